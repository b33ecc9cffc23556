//! Answers of a drive that follows set points: which ones count, and where they show the joint (pure).
//!
//! An answer holds no number of its request. It counts once per request and before the next period. The first one after a missed one may
//! be that one, late: it shows that the drive lives and is no measurement. An answer is stale if it stays the same bit by bit while the set
//! point moves, torn if the joint cannot have got there.

use core::f32::consts::TAU;

use protocol::{Duration, Frame, Instant};

use super::shape::Axis;
use crate::group::PositionSample;
use crate::joints::at_least;
use crate::rest::Rest;
use crate::settings::{JointSettings, Settings};
use crate::supervisor::is_plausible;

/// An answer is stale if it does not change in any bit while the set points move by this, rad: eight steps of a position of 16 bits.
const STALE_RAD: f32 = 3e-3;
/// A position older than this many periods does not show that a joint rests.
const AGE_PERIODS: u64 = 4;

/// What an answer is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Worth {
    Measured,
    /// Torn, or the first stale one; true for the second one in a row.
    Implausible(bool),
    /// Stale again.
    Frozen,
}

/// See the [module](self).
#[derive(Clone, Copy, Debug, Default)]
pub struct Answers {
    /// The last request has no answer yet.
    pub(super) awaited: bool,
    /// The answer before was missed: the next one may be that one, late.
    is_doubtful: bool,
    /// An answer came that may have been late: another one may follow.
    may_follow: bool,
    pub(super) missed_in_row: u32,
    implausible_in_row: u32,
    /// Last answer, and how far the set point has moved since it first came.
    last: Option<[u8; 8]>,
    moved_rad: f32,
    /// Set point sent last.
    pub(super) sent: Axis,
    /// Position of the set point before `sent`.
    sent_before_rad: f32,
    /// Position of the last set point that the drive has certainly received. Later ones may be lost.
    pub(super) taken_rad: f32,
    pub(super) sample: Option<PositionSample>,
    pub(super) rest: Rest,
}

impl Answers {
    /// The period ends. Returns the answers missed in a row, if one was missed.
    pub(super) fn close(&mut self) -> Option<u32> {
        self.is_doubtful = core::mem::take(&mut self.awaited);
        self.may_follow = false;
        self.is_doubtful.then(|| {
            self.missed_in_row = self.missed_in_row.saturating_add(1);
            self.missed_in_row
        })
    }

    /// Whether an answer counts that can be one to the last request. `doubts`: the first one after a missed one may be late.
    pub(super) fn admits(&mut self, doubts: bool) -> bool {
        if !(self.awaited || self.may_follow) {
            return false;
        }
        self.may_follow = doubts && core::mem::take(&mut self.is_doubtful);
        if self.may_follow {
            self.came();
        }
        !self.may_follow
    }

    /// Takes the position of an answer that does not count: it shows whether the drive received the set point before the last one.
    pub(super) fn take_doubtful(&mut self, q_rad: f32) {
        let step_rad = (self.sent_before_rad - self.taken_rad).abs();
        // A shaft whose next set point is lost overshoots by up to half a step.
        if self.may_follow && (q_rad - self.sent_before_rad).abs() < 0.25 * step_rad {
            self.taken_rad = self.sent_before_rad;
        }
    }

    /// The last request has its answer.
    pub(super) fn came(&mut self) {
        (self.awaited, self.missed_in_row) = (false, 0);
    }

