//! Six CANopen servos and the controller.

use firmware::groups::cia402::{Cia402, Follow, Home, Options, Servo};
use firmware::settings::Settings;
use hil_sim::drive::cia402::{CanopenServo, ServoOptions};
use protocol::canopen::{Function, NodeId};
use protocol::{Frame, Instant};

use crate::six::{JOINTS, Six, settings_at, stands_rad};

pub(crate) const PERIOD_US: u64 = 2_000;
pub(crate) const TIME_OUT_US: u32 = 30_000;

pub(crate) type Rig = Six<Cia402, CanopenServo>;

pub(crate) fn node(index: usize) -> NodeId {
    NodeId::new(index as u8 + 3).unwrap()
}

pub(crate) fn settings() -> Settings {
    settings_at(PERIOD_US, TIME_OUT_US)
}

impl Rig {
    pub(crate) fn with(settings: &Settings, home: Home, change: impl Fn(usize, &mut ServoOptions)) -> Self {
        let servo = Servo {
            node: node(0),
            counts_per_turn: 409_600,
            rated_mnm: 50_000,
            home,
            follow: Follow::Cyclic,
        };
        Self::of_servos(settings, servo, change)
    }

    /// Modules that interpolate and count millidegrees.
    pub(crate) fn interpolating(change: impl Fn(usize, &mut ServoOptions)) -> Self {
        Self::interpolating_with(&settings(), change)
    }

    /// See [`Self::interpolating`].
    pub(crate) fn interpolating_with(settings: &Settings, change: impl Fn(usize, &mut ServoOptions)) -> Self {
        let servo = Servo {
            node: node(0),
            counts_per_turn: 360_000,
            rated_mnm: 50_000,
            home: Home::Absolute,
            follow: Follow::Interpolated,
        };
        Self::of_servos(settings, servo, |i, options| {
            *options = options.interpolating();
            change(i, options);
        })
    }

    /// Six of this servo, at nodes from 3 on.
    fn of_servos(settings: &Settings, servo: Servo, change: impl Fn(usize, &mut ServoOptions)) -> Self {
        let servos: [Servo; JOINTS] = core::array::from_fn(|i| Servo { node: node(i), ..servo });
        let group = Cia402::new(Options::new(&servos).unwrap());
        let servo = |i| {
            let mut options = ServoOptions::of(node(i));
            change(i, &mut options);
            CanopenServo::new(options, stands_rad(i))
        };
        Self::six(settings, group, (0..JOINTS).map(servo).collect(), CanopenServo::shaft_rad)
    }

    pub(crate) fn new() -> Self {
        Self::with(&settings(), Home::Absolute, |_, _| {})
    }

    pub(crate) fn ready() -> Self {
        Self::new().made_ready(1_500)
    }

    pub(crate) fn moving() -> Self {
        Self::ready().moved_on()
    }

    /// Frames for `function` since `from`, with the time at which each ended.
    pub(crate) fn frames_of(&self, function: Function, from: Instant) -> Vec<(Instant, Frame)> {
        self.frames(from, |frame| Function::of_frame(frame) == Some(function))
    }

    /// Control words and targets of a servo since `from`.
    pub(crate) fn targets(&self, index: usize, from: Instant) -> Vec<(Instant, u16, f64)> {
        let words = self.frames_of(Function::Rpdo(1, node(index)), from).into_iter();
        words
            .map(|(at, frame)| {
                let [a, b, c, d, e, f] = *frame.data().first_chunk::<6>().unwrap();
                let counts = i32::from_le_bytes([c, d, e, f]);
                (at, u16::from_le_bytes([a, b]), f64::from(counts) * std::f64::consts::TAU / 409_600.0)
            })
            .collect()
    }
}
