//! Six CANopen servos, each with an inertia of its own, and the controller, on one bus of 1 Mbit/s.

use canopen_protocol::{Function, NodeId};
use firmware::Controller;
use firmware::authority::Seed;
use firmware::fault::Fault as Latched;
use firmware::groups::cia402::{Cia402, Home, Options, Servo};
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use hil_sim::bus::BusConfig;
use hil_sim::drive::bench::Bench;
use hil_sim::drive::cia402::{CanopenServo, ServoOptions};
use hil_sim::participants::Solo;
use hil_sim::world::{Observer, World};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use crate::rig::{HOST, plan_file, quintic};

pub(crate) const JOINTS: usize = 6;
pub(crate) const PERIOD_US: u64 = 2_000;
pub(crate) const TIME_OUT_US: u32 = 30_000;
/// At each shaft.
const INERTIA_KG_M2: f64 = 0.2;

type Node = Controller<RamStorage, Spline, Cia402>;
type All = (Bench<CanopenServo>, Solo<Node>);

pub(crate) fn node(index: usize) -> NodeId {
    NodeId::new(index as u8 + 3).unwrap()
}

/// Where a shaft stands at first, rad.
pub(crate) fn stands_rad(index: usize) -> f64 {
    0.05 * index as f64
}

pub(crate) fn settings() -> Settings {
    let mut settings = Settings::powercube6();
    settings.cycle_period_us = PERIOD_US as u32;
    settings.gains_period_us = PERIOD_US as u32;
    (settings.gains_delay_min_us, settings.gains_delay_max_us) = (PERIOD_US as u32, PERIOD_US as u32);
    settings.watchdog_timeout_us = TIME_OUT_US;
    settings.watchdog_refresh_us = 10_000;
    for joint in JointIndex::first(JOINTS) {
        let limits = settings.joint.at_mut(joint);
        (limits.q_min_rad, limits.q_max_rad) = (-2.0, 2.0);
    }
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    settings
}

/// Frames on the bus and when each ended.
#[derive(Default)]
struct Log(Vec<(Instant, Frame)>);

impl Observer for Log {
    fn on_frame(&mut self, at: Instant, _: Option<usize>, frame: &Frame) {
        self.0.push((at, *frame));
    }
}

pub(crate) struct Rig {
    world: World<All>,
    log: Log,
    /// Angle of each shaft at each step of 1 ms.
    pub(crate) track: Vec<(Instant, [f64; JOINTS])>,
}

impl Rig {
    pub(crate) fn with(settings: &Settings, home: Home, change: impl Fn(usize, &mut ServoOptions)) -> Self {
        assert_eq!(settings.check(), Ok(()), "a controller would take others");
        let options: [ServoOptions; JOINTS] = core::array::from_fn(|i| {
            let mut options = ServoOptions::of(node(i));
            change(i, &mut options);
            options
        });
        let servos: [Servo; JOINTS] = core::array::from_fn(|i| Servo {
            node: node(i),
            counts_per_turn: 409_600,
            rated_mnm: 50_000,
            home,
        });
        let group = Cia402::new(Options::new(&servos).unwrap());
        let controller =
            Controller::with_group(RamStorage::new(), Spline::empty(), group, settings, Seed::FORESEEABLE);
        let servos =
            options.iter().enumerate().map(|(i, options)| CanopenServo::new(*options, stands_rad(i)));
        let bench = Bench::new(servos.collect(), INERTIA_KG_M2);
        let node = Solo::new("controller", controller);
        let world = World::new((bench, node), BusConfig::default(), 1, Vec::new()).unwrap();
        Self { world, log: Log::default(), track: Vec::new() }
    }

    pub(crate) fn new() -> Self {
        Self::with(&settings(), Home::Absolute, |_, _| {})
    }

    pub(crate) fn now(&self) -> Instant {
        self.world.now()
    }

    pub(crate) fn controller(&self) -> &Node {
        &self.world.participants().1.node
    }

    pub(crate) fn kind(&self) -> StateKind {
        self.controller().state().kind()
    }

    pub(crate) fn fault(&self) -> Option<Latched> {
        self.controller().state().fault()
    }

    pub(crate) fn servo<R>(&mut self, index: usize, act: impl FnOnce(&mut CanopenServo, Instant) -> R) -> R {
        self.world.with_participants(|all, now| act(&mut all.0.motors_mut()[index], now)).unwrap()
    }

    pub(crate) fn shafts(&mut self) -> [f64; JOINTS] {
        core::array::from_fn(|i| self.servo(i, |servo, _| servo.shaft_rad()))
    }

    /// A frame reaches the controller as if another node had sent it.
    pub(crate) fn forge(&mut self, frame: &Frame) {
        self.world.with_participants(|all, now| all.1.node.handle_packet(now, frame)).unwrap();
    }

