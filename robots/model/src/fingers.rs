//! Two parallel fingers that hold a ball: how they grip, and how they open.
//!
//! ```text
//! x(t) = a t² / 2 until the speed v is reached, then on with v, up to x_max      travel of one finger, t since it starts
//! N(d) = N_grip d / d_grip                                                       force of a pad that is pressed in by d
//! ```
//!
//! Forces are given over the mass of the ball, so that no mass is needed.

use nalgebra::Vector3;

/// A two-finger gripper with flat, soft pads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fingers {
    /// Unit normal of the pads in the end-effector frame, from the second finger to the first.
    pub closing_axis_e: Vector3<f64>,
    /// Half edge lengths of a pad in m: along the throw, and across throw and closing axis. The closed pads have their
    /// centres at the ball.
    pub pad_half_m: [f64; 2],
    /// Force of one pad on the held ball over the ball's mass, in m/s².
    pub grip_m_s2: f64,
    /// How far the held ball presses each pad in, in m.
    pub give_m: f64,
    /// Coulomb friction of ball and pad.
    pub friction: f64,
    /// Acceleration of a finger that opens, in m/s².
    pub opening_m_s2: f64,
    /// Its largest speed in m/s.
    pub opening_m_s: f64,
    /// Its whole travel in m.
    pub travel_m: f64,
    /// How much later the second finger starts than the first, in s; negative: earlier.
    pub lag_s: f64,
    /// What is not the same in each opening.
    pub scatter: FingerScatter,
}

/// Standard deviations between one opening and the next.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FingerScatter {
    /// Of the lag in s.
    pub lag_s: f64,
    /// Of the friction, as share of it.
    pub friction_share: f64,
    /// Of the acceleration of the fingers, as share of it.
    pub opening_share: f64,
}

impl FingerScatter {
    /// An opening with deviations, from three independent standard normal numbers: for lag, friction and acceleration.
    #[must_use]
    pub fn deviation(&self, [lag, friction, opening]: [f64; 3]) -> Deviation {
        Deviation {
            lag_s: self.lag_s * lag,
            friction_share: self.friction_share * friction,
            opening_share: self.opening_share * opening,
        }
    }
}

/// What one opening differs in from the usual one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Deviation {
    /// Added to the lag, in s.
    pub lag_s: f64,
    /// Added to the friction, as share of it.
    pub friction_share: f64,
    /// Added to the acceleration of the fingers, as share of it.
    pub opening_share: f64,
}

/// Least factor that a deviation may make: a draw far out makes no finger close.
const FACTOR_MIN: f64 = 0.05;

impl Fingers {
    /// The fingers in an opening that differs by `deviation`; friction and acceleration keep at least a twentieth.
    #[must_use]
    pub fn deviated(&self, deviation: &Deviation) -> Self {
        Self {
            lag_s: self.lag_s + deviation.lag_s,
            friction: self.friction * (1.0 + deviation.friction_share).max(FACTOR_MIN),
            opening_m_s2: self.opening_m_s2 * (1.0 + deviation.opening_share).max(FACTOR_MIN),
            ..*self
        }
    }

    /// Travel in m and speed in m/s of a finger `t_s` after it has started; zero before.
    #[must_use]
    pub fn travel(&self, t_s: f64) -> (f64, f64) {
        let (a, v) = (self.opening_m_s2, self.opening_m_s);
        let t_s = t_s.max(0.0);
        let until_s = v / a;
        let (x, speed) = if t_s < until_s {
            (0.5 * a * t_s * t_s, a * t_s)
        } else {
            (0.5 * v * until_s + v * (t_s - until_s), v)
        };
        if x >= self.travel_m { (self.travel_m, 0.0) } else { (x, speed) }
    }

    /// When each finger starts, in s against the middle of the two: first, second.
    #[must_use]
    pub fn starts_s(&self) -> [f64; 2] {
        [-0.5 * self.lag_s, 0.5 * self.lag_s]
    }

    /// Time from the start of fingers without lag until the pads leave a ball on which no other force acts, in s.
    #[must_use]
    pub fn freeing_s(&self) -> f64 {
        let (a, v, x) = (self.opening_m_s2, self.opening_m_s, self.give_m);
        let until_s = v / a;
        if x <= 0.5 * v * until_s { (2.0 * x / a).sqrt() } else { until_s + (x - 0.5 * v * until_s) / v }
    }

    /// Stiffness of a pad over the mass of the ball, in 1/s².
    #[must_use]
    pub fn stiffness_1_s2(&self) -> f64 {
        self.grip_m_s2 / self.give_m
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Fingers of the tests: 6 N on 30 g, 0.3 mm pressed in, 20 m/s² up to 0.3 m/s.
    pub(crate) fn fingers() -> Fingers {
        Fingers {
            closing_axis_e: Vector3::y(),
            pad_half_m: [0.015, 0.01],
            grip_m_s2: 200.0,
            give_m: 3e-4,
            friction: 0.8,
            opening_m_s2: 20.0,
            opening_m_s: 0.3,
            travel_m: 0.015,
            lag_s: 0.0,
            scatter: FingerScatter::default(),
        }
    }

    #[test]
    fn travel_is_the_integral_of_its_speed_and_ends_at_the_whole_travel() {
        let fingers = fingers();
        let (mut x, h) = (0.0, 1e-6);
        for k in 0..60_000 {
            let t = f64::from(k) * h;
            x += fingers.travel(t + 0.5 * h).1 * h;
            assert!((fingers.travel(t + h).0 - x.min(fingers.travel_m)).abs() < 1e-6, "{t}");
        }
        assert_eq!(fingers.travel(1.0), (fingers.travel_m, 0.0));
        assert_eq!(fingers.travel(-1.0), (0.0, 0.0));
    }

    #[test]
    fn freeing_time_is_when_the_travel_is_what_the_pad_was_pressed_in() {
        for give_m in [1e-4, 3e-4, 3e-3] {
            let fingers = Fingers { give_m, ..fingers() };
            assert!((fingers.travel(fingers.freeing_s()).0 - give_m).abs() < 1e-12);
        }
    }

    #[test]
    fn a_draw_far_out_leaves_fingers_that_open_and_rub() {
        let far = Deviation { friction_share: -3.0, opening_share: -3.0, lag_s: 1e-3 };
        let fingers = fingers().deviated(&far);
        assert!(fingers.friction > 0.0 && fingers.opening_m_s2 > 0.0 && fingers.lag_s == 1e-3);
    }
}
