//! Measurements and reports of a run, in terms of joints, for every link: the only input of an analysis.
//!
//! [`of_log`] makes them from the frames of a CAN bus, live or recorded; each frame is decoded once. `of_controller` reads them from a
//! controller in this program.
//!
//! # Conventions
//!
//! Times are those of the session or the log. Positions are of joints in rad, base first. A position carries the time at which it
//! was measured, everything else the time at which it was heard.

pub mod drives;
pub(crate) mod of_controller;
pub mod of_log;

use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::JointSample;
use protocol::{Instant, bits};

use crate::log::candump::Line;
use crate::log::watch::LogEvent;
use drives::Drives;

/// A number at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct At {
    pub at: Instant,
    pub value: f64,
}

/// A ramp that a drive was ordered to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RampOrder {
    pub at: Instant,
    /// Angle of the joint to ramp to, rad.
    pub target_rad: f64,
    /// Speed of the ramp as last written, rad/s.
    pub v_rad_s: Option<f64>,
    /// Acceleration of the ramp as last written, rad/s².
    pub a_rad_s2: Option<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct JointSamples {
    /// Measured angles, rad.
    pub positions: Vec<At>,
    /// Motor currents, A, positive if they turn the joint forwards.
    pub currents: Vec<At>,
    /// Temperatures of the drive, degrees Celsius.
    pub temperatures: Vec<At>,
    pub orders: Vec<RampOrder>,
    /// Reports of the controller about the joint.
    pub reported: Vec<(Instant, JointSample)>,
}

/// A state of the group, as the controller reported it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroupTold {
    /// When it was received completely.
    pub at: Instant,
    /// The controller had made the message by then.
    pub made_by: Instant,
    /// The message.
    pub state: GroupState,
}

/// A joint as last known at the moment of a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointFreeze {
    /// Angle, rad.
    pub position: Option<At>,
    pub current_a: Option<f64>,
    /// Acceleration written last, rad/s².
    pub ramp_a_rad_s2: Option<f64>,
    /// Target of the last ramp ordered, rad.
    pub ramp_target_rad: Option<f64>,
}

/// The group at the moment of a fault.
#[derive(Clone, Debug, PartialEq)]
pub struct Freeze {
    /// When the controller reported it.
    pub at: Instant,
    pub group: GroupState,
    pub before: State,
    /// The joints, base first.
    pub joints: Vec<JointFreeze>,
    /// The last frames before it, oldest first; empty if the link is not a bus.
    pub frames: Vec<(Instant, String)>,
}

#[derive(Clone, Debug)]
pub struct BusLog {
    /// Its frames in ascending time; the time of a line is the end of its frame.
    pub frames: Vec<Line>,
    /// How long bits take on it.
    pub bit_times: BitTimes,
    pub drives: Drives,
}

/// How long the bits of a bus take, s.
#[derive(Clone, Copy, Debug)]
pub struct BitTimes {
    /// Of classical frames, and of the arbitration of others.
    pub nominal_s: f64,
    /// In the data phase of CAN FD.
    pub fast_s: f64,
}

impl BitTimes {
    /// Of a bus with these rates, bit/s; without a data rate the data phase of CAN FD is as slow as the rest.
    #[must_use]
    pub fn of(bit_rate_bit_s: u32, data_bit_rate_bit_s: Option<u32>) -> Self {
        let [nominal_s, fast_s] = [bit_rate_bit_s, data_bit_rate_bit_s.unwrap_or(bit_rate_bit_s)]
            .map(|rate| 1.0 / f64::from(rate.max(1)));
        Self { nominal_s, fast_s }
    }

    /// Time from the start of a frame to its end, s.
    #[must_use]
    pub fn frame_s(&self, length: bits::Length) -> f64 {
        f64::from(length.frame() - length.fast) * self.nominal_s + f64::from(length.fast) * self.fast_s
    }
}

/// A cycle of a robot that is led, as one of its telegrams has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Cycle {
    /// When it came, on the station's clock.
    pub at: Instant,
    pub ipoc: u64,
    /// Start pose of the robot's program, deg.
    pub start_deg: [f64; 6],
    /// Set point in force, deg: start pose and the correction that the robot took last.
    pub set_deg: [f64; 6],
    /// Measured axes, deg.
    pub actual_deg: [f64; 6],
    /// Output value in force.
    pub outputs: f64,
    /// State of the finger sensor; `None`: the configuration has no sensor.
    pub fingers_open: Option<bool>,
    /// Late answers as the robot counts them.
    pub late: u64,
}

#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// The joints, base first.
    pub joints: Vec<JointSamples>,
    pub group: Vec<GroupTold>,
    /// When the gripper was ordered to open or to close.
    pub gripper_ordered: Vec<Instant>,
    /// What happened, as text.
    pub events: Vec<LogEvent>,
    /// Faults and stops that were not there before.
    pub freezes: Vec<Freeze>,
    /// The frames, where the link is a bus.
    pub bus: Option<BusLog>,
    /// When the motion began by the time of its path, where the link knows it.
    pub begun: Option<Instant>,
    /// The cycles of a robot that is led, and what the last answer sets its outputs to.
    pub cycles: Vec<Cycle>,
    pub last_outputs: Option<f64>,
}

impl Samples {
    /// True if no data were received at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        let silent = |joint: &JointSamples| joint.positions.is_empty() && joint.reported.is_empty();
        self.group.is_empty()
            && self.joints.iter().all(silent)
            && self.bus.as_ref().is_none_or(|bus| bus.frames.is_empty())
    }
}
