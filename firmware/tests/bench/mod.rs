//! Bench of the controller's tests: a CAN bus with bit times and arbitration, and drives. The drives are as simple
//! as possible, but they ramp, lag, quantise, answer late and stop by their watchdog. Written from the drive's
//! protocol. The simulator of the project is `hil-sim`; this bench only serves the tests of this package.

mod drive;
pub(crate) mod host;

use std::collections::VecDeque;

pub(crate) use drive::{BenchDrive, Wrong};

use firmware::Controller;
use firmware::authority::{Peer, Seed};
use firmware::events::PlanEvents;
use firmware::groups::powercube::PowerCubes;
use firmware::joints::PerJoint;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::{Knot, Spline};
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use protocol::cyphal::crc::Crc64;
use protocol::powercube::{
    AddressedRequest, Broadcast, CubeState, MotionCommand, Parameter, Request, SimpleCommand, Value,
};
use protocol::{Duration, Frame, Instant, JointIndex, Node};

/// The node that gives the orders.
pub(crate) const HOST: Peer = Peer::new(42);

/// Numerical Recipes' LCG: seeded, good enough for delays.
#[derive(Clone)]
pub(crate) struct Rng(pub u64);

impl Rng {
    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

/// Half a step of the encoder: a joint that stands outside its limits is held where it was measured.
const OUTSIDE_RAD: f32 = 2e-4;

/// Frame with the time of its end on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Logged {
    pub at: Instant,
    pub by_controller: bool,
    pub frame: Frame,
}

/// Options of a bench.
#[derive(Clone, Copy)]
pub(crate) struct Options {
    pub settings: Settings,
    pub answer_us: (u64, u64),
    pub homed: bool,
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { settings: Settings::powercube6(), answer_us: (100, 300), homed: true, seed: 1 }
    }
}

/// What is tested: the controller alone, or with its host link.
pub(crate) trait Controlled: Node {
    fn core(&self) -> &Controller<RamStorage, Spline, PowerCubes>;
    fn core_mut(&mut self) -> &mut Controller<RamStorage, Spline, PowerCubes>;
}

impl Controlled for Controller<RamStorage, Spline, PowerCubes> {
    fn core(&self) -> &Controller<RamStorage, Spline, PowerCubes> {
        self
    }
    fn core_mut(&mut self) -> &mut Controller<RamStorage, Spline, PowerCubes> {
        self
    }
}

pub(crate) struct Bench<C = Controller<RamStorage, Spline, PowerCubes>> {
    pub controller: Box<C>,
    pub drives: Vec<BenchDrive>,
    pub log: Vec<Logged>,
    pub now: u64,
    pub rng: Rng,
    pub heartbeat: bool,
    pub board_gripper: Vec<(u64, bool)>,
    pub bus_busy_us: u64,
    answer_us: (u64, u64),
    heartbeat_due: u64,
    from_controller: VecDeque<Frame>,
    /// Ready time and reply, per drive in order.
    from_drive: Vec<VecDeque<(u64, Frame)>>,
    /// Frames of another node.
    strangers: VecDeque<Frame>,
    on_bus: Option<(u64, Frame, Sender)>,
    /// Until then the controller's processor is busy with something else; frames and deadlines wait.
    held_until: u64,
    waiting: VecDeque<Frame>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Sender {
    Controller,
    Drive(usize),
    Stranger,
}

/// Bits on the wire with an average of stuffing, 1 µs each.
fn frame_us(frame: &Frame) -> u64 {
    let bits = if frame.is_extended() { 67 } else { 47 } + 8 * frame.data().len() as u64;
    bits + bits / 12
}

impl Bench {
    pub(crate) fn new(options: Options) -> Self {
        Self::with(Controller::new(RamStorage::new(), &options.settings, Seed::FORESEEABLE), options)
    }

