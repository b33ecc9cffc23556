//! How a job ended.
//!
//! | outcome | JSON | known from |
//! |---|---|---|
//! | [`Outcome::Landed`] | `landed` | an observer watched the ball land within the tolerance |
//! | [`Outcome::NotObserved`] | `not_observed` | the arm followed the plan and the release was ordered; the ball was not observed |
//! | [`Outcome::Missed`] | `missed` | the ball landed beyond the tolerance, or touched the arm; or the measured motion sends it beyond |
//! | [`Outcome::NotReleased`] | `not_released` | the ball is still in the hand, or the release was never ordered |
//! | [`Outcome::Stopped`] | `stopped` | the arm was stopped while it moved, or by another node or a person at any time |
//! | [`Outcome::NotThrown`] | `not_thrown` | the job ended before the throw, with the arm at rest |
//! | [`Outcome::Reached`] | `reached` | by its samples the arm followed the motion and stands at its end |
//! | [`Outcome::NotReached`] | `not_reached` | by its samples it did not |
//! | [`Outcome::NotRun`] | `not_run` | the job ended before the motion, with the arm at rest |
//! | [`Outcome::Stored`] | `stored` | the program is in the controller; nothing was to move |
//!
//! Only the simulated cell inside the program knows where its ball is. On every other bus the ball is not observed,
//! so the outcome is never [`Outcome::Landed`] there.

use super::order::{Judge, Order};
use super::record::{JobError, Record, Step};
use super::{follow, reach, throw};
use crate::dialogue::operator::OperatorError;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Outcome {
    /// The ball was seen to land within the tolerance.
    Landed,
    /// The arm followed the plan and the release was ordered; the ball was not observed.
    NotObserved,
    /// The ball landed beyond the tolerance or touched the arm, or the measured motion sends it beyond.
    Missed,
    /// The ball is still in the hand, or the release was never ordered.
    NotReleased,
    /// The arm was stopped while it moved, or by another node or a person at any time.
    Stopped,
    /// The job ended before the throw, with the arm at rest.
    #[default]
    NotThrown,
    /// The arm followed the motion, as far as its samples say, and stands at its end.
    Reached,
    NotReached,
    /// The job ended before the motion, with the arm at rest.
    NotRun,
    /// The program is in the controller.
    Stored,
}

impl Outcome {
    pub const ALL: [Self; 10] = [
        Self::Landed,
        Self::NotObserved,
        Self::Missed,
        Self::NotReleased,
        Self::Stopped,
        Self::NotThrown,
        Self::Reached,
        Self::NotReached,
        Self::NotRun,
        Self::Stored,
    ];

    /// Field `outcome` of `summary.json`.
    #[must_use]
    pub const fn json_name(self) -> &'static str {
        match self {
            Self::Landed => "landed",
            Self::NotObserved => "not_observed",
            Self::Missed => "missed",
            Self::NotReleased => "not_released",
            Self::Stopped => "stopped",
            Self::NotThrown => "not_thrown",
            Self::Reached => "reached",
            Self::NotReached => "not_reached",
            Self::NotRun => "not_run",
            Self::Stored => "stored",
        }
    }

    /// The outcome with this JSON name.
    #[must_use]
    pub fn from_json_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|outcome| outcome.json_name() == name)
    }

    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Landed => "landed",
            Self::NotObserved => "thrown, not observed",
            Self::Missed => "missed",
            Self::NotReleased => "not released",
            Self::Stopped => "stopped",
            Self::NotThrown => "not thrown",
            Self::Reached => "reached",
            Self::NotReached => "not reached",
            Self::NotRun => "not run",
            Self::Stored => "stored",
        }
    }
}

/// How a job ended, and what a person reads about it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    pub outcome: Outcome,
    /// What is known, in one sentence or two.
    pub text: String,
}

/// The verdict about a job whose record is complete but for it.
#[must_use]
pub fn judge(order: &Order<'_>, record: &Record) -> Verdict {
    let (outcome, text) = match (&record.ended, &order.judge) {
        (Some(error), judge) => {
            let outcome = match judge {
                _ if was_stopped(record, error) => Outcome::Stopped,
                Judge::Reach => Outcome::NotRun,
                _ => Outcome::NotThrown,
            };
            let step = record.at_work.map_or("start", |(step, _)| step.name());
            let ball = match judge {
                Judge::Throw { .. } => throw::ball_after_stop(record),
                Judge::Follow { .. } => follow::ball_after_stop(record),
                Judge::Reach => String::new(),
            };
            (outcome, format!("{} in the step \"{step}\": {error}{ball}", outcome.words()))
        }
        (None, Judge::Throw { tolerance_m, .. }) => throw::verdict(record, *tolerance_m),
        (None, Judge::Follow { tolerance_m, .. }) => follow::verdict(record, *tolerance_m),
        (None, Judge::Reach) => reach::verdict(record),
    };
    Verdict { outcome, text }
}

/// The arm was stopped: by another node or a person at any time, or by the controller or this program while it moved.
fn was_stopped(record: &Record, error: &JobError) -> bool {
    if matches!(error, JobError::Operator(error) if error.is_stop_by_other()) {
        return true;
    }
    let Some((step, _)) = record.at_work else { return false };
    // After the throw the ball is no longer in the hand: "not thrown" would be wrong.
    if matches!(step, Step::Flight | Step::Return) {
        return true;
    }
    let moves = matches!(step, Step::Home | Step::Approach | Step::Throw | Step::Run);
    // An order that was refused moved nothing.
    moves && matches!(error, JobError::Operator(error) if !matches!(error, OperatorError::Refused { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_outcome_has_its_own_json_name() {
        for (i, outcome) in Outcome::ALL.into_iter().enumerate() {
            assert_eq!(Outcome::from_json_name(outcome.json_name()), Some(outcome));
            assert!(Outcome::ALL[..i].iter().all(|other| other.json_name() != outcome.json_name()));
        }
        assert_eq!(Outcome::from_json_name("Landed"), None);
    }
}
