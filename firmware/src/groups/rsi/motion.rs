//! Set points of all axes, by mode.

use protocol::{Duration, Instant, JointIndex};

use super::packet::Options;
use crate::groups::shape::Axis;
use crate::joints::{PerJoint, at_least, at_most, clamp};
use crate::reach::{SoftLimits, reachable};
use crate::settings::{JointSettings, Settings};

/// What the axes do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Mode {
    #[default]
    Finding,
    Standing,
    Homing(JointIndex),
    Jogging {
        joint: JointIndex,
        qd_rad_s: f32,
        until: Instant,
        released: bool,
    },
    Tracking,
    Moving,
    Braking,
    /// Refuses motion.
    Halted,
}

/// All axes come to rest together, on the tangent of their path.
#[derive(Clone, Copy, Debug)]
struct Brake {
    from_rad_s: PerJoint<f32>,
    length_s: f32,
    since_s: f32,
}

/// Set points in force and on their way.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Setpoints {
    pub(super) mode: Mode,
    axis: PerJoint<Axis>,
    /// Set points before the last answer: in force if the robot did not take it.
    before_rad: PerJoint<f32>,
    /// Reference of this cycle and of the one before.
    reference_rad: PerJoint<f32>,
    reference_before_rad: PerJoint<f32>,
    end_rad: PerJoint<f32>,
    brake: Option<Brake>,
    period: Duration,
}

/// Where set points may be.
pub(super) struct Window {
    pub(super) low_rad: PerJoint<f32>,
    pub(super) high_rad: PerJoint<f32>,
}

impl Window {
    /// Soft limits of a joint inside of it.
    fn limits(&self, settings: &JointSettings, joint: JointIndex) -> SoftLimits {
        let soft = SoftLimits::of(settings);
        SoftLimits {
            q_min_rad: at_least(self.low_rad.get(joint), soft.q_min_rad),
            q_max_rad: at_most(self.high_rad.get(joint), soft.q_max_rad),
        }
    }
}

/// A jog is ordered to where its speed leads in this time, s: beyond every range.
const JOG_WAY_S: f32 = 1e3;
/// Largest share of a speed limit: a robot that judges the difference of two rounded set points stops at the limit itself.
const WITHIN_LIMIT: f32 = 0.999;
/// Speed below which an axis stands, rad/s.
const STANDS_RAD_S: f32 = 1e-5;

impl Setpoints {
    /// Period of the last cycle.
    pub(super) const fn period(&self) -> Duration {
        self.period
    }

    pub(super) fn set_rad(&self) -> PerJoint<f32> {
        let PerJoint(axes) = self.axis;
        PerJoint(axes.map(|axis| axis.q_rad))
    }

    /// All set points are at a pose, at rest.
    pub(super) fn rest_at(&mut self, q_rad: PerJoint<f32>) {
        let PerJoint(poses) = q_rad;
        self.axis = PerJoint(poses.map(|q_rad| Axis { q_rad, v_rad_s: 0.0 }));
        (self.before_rad, self.reference_rad, self.reference_before_rad) = (q_rad, q_rad, q_rad);
        self.brake = None;
    }

    /// The robot did not take the last answer and holds the set points before.
    pub(super) fn refused(&mut self) {
        for (axis, before) in self.axis.0.iter_mut().zip(self.before_rad.0) {
            axis.q_rad = before;
        }
        self.held();
    }

    /// The robot has held the set points in force for at least a cycle.
    pub(super) fn held(&mut self) {
        for axis in &mut self.axis.0 {
            axis.v_rad_s = 0.0;
        }
        self.brake = None;
    }

    pub(super) fn track(&mut self) {
        (self.mode, self.brake) = (Mode::Tracking, None);
        (self.reference_rad, self.reference_before_rad) = (self.set_rad(), self.set_rad());
    }

    /// Setpoint of an axis for the next cycle.
    pub(super) fn refer(&mut self, joint: JointIndex, q_rad: f32) {
        self.reference_rad.set(joint, q_rad);
    }

