//! Follows a run by the states that a controller reports.

use protocol::Instant;
use protocol::cyphal::cubecell::group_state::{GroupState, State};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Following {
    ordered_at: Instant,
    last: Option<u16>,
    seen_running: bool,
}

impl Following {
    /// Of a run that was ordered at `ordered_at`.
    pub(crate) const fn new(ordered_at: Instant) -> Self {
        Self { ordered_at, last: None, seen_running: false }
    }

    /// True if the controller has reported that the plan runs.
    pub(crate) const fn has_run(&self) -> bool {
        self.seen_running
    }

    /// Takes the last report, received at `at`; `progress` gets each message once. True if the run has ended.
    pub(crate) fn has_ended(
        &mut self,
        at: Instant,
        state: &GroupState,
        progress: &mut dyn FnMut(Instant, &GroupState),
    ) -> bool {
        if self.last != Some(state.sequence) {
            self.last = Some(state.sequence);
            progress(at, state);
        }
        self.seen_running |= state.state == State::Running;
        // States come ten times a second: a run that was stopped before its first state was never seen to run.
        let ended_early = at > self.ordered_at && matches!(state.state, State::Fault | State::Stopped);
        ended_early || (self.seen_running && !matches!(state.state, State::Running | State::Stopping))
    }
}
