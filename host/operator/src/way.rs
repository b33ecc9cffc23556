//! From rest to rest at reduced speed, around everything in the way.
//!
//! The straight line in joint space is taken if it is proven free, ball in the hand included. Else two trees
//! grow towards each other through free space (Kuffner, LaValle, "RRT-Connect: an efficient approach to single-query
//! path planning", 2000), and the path is shortened. The arm rests at every corner: slow, but never beside the path.

use robot_model::collision::{Body, CollisionChecker, MotionVerdict, Scene, StraightMove};

use planner::motion::{Knot, Motion};
use planner::plan::rng::SplitMix64;
use planner::plan::{Arm, Joints};

/// Bodies that come nearer than this count as touching, m.
const TOLERANCE_M: f64 = 1e-3;
/// Largest step of a tree in one joint, rad.
const STEP_RAD: f64 = 0.4;
/// Points that are tried before giving up.
const SAMPLES_MAX: usize = 4_000;
/// Tries to cut a corner off.
const CUTS: usize = 60;
/// Distance from the ends of the joint ranges at corners, rad.
const MARGIN_RAD: f64 = 0.03;
/// Shortest leg, s.
const LEG_MIN_S: f64 = 0.2;
/// A pose nearer than this is reached, rad.
pub const THERE_RAD: f64 = 1e-3;

/// How an arm goes from one rest to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Travel {
    /// Share of the robot's speeds and accelerations.
    pub share: f64,
    /// Seed for ways around obstacles.
    pub seed: u64,
    /// Least and largest angles of corners, rad; `None`: the ranges of the joints, less a margin. Between two corners each joint
    /// moves one way only, so the whole way is inside if both ends are.
    pub range: Option<(Joints, Joints)>,
}

impl Default for Travel {
    fn default() -> Self {
        Self { share: 0.3, seed: 1, range: None }
    }
}

/// Why there is no way.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoWay {
    /// One end touches something or is no pose of this arm.
    #[error("at {} {what}\n  next: jog the arm free with `cubectl jog`", if *.at_start { "its present pose the arm" } else { "the end of the motion the arm" })]
    Blocked {
        at_start: bool,
        /// What is wrong there.
        what: String,
    },
    /// None was found.
    #[error(
        "no free way to the start of the plan was found in {SAMPLES_MAX} tries\n  next: jog the arm nearer to it, or plan another throw"
    )]
    NotFound,
}

/// Motion of an arm that rests at `from` to rest at `to` (rad), clear of everything in `scene`; `None` if it is there.
///
/// # Errors
/// [`NoWay`].
pub fn way(
    arm: &Arm,
    scene: &Scene,
    travel: &Travel,
    from: &Joints,
    to: &Joints,
) -> Result<Option<Motion>, NoWay> {
    if (from - to).amax() < THERE_RAD {
        return Ok(None);
    }
    let margin = Joints::repeat(arm.n(), MARGIN_RAD);
    let range = travel.range.unwrap_or((arm.q_min() + margin, arm.q_max() - margin));
    let mut space =
        Space { checker: CollisionChecker::new(arm, scene), rng: SplitMix64::new(travel.seed), range };
    for (q, at_start) in [(from, true), (to, false)] {
        if !q.iter().all(|x| x.is_finite()) || !arm.in_range(q, 0.02) {
            let what = "is outside its joint ranges".to_owned();
            return Err(NoWay::Blocked { at_start, what });
        }
        if let Some((a, b)) = space.checker.first_contact(&arm.fk(q)) {
            let what = format!("touches something: {} and {}", name(arm, a), name(arm, b));
            return Err(NoWay::Blocked { at_start, what });
        }
    }
    let corners = if space.is_free(from, to) {
        vec![*from, *to]
    } else {
        let path = space.connect(from, to).ok_or(NoWay::NotFound)?;
        space.shorten(path)
    };
    Ok(Some(timed(arm, &corners, travel.share)))
}

fn name(arm: &Arm, body: Body) -> String {
    match body {
        Body::Box(index) => {
            arm.collision().boxes().get(index).map_or_else(|| "?".to_owned(), |b| b.name.clone())
        }
        Body::Obstacle(index) => format!("obstacle {}", index + 1),
        Body::Floor => "floor".to_owned(),
        Body::Ball => "ball".to_owned(),
    }
}

