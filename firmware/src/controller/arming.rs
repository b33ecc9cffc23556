//! Arming in two steps, and starting a run.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant};

use super::{Controller, Offer};
use crate::fault::{Cause, Refusal};
use crate::group::{Command, DriveGroup, Law};
use crate::orders::{ARMING_VALID_MAX, Done, START_AHEAD_MAX};
use crate::registers;
use crate::spline::Spline;
use crate::state::State;
use crate::store::{FileName, Storage};
use crate::trajectory_format;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    pub(super) fn require_host(&self, now: Instant) -> Result<(), Refusal> {
        if self.host_is_alive(now) { Ok(()) } else { Err(Refusal::of(Cause::NoHost)) }
    }

    pub(super) fn order_prepare(
        &mut self,
        now: Instant,
        crc64: u64,
        valid: Duration,
    ) -> Result<Done, Refusal> {
        if valid.is_zero() || valid > ARMING_VALID_MAX {
            return Err(Refusal::of(Cause::BadValue));
        }
        self.require_host(now)?;
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        if committed.name.crc64 != crc64 {
            return Err(Refusal::of(Cause::OtherTrajectory));
        }
        let digest = registers::run_digest(&committed.sha256, &self.settings);
        if self.spline.borrow().is_altered() {
            // The last run replaced knots by those of later segments: load the knots of the file again.
            self.store.reload(&self.storage, &self.settings, self.spline.borrow_mut());
        }
        if matches!(self.machine.state(), State::Stopped { .. }) {
            // Drives are halted; a reset moves nothing. Their state words are read again before the second step.
            self.group.command(now, &self.settings, Command::Reset);
        }
        let token = self.tokens.next_token();
        self.offer = Some(Offer { token, until: now + valid });
        Ok(Done::Offer { token, valid, digest })
    }

    pub(super) fn order_confirm(
        &mut self,
        now: Instant,
        token: u32,
        valid: Duration,
    ) -> Result<Done, Refusal> {
        if valid.is_zero() || valid > ARMING_VALID_MAX {
            return Err(Refusal::of(Cause::BadValue));
        }
        if let State::Armed { token: armed, .. } = *self.machine.state() {
            return if armed == token { Ok(Done::Taken) } else { Err(Refusal::of(Cause::TokenWrong)) };
        }
        let offered = self.offer.is_some_and(|offer| offer.token == token && offer.until > now);
        if !offered {
            return Err(Refusal::of(Cause::TokenWrong));
        }
        self.require_runnable(now)?;
        self.offer = None;
        self.enter_standing(now, State::Armed { token, until: now + valid, start: None });
        Ok(Done::Taken)
    }

    /// Starts the armed trajectory, at once or at `start`.
    pub(super) fn order_run(
        &mut self,
        now: Instant,
        name: FileName,
        start: Option<Instant>,
    ) -> Result<Done, Refusal> {
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        if committed.name != name {
            return Err(Refusal::of(Cause::OtherTrajectory));
        }
        if matches!(self.machine.state(), State::Running { .. }) {
            return Ok(Done::Taken);
        }
        self.require_runnable(now)?;
        let soonest = now + self.group.profile(&self.settings).lead;
        match start {
            None => self.start_run(now, soonest),
            Some(start) if start < soonest => return Err(Refusal::of(Cause::StartPassed)),
            Some(start) if start > now + START_AHEAD_MAX => return Err(Refusal::of(Cause::StartTooFar)),
            Some(at) => {
                self.machine.start_at(at);
                self.start_when_due(now, at);
            }
        }
        Ok(Done::Taken)
    }

    /// How long before its start time a run is begun: the lead of the group, and two monitor periods in case the
    /// call comes late.
    pub(super) fn start_ahead(&self) -> Duration {
        let monitor = Duration::from_micros(self.settings.monitor_period_us.into());
        self.group.profile(&self.settings).lead + monitor * 2
    }

    /// Goes to Running when the start of an ordered run is so near that the group must begin to lead the drives. A
    /// start that has passed, or that is nearer than the lead of the group, is refused: the plan would begin with a
    /// leap.
    pub(super) fn start_when_due(&mut self, now: Instant, start: Instant) {
        if start > now + self.start_ahead() {
            return;
        }
        let passed = start < now + self.group.profile(&self.settings).lead;
        let runnable = if passed { Err(Refusal::of(Cause::StartPassed)) } else { self.require_runnable(now) };
        match runnable {
            Ok(()) => self.start_run(now, start),
            Err(refusal) => self.not_begun(now, refusal.cause),
        }
    }

    /// Time until an ordered run begins.
    pub(super) fn start_left(&self, now: Instant) -> Option<Duration> {
        match *self.machine.state() {
            State::Armed { start: Some(start), .. } => Some(start.saturating_since(now)),
            _ => None,
        }
    }

    /// All that must hold before the arm may move by itself.
    fn require_runnable(&self, now: Instant) -> Result<(), Refusal> {
        self.require_host(now)?;
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        // Settings may have changed since the commit.
        trajectory_format::check(&committed.header, self.spline.borrow(), &self.settings)?;
        if self.group.profile(&self.settings).law == Law::Feedback {
            self.require_gains(committed.header.robot_crc32)?;
        }
        self.group.check_group(now, &self.settings)?;
        for joint in self.joints() {
            self.group.check_drive(now, &self.settings, joint)?;
            let Some(position) = self.group.position(joint) else {
                return Err(Refusal::at(Cause::DriveNotReady, joint));
            };
            let away_rad = (position.q_rad - self.spline.borrow().start_rad(joint)).abs();
            // Written so that NaN fails.
            let near = away_rad <= self.settings.joint.at(joint).start_tolerance_rad;
            if !near {
                return Err(Refusal::at(Cause::NotAtStart, joint));
            }
        }
        Ok(())
    }

    /// The gains were proven for the loop of these settings, for its period and delay, and for the robot of the
    /// plan. `robot_crc32` 0: the plan names no robot.
    fn require_gains(&self, robot_crc32: u32) -> Result<(), Refusal> {
        let s = &self.settings;
        if s.gains_certificate_crc32 != registers::certificate_crc32(s) {
            return Err(Refusal::of(Cause::GainsUncertified));
        }
        if robot_crc32 != 0 && robot_crc32 != s.gains_robot_crc32 {
            return Err(Refusal::of(Cause::GainsOtherRobot));
        }
        if s.gains_period_us != s.cycle_period_us {
            return Err(Refusal::of(Cause::GainPeriod));
        }
        // A command acts when the next measurement is due.
        if !(s.gains_delay_min_us..=s.gains_delay_max_us).contains(&s.cycle_period_us) {
            return Err(Refusal::of(Cause::GainDelay));
        }
        Ok(())
    }
}
