//! Commands stay within the limits of the robot.

use protocol::powercube::{AddressedRequest, MotionCommand, Parameter, Request};
use protocol::{Frame, Instant, ModuleId};

use super::{Checker, Findings};

/// Share by which a command may exceed a limit: rounding to binary32.
const SLACK: f64 = 1e-6;

/// Limits of one module, joint side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModuleLimits {
    /// Wire address.
    pub module: ModuleId,
    /// Smallest target, rad.
    pub q_min_rad: f64,
    /// Largest target, rad.
    pub q_max_rad: f64,
    /// Largest velocity, rad/s.
    pub v_max_rad_s: f64,
    /// Largest acceleration, rad/s².
    pub a_max_rad_s2: f64,
    /// Largest current, A.
    pub current_max_a: f64,
}

/// Checker of commanded targets, velocities, accelerations and currents.
///
/// Values that are not finite violate every limit. Motions in ticks are not checked: the ratio is the drive's own.
#[derive(Clone, Debug)]
pub struct Limits {
    limits: Vec<ModuleLimits>,
}

impl Limits {
    /// Judges commands to these modules.
    pub fn new(limits: &[ModuleLimits]) -> Self {
        Self { limits: limits.to_vec() }
    }
}

impl Checker for Limits {
    fn on_frame(&mut self, at: Instant, frame: &Frame, findings: &mut Findings) {
        let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) else { return };
        let Some(limit) = self.limits.iter().find(|limit| limit.module == module) else { return };
        let mut judge = |what: &str, value: f64, low: f64, high: f64, unit: &str| {
            let slack = SLACK * low.abs().max(high.abs());
            if !(low - slack..=high + slack).contains(&value) {
                findings.add(at, Some(module), || {
                    format!("{what} {value:.6} {unit} is outside {low:.6} to {high:.6}")
                });
            }
        };
        let (v, a, i) = (limit.v_max_rad_s, limit.a_max_rad_s2, limit.current_max_a);
        let target = |q: protocol::units::Radians| f64::from(q.get());
        match request {
            Request::Set(Parameter::TargetVel, value) => {
                judge("target velocity", value.as_f64().unwrap_or(f64::NAN), 0.0, v, "rad/s");
            }
            Request::Set(Parameter::TargetAcc, value) => {
                judge("target acceleration", value.as_f64().unwrap_or(f64::NAN), 0.0, a, "rad/s2");
            }
            Request::Move(motion) => match motion.command() {
                MotionCommand::Ramp { target: q } | MotionCommand::Step { target: q, .. } => {
                    judge("target", target(q), limit.q_min_rad, limit.q_max_rad, "rad");
                }
                MotionCommand::Velocity(velocity) => {
                    judge("velocity", f64::from(velocity.get()), -v, v, "rad/s");
                }
                MotionCommand::Current(current) => judge("current", f64::from(current.get()), -i, i, "A"),
                _ => {}
            },
            _ => {}
        }
    }
}