/// Rest at every corner; between two of them `q = a + (b - a)(3 s² - 2 s³)`, peak speed 1.5 and peak acceleration 6
/// times the way over the duration and its square.
fn timed(arm: &Arm, corners: &[Joints], share: f64) -> Motion {
    let (v_max, a_max) = (arm.limit(|l| l.v_max_rad_s) * share, arm.limit(|l| l.a_max_rad_s2) * share);
    let mut t_s = 0.0;
    let rest = |t_s, q_rad| Knot { t_s, q_rad, qd_rad_s: Joints::zeros(arm.n()) };
    let mut knots = Vec::new();
    if let Some(first) = corners.first() {
        knots.push(rest(0.0, *first));
    }
    for leg in corners.windows(2) {
        let way = (leg[1] - leg[0]).abs();
        let slowest = way
            .iter()
            .zip(v_max.iter().zip(a_max.iter()))
            .map(|(way, (v, a))| (1.5 * way / v).max((6.0 * way / a).sqrt()))
            .fold(LEG_MIN_S, f64::max);
        t_s += slowest;
        knots.push(rest(t_s, leg[1]));
    }
    Motion { knots, events: Vec::new() }
}

/// Joint space with what is free in it.
struct Space<'a> {
    checker: CollisionChecker<'a>,
    rng: SplitMix64,
    /// Least and largest angles of corners.
    range: (Joints, Joints),
}

/// Poses with the index of the one each was reached from.
struct Tree {
    nodes: Vec<(Joints, usize)>,
}

impl Tree {
    fn nearest(&self, q: &Joints) -> usize {
        let distance = |node: &(Joints, usize)| (node.0 - q).norm_squared();
        let by_distance =
            |a: &usize, b: &usize| distance(&self.nodes[*a]).total_cmp(&distance(&self.nodes[*b]));
        (0..self.nodes.len()).min_by(by_distance).unwrap_or(0)
    }

    /// From the root to `index`.
    fn branch(&self, mut index: usize) -> Vec<Joints> {
        let mut branch = vec![self.nodes[index].0];
        while index != 0 {
            index = self.nodes[index].1;
            branch.push(self.nodes[index].0);
        }
        branch.reverse();
        branch
    }
}

