//! How fast virtual time is: simulated seconds per second, and where the time goes.
//!
//! Traffic as the controller makes it: six joints, four frames each per cycle (SET acceleration and its
//! acknowledge, ramp with its long acknowledge), at 1 Mbit/s, as dense as the bus allows. First with nodes that do
//! nothing but answer, which shows bus and scheduler alone; then the full cell of `scenarios/cycle.toml`, six drives
//! that move the arm.
//!
//! `cargo bench -p hil-sim --bench virtual_time`; prints medians of several runs, in processor time.

use std::collections::VecDeque;
use std::hint::black_box;
use std::time::Instant as WallClock;

use hil_sim::bus::{Bus, BusConfig, QuietWire};
use hil_sim::participants::Solo;
use hil_sim::record::CandumpLog;
use hil_sim::scenario::Scenario;
use hil_sim::world::World;
use protocol::text::BusName;
use protocol::{Duration, Frame, Instant, Node, StandardId, bits};

const JOINTS: u16 = 6;
const CYCLE: Duration = Duration::from_micros(2_900);
const PROCESSING: Duration = Duration::from_micros(20);
const RUNS: usize = 7;

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::from_low_bits(id), data)
        .unwrap_or_else(|_| Frame::from_array(StandardId::ZERO, []))
}

/// Starts a cycle on its timer: two requests to each joint.
struct Controller {
    next: Instant,
    out: VecDeque<Frame>,
    answers: u64,
}

impl Node for Controller {
    fn handle_frame(&mut self, _: Instant, frame: &Frame) {
        if (0x0A1..=0x0BF).contains(&frame.id().raw()) {
            self.answers += 1;
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if now < self.next {
            return;
        }
        self.next += CYCLE;
        for joint in 1..=JOINTS {
            let value = (self.answers as f32 * 1e-3).to_le_bytes();
            let [a, b, c, d] = value;
            self.out.push_back(frame(0x0E0 + joint, &[0x08, 0x50, a, b, c, d]));
            self.out.push_back(frame(0x0E0 + joint, &[0x0B, 0x0E, d, c, b, a]));
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }
}

/// Answers its requests after a fixed time.
struct Module {
    address: u16,
    due: VecDeque<(Instant, Frame)>,
    out: Option<Frame>,
}

impl Node for Module {
    fn handle_frame(&mut self, now: Instant, request: &Frame) {
        if request.id().raw() == u32::from(0x0E0 + self.address) {
            let data = request.data();
            let answer = match data {
                [0x08, parameter, ..] => frame(0x0A0 + self.address, &[0x08, *parameter, 0x64]),
                [0x0B, motion, a, b, c, d] => {
                    frame(0x0A0 + self.address, &[0x0B, *motion, *a, *b, *c, *d, 0x20, 0x00])
                }
                _ => return,
            };
            self.due.push_back((now + PROCESSING, answer));
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if self.due.front().is_some_and(|(at, _)| *at <= now) {
            self.out = self.due.pop_front().map(|(_, frame)| frame);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.take()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.due.front().map(|(at, _)| *at)
    }
}

fn world() -> World<(Solo<Controller>, Vec<Solo<Module>>)> {
    let controller =
        Solo::new("controller", Controller { next: Instant::ZERO, out: VecDeque::new(), answers: 0 });
    let modules = (1..=JOINTS)
        .map(|address| {
            Solo::new(format!("module {address}"), Module { address, due: VecDeque::new(), out: None })
        })
        .collect();
    match World::new((controller, modules), BusConfig::default(), 1, Vec::new()) {
        Ok(world) => world,
        Err(error) => unreachable!("default bus: {error}"),
    }
}

/// Seconds that this thread has spent on a processor, so that other programs do not count; Linux keeps it in nanoseconds.
fn on_processor_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    text.split(' ').next()?.parse::<f64>().ok().map(|ns| ns * 1e-9)
}

/// Median of the processor seconds of `RUNS` runs; of the wall clock where the system does not report them.
fn median_s(mut run: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let (wall, processor) = (WallClock::now(), on_processor_s());
            run();
            match (processor, on_processor_s()) {
                (Some(before), Some(after)) => after - before,
                _ => wall.elapsed().as_secs_f64(),
            }
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2]
}

fn main() {
    // `cargo test --benches` runs this too: one short round then.
    let simulated_s = if std::env::args().any(|arg| arg == "--bench") { 20 } else { 1 };
    let end = Instant::ZERO + Duration::from_secs(simulated_s);

    let mut frames = 0;
    let mut utilisation = 0.0;
    let wall_s = median_s(|| {
        let mut world = world();
        if let Err(error) = world.run_until(end, &mut ()) {
            unreachable!("{error}");
        }
        frames = world.stats().frames;
        utilisation = world.bus().busy_ns() as f64 / world.bus().now_ns() as f64;
    });
    let logged_s = median_s(|| {
        let Ok(bus) = BusName::new("can0") else { unreachable!("a bus name") };
        let mut log = CandumpLog::new(Vec::with_capacity(64 << 20), bus);
        if let Err(error) = world().run_until(end, &mut log) {
            unreachable!("{error}");
        }
        black_box(log.lines());
    });
    let mut cell_frames = 0;
    let cell_wall_s = median_s(|| {
        let text = include_str!("../scenarios/cycle.toml");
        let world = Scenario::from_toml("cycle.toml", text).map(|scenario| scenario.world());
        let Ok(Ok(mut world)) = world else { unreachable!("checked by the stage that runs all scenarios") };
        if let Err(error) = world.run_until(end, &mut ()) {
            unreachable!("{error}");
        }
        cell_frames = world.stats().frames;
    });
    let sample = frame(0x0A3, &[0x0B, 0x0E, 0x12, 0x34, 0x56, 0x3F, 0x20, 0]);
    let encode_ns = 1e3
        * median_s(|| {
            for _ in 0..1_000_000 {
                black_box(bits::length(black_box(&sample)).frame());
            }
        });
    let bus_ns = 1e4
        * median_s(|| {
            let Ok(mut bus) = Bus::new(BusConfig::default(), 7) else { unreachable!("default bus") };
            for at in 0..100_000_u64 {
                bus.send(3, sample, at * 200_000);
                while bus.run_until((at + 1) * 200_000, &mut QuietWire).is_some() {}
            }
        });

    let per_frame_ns = wall_s * 1e9 / frames as f64;
    println!("six joints x 4 frames every {CYCLE}, 1 Mbit/s, utilisation {:.1} %", utilisation * 100.0);
    println!(
        "bus + scheduler            {:>8.0} x real time, {per_frame_ns:.0} ns per frame",
        simulated_s as f64 / wall_s
    );
    println!(
        "with candump log           {:>8.0} x real time, {:.0} ns per frame",
        simulated_s as f64 / logged_s,
        logged_s * 1e9 / frames as f64
    );
    let cell_ns = cell_wall_s * 1e9 / cell_frames as f64;
    println!(
        "full cell                  {:>8.0} x real time, {cell_ns:.0} ns per frame, of which drives and arm {:.0} %",
        simulated_s as f64 / cell_wall_s,
        100.0 * (1.0 - per_frame_ns / cell_ns)
    );
    println!("of which bus alone         {bus_ns:>8.0} ns per frame, {encode_ns:.0} ns of it counting bits");
}
