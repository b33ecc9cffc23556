//! Margins of every limit of a throw, from the throw itself (not from the optimiser's rows).

use super::problem::Problem;
use crate::throw::Throw;
use robot_model::JointVec;

/// How much of each limit is left, per joint, over the whole motion.
///
/// Positions in rad, the others as a share of the limit (1 unused, 0 at the limit, negative beyond).
#[derive(Debug, Clone, PartialEq)]
pub struct Margins {
    /// Distance to the nearer end of the range over the motion, in rad: (2), (3).
    pub position_rad: JointVec,
    /// Speed: (4).
    pub speed: JointVec,
    /// Acceleration: (5).
    pub acceleration: JointVec,
    /// Jerk: (6).
    pub jerk: JointVec,
    /// Motor currents at the release in A with `τ(q_r, q̇_r, 0)`, if the robot file describes drives.
    pub release_currents_a: Option<JointVec>,
    /// Motor currents at the release: (7).
    pub motor: Option<JointVec>,
    /// Supplies at the release: (8), in the order of the robot file.
    pub supply: Vec<f64>,
}

impl Margins {
    /// Margins of a throw against the full limits of the robot (not the share a plan may use).
    #[must_use]
    pub fn of(problem: &Problem<'_>, throw: &Throw) -> Self {
        let arm = problem.arm;
        let n = arm.n();
        let l = |j: usize| arm.joints()[j].limits;
        let (ja, jb) = throw.jerk();
        let peak_speed = throw.peak_speed();
        let peak_acceleration = throw.peak_acceleration();
        let position_rad = JointVec::from_fn(n, |j| {
            let mut nearest = f64::INFINITY;
            let mut phases = vec![-1.0, 0.0, 1.0];
            phases.extend([-1.0, 1.0].into_iter().filter_map(|side| throw.turning_phase(j, side)));
            for sigma in phases {
                let q = throw.at_phase(sigma).q[j];
                nearest = nearest.min(q - l(j).q_min_rad).min(l(j).q_max_rad - q);
            }
            nearest
        });
        let tau = problem.holding().bias_torques(&throw.q_rad, &throw.qd_rad_s);
        let release_currents_a = arm.motor_currents(&throw.qd_rad_s, &tau);
        let motor = release_currents_a.and_then(|i| {
            let drives = arm.drives()?;
            Some(JointVec::from_fn(n, |j| 1.0 - i[j] / drives[j].current_max_a))
        });
        let supply = release_currents_a.map_or_else(Vec::new, |i| {
            arm.supplies()
                .iter()
                .zip(arm.supply_currents(&i))
                .map(|(s, a)| 1.0 - a / s.current_max_a)
                .collect()
        });
        Self {
            position_rad,
            speed: JointVec::from_fn(n, |j| 1.0 - peak_speed[j] / l(j).v_max_rad_s),
            acceleration: JointVec::from_fn(n, |j| 1.0 - peak_acceleration[j] / l(j).a_max_rad_s2),
            jerk: JointVec::from_fn(n, |j| 1.0 - ja[j].abs().max(jb[j].abs()) / l(j).j_max_rad_s3),
            release_currents_a,
            motor,
            supply,
        }
    }

    /// Largest violation; zero if every limit holds.
    #[must_use]
    pub fn violation(&self) -> f64 {
        let mut worst = 0.0_f64;
        let mut see = |v: f64| worst = worst.max(if v.is_nan() { f64::INFINITY } else { -v });
        for j in 0..self.speed.len() {
            see(self.position_rad[j]);
            see(self.speed[j]);
            see(self.acceleration[j]);
            see(self.jerk[j]);
            if let Some(motor) = &self.motor {
                see(motor[j]);
            }
        }
        self.supply.iter().copied().for_each(see);
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::problem::Options;
    use crate::throw::{Arm, Joints};
    use nalgebra::Vector3;

    #[test]
    fn a_heavier_ball_raises_the_currents_at_the_release_by_the_closed_form() {
        let arm = |mass_kg: f64| {
            let text = robot_model::built_in_text("powercube6").unwrap();
            Arm::from_toml("a", &text.replacen("ball_mass_kg = 0", &format!("ball_mass_kg = {mass_kg}"), 1))
                .unwrap()
        };
        let (bare, heavy) = (arm(0.0), arm(0.5));
        let throw = Throw {
            q_rad: Joints::from([0.3, -1.2, -1.4, 0.2, 0.7, 0.1]),
            qd_rad_s: Joints::zeros(6),
            qdd_rad_s2: Joints::zeros(6),
            flight_s: 0.5,
            ha_s: 0.5,
            hb_s: 0.3,
        };
        let currents = |arm: &Arm| {
            let problem = Problem::new(arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).unwrap();
            Margins::of(&problem, &throw).release_currents_a.unwrap()
        };
        let (light_a, heavy_a) = (currents(&bare), currents(&heavy));
        // At rest the ball adds m g times the height that its point gains per radian.
        let frames = bare.fk(&throw.q_rad);
        let jacobian = frames.jacobian(&bare.ball(&frames).pos);
        let bare_nm = bare.gravity_torques(&throw.q_rad);
        let mut more = 0;
        for j in 0..6 {
            let nm = bare_nm[j] + 0.5 * bare.world().gravity_m_s2 * jacobian[(2, j)];
            let expected_a = bare.drives().unwrap()[j].k_m_a_nm * nm.abs();
            assert!(
                (heavy_a[j] - expected_a).abs() < 1e-12,
                "joint {}: {} against {expected_a}",
                j + 1,
                heavy_a[j]
            );
            more += usize::from(heavy_a[j] > light_a[j] + 0.1);
        }
        assert!(more >= 2, "{light_a} {heavy_a}");
    }
}
