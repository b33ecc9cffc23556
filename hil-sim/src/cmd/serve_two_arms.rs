//! `hil-sim serve-two-arms`: two arms, each on a bus of its own, a ball between them and a tracker, in real time. A hand that closes around a
//! ball at rest in its cup grips it, and its next opening is the next throw.
//!
//! ```text
//! client ── bus 1 ── drives of the thrower ──┐ joints, each millisecond
//! client ── bus 2 ── drives of the catcher ──┴──► TwoArmCell: ball, cups, floor ──► datagrams of the tracker
//!                                                   └──► what really happened
//! ```
//!
//! Each bus runs in a thread of its own; all follow one clock. The cell moves on as far as both arms have, some milliseconds behind
//! the clock. The tracker's latency is longer than that, so its datagrams leave on time.
//!
//! In lock step one thread gives turns to the clients of both buses, a millisecond of the first bus and then the same of the second one,
//! and the clients' connection for the tracker's data has marks of that time ([`hil_sim::two_arms::in_step`]): a run depends on the programs and the
//! seed alone.

use std::collections::VecDeque;
use std::net::{SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::JoinHandle;

use can_link::{BusSpec, Clock, Role, Urgent};
use hil_sim::bus::BusConfig;
use hil_sim::cell::{Cell, CellOptions};
use hil_sim::mechanics::LooseBall;
use hil_sim::realtime::{Endpoint, Realtime, shared_time};
use hil_sim::two_arms::in_step::{STEP, Trackers};
use hil_sim::two_arms::{ArmPlace, Crossing, JointsNow, TwoArmCell, TwoArmEvent, TwoArmOptions};
use nalgebra::Vector3;
use protocol::{Duration, Instant};
use robot_model::JointVec;
use serde_json::{Value, json};

use super::exit::{Code, Failure};
use super::progress::{Interrupt, say};
use super::serve_tracker::address;

/// Both arms stand upright at the beginning, deg.
const STANDING_DEG: [f64; 6] = [0.0, -90.0, -90.0, 0.0, 0.0, 0.0];

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Cell file: places of the arms, ball, cups, tracker and its faults; the built-in one otherwise.
    #[arg(long, value_name = "FILE", alias = "court")]
    cell: Option<PathBuf>,
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
    /// A ball that is thrown by hand, instead of the first arm, which is not there then, nor its bus: place (m) and velocity (m/s)
    /// in the base frame of the second arm.
    #[arg(long, value_name = "X,Y,Z,VX,VY,VZ", allow_hyphen_values = true, value_parser = six, conflicts_with = "bus_thrower")]
    ball: Option<[f64; 6]>,
    /// When it is thrown, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 15.0, requires = "ball", value_parser = seconds)]
    ball_at_s: f64,
    /// Seed instead of the cell's.
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
    /// When the hand let go of what it held.
    released_at: Option<Instant>,
    /// When the hand was last ordered to close; `None` while it is ordered to open.
    closed_at: Option<Instant>,
}

struct ArmBus {
    samples: Receiver<ArmNow>,
    waiting: VecDeque<ArmNow>,
    thread: JoinHandle<Result<Duration, String>>,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let cell = match &args.cell {
        Some(file) => TwoArmOptions::load(file),
        None => TwoArmOptions::two_arms(),
    };
    let mut cell = cell.map_err(|error| Failure::new(Code::BadFile, &error))?;
    cell.seed = args.seed.unwrap_or(cell.seed);
    let data = address(&args.data)?;
    if args.ball.is_some() {
        cell = cell.without_thrower();
    }
    let buses: Vec<BusSpec> = served(args).map(|(_, spec)| spec.clone()).collect();
    let (_, in_step) =
        shared_time(&buses).map_err(|error| Failure::new(Code::BadFile, &error).next(error.next()))?;
    if in_step.is_some() {
        return run_in_step(args, cell, data);
    }
    let any: SocketAddr = if data.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
    let socket = UdpSocket::bind(any).map_err(|error| Failure::new(Code::Bus, &error))?;
    let clock = Clock::start();
    let over = Arc::new(AtomicBool::new(false));
    let mut arms = Vec::new();
    for (k, spec) in served(args) {
        let endpoint = open_endpoint(args, k, spec, clock)?;
        arms.push(arm_bus(&cell.arms[k], args.homed, cell.seed + k as u64, endpoint, clock, &over));
    }
    say(args.json, "serving", &format!("tracker data to {data}"));
    let urgent = Urgent::request(Role::Plant);
    say(args.json, "real time", &urgent.granted().to_string());
    let interrupt = Interrupt::listen();
    let until = args.duration_s.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    let mut live = Live::of(args, cell);
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

/// The arms that are there, by number, and their buses.
fn served(args: &Args) -> impl Iterator<Item = (usize, &BusSpec)> {
    let both = [&args.bus_thrower, &args.bus_catcher].into_iter().enumerate();
    both.skip(usize::from(args.ball.is_some()))
}

fn open_endpoint(args: &Args, arm: usize, spec: &BusSpec, clock: Clock) -> Result<Endpoint, Failure> {
    let endpoint =
        Endpoint::open(spec, clock).map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))?;
    say(args.json, "serving", &format!("{} (arm {})", endpoint.name(), arm + 1));
    Ok(endpoint)
}

