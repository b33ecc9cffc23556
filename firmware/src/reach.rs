//! Where a joint may be led, also from outside its soft limits (pure). A jog, its release and a stop use this one
//! rule, in each family of drives.
//!
//! | joint stands | ordered outwards | ordered inwards |
//! |---|---|---|
//! | inside, or on a limit | as ordered, up to the limit | as ordered, up to the other limit |
//! | outside | stays where it is | as ordered, up to the other limit |
//!
//! So a joint outside its limits moves inwards as far as ordered and no further. A limit ends a motion; it never begins one.

use crate::joints::{at_least, at_most, clamp};
use crate::settings::JointSettings;

/// Soft limits of a joint, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SoftLimits {
    /// Lower limit, rad.
    pub q_min_rad: f32,
    /// Upper limit, rad.
    pub q_max_rad: f32,
}

impl SoftLimits {
    /// Limits of a joint that has not found its zero: unbounded, because its position cannot be compared with limits.
    pub const UNKNOWN: Self = Self { q_min_rad: f32::NEG_INFINITY, q_max_rad: f32::INFINITY };

    /// Limits of the settings, for a joint that has found its zero.
    pub const fn of(joint: &JointSettings) -> Self {
        Self { q_min_rad: joint.q_min_rad, q_max_rad: joint.q_max_rad }
    }

    /// Limits that apply to a joint: those of the settings once it is homed, unbounded before.
    pub const fn kept(joint: &JointSettings, is_homed: bool) -> Self {
        if is_homed { Self::of(joint) } else { Self::UNKNOWN }
    }

    /// These limits, widened to include the position of the joint.
    #[must_use]
    pub const fn with(self, q_rad: f32) -> Self {
        Self { q_min_rad: at_most(q_rad, self.q_min_rad), q_max_rad: at_least(q_rad, self.q_max_rad) }
    }

    /// Way from `q_rad` to the limit in the direction of `v_rad_s`, rad; negative beyond that limit.
    #[must_use]
    pub fn room_rad(self, q_rad: f32, v_rad_s: f32) -> f32 {
        if v_rad_s > 0.0 { self.q_max_rad - q_rad } else { q_rad - self.q_min_rad }
    }

    /// Distance of `q_rad` from the nearer limit, on either side of it, rad.
    #[must_use]
    pub const fn way_to_nearest_rad(self, q_rad: f32) -> f32 {
        at_most((self.q_max_rad - q_rad).abs(), (q_rad - self.q_min_rad).abs())
    }
}

/// Position to which a joint at `q_rad` may be led when `ordered_rad` is ordered, rad.
///
/// The joint moves in the direction of the order or not at all, never beyond the order, and never further outside.
/// If the position or the order is not a number, the joint stays where it is.
#[must_use]
pub const fn reachable(q_rad: f32, limits: SoftLimits, ordered_rad: f32) -> f32 {
    if q_rad.is_nan() || ordered_rad.is_nan() {
        return q_rad;
    }
    let SoftLimits { q_min_rad, q_max_rad } = limits.with(q_rad);
    clamp(ordered_rad, q_min_rad, q_max_rad)
}

/// Position at which a joint comes to rest that is at `q_rad`, moves with `v_rad_s` and brakes with `a_rad_s2`,
/// within what is [`reachable`], rad. A joint that already moves outwards beyond a limit rests after its braking
/// way: it is not led back.
#[must_use]
pub const fn rest_rad(q_rad: f32, v_rad_s: f32, a_rad_s2: f32, limits: SoftLimits) -> f32 {
    let free_rad = q_rad + way_rad(v_rad_s, a_rad_s2);
    let leaves = (q_rad > limits.q_max_rad && v_rad_s > 0.0) || (q_rad < limits.q_min_rad && v_rad_s < 0.0);
    reachable(if leaves { free_rad } else { q_rad }, limits, free_rad)
}

/// Signed way of a joint from `v_rad_s` to rest with `a_rad_s2`.
#[must_use]
pub const fn way_rad(v_rad_s: f32, a_rad_s2: f32) -> f32 {
    0.5 * v_rad_s * v_rad_s.abs() / a_rad_s2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: SoftLimits = SoftLimits { q_min_rad: -1.0, q_max_rad: 2.0 };

    #[test]
    fn a_limit_bounds_a_motion_and_never_begins_one() {
        let cases = [
            ("inside, free", 0.5, 0.7, 0.7),
            ("inside, at most to the upper limit", 1.9, 2.3, 2.0),
            ("inside, at most to the lower limit", -0.9, -1.3, -1.0),
            ("on the upper limit, outwards", 2.0, 2.1, 2.0),
            ("on the upper limit, inwards", 2.0, 1.9, 1.9),
            ("on the lower limit, outwards", -1.0, -1.1, -1.0),
            ("on the lower limit, inwards", -1.0, -0.9, -0.9),
            ("above, outwards", 2.2, 2.3, 2.2),
            ("above, let go", 2.2, 2.2, 2.2),
            ("above, a little inwards", 2.2, 2.18, 2.18),
            ("above, inwards through everything", 2.2, -1.5, -1.0),
            ("below, outwards", -1.2, -1.3, -1.2),
            ("below, let go", -1.2, -1.2, -1.2),
            ("below, a little inwards", -1.2, -1.18, -1.18),
            ("below, inwards through everything", -1.2, 2.5, 2.0),
            ("order is not a number", 2.2, f32::NAN, 2.2),
        ];
        for (name, q_rad, ordered_rad, expected_rad) in cases {
            assert_eq!(reachable(q_rad, LIMITS, ordered_rad), expected_rad, "{name}");
        }
        assert!(reachable(f32::NAN, LIMITS, 1.0).is_nan(), "no position, no motion");
        assert_eq!(reachable(9.0, SoftLimits::UNKNOWN, 9.5), 9.5, "no zero, no limits");
    }

    #[test]
    fn a_joint_that_is_let_go_rests_after_its_braking_way() {
        // 0.2 rad/s with 1 rad/s2 are 20 mrad.
        assert_eq!(rest_rad(2.2, -0.2, 1.0, LIMITS), 2.2 - 0.02);
        assert_eq!(rest_rad(-1.2, 0.2, 1.0, LIMITS), -1.2 + 0.02);
        assert_eq!(rest_rad(2.2, 0.0, 1.0, LIMITS), 2.2);
        assert_eq!(rest_rad(1.99, 0.2, 1.0, LIMITS), 2.0);
        assert_eq!(rest_rad(2.2, 0.2, 1.0, LIMITS), 2.2 + 0.02, "not led back");
    }

    proptest! {
        #[test]
        fn a_joint_moves_as_ordered_or_less_and_never_further_out(
            q_rad in -3f32..4.0, ordered_rad in -4f32..5.0,
        ) {
            let (ordered, moved) = (ordered_rad - q_rad, reachable(q_rad, LIMITS, ordered_rad) - q_rad);
            prop_assert!(moved == 0.0 || moved.signum() == ordered.signum());
            prop_assert!(moved.abs() <= ordered.abs());
            let outside = |q_rad: f32| (q_rad - LIMITS.q_max_rad).max(LIMITS.q_min_rad - q_rad).max(0.0);
            prop_assert!(outside(q_rad + moved) <= outside(q_rad) + 1e-6);
            // Only a limit shortens it.
            let target_rad = q_rad + moved;
            let bound = [LIMITS.q_min_rad, LIMITS.q_max_rad, q_rad].iter().any(|end| (end - target_rad).abs() < 1e-6);
            prop_assert!(bound || (moved - ordered).abs() < 1e-6);
        }
    }
}
