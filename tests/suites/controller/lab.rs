//! The controller in the simulated cell, in the hands of a test; what it does is watched from the bus.

use std::borrow::Cow;
use std::collections::VecDeque;

use cell_tests::published_throw;
use firmware::Controller;
use firmware::authority::{Peer, Seed};
use firmware::fault::Refusal;
use firmware::groups::powercube::PowerCubes;
use firmware::orders::{Done, Order};
use firmware::registers::Number;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use hil_sim::bus::BusConfig;
use hil_sim::checker::Checkers;
use hil_sim::mechanics::Scatter;
use hil_sim::participants::Participants;
use hil_sim::scenario::Expect;
use hil_sim::scenario::build::limits_of;
use hil_sim::world::{Observer, World};
use hil_sim::{Cell, CellOptions};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Frame, Id, Instant, Node};
use robot_model::RobotModel;

/// The controller, and a node that only sends what it is given.
pub(crate) struct ControllerPort(Box<Controller<RamStorage, Spline, PowerCubes>>, Stranger);

/// Somebody else on the bus.
#[derive(Default)]
pub(crate) struct Stranger(VecDeque<Frame>);

impl Node for Stranger {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        self.0.pop_front()
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl Participants for ControllerPort {
    fn len(&self) -> usize {
        2
    }
    fn node(&mut self, index: usize) -> &mut dyn Node {
        if index == 0 { &mut *self.0 } else { &mut self.1 }
    }
    fn name(&self, index: usize) -> Cow<'_, str> {
        if index == 0 { "controller".into() } else { "stranger".into() }
    }
}

/// The simulator's checkers, and whether anything gets an order to move that must not. Reads bytes, not the codec that the
/// controller uses.
pub(crate) struct Watch {
    checkers: Checkers,
    /// A motion is due: set by whoever orders one.
    pub(crate) allowed: bool,
    halted: bool,
    /// First halt broadcast since the flag was taken, end of its frame.
    pub(crate) halt_at: Option<Instant>,
    /// First sign of life to the drives since the flag was taken, end of its frame.
    pub(crate) life_at: Option<Instant>,
    pub(crate) motions: u32,
    pub(crate) forbidden: Vec<String>,
}

impl Observer for Watch {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        self.checkers.on_frame(at, from, frame);
        let Id::Standard(id) = frame.id() else { return };
        match (id.get(), frame.data().first()) {
            (0x100, Some(0x02)) => {
                self.halted = true;
                self.halt_at = self.halt_at.or(Some(at));
            }
            (0x100, Some(0x07)) => self.life_at = self.life_at.or(Some(at)),
            (0x100, Some(0x00)) => self.halted = false,
            // SET MOTION to any module.
            (0x0E0..=0x0FF, Some(0x0B)) => {
                self.motions += 1;
                if self.halted || !self.allowed {
                    self.forbidden.push(format!("{at}: {frame}, halted {}", self.halted));
                }
            }
            _ => {}
        }
    }
}

/// What the cell is like.
#[derive(Clone, Copy)]
pub(crate) struct Situation {
    /// Start beside the path, rad, all joints.
    pub(crate) offset_rad: f64,
    /// Answer time of the drives and how far it varies, µs.
    pub(crate) answer_us: (u64, u64),
    pub(crate) scatter: Scatter,
    pub(crate) seed: u64,
}

impl Situation {
    /// The nominal cell: answers after 200 ± 100 µs.
    pub(crate) fn nominal(seed: u64) -> Self {
        Self { offset_rad: 0.0, answer_us: (200, 100), scatter: Scatter::default(), seed }
    }
}

/// The node that gives the orders.
pub(crate) const HOST: Peer = Peer::new(42);

pub(crate) struct Lab {
    pub(crate) world: World<(Cell, ControllerPort)>,
    pub(crate) watch: Watch,
    pub(crate) heartbeat: bool,
    beat: Instant,
}

impl Lab {
    pub(crate) fn new(settings: &Settings, situation: &Situation) -> Self {
        let robot = RobotModel::load("powercube6").unwrap();
        let arm = &robot;
        let mut options = CellOptions::default();
        options.drive.starts_homed = true;
        let (answer_us, jitter_us) = situation.answer_us;
        options.drive.processing_delay = Duration::from_micros(answer_us);
        options.drive.processing_jitter = Duration::from_micros(jitter_us);
        options.gripper.jitter = Duration::ZERO;
        options.scatter = situation.scatter;
        options.start_q_rad =
            Some(published_throw::start_rad().iter().map(|q| q + situation.offset_rad).collect());
        let cell = Cell::new(&robot, &options, situation.seed).unwrap();
        let mut limits = limits_of(&cell);
        for (limit, joint) in limits.iter_mut().zip(arm.joints()) {
            limit.a_max_rad_s2 = joint.limits.a_control_max_rad_s2;
        }
        let expect = Expect {
            limits: true,
            homing: true,
            stop_within: Some(Duration::from_millis(400)),
            ..Expect::default()
        };
        let host_node = ControllerPort(
            Box::new(Controller::new(RamStorage::new(), settings, Seed::FORESEEABLE)),
            Stranger::default(),
        );
        let config = BusConfig::default();
        let watch = Watch {
            checkers: Checkers::new(&expect, &limits, &config),
            allowed: false,
            halted: false,
            halt_at: None,
            life_at: None,
            motions: 0,
            forbidden: Vec::new(),
        };
        let world = World::new((cell, host_node), config, situation.seed, Vec::new()).unwrap();
        Self { world, watch, heartbeat: true, beat: Instant::ZERO }
    }