impl Space<'_> {
    fn is_free(&mut self, from: &Joints, to: &Joints) -> bool {
        let motion = StraightMove { from: *from, to: *to };
        matches!(self.checker.check_motion(&motion, 0.0, 1.0, TOLERANCE_M), MotionVerdict::Free { .. })
    }

    fn sample(&mut self) -> Joints {
        let (low, high) = self.range;
        Joints::from_fn(low.len(), |j| low[j] + (high[j] - low[j]) * self.rng.unit())
    }

    /// One step of `tree` towards `goal`; the index of the new node.
    fn extend(&mut self, tree: &mut Tree, goal: &Joints) -> Option<usize> {
        let near = tree.nearest(goal);
        let from = tree.nodes[near].0;
        let way = goal - from;
        let reach = way.amax();
        let to = if reach > STEP_RAD { from + way * (STEP_RAD / reach) } else { *goal };
        if !self.is_free(&from, &to) {
            return None;
        }
        tree.nodes.push((to, near));
        Some(tree.nodes.len() - 1)
    }

    fn connect(&mut self, from: &Joints, to: &Joints) -> Option<Vec<Joints>> {
        let mut trees = [Tree { nodes: vec![(*from, 0)] }, Tree { nodes: vec![(*to, 0)] }];
        for round in 0..SAMPLES_MAX {
            let (a, b) = (round % 2, 1 - round % 2);
            let sample = self.sample();
            let Some(new) = self.extend(&mut trees[a], &sample) else { continue };
            let meeting = trees[a].nodes[new].0;
            // The other tree comes as far as it can.
            while let Some(index) = self.extend(&mut trees[b], &meeting) {
                if trees[b].nodes[index].0 == meeting {
                    let mut path = trees[a].branch(new);
                    let mut rest = trees[b].branch(index);
                    rest.pop();
                    rest.reverse();
                    path.append(&mut rest);
                    if a == 1 {
                        path.reverse();
                    }
                    return Some(path);
                }
            }
        }
        None
    }

    /// Takes out what a straight line can replace.
    fn shorten(&mut self, mut path: Vec<Joints>) -> Vec<Joints> {
        for _ in 0..CUTS {
            if path.len() <= 2 {
                break;
            }
            let pick = |space: &mut Self, n: usize| (space.rng.unit() * n as f64) as usize % n;
            let (a, b) = (pick(self, path.len()), pick(self, path.len()));
            let (a, b) = (a.min(b), a.max(b));
            if b - a >= 2 && self.is_free(&path[a].clone(), &path[b].clone()) {
                path.drain(a + 1..b);
            }
        }
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planner::motion::Sample;

    fn arm() -> Arm {
        Arm::load("powercube6").unwrap()
    }

    fn deg(q: [f64; 6]) -> Joints {
        Joints::from(q.map(f64::to_radians))
    }

    fn slow(seed: u64) -> Travel {
        Travel { share: 0.3, seed, range: None }
    }

    fn clear_all_along(arm: &Arm, scene: &Scene, motion: &Motion) {
        let mut checker = CollisionChecker::new(arm, scene);
        for i in 0..=2_000 {
            let Sample { q, qd, .. } = motion.at(motion.duration_s() * f64::from(i) / 2_000.0);
            assert!(!checker.collides(&arm.fk(&q)), "at {i}: {q:?}");
            assert!(arm.in_range(&q, 1e-9));
            for (v, limit) in qd.iter().zip(arm.limit(|l| l.v_max_rad_s).iter()) {
                assert!(v.abs() <= 0.3 * limit + 1e-9);
            }
        }
    }

    #[test]
    fn a_free_line_is_taken_and_its_slowest_joint_sets_the_time() {
        let (arm, scene) = (arm(), Scene { ball_held: true, ..Scene::default() });
        let (from, to) =
            (deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0]), deg([40.0, -60.0, -80.0, 10.0, 20.0, 0.0]));
        let motion = way(&arm, &scene, &slow(1), &from, &to).unwrap().unwrap();
        assert_eq!(motion.knots.len(), 2);
        let turn = 40_f64.to_radians();
        let (v, a) = (0.3 * 149_f64.to_radians(), 0.3 * 596_f64.to_radians());
        assert!((motion.duration_s() - (1.5 * turn / v).max((6.0 * turn / a).sqrt())).abs() < 1e-9);
        clear_all_along(&arm, &scene, &motion);
        assert_eq!(way(&arm, &scene, &slow(1), &from, &from), Ok(None));
    }

    #[test]
    fn an_obstacle_on_the_line_is_passed_around() {
        let arm = arm();
        let obb = robot_model::collision::Obb::new(
            robot_model::Pose::translation(0.45, 0.0, 0.5),
            nalgebra::Vector3::new(0.25, 0.05, 0.6),
        );
        let scene = Scene { obstacles: vec![("post".to_owned(), obb)], ball_held: true };
        let (from, to) =
            (deg([-50.0, -20.0, -90.0, 0.0, 0.0, 0.0]), deg([50.0, -20.0, -90.0, 0.0, 0.0, 0.0]));
        let motion = way(&arm, &scene, &slow(1), &from, &to).unwrap().unwrap();
        assert!(motion.knots.len() > 2);
        clear_all_along(&arm, &scene, &motion);
        assert_eq!((motion.start_rad(), motion.stop_rad()), (from, to));
    }

    #[test]
    fn the_way_around_an_obstacle_stays_inside_a_narrower_range() {
        let arm = arm();
        let obb = robot_model::collision::Obb::new(
            robot_model::Pose::translation(0.45, 0.0, 0.5),
            nalgebra::Vector3::new(0.25, 0.05, 0.6),
        );
        let scene = Scene { obstacles: vec![("post".to_owned(), obb)], ball_held: true };
        let (from, to) =
            (deg([-50.0, -20.0, -90.0, 0.0, 0.0, 0.0]), deg([50.0, -20.0, -90.0, 0.0, 0.0, 0.0]));
        let range =
            (deg([-60.0, -150.0, -120.0, -20.0, -40.0, -10.0]), deg([60.0, 0.0, -20.0, 20.0, 40.0, 10.0]));
        for seed in 1..4 {
            let motion =
                way(&arm, &scene, &Travel { range: Some(range), ..slow(seed) }, &from, &to).unwrap().unwrap();
            clear_all_along(&arm, &scene, &motion);
            for i in 0..=500 {
                let q = motion.at(motion.duration_s() * f64::from(i) / 500.0).q;
                let inside = |j: usize| q[j] >= range.0[j] - 1e-9 && q[j] <= range.1[j] + 1e-9;
                assert!((0..6).all(inside), "seed {seed}, at {i}: {q:?}");
            }
        }
    }

    #[test]
    fn a_pose_inside_something_is_named() {
        let (arm, scene) = (arm(), Scene::default());
        let good = deg([0.0, -90.0, -90.0, 0.0, 0.0, 0.0]);
        // Upper arm down, forearm folded back through the column; which way depends on the elbow's sign.
        let folded = [0.0, -180.0].map(|elbow| deg([0.0, 60.0, elbow, 0.0, 0.0, 0.0]));
        let refused = folded.iter().find_map(|bad| way(&arm, &scene, &slow(1), bad, &good).err());
        let text = refused.unwrap().to_string();
        assert!(text.starts_with("at its present pose the arm touches something"), "{text}");
    }
}
