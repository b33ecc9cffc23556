//! Whether arm, hand, floor and ball stay clear of each other.

use nalgebra::Vector3;
use robot_model::Frames;
use robot_model::collision::{CollisionChecker, MotionVerdict, Scene, Travel};
use serde::{Deserialize, Serialize};

use super::limits::{AXES, Arm, Axes};
use super::motion::FollowMotion;
use super::parabola::Parabola;

/// Distances to keep.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Margins {
    /// Height of flange, elbow and the ball's centre in the fingers above the floor, in m.
    pub floor_m: f64,
    /// Distance between boxes of the arm, in m.
    pub boxes_m: f64,
    /// How much nearer than in the grip the ball may come to the hand after the release, in m.
    pub grip_slack_m: f64,
}

impl Default for Margins {
    fn default() -> Self {
        Self { floor_m: 0.1, boxes_m: 0.002, grip_slack_m: 0.001 }
    }
}

/// What is not clear.
#[derive(Debug, Clone, PartialEq)]
pub enum Contact {
    /// Flange, elbow or the ball's centre in the fingers is below its height above the floor.
    Floor {
        /// Time from the first step on the parabola, in s.
        t_s: f64,
        /// Height above the floor in m.
        height_m: f64,
    },
    /// Two bodies touch.
    Boxes {
        /// Time from the first step on the parabola, in s.
        t_s: f64,
        /// Names of both.
        bodies: [String; 2],
    },
    /// The flying ball meets arm or hand.
    Ball {
        /// Time from the first step on the parabola, in s.
        t_s: f64,
        /// What it meets.
        body: String,
        /// Distance in m, negative inside.
        distance_m: f64,
    },
}

/// Arm with and without the ball in its hand.
#[derive(Debug)]
pub struct Clear<'m> {
    arm: &'m Arm,
    margins: Margins,
    held: CollisionChecker<'m>,
    empty: CollisionChecker<'m>,
    /// Distance of the held ball to the nearest box; the same in every posture.
    grip_m: f64,
}

/// The scenes of [`Clear`]; made before it, because it borrows them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scenes {
    held: Scene,
    empty: Scene,
}

impl Scenes {
    /// Without obstacles.
    #[must_use]
    pub fn new() -> Self {
        Self { held: Scene { ball_held: true, ..Scene::default() }, empty: Scene::default() }
    }
}

/// Intervals in which bodies approach by less than this without being proven clear count as contact, in m.
const TOLERANCE_M: f64 = 1e-4;
/// Instants per period at which the flying ball is tested.
const BALL_TESTS: usize = 3;

impl<'m> Clear<'m> {
    /// Tests for an arm.
    #[must_use]
    pub fn new(arm: &'m Arm, scenes: &'m Scenes, margins: Margins) -> Self {
        let held = CollisionChecker::new(arm, &scenes.held);
        let mut empty = CollisionChecker::new(arm, &scenes.empty);
        let frames = arm.fk(&Axes::zeros(AXES));
        let grip_m = empty.ball_clearance(&frames, &arm.ball(&frames).pos).distance_m;
        Self { arm, margins, held, empty, grip_m }
    }

    #[must_use]
    pub fn margins(&self) -> &Margins {
        &self.margins
    }

    /// Height of the lowest of flange, elbow (the axis of joint 3) and the ball's centre in the fingers above the floor, in m.
    #[must_use]
    pub fn height_m(&self, frames: &Frames) -> f64 {
        let places = [self.arm.ee(frames).pos.z, frames.origin(2).z, self.arm.ball(frames).pos.z];
        places.into_iter().fold(f64::INFINITY, f64::min) - self.arm.world().floor_z_m
    }

    /// Distance of the nearest pair of bodies, in m, at most `most_m`: arm, floor, and the ball or the fingers.
    #[must_use]
    pub(crate) fn distance_m(&mut self, frames: &Frames, held: bool, most_m: f64) -> f64 {
        if held {
            self.held.distance_up_to(frames, most_m)
        } else {
            self.empty.distance_up_to(frames, most_m).min(self.fingers_m(frames))
        }
    }

    /// Height of the fingers above the floor, in m: they reach around the ball, also when it has left them. They
    /// have no boxes, because the ball would touch them.
    fn fingers_m(&self, frames: &Frames) -> f64 {
        let low_m = self.arm.ball(frames).pos.z - self.arm.gripper().ball_radius_m;
        low_m - self.arm.world().floor_z_m
    }

    /// Distance of the free ball at `center` from arm and hand beyond the required one, in m; negative is a contact.
    #[must_use]
    pub(crate) fn ball_spare_m(&mut self, frames: &Frames, center: &Vector3<f64>) -> f64 {
        self.empty.ball_clearance(frames, center).distance_m - (self.grip_m - self.margins.grip_slack_m)
    }

