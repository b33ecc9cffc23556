//! Seven motors of an OpenArm, each with an inertia of its own, and the controller, on one bus of 1 Mbit/s.

use firmware::authority::Peer;
use firmware::events::PlanEvents;
use firmware::groups::mit::{Mit, Motor, Options};
use firmware::joints::PerJoint;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::spline::Knot;
use firmware::state::StateKind;
use firmware::trajectory_format::{self, FILE_LEN_MAX, Header};
use hil_sim::bus::BusConfig;
use hil_sim::drive::bench::Bench;
use hil_sim::drive::mit::{MitMotor, MitOptions};
use hil_sim::fault::{IdFilter, WireFault};
use protocol::mit::{Command, Mit as SetPoint, MotorId, Ranges};
use protocol::{Duration, Id, Instant, JointIndex, StandardId};

use crate::arm::Arm;

pub(crate) const JOINTS: usize = 7;
pub(crate) const PERIOD_US: u64 = 3_000;
pub(crate) const TIME_OUT_US: u32 = 15_000;
pub(crate) const KP_NM_RAD: f32 = 100.0;
pub(crate) const KD_NM_S_RAD: f32 = 5.0;
/// At each shaft. With the gains above: 32 rad/s, damping 0.79.
const INERTIA_KG_M2: f64 = 0.1;
pub(crate) const TYPES: [&str; JOINTS] = ["8009", "8009", "4340", "4340", "4310", "4310", "4310"];
pub(crate) const HOST: Peer = Peer::new(42);

pub(crate) fn joint(index: usize) -> JointIndex {
    JointIndex::new(index).unwrap()
}

pub(crate) fn id(index: usize) -> MotorId {
    MotorId::new(index as u8 + 1).unwrap()
}

pub(crate) fn master(index: usize) -> StandardId {
    StandardId::new(0x11 + index as u16).unwrap()
}

pub(crate) fn ranges(index: usize) -> Ranges {
    MitOptions::of(TYPES[index], id(index), master(index)).unwrap().motor.ranges
}

pub(crate) fn motors() -> [Motor; JOINTS] {
    core::array::from_fn(|i| Motor {
        id: id(i),
        master: master(i),
        ranges: ranges(i),
        kp_nm_rad: KP_NM_RAD,
        kd_nm_s_rad: KD_NM_S_RAD,
    })
}

/// Gains of the arm of PowerCubes: the set points are as fast as its ramps.
pub(crate) fn settings() -> Settings {
    let mut settings = Settings::powercube6();
    settings.joints = JOINTS as u32;
    settings.watchdog_timeout_us = TIME_OUT_US;
    settings.watchdog_refresh_us = 5_000;
    for joint in JointIndex::first(JOINTS) {
        let limits = settings.joint.at_mut(joint);
        (limits.q_min_rad, limits.q_max_rad) = (-2.0, 2.0);
    }
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    settings
}

pub(crate) type Rig = Arm<Mit, MitMotor, JOINTS>;

impl Rig {
    /// Motors on classical CAN that stand at `zero_rad` with changed options.
    pub(crate) fn with(settings: &Settings, change: impl Fn(usize, &mut MitOptions)) -> Self {
        Self::on(BusConfig::default(), settings, change)
    }

    /// Motors on a bus; with a data rate the group speaks CAN FD.
    pub(crate) fn on(bus: BusConfig, settings: &Settings, change: impl Fn(usize, &mut MitOptions)) -> Self {
        let options: [MitOptions; JOINTS] = core::array::from_fn(|i| {
            let mut options = MitOptions::of(TYPES[i], id(i), master(i)).unwrap();
            change(i, &mut options);
            options
        });
        let group = Options::new(&motors()).unwrap();
        let group = Mit::new(match bus.data_bit_rate_bit_s {
            Some(bit_s) => group.with_fd(bit_s).unwrap(),
            None => group,
        });
        let motors = options.map(|o| MitMotor::new(o, o.zero_rad)).to_vec();
        Self::of(bus, settings, group, Bench::new(motors, INERTIA_KG_M2), MitMotor::shaft_rad)
    }

    pub(crate) fn new() -> Self {
        Self::with(&settings(), |_, _| {})
    }

    pub(crate) fn motor<R>(&mut self, index: usize, act: impl FnOnce(&mut MitMotor) -> R) -> R {
        self.drive(index, |motor, _| act(motor))
    }

