//! `hil-sim serve-court`: two arms, each on a bus of its own, a ball between them and a tracker, in real time.
//!
//! ```text
//! client ── bus 1 ── drives of the thrower ──┐ joints, each millisecond
//! client ── bus 2 ── drives of the catcher ──┴──► Court: ball, cups, floor ──► datagrams of the tracker
//!                                                   └──► what really happened
//! ```
//!
//! Each bus runs in a thread of its own; all follow one clock. The court moves on as far as both arms have, some milliseconds behind
//! the clock. The tracker's latency is longer than that, so its datagrams leave on time.
//!
//! In lock step one thread gives turns to the clients of both buses, a millisecond of the first bus and then the same of the second one,
//! and the clients' connection for the tracker's data has marks of that time ([`hil_sim::court::in_step`]): a run depends on the programs and the
//! seed alone.

use std::collections::VecDeque;
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::JoinHandle;

use can_link::{BusSpec, Clock, Role, Urgent};
use hil_sim::bus::BusConfig;
use hil_sim::cell::{Cell, CellOptions};
use hil_sim::court::in_step::{STEP, Trackers};
use hil_sim::court::{ArmPlace, Court, CourtEvent, CourtOptions, JointsNow};
use hil_sim::realtime::{Door, Realtime, shared_time};
use protocol::{Duration, Instant};
use robot_model::JointVec;
use serde_json::json;

use super::exit::{Code, Failure};
use super::progress::{Interrupt, say};

/// Both arms stand upright at the beginning, deg.
const STANDING_DEG: [f64; 6] = [0.0, -90.0, -90.0, 0.0, 0.0, 0.0];

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Court file: places of the arms, ball, cups, tracker and its faults; the built-in one otherwise.
    #[arg(long, value_name = "FILE")]
    court: Option<PathBuf>,
    /// Where the bus of the thrower is, as for `serve`. With lockstep:// for both buses all is in one virtual time.
    #[arg(long, value_parser = can_link::bus_of_option, default_value = "socketcand://127.0.0.1:29536/can0")]
    bus_thrower: BusSpec,
    /// Where the bus of the catcher is.
    #[arg(long, value_parser = can_link::bus_of_option, default_value = "socketcand://127.0.0.1:29537/can0")]
    bus_catcher: BusSpec,
    /// Where the tracker sends its data, which it does without being asked. In lock step: where a client fetches them.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:5000")]
    data: String,
    /// The drives are homed, as if they had been left on.
    #[arg(long)]
    homed: bool,
    /// Seed instead of the court's.
    #[arg(long)]
    seed: Option<u64>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    duration_s: Option<f64>,
    /// Print events and the report as JSON lines.
    #[arg(long)]
    json: bool,
}

/// An arm at a point of the grid.
struct ArmNow {
    at: Instant,
    joints: JointsNow,
    /// When the ball left the fingers.
    released_at: Option<Instant>,
}

/// The bus of an arm in its thread.
struct ArmBus {
    samples: Receiver<ArmNow>,
    waiting: VecDeque<ArmNow>,
    thread: JoinHandle<Result<Duration, String>>,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let court = match &args.court {
        Some(file) => CourtOptions::load(file),
        None => CourtOptions::two_arms(),
    };
    let mut court = court.map_err(|error| Failure::new(Code::BadFile, &error))?;
    court.seed = args.seed.unwrap_or(court.seed);
    let data = address(&args.data)?;
    let specs = [&args.bus_thrower, &args.bus_catcher];
    let buses = specs.map(Clone::clone);
    let (_, in_step) =
        shared_time(&buses).map_err(|error| Failure::new(Code::BadFile, &error).next(error.next()))?;
    if in_step.is_some() {
        return run_in_step(args, court, data);
    }
    let any: SocketAddr = if data.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
    let socket = UdpSocket::bind(any).map_err(|error| Failure::new(Code::Bus, &error))?;
    let clock = Clock::start();
    let over = Arc::new(AtomicBool::new(false));
    let mut arms = Vec::new();
    for (k, spec) in specs.into_iter().enumerate() {
        let door =
            Door::open(spec, clock).map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))?;
        say(args.json, "serving", &format!("{} ({})", door.name(), ["thrower", "catcher"][k]));
        arms.push(arm_bus(&court.arms[k], args.homed, court.seed + k as u64, door, clock, &over));
    }
    say(args.json, "serving", &format!("tracker data to {data}"));
    let urgent = Urgent::request(Role::Plant);
    say(args.json, "real time", &urgent.granted().to_string());
    let interrupt = Interrupt::listen();
    let until = args.duration_s.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    let mut live = Live::of(court);
    let goes_on = || !interrupt.came() && clock.now() < until;
    let ended = live.run(args, &mut arms, &socket, data, clock, &goes_on);
    over.store(true, Ordering::Relaxed);
    let mut lags = Vec::new();
    for arm in arms {
        drop(arm.samples);
        let lag = arm.thread.join().map_err(|_| Failure::new(Code::Bus, &"the thread of a bus has ended"))?;
        lags.push(lag.map_err(|why| Failure::new(Code::Bus, &why))?);
    }
    ended?;
    live.report(args, &lags)
}

