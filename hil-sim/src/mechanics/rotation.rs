//! A thing that is no ball turns freely after its release.
//!
//! ```text
//! ω̇_x = (1 - r) ω_y ω_z     ω̇_y = (r - 1) ω_z ω_x     ω̇_z = 0     body, z the axis of symmetry, r = I_a/I_t
//! ```
//!
//! Each sub-step turns the attitude by the angular velocity in its middle.

use nalgebra::{Matrix3, Rotation3, Vector3};
use robot_model::release::HandMotion;

/// Sub-step, s: the error over a throw at 20 rad/s is below 1e-5 rad.
const STEP_S: f64 = 1e-4;

/// A rigid thing with an axis of symmetry, fixed in the hand until the release.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thing {
    /// Axis of symmetry in the frame E of the hand; any length but zero.
    pub axis_e: Vector3<f64>,
    /// Moment of inertia about the axis over that across it, 0 to 2.
    pub inertia_ratio: f64,
}

/// A thing in free rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    /// Axis of symmetry, unit vector, world.
    pub axis: Vector3<f64>,
    /// Angular momentum over the transverse moment of inertia, rad/s, world.
    pub momentum_rad_s: Vector3<f64>,
}

impl Thing {
    /// The thing `t_s` seconds after a release from `hand`.
    pub fn attitude(&self, hand: &HandMotion, t_s: f64) -> Attitude {
        let hand_w = Rotation3::from_matrix_unchecked(hand.rot_we);
        // The body's z is the axis of symmetry.
        let z = self.axis_e.normalize();
        let turn = Rotation3::rotation_between(&Vector3::z(), &z)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let mut body_w = hand_w * turn;
        let mut rate = body_w.inverse() * hand.w_rad_s;
        let more = self.inertia_ratio - 1.0;
        let change = |w: &Vector3<f64>| Vector3::new(-more * w.y * w.z, more * w.z * w.x, 0.0);
        let steps = (t_s.max(0.0) / STEP_S).ceil().max(1.0);
        let h = t_s.max(0.0) / steps;
        for _ in 0..steps as usize {
            let middle = rate + change(&rate) * (0.5 * h);
            body_w *= Rotation3::from_scaled_axis(middle * h);
            rate += change(&middle) * h;
        }
        let inertia = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, self.inertia_ratio));
        Attitude { axis: body_w * Vector3::z(), momentum_rad_s: body_w * (inertia * rate) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hand(rot_we: Matrix3<f64>, w_rad_s: Vector3<f64>) -> HandMotion {
        HandMotion { rot_we, rot_wr: rot_we, p_m: Vector3::zeros(), v_m_s: Vector3::zeros(), w_rad_s }
    }

    /// The axis of a free body with an axis of symmetry turns about the constant angular momentum L at |L|/I_t.
    #[test]
    fn the_axis_turns_about_the_angular_momentum_at_its_rate() {
        let rot_we = Rotation3::from_euler_angles(0.3, -0.8, 1.2).into_inner();
        let hand = hand(rot_we, Vector3::new(4.0, -3.0, 6.0));
        for (axis_e, inertia_ratio) in [
            (Vector3::z(), 1.8),
            (Vector3::new(1.0, 2.0, 0.0), 0.0),
            (-Vector3::z(), 0.4),
            (Vector3::x(), 1.0),
        ] {
            let thing = Thing { axis_e, inertia_ratio };
            let (first, last) = (thing.attitude(&hand, 0.0), thing.attitude(&hand, 0.9));
            assert!((first.axis - hand.rot_we * axis_e.normalize()).norm() < 1e-12);
            assert!((last.momentum_rad_s - first.momentum_rad_s).norm() < 1e-5, "{inertia_ratio}: {last:?}");
            let turned = Rotation3::from_scaled_axis(first.momentum_rad_s * 0.9) * first.axis;
            assert!((last.axis - turned).norm() < 1e-5, "{inertia_ratio}: {} {turned}", last.axis);
        }
    }

    #[test]
    fn a_thing_that_leaves_without_rotation_keeps_its_attitude() {
        let hand = hand(Matrix3::identity(), Vector3::zeros());
        let thing = Thing { axis_e: Vector3::y(), inertia_ratio: 1.8 };
        assert_eq!(thing.attitude(&hand, 2.0).axis, thing.attitude(&hand, 0.0).axis);
    }
}
