//! One value per joint, reached by [`JointIndex`] without a path that panics.

use protocol::{JOINTS_MAX, JointIndex};

/// [`JOINTS_MAX`] values, base first. Entries beyond the joints in use hold their default; the control law never reads them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PerJoint<T>(pub [T; JOINTS_MAX]);

/// Keeps an index below [`JOINTS_MAX`], a power of two.
const MASK: usize = JOINTS_MAX - 1;
const _: () = assert!(JOINTS_MAX.is_power_of_two());

impl<T: Copy> PerJoint<T> {
    /// The same value for every joint.
    pub const fn splat(value: T) -> Self {
        Self([value; JOINTS_MAX])
    }

    /// Value of a joint, by copy.
    pub fn get(&self, joint: JointIndex) -> T {
        *self.at(joint)
    }

    /// Replaces the value of a joint.
    pub fn set(&mut self, joint: JointIndex, value: T) {
        *self.at_mut(joint) = value;
    }
}

/// One default, copied: the default of an array would be written eight times in flash.
impl<T: Copy + Default> Default for PerJoint<T> {
    fn default() -> Self {
        Self::splat(T::default())
    }
}

impl<T> PerJoint<T> {
    /// Value of a joint.
    // A `JointIndex` is below `JOINTS_MAX`, and the mask makes this visible to the compiler: no check, no panic path.
    #[allow(clippy::indexing_slicing)]
    pub const fn at(&self, joint: JointIndex) -> &T {
        &self.0[joint.get() & MASK]
    }

    /// Value of a joint, to change.
    #[allow(clippy::indexing_slicing)]
    pub const fn at_mut(&mut self, joint: JointIndex) -> &mut T {
        &mut self.0[joint.get() & MASK]
    }
}

/// `x` within `low..=high`; NaN becomes `low`. Unlike `f32::clamp` it has no assertion inside.
#[must_use]
pub const fn clamp(x: f32, low: f32, high: f32) -> f32 {
    // Comparisons, not `max` and `min`: those are calls on a Cortex-M4.
    if x >= low { if x <= high { x } else { high } } else { low }
}

/// The larger one; `floor` if `x` is NaN.
#[must_use]
pub const fn at_least(x: f32, floor: f32) -> f32 {
    if x > floor { x } else { floor }
}

/// The smaller one; `ceiling` if `x` is NaN.
#[must_use]
pub const fn at_most(x: f32, ceiling: f32) -> f32 {
    if x < ceiling { x } else { ceiling }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_joint_has_its_own_place() {
        let mut values = PerJoint::splat(0);
        for joint in JointIndex::first(JOINTS_MAX) {
            values.set(joint, joint.get() + 10);
        }
        assert_eq!(values.0, [10, 11, 12, 13, 14, 15, 16, 17]);
        assert!(JointIndex::first(JOINTS_MAX).all(|joint| values.get(joint) == joint.get() + 10));
    }

    #[test]
    fn clamp_never_lets_a_lost_number_act() {
        assert_eq!(clamp(f32::NAN, -1.0, 1.0), -1.0);
        assert_eq!(clamp(f32::INFINITY, -1.0, 1.0), 1.0);
        assert_eq!((at_least(f32::NAN, 1.0), at_most(f32::NAN, 1.0)), (1.0, 1.0));
        assert_eq!((at_least(2.0, 1.0), at_most(2.0, 1.0)), (2.0, 1.0));
    }
}
