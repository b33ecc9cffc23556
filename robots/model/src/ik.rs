//! Inverse kinematics: all closed-form solutions, placed in the joint ranges.

use crate::family::Family;
use crate::ik_solution::{Branch, IkSolutions};
use crate::kinematics::Frames;
use crate::model::RobotModel;
use crate::per_joint::JointVec;
use crate::pose::Pose;

/// The robot's family has no closed-form inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this robot's kinematic family has no closed-form inverse kinematics")]
pub struct NoClosedForm;

/// Joint angles may pass a limit by this much, in rad, and still count as inside: rounding at exactly ±180°.
pub const RANGE_SLACK_RAD: f64 = 1e-9;

impl RobotModel {
    /// All solutions for an end-effector pose in the world.
    ///
    /// Angles are chosen by whole turns as near as possible to the middle of each range; where an angle is free
    /// (wrist straight, wrist centre on axis 1) it is put to the middle of its range and the solution is marked
    /// [`IkSolution::singular`](crate::IkSolution::singular). Derivatives of a solution with respect to the pose are those of the inverse
    /// Jacobian: `δq = J⁻¹ [δp; δφ]`.
    ///
    /// # Errors
    /// [`NoClosedForm`] if the robot's family has no closed form. A pose out of reach is not an error: there are no solutions.
    pub fn ik(&self, x_we: &Pose) -> Result<IkSolutions, NoClosedForm> {
        self.ik_near(x_we, &((self.q_min() + self.q_max()) * 0.5))
    }

    /// As [`RobotModel::ik`], with angles chosen as near as possible to `q_ref`.
    ///
    /// # Errors
    /// As [`RobotModel::ik`].
    pub fn ik_near(&self, x_we: &Pose, q_ref: &JointVec) -> Result<IkSolutions, NoClosedForm> {
        let x_wn = *x_we * self.x_ne.inverse();
        let mut out = match &self.family {
            Family::OrthoParallel(arm) => arm.solve(&x_wn, q_ref, None),
            Family::TurntablePlanar(arm) => arm.solve(&x_wn, q_ref),
            Family::General => return Err(NoClosedForm),
        };
        out.place_in_ranges(|q| {
            let mut all_inside = true;
            for (i, joint) in self.joints.iter().enumerate() {
                let (placed, inside) = place(q[i], q_ref[i], joint.limits.q_min_rad, joint.limits.q_max_rad);
                q[i] = placed;
                all_inside &= inside;
            }
            all_inside
        });
        Ok(out)
    }

    /// The solution nearest to `q_ref`: the next step along a path. Whole turns are added to each angle until it is nearest to that of
    /// `q_ref`; joint ranges are not applied. `None` if the pose is out of reach.
    ///
    /// # Errors
    /// As [`RobotModel::ik`].
    pub fn ik_next(&self, x_we: &Pose, q_ref: &JointVec) -> Result<Option<JointVec>, NoClosedForm> {
        let x_wn = *x_we * self.x_ne.inverse();
        let next = |solutions: &IkSolutions| {
            let placed = solutions.iter().map(|s| s.q.zip_map(q_ref, next_turn));
            let apart = placed.map(|q| ((q - q_ref).amax(), q));
            apart.min_by(|(a, _), (b, _)| a.total_cmp(b))
        };
        let all = match &self.family {
            Family::OrthoParallel(arm) => {
                // On a path the branch seldom changes, and the others cost most of the time.
                let branch = q_ref[..].try_into().ok().map(|q| arm.branch_of(q));
                if let Some((apart, q)) = next(&arm.solve(&x_wn, q_ref, branch))
                    && apart < arm.half_gap_rad(&q.array())
                {
                    return Ok(Some(q));
                }
                arm.solve(&x_wn, q_ref, None)
            }
            Family::TurntablePlanar(arm) => arm.solve(&x_wn, q_ref),
            Family::General => return Err(NoClosedForm),
        };
        Ok(next(&all).map(|(_, q)| q))
    }

    /// The branch a configuration belongs to; `None` if the family has no closed form.
    #[must_use]
    pub fn branch_of(&self, q: &JointVec) -> Option<Branch> {
        match &self.family {
            Family::OrthoParallel(arm) => Some(arm.branch_of(q[..].try_into().ok()?)),
            Family::TurntablePlanar(arm) => Some(arm.branch_of(q[..].try_into().ok()?)),
            Family::General => None,
        }
    }

    /// Forward kinematics of the end effector for joint angles in rad.
    #[must_use]
    pub fn ee_at(&self, q_rad: &JointVec) -> Pose {
        let frames: Frames = self.fk(q_rad);
        self.ee(&frames)
    }
}

/// `angle` moved by whole turns next to `reference`.
fn next_turn(angle: f64, reference: f64) -> f64 {
    use std::f64::consts::TAU;
    angle + TAU * ((reference - angle) / TAU).round_ties_even()
}

/// The angle `q` moved by whole turns into the range, as near to `q_ref` as possible, and whether that succeeded.
///
/// If no whole number of turns brings it inside, the value nearest to the middle of the range is returned, which is
/// the one with the smallest violation.
pub(crate) fn place(q: f64, q_ref: f64, min: f64, max: f64) -> (f64, bool) {
    use std::f64::consts::TAU;
    let inside = |v: f64| v >= min - RANGE_SLACK_RAD && v <= max + RANGE_SLACK_RAD;
    let near_ref = next_turn(q, q_ref);
    if inside(near_ref) {
        return (near_ref, true);
    }
    // A range wider than a turn has several candidates; the one next to the nearest is the only other good one.
    let step = if near_ref > max { -TAU } else { TAU };
    if inside(near_ref + step) {
        return (near_ref + step, true);
    }
    let middle = 0.5 * (min + max);
    let near_middle = next_turn(q, middle);
    (near_middle, inside(near_middle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_placed_in_offset_and_wide_ranges() {
        let deg = f64::to_radians;
        // (angle, reference, range) -> (placed, inside)
        let table = [
            ((170.0, -90.0, -240.0, 60.0), (-190.0, true)),
            ((-250.0, -90.0, -240.0, 60.0), (-250.0, false)),
            ((100.0, -90.0, -240.0, 60.0), (-260.0, false)),
            ((-350.0, 0.0, -180.0, 180.0), (10.0, true)),
            ((180.0, 0.0, -180.0, 180.0), (180.0, true)),
            ((10.0, 340.0, -350.0, 350.0), (10.0, true)),
            ((-20.0, 340.0, -350.0, 350.0), (340.0, true)),
            ((-20.0, -10.0, -350.0, 350.0), (-20.0, true)),
            ((20.0, -300.0, -350.0, 350.0), (-340.0, true)),
            ((120.0, 0.0, -115.0, 115.0), (120.0, false)),
        ];
        for ((q, r, min, max), (want, want_inside)) in table {
            let (got, inside) = place(deg(q), deg(r), deg(min), deg(max));
            assert!(
                (got - deg(want)).abs() < 1e-12 && inside == want_inside,
                "{q} {r}: {}",
                got.to_degrees()
            );
        }
    }

    #[test]
    fn branch_numbers_name_the_posture() {
        for (k, b) in Branch::all().enumerate() {
            assert_eq!(b.index(), k);
            assert_eq!(Branch::new(b.shoulder_back(), b.elbow_negative(), b.wrist_flipped()), b);
        }
        assert_eq!(Branch::from_index(8), None);
    }
}