    /// Answers of a motor reach the controller so much later for some milliseconds in each 60.
    pub(crate) fn delay_answers(&mut self, index: usize, by: Duration, length: Duration) {
        let filter = IdFilter { id: Id::Standard(master(index)), mask: 0x7FF };
        self.wire(WireFault::Delay(by), filter, length, Some(Duration::from_millis(60)));
    }

    /// No command reaches a motor.
    pub(crate) fn cut_commands(&mut self, length: Duration) {
        let filter = IdFilter { id: Id::Standard(StandardId::ZERO), mask: 0x7F8 };
        self.wire(WireFault::Drop, filter, length, None);
    }

    /// Found, and all joints at home.
    pub(crate) fn ready() -> Self {
        Self::new().made_ready()
    }

    /// See [`Self::ready`].
    pub(crate) fn made_ready(mut self) -> Self {
        self.run_to(500, StateKind::Idle);
        self.order(Order::Home { mask: 0x7F });
        self.run_to(1_000, StateKind::Ready);
        self
    }

    /// Starts a plan; when it begins.
    pub(crate) fn start(&mut self, file: &[u8]) -> Instant {
        self.run_file(file);
        self.now() + self.period * 2
    }

    /// In the middle of [`quintic`].
    pub(crate) fn moving() -> Self {
        let mut rig = Self::ready();
        rig.start(&quintic_file());
        rig.in_plan()
    }

    /// Commands to a motor since `from`, with the time at which the frame ended.
    pub(crate) fn commands(&self, index: usize, from: Instant) -> Vec<(Instant, Command)> {
        let own = Id::Standard(StandardId::new(u16::from(id(index).get())).unwrap());
        let sent = self.frames(from, |frame| frame.id() == own).into_iter();
        sent.map(|(at, frame)| (at, Command::decode(&frame, &ranges(index)).unwrap().1)).collect()
    }

    pub(crate) fn set_points(&self, index: usize, from: Instant) -> Vec<(Instant, SetPoint)> {
        let commands = self.commands(index, from).into_iter();
        commands
            .filter_map(|(at, c)| if let Command::Mit(mit) = c { Some((at, mit)) } else { None })
            .collect()
    }

    /// Time during which the bus was taken, and during which it carried errors.
    pub(crate) fn busy(&self) -> (Duration, Duration) {
        let bus = self.world.bus();
        (Duration::from_micros(bus.busy_ns() / 1_000), Duration::from_micros(bus.error_ns() / 1_000))
    }
}

/// Length of the plan, s, and how far each joint goes, rad.
pub(crate) const PLAN_S: f64 = 1.0;
pub(crate) const WAY_RAD: [f64; JOINTS] = [1.0, -1.0, 0.8, 0.9, -0.7, 0.6, 1.0];

/// Position and velocity of a joint, from rest to rest.
pub(crate) fn quintic(index: usize, t_s: f64) -> (f64, f64) {
    let s = (t_s / PLAN_S).clamp(0.0, 1.0);
    let way = WAY_RAD[index];
    (way * s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s), way / PLAN_S * 30.0 * s * s * (1.0 - s).powi(2))
}

pub(crate) fn quintic_file() -> Vec<u8> {
    plan_file(JOINTS, PERIOD_US as u32, |_| 0.0)
}

/// [`quintic`] of so many joints, from where each stands.
pub(crate) fn plan_file(joints: usize, period_us: u32, stands_rad: impl Fn(usize) -> f64) -> Vec<u8> {
    let knots: Vec<Knot> = (0..=40)
        .map(|k| {
            let t_s = PLAN_S * f64::from(k) / 40.0;
            let mut state = PerJoint::default();
            for i in 0..joints {
                let (q, qd) = quintic(i, t_s);
                state.set(joint(i), ((q + stands_rad(i)) as f32, qd as f32));
            }
            Knot { t_us: (t_s * 1e6) as u32, state }
        })
        .collect();
    let header = Header {
        joints: joints as u8,
        period_us,
        events: PlanEvents::release(None),
        robot_crc32: 0,
        ..Header::default()
    };
    let mut file = vec![0; FILE_LEN_MAX];
    let len = trajectory_format::encode(&header, &knots, &mut file).unwrap();
    file.truncate(len);
    file
}
