//! What the catcher reports of its catch.
//!
//! The catcher knows its decisions, its joints and what its tracker saw. It does not know the court.

use nalgebra::Vector3;
use planner::catch::arm::CatchArm;
use planner::catch::online::Catcher;
use planner::catch::task::Decline;

use hil_sim::court::JointsNow;

use crate::flight_estimator::BallWatch;

/// The last part of a trial, in which a caught ball lies still, s.
const LAST_S: f64 = 0.3;
/// A ball in the cup is seen there this often in that time.
const SEEN_MIN: usize = 6;
/// Newest markers of which none is in the cup, over this long: the ball is out of it, s.
const GONE_S: f64 = 0.02;
/// Distance of a ball in the cup from the middle of its cavity, at most, m.
const IN_CUP_M: f64 = 0.06;
/// Distance of a ball that lies still from the mean of its places, at most, m.
const STILL_M: f64 = 0.012;

/// What the catcher reports of its catch, from what it saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CatchOutcome {
    /// The tracker saw the ball in the cup at the end, whether a catch was tried or not.
    Caught,
    /// The tracker saw the ball elsewhere after the catch.
    Missed,
    /// A catch was tried and the tracker saw nothing afterwards, or the ball still moved in the cup at the end.
    Unknown,
    /// No catch was tried; why.
    Declined(Decline),
    /// No ball was seen in flight, whether one was announced or not.
    NothingThrown,
    /// The arm stopped because of a fault.
    Halted,
}

impl CatchOutcome {
    /// Whether the court's word, "the ball lies in the cup", agrees; [`CatchOutcome::Unknown`] and [`CatchOutcome::Halted`] say
    /// nothing about the ball.
    #[must_use]
    pub fn agrees(self, caught: bool) -> bool {
        match self {
            Self::Caught => caught,
            Self::Missed | Self::Declined(_) | Self::NothingThrown => !caught,
            Self::Unknown | Self::Halted => true,
        }
    }
}

/// Where the ball is at the end, by its markers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum InCup {
    No,
    /// It rolls or bounces there, and may still come out.
    Moving,
    Still,
}

/// What the tracker saw in the last time before `now_s`: all markers with their times (s) and places (m), in order of arrival.
fn last_seen(catcher: &Catcher<'_>, seen: &[(f64, Vector3<f64>)], now_s: f64) -> Vec<(f64, Vector3<f64>)> {
    let catch_s = catcher.choice().map_or(f64::NEG_INFINITY, |choice| choice.t_s);
    let from_s = catch_s.max(now_s - LAST_S);
    seen.iter().filter(|(t_s, _)| *t_s > from_s).copied().collect()
}

/// The newest markers in the cup. A ball may fall into a cup that waits.
fn inside(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> Vec<Vector3<f64>> {
    let arm: &CatchArm = catcher.arm();
    let (mouth, axis, _) = arm.mouth(&joints.q, &joints.qd);
    let middle = mouth - axis * (0.5 * arm.cup().length_m());
    let last = last_seen(catcher, seen, now_s);
    let inside: Vec<_> = last.iter().filter(|(_, p)| (p - middle).norm() < IN_CUP_M).collect();
    // A ball that has fallen out is in the cup no longer, however long it was there.
    let newest_s = last.iter().map(|(t_s, _)| *t_s).fold(f64::NEG_INFINITY, f64::max);
    let gone = inside.iter().all(|(t_s, _)| *t_s < newest_s - GONE_S);
    if gone || inside.len() < SEEN_MIN { Vec::new() } else { inside.into_iter().map(|(_, p)| *p).collect() }
}

/// Mean of the newest markers in the cup, m.
pub(super) fn place_in_cup(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> Option<Vector3<f64>> {
    let inside = inside(catcher, seen, joints, now_s);
    (!inside.is_empty()).then(|| inside.iter().sum::<Vector3<f64>>() / inside.len() as f64)
}

/// Whether the ball is seen in the cup.
pub(super) fn in_cup(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> InCup {
    let inside = inside(catcher, seen, joints, now_s);
    let Some(mean) = place_in_cup(catcher, seen, joints, now_s) else { return InCup::No };
    if inside.iter().all(|p| (p - mean).norm() < STILL_M) { InCup::Still } else { InCup::Moving }
}

/// The report at the time `now_s`; `seen` are all markers with their times (s) and places (m), in order of arrival.
#[must_use]
pub fn report(
    catcher: &Catcher<'_>,
    watch: &BallWatch,
    seen: &[(f64, Vector3<f64>)],
    halted: bool,
    joints: &JointsNow,
    now_s: f64,
) -> CatchOutcome {
    if halted {
        return CatchOutcome::Halted;
    }
    let nothing_seen = last_seen(catcher, seen, now_s).is_empty();
    match (in_cup(catcher, seen, joints, now_s), catcher.choice()) {
        (InCup::Still, _) => CatchOutcome::Caught,
        (InCup::Moving, _) => CatchOutcome::Unknown,
        (InCup::No, _) if watch.saw_no_release() => CatchOutcome::NothingThrown,
        (InCup::No, Some(_)) if nothing_seen => CatchOutcome::Unknown,
        (InCup::No, Some(_)) => CatchOutcome::Missed,
        (InCup::No, None) => catcher.declined().map_or(CatchOutcome::NothingThrown, CatchOutcome::Declined),
    }
}
