//! What the catcher reports of its catch.
//!
//! The catcher knows its decisions, its joints and what its tracker saw. It does not know the cell.

use nalgebra::Vector3;
use planner::catch::arm::CatchArm;
use planner::catch::online::Catcher;
use planner::catch::task::Decline;

use hil_sim::two_arms::JointsNow;

use crate::flight_estimator::BallWatch;

/// The last part of a trial, in which a caught ball lies still, s.
const LAST_S: f64 = 0.6;
/// The place of a ball in the cup is the mean of the markers of this last time, s.
const PLACE_S: f64 = 0.3;
/// A ball in the cup is seen there this often in that time.
const SEEN_MIN: usize = 6;
/// Newest markers of which none is in the cup, over this long: the ball is out of it, s.
const GONE_S: f64 = 0.02;
/// Distance of a ball in the cup from the middle of its cavity, at most, m.
const IN_CUP_M: f64 = 0.06;
/// A ball lies still after so long near one place, s. Bounces that are too low to be seen there end in this time, up to a restitution of 0.7.
const STILL_S: f64 = 0.5;
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
    /// Whether the cell's word, "the ball lies in the cup", agrees; [`CatchOutcome::Unknown`] and [`CatchOutcome::Halted`] say
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

/// The newest markers in the cup, with their times, and when a frame last showed none there. A ball may fall into a cup that waits.
struct Inside {
    markers: Vec<(f64, Vector3<f64>)>,
    outside_s: f64,
}

fn inside(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> Option<Inside> {
    let arm: &CatchArm = catcher.arm();
    let (mouth, axis, _) = arm.mouth(&joints.q, &joints.qd);
    let middle = mouth - axis * (0.5 * arm.cup().length_m());
    let last = last_seen(catcher, seen, now_s);
    let (markers, others): (Vec<_>, Vec<_>) = last.iter().partition(|(_, p)| (p - middle).norm() < IN_CUP_M);
    // A false marker elsewhere is no frame without the ball.
    let empty = others.iter().map(|(t_s, _)| *t_s).filter(|t_s| markers.iter().all(|(in_s, _)| in_s != t_s));
    let outside_s = empty.fold(f64::NEG_INFINITY, f64::max);
    // A ball that has fallen out is in the cup no longer, however long it was there.
    let newest_s = last.iter().map(|(t_s, _)| *t_s).fold(f64::NEG_INFINITY, f64::max);
    let gone = markers.iter().all(|(t_s, _)| *t_s < newest_s - GONE_S);
    (!gone && markers.len() >= SEEN_MIN).then_some(Inside { markers, outside_s })
}

/// Mean of the newest markers in the cup, m.
pub(super) fn place_in_cup(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> Option<Vector3<f64>> {
    let mut markers = inside(catcher, seen, joints, now_s)?.markers;
    markers.retain(|(t_s, _)| *t_s > now_s - PLACE_S);
    (!markers.is_empty()).then(|| mean(&markers))
}

fn mean(markers: &[(f64, Vector3<f64>)]) -> Vector3<f64> {
    markers.iter().map(|(_, p)| p).sum::<Vector3<f64>>() / markers.len() as f64
}

/// Whether the ball is seen in the cup.
pub(super) fn in_cup(
    catcher: &Catcher<'_>,
    seen: &[(f64, Vector3<f64>)],
    joints: &JointsNow,
    now_s: f64,
) -> InCup {
    match inside(catcher, seen, joints, now_s) {
        None => InCup::No,
        Some(inside) if inside.is_still() => InCup::Still,
        Some(_) => InCup::Moving,
    }
}

impl Inside {
    /// All markers are near their mean, and were for long enough: also a ball at the top of a bounce hardly moves for some frames.
    fn is_still(&self) -> bool {
        let middle = mean(&self.markers);
        let times = self.markers.iter().map(|(t_s, _)| *t_s).filter(|t_s| *t_s > self.outside_s);
        let (first_s, last_s) = times
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), t_s| (t_s.min(first), t_s.max(last)));
        last_s - first_s >= STILL_S && self.markers.iter().all(|(_, p)| (p - middle).norm() < STILL_M)
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Markers of 120 Hz until time 0.
    fn seen(from_s: f64, height_m: impl Fn(f64) -> f64) -> Vec<(f64, Vector3<f64>)> {
        let frames = (from_s * 120.0) as i32..=0;
        frames.map(|k| f64::from(k) / 120.0).map(|t_s| (t_s, Vector3::z() * height_m(t_s))).collect()
    }

    #[test]
    fn a_ball_at_the_top_of_a_bounce_is_not_still_and_one_that_lies_is() {
        let lies =
            Inside { markers: seen(-0.6, |t_s| 0.002 * (300.0 * t_s).sin()), outside_s: f64::NEG_INFINITY };
        assert!(lies.is_still());
        // It has come back into the cup for 58 ms: no marker is 12 mm from their mean.
        let top = |t_s: f64| -4.9 * (t_s + 0.029).powi(2);
        let hangs = Inside { markers: seen(-0.06, top), outside_s: -0.067 };
        assert!(hangs.markers.len() >= SEEN_MIN && !hangs.is_still());
        // Seen for longer, it falls.
        assert!(!Inside { markers: seen(-0.16, top), outside_s: -0.167 }.is_still());
        // A cup with restitution 0.7: bounces of 24 mm and less, which end 0.47 s after the first one begins.
        let bounces = |begins_s: f64| {
            move |t_s: f64| {
                let (mut v_m_s, mut since_s) = (0.686, t_s - begins_s);
                if since_s < 0.0 {
                    return 0.0;
                }
                while v_m_s > 1e-3 && since_s > 2.0 * v_m_s / 9.81 {
                    since_s -= 2.0 * v_m_s / 9.81;
                    v_m_s *= 0.7;
                }
                if v_m_s > 1e-3 { v_m_s * since_s - 4.905 * since_s * since_s } else { 0.0 }
            }
        };
        let bounced =
            |begins_s| Inside { markers: seen(-0.6, bounces(begins_s)), outside_s: f64::NEG_INFINITY };
        assert!(!bounced(-0.53).is_still(), "it lies for 0.06 s");
        assert!(bounced(-1.07).is_still(), "it lies for 0.6 s");
        // It lay there, jumped out and is back for a moment.
        let mut back = lies;
        back.outside_s = -0.05;
        assert!(!back.is_still());
    }
}
