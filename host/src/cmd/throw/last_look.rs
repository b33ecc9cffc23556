//! The last look at a tracked target: an industrial robot may be waited for, and led to the start of the throw, for minutes.

use std::thread::JoinHandle;

use operator::rsi::station::Station;
use protocol::Instant;

use crate::cmd::tracker::{Measured, TrackerArgs};
use crate::error::ExpectedError;

/// Looks once the arm stands at the start of the throw, which its station holds until then.
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

    /// Called with each telegram; false if the target is not where it was.
    pub(super) fn allows(&mut self, now: Instant, station: &mut Station) -> bool {
        if !station.is_held() {
            return true;
        }
        let look = self.under_way.take().unwrap_or_else(|| {
            let (tracker, before) = (self.tracker.clone(), self.before.clone());
            std::thread::spawn(move || tracker.still_there(&before))
        });
        if !self.lockstep && !look.is_finished() {
            self.under_way = Some(look);
            return true;
        }
        match look.join() {
            Ok(Ok(())) => station.proceed_from_hold(now),
            Ok(Err(moved)) => self.refused = Some(moved),
            Err(panicked) => std::panic::resume_unwind(panicked),
        }
        self.refused.is_none()
    }
}