    /// Started, all homed, at `q`.
    pub(crate) fn ready(options: Options, q: &[f64]) -> Self {
        let mut bench = Self::new(options);
        for (drive, &q) in bench.drives.iter_mut().zip(q) {
            drive.place(q);
        }
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
        assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
        // Everything read at least once.
        bench.run_for(60_000);
        bench
    }
}

impl<C: Controlled> Bench<C> {
    pub(crate) fn with(controller: C, options: Options) -> Self {
        let count = options.settings.joints as usize;
        let mut drives: Vec<BenchDrive> =
            (0..count).map(|i| BenchDrive::new(options.settings.joint.0[i].address as u8)).collect();
        if !options.homed {
            for drive in &mut drives {
                drive.state = CubeState::EMPTY;
            }
        }
        Self {
            controller: Box::new(controller),
            strangers: VecDeque::new(),
            from_drive: vec![VecDeque::new(); count],
            drives,
            log: Vec::new(),
            now: 0,
            rng: Rng(options.seed),
            heartbeat: true,
            board_gripper: Vec::new(),
            bus_busy_us: 0,
            answer_us: options.answer_us,
            heartbeat_due: 0,
            from_controller: VecDeque::new(),
            on_bus: None,
            held_until: 0,
            waiting: VecDeque::new(),
        }
    }

    /// The controller is not called for `us`. Then it gets the frames that have come, and after them its deadlines.
    pub(crate) fn hold_up(&mut self, us: u64) {
        self.held_until = self.now + us;
    }

    pub(crate) fn kind(&self) -> StateKind {
        self.controller.core().state().kind()
    }

    /// When the last heartbeat went out.
    pub(crate) fn last_heartbeat(&self) -> u64 {
        self.heartbeat_due.saturating_sub(20_000)
    }

    pub(crate) fn instant(&self) -> Instant {
        Instant::from_micros(self.now)
    }

    fn drain(&mut self) {
        let mut count = 0;
        while let Some(frame) = self.controller.poll_frame() {
            count += 1;
            assert!(count <= 24, "one call, {count} frames");
            self.check_invariants(&frame);
            self.from_controller.push_back(frame);
        }
        if let Some(level) = self.take_level() {
            self.board_gripper.push((self.now, level));
        }
        self.start_frame();
    }

    /// Conditions on every frame that the controller sends, in every test.
    fn check_invariants(&self, frame: &Frame) {
        if frame.is_extended() {
            return;
        }
        let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) else {
            assert!(Broadcast::decode(frame).is_ok(), "neither request nor broadcast: {frame}");
            return;
        };
        let settings = self.controller.core().settings();
        let joint = settings.joint_of(module).expect("a drive of the group");
        let limits = settings.joint.at(joint);
        let kind = self.kind();
        match request {
            Request::Move(motion) => {
                assert!(kind.may_move(), "motion in {kind:?}: {frame}");
                let MotionCommand::Ramp { target } = motion.command() else { panic!("only ramps: {frame}") };
                let q = limits.to_joint_rad(target.get());
                let drive = self.drives.iter().find(|drive| drive.module == module).unwrap();
                // Outside its limits a joint moves no further out, except for its braking way. Without a zero it
                // has no limits.
                let rests = (drive.q_gen + 0.5 * drive.v_gen * drive.v_gen.abs() / drive.a_ramp) as f32;
                let low = limits.q_min_rad.min(drive.q_gen as f32).min(rests) - OUTSIDE_RAD;
                let high = limits.q_max_rad.max(drive.q_gen as f32).max(rests) + OUTSIDE_RAD;
                let homed = drive.state.contains(CubeState::HOME_OK);
                assert!(!homed || (low..=high).contains(&q), "target {q} rad of joint {joint}");
            }
            Request::Set(Parameter::TargetVel, Value::F32(v)) => {
                assert!((0.0..=limits.v_max_rad_s).contains(&v), "speed {v} of joint {joint}");
            }
            Request::Set(Parameter::TargetAcc, Value::F32(a)) => {
                assert!((0.0..=limits.a_max_rad_s2).contains(&a), "acceleration {a} of joint {joint}");
            }
            Request::Simple(SimpleCommand::Home) => assert_eq!(kind, StateKind::Homing),
            _ => {}
        }
    }