    pub(crate) fn run(&mut self, us: u64) {
        let end = self.world.now() + Duration::from_micros(us);
        while self.world.now() < end {
            if self.world.now() >= self.beat {
                self.beat = self.world.now() + Duration::from_millis(20);
                if self.heartbeat {
                    self.world
                        .with_participants(|participants, now| participants.1.0.host_heartbeat(now, HOST))
                        .unwrap();
                }
            }
            self.world.run_until(end.min(self.beat), &mut self.watch).unwrap();
        }
    }

    pub(crate) fn try_order(&mut self, order: Order) -> Result<Done, Refusal> {
        self.world.with_participants(|participants, now| participants.1.0.order(now, HOST, order)).unwrap()
    }

    pub(crate) fn order(&mut self, order: Order) -> Done {
        self.try_order(order).unwrap_or_else(|refusal| panic!("{order:?}: {refusal:?}"))
    }

    pub(crate) fn stop_now(&mut self) {
        self.world.with_participants(|participants, now| participants.1.0.stop_now(now)).unwrap();
    }

    /// A frame of somebody else wants to the bus now.
    pub(crate) fn foreign(&mut self, frame: Frame) {
        self.world.with_participants(|participants, _| participants.1.1.0.push_back(frame)).unwrap();
    }

    pub(crate) fn controller(&self) -> &Controller<RamStorage, Spline, PowerCubes> {
        &self.world.participants().1.0
    }

    pub(crate) fn kind(&self) -> StateKind {
        self.controller().state().kind()
    }

    pub(crate) fn write(&mut self, name: &str, numbers: &[Number]) -> Result<(), Refusal> {
        self.world
            .with_participants(|participants, now| participants.1.0.write_register(now, HOST, name, numbers))
            .unwrap()
    }

    pub(crate) fn upload(&mut self, file: &[u8]) {
        self.world
            .with_participants(|participants, now| participants.1.0.upload(now, HOST, 0, file))
            .unwrap()
            .unwrap();
    }

    /// Runs until the group is ready and every drive was read.
    pub(crate) fn wait_ready(&mut self) {
        for _ in 0..300 {
            if self.kind() == StateKind::Ready {
                break;
            }
            self.run(10_000);
        }
        assert_eq!(self.kind(), StateKind::Ready, "{:?}", self.controller().state());
        self.run(60_000);
    }

    /// Ready, uploaded, offered; the file and the token.
    fn offered(&mut self, file: &[u8]) -> (FileName, u32) {
        self.wait_ready();
        self.upload(file);
        let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
        self.order(Order::Commit(name));
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
            panic!("no offer")
        };
        self.run(60_000);
        (name, token)
    }

    /// Ready, uploaded, armed, started; the time at which the plan begins.
    ///
    /// # Errors
    ///
    /// Why the group was not armed, or not started.
    pub(crate) fn try_start(&mut self) -> Result<Instant, Refusal> {
        let period_us = self.controller().settings().cycle_period_us;
        self.try_start_file(&published_throw::file(period_us))
    }

    /// As [`Self::try_start`], with another file.
    pub(crate) fn try_start_file(&mut self, file: &[u8]) -> Result<Instant, Refusal> {
        let period_us = self.controller().settings().cycle_period_us;
        let (name, token) = self.offered(file);
        self.try_order(Order::ArmConfirm { token, valid: Duration::from_secs(5) })?;
        self.run(60_000);
        self.watch.allowed = true;
        self.try_order(Order::Run(name))?;
        Ok(self.world.now() + Duration::from_micros(2 * u64::from(period_us)))
    }

    /// As [`Self::try_start`], which must come to its end.
    pub(crate) fn start(&mut self) -> Instant {
        self.try_start().unwrap_or_else(|refusal| panic!("{refusal:?}"))
    }

    /// What the checkers found, as text; empty if all was well.
    pub(crate) fn findings(&mut self) -> Vec<String> {
        let end = self.world.now();
        let mut found = std::mem::take(&mut self.watch.forbidden);
        for result in self.watch.checkers.finish(end, &Expect::default()) {
            found.extend(result.first.iter().map(ToString::to_string));
        }
        found
    }
}
