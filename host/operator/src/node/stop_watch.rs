//! Stops that this program did not send: the one place that detects them.
//!
//! Three things show one: a stop message of another node, a halt broadcast to the drives, and a controller that
//! reports that it stopped. A halt broadcast has no sender, and a controller halts the drives at every stop of its
//! own. The controller reports its own stop at once, so a halt without report came from another node. So did the
//! first of two halts before the report: at rest the controller notices the halted drives a little later, and
//! treats them as a fault.

use firmware::fault::Cause;
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::stop;
use protocol::cyphal::id::{NodeId, Route};
use protocol::powercube::{Address, Broadcast};
use protocol::{Duration, Frame, Id, Instant};

/// A controller reports a state that it enters within this time: it sends ten a second by default.
const REPORT_MAX: Duration = Duration::from_millis(300);
/// An arm that was stopped stands by then.
pub(crate) const REST_MAX: Duration = Duration::from_secs(3);

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopSource {
    /// A stop message of this node.
    Message(NodeId),
    /// A halt broadcast to the drives; it has no sender.
    Halt,
    /// A controller reported that it stopped.
    Controller,
}

/// A stop that this program did not give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopSeen {
    pub at: Instant,
    pub source: StopSource,
    /// State that the controller reports: Stopped or Fault; `None` without a report.
    pub group: Option<GroupState>,
    /// Another node or a person stopped the arm; it was not a fault.
    pub by_other: bool,
}

impl std::fmt::Display for StopSeen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.source {
            StopSource::Message(node) => write!(f, "node {} sent a stop message", node.get()),
            StopSource::Halt => f.write_str("another node halted the drives"),
            StopSource::Controller => f.write_str("the controller stopped"),
        }
    }
}

/// True for a stop that was ordered; false for a fault.
pub(crate) fn is_stop_by_other(cause: u16) -> bool {
    const CAUSES: [Cause; 3] = [Cause::StopOrdered, Cause::StopMessage, Cause::HaltedByOther];
    CAUSES.iter().any(|known| known.code() == cause)
}

/// Detects stops while it is on. It does not get the frames of this program.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StopWatch {
    on: bool,
    seen: Option<StopSeen>,
    /// Halt broadcasts since then.
    halts: u32,
    /// No frame of the controller is given to it.
    others_only: bool,
    /// Last reported state.
    state: Option<State>,
}

impl StopWatch {
    /// For frames of other nodes only, without those of the controller.
    pub(crate) const fn of_others() -> Self {
        Self { on: false, seen: None, halts: 0, others_only: true, state: None }
    }

    /// Forgets earlier stops, and detects new ones from now on.
    pub(crate) const fn start(&mut self) {
        (self.on, self.seen, self.halts) = (true, None, 0);
    }

    /// Stops detecting, so that the work that must follow a stop is not ended by it.
    pub(crate) const fn end(&mut self) {
        self.on = false;
    }

    /// A stop was seen and not reported yet.
    pub(crate) const fn is_pending(&self) -> bool {
        self.on && self.seen.is_some()
    }

    /// A frame of another node, or of the controller.
    pub(crate) fn take_frame(&mut self, at: Instant, frame: &Frame) {
        let source = match frame.id() {
            Id::Extended(id) => match Route::parse(id) {
                Ok((_, Route::Message { source, subject })) if subject == stop::SUBJECT => {
                    StopSource::Message(source)
                }
                _ => return,
            },
            Id::Standard(_) if Address::of(frame.id()) == Some(Address::Broadcast) => {
                if Broadcast::decode(frame) != Ok(Broadcast::Halt) {
                    return;
                }
                StopSource::Halt
            }
            Id::Standard(_) => return,
        };
        self.note(at, source);
    }

    /// What the controller reports.
    pub(crate) fn take_state(&mut self, at: Instant, group: &GroupState) {
        let stands = |state| matches!(state, State::Stopped | State::Fault);
        let before = self.state.replace(group.state);
        if stands(group.state) && before.is_some_and(|before| !stands(before)) {
            self.note(at, StopSource::Controller);
        }
    }

    fn note(&mut self, at: Instant, source: StopSource) {
        if self.on {
            self.halts += u32::from(source == StopSource::Halt);
            self.seen.get_or_insert(StopSeen { at, source, group: None, by_other: true });
        }
    }

    /// The stop, once the controller has reported it or is known not to: then the job ends. `group` is its last
    /// report, with its time; `None` without a controller.
    pub(crate) fn due(&self, now: Instant, group: Option<(Instant, GroupState)>) -> Option<StopSeen> {
        let seen = self.seen.filter(|_| self.on)?;
        let Some((heard_at, group)) = group else { return Some(seen) };
        let since = now.saturating_since(seen.at);
        match group.state {
            State::Stopped | State::Fault if heard_at >= seen.at => {
                let by_other = match seen.source {
                    StopSource::Message(_) => true,
                    StopSource::Halt => {
                        self.others_only || self.halts > 1 || is_stop_by_other(group.fault_cause)
                    }
                    StopSource::Controller => is_stop_by_other(group.fault_cause),
                };
                Some(StopSeen { group: Some(group), by_other, ..seen })
            }
            state if since < REPORT_MAX || (state.may_move() && since < REST_MAX) => None,
            _ => Some(seen),
        }
    }
}
