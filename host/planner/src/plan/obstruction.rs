//! Why an arm has no throw to any target: a body that something touches in every posture.

use robot_model::JointVec;
use robot_model::collision::Obb;

use super::problem::Problem;
use super::rng::SplitMix64;

/// What touches what in each posture that was tried.
#[derive(Debug, Clone, PartialEq)]
pub enum Obstruction {
    /// An obstacle and a body of the arm.
    ObstacleInArm {
        /// Name of the obstacle.
        obstacle: String,
        /// Name of the body.
        body: String,
        /// Postures that were tried, spread over all joint ranges.
        postures: usize,
    },
    /// The ball in the hand and a body of the hand: the ball cannot leave.
    BallInHand {
        /// Name of the body.
        body: String,
        /// Depth of the overlap in m.
        depth_m: f64,
    },
}

impl std::fmt::Display for Obstruction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::ObstacleInArm { obstacle, body, postures } => write!(
                f,
                "\"{obstacle}\" touches \"{body}\" of the arm in each of {postures} postures over all joint ranges"
            ),
            Self::BallInHand { body, depth_m } => write!(
                f,
                "the ball in the hand overlaps \"{body}\" by {:.1} mm, so it cannot leave",
                depth_m * 1e3
            ),
        }
    }
}

impl Obstruction {
    /// What a person can do about it.
    #[must_use]
    pub fn next_step(&self) -> &'static str {
        match self {
            Self::ObstacleInArm { .. } => "move the obstacle away from the base of the arm",
            Self::BallInHand { .. } => {
                "correct the place or radius of the ball, or that body, in the robot file"
            }
        }
    }
}

/// Postures over the joint ranges. A body that is free in one posture of a thousand is hardly ever missed with this number.
const POSTURES: usize = 1000;
/// Contacts of exactly touching boxes are rounding.
const OVERLAP_MIN_M: f64 = 1e-6;

/// Searches a body that is touched in every posture. `None` only means that no such body was found.
pub(super) fn obstruction(problem: &Problem<'_>) -> Option<Obstruction> {
    ball_in_hand(problem).or_else(|| obstacle_in_arm(problem))
}

fn ball_in_hand(problem: &Problem<'_>) -> Option<Obstruction> {
    if !problem.options.clean_release {
        return None;
    }
    let arm = problem.arm;
    let frames = arm.fk(&JointVec::zeros(arm.n()));
    let ball_w = arm.ball(&frames).pos;
    let hand = arm.collision().boxes().iter().filter(|body| body.link == arm.n());
    let deepest = hand
        .map(|body| {
            let placed = Obb::new(frames.x_w[arm.n() - 1] * body.x_lb, body.half_m);
            (placed.proximity_to_sphere(&ball_w, arm.gripper().ball_radius_m).distance_m, body)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let (distance_m, body) = deepest.filter(|(distance_m, _)| *distance_m < -OVERLAP_MIN_M)?;
    Some(Obstruction::BallInHand { body: body.name.clone(), depth_m: -distance_m })
}

fn obstacle_in_arm(problem: &Problem<'_>) -> Option<Obstruction> {
    if !problem.options.avoid_collisions {
        return None;
    }
    let arm = problem.arm;
    let bodies: Vec<_> = arm.collision().boxes().iter().filter(|body| body.link > 0).collect();
    let obstacles: Vec<Obb> = problem.options.obstacles.iter().map(|o| Obb::new(o.x_wo, o.half_m)).collect();
    // Pairs of obstacle and body that touched in all postures so far.
    let mut left: Vec<(usize, usize)> =
        (0..obstacles.len()).flat_map(|o| (0..bodies.len()).map(move |b| (o, b))).collect();
    let mut rng = SplitMix64::stream(1, 0);
    for _ in 0..POSTURES {
        if left.is_empty() {
            return None;
        }
        let l = &problem.limits;
        let q = JointVec::from_fn(problem.joints(), |j| l.q_min[j] + rng.unit() * (l.q_max[j] - l.q_min[j]));
        let frames = arm.fk(&q);
        left.retain(|&(o, b)| {
            let placed = Obb::new(frames.x_w[bodies[b].link - 1] * bodies[b].x_lb, bodies[b].half_m);
            obstacles[o].overlaps(&placed)
        });
    }
    let &(o, b) = left.first()?;
    Some(Obstruction::ObstacleInArm {
        obstacle: problem.options.obstacles[o].name.clone(),
        body: bodies[b].name.clone(),
        postures: POSTURES,
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use robot_model::Pose;

    use super::*;
    use crate::plan::problem::{Obstacle, Options};
    use crate::throw::Arm;

    fn around(at: [f64; 3], half_m: f64) -> Options {
        let obstacle = Obstacle {
            name: "crate".to_owned(),
            x_wo: Pose::translation(at[0], at[1], at[2]),
            half_m: Vector3::repeat(half_m),
        };
        Options { obstacles: vec![obstacle], ..Options::best() }
    }

    #[test]
    fn an_obstacle_at_the_shoulder_is_named_and_one_beside_the_arm_is_not() {
        let arm = Arm::load("powercube6").expect("built in");
        let find = |options| {
            let problem = Problem::new(&arm, Vector3::new(2.0, 0.5, -1.0), options).expect("valid");
            obstruction(&problem)
        };
        let shoulder = problem_shoulder(&arm);
        let found = find(around(shoulder, 0.03));
        assert!(
            matches!(&found, Some(Obstruction::ObstacleInArm { obstacle, .. }) if obstacle == "crate"),
            "{found:?}"
        );
        assert_eq!(find(around([0.9, 0.9, 0.2], 0.1)), None);
        assert_eq!(find(Options::best()), None);
    }

    fn problem_shoulder(arm: &Arm) -> [f64; 3] {
        let options = Options::best();
        Problem::new(arm, Vector3::new(2.0, 0.5, -1.0), options).expect("valid").shoulder.into()
    }

    #[test]
    fn a_ball_that_is_larger_than_the_gap_of_the_fingers_is_named() {
        let text = robot_model::built_in_text("powercube6").expect("built in");
        let grown = text.replace("ball_radius_m = 0.03", "ball_radius_m = 0.09");
        assert_ne!(text, grown, "the robot file has the radius this test changes");
        let arm = Arm::from_toml("grown.toml", &grown).expect("valid");
        let problem = Problem::new(&arm, Vector3::new(2.0, 0.5, -1.0), Options::best()).expect("valid");
        assert!(
            matches!(obstruction(&problem), Some(Obstruction::BallInHand { depth_m, .. }) if depth_m > 0.01)
        );
    }
}
