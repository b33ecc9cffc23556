//! Designs side by side on a plant with everything the design leaves out, following a motion.

use super::plant::{FeedForwardLaw, Plant, Reference, Setup, track};
use super::saturated::Gains;
use crate::model::Estimator;

/// Errors of one joint, worst over an initial error of either sign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracking {
    /// Time until the position error stays below half of the initial one, s; infinite if it does not.
    pub halved_after_s: f64,
    /// Largest position error after 0.35 s, rad.
    pub late_max_rad: f64,
    /// The same from zero initial error, rad.
    pub late_max_from_rest_rad: f64,
    /// |position error| at `event_s`, rad.
    pub event_position_rad: f64,
    /// |velocity error| at `event_s`, rad/s.
    pub event_velocity_rad_s: f64,
}

/// After this the start is over and the errors are the loop's own, s (a third of a throw's run-up).
const LATE_S: f64 = 0.35;

/// Runs `gains` from +-`error_rad` and from zero with the estimator usual at the period; `event_s` is the release.
pub fn tracking(
    plant: &Plant,
    reference: &impl Reference,
    gains: Gains,
    (period_s, delay_s): (f64, f64),
    error_rad: f64,
    event_s: f64,
) -> Tracking {
    let run = |start_error_rad: f64| {
        let estimator = Estimator::usual(period_s);
        let setup = Setup { period_s, delay_s, law: FeedForwardLaw::Aligned, estimator, start_error_rad };
        track(plant, reference, gains, &setup)
    };
    let mut worst = Tracking {
        halved_after_s: 0.0,
        late_max_rad: 0.0,
        late_max_from_rest_rad: run(0.0).position_max_rad(LATE_S),
        event_position_rad: 0.0,
        event_velocity_rad_s: 0.0,
    };
    for sign in [1.0, -1.0] {
        let found = run(sign * error_rad);
        let halved = found.below_after_s(0.5 * error_rad).unwrap_or(f64::INFINITY);
        let (position, velocity) = found.at(event_s);
        worst.halved_after_s = worst.halved_after_s.max(halved);
        worst.late_max_rad = worst.late_max_rad.max(found.position_max_rad(LATE_S));
        worst.event_position_rad = worst.event_position_rad.max(position.abs());
        worst.event_velocity_rad_s = worst.event_velocity_rad_s.max(velocity.abs());
    }
    worst
}