    pub(super) fn move_to(&mut self, joint: JointIndex, q_rad: f32) {
        if self.mode != Mode::Moving {
            (self.mode, self.end_rad, self.brake) = (Mode::Moving, self.set_rad(), None);
        }
        self.end_rad.set(joint, q_rad);
    }

    /// Begins to brake, unless it does already. Returns the time to rest, s.
    pub(super) fn brake(&mut self, settings: &Settings, options: &Options) -> f32 {
        if let Some(brake) = self.brake {
            return at_least(brake.length_s - brake.since_s, 0.0);
        }
        let mut from_rad_s = PerJoint::default();
        let mut fastest = 0.0;
        for joint in settings.joints() {
            let v = self.axis.at(joint).v_rad_s;
            from_rad_s.set(joint, v);
            fastest = at_least(v.abs(), fastest);
        }
        if fastest <= STANDS_RAD_S {
            return 0.0;
        }
        let length_s = fastest / options.a_brake_rad_s2;
        self.brake = Some(Brake { from_rad_s, length_s, since_s: 0.0 });
        length_s
    }

    /// The set points of the next cycle: what the mode wants, within `window` and then within what a robot follows from the last
    /// set point that was sent. Whatever comes in, no set point leaves by another way.
    pub(super) fn step(&mut self, now: Instant, settings: &Settings, options: &Options, window: &Window) {
        self.period = settings.cycle_period();
        let dt_s = settings.cycle_period_s();
        let sent = self.axis;
        self.before_rad = self.set_rad();
        self.wish(now, settings, options, window);
        for joint in settings.joints() {
            let v_max_rad_s = WITHIN_LIMIT * settings.joint.at(joint).v_max_rad_s;
            let axis = self.axis.at_mut(joint);
            if axis.q_rad.is_finite() {
                axis.q_rad = clamp(axis.q_rad, window.low_rad.get(joint), window.high_rad.get(joint));
            }
            *axis = sent.at(joint).within(*axis, v_max_rad_s, options.a_cap_rad_s2, dt_s);
        }
        self.reference_before_rad = self.reference_rad;
    }

    fn wish(&mut self, now: Instant, settings: &Settings, options: &Options, window: &Window) {
        let dt_s = settings.cycle_period_s();
        if let Some(brake) = &mut self.brake {
            brake.since_s += dt_s;
            let share = at_least(1.0 - brake.since_s / brake.length_s, 0.0);
            for joint in settings.joints() {
                self.axis.at_mut(joint).go(share * brake.from_rad_s.get(joint), dt_s);
            }
            if share <= 0.0 {
                self.brake = None;
            }
            return;
        }
        for joint in settings.joints() {
            let (limits, axis) = (settings.joint.at(joint), self.axis.at_mut(joint));
            match self.mode {
                Mode::Tracking => {
                    let (from, to) = (self.reference_before_rad.get(joint), self.reference_rad.get(joint));
                    let v_max_rad_s = WITHIN_LIMIT * limits.v_max_rad_s;
                    axis.follow(from, to, v_max_rad_s, options.a_cap_rad_s2, dt_s);
                }
                Mode::Moving => {
                    axis.approach(self.end_rad.get(joint), limits.jog_v_rad_s, limits.jog_a_rad_s2, dt_s);
                }
                Mode::Jogging { joint: at_work, qd_rad_s, until, released } => {
                    if at_work == joint && !released && now < until {
                        let end_rad = reachable(
                            axis.q_rad,
                            window.limits(limits, joint),
                            axis.q_rad + JOG_WAY_S * qd_rad_s,
                        );
                        axis.approach(end_rad, qd_rad_s.abs(), limits.jog_a_rad_s2, dt_s);
                    } else {
                        axis.drive(0.0, limits.jog_a_rad_s2, dt_s);
                    }
                }
                Mode::Finding | Mode::Standing | Mode::Homing(_) | Mode::Braking | Mode::Halted => {
                    axis.v_rad_s = 0.0;
                }
            }
        }
    }

    /// Reference of the last cycle.
    pub(super) const fn last_reference_rad(&self) -> &PerJoint<f32> {
        &self.reference_before_rad
    }
}
