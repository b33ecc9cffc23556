//! Statements of a file about its throw, computed again: from the motion, the target, the air, and the request.

use nalgebra::Vector3;
use robot_model::collision::{Obb, Scene};
use robot_model::{JointVec, RobotModel};
use serde::Serialize;
use serde_json::Value;

use super::PlanFile;
use crate::flight::Course;
use crate::plan::local::Found;
use crate::plan::opening::Opening;
use crate::plan::outcome::Best;
use crate::plan::problem::{DelayWindow, Obstacle, Options, Problem};
use crate::throw::Throw;

/// Numbers that differ by less are the same: a share of the number, and a remainder for numbers near zero. The same
/// program computes both, so only rounding separates them.
const SAME_SHARE: f64 = 1e-6;
const SAME: f64 = 1e-9;
/// The same for the predicted landing, for which programs of other versions use other rules (differences of 1.5 %
/// occurred). Nothing else depends on the value in the file.
const PREDICTED_SAME_SHARE: f64 = 0.05;
const PREDICTED_SAME: f64 = 1e-5;
const PREDICTED: [&str; 5] =
    ["mean_m", "covariance_m2", "delay_sensitivity_mm_per_ms", "hit_probability", "sigma_rad"];

impl PlanFile {
    /// What is in the way of the arm beside itself and the floor, with the ball in the hand.
    #[must_use]
    pub fn scene(&self) -> Scene {
        let boxes = self.obstacles.iter().map(|o| (o.name.clone(), Obb::new(o.pose(), o.half_m.into())));
        Scene { obstacles: boxes.collect(), ball_held: true }
    }

    /// Whether the file claims a check whose text has this word.
    #[must_use]
    pub fn claims(&self, word: &str) -> bool {
        self.checks.iter().any(|c| c.enforced && c.what.contains(word))
    }

    /// The same plan with everything that follows from its motion, its target, its air and its noise computed
    /// again, by the functions that make plans. Its data about the search and about its checks stay. `None`: this
    /// motion cannot be a plan.
    #[must_use]
    pub fn computed_again(&self, arm: &RobotModel) -> Option<Self> {
        let problem = Problem::new(arm, self.target.position_m.into(), self.asked()).ok()?;
        let list =
            |numbers: &[f64]| JointVec::from_fn(arm.n(), |j| numbers.get(j).copied().unwrap_or(f64::NAN));
        let mut throw = Throw {
            q_rad: list(&self.release.q_rad),
            qd_rad_s: list(&self.release.qd_rad_s),
            qdd_rad_s2: list(&self.release.qdd_rad_s2),
            flight_s: 0.0,
            ha_s: self.release_time_s,
            hb_s: self.end_time_s - self.release_time_s,
        };
        let (p, v) = throw.ball_at_release(arm);
        throw.flight_s = problem.flight.meet(&p, &v, &problem.aim, 0.0)?.time_s;
        let best = Best::alone(Found {
            throw,
            objective: 0.0,
            iterations: 0,
            slope_per_m: Vector3::zeros(),
            touches: false,
        });
        let (noise, region) = (&self.landing.noise, self.target.region);
        let made = Self::of(&problem, &best, &self.robot.source, self.search.seed, noise, region)?;
        let mut again =
            Self { version: self.version, search: self.search.clone(), checks: self.checks.clone(), ..made };
        if self.landing.delay_shifts.is_empty() {
            // A file of version 1.
            again.landing.delay_shifts.clear();
        }
        Some(again)
    }

