//! Checks of measured motion, without state: each returns the cause of a violated limit, or `None`. The controller
//! calls them and reacts ([`crate::fault::Reaction`]).

use protocol::Instant;

use crate::fault::Cause;
use crate::group::PositionSample;
use crate::reach::SoftLimits;
use crate::settings::JointSettings;
use crate::span;

/// Factor on the speed limit above which a measured speed is a fault: the estimate has noise, and a saturated loop
/// may overshoot a little.
const V_TOLERANCE: f32 = 1.1;
/// Noise of a measured speed, rad/s.
const V_NOISE_RAD_S: f32 = 0.15;
/// Distance outside the soft limits at which a measured position is a fault, rad: the drive's ramp ends
/// on the limit and its loop overshoots.
const Q_TOLERANCE_RAD: f32 = 0.01;
/// Readings above the current limit in a row that are a fault.
pub const OVER_CURRENT_READINGS: u8 = 3;

/// One joint as measured in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisedSample {
    /// Position, rad.
    pub q_rad: f32,
    /// Velocity, rad/s.
    pub qd_rad_s: f32,
    /// Following error, rad.
    pub e_rad: f32,
}

/// Checks position, speed and following error of a moving joint, whose position may be within `soft`.
pub fn check_motion(measured: &SupervisedSample, limits: &JointSettings, soft: SoftLimits) -> Option<Cause> {
    let SupervisedSample { q_rad, qd_rad_s, e_rad } = *measured;
    // Each comparison is false for NaN, so NaN is a fault.
    let inside = q_rad >= soft.q_min_rad - Q_TOLERANCE_RAD && q_rad <= soft.q_max_rad + Q_TOLERANCE_RAD;
    let slow_enough = qd_rad_s.abs() <= V_TOLERANCE * limits.v_max_rad_s + V_NOISE_RAD_S;
    let near_enough = e_rad.abs() <= limits.error_max_rad;
    if !inside {
        Some(Cause::PositionLimit)
    } else if !slow_enough {
        Some(Cause::VelocityLimit)
    } else if !near_enough {
        Some(Cause::FollowingError)
    } else {
        None
    }
}

/// True if the joint can have moved from the last position to this one. This rejects a stale, mixed-up or broken
/// position that is far away; a wrong position nearby does no harm.
pub fn is_plausible(q_rad: f32, at: Instant, last: Option<PositionSample>, v_max_rad_s: f32) -> bool {
    let Some(last) = last else { return q_rad.is_finite() };
    let dt_s = span::seconds(at.saturating_since(last.at));
    (q_rad - last.q_rad).abs() <= 1.5 * v_max_rad_s * dt_s + 0.02
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use protocol::JointIndex;

    #[test]
    fn each_limit_is_judged_on_what_is_measured_and_a_lost_number_fails() {
        let limits = Settings::powercube6().joint.get(JointIndex::new(0).unwrap());
        let fine = SupervisedSample { q_rad: 1.0, qd_rad_s: 1.0, e_rad: 0.0 };
        let table = [
            (fine, None),
            (SupervisedSample { q_rad: 3.16, ..fine }, Some(Cause::PositionLimit)),
            (SupervisedSample { q_rad: f32::NAN, ..fine }, Some(Cause::PositionLimit)),
            (SupervisedSample { qd_rad_s: -3.1, ..fine }, Some(Cause::VelocityLimit)),
            (SupervisedSample { qd_rad_s: f32::NAN, ..fine }, Some(Cause::VelocityLimit)),
            (SupervisedSample { e_rad: -0.26, ..fine }, Some(Cause::FollowingError)),
        ];
        for (measured, cause) in table {
            assert_eq!(check_motion(&measured, &limits, SoftLimits::of(&limits)), cause, "{measured:?}");
        }
    }

    #[test]
    fn each_tolerance_begins_at_its_limit_and_ends_where_it_says() {
        let limits = Settings::powercube6().joint.get(JointIndex::new(0).unwrap());
        let rest = SupervisedSample { q_rad: 0.0, qd_rad_s: 0.0, e_rad: 0.0 };
        let hair = 1e-3;
        for sign in [-1.0f32, 1.0] {
            let q_end = if sign > 0.0 { limits.q_max_rad } else { limits.q_min_rad } + sign * Q_TOLERANCE_RAD;
            let v_end = sign * (V_TOLERANCE * limits.v_max_rad_s + V_NOISE_RAD_S);
            for (measured, cause) in [
                (SupervisedSample { q_rad: q_end - sign * hair, ..rest }, None),
                (SupervisedSample { q_rad: q_end + sign * hair, ..rest }, Some(Cause::PositionLimit)),
                (SupervisedSample { qd_rad_s: v_end - sign * hair, ..rest }, None),
                (SupervisedSample { qd_rad_s: v_end + sign * hair, ..rest }, Some(Cause::VelocityLimit)),
                (SupervisedSample { e_rad: sign * (limits.error_max_rad - hair), ..rest }, None),
                (
                    SupervisedSample { e_rad: sign * (limits.error_max_rad + hair), ..rest },
                    Some(Cause::FollowingError),
                ),
            ] {
                assert_eq!(check_motion(&measured, &limits, SoftLimits::of(&limits)), cause, "{measured:?}");
            }
        }
    }

    #[test]
    fn position_that_cannot_have_been_reached_is_not_plausible() {
        let last = Some(PositionSample { q_rad: 1.0, at: Instant::from_micros(0) });
        let at = Instant::from_micros(3_000);
        assert!(is_plausible(1.008, at, last, 2.6));
        assert!(!is_plausible(1.1, at, last, 2.6));
        assert!(!is_plausible(f32::NAN, at, last, 2.6));
        assert!(!is_plausible(f32::NAN, at, None, 2.6));
    }
}
