//! Solutions of inverse kinematics, with branches that keep their identity.

use crate::per_joint::JointVec;

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
pub struct IkSolution {
    /// Posture.
    pub branch: Branch,
    /// Joint angles in rad, each by whole turns as near to the reference as its range allows.
    pub q: JointVec,
    /// Whether every joint is inside its range.
    pub in_range: bool,
    /// Whether a joint angle was free (axes aligned) and was taken from the reference.
    pub singular: bool,
}

/// The solutions for one pose, at most one per branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IkSolutions {
    q: [JointVec; Branch::COUNT],
    reached: u8,
    in_range: u8,
    singular: u8,
    /// How far inside the reach of upper arm and forearm the wrist centre lies, shoulder forward and back, in m.
    ///
    /// Negative: out of reach by that distance (too far out, or too close to the shoulder). Smooth enough to be a
    /// constraint of a solver at poses without a solution.
    pub reach_margin_m: [f64; 2],
}

impl IkSolutions {
    pub(crate) fn none(n: usize) -> Self {
        Self {
            q: [JointVec::zeros(n); Branch::COUNT],
            reached: 0,
            in_range: 0,
            singular: 0,
            reach_margin_m: [f64::NEG_INFINITY; 2],
        }
    }

    pub(crate) fn set(&mut self, branch: Branch, q: JointVec, singular: bool) {
        self.q[branch.index()] = q;
        self.reached |= 1 << branch.0;
        self.singular |= u8::from(singular) << branch.0;
    }

    /// Calls `place` with each solution. It moves the angles by whole turns and returns whether all are in range.
    pub(crate) fn place_in_ranges(&mut self, mut place: impl FnMut(&mut JointVec) -> bool) {
        for (k, q) in self.q.iter_mut().enumerate() {
            if self.reached & (1 << k) != 0 {
                self.in_range |= u8::from(place(q)) << k;
            }
        }
    }

    /// The solution of a branch, in range or not.
    #[must_use]
    pub fn get(&self, branch: Branch) -> Option<IkSolution> {
        let bit = 1 << branch.0;
        (self.reached & bit != 0).then(|| IkSolution {
            branch,
            q: self.q[branch.index()],
            in_range: self.in_range & bit != 0,
            singular: self.singular & bit != 0,
        })
    }

    /// All solutions, in order of branches.
    pub fn iter(&self) -> impl Iterator<Item = IkSolution> + '_ {
        Branch::all().filter_map(|b| self.get(b))
    }

    /// The solutions with every joint in its range, in order of branches.
    pub fn in_range(&self) -> impl Iterator<Item = IkSolution> + '_ {
        self.iter().filter(|s| s.in_range)
    }

    /// Number of solutions, in range or not.
    #[must_use]
    pub fn len(&self) -> usize {
        self.reached.count_ones() as usize
    }

    /// True if the pose is out of reach for any joint ranges.
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