    /// The request, as far as the file contains it.
    fn asked(&self) -> Options {
        let windows = self.landing.delay_shifts.iter();
        let windows =
            windows.filter_map(|s| Some(DelayWindow { delay_s: s.delay_s, shift_m: s.limit_m? })).collect();
        let obstacles = self.obstacles.iter();
        let obstacles =
            obstacles.map(|o| Obstacle { name: o.name.clone(), x_wo: o.pose(), half_m: o.half_m.into() });
        Options {
            weights: self.objective.weights,
            speed_use: self.search.speed_use,
            acceleration_use: self.search.acceleration_use,
            free_spin: true,
            null_delay: self.claims("unmoved by a late release"),
            delay_windows: windows,
            current_over_motion: self.claims("currents over the motion"),
            avoid_collisions: self.claims("clearance of arm"),
            clean_release: self.claims("clearance of the released ball"),
            clearance_m: self.search.clearance_m,
            drag_per_m: self.landing.drag_per_m,
            finger_release: self.landing.fingers.is_some(),
            magnus_rad_s: self.landing.magnus_rad_s.into(),
            obstacles: obstacles.collect(),
            opening: self.target.opening.map(|o| Opening {
                normal: o.normal.into(),
                radius_m: o.radius_m,
                incidence_max_rad: o.incidence_max_rad,
            }),
            course: Course::new(&self.target.course).unwrap_or_default(),
            ..Options::of(self.search.form)
        }
    }

    /// The first statement of the file that differs from the computed value.
    #[must_use]
    pub fn false_claim(&self, arm: &RobotModel) -> Option<String> {
        let Some(again) = self.computed_again(arm) else {
            return Some(
                "no plan is made of this motion: its options are refused, or its ball does not come down"
                    .to_owned(),
            );
        };
        first_difference(self, &again)
    }

    /// Ranges of numbers that the types cannot express and that do not follow from the motion.
    pub(super) fn ranges(&self) -> Result<(), String> {
        let (s, noise) = (&self.search, &self.landing.noise);
        let bounded = [
            ("search.clearance_m", s.clearance_m, 1.0),
            ("search.hand_clearance_m", s.hand_clearance_m, 1.0),
            ("search.speed_use", s.speed_use, 1.0),
            ("search.acceleration_use", s.acceleration_use, 1.0),
            ("search.confidence.better_chance", s.confidence.map_or(0.0, |c| c.better_chance), 1.0),
            ("search.confidence.gap_share", s.confidence.map_or(0.0, |c| c.gap_share), f64::MAX),
            ("landing.noise.release_time_s", noise.release_time_s, 1.0),
            ("landing.noise.position_rad", noise.position_rad, 1.0),
            ("landing.noise.speed_rad_s", noise.speed_rad_s, 10.0),
            ("landing.noise.drag_per_m", noise.drag_per_m, 10.0),
        ];
        if let Some((name, value, most)) = bounded.into_iter().find(|(_, v, most)| !(0.0..=*most).contains(v))
        {
            return Err(format!("{name} = {value} is outside 0 to {most}"));
        }
        if noise.release_nodes.is_some_and(|nodes| !nodes.is_valid()) {
            return Err("landing.noise.release_nodes: not delays with weights that add up to one".to_owned());
        }
        let ended = s.confidence.map_or(0, |c| c.at_best.max(c.distinct));
        if s.solved > s.starts || ended > s.starts {
            return Err(format!("its search found {} throws in {} starts, {ended} ends", s.solved, s.starts));
        }
        Ok(())
    }
}

/// The first number of a plan that differs from the plan computed again, with both values.
pub(crate) fn first_difference<T: Serialize>(reported: &T, again: &T) -> Option<String> {
    // Plans are numbers, text and lists of them.
    let json = |plan: &T| serde_json::to_value(plan).unwrap_or_default();
    difference(&json(reported), &json(again), "")
}

/// Where the first of two values differs from the second, with both.
fn difference(reported: &Value, found: &Value, at: &str) -> Option<String> {
    let below =
        |key: &dyn std::fmt::Display| if at.is_empty() { key.to_string() } else { format!("{at}.{key}") };
    match (reported, found) {
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => {
            a.iter().zip(b.values()).find_map(|((key, a), b)| difference(a, b, &below(key)))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(k, (a, b))| difference(a, b, &below(&k)))
        }
        _ => {
            let (same, share) = if PREDICTED.iter().any(|name| at.contains(name)) {
                (PREDICTED_SAME, PREDICTED_SAME_SHARE)
            } else {
                (SAME, SAME_SHARE)
            };
            let same = match reported.as_f64().zip(found.as_f64()) {
                Some((a, b)) => (a - b).abs() <= same + share * a.abs().max(b.abs()),
                None => reported == found,
            };
            (!same).then(|| format!("{at}: {reported}, not {found}"))
        }
    }
}
