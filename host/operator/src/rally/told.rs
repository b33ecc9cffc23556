//! What the catcher tells about its catch.
//!
//! The catcher knows its decisions, its joints and what its tracker saw. It does not know the court.

use nalgebra::Vector3;
use planner::catch::arm::CatchArm;
use planner::catch::online::Catcher;
use planner::catch::search::Decline;

use hil_sim::court::JointsNow;

/// The last part of a trial, in which a caught ball lies still, s.
const LAST_S: f64 = 0.3;
/// A ball in the cup is seen there this often in that time.
const SEEN_MIN: usize = 6;
/// Distance of a ball in the cup from the middle of its cavity, at most, m.
const IN_CUP_M: f64 = 0.06;
/// Distance of a ball that lies still from the mean of its places, at most, m.
const STILL_M: f64 = 0.012;

/// What the catcher tells about its catch, from what it saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CatchOutcome {
    /// The tracker saw the ball in the cup at the end, whether a catch was tried or not.
    Caught,
    /// The tracker saw the ball elsewhere after the catch.
    Missed,
    /// A catch was tried; the tracker saw nothing afterwards.
    Unknown,
    /// No catch was tried; why.
    Declined(Decline),
    /// No ball was seen in flight.
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

/// `seen` are all markers with their times (s) and places (m), in order of arrival.
pub(super) fn tell(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    halted: bool,
    joints: &JointsNow<6>,
    now_s: f64,
) -> CatchOutcome {
    if halted {
        return CatchOutcome::Halted;
    }
    let choice = catcher.choice();
    let from_s = choice.map_or(f64::NEG_INFINITY, |choice| choice.t_s).max(now_s - LAST_S);
    let last: Vec<Vector3<f64>> = seen.iter().filter(|(t_s, _)| *t_s > from_s).map(|(_, p)| *p).collect();
    // A ball may fall into a cup that waits.
    if lies_in_cup(catcher.arm(), &last, joints) {
        return CatchOutcome::Caught;
    }
    match choice {
        Some(_) if last.is_empty() => CatchOutcome::Unknown,
        Some(_) => CatchOutcome::Missed,
        None => catcher.declined().map_or(CatchOutcome::NothingThrown, CatchOutcome::Declined),
    }
}

fn lies_in_cup(arm: &CatchArm, seen: &[Vector3<f64>], joints: &JointsNow<6>) -> bool {
    let (mouth, axis, _) = arm.mouth(&joints.q, &joints.qd);
    let middle = mouth - axis * (0.5 * arm.cup().length_m);
    let inside: Vec<&Vector3<f64>> = seen.iter().filter(|p| (*p - middle).norm() < IN_CUP_M).collect();
    if inside.len() < SEEN_MIN {
        return false;
    }
    let mean = inside.iter().copied().sum::<Vector3<f64>>() / inside.len() as f64;
    inside.iter().all(|p| (*p - mean).norm() < STILL_M)
}
