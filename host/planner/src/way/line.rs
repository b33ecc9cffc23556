//! A straight line of the hand, as a path of the joints.

use nalgebra::{Rotation3, Vector3};
use robot_model::collision::{CollisionChecker, MotionVerdict};
use robot_model::{JointVec, Pose, RobotModel};

use super::{Goal, TOLERANCE_M, name};
use crate::timing::Path;

/// Largest distance and turn between two points of the line.
const STEP_M: f64 = 0.004;
const STEP_RAD: f64 = 0.02;
/// A joint that turns by more than this between two points passes a singularity.
const JUMP_RAD: f64 = 0.15;
/// Corners between points are rounded within this, rad: it rounds all of them.
const BLEND_RAD: f64 = 1e-3;
/// Below these the hand is there.
const THERE_M: f64 = 1e-5;
const THERE_TURN_RAD: f64 = 1e-4;

/// What breaks a line.
#[derive(Debug, Clone, PartialEq)]
pub enum LineBreak {
    /// A joint comes to the end of its range.
    Limit { joint: usize },
    /// A joint would have to turn at once.
    Singularity { joint: usize },
    /// The hand does not reach that far.
    Reach,
    /// Two bodies touch.
    Contact { bodies: [String; 2] },
}

impl std::fmt::Display for LineBreak {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Limit { joint } => write!(f, "joint {} comes to the end of its range", joint + 1),
            Self::Singularity { joint } => {
                write!(f, "the arm passes a singularity, joint {} would turn at once", joint + 1)
            }
            Self::Reach => f.write_str("the hand does not reach farther"),
            Self::Contact { bodies: [a, b] } => write!(f, "{a} and {b} touch"),
        }
    }
}

/// The hand cannot move on a straight line.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "the straight line breaks after {:.3} of {:.3} m, at ({:.3}, {:.3}, {:.3}) m: {what}", .after_m, .of_m, .at_m[0], .at_m[1], .at_m[2]
)]
pub struct LineError {
    /// Way of the hand until there, m.
    pub after_m: f64,
    /// Length of the line, m.
    pub of_m: f64,
    /// Place of the hand there, base frame, m.
    pub at_m: [f64; 3],
    /// Why.
    pub what: LineBreak,
}

/// The path of the joints that leads the hand from where it is with `from` straight to `goal`; `None` if it is there.
///
/// # Errors
/// [`LineError`].
pub(super) fn path(
    arm: &RobotModel,
    checker: &mut CollisionChecker<'_>,
    from: &JointVec,
    goal: &Goal,
) -> Result<Option<Path>, LineError> {
    let begin = arm.ee_at(from);
    let end = match goal {
        Goal::Pose(pose) => *pose,
        // A point alone: the hand keeps its orientation.
        Goal::Point(p) => Pose::new(begin.rot, *p),
    };
    let way = end.pos - begin.pos;
    let turn = Rotation3::from_matrix_unchecked(begin.rot.transpose() * end.rot).scaled_axis();
    let (of_m, of_rad) = (way.norm(), turn.norm());
    if of_m < THERE_M && of_rad < THERE_TURN_RAD {
        return Ok(None);
    }
    let steps = (of_m / STEP_M).max(of_rad / STEP_RAD).ceil().max(2.0) as usize;
    let hand = |k: usize| {
        let share = k as f64 / steps as f64;
        let rot = begin.rot * Rotation3::from_scaled_axis(turn * share).into_inner();
        Pose::new(rot, begin.pos + way * share)
    };
    let broken = |k: usize, what: LineBreak| {
        let at: Vector3<f64> = hand(k).pos;
        LineError { after_m: of_m * k as f64 / steps as f64, of_m, at_m: at.into(), what }
    };
    let mut points = vec![*from];
    for k in 1..=steps {
        let before = points[k - 1];
        let q = arm.ik_from(&hand(k), &before).ok_or_else(|| broken(k - 1, LineBreak::Reach))?;
        let step = (q - before).abs();
        let joint = step.imax();
        if step[joint] > JUMP_RAD {
            return Err(broken(k - 1, LineBreak::Singularity { joint }));
        }
        let (low, high) = (arm.q_min(), arm.q_max());
        let outward =
            |j: &usize| (q[*j] > high[*j] && q[*j] > before[*j]) || (q[*j] < low[*j] && q[*j] < before[*j]);
        if let Some(joint) = (0..arm.joints().len()).find(outward) {
            return Err(broken(k - 1, LineBreak::Limit { joint }));
        }
        points.push(q);
    }
    let rows: Vec<&[f64]> = points.iter().map(JointVec::as_slice).collect();
    let Ok(path) = Path::through(&rows, BLEND_RAD) else { return Ok(None) };
    match checker.check_motion(&path, 0.0, path.length(), TOLERANCE_M) {
        MotionVerdict::Free { .. } => Ok(Some(path)),
        MotionVerdict::Contact { s, clearance } => {
            let q = JointVec::from_slice(&path.angles(s));
            let at = arm.ee_at(&q).pos;
            let bodies = [clearance.a, clearance.b].map(|body| name(arm, checker.scene(), body));
            let after_m = (at - begin.pos).norm();
            Err(LineError { after_m, of_m, at_m: at.into(), what: LineBreak::Contact { bodies } })
        }
    }
}
