//! One value per joint, reached by [`JointIndex`] without a path that panics.

use protocol::{JOINTS_MAX, JointIndex};

/// [`JOINTS_MAX`] values, base first. Entries past the joints in use hold their default and are never read by the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PerJoint<T>(pub [T; JOINTS_MAX]);

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

impl<T> PerJoint<T> {
    /// Value of a joint.
    pub const fn at(&self, joint: JointIndex) -> &T {
        let [a, b, c, d, e, f, g, h] = &self.0;
        // A `JointIndex` is below `JOINTS_MAX`; spelled out because indexing would be a panic path.
        match joint.get() {
            0 => a,
            1 => b,
            2 => c,
            3 => d,
            4 => e,
            5 => f,
            6 => g,
            _ => h,
        }
    }

    /// Value of a joint, to change.
    pub const fn at_mut(&mut self, joint: JointIndex) -> &mut T {
        let [a, b, c, d, e, f, g, h] = &mut self.0;
        match joint.get() {
            0 => a,
            1 => b,
            2 => c,
            3 => d,
            4 => e,
            5 => f,
            6 => g,
            _ => h,
        }
    }
}

/// `x` within `low..=high`; NaN becomes `low`. Unlike `f32::clamp` it has no assertion inside.
#[must_use]
pub const fn clamp(x: f32, low: f32, high: f32) -> f32 {
    // Comparisons, not `max` and `min`: those are calls on a Cortex-M4.
    if x >= low { if x <= high { x } else { high } } else { low }
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
    }
}
