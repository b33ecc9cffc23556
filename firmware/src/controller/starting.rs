//! Starting a run.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use super::tracker::Tracker;
use crate::fault::Cause;
use crate::group::{Command, DriveGroup};
use crate::orders::OrderKind;
use crate::path::PathClock;
use crate::spline::Spline;
use crate::state::State;
use crate::store::Storage;
use crate::trace::TraceEvent;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Begins the committed trajectory at `start`, at least the lead of the group from now. The caller has checked
    /// that it may run.
    pub(super) fn start_run(&mut self, now: Instant, start: Instant) {
        self.spline.borrow_mut().follow_knots();
        self.group.command(now, &self.settings, Command::Track);
        for joint in self.settings.joints() {
            let q_start_rad = self.spline.borrow().start_rad(joint);
            let q_rad = self.group.position(joint).map_or(q_start_rad, |position| position.q_rad);
            let weights = self.settings.weights();
            self.trackers.set(joint, Tracker::begin(now, q_rad - q_start_rad, weights));
        }
        let opening = Duration::from_micros(self.settings.gripper_opening_us.into());
        self.gripper.cancel();
        if let Some(committed) = self.store.committed() {
            for event in committed.header.events.as_slice() {
                // There is room: a plan has no more events than fit.
                let _ = self.gripper.plan(
                    event.action,
                    start + Duration::from_micros(event.t_us.into()),
                    opening,
                );
            }
            (self.next_segment, self.last_segment) = (committed.header.next, None);
        }
        (self.late_in_row, self.targets_taken, self.is_on_plan) = (0, 0, false);
        self.motions_before = self.group.counters().motions;
        self.enter(now, State::Running { clock: PathClock::starting(start), parking: None });
    }

    /// True if the first set point within the plan comes so late that the joints would leap from rest into motion.
    /// A plan begins at rest: in its first two periods it moves less than the drives resolve. For drives that are
    /// led and already move, it is a late cycle like any other.
    pub(super) fn misses_start(&mut self, now: Instant, s_us: i64) -> bool {
        if self.is_on_plan || s_us <= 0 {
            return false;
        }
        let period_us = self.group.profile(&self.settings).period.as_micros() as i64;
        self.is_on_plan = s_us <= 2 * period_us || self.any_moves(now);
        !self.is_on_plan
    }

    /// Ends a run, or the wait for it, before anything has moved. If drives have got set points during the wait,
    /// they ramp to rest where the plan begins: a drive keeps the last acceleration that it got.
    pub(super) fn not_begun(&mut self, now: Instant, cause: Cause) {
        self.gripper.cancel();
        self.note(now, TraceEvent::Refused(OrderKind::Run, cause));
        let is_running = matches!(self.machine.state(), State::Running { .. });
        if is_running && self.group.counters().motions != self.motions_before {
            self.park(now);
        } else {
            self.enter_standing(now, State::Ready);
        }
    }
}
