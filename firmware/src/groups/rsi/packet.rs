//! What goes over the wire, without its spelling: XML belongs to the host.

use protocol::Duration;

use crate::joints::PerJoint;

/// A packet of the link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Packet {
    /// From the robot, once per cycle.
    Robot(Telegram),
    /// To the robot.
    Pc(Answer),
}

/// A telegram of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Telegram {
    /// Number of the cycle; the answer repeats it.
    pub ipoc: u64,
    /// Measured axes, rad. `None` in the first telegram of a KR C2, which holds the number only.
    pub q_rad: Option<PerJoint<f32>>,
    /// Programmed axes, rad: the start pose, to which corrections are added. `None`: the configuration does not send them.
    pub start_rad: Option<PerJoint<f32>>,
    /// Answers that came too late since the program began, as the robot counts them.
    pub late: Option<u32>,
    /// The telegram comes from another socket than the one before: a new program run.
    pub new_connection: bool,
}

/// The answer to one telegram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Number of the telegram.
    pub ipoc: u64,
    /// Offset from the start pose, rad, in all and not per cycle.
    pub correction_rad: PerJoint<f32>,
    /// The gripper's output: open.
    pub open: bool,
    /// The robot leaves the sensor motion.
    pub stop: bool,
}

/// What the group must know of robot and program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// From a set point to the beginning of its effect on the axes.
    pub dead_time: Duration,
    /// Time constant of the first-order lag behind it.
    pub time_constant: Duration,
    /// Lower limits of the corrections, rad: those of the robot's program. It clamps silently, so the group refuses first.
    pub lower_rad: PerJoint<f32>,
    /// Upper limits.
    pub upper_rad: PerJoint<f32>,
    /// Largest acceleration of set points (difference over a cycle), rad/s². Below the robot's cut-out.
    pub a_cap_rad_s2: f32,
    /// Deceleration of the fastest axis when all brake together, rad/s².
    pub a_brake_rad_s2: f32,
    /// Distance of the axes from the path of the model of the drives that counts as lagging, rad.
    pub lag_max_rad: f32,
    /// Delay of that path that counts as lagging.
    pub delay_max: Duration,
    /// Late answers within a run after which the path is left.
    pub late_max: u32,
}

impl Default for Options {
    /// A KR 16 with a KR C2 (two published measurements give 120 ms from correction to axis).
    fn default() -> Self {
        Self {
            dead_time: Duration::from_millis(96),
            time_constant: Duration::from_millis(24),
            lower_rad: PerJoint::splat(-1.745),
            upper_rad: PerJoint::splat(1.745),
            a_cap_rad_s2: 34.85,
            a_brake_rad_s2: 8.0,
            lag_max_rad: 0.05,
            delay_max: Duration::from_millis(40),
            late_max: 3,
        }
    }
}
