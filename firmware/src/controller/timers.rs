//! What the controller waits for beside its group: each deadline by name, the earliest of them, and the reaction
//! when it has come. One call serves everything that is due; afterwards no deadline is at or before `now`.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use crate::fault::{Cause, Fault};
use crate::group::DriveGroup;
use crate::spline::Spline;
use crate::state::{State, StateKind, StopWay};
use crate::store::Storage;

/// A deadline of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Timer {
    /// The gripper's output is switched.
    Gripper,
    /// An offer to arm ends.
    Offer,
    /// Limits beyond those of the robot end; only while nothing moves.
    Unlock,
    /// The host was not heard for too long.
    Host,
    /// The group is disarmed if no run was ordered.
    Arming,
    /// An ordered run is so near that the group must begin to lead the drives.
    Start,
    /// Longest time of a joint's homing.
    Homing,
    /// Longest time from the end of a plan to rest.
    Parking,
    /// Longest time of a way to stop.
    Stop,
}

/// Deadlines at one time, and one more for each deadline that a served deadline starts.
const SERVED_MAX: usize = 16;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// The table of deadlines. Those of a state end with it.
    fn timers(&self) -> [Option<(Timer, Instant)>; 5] {
        let of_state = match *self.machine.state() {
            State::Armed { start: Some(start), .. } => {
                Some((Timer::Start, start.saturating_sub(self.start_ahead())))
            }
            State::Armed { until, .. } => Some((Timer::Arming, until)),
            State::Homing(homing) => Some((Timer::Homing, homing.deadline)),
            State::Running { parking: Some(until), .. } => Some((Timer::Parking, until)),
            State::Stopping { deadline, .. } => Some((Timer::Stop, deadline)),
            _ => None,
        };
        let stands = !self.kind().may_move() && self.kind() != StateKind::Boot;
        [
            self.gripper.next_at().map(|at| (Timer::Gripper, at)),
            self.offer.map(|offer| (Timer::Offer, offer.until)),
            self.unlock.filter(|_| stands).map(|unlock| (Timer::Unlock, unlock.until)),
            self.host_lost_at().map(|at| (Timer::Host, at)),
            of_state,
        ]
    }

    /// When the host of this state counts as lost; `None` if the state needs no host.
    fn host_lost_at(&self) -> Option<Instant> {
        let needed = match self.machine.state() {
            State::Armed { .. } | State::Homing(_) | State::Running { .. } => true,
            State::Jogging(jog) => !jog.released,
            _ => false,
        };
        // The host is in time until the last microsecond of the time-out.
        let timeout = Duration::from_micros(u64::from(self.settings.host_timeout_us) + 1);
        if needed { Some(self.session.heard_at().map_or(self.now, |heard| heard + timeout)) } else { None }
    }

    /// The earliest deadline.
    pub(super) fn next_timer(&self) -> Option<Instant> {
        self.timers().into_iter().flatten().map(|(_, at)| at).min()
    }

    /// Serves all deadlines that have come, the earliest one first.
    pub(super) fn expire(&mut self, now: Instant) {
        for _ in 0..SERVED_MAX {
            let due = self.timers().into_iter().flatten().filter(|(_, at)| *at <= now);
            let Some((timer, _)) = due.min_by_key(|(_, at)| *at) else { return };
            self.expired(now, timer);
        }
    }

    #[inline(never)]
    fn expired(&mut self, now: Instant, timer: Timer) {
        match (timer, *self.machine.state()) {
            (Timer::Gripper, _) => {
                if let Some(open) = self.gripper.take_due(now) {
                    self.set_gripper(now, open);
                }
            }
            (Timer::Offer, _) => self.offer = None,
            (Timer::Unlock, _) => self.lock_limits(now),
            (Timer::Arming, _) | (Timer::Host, State::Armed { .. }) => self.enter_standing(now, State::Ready),
            (Timer::Host, _) => self.fail(now, Fault::group(Cause::HostLost)),
            (Timer::Start, State::Armed { start: Some(start), .. }) => self.start_when_due(now, start),
            (Timer::Homing, State::Homing(homing)) => {
                self.fail(now, Fault::at(Cause::HomingTimeout, homing.joint));
            }
            (Timer::Stop, State::Stopping { fault, way: StopWay::Quick, .. }) => self.end_stop(now, fault),
            (Timer::Stop, State::Stopping { fault, way: StopWay::Path, clock, .. }) => {
                self.quick_stop(now, fault, clock);
            }
            (Timer::Parking | Timer::Stop, _) => {
                self.fail(now, Fault { cause: Cause::RestNotReached, joint: self.not_at_rest(now) });
            }
            (Timer::Start | Timer::Homing, _) => {}
        }
    }
}