/// Both buses, ball and tracker in one virtual time, until all clients have left.
fn run_in_step(args: &Args, cell: TwoArmOptions, data: SocketAddr) -> Result<(), Failure> {
    let mut trackers = Trackers::listen(data).map_err(|error| Failure::new(Code::Bus, &error))?;
    let failed = |why: String| Failure::new(Code::Bus, &why);
    let mut arms = Vec::new();
    for (k, spec) in served(args) {
        let BusSpec::Lockstep { clients, .. } = spec else { continue };
        let clock = Clock::manual();
        let endpoint = open_endpoint(args, k, spec, clock)?;
        let seed = cell.seed + k as u64;
        let realtime = realtime_of(&cell.arms[k], args.homed, seed, endpoint, clock).map_err(failed)?;
        arms.push((realtime.in_lock_step(*clients), 0, VecDeque::new()));
    }
    say(args.json, "lock step", &format!("tracker data at {data}"));
    let interrupt = Interrupt::listen();
    let until = args.duration_s.map_or(Instant::FAR_FUTURE, |s| Instant::ZERO + Duration::from_secs_f64(s));
    let mut live = Live::of(args, cell);
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
            hold_again(arm).map_err(failed)?;
            samples.extend(samples_since(arm, sent).map_err(failed)?);
        }
        while arms.iter().all(|(.., samples)| !samples.is_empty()) {
            live.step(arms.iter_mut().filter_map(|(.., samples)| samples.pop_front()));
        }
        live.print_events(args);
        let datagrams: Vec<_> = std::iter::from_fn(|| live.cell.poll_datagram_by(now)).collect();
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
    endpoint: Endpoint,
    clock: Clock,
) -> Result<Realtime<Cell>, String> {
    let mut options = CellOptions {
        start_q_rad: Some(STANDING_DEG.map(f64::to_radians).to_vec()),
        ..CellOptions::default()
    };
    options.drive.starts_homed = homed;
    let mut cell = Cell::new(&place.model, &options, seed).map_err(|error| error.to_string())?;
    cell.record_trace();
    Realtime::new(cell, BusConfig::default(), seed, Vec::new(), vec![endpoint], clock)
        .map_err(|error| error.to_string())
}

/// A hand that has closed after a throw lets go again at its next opening. Whether it holds the ball, the cell knows.
fn hold_again(realtime: &mut Realtime<Cell>) -> Result<(), String> {
    let cell = &realtime.world().participants().0;
    if cell.throw().released_at.is_none() || cell.closed_at().is_none() {
        return Ok(());
    }
    let held = realtime.world_mut().with_participants(|(cell, _), now| cell.reload(now));
    held.map_err(|error| error.to_string())
}

/// What the arm did since the last call.
fn samples_since(realtime: &Realtime<Cell>, sent: &mut usize) -> Result<Vec<ArmNow>, String> {
    let cell = &realtime.world().participants().0;
    let Some(trace) = cell.trace() else { return Err("the arm is not recorded".to_owned()) };
    let first = std::mem::replace(sent, trace.len());
    let sample = |index| {
        let joint = |i: usize, part: usize| trace.sample(index).get(i).map_or(0.0, |joint| joint[part]);
        let (q, qd) = (JointVec::from_fn(6, |i| joint(i, 0)), JointVec::from_fn(6, |i| joint(i, 1)));
        ArmNow {
            at: trace.at(index),
            joints: JointsNow { q, qd },
            released_at: cell.throw().released_at,
            closed_at: cell.closed_at(),
        }
    };
    Ok((first..trace.len()).map(sample).collect())
}