    pub(crate) fn run_us(&mut self, us: u64) {
        let end = self.now() + Duration::from_micros(us);
        while self.now() < end {
            self.world.with_participants(|all, now| all.1.node.host_heartbeat(now, HOST)).unwrap();
            let until = end.min(self.now() + Duration::from_millis(1));
            self.world.run_until(until, &mut self.log).unwrap();
            let shafts = self.shafts();
            self.track.push((self.now(), shafts));
        }
    }

    pub(crate) fn run_until(&mut self, limit_ms: u64, done: impl Fn(&Self) -> bool) {
        for _ in 0..limit_ms {
            if done(self) {
                return;
            }
            self.run_us(1_000);
        }
        assert!(
            done(self),
            "{:?} {:?}",
            self.controller().state(),
            self.controller().group().mismatch().map(|(joint, m)| (joint.get(), m.to_string()))
        );
    }

    pub(crate) fn run_to(&mut self, limit_ms: u64, kind: StateKind) {
        self.run_until(limit_ms, |rig| rig.kind() == kind);
    }

    pub(crate) fn order(&mut self, order: Order) -> Done {
        let taken = self.world.with_participants(|all, now| all.1.node.order(now, HOST, order)).unwrap();
        taken.unwrap()
    }

    /// The latched fault; the time until a halted arm counts as standing has passed, and a person clears it.
    pub(crate) fn clear(&mut self) -> Latched {
        let fault = self.fault().unwrap();
        self.run_us(1_700_000);
        self.order(Order::ClearFault { code: fault.cause.code() });
        fault
    }

    pub(crate) fn stop_now(&mut self) {
        self.world.with_participants(|all, now| all.1.node.stop_now(now)).unwrap();
    }

    /// Found, and all joints at home.
    pub(crate) fn ready() -> Self {
        let mut rig = Self::new();
        rig.run_to(1_500, StateKind::Idle);
        rig.order(Order::Home { mask: 0x3F });
        rig.run_to(1_500, StateKind::Ready);
        rig
    }

    /// Armed with the plan and started; when the plan begins.
    pub(crate) fn start(&mut self) -> Instant {
        let file = plan_file(JOINTS, PERIOD_US as u32, stands_rad);
        for (i, piece) in file.chunks(256).enumerate() {
            let upload = |all: &mut All, now| all.1.node.upload(now, HOST, 256 * i, piece).unwrap();
            self.world.with_participants(upload).unwrap();
        }
        let name = FileName { crc64: Crc64::of(&file), len: file.len() as u32 };
        self.order(Order::Commit(name));
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
            panic!("no offer")
        };
        self.run_us(60_000);
        self.order(Order::ArmConfirm { token, valid });
        self.run_us(60_000);
        self.order(Order::Run(name));
        self.now() + Duration::from_micros(3 * PERIOD_US)
    }

    /// In the middle of the plan.
    pub(crate) fn moving() -> Self {
        let mut rig = Self::ready();
        rig.start();
        rig.run_us(400_000);
        assert_eq!(rig.kind(), StateKind::Running, "{:?}", rig.controller().state());
        rig
    }

    /// Where the plan has a joint, rad.
    pub(crate) fn planned_rad(index: usize, t_s: f64) -> f64 {
        stands_rad(index) + quintic(index, t_s).0
    }

    /// Frames for `function` since `from`, with the time at which each ended.
    pub(crate) fn frames(&self, function: Function, from: Instant) -> Vec<(Instant, Frame)> {
        let is_own = |frame: &Frame| Function::of_frame(frame) == Some(function);
        self.log.0.iter().filter(|(at, frame)| *at >= from && is_own(frame)).copied().collect()
    }

    /// Control words and targets of a servo since `from`.
    pub(crate) fn targets(&self, index: usize, from: Instant) -> Vec<(Instant, u16, f64)> {
        let words = self.frames(Function::Rpdo(1, node(index)), from).into_iter();
        words
            .map(|(at, frame)| {
                let [a, b, c, d, e, f] = *frame.data().first_chunk::<6>().unwrap();
                let counts = i32::from_le_bytes([c, d, e, f]);
                (at, u16::from_le_bytes([a, b]), f64::from(counts) * std::f64::consts::TAU / 409_600.0)
            })
            .collect()
    }

    /// Share of the time since `from` for which the bus is busy, with stuff bits at their most.
    pub(crate) fn load(&self, from: Instant) -> f64 {
        let bits = |frame: &Frame| {
            let (head, len) = if matches!(frame.id(), Id::Standard(_)) { (47, 33) } else { (67, 53) };
            let bytes = 8 * frame.data().len() as u64;
            head + bytes + (len + bytes) / 4
        };
        let sent: u64 = self.log.0.iter().filter(|(at, _)| *at >= from).map(|(_, frame)| bits(frame)).sum();
        sent as f64 / self.now().saturating_since(from).as_micros() as f64
    }
}
