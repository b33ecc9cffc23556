//! Search space of the release: the paper's `h_min` and `h_max`, or the region that the robot's workspace and limits allow.

use robot_model::RobotModel;
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::options::{AskedBounds, Form};

/// Search space of the release.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    /// Azimuth θ of the ball seen from the shoulder in rad; `None`: any.
    pub azimuth_rad: Option<RangeInclusive<f64>>,
    /// Elevation φ of the ball seen from the shoulder in rad.
    pub elevation_rad: RangeInclusive<f64>,
    /// Distance r of the ball from the shoulder in m.
    pub radius_m: RangeInclusive<f64>,
    /// Angular velocity ω of the hand about the throw in rad/s (paper's form only).
    pub spin_rad_s: RangeInclusive<f64>,
    /// Time of flight F in s.
    pub flight_s: RangeInclusive<f64>,
    /// Duration H_s of the movement in s.
    pub duration_s: RangeInclusive<f64>,
    /// Braking ratio d_r.
    pub braking_ratio: RangeInclusive<f64>,
}

/// Reach of the paper's arm as [`reach_m`] bounds it, in m.
const PAPER_REACH_M: f64 = 1.102;
/// An arm whose reach is this near to that of the paper's arm has the paper's bounds in the paper's form.
const PAPER_REACH_SHARE: f64 = 0.05;
/// A release nearer to the shoulder than this share of the reach is useless: the hand hardly moves there.
const RADIUS_MIN_SHARE: f64 = 0.15;
/// Shortest flight and motion, in s.
const FLIGHT_MIN_S: f64 = 0.1;
const DURATION_MIN_S: f64 = 0.1;
/// A joint that crosses its range on a parabola of speed takes this multiple of the range over its largest speed.
const PARABOLA: f64 = 1.5;
/// A parabola of speed up to v takes 2 v/a to rise and 2 v/a to fall.
const RISE_AND_FALL: f64 = 4.0;

impl Bounds {
    /// The paper's; with its θ in [-π/2, π/2] replaced by any azimuth, so that targets behind the arm are not lost
    /// (joint 1 limits the azimuth anyway). No optimum of the published targets lies on that bound.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            azimuth_rad: None,
            elevation_rad: -PI / 2.5..=FRAC_PI_2,
            radius_m: 0.5..=1.0,
            spin_rad_s: -FRAC_PI_2..=FRAC_PI_2,
            flight_s: 0.3..=3.0,
            duration_s: 0.2..=2.0,
            braking_ratio: 0.04..=0.4,
        }
    }

    /// Region that workspace and limits of the robot allow: no throw of this arm beyond these bounds can be better.
    ///
    /// `shoulder` is the centre of the spherical coordinates in m, world.
    #[must_use]
    pub fn of_robot(arm: &RobotModel, shoulder: &Vector3<f64>) -> Self {
        let reach_m = reach_m(arm);
        let gravity = arm.world().gravity_m_s2;
        let limits = |j: usize| arm.joints()[j].limits;
        let ball_speed: f64 =
            (0..arm.n()).map(|j| limits(j).v_max_rad_s * arm.collision().ball_swing_m(j)).sum();
        let drop_m = (shoulder.z + reach_m - arm.world().floor_z_m).max(0.0);
        let flight_s = (ball_speed + (ball_speed * ball_speed + 2.0 * gravity * drop_m).sqrt()) / gravity;
        let duration_s = (0..arm.n())
            .map(|j| {
                let l = limits(j);
                let across_s = PARABOLA * (l.q_max_rad - l.q_min_rad) / l.v_max_rad_s;
                across_s.max(RISE_AND_FALL * l.v_max_rad_s / l.a_max_rad_s2)
            })
            .fold(0.0, f64::max);
        Self {
            azimuth_rad: None,
            elevation_rad: -FRAC_PI_2..=FRAC_PI_2,
            radius_m: RADIUS_MIN_SHARE * reach_m..=reach_m,
            spin_rad_s: -limits(arm.n() - 1).v_max_rad_s..=limits(arm.n() - 1).v_max_rad_s,
            flight_s: FLIGHT_MIN_S..=flight_s.max(2.0 * FLIGHT_MIN_S),
            duration_s: DURATION_MIN_S..=duration_s.max(2.0 * DURATION_MIN_S),
            braking_ratio: 0.04..=0.6,
        }
    }

    /// Bounds of a form for an arm, unless others are requested.
    ///
    /// The paper states its bounds for its own arm. An arm of another size has its own in the paper's form too.
    #[must_use]
    pub fn of(form: Form, arm: &RobotModel, shoulder: &Vector3<f64>) -> Self {
        let same_size = (reach_m(arm) / PAPER_REACH_M - 1.0).abs() <= PAPER_REACH_SHARE;
        if form == Form::Paper && same_size { Self::paper() } else { Self::of_robot(arm, shoulder) }
    }

    /// The same with the requested bounds in their place.
    #[must_use]
    pub fn with(self, asked: &AskedBounds) -> Self {
        let or = |asked: &Option<RangeInclusive<f64>>, own| asked.clone().unwrap_or(own);
        Self {
            azimuth_rad: asked.azimuth_rad.clone().or(self.azimuth_rad),
            elevation_rad: or(&asked.elevation_rad, self.elevation_rad),
            radius_m: or(&asked.radius_m, self.radius_m),
            spin_rad_s: or(&asked.spin_rad_s, self.spin_rad_s),
            flight_s: or(&asked.flight_s, self.flight_s),
            duration_s: or(&asked.duration_s, self.duration_s),
            braking_ratio: or(&asked.braking_ratio, self.braking_ratio),
        }
    }
}

/// Bound on the distance of the ball from the axis of joint 2, in m: the links in a row.
fn reach_m(arm: &RobotModel) -> f64 {
    arm.collision().ball_swing_m(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::throw::Arm;

    #[test]
    fn bounds_of_the_papers_arm_contain_the_papers_and_follow_the_size_of_an_arm() {
        let arm = Arm::load("powercube6").expect("built in");
        let shoulder = Vector3::new(0.0, 0.0, 0.27);
        assert!((reach_m(&arm) - PAPER_REACH_M).abs() < 0.02, "{}", reach_m(&arm));
        let (own, paper) = (Bounds::of_robot(&arm, &shoulder), Bounds::paper());
        assert_eq!(Bounds::of(Form::Paper, &arm, &shoulder), paper);
        for (name, own, paper) in [
            ("radius", &own.radius_m, &paper.radius_m),
            ("duration", &own.duration_s, &paper.duration_s),
            ("braking", &own.braking_ratio, &paper.braking_ratio),
            ("elevation", &own.elevation_rad, &paper.elevation_rad),
        ] {
            assert!(own.start() <= paper.start() && own.end() >= paper.end(), "{name}: {own:?}");
        }
        let large = Arm::load("kr16_2").expect("built in");
        let large = Bounds::of_robot(&large, &Vector3::new(0.0, 0.0, 0.675));
        assert!(*large.radius_m.end() > 1.4 && *large.radius_m.end() < 1.9, "{:?}", large.radius_m);
    }
}
