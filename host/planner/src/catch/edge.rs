//! The edge of the arm's reach: the flight is not known exactly, and part of the flights that it may be are out of reach.

use std::f64::consts::TAU;

use super::arm::CatchArm;
use super::candidates::{Candidate, Search};
use super::forecast::{Forecast, across};
use super::slot::{Slot, slot};
use super::task::{Settings, Start};

/// Rings of equal probability about the mean of a normal distribution in a plane, in standard deviations: the medians of the
/// inner and the outer half, sqrt(-2 ln(3/4)) and sqrt(-2 ln(1/4)).
const RINGS: [f64; 2] = [0.758_528, 1.665_109];
const PER_RING: u32 = 6;
/// A flight that is out of reach at the time of the candidate may be in reach this much earlier or later, s.
const SHIFTS_S: [f64; 7] = [0.0, -0.03, 0.03, -0.06, 0.06, -0.1, 0.1];
/// A catch with less of the candidate's chance that the ball stays is no catch of the same kind.
const ALIKE: f64 = 0.5;
/// Below this standard deviation of what later samples will add, nearly all flights are in reach where the candidate is, m.
const SIGMA_MIN_M: f64 = 0.003;

/// Share of the flights, as far as they are not known yet, for which an arm that goes to this candidate can still catch: at that time
/// or near it a posture inside the limits leads the cup to the ball. `directions` are given about the reverse of the ball's velocity.
pub(super) fn share_in_reach(
    arm: &CatchArm,
    settings: &Settings,
    start: &Start<'_>,
    forecast: &Forecast,
    candidate: &Candidate,
    directions: &[[f64; 3]],
) -> f64 {
    let sigma_m = candidate.ball.lateral_sigma_m();
    if sigma_m < SIGMA_MIN_M {
        return 1.0;
    }
    let limits = arm.limits(true);
    let stays = ALIKE * candidate.stays;
    let slots: Vec<Slot<'_>> = SHIFTS_S
        .iter()
        .filter_map(|shift_s| forecast.at(candidate.ball.t_s + shift_s))
        .filter(|ball| ball.t_s > start.at_s + settings.freeze_s)
        .map(|ball| slot(arm, settings, start, forecast, limits, ball))
        .collect();
    let caught = |off: (f64, f64)| {
        slots.iter().any(|slot| {
            let (a, b) = across(&slot.u);
            let mut slot = slot.clone();
            slot.ball.p_m += (a * off.0 + b * off.1) * sigma_m;
            let same = [candidate.axis.dot(&a), candidate.axis.dot(&b), -candidate.axis.dot(&slot.u)];
            let mut search = Search::new(arm, settings, start);
            search.look(&slot, &[same]);
            let caught = |search: &Search<'_>| search.best.first().is_some_and(|best| best.stays >= stays);
            if !caught(&search) {
                search.look(&slot, directions);
            }
            caught(&search)
        })
    };
    around().filter(|off| caught(*off)).count() as f64 / AROUND as f64
}

/// Number of points of [`around`].
pub(super) const AROUND: usize = RINGS.len() * PER_RING as usize;

/// By this the points of [`around`] are turned to lie in between, rad.
pub(super) const BETWEEN_RAD: f64 = 0.5 * TAU / PER_RING as f64;

/// Points about the mean of a normal distribution in a plane, each as likely as the others, in standard deviations.
pub(super) fn around() -> impl Iterator<Item = (f64, f64)> {
    RINGS.iter().flat_map(|radius| {
        (0..PER_RING).map(move |k| {
            let (y, x) = (TAU * f64::from(k) / f64::from(PER_RING)).sin_cos();
            (radius * x, radius * y)
        })
    })
}
