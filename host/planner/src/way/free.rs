//! Check of a motion from another program: is it free of contact?

use robot_model::collision::{CollisionChecker, MotionVerdict, Scene, Travel};
use robot_model::cubic::Cubic;
use robot_model::{JointVec, RobotModel};

use super::{TOLERANCE_M, WayError};
use crate::motion::Motion;

/// One cubic of a motion; the parameter is the time since its begin, s.
struct Piece(Cubic<JointVec>);

impl Travel for Piece {
    fn at(&self, s: f64) -> JointVec {
        self.0.position(s)
    }

    /// The speed is a parabola: no faster than at both ends, and an eighth of jerk times the square of the span.
    fn path_length(&self, s0: f64, s1: f64) -> JointVec {
        let span = s1 - s0;
        let ends = self.0.velocity(s0).abs().sup(&self.0.velocity(s1).abs());
        (ends + self.0.jerk().abs() * (span * span / 8.0)) * span
    }
}

/// Checks that no two bodies touch on `motion`, at any instant.
///
/// # Errors
/// [`WayError::Contact`] with the first time and the bodies.
pub fn require_free_motion(arm: &RobotModel, scene: &Scene, motion: &Motion) -> Result<(), WayError> {
    let mut checker = CollisionChecker::new(arm, scene);
    for pair in motion.knots.windows(2) {
        let h_s = pair[1].t_s - pair[0].t_s;
        let [from, to] = [&pair[0], &pair[1]].map(|knot| (knot.q_rad, knot.qd_rad_s));
        let piece = Piece(Cubic::between(h_s, from, to));
        if let MotionVerdict::Contact { s, clearance } = checker.check_motion(&piece, 0.0, h_s, TOLERANCE_M) {
            let [a, b] = [clearance.a, clearance.b].map(|body| checker.name(body).to_string());
            return Err(WayError::Contact { t_s: pair[0].t_s + s, a, b });
        }
    }
    Ok(())
}