    /// The first contact of a motion; `flight` has t = 0 at the first step on the parabola and ends at `landing_s`.
    ///
    /// Boxes are proven clear also between the steps (joints move in straight lines from step to step). The ball is
    /// held until the last step on the parabola and flies on from there: a gripper that opens earlier gives the
    /// same flight.
    pub fn first_contact(
        &mut self,
        motion: &FollowMotion,
        flight: &Parabola,
        landing_s: f64,
    ) -> Option<Contact> {
        for (k, state) in motion.states.iter().enumerate() {
            let frames = self.arm.fk(&state.q);
            let (height_m, fingers_m) = (self.height_m(&frames), self.fingers_m(&frames));
            if height_m < self.margins.floor_m || fingers_m < 0.0 {
                return Some(Contact::Floor { t_s: motion.time_s(k), height_m: height_m.min(fingers_m) });
            }
        }
        let path = Steps(&motion.states.iter().map(|s| s.q).collect::<Vec<_>>());
        let (first, last, end) = (0.0, motion.last as f64, (motion.states.len() - 1) as f64);
        for (from, to, held) in [(first, last, true), (last, end, false)] {
            let checker = if held { &mut self.held } else { &mut self.empty };
            if let MotionVerdict::Contact { s, clearance } =
                checker.check_motion(&path, from, to, TOLERANCE_M)
            {
                let bodies = [clearance.a, clearance.b].map(|b| checker.name(b).to_string());
                return Some(Contact::Boxes { t_s: (s - motion.first as f64) * motion.period_s, bodies });
            }
        }
        let step_s = motion.period_s / BALL_TESTS as f64;
        let tests = ((landing_s - motion.time_s(motion.last)) / step_s).ceil().max(0.0) as usize;
        for k in 1..=tests {
            let t_s = motion.time_s(motion.last) + k as f64 * step_s;
            let frames = self.arm.fk(&path.at(motion.first as f64 + t_s / motion.period_s));
            let center = flight.position(t_s);
            let near = self.empty.ball_clearance(&frames, &center);
            if near.distance_m < self.grip_m - self.margins.grip_slack_m {
                let body = self.empty.name(near.a).to_string();
                return Some(Contact::Ball { t_s, body, distance_m: near.distance_m });
            }
        }
        None
    }
}

/// A path given by its steps, joined by straight lines; the parameter is the step number.
struct Steps<'a>(&'a [Axes]);

impl Travel for Steps<'_> {
    fn at(&self, s: f64) -> Axes {
        let end = self.0.len() - 1;
        let s = s.clamp(0.0, end as f64);
        let k = (s.floor() as usize).min(end.saturating_sub(1));
        let next = (k + 1).min(end);
        self.0[k] + (self.0[next] - self.0[k]) * (s - k as f64)
    }

    fn path_length(&self, s0: f64, s1: f64) -> Axes {
        let mut length = Axes::zeros(AXES);
        let mut from = s0;
        while from < s1 {
            let to = (from.floor() + 1.0).min(s1);
            length += (self.at(to) - self.at(from)).abs();
            from = to;
        }
        length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_along_steps_is_the_sum_of_the_ways_of_the_joints() {
        let at = |q: f64| Axes::repeat(AXES, q);
        let steps = [at(0.0), at(1.0), at(0.5), at(0.5)];
        let path = Steps(&steps);
        assert_eq!(path.at(1.5), at(0.75));
        assert_eq!(path.at(7.0), at(0.5));
        assert_eq!(path.path_length(0.0, 3.0), at(1.5));
        assert_eq!(path.path_length(0.5, 1.5), at(0.75));
    }

    #[test]
    fn fingers_without_a_ball_stay_above_the_floor_like_the_ball_in_them() {
        let arm = Arm::load("kr16_2").unwrap();
        let scenes = Scenes::new();
        let mut clear = Clear::new(&arm, &scenes, Margins::default());
        let mut boxes_alone_are_clear = 0;
        for k in 0..400 {
            let u = |n: f64| (f64::from(k) * n).fract();
            let (q2, q3, q5) = (0.6 * u(0.618), 1.6 * u(0.414), 1.5 * u(0.732));
            let frames = arm.fk(&Axes::from([0.0, q2, q3, 0.0, q5, 0.0]));
            let low_m = arm.ball(&frames).pos.z - arm.gripper().ball_radius_m;
            assert!(clear.distance_m(&frames, false, f64::INFINITY) <= low_m);
            boxes_alone_are_clear +=
                u32::from(low_m < 0.0 && clear.empty.clearance(&frames).distance_m > 0.0);
        }
        assert!(boxes_alone_are_clear > 0, "the fingers decide at least once");
    }
}