/// Both buses, ball and tracker in one virtual time, until all clients have left.
fn run_in_step(args: &Args, court: CourtOptions, data: SocketAddr) -> Result<(), Failure> {
    let mut trackers = Trackers::listen(data).map_err(|error| Failure::new(Code::Bus, &error))?;
    let failed = |why: String| Failure::new(Code::Bus, &why);
    let mut arms = Vec::new();
    for (k, spec) in [&args.bus_thrower, &args.bus_catcher].into_iter().enumerate() {
        let BusSpec::Lockstep { clients, .. } = spec else { continue };
        let clock = Clock::manual();
        let door =
            Door::open(spec, clock).map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))?;
        say(args.json, "serving", &format!("{} ({})", door.name(), ["thrower", "catcher"][k]));
        let seed = court.seed + k as u64;
        let realtime = realtime_of(&court.arms[k], args.homed, seed, door, clock).map_err(failed)?;
        arms.push((realtime.in_lock_step(*clients), 0, VecDeque::new()));
    }
    say(args.json, "lock step", &format!("tracker data at {data}"));
    let interrupt = Interrupt::listen();
    let until = args.duration_s.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    let mut live = Live::of(court);
    while !arms.iter_mut().fold(true, |all, (arm, ..)| arm.is_gathered() && all) && !interrupt.came() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let mut now = Instant::ZERO;
    while now < until && !interrupt.came() && arms.iter().any(|(arm, ..)| arm.members() > 0) {
        now += STEP;
        for (arm, sent, samples) in &mut arms {
            while !arm.has_reached(now) && !interrupt.came() {
                arm.turn(now, &mut ()).map_err(|error| failed(error.to_string()))?;
            }
            samples.extend(samples_since(arm, sent).map_err(failed)?);
        }
        while arms.iter().all(|(.., samples)| !samples.is_empty()) {
            let mut both = arms.iter_mut().filter_map(|(.., samples)| samples.pop_front());
            let (Some(thrower), Some(catcher)) = (both.next(), both.next()) else { break };
            live.step(&thrower, &catcher);
        }
        live.tell(args);
        let datagrams: Vec<_> = std::iter::from_fn(|| live.court.poll_datagram_by(now)).collect();
        trackers.put(&datagrams, now + STEP);
    }
    (live.datagrams, live.unsent) = (trackers.taken, trackers.untaken);
    live.report(args, &[])
}

/// The bus of an arm that stands upright.
fn realtime_of(
    place: &ArmPlace,
    homed: bool,
    seed: u64,
    door: Door,
    clock: Clock,
) -> Result<Realtime<Cell>, String> {
    let mut options = CellOptions {
        start_q_rad: Some(STANDING_DEG.map(f64::to_radians).to_vec()),
        ..CellOptions::default()
    };
    options.drive.starts_homed = homed;
    let mut cell = Cell::new(&place.model, &options, seed).map_err(|error| error.to_string())?;
    cell.record_trace();
    Realtime::new(cell, BusConfig::default(), seed, Vec::new(), vec![door], clock)
        .map_err(|error| error.to_string())
}