fn arm_bus(
    place: &ArmPlace,
    homed: bool,
    seed: u64,
    endpoint: Endpoint,
    clock: Clock,
    over: &Arc<AtomicBool>,
) -> ArmBus {
    let (sender, samples) = mpsc::channel();
    let (place, over) = (place.clone(), Arc::clone(over));
    let thread = std::thread::spawn(move || {
        let realtime = realtime_of(&place, homed, seed, endpoint, clock)?;
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
        hold_again(&mut realtime)?;
        for now in samples_since(&realtime, &mut sent)? {
            if to.send(now).is_err() {
                break;
            }
        }
    }
    Ok(realtime.lag().turns.max().max(realtime.lateness().max()).unwrap_or_default())
}

/// The cell while it runs.
struct Live {
    cell: TwoArmCell,
    joints: [JointsNow; 2],
    /// Of each arm: when it let go last, and when it was ordered to close last.
    released_at: [Option<Instant>; 2],
    closed_at: [Option<Instant>; 2],
    /// The arms that are there begin with this one.
    first: usize,
    /// A ball that is still to be thrown by hand, and when.
    ball: Option<(Instant, LooseBall)>,
    thrown_in_at: Option<Instant>,
    /// Events that were printed.
    printed: usize,
    datagrams: u64,
    unsent: u64,
}

impl Live {
    fn of(args: &Args, cell: TwoArmOptions) -> Self {
        let upright =
            JointsNow { q: JointVec::from(STANDING_DEG.map(f64::to_radians)), qd: JointVec::zeros(6) };
        let x_wb = cell.arms[1].x_wb;
        let ball = args.ball.map(|[x, y, z, vx, vy, vz]| {
            let at = Instant::ZERO + Duration::from_secs_f64(args.ball_at_s);
            let (p, v) = (Vector3::new(x, y, z), Vector3::new(vx, vy, vz));
            let p_m = x_wb.transform_point(&p);
            (at, LooseBall { p_m, v_m_s: x_wb.rot * v, spin_rad_s: Vector3::zeros() })
        });
        let lies_e_m = cell.cup.rest_e_m(cell.ball.radius_m);
        let mut cell = TwoArmCell::new(cell, 0, [upright; 2]);
        // Who puts the ball into the hand lays it into the middle of the cup.
        cell.grip_at(lies_e_m);
        Self {
            cell,
            joints: [upright; 2],
            released_at: [None; 2],
            closed_at: [Some(Instant::ZERO); 2],
            first: usize::from(ball.is_some()),
            ball,
            thrown_in_at: None,
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
                self.step(arms.iter_mut().filter_map(|arm| arm.waiting.pop_front()));
            }
            self.print_events(args);
            while let Some(bytes) = self.cell.poll_datagram_by(clock.now()) {
                match socket.send_to(&bytes, data) {
                    Ok(_) => self.datagrams += 1,
                    Err(_) => self.unsent += 1,
                }
            }
        }
        Ok(())
    }

    fn step(&mut self, arms: impl Iterator<Item = ArmNow>) {
        let mut to = self.cell.now();
        for (k, arm) in (self.first..).zip(arms) {
            if arm.closed_at != std::mem::replace(&mut self.closed_at[k], arm.closed_at) {
                self.cell.set_jaws(k, arm.closed_at.is_none());
            }
            let before = std::mem::replace(&mut self.released_at[k], arm.released_at);
            if let Some(at) = arm.released_at.filter(|_| before != arm.released_at)
                && self.cell.holder() == Some(k)
            {
                self.cell.release_at(at);
            }
            (self.joints[k], to) = (arm.joints, arm.at);
        }
        if let Some((_, ball)) = self.ball.take_if(|(at, _)| *at <= to) {
            self.cell.throw_in(ball);
            self.thrown_in_at = Some(to);
        }
        self.cell.step(to, self.joints);
    }

    fn print_events(&mut self, args: &Args) {
        for (at, event) in self.cell.events().iter().skip(self.printed) {
            let text = format!("{:.4} s: {}", at.as_secs_f64(), words(event));
            if args.json {
                console::line!("{}", json!({"event": "cell", "t_s": at.as_secs_f64(), "what": words(event)}));
            } else {
                console::note!("{text}");
            }
        }
        self.printed = self.cell.events().len();
    }

    fn report(&self, args: &Args, lags: &[Duration]) -> Result<(), Failure> {
        let worst_ms: Vec<f64> = lags.iter().map(|lag| lag.as_secs_f64() * 1e3).collect();
        let throws = thrown(self.thrown_in_at, self.cell.events());
        if args.json {
            let report = json!({
                "event": "report",
                "throws": throws.iter().map(Thrown::as_json).collect::<Vec<_>>(),
                "datagrams": self.datagrams,
                "unsent": self.unsent,
                "simulated_s": self.cell.now().as_secs_f64(),
                "worst_lag_ms": worst_ms,
            });
            console::line!("{}", serde_json::to_string(&report).map_err(|e| Failure::new(Code::Output, &e))?);
            return Ok(());
        }
        if throws.is_empty() {
            console::line!("the ball was not released");
        }
        for (k, throw) in throws.iter().enumerate() {
            console::line!("throw {}: {}", k + 1, throw.words());
        }
        console::line!(
            "tracker: {} datagrams sent, {} not taken; behind the clock at worst: {:.1} ms",
            self.datagrams,
            self.unsent,
            worst_ms.iter().copied().fold(0.0, f64::max)
        );
        Ok(())
    }
}

