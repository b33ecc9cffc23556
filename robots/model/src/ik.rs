//! Inverse kinematics: all closed-form solutions, with branches that keep their identity.

use crate::family::Family;
use crate::kinematics::Frames;
use crate::model::{JointVec, RobotModel};
use crate::pose::Pose;

/// Which of the (up to eight) postures a solution has.
///
/// The number is the same for neighbouring poses, so a planner can follow one branch: shoulder, elbow and wrist
/// change only where the arm passes a singularity of that part. Ordered as 4 shoulder + 2 elbow + wrist.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Branch(u8);

impl Branch {
    /// Number of branches of the largest family.
    pub const COUNT: usize = 8;

    /// All branches in order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..Self::COUNT as u8).map(Self)
    }

    /// The branch with this index; `None` from 8 on.
    #[must_use]
    pub fn from_index(index: usize) -> Option<Self> {
        (index < Self::COUNT).then_some(Self(index as u8))
    }

    pub(crate) fn new(shoulder_back: bool, elbow_negative: bool, wrist_flipped: bool) -> Self {
        Self(u8::from(shoulder_back) * 4 + u8::from(elbow_negative) * 2 + u8::from(wrist_flipped))
    }

    /// Index from 0 to 7.
    #[must_use]
    pub fn index(self) -> usize {
        usize::from(self.0)
    }

    /// The arm reaches over its back: the wrist centre is behind axis 1.
    #[must_use]
    pub fn shoulder_back(self) -> bool {
        self.0 & 4 != 0
    }

    /// The elbow bends the other way: the direction of the forearm turns backwards from that of the upper arm.
    #[must_use]
    pub fn elbow_negative(self) -> bool {
        self.0 & 2 != 0
    }

    /// The wrist's other twin: joint 4 turned by half a turn and joint 5 mirrored.
    #[must_use]
    pub fn wrist_flipped(self) -> bool {
        self.0 & 1 != 0
    }
}

/// One solution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolution<const N: usize> {
    /// Posture.
    pub branch: Branch,
    /// Joint angles in rad, each by whole turns as near to the reference as its range allows.
    pub q: JointVec<N>,
    /// Whether every joint is inside its range.
    pub in_range: bool,
    /// Whether a joint angle was free (axes aligned) and was taken from the reference.
    pub singular: bool,
}

/// The solutions for one pose, at most one per branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolutions<const N: usize> {
    q: [JointVec<N>; Branch::COUNT],
    reached: u8,
    in_range: u8,
    singular: u8,
    /// How far inside the reach of upper arm and forearm the wrist centre lies, shoulder forward and back, in m.
    ///
    /// Negative: out of reach by that distance (too far out, or too close to the shoulder). Smooth enough to
    /// serve a solver as a constraint where no solution exists.
    pub reach_margin_m: [f64; 2],
}

impl<const N: usize> IkSolutions<N> {
    pub(crate) fn none() -> Self {
        Self {
            q: [JointVec::zeros(); Branch::COUNT],
            reached: 0,
            in_range: 0,
            singular: 0,
            reach_margin_m: [f64::NEG_INFINITY; 2],
        }
    }

    pub(crate) fn set(&mut self, branch: Branch, q: JointVec<N>, singular: bool) {
        self.q[branch.index()] = q;
        self.reached |= 1 << branch.0;
        self.singular |= u8::from(singular) << branch.0;
    }

    /// The solution of a branch, in range or not.
    #[must_use]
    pub fn get(&self, branch: Branch) -> Option<IkSolution<N>> {
        let bit = 1 << branch.0;
        (self.reached & bit != 0).then(|| IkSolution {
            branch,
            q: self.q[branch.index()],
            in_range: self.in_range & bit != 0,
            singular: self.singular & bit != 0,
        })
    }

    /// All solutions, in order of branches.
    pub fn iter(&self) -> impl Iterator<Item = IkSolution<N>> + '_ {
        Branch::all().filter_map(|b| self.get(b))
    }

    /// The solutions with every joint in its range, in order of branches.
    pub fn in_range(&self) -> impl Iterator<Item = IkSolution<N>> + '_ {
        self.iter().filter(|s| s.in_range)
    }

    /// Number of solutions, in range or not.
    #[must_use]
    pub fn len(&self) -> usize {
        self.reached.count_ones() as usize
    }

    /// Whether the pose is out of reach whatever the joint ranges.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.reached == 0
    }

    /// Number of solutions with every joint in its range.
    #[must_use]
    pub fn len_in_range(&self) -> usize {
        self.in_range.count_ones() as usize
    }
}