/// What the arm did since the last call.
fn samples_since(realtime: &Realtime<Cell>, sent: &mut usize) -> Result<Vec<ArmNow>, String> {
    let cell = &realtime.world().participants().0;
    let Some(trace) = cell.trace() else { return Err("the arm is not recorded".to_owned()) };
    let first = std::mem::replace(sent, trace.len());
    let sample = |index| {
        let joint = |i: usize, part: usize| trace.sample(index).get(i).map_or(0.0, |joint| joint[part]);
        let (q, qd) = (JointVec::from_fn(6, |i| joint(i, 0)), JointVec::from_fn(6, |i| joint(i, 1)));
        ArmNow { at: trace.at(index), joints: JointsNow { q, qd }, released_at: cell.throw().released_at }
    };
    Ok((first..trace.len()).map(sample).collect())
}

fn arm_bus(
    place: &ArmPlace,
    homed: bool,
    seed: u64,
    door: Door,
    clock: Clock,
    over: &Arc<AtomicBool>,
) -> ArmBus {
    let (sender, samples) = mpsc::channel();
    let (place, over) = (place.clone(), Arc::clone(over));
    let thread = std::thread::spawn(move || {
        let realtime = realtime_of(&place, homed, seed, door, clock)?;
        let _urgent = Urgent::request(Role::Plant);
        serve(realtime, &sender, &over)
    });
    ArmBus { samples, waiting: VecDeque::new(), thread }
}

/// Serves one bus and sends what its arm does. Returns how late it was at worst: a turn behind the clock, or a frame when it left.
fn serve(mut realtime: Realtime<Cell>, to: &Sender<ArmNow>, over: &AtomicBool) -> Result<Duration, String> {
    let mut sent = 0;
    while !over.load(Ordering::Relaxed) {
        let next = realtime.world().now() + STEP;
        realtime.turn(next, &mut ()).map_err(|error| error.to_string())?;
        for now in samples_since(&realtime, &mut sent)? {
            if to.send(now).is_err() {
                break;
            }
        }
    }
    Ok(realtime.lag().turns.max().max(realtime.lateness().max()).unwrap_or_default())
}

/// The court while it runs.
struct Live {
    court: Court,
    released: bool,
    /// Events that were printed.
    printed: usize,
    datagrams: u64,
    unsent: u64,
}

impl Live {
    fn of(court: CourtOptions) -> Self {
        let upright =
            JointsNow { q: JointVec::from(STANDING_DEG.map(f64::to_radians)), qd: JointVec::zeros(6) };
        Self {
            court: Court::new(court, 0, [upright; 2]),
            released: false,
            printed: 0,
            datagrams: 0,
            unsent: 0,
        }
    }