    fn start_frame(&mut self) {
        if self.on_bus.is_some() {
            return;
        }
        let mut best: Option<(u32, Sender)> = None;
        let mut offer = |frame: Option<&Frame>, sender| {
            if let Some(key) = frame.map(Frame::arbitration_key)
                && best.is_none_or(|(least, _)| key < least)
            {
                best = Some((key, sender));
            }
        };
        offer(self.from_controller.front(), Sender::Controller);
        offer(self.strangers.front(), Sender::Stranger);
        for (i, queue) in self.from_drive.iter().enumerate() {
            let ready = queue.front().filter(|(ready, _)| *ready <= self.now);
            offer(ready.map(|(_, frame)| frame), Sender::Drive(i));
        }
        let Some((_, sender)) = best else { return };
        let frame = match sender {
            Sender::Controller => self.from_controller.pop_front(),
            Sender::Stranger => self.strangers.pop_front(),
            Sender::Drive(i) => self.from_drive[i].pop_front().map(|(_, frame)| frame),
        };
        let frame = frame.unwrap();
        let us = frame_us(&frame);
        self.bus_busy_us += us;
        self.on_bus = Some((self.now + us, frame, sender));
    }

    fn deliver(&mut self, frame: Frame, sender: Sender) {
        self.log.push(Logged { at: self.instant(), by_controller: sender == Sender::Controller, frame });
        let now = self.now;
        if sender != Sender::Controller {
            if now < self.held_until {
                self.waiting.push_back(frame);
            } else {
                self.controller.handle_frame(Instant::from_micros(now), &frame);
            }
            return;
        }
        for (i, drive) in self.drives.iter_mut().enumerate() {
            drive.advance(now);
            if drive.silent {
                continue;
            }
            if let Ok(broadcast) = Broadcast::decode(&frame) {
                drive.hear(now);
                drive.broadcast(now, broadcast);
                continue;
            }
            let Ok(request) = AddressedRequest::decode(&frame) else { continue };
            if request.module != drive.module {
                continue;
            }
            drive.hear(now);
            let delay = self.answer_us.0 + self.rng.below(self.answer_us.1 - self.answer_us.0 + 1);
            let earliest = self.from_drive[i].back().map_or(0, |(ready, _)| *ready);
            if let Some(reply) = drive.answer(now, request.request) {
                if drive.drop_replies > 0 {
                    drive.drop_replies -= 1;
                } else {
                    self.from_drive[i].push_back(((now + delay).max(earliest), reply.encode(drive.module)));
                }
            }
        }
    }

    /// One event; false if it would be after `end`.
    fn step(&mut self, end: u64) -> bool {
        let deadline = self.controller.poll_timeout().map_or(u64::MAX, Instant::as_micros);
        let deadline = deadline.max(self.now).max(self.held_until);
        let wake = if self.waiting.is_empty() { u64::MAX } else { self.held_until.max(self.now) };
        let bus = self.on_bus.map_or(u64::MAX, |(at, ..)| at);
        let ready = self.from_drive.iter().filter_map(|queue| queue.front().map(|(ready, _)| *ready)).min();
        let ready = if self.on_bus.is_some() { u64::MAX } else { ready.unwrap_or(u64::MAX).max(self.now) };
        let beat = if self.heartbeat { self.heartbeat_due.max(self.held_until) } else { u64::MAX };
        let next = deadline.min(bus).min(ready).min(beat).min(wake);
        if next > end {
            self.now = end;
            return false;
        }
        self.now = next;
        if wake == next
            && let Some(frame) = self.waiting.pop_front()
        {
            self.controller.handle_frame(Instant::from_micros(next), &frame);
        } else if beat == next {
            let at = self.instant();
            self.controller.core_mut().host_heartbeat(at, HOST);
            self.heartbeat_due = next + 20_000;
        } else if bus == next {
            let (_, frame, sender) = self.on_bus.take().unwrap();
            self.deliver(frame, sender);
        } else if deadline == next {
            let before = self.instant();
            self.controller.handle_timeout(before);
            let after = self.controller.poll_timeout().unwrap();
            assert!(
                after > before,
                "deadline {after} stuck at {before}: {:?}",
                self.controller.core().state()
            );
        }
        self.drain();
        true
    }