/// The robot's family has no closed-form inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this robot's kinematic family has no closed-form inverse kinematics")]
pub struct NoClosedForm;

/// Joint angles may pass a limit by this much, in rad, and still count as inside: rounding at exactly ±180°.
pub const RANGE_SLACK_RAD: f64 = 1e-9;

impl<const N: usize> RobotModel<N> {
    /// All solutions for an end-effector pose in the world.
    ///
    /// Angles are chosen by whole turns as near as possible to the middle of each range; where an angle is free
    /// (wrist straight, wrist centre on axis 1) it is put to the middle of its range and the solution is marked
    /// [`IkSolution::singular`]. Derivatives of a solution with respect to the pose are those of the inverse
    /// Jacobian: `δq = J⁻¹ [δp; δφ]`.
    ///
    /// # Errors
    /// [`NoClosedForm`] if the robot is of no family with a closed form. Out of reach is not an error: no solutions.
    pub fn ik(&self, x_we: &Pose) -> Result<IkSolutions<N>, NoClosedForm> {
        self.ik_near(x_we, &((self.q_min() + self.q_max()) * 0.5))
    }

    /// As [`RobotModel::ik`], with angles chosen as near as possible to `q_ref`.
    ///
    /// # Errors
    /// As [`RobotModel::ik`].
    pub fn ik_near(&self, x_we: &Pose, q_ref: &JointVec<N>) -> Result<IkSolutions<N>, NoClosedForm> {
        let x_wn = *x_we * self.x_ne.inverse();
        let mut out = match &self.family {
            Family::OrthoParallel(arm) => arm.solve(&x_wn, q_ref),
            Family::TurntablePlanar(arm) => arm.solve(&x_wn, q_ref),
            Family::General => return Err(NoClosedForm),
        };
        for k in 0..Branch::COUNT {
            if out.reached & (1 << k) == 0 {
                continue;
            }
            let mut all_inside = true;
            for (i, joint) in self.joints.iter().enumerate() {
                let (q, inside) =
                    place(out.q[k][i], q_ref[i], joint.limits.q_min_rad, joint.limits.q_max_rad);
                out.q[k][i] = q;
                all_inside &= inside;
            }
            out.in_range |= u8::from(all_inside) << k;
        }
        Ok(out)
    }

    /// The branch a configuration belongs to; `None` if the family has no closed form.
    #[must_use]
    pub fn branch_of(&self, q: &JointVec<N>) -> Option<Branch> {
        match &self.family {
            Family::OrthoParallel(arm) => Some(arm.branch_of(q.as_slice().try_into().ok()?)),
            Family::TurntablePlanar(arm) => Some(arm.branch_of(q.as_slice().try_into().ok()?)),
            Family::General => None,
        }
    }

    /// Forward kinematics of the end effector for joint angles in rad.
    #[must_use]
    pub fn ee_at(&self, q_rad: &JointVec<N>) -> Pose {
        let frames: Frames<N> = self.fk(q_rad);
        self.ee(&frames)
    }
}

/// The angle `q` moved by whole turns into the range, as near to `q_ref` as possible, and whether that succeeded.
///
/// If no whole number of turns brings it inside, the value nearest to the middle of the range is returned, which is
/// the one with the smallest violation.
pub(crate) fn place(q: f64, q_ref: f64, min: f64, max: f64) -> (f64, bool) {
    use std::f64::consts::TAU;
    let inside = |v: f64| v >= min - RANGE_SLACK_RAD && v <= max + RANGE_SLACK_RAD;
    let near_ref = q + TAU * ((q_ref - q) / TAU).round_ties_even();
    if inside(near_ref) {
        return (near_ref, true);
    }
    // A range wider than a turn has several candidates; the one next to the nearest is the only other good one.
    let step = if near_ref > max { -TAU } else { TAU };
    if inside(near_ref + step) {
        return (near_ref + step, true);
    }
    let middle = 0.5 * (min + max);
    let near_middle = q + TAU * ((middle - q) / TAU).round_ties_even();
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