    fn run(
        &mut self,
        args: &Args,
        arms: &mut [ArmBus],
        socket: &UdpSocket,
        data: SocketAddr,
        clock: Clock,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<(), Failure> {
        while goes_on() {
            for arm in &mut *arms {
                match arm.samples.recv_timeout(std::time::Duration::from_millis(1)) {
                    Ok(sample) => arm.waiting.push_back(sample),
                    Err(RecvTimeoutError::Timeout) => {}
                    // Its thread says why when it is joined.
                    Err(RecvTimeoutError::Disconnected) => return Ok(()),
                }
                arm.waiting.extend(arm.samples.try_iter());
            }
            while arms.iter().all(|arm| !arm.waiting.is_empty()) {
                let mut both = arms.iter_mut().filter_map(|arm| arm.waiting.pop_front());
                let (Some(thrower), Some(catcher)) = (both.next(), both.next()) else { break };
                self.step(&thrower, &catcher);
            }
            self.tell(args);
            while let Some(bytes) = self.court.poll_datagram_by(clock.now()) {
                match socket.send_to(&bytes, data) {
                    Ok(_) => self.datagrams += 1,
                    Err(_) => self.unsent += 1,
                }
            }
        }
        Ok(())
    }

    fn step(&mut self, thrower: &ArmNow, catcher: &ArmNow) {
        if let (Some(at), false) = (thrower.released_at, self.released) {
            self.released = true;
            self.court.release_at(at);
        }
        self.court.step(thrower.at, [thrower.joints, catcher.joints]);
    }

    fn tell(&mut self, args: &Args) {
        for (at, event) in self.court.events().iter().skip(self.printed) {
            let text = format!("{:.4} s: {}", at.as_secs_f64(), words(event));
            if args.json {
                console::line!(
                    "{}",
                    json!({"event": "court", "t_s": at.as_secs_f64(), "what": words(event)})
                );
            } else {
                console::note!("{text}");
            }
        }
        self.printed = self.court.events().len();
    }

    fn report(&self, args: &Args, lags: &[Duration]) -> Result<(), Failure> {
        let events = self.court.events();
        let has = |wanted: &dyn Fn(&CourtEvent) -> bool| events.iter().any(|(_, event)| wanted(event));
        let caught = self.court.resting_in() == Some(1);
        let floor = has(&|event| *event == CourtEvent::HitFloor);
        let worst_ms: Vec<f64> = lags.iter().map(|lag| lag.as_secs_f64() * 1e3).collect();
        if args.json {
            let report = json!({
                "event": "report",
                "released": self.released,
                "caught": caught,
                "touched_floor": floor,
                "touched_catcher": has(&|event| matches!(event, CourtEvent::HitCup { arm: 1, .. } | CourtEvent::HitLink { arm: 1, .. })),
                "crossing": events.iter().find_map(|(_, event)| match event {
                    CourtEvent::Crossed { arm: 1, crossing } => Some(json!({
                        "miss_m": crossing.miss_m, "angle_rad": crossing.angle_rad, "speed_m_s": crossing.speed_m_s,
                    })),
                    _ => None,
                }),
                "datagrams": self.datagrams,
                "unsent": self.unsent,
                "simulated_s": self.court.now().as_secs_f64(),
                "worst_lag_ms": worst_ms,
            });
            console::line!("{}", serde_json::to_string(&report).map_err(|e| Failure::new(Code::Output, &e))?);
            return Ok(());
        }
        let what = match (self.released, caught, floor) {
            (false, ..) => "the ball was not released",
            (true, true, _) => "the ball lies in the catcher's cup",
            (true, false, true) => "the ball was not caught; it touched the floor",
            (true, false, false) => "the ball was not caught",
        };
        console::line!("{what}");
        console::line!(
            "tracker: {} datagrams sent, {} not taken; behind the clock at worst: thrower {:.1} ms, catcher {:.1} ms",
            self.datagrams,
            self.unsent,
            worst_ms.first().copied().unwrap_or_default(),
            worst_ms.get(1).copied().unwrap_or_default()
        );
        Ok(())
    }
}

fn words(event: &CourtEvent) -> String {
    let name = |arm: &usize| ["thrower", "catcher"][*arm];
    match event {
        CourtEvent::Released { arm } => format!("the {} lets the ball go", name(arm)),
        CourtEvent::Crossed { arm, crossing } => format!(
            "the ball crosses the mouth of the {}'s cup, {:.1} mm off its axis, with {:.2} m/s",
            name(arm),
            crossing.miss_m * 1e3,
            crossing.speed_m_s
        ),
        CourtEvent::HitCup { arm, speed_m_s } => {
            format!("the ball hits the cup of the {} with {speed_m_s:.2} m/s", name(arm))
        }
        CourtEvent::HitLink { arm, part, .. } => format!("the ball hits the {} ({part})", name(arm)),
        CourtEvent::HitFloor => "the ball hits the floor".to_owned(),
        CourtEvent::Rests { arm } => format!("the ball rests in the cup of the {}", name(arm)),
        CourtEvent::FellOut { arm } => format!("the ball has left the cup of the {}", name(arm)),
    }
}

fn address(text: &str) -> Result<SocketAddr, Failure> {
    let wrong = |why: String| {
        Failure::new(Code::Bus, &format!("{text}: {why}"))
            .next("give HOST:PORT, for example 127.0.0.1:5000".to_owned())
    };
    let mut found = text.to_socket_addrs().map_err(|error| wrong(error.to_string()))?;
    found.next().ok_or_else(|| wrong("no address".to_owned()))
}
