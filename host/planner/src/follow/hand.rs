//! How the hand turns while its ball stays on the flight parabola.
//!
//! The release frame has z along the throw. Its rotation is `Rz(azimuth) Ry(polar) Rz(roll)`: azimuth and polar angle
//! point z, the roll turns the hand about it. In the paper all three are constant; here each is a polynomial of time,
//! and the polar angle may follow the tangent of the flight.

use nalgebra::{Vector3, Vector6};
use robot_model::Pose;

use super::parabola::Parabola;

/// Motion of the hand along a flight; t = 0 is where the flight has `p0` and `v0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandLaw {
    /// Share of the tangent's turn that the hand follows: 0 constant orientation, 1 z always along the velocity.
    pub follow: f64,
    /// Roll about z: angle in rad, rate in rad/s, second derivative in rad/s².
    pub roll: [f64; 3],
    /// Departure of z from the velocity in the vertical plane of the flight: angle in rad and rate in rad/s.
    pub tilt: [f64; 2],
    /// The same about the vertical.
    pub yaw: [f64; 2],
}

/// Ball frame with its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandState {
    /// Release frame in the world, origin at the ball's centre.
    pub x_wb: Pose,
    /// `[v; ω]` of it in the world, in m/s and rad/s.
    pub twist: Vector6<f64>,
    /// Time derivative of the twist.
    pub twist_rate: Vector6<f64>,
}

impl HandLaw {
    /// The paper's hand: across v0, not turning.
    #[must_use]
    pub fn constant(roll_rad: f64) -> Self {
        Self { follow: 0.0, roll: [roll_rad, 0.0, 0.0], tilt: [0.0; 2], yaw: [0.0; 2] }
    }

    /// The hand at `t_s` of the flight.
    #[must_use]
    pub fn at(&self, flight: &Parabola, t_s: f64) -> HandState {
        let azimuth = flight.v0.y.atan2(flight.v0.x) + self.yaw[0] + self.yaw[1] * t_s;
        let azimuth_d = self.yaw[1];
        let polar_0 = flight.polar(0.0)[0];
        let [polar_t, polar_t_d, polar_t_dd] = flight.polar(t_s);
        let polar = polar_0 + self.follow * (polar_t - polar_0) + self.tilt[0] + self.tilt[1] * t_s;
        let (polar_d, polar_dd) = (self.follow * polar_t_d + self.tilt[1], self.follow * polar_t_dd);
        let roll = self.roll[0] + (self.roll[1] + 0.5 * self.roll[2] * t_s) * t_s;
        let (roll_d, roll_dd) = (self.roll[1] + self.roll[2] * t_s, self.roll[2]);

        let turned = Pose::rot_z(azimuth);
        let rot = (turned * Pose::rot_y(polar) * Pose::rot_z(roll)).rot;
        let (up, side): (_, Vector3<f64>) = (Vector3::z(), turned.rot.column(1).into());
        let along: Vector3<f64> = rot.column(2).into();
        let omega = up * azimuth_d + side * polar_d + along * roll_d;
        let alpha = side * polar_dd
            + up.cross(&side) * (azimuth_d * polar_d)
            + along * roll_dd
            + omega.cross(&along) * roll_d;
        let v = flight.velocity(t_s);
        HandState {
            x_wb: Pose::new(rot, flight.position(t_s)),
            twist: Vector6::new(v.x, v.y, v.z, omega.x, omega.y, omega.z),
            twist_rate: Vector6::new(0.0, 0.0, -flight.gravity_m_s2, alpha.x, alpha.y, alpha.z),
        }
    }

    /// Angle between the hand's z axis and the velocity of the ball at `t_s`, in rad.
    #[must_use]
    pub(crate) fn off_across_rad(&self, flight: &Parabola, t_s: f64) -> f64 {
        let z: Vector3<f64> = self.at(flight, t_s).x_wb.rot.column(2).into();
        z.cross(&flight.velocity(t_s)).norm().atan2(z.dot(&flight.velocity(t_s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight() -> Parabola {
        Parabola { p0: Vector3::new(0.5, 0.2, 1.1), v0: Vector3::new(2.4, -1.1, 1.9), gravity_m_s2: 9.81 }
    }

    #[test]
    fn twist_and_its_rate_are_those_of_finite_differences() {
        let law = HandLaw { follow: 0.7, roll: [0.4, -1.5, 6.0], tilt: [0.1, 0.5], yaw: [-0.2, 0.8] };
        let (flight, t, h) = (flight(), 0.07, 1e-5);
        let [at, before, after] = [t, t - h, t + h].map(|t| law.at(&flight, t));
        let rate = (after.twist - before.twist) / (2.0 * h);
        assert!((rate - at.twist_rate).amax() < 1e-7, "{rate:?} {:?}", at.twist_rate);
        let v = (after.x_wb.pos - before.x_wb.pos) / (2.0 * h);
        assert!((v - at.twist.fixed_rows::<3>(0)).amax() < 1e-8);
        let spin = (after.x_wb.rot - before.x_wb.rot) * at.x_wb.rot.transpose() / (2.0 * h);
        let omega = Vector3::new(spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]);
        assert!((omega - at.twist.fixed_rows::<3>(3)).amax() < 1e-8, "{omega:?}");
    }

    #[test]
    fn a_following_hand_stays_across_the_flight_and_a_constant_one_does_not_turn() {
        let flight = flight();
        let following = HandLaw { follow: 1.0, roll: [0.3, 2.0, 0.0], tilt: [0.0; 2], yaw: [0.0; 2] };
        let constant = HandLaw::constant(0.3);
        assert!(following.off_across_rad(&flight, 0.2) < 1e-12);
        assert!(constant.off_across_rad(&flight, 0.0) < 1e-12);
        assert!(constant.off_across_rad(&flight, 0.2) > 0.3);
        assert_eq!(constant.at(&flight, 0.0).x_wb.rot, constant.at(&flight, 0.2).x_wb.rot);
        // At zero roll x of the release frame lies in the vertical plane of the flight and points downwards.
        let x = HandLaw::constant(0.0).at(&flight, 0.0).x_wb.rot.column(0).into_owned();
        assert!(x.z < 0.0 && x.dot(&flight.v0.cross(&Vector3::z())).abs() < 1e-12);
    }
}