    pub(crate) fn run_for(&mut self, us: u64) {
        let end = self.now + us;
        while self.step(end) {}
        for drive in &mut self.drives {
            drive.advance(self.now);
        }
    }

    pub(crate) fn run_until(&mut self, us: u64, done: impl Fn(&Self) -> bool) {
        let end = self.now + us;
        while !done(self) && self.step(end) {}
        for drive in &mut self.drives {
            drive.advance(self.now);
        }
    }

    pub(crate) fn order(&mut self, order: Order) -> Result<Done, firmware::fault::Refusal> {
        self.order_of(HOST, order)
    }

    /// Order of a certain node.
    pub(crate) fn order_of(&mut self, peer: Peer, order: Order) -> Result<Done, firmware::fault::Refusal> {
        let outcome = {
            let at = self.instant();
            self.controller.core_mut().order(at, peer, order)
        };
        self.drain();
        outcome
    }

    pub(crate) fn stop_now(&mut self) {
        let at = self.instant();
        self.controller.core_mut().stop_now(at);
        self.drain();
    }

    pub(crate) fn upload(&mut self, file: &[u8]) -> FileName {
        for (i, piece) in file.chunks(256).enumerate() {
            let at = self.instant();
            self.controller.core_mut().upload(at, HOST, 256 * i, piece).unwrap();
        }
        let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
        self.order(Order::Commit(name)).unwrap();
        name
    }

    pub(crate) fn arm(&mut self, name: FileName) {
        let valid = Duration::from_secs(10);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid }).unwrap()
        else {
            panic!("no offer")
        };
        self.run_for(60_000);
        self.order(Order::ArmConfirm { token, valid }).unwrap();
        self.run_for(60_000);
    }

    /// Armed and started.
    pub(crate) fn start(&mut self, file: &[u8]) -> FileName {
        let name = self.upload(file);
        self.arm(name);
        self.order(Order::Run(name)).unwrap();
        name
    }

    fn take_level(&mut self) -> Option<bool> {
        // With a host link the board's output is not read.
        if self.heartbeat { self.controller.core_mut().take_gripper_level() } else { None }
    }

    /// Another node sends a frame to the bus.
    pub(crate) fn foreign(&mut self, frame: Frame) {
        self.strangers.push_back(frame);
        self.start_frame();
    }

    /// A frame of another node reaches the controller now.
    pub(crate) fn inject(&mut self, frame: &Frame) {
        self.log.push(Logged { at: self.instant(), by_controller: false, frame: *frame });
        self.controller.handle_frame(self.instant(), frame);
        self.drain();
    }

    /// Time at which a state was left after `at`, from the trace.
    pub(crate) fn left(&self, state: StateKind, after: u64) -> Option<u64> {
        let mut entries = self.controller.core().trace().iter().filter_map(|(at, event)| match event {
            firmware::trace::TraceEvent::State { from, .. } if from == state => Some(at.as_micros()),
            _ => None,
        });
        entries.find(|at| *at >= after)
    }

    /// Largest distance of the joints from the nearest point of the throw's path, rad.
    pub(crate) fn distance_from_path(&self) -> f64 {
        let distance = |t: f64| {
            let each =
                self.drives.iter().enumerate().map(|(i, drive)| (drive.q - throw_reference(i, t).0).abs());
            each.fold(0.0, f64::max)
        };
        (0..=920).map(|ms| distance(f64::from(ms) * 1e-3)).fold(f64::INFINITY, f64::min)
    }

    /// Frames of the controller after a time that satisfy a predicate.
    pub(crate) fn sent_after(&self, at: u64, is: impl Fn(&Frame) -> bool) -> Option<Instant> {
        self.log.iter().find(|l| l.by_controller && l.at.as_micros() > at && is(&l.frame)).map(|l| l.at)
    }

    pub(crate) fn count_sent(&self, is: impl Fn(&Frame) -> bool) -> usize {
        self.log.iter().filter(|l| l.by_controller && is(&l.frame)).count()
    }
}

