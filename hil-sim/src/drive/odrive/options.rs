//! An axis as it is configured, and what is wrong with it.

use protocol::Duration;
use protocol::odrive::{NodeId, Version};

/// A parameter that a host reaches by its number (0.6). What no other message changes is kept here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OdriveParameter {
    /// Between two estimates, ms; 0: when asked only.
    EstimatesPeriod,
    /// Steps of the velocity field in a turn/s.
    VelocityScale,
    /// Steps of the torque field in a N·m.
    TorqueScale,
    /// Time-out of the watchdog, s.
    WatchdogTime,
    WatchdogOn,
    /// What the loop controls; read only.
    ControlMode,
    /// How set points become what is controlled; read only.
    InputMode,
}

impl OdriveParameter {
    /// All, in the order of [`OdriveOptions::endpoints`].
    pub const ALL: [Self; 7] = [
        Self::EstimatesPeriod,
        Self::VelocityScale,
        Self::TorqueScale,
        Self::WatchdogTime,
        Self::WatchdogOn,
        Self::ControlMode,
        Self::InputMode,
    ];
}

/// An axis as it is configured. Torques are those of the motor's shaft, in front of the gear; turns are those of the shaft that is counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdriveOptions {
    /// Its number on the bus.
    pub node: NodeId,
    /// Which messages it speaks.
    pub version: Version,
    /// Turns of the motor per turn of the joint.
    pub gear: f64,
    /// Turns that are counted per turn of the joint: the gear, or 1 with an encoder at the joint.
    pub counted: f64,
    /// Torque per current, N·m/A.
    pub torque_nm_a: f64,
    /// Largest current of a new axis, A.
    pub current_max_a: f64,
    /// Largest speed of a new axis, turns/s.
    pub velocity_max_rev_s: f64,
    /// k_p, 1/s.
    pub position_gain: f64,
    /// k_v, N·m s.
    pub velocity_gain: f64,
    /// Gain of the integral, N·m.
    pub integral_gain: f64,
    /// Time without an order after which there is no torque. Off as shipped.
    pub watchdog: Option<Duration>,
    /// Between two heartbeats.
    pub heartbeat: Duration,
    /// Between two estimates; `None`: only when asked.
    pub estimates: Option<Duration>,
    /// The encoder knows its place within a turn at power-on. One that does not needs an index search.
    pub absolute: bool,
    /// A brake that closes without torque.
    pub brakes: bool,
    /// From a request to its answer.
    pub answer_after: Duration,
    /// A request feeds the watchdog as an order does.
    pub requests_feed: bool,
    /// Firmware that it reports: major, minor, revision.
    pub firmware: [u8; 3],
    /// Numbers of parameters, in the order of [`OdriveParameter::ALL`]. Each firmware has its own.
    pub endpoints: Option<[u16; OdriveParameter::ALL.len()]>,
}

impl OdriveOptions {
    /// Rates and limits as shipped; gains for an inertia of 0.1 kg·m² behind the gear: 100 rad/s of the velocity loop.
    pub fn new(node: NodeId, version: Version) -> Self {
        Self {
            node,
            version,
            gear: 8.0,
            counted: 8.0,
            torque_nm_a: 8.27 / 270.0,
            current_max_a: 40.0,
            velocity_max_rev_s: 20.0,
            position_gain: 20.0,
            velocity_gain: 1.0,
            integral_gain: 5.0,
            watchdog: None,
            heartbeat: Duration::from_millis(100),
            estimates: Some(Duration::from_millis(10)),
            absolute: true,
            brakes: false,
            answer_after: Duration::from_micros(150),
            requests_feed: false,
            firmware: [0, 6, 10],
            endpoints: None,
        }
    }
}

/// What is wrong with an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OdriveFaults {
    /// The watchdog never strikes.
    pub watchdog_is_dead: bool,
    pub estimates_are_nan: bool,
    /// Estimates hold what was measured last before.
    pub estimates_are_stale: bool,
    /// So many of the next estimates are torn: 0.5 turns of the joint off.
    pub torn_estimates: u32,
    /// Every so many requests one has no answer; 0: each has one.
    pub answer_lost_every: u32,
    /// Nothing is sent.
    pub is_silent: bool,
    /// Parameters are not written.
    pub parameters_are_fixed: bool,
}
