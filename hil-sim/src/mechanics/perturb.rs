//! How far this arm is from its model, drawn from a seed: for robustness studies.

use protocol::Duration;

use crate::rng::Rng;

/// Half widths of the uniform distributions around the nominal values. All zero by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scatter {
    /// Mass and inertia of each link, share of the nominal value (0.1 is ± 10 %).
    pub mass_share: f64,
    /// Centre of mass of each link, m, in each direction.
    pub com_m: f64,
    /// Coulomb and viscous friction of each joint, share.
    pub friction_share: f64,
    /// Rotor inertia of each joint, share.
    pub rotor_share: f64,
    /// K_B and K_M of each drive, share.
    pub current_share: f64,
    /// Processing delay of each drive, share.
    pub delay_share: f64,
    /// Error of each joint's zero position after homing, rad.
    pub home_rad: f64,
    pub gripper_delay: Duration,
}

/// One joint's deviations: factors around 1, and offsets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointDeviation {
    /// Factor on mass and inertia.
    pub mass: f64,
    /// Shift of the centre of mass, m.
    pub com_m: [f64; 3],
    /// Factor on friction.
    pub friction: f64,
    /// Factor on rotor inertia.
    pub rotor: f64,
    /// Factor on K_B and K_M.
    pub current: f64,
    /// Factor on the processing delay.
    pub delay: f64,
    /// Zero position error, rad.
    pub home_rad: f64,
}

impl Scatter {
    /// Deviations of joint `index`: a stream of its own, so that one more joint changes no other.
    ///
    /// Factors are kept at or above 0.05, so that no draw makes a mass vanish.
    pub fn draw(&self, seed: u64, index: usize) -> JointDeviation {
        let mut rng = Rng::stream(seed, &format!("plant joint {index}"));
        let mut even = |half: f64| half * (2.0 * rng.unit() - 1.0);
        let mass = (1.0 + even(self.mass_share)).max(0.05);
        let com_m = [even(self.com_m), even(self.com_m), even(self.com_m)];
        let mut factor = |half: f64| (1.0 + even(half)).max(0.05);
        let (friction, rotor) = (factor(self.friction_share), factor(self.rotor_share));
        let (current, delay) = (factor(self.current_share), factor(self.delay_share));
        JointDeviation { mass, com_m, friction, rotor, current, delay, home_rad: even(self.home_rad) }
    }

    /// Delay of the gripper around `nominal`, not below zero.
    pub fn draw_gripper_delay(&self, seed: u64, nominal: Duration) -> Duration {
        let half = self.gripper_delay.as_micros();
        let drawn = Rng::stream(seed, "plant gripper").within(0, half.saturating_mul(2));
        (nominal + Duration::from_micros(drawn)).saturating_sub(self.gripper_delay)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_scatter_is_the_model_itself() {
        let joint = Scatter::default().draw(7, 3);
        let ones = [joint.mass, joint.friction, joint.rotor, joint.current, joint.delay];
        assert_eq!((ones, joint.com_m, joint.home_rad), ([1.0; 5], [0.0; 3], 0.0));
        let nominal = Duration::from_millis(20);
        assert_eq!(Scatter::default().draw_gripper_delay(7, nominal), nominal);
    }

    #[test]
    fn draws_stay_inside_their_half_width_reach_both_halves_and_repeat() {
        let scatter = Scatter { mass_share: 0.1, home_rad: 0.002, ..Scatter::default() };
        let draws: Vec<_> = (0..200).map(|seed| scatter.draw(seed, 0)).collect();
        assert!(draws.iter().all(|d| (0.9..=1.1).contains(&d.mass) && d.home_rad.abs() <= 0.002));
        assert!(draws.iter().any(|d| d.mass < 0.93) && draws.iter().any(|d| d.mass > 1.07));
        assert_eq!(scatter.draw(5, 2), scatter.draw(5, 2));
        assert_ne!(scatter.draw(5, 2), scatter.draw(5, 1));
    }
}
