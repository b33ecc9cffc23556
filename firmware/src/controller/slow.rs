//! Homing and jogging: the controller's half. The group does the homing and jogging of a single joint.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Refusal};
use crate::group::{Command, DriveGroup};
use crate::joints::clamp;
use crate::orders::JOG_HOLD_MAX;
use crate::spline::Spline;
use crate::state::{Homing, Jog, State};
use crate::store::Storage;

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// Homes joints one after the other, from the hand to the base: the arm is light when the big joints turn.
    pub(super) fn order_home(&mut self, now: Instant, mask: u8) -> Result<(), Refusal> {
        if let State::Homing(homing) = self.machine.state() {
            // The same joints again: the answer was lost.
            let left = homing.mask & !mask == 0 && mask != 0;
            return if left { Ok(()) } else { Err(Refusal::of(Cause::OrderNotNow)) };
        }
        let known = (1u32 << self.settings.joints) - 1;
        if mask == 0 || u32::from(mask) & !known != 0 {
            return Err(Refusal::of(Cause::JointUnknown));
        }
        self.require_host(now)?;
        self.reset_if_stopped(now);
        self.keep_places();
        self.offer = None;
        self.home_next(now, mask);
        Ok(())
    }

    /// A motion that begins in Stopped clears the halt first.
    fn reset_if_stopped(&mut self, now: Instant) {
        if matches!(self.machine.state(), State::Stopped { .. }) {
            self.group.command(now, &self.settings, Command::Reset);
        }
    }

    /// Goes on with the highest joint of the mask, or ends.
    fn home_next(&mut self, now: Instant, mask: u8) {
        let next = self.joints().rev().find(|joint| mask & joint.bit() != 0);
        let Some(joint) = next else {
            self.stand(now);
            return;
        };
        let deadline = now + Duration::from_micros(self.settings.home_timeout_us.into());
        self.enter(now, State::Homing(Homing { mask, joint, deadline }));
        self.group.command(now, &self.settings, Command::Home(joint));
    }

    /// A joint has found its zero.
    pub(super) fn go_on_homing(&mut self, now: Instant, joint: JointIndex) {
        let State::Homing(homing) = *self.machine.state() else { return };
        if homing.joint == joint {
            // Its position counts from its zero now.
            self.keep_places();
            self.home_next(now, homing.mask & !joint.bit());
        }
    }

    /// Moves one joint at reduced speed while the order is repeated.
    pub(super) fn order_jog(
        &mut self,
        now: Instant,
        joint: JointIndex,
        qd_rad_s: f32,
        hold: Duration,
    ) -> Result<(), Refusal> {
        if joint.get() >= self.settings.joints as usize {
            return Err(Refusal::of(Cause::JointUnknown));
        }
        if !qd_rad_s.is_finite() || hold > JOG_HOLD_MAX || hold.is_zero() {
            return Err(Refusal::at(Cause::BadValue, joint));
        }
        self.require_host(now)?;
        let v_max_rad_s = self.settings.joint.at(joint).jog_v_rad_s;
        let qd_rad_s = clamp(qd_rad_s, -v_max_rad_s, v_max_rad_s);
        if let State::Jogging(jog) = *self.machine.state() {
            if jog.joint != joint || jog.released {
                return Err(Refusal::at(Cause::OrderNotNow, joint));
            }
        } else {
            if self.group.position(joint).is_none() {
                return Err(Refusal::at(Cause::DriveNotReady, joint));
            }
            self.reset_if_stopped(now);
            self.offer = None;
            self.enter(now, State::Jogging(Jog { joint, released: false }));
        }
        self.group.command(now, &self.settings, Command::Jog { joint, qd_rad_s, until: now + hold });
        Ok(())
    }
}
