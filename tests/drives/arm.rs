//! Drives of one family, each with an inertia of its own, and the controller, on one bus.

use firmware::Controller;
use firmware::authority::Seed;
use firmware::fault::{Cause, Fault as Latched};
use firmware::group::DriveGroup;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use hil_sim::bus::BusConfig;
use hil_sim::drive::bench::{Bench, ShaftMotor};
use hil_sim::fault::{Fault, FaultKind, IdFilter, Target, WireFault};
use hil_sim::participants::Solo;
use hil_sim::world::{Observer, World};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Frame, Id, Instant, bits};

use crate::rig::{HOST, PLAN_S, joint};

/// Frames on the bus and when each ended.
#[derive(Default)]
struct Log(Vec<(Instant, Frame)>);

impl Observer for Log {
    fn on_frame(&mut self, at: Instant, _: Option<usize>, frame: &Frame) {
        self.0.push((at, *frame));
    }
}

type Node<G> = Controller<RamStorage, Spline, G>;
type All<G, M> = (Bench<M>, Solo<Node<G>>);

/// `N` drives of one family.
pub(crate) struct Arm<G: DriveGroup<Packet = Frame>, M, const N: usize> {
    pub(crate) world: World<All<G, M>>,
    log: Log,
    pub(crate) period: Duration,
    /// Angle of a shaft by the drive that holds it.
    shaft_rad: fn(&M) -> f64,
    /// Angle of each shaft at each step of 1 ms.
    pub(crate) track: Vec<(Instant, [f64; N])>,
}

impl<G: DriveGroup<Packet = Frame>, M: ShaftMotor, const N: usize> Arm<G, M, N> {
    pub(crate) fn of(
        bus: BusConfig,
        settings: &Settings,
        group: G,
        bench: Bench<M>,
        shaft_rad: fn(&M) -> f64,
    ) -> Self {
        assert_eq!(settings.check(), Ok(()), "a controller would take others");
        let controller =
            Controller::with_group(RamStorage::new(), Spline::empty(), group, settings, Seed::FORESEEABLE);
        let world = World::new((bench, Solo::new("controller", controller)), bus, 1, Vec::new()).unwrap();
        Self { world, log: Log::default(), period: settings.cycle_period(), shaft_rad, track: Vec::new() }
    }

    pub(crate) fn now(&self) -> Instant {
        self.world.now()
    }

    pub(crate) fn controller(&self) -> &Node<G> {
        &self.world.participants().1.node
    }

    pub(crate) fn kind(&self) -> StateKind {
        self.controller().state().kind()
    }

    pub(crate) fn fault(&self) -> Option<Latched> {
        self.controller().state().fault()
    }

    pub(crate) fn drive<R>(&mut self, index: usize, act: impl FnOnce(&mut M, Instant) -> R) -> R {
        self.world.with_participants(|all, now| act(&mut all.0.motors_mut()[index], now)).unwrap()
    }

    pub(crate) fn shafts(&mut self) -> [f64; N] {
        let shaft_rad = self.shaft_rad;
        core::array::from_fn(|i| self.drive(i, |drive, _| shaft_rad(drive)))
    }

    /// A frame reaches the controller as if another node had sent it.
    pub(crate) fn forge(&mut self, frame: &Frame) {
        self.world.with_participants(|all, now| all.1.node.handle_packet(now, frame)).unwrap();
    }

    /// Frames of these ids suffer so from now on.
    pub(crate) fn wire(
        &mut self,
        kind: WireFault,
        filter: IdFilter,
        length: Duration,
        every: Option<Duration>,
    ) {
        let fault = Fault {
            label: "wire".to_owned(),
            kind: FaultKind::Wire(kind),
            target: Target::Bus,
            filter: Some(filter),
            start: self.now(),
            at: None,
            length: Some(length),
            every,
            probability: 1.0,
        };
        self.world.add_fault(fault).unwrap();
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
        assert!(done(self), "{:?}", self.controller().state());
    }

