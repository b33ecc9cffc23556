//! The verdict about a throw, from what the robot did.

use nalgebra::Vector3;

use super::cell::Seen;
use super::station::Stage;
use crate::throw::{Outcome, Verdict};

/// Distance of the landing from the target, in the plane of the target, m; `None` without a landing.
#[must_use]
pub fn error_m(seen: &Seen, target_m: &[f64; 3]) -> Option<f64> {
    seen.landing.as_ref().map(|landing| (landing.p_m - Vector3::from(*target_m)).xy().norm())
}

/// The verdict. A throw whose ball has landed is no success if the arm was stopped in its motion.
#[must_use]
pub fn judge(seen: &Seen, stage: &Stage, target_m: &[f64; 3], tolerance_m: f64) -> Verdict {
    let ball = match (&seen.released, error_m(seen, target_m)) {
        (None, _) => "the ball is in the hand".to_owned(),
        (Some(_), None) => "the ball left the hand and does not reach the height of the target".to_owned(),
        (Some(_), Some(error_m)) => format!("the ball landed {:.1} mm from the target", 1e3 * error_m),
    };
    let robot =
        seen.fault.as_ref().map_or(String::new(), |fault| format!("; the robot stopped by itself: {fault}"));
    let (outcome, text) = match stage {
        Stage::Waiting | Stage::Offered { .. } => {
            (Outcome::NotThrown, format!("not thrown: the robot was never ready{robot}"))
        }
        Stage::NotThrown { refusal } => {
            let what = refusal.cause.info().map_or("refused", |info| info.what);
            let joint = refusal.joint.map_or(String::new(), |joint| format!(" (A{})", joint.get() + 1));
            (Outcome::NotThrown, format!("not thrown: {what}{joint}, fault {}{robot}", refusal.cause.code()))
        }
        Stage::Stopped { fault } => {
            let what = fault.cause.info().map_or("stopped", |info| info.what);
            let joint = fault.joint.map_or(String::new(), |joint| format!(" (A{})", joint.get() + 1));
            (Outcome::Stopped, format!("stopped: {what}{joint}, fault {}{robot}; {ball}", fault.cause.code()))
        }
        Stage::Running { .. } => (Outcome::Stopped, format!("stopped: the motion has no end{robot}; {ball}")),
        Stage::Finished { .. } if seen.fault.is_some() => {
            (Outcome::Stopped, format!("stopped{robot}; {ball}"))
        }
        Stage::Finished { .. } => match (&seen.released, error_m(seen, target_m)) {
            (None, _) => (Outcome::NotReleased, format!("not released: {ball}")),
            (Some(_), Some(error_m)) if error_m <= tolerance_m => {
                (Outcome::Landed, format!("landed: {ball} (tolerance {:.0} mm)", 1e3 * tolerance_m))
            }
            _ => (Outcome::Missed, format!("missed: {ball} (tolerance {:.0} mm)", 1e3 * tolerance_m)),
        },
    };
    Verdict { outcome, text, tolerance_m }
}
