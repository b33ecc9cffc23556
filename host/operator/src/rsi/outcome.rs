//! The verdict about a throw, from what the robot did.

use firmware::fault::Cause;
use nalgebra::{DMatrix, DVector, Vector3};
use planner::follow::limits::{AXES, Arm, Axes};
use protocol::JointIndex;

use super::cell::Seen;
use super::cycles::Cycle;
use super::station::Stage;
use crate::throw::{Outcome, Verdict};

/// Distance of the landing from the target, in the plane of the target, m; `None` without a landing.
#[must_use]
pub fn error_m(seen: &Seen, target_m: &[f64; 3]) -> Option<f64> {
    seen.landing.as_ref().map(|landing| (landing.p_m - Vector3::from(*target_m)).xy().norm())
}

/// What is known of the ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RsiBallOutcome {
    /// It never left the hand.
    InHand,
    /// It left the hand and does not come down to the height of the target.
    Lost,
    /// It was seen to land so far from the target, m.
    Landed(f64),
    /// Nobody watched it; the measured axes send it so far from the target, m.
    Predicted(f64),
}

impl RsiBallOutcome {
    fn words(self) -> String {
        match self {
            Self::InHand => "the ball is in the hand".to_owned(),
            Self::Lost => "the ball left the hand and does not reach the height of the target".to_owned(),
            Self::Landed(error_m) => format!("the ball landed {:.1} mm from the target", 1e3 * error_m),
            Self::Predicted(error_m) => {
                format!(
                    "nobody watched the ball; the measured axes send it {:.1} mm from the target",
                    1e3 * error_m
                )
            }
        }
    }
}

/// The verdict on a throw that the simulated robot tells.
#[must_use]
pub fn judge(seen: &Seen, stage: &Stage, target_m: &[f64; 3], tolerance_m: f64) -> Verdict {
    let ball = match (&seen.released, error_m(seen, target_m)) {
        (None, _) => RsiBallOutcome::InHand,
        (Some(_), None) => RsiBallOutcome::Lost,
        (Some(_), Some(error_m)) => RsiBallOutcome::Landed(error_m),
    };
    let robot = seen.fault.as_ref().map(ToString::to_string);
    verdict(ball, robot.as_deref(), stage, tolerance_m)
}

/// The verdict. A throw whose ball has landed is no success if the arm was stopped in its motion; `robot_fault` says why the
/// robot stopped by itself, where that is known.
#[must_use]
pub fn verdict(ball: RsiBallOutcome, robot_fault: Option<&str>, stage: &Stage, tolerance_m: f64) -> Verdict {
    let robot = robot_fault.map_or(String::new(), |fault| format!("; the robot stopped by itself: {fault}"));
    let by_controller = |word: &str, cause: Cause, joint: Option<JointIndex>| {
        let what = cause.info().map_or(word, |info| info.what);
        let joint = joint.map_or(String::new(), |joint| format!(" (A{})", joint.get() + 1));
        format!("{word}: {what}{joint}, fault {}{robot}", cause.code())
    };
    let about_ball = ball.words();
    let (outcome, text) = match stage {
        Stage::Waiting | Stage::Offered { .. } => {
            (Outcome::NotThrown, format!("not thrown: the robot was never ready{robot}"))
        }
        Stage::NotThrown { refusal } => {
            (Outcome::NotThrown, by_controller("not thrown", refusal.cause, refusal.joint))
        }
        Stage::Stopped { fault } => {
            let text = by_controller("stopped", fault.cause, fault.joint);
            (Outcome::Stopped, format!("{text}; {about_ball}"))
        }
        Stage::Running { .. } => {
            (Outcome::Stopped, format!("stopped: the motion has no end{robot}; {about_ball}"))
        }
        Stage::Finished { .. } if robot_fault.is_some() => {
            (Outcome::Stopped, format!("stopped{robot}; {about_ball}"))
        }
        Stage::Finished { .. } => {
            let within = |error_m: f64| error_m <= tolerance_m;
            let (outcome, word) = match ball {
                RsiBallOutcome::InHand => (Outcome::NotReleased, "not released"),
                RsiBallOutcome::Landed(error_m) if within(error_m) => (Outcome::Landed, "landed"),
                RsiBallOutcome::Predicted(error_m) if within(error_m) => {
                    (Outcome::NotObserved, "thrown, not observed")
                }
                _ => (Outcome::Missed, "missed"),
            };
            let tolerance = match outcome {
                Outcome::NotReleased => String::new(),
                _ => format!(" (tolerance {:.0} mm)", 1e3 * tolerance_m),
            };
            (outcome, format!("{word}: {about_ball}{tolerance}"))
        }
    };
    Verdict { outcome, text, tolerance_m }
}

/// Cycles on each side of the release through which the path of an axis is fitted.
const NEAR: usize = 8;
/// Coefficients of the fitted path of an axis.
const COEFFICIENTS: usize = 4;

/// What the measured axes say about the ball: where it comes down at the height of the target.
///
/// The ball is free `gripper_delay_s` after the first cycle in which output bit `output_bit` is in force. A cubic through the
/// measured axes of the cycles around gives position and speed of the hand there.
#[must_use]
pub fn measured(
    arm: &Arm,
    cycles: &[Cycle],
    period_s: f64,
    (output_bit, gripper_delay_s): (u8, f64),
    target_m: &[f64; 3],
) -> RsiBallOutcome {
    let is_open = |cycle: &Cycle| (cycle.outputs as i64) >> output_bit & 1 == 1;
    let Some(opened) = cycles.iter().position(is_open) else { return RsiBallOutcome::InHand };
    let at = opened as f64 + gripper_delay_s / period_s;
    let first = (at as usize).saturating_sub(NEAR);
    let near = cycles.get(first..(first + 2 * NEAR + 1).min(cycles.len())).unwrap_or_default();
    if near.len() < 2 * COEFFICIENTS {
        return RsiBallOutcome::Lost;
    }
    let rows = DMatrix::from_fn(near.len(), COEFFICIENTS, |row, column| {
        ((first + row) as f64 - at).powi(column as i32)
    });
    let Ok(inverse) = rows.pseudo_inverse(1e-12) else { return RsiBallOutcome::Lost };
    let (mut q, mut qd) = (Axes::zeros(), Axes::zeros());
    for axis in 0..AXES {
        let deg = DVector::from_iterator(near.len(), near.iter().map(|cycle| cycle.actual_deg[axis]));
        let fitted = &inverse * deg;
        q[axis] = fitted[0].to_radians();
        qd[axis] = fitted[1].to_radians() / period_s;
    }
    let frames = arm.fk(&q);
    let p = arm.ball(&frames).pos;
    let v: Vector3<f64> = (frames.jacobian(&p) * qd).fixed_rows::<3>(0).into();
    let g = arm.world().gravity_m_s2;
    let root = v.z * v.z + 2.0 * g * (p.z - target_m[2]);
    if root < 0.0 {
        return RsiBallOutcome::Lost;
    }
    let fall_s = (v.z + root.sqrt()) / g;
    RsiBallOutcome::Predicted((p + v * fall_s - Vector3::from(*target_m)).xy().norm())
}
