//! Arming in two steps, and starting a run.

use core::borrow::BorrowMut;

use protocol::powercube::{CubeState, ShortState};
use protocol::{Duration, Instant};

use super::boot::RESET_SETTLE;
use super::{Controller, Offer};
use crate::fault::{Cause, Refusal};
use crate::orders::{ARMING_VALID_MAX, Done};
use crate::spline::Spline;
use crate::state::State;
use crate::store::{FileName, Storage};
use crate::trajectory_format;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
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
        self.require_trajectory(crc64)?;
        if matches!(self.machine.state(), State::Stopped { .. }) {
            // Drives are halted; nothing moves by a reset. Their state words are read anew before the second step.
            self.send_reset(now);
        }
        let token = self.tokens.next_token();
        self.offer = Some(Offer { token, until: now + valid });
        Ok(Done::Offer { token, valid })
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
        self.machine.transition_to_armed(now, &mut self.trace, token, now + valid);
        Ok(Done::Taken)
    }

    pub(super) fn order_run(&mut self, now: Instant, name: FileName) -> Result<Done, Refusal> {
        let committed = self.store.committed().copied().ok_or(Refusal::of(Cause::NoTrajectory))?;
        if committed.name != name {
            return Err(Refusal::of(Cause::OtherTrajectory));
        }
        if matches!(self.machine.state(), State::Running { .. }) {
            return Ok(Done::Taken);
        }
        self.require_runnable(now)?;
        self.start_run(now, committed.header.release_us);
        Ok(Done::Taken)
    }

    fn require_trajectory(&self, crc64: u64) -> Result<(), Refusal> {
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        if committed.name.crc64 != crc64 {
            return Err(Refusal::of(Cause::OtherTrajectory));
        }
        Ok(())
    }

    /// A control cycle fits into its period: known before a motion, not found out in it.
    fn require_time(&self) -> Result<(), Refusal> {
        // Without a rehearsal the drives have not been read since they were found; it comes with the next few looks.
        let (_, cycle_us) = self.cycle_times();
        let cycle_us = cycle_us.ok_or(Refusal::of(Cause::DriveNotReady))?;
        if cycle_us <= self.settings.cycle_period_us {
            return Ok(());
        }
        let period_us = cycle_us.div_ceil(100).saturating_mul(100);
        let index = u16::try_from(period_us).unwrap_or(u16::MAX);
        Err(Refusal { cause: Cause::CycleTooShort, joint: None, index })
    }

    /// All that must hold before the arm may move by itself.
    fn require_runnable(&self, now: Instant) -> Result<(), Refusal> {
        self.require_host(now)?;
        let committed = self.store.committed().ok_or(Refusal::of(Cause::NoTrajectory))?;
        // Settings may have changed since the commit.
        trajectory_format::check(&committed.header, self.spline.borrow(), &self.settings)?;
        if self.settings.gains_certificate_crc32 == 0 {
            return Err(Refusal::of(Cause::GainsUncertified));
        }
        // 0: a motion that names no robot.
        let robot_crc32 = committed.header.robot_crc32;
        if robot_crc32 != 0 && robot_crc32 != self.settings.gains_robot_crc32 {
            return Err(Refusal::of(Cause::GainsOtherRobot));
        }
        if self.settings.gains_period_us != self.settings.cycle_period_us {
            return Err(Refusal::of(Cause::GainPeriod));
        }
        self.require_time()?;
        if let Some(joint) = self.not_at_rest(now) {
            return Err(Refusal::at(Cause::DriveNotReady, joint));
        }
        // A drive that was reset opens its brake first; a motion ordered before begins later than ordered.
        if now < self.reset_at + RESET_SETTLE {
            return Err(Refusal::of(Cause::DriveNotReady));
        }
        for joint in self.joints() {
            let (drive, limits) = (self.drives.at(joint), self.settings.joint.at(joint));
            let Some((state, at)) = drive.state else { return Err(Refusal::at(Cause::DriveNotReady, joint)) };
            let bad = CubeState::ERROR.union(CubeState::HALTED).union(CubeState::MOTION);
            // Four things are read in turn, so nothing is older than four periods and a few.
            let age_max = Duration::from_micros(8 * u64::from(self.settings.monitor_period_us));
            let stale = at < self.reset_at || now.saturating_since(at) > age_max;
            if stale || state.intersects(bad) || drive.missed_in_row > 0 {
                return Err(Refusal::at(Cause::DriveNotReady, joint));
            }
            if !state.contains(CubeState::HOME_OK) {
                return Err(Refusal::at(Cause::NotHomed, joint));
            }
            let Some(position) = drive.position else { return Err(Refusal::at(Cause::DriveNotReady, joint)) };
            let old = position.at < self.reset_at || now.saturating_since(position.at) > age_max;
            if old || drive.short_state.intersects(ShortState::NOT_OK) {
                return Err(Refusal::at(Cause::DriveNotReady, joint));
            }
            let away_rad = (position.q_rad - self.spline.borrow().start_rad(joint)).abs();
            // Written so that a number that is none fails.
            let near = away_rad <= limits.start_tolerance_rad;
            if !near {
                return Err(Refusal::at(Cause::NotAtStart, joint));
            }
        }
        Ok(())
    }
}