    pub(crate) fn run_to(&mut self, limit_ms: u64, kind: StateKind) {
        self.run_until(limit_ms, |rig| rig.kind() == kind);
    }

    pub(crate) fn order(&mut self, order: Order) -> Done {
        let taken = self.world.with_participants(|all, now| all.1.node.order(now, HOST, order)).unwrap();
        taken.unwrap()
    }

    /// Waits until a halted arm counts as standing, and clears the fault as a person does. Returns the fault.
    pub(crate) fn clear(&mut self) -> Latched {
        let fault = self.fault().unwrap();
        self.run_us(1_700_000);
        self.order(Order::ClearFault { code: fault.cause.code() });
        fault
    }

    pub(crate) fn stop_now(&mut self) {
        self.world.with_participants(|all, now| all.1.node.stop_now(now)).unwrap();
    }

    /// Arms the controller with a plan and starts it.
    pub(crate) fn run_file(&mut self, file: &[u8]) {
        for (i, piece) in file.chunks(256).enumerate() {
            let upload = |all: &mut All<G, M>, now| all.1.node.upload(now, HOST, 256 * i, piece).unwrap();
            self.world.with_participants(upload).unwrap();
        }
        let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
        self.order(Order::Commit(name));
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
            panic!("no offer")
        };
        self.run_us(60_000);
        self.order(Order::ArmConfirm { token, valid });
        self.run_us(60_000);
        self.order(Order::Run(name));
    }

    /// In the middle of the plan.
    pub(crate) fn in_plan(mut self) -> Self {
        self.run_us(400_000);
        assert_eq!(self.kind(), StateKind::Running, "{:?}", self.controller().state());
        self
    }

    /// Largest distance of each joint since `start` from where the plan that began then has it, rad.
    pub(crate) fn away_from(&self, start: Instant, planned_rad: impl Fn(usize, f64) -> f64) -> [f64; N] {
        core::array::from_fn(|i| {
            let since = self.track.iter().filter(|(at, _)| *at >= start);
            let away = since.map(|(at, q)| {
                let t_s = (at.as_secs_f64() - start.as_secs_f64()).min(PLAN_S);
                (q[i] - planned_rad(i, t_s)).abs()
            });
            away.fold(0.0, f64::max)
        })
    }

    /// The cause and the joint of the fault that ends the motion; it is noticed within so many periods.
    pub(crate) fn ends_with(&mut self, since: Instant, periods: u64, cause: Cause, index: usize) {
        self.run_until(700, |rig| rig.kind() != StateKind::Running);
        let took = self.now().saturating_since(since);
        assert!(took <= self.period * periods, "{took:?}");
        self.run_to(1_500, StateKind::Fault);
        let fault = self.fault().unwrap();
        assert_eq!((fault.cause, fault.joint), (cause, Some(joint(index))));
        // A halt is a fault at once; the ramps take 0.2 s.
        self.run_us(600_000);
    }

    pub(crate) fn refused(&mut self, cause: Cause, index: usize) {
        self.run_to(5_000, StateKind::Fault);
        let fault = self.fault().unwrap();
        assert_eq!((fault.cause, fault.joint), (cause, Some(joint(index))));
    }

    /// Frames since `from` with the time at which each ended.
    pub(crate) fn frames(&self, from: Instant, is_meant: impl Fn(&Frame) -> bool) -> Vec<(Instant, Frame)> {
        self.log.0.iter().filter(|(at, frame)| *at >= from && is_meant(frame)).copied().collect()
    }

    /// Bus load since `from` at 1 Mbit/s, with the largest possible number of stuff bits in each frame.
    pub(crate) fn load(&self, from: Instant) -> f64 {
        let bits = |(_, frame): &(Instant, Frame)| {
            let is_extended = matches!(frame.id(), Id::Extended(_));
            u64::from(bits::worst_case(is_extended, frame.data().len()).with_interframe_space())
        };
        let sent: u64 = self.frames(from, |_| true).iter().map(bits).sum();
        sent as f64 / self.now().saturating_since(from).as_micros() as f64
    }
}
