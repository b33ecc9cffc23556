//! The last look at a tracked target: the arm may be waited for, and led to the start of the throw, for minutes.

use std::thread::JoinHandle;

use operator::job::Answer;

use crate::cmd::tracker::{Measured, TrackerArgs};
use crate::error::ExpectedError;

/// Looks once the arm stands at the start of the throw, which waits until then.
pub(super) struct LastLook {
    tracker: TrackerArgs,
    before: Measured,
    /// The robot waits for each answer, so the look is made before the next one.
    lockstep: bool,
    /// A look takes seconds and telegrams want their answers: it is made beside the exchange.
    under_way: Option<JoinHandle<Result<(), ExpectedError>>>,
    /// Why the throw is not made.
    pub(super) refused: Option<ExpectedError>,
}

impl LastLook {
    pub(super) fn new(tracker: &TrackerArgs, before: &Measured, lockstep: bool) -> Self {
        let (tracker, before) = (tracker.clone(), before.clone());
        Self { tracker, before, lockstep, under_way: None, refused: None }
    }

    /// Whether the target is where it was.
    pub(super) fn answer(&mut self) -> Answer {
        let look = self.under_way.take().unwrap_or_else(|| {
            let (tracker, before) = (self.tracker.clone(), self.before.clone());
            std::thread::spawn(move || tracker.still_there(&before))
        });
        if !self.lockstep && !look.is_finished() {
            self.under_way = Some(look);
            return Answer::Waiting;
        }
        match look.join() {
            Ok(Ok(())) => Answer::Yes,
            Ok(Err(moved)) => {
                self.refused = Some(moved);
                Answer::No
            }
            Err(panicked) => std::panic::resume_unwind(panicked),
        }
    }
}
