//! Joint angles in which the hand is where it is wanted.

use nalgebra::{Matrix3, Vector3};
use robot_model::collision::CollisionChecker;
use robot_model::{JointVec, Pose, RobotModel};

/// Starts of the search if there is no closed form.
const STARTS: usize = 48;
/// Poses to which a way around is searched.
pub(super) const POSES_MAX: usize = 3;
/// Two poses are one below this, rad.
const SAME_RAD: f64 = 1e-4;
/// Largest distance of the hand from a point, m; steps from one start.
const POINT_TOL_M: f64 = 1e-9;
const STEPS_MAX: usize = 80;

/// Where the hand (the end effector of the robot file) is to be, in the frame of the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// At a point in m, turned as comes with the least motion.
    Point(Vector3<f64>),
    /// In a pose.
    Pose(Pose),
}

/// The hand cannot be there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoGoal {
    #[error("the hand does not reach that place inside the joint ranges")]
    OutOfReach,
    #[error("wherever the hand is there, the arm touches something")]
    Blocked,
}

/// Free poses of the arm with the hand at `goal`, the one that takes least time from `from` first.
///
/// # Errors
/// [`NoGoal`].
pub(super) fn poses(
    arm: &RobotModel,
    checker: &mut CollisionChecker<'_>,
    from: &JointVec,
    goal: &Goal,
) -> Result<Vec<JointVec>, NoGoal> {
    let mut found = match goal {
        Goal::Pose(pose) => match arm.ik_near(pose, from) {
            Ok(solutions) => solutions.iter().filter(|s| s.in_range).map(|s| s.q).collect(),
            Err(_) => {
                let mut found = arm.ik_search(pose, STARTS);
                found.extend(arm.ik_from(pose, from));
                found
            }
        },
        Goal::Point(p) => {
            let starts = std::iter::once(*from).chain((0..STARTS).map(|k| arm.spread_configuration(k)));
            starts.filter_map(|start| at_point(arm, p, start)).collect()
        }
    };
    found.retain(|q| arm.in_range(q, 0.0));
    if found.is_empty() {
        return Err(NoGoal::OutOfReach);
    }
    found.retain(|q| !checker.collides(&arm.fk(q)));
    let v = arm.limit(|l| l.v_max_rad_s);
    let time = |q: &JointVec| (q - from).abs().component_div(&v).amax();
    found.sort_by(|a, b| time(a).total_cmp(&time(b)));
    found.dedup_by(|b, a| (*a - *b).amax() < SAME_RAD);
    if found.is_empty() { Err(NoGoal::Blocked) } else { Ok(found) }
}

/// From `q` with steps of least motion to a pose with the hand at `p`; angles stay in their ranges.
pub(crate) fn at_point(arm: &RobotModel, p: &Vector3<f64>, mut q: JointVec) -> Option<JointVec> {
    let (low, high) = (arm.q_min(), arm.q_max());
    let mut damping = 1e-6_f64;
    for _ in 0..STEPS_MAX {
        let frames = arm.fk(&q);
        let hand = arm.ee(&frames).pos;
        let error = p - hand;
        if error.norm() <= POINT_TOL_M {
            return Some(q);
        }
        let j = frames.jacobian(&hand);
        let square: Matrix3<f64> = (0..arm.n()).map(|k| j.linear(k) * j.linear(k).transpose()).sum();
        loop {
            let solved = (square + Matrix3::identity() * damping).cholesky()?.solve(&error);
            let next =
                JointVec::from_fn(arm.n(), |i| (q[i] + j.linear(i).dot(&solved)).clamp(low[i], high[i]));
            if (p - arm.ee_at(&next).pos).norm_squared() < error.norm_squared() {
                q = next;
                damping = (0.1 * damping).max(1e-12);
                break;
            }
            damping *= 10.0;
            if damping.is_nan() || damping > 1e3 {
                return None;
            }
        }
    }
    None
}
