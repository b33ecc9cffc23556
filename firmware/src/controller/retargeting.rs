//! New end states in flight: what must hold, and taking one over.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::Controller;
use crate::fault::{Cause, Refusal};
use crate::group::DriveGroup;
use crate::joints::PerJoint;
use crate::orders::{Done, Target};
use crate::path::PathClock;
use crate::retarget::{Course, EndState, OutOfReach, REACH_MAX_US, REACH_MIN_US};
use crate::spline::Spline;
use crate::state::State;
use crate::store::Storage;

/// Periods whose set points the drives have, or get before a change can act.
const COMMITTED_CYCLES: u64 = 2;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Takes a new end state over, or refuses it and changes nothing.
    #[inline(never)]
    pub(super) fn order_retarget(&mut self, now: Instant, target: &Target) -> Result<Done, Refusal> {
        let State::Running { clock, parking: None } = *self.machine.state() else {
            return Err(Refusal::of(Cause::OrderNotNow));
        };
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        let envelope = committed.header.envelope.ok_or(Refusal::of(Cause::NoEnvelope))?;
        if u32::from(target.joints) != self.settings.joints {
            return Err(Refusal::of(Cause::BadValue));
        }
        let (from_us, to_us) = self.reach(now, &clock, target.at)?;
        let spline = self.spline.borrow_mut();
        let mut courses: PerJoint<Course> = PerJoint::default();
        for joint in self.settings.joints() {
            let along = spline.at(joint, from_us.into());
            let start = EndState { q_rad: along.q_rad, qd_rad_s: along.qd_rad_s };
            let bounds = envelope.joint.at(joint);
            let course = Course::solve((from_us, start), (to_us, target.state.get(joint)), bounds)
                .and_then(|course| course.check(bounds).map(|()| course))
                .map_err(|out| Refusal::at(cause_of(out), joint))?;
            courses.set(joint, course);
        }
        let end_us = self.settings.joints().map(|joint| courses.at(joint).end_us()).max().unwrap_or(to_us);
        let end = clock.when(end_us);
        let opening = Duration::from_micros(self.settings.gripper_opening_us.into());
        let mut gripper = self.gripper.clone();
        gripper.cancel();
        for (index, &(at, action)) in target.events.iter().flatten().enumerate() {
            let is_planned = at <= end && gripper.plan(action, at, opening);
            if !is_planned || gripper.next_at().is_some_and(|next| next < now) {
                return Err(Refusal::in_file(Cause::TargetEvent, None, index));
            }
        }
        self.gripper = gripper;
        spline.follow(&courses);
        self.targets_taken = self.targets_taken.saturating_add(1);
        Ok(Done::Taken)
    }

    /// Time from now until the motion can still change: the set points that the drives have, or get before a change can act.
    #[must_use]
    pub fn committed(&self) -> Duration {
        let profile = self.group.profile(&self.settings);
        profile.period * COMMITTED_CYCLES + profile.lag
    }

    /// First time at which the motion can still change, and time at which the end state is to be reached; both µs of the plan.
    fn reach(&self, now: Instant, clock: &PathClock, at: Instant) -> Result<(u32, u32), Refusal> {
        let (open_us, _) = clock.at(now + self.committed());
        let from_us = u32::try_from(open_us.max(0)).map_err(|_| Refusal::of(Cause::TargetTooFar))?;
        let reach_us = clock.at(at).0.saturating_sub(i64::from(from_us));
        if reach_us < i64::from(REACH_MIN_US) {
            return Err(Refusal::of(Cause::TargetTooSoon));
        }
        let reach_us = u32::try_from(reach_us).ok().filter(|reach_us| *reach_us <= REACH_MAX_US);
        let to_us = reach_us.and_then(|reach_us| from_us.checked_add(reach_us));
        Ok((from_us, to_us.ok_or(Refusal::of(Cause::TargetTooFar))?))
    }
}

const fn cause_of(out: OutOfReach) -> Cause {
    match out {
        OutOfReach::Numbers => Cause::BadValue,
        OutOfReach::Position => Cause::TargetPosition,
        OutOfReach::Velocity => Cause::TargetVelocity,
        OutOfReach::Acceleration => Cause::TargetAcceleration,
    }
}