/// A throw, from the release to the next one.
#[derive(Default)]
struct Thrown {
    released_at: Instant,
    /// 0 or 1; `None`: by hand.
    by: Option<usize>,
    /// The ball lies in the other arm's cup, or was gripped there.
    caught: bool,
    touched_floor: bool,
    touched_catcher: bool,
    crossing: Option<Crossing>,
}

fn thrown(by_hand: Option<Instant>, events: &[(Instant, TwoArmEvent)]) -> Vec<Thrown> {
    let by_hand = by_hand.map(|released_at| Thrown { released_at, ..Thrown::default() });
    let mut throws: Vec<Thrown> = by_hand.into_iter().collect();
    for (at, event) in events {
        if let TwoArmEvent::Released { arm } = event {
            throws.push(Thrown { released_at: *at, by: Some(*arm), ..Thrown::default() });
        }
        let Some(throw) = throws.last_mut() else { continue };
        let by_catcher = |arm: &usize| Some(*arm) != throw.by;
        match event {
            TwoArmEvent::Crossed { arm, crossing } if by_catcher(arm) => throw.crossing = Some(*crossing),
            TwoArmEvent::HitCup { arm, .. } | TwoArmEvent::HitLink { arm, .. } if by_catcher(arm) => {
                throw.touched_catcher = true;
            }
            TwoArmEvent::HitFloor => throw.touched_floor = true,
            TwoArmEvent::Rests { arm } if by_catcher(arm) => throw.caught = true,
            TwoArmEvent::FellOut { arm } if by_catcher(arm) => throw.caught = false,
            _ => {}
        }
    }
    throws
}

impl Thrown {
    fn as_json(&self) -> Value {
        json!({
            "t_s": self.released_at.as_secs_f64(),
            "thrower": self.by.map(|arm| arm + 1),
            "caught": self.caught,
            "touched_floor": self.touched_floor,
            "touched_catcher": self.touched_catcher,
            "crossing": self.crossing.map(|crossing| json!({
                "miss_m": crossing.miss_m, "angle_rad": crossing.angle_rad, "speed_m_s": crossing.speed_m_s,
            })),
        })
    }

    fn words(&self) -> String {
        let what = match (self.caught, self.touched_floor) {
            (true, _) => "the ball lies in a cup",
            (false, true) => "the ball was not caught; it touched the floor",
            (false, false) => "the ball was not caught",
        };
        let at_s = self.released_at.as_secs_f64();
        match self.by {
            Some(arm) => format!("arm {} lets go at {at_s:.3} s; {what}", arm + 1),
            None => format!("by hand at {at_s:.3} s; {what}"),
        }
    }
}

fn words(event: &TwoArmEvent) -> String {
    let name = |arm: &usize| format!("arm {}", arm + 1);
    match event {
        TwoArmEvent::Released { arm } => format!("{} lets the ball go", name(arm)),
        TwoArmEvent::Crossed { arm, crossing } => format!(
            "the ball crosses the mouth of the cup of {}, {:.1} mm off its axis, with {:.2} m/s",
            name(arm),
            crossing.miss_m * 1e3,
            crossing.speed_m_s
        ),
        TwoArmEvent::HitCup { arm, speed_m_s } => {
            format!("the ball hits the cup of {} with {speed_m_s:.2} m/s", name(arm))
        }
        TwoArmEvent::HitLink { arm, part, .. } => format!("the ball hits {} ({part})", name(arm)),
        TwoArmEvent::HitFloor => "the ball hits the floor".to_owned(),
        TwoArmEvent::Rests { arm } => format!("the ball rests in the cup of {}", name(arm)),
        TwoArmEvent::FellOut { arm } => format!("the ball has left the cup of {}", name(arm)),
        TwoArmEvent::Gripped { arm } => format!("{} grips the ball", name(arm)),
    }
}

/// Six numbers with commas between.
fn six(text: &str) -> Result<[f64; 6], String> {
    let numbers: Vec<f64> =
        text.split(',').map_while(|part| part.trim().parse().ok()).filter(|x: &f64| x.is_finite()).collect();
    let parts = text.split(',').count();
    <[f64; 6]>::try_from(numbers).ok().filter(|_| parts == 6).ok_or_else(|| "six finite numbers".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|s: &f64| (0.0..=86_400.0).contains(s));
    seconds.ok_or_else(|| "seconds from 0 to 86400".to_owned())
}