    /// Takes a position that the drive measured at `at`. `follows`: the joint should move with its set points. A joint stands
    /// within `band_rad`.
    pub(super) fn take(
        &mut self,
        frame: &Frame,
        q_rad: f32,
        at: Instant,
        limits: &JointSettings,
        follows: bool,
        band_rad: f32,
    ) -> Worth {
        let mut data = [0; 8];
        data.iter_mut().zip(frame.data()).for_each(|(to, from)| *to = *from);
        if self.last != Some(data) {
            (self.last, self.moved_rad) = (Some(data), 0.0);
        }
        let is_stale = follows && q_rad.is_finite() && self.moved_rad >= STALE_RAD;
        if is_stale || !is_plausible(q_rad, at, self.sample, limits.v_max_rad_s) {
            self.implausible_in_row = self.implausible_in_row.saturating_add(1);
            let again = self.implausible_in_row > 1;
            return if again && is_stale { Worth::Frozen } else { Worth::Implausible(again) };
        }
        let sample = PositionSample { q_rad, at };
        (self.implausible_in_row, self.taken_rad) = (0, self.sent.q_rad);
        self.sample = Some(sample);
        self.rest.take_within(sample, band_rad);
        Worth::Measured
    }

    /// The drive counts from elsewhere: all its positions are shifted.
    pub(super) fn shift(&mut self, by_rad: f32) {
        if by_rad != 0.0 {
            self.sample = self.sample.map(|s| PositionSample { q_rad: s.q_rad + by_rad, ..s });
            self.rest = Rest::default();
        }
    }

    /// Notes that the set point is sent in this period. Returns its acceleration since the last one, rad/s².
    pub(super) fn send(&mut self, set: Axis, dt_s: f32) -> f32 {
        self.moved_rad = at_least(self.moved_rad + (set.q_rad - self.sent.q_rad).abs(), 0.0);
        let qdd_rad_s2 = (set.v_rad_s - self.sent.v_rad_s) / dt_s;
        self.sent_before_rad = core::mem::replace(&mut self.sent, set).q_rad;
        qdd_rad_s2
    }

    /// Since when the joint has stood as measured.
    pub(super) fn rests_since(&self, now: Instant, settings: &Settings) -> Option<Instant> {
        self.rest.since(now, age_max(settings))
    }

    /// See [`crate::group::DriveGroup::is_moving`].
    pub(super) fn is_moving(&self, now: Instant, settings: &Settings) -> bool {
        self.rest.is_moving(now, age_max(settings))
    }
}

fn age_max(settings: &Settings) -> Duration {
    settings.cycle_period() * AGE_PERIODS
}

/// The turn by which a position within a turn must be shifted to lie within the soft limits; `None` unless there is just one.
pub(super) fn only_turn_rad(limits: &JointSettings, q_rad: f32) -> Option<f32> {
    let mut inside = [-TAU, 0.0, TAU].into_iter().filter(|turn_rad| limits.holds(q_rad + turn_rad));
    inside.next().filter(|_| inside.next().is_none())
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::JointIndex;

    #[test]
    fn turn_is_chosen_only_if_it_is_the_only_one_within_the_limits() {
        let mut limits = *Settings::powercube6().joint.at(JointIndex::new(0).unwrap());
        // The first joint of an OpenArm.
        (limits.q_min_rad, limits.q_max_rad) = (-80_f32.to_radians(), 200_f32.to_radians());
        let turn = |q_deg: f32| only_turn_rad(&limits, q_deg.to_radians());
        assert_eq!(turn(90.0), Some(0.0));
        assert_eq!(turn(-170.0), Some(TAU), "parked at 190 degrees");
        assert_eq!(turn(-120.0), None, "neither -120 nor 240 degrees");
        (limits.q_min_rad, limits.q_max_rad) = (-4.0, 4.0);
        assert_eq!(only_turn_rad(&limits, 3.0), None, "also at -3.28 rad");
    }

    #[test]
    fn an_answer_counts_once_and_the_first_after_a_missed_one_is_no_measurement() {
        let mut answers: Answers = Answers::default();
        assert!(!answers.admits(true), "nobody asked");
        answers.awaited = true;
        assert!(answers.admits(true));
        answers.came();
        assert!(!answers.admits(true), "twice");
        answers.awaited = true;
        assert_eq!(answers.close(), Some(1));
        answers.awaited = true;
        assert!(!answers.admits(true), "it may be the late one");
        assert_eq!(answers.missed_in_row, 0);
        assert!(answers.admits(true), "the right one follows");
        assert!(!answers.admits(true));
        assert_eq!(answers.close(), None);
    }
}