#[must_use]
pub(crate) fn is_halt(frame: &Frame) -> bool {
    Broadcast::decode(frame) == Ok(Broadcast::Halt)
}

pub(crate) fn is_motion(frame: &Frame) -> bool {
    matches!(AddressedRequest::decode(frame), Ok(AddressedRequest { request: Request::Move(_), .. }))
}

pub(crate) fn joint(index: usize) -> JointIndex {
    JointIndex::new(index).unwrap()
}

/// The published throw (`robot-models` 1.6): position and velocity at release, before and after times.
pub(crate) const Q_RELEASE: [f64; 6] = [0.199_999, 0.125_428, -1.856_562, 1.004_064, 1.387_908, 1.654_417];
pub(crate) const QD_RELEASE: [f64; 6] = [1.358_402, -1.675_786, 0.482_325, -0.010_697, -0.986_023, 2.548_397];
pub(crate) const HA: f64 = 0.920 * (1.0 - 0.391);
pub(crate) const HB: f64 = 0.920 * 0.391;

pub(crate) fn throw_start() -> [f64; 6] {
    core::array::from_fn(|i| Q_RELEASE[i] - 2.0 / 3.0 * QD_RELEASE[i] * HA)
}

/// Reference of the throw in double precision, from the closed form, s seconds after its start.
pub(crate) fn throw_reference(i: usize, t: f64) -> (f64, f64) {
    let (s, qd) = (t.clamp(0.0, HA + HB) - HA, QD_RELEASE[i]);
    let h = if s < 0.0 { HA } else { HB };
    (Q_RELEASE[i] + qd * (s - s * s * s / (3.0 * h * h)), qd * (1.0 - s * s / (h * h)))
}

pub(crate) fn throw_file(period_us: u32, release: bool) -> Vec<u8> {
    throw_file_of(0, period_us, release)
}

/// The throw, planned for a certain robot.
pub(crate) fn throw_file_of(robot_crc32: u32, period_us: u32, release: bool) -> Vec<u8> {
    let (a_us, knots) = throw_knots();
    let events = PlanEvents::release(release.then_some(a_us));
    file(&Header { joints: 6, period_us, events, robot_crc32, ..Header::default() }, &knots)
}

/// Knots of the throw, and the time of its release, µs.
pub(crate) fn throw_knots() -> (u32, [Knot; 3]) {
    let (a_us, b_us) = ((HA * 1e6).round() as u32, (HB * 1e6).round() as u32);
    let knot = |t_us, f: &dyn Fn(usize) -> (f64, f64)| {
        let mut state = PerJoint::default();
        for i in 0..6 {
            let (q, qd) = f(i);
            state.set(joint(i), (q as f32, qd as f32));
        }
        Knot { t_us, state }
    };
    let knots = [
        knot(0, &|i| (Q_RELEASE[i] - 2.0 / 3.0 * QD_RELEASE[i] * HA, 0.0)),
        knot(a_us, &|i| (Q_RELEASE[i], QD_RELEASE[i])),
        knot(a_us + b_us, &|i| (Q_RELEASE[i] + 2.0 / 3.0 * QD_RELEASE[i] * HB, 0.0)),
    ];
    (a_us, knots)
}

pub(crate) fn file(header: &Header, knots: &[Knot]) -> Vec<u8> {
    let mut out = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(header, knots, &mut out).unwrap();
    out.truncate(len);
    out
}
