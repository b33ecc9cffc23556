//! Rest: which joints stand, as measured; and the supervision of a group that stands.
//!
//! # When a joint stands
//!
//! Its position has stayed within the steps of its encoder for [`crate::rest::WINDOW`], and the drive has reported
//! no motion since ([`DriveGroup::is_at_rest`]). The group enters Ready and Stopped, and ends a jog, a homing, a
//! run and Boot, only when all joints stand in this sense. No timer replaces the measurement: if the joints do not
//! come to rest in time, the fault is RestNotReached.
//!
//! # Supervision of a group that stands
//!
//! A joint that leaves its place by more than [`PLACE_RAD`], or whose drive reports motion several times in a row, moves.
//!
//! | state | a joint that moves |
//! |---|---|
//! | Ready, Armed, Stopped | fault MovesUnordered, halt |
//! | Idle | the same, unless the position loop of the drive is open: people may move the joint by hand |
//! | Homing, Jogging | as in Ready, for the joints that are not at work |
//! | Fault | the halt is repeated every [`HALT_REPEAT`] until the joint stands; the first cause stays |
//!
//! In Fault people may move joints by hand: the repeated halt does not hinder them. In Stopped they may not,
//! although the drives are halted: a slipping brake would look the same.

use core::borrow::BorrowMut;

use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Fault};
use crate::group::{Command, DriveGroup, Standing};
use crate::spline::Spline;
use crate::state::{State, StateKind};
use crate::store::Storage;

/// Distance from its place at which a standing joint counts as moving, rad: eight steps of the encoder. A joint
/// moves by about one step when its brake opens or the ball leaves the hand.
const PLACE_RAD: f32 = 3e-3;
/// Time between halts while a joint moves that must stand.
pub(super) const HALT_REPEAT: Duration = Duration::from_millis(100);

impl<S: Storage, M: BorrowMut<Spline>, G: DriveGroup> Controller<S, M, G> {
    /// True if all joints are measured at rest.
    pub(super) fn all_at_rest(&self, now: Instant) -> bool {
        self.not_at_rest(now).is_none()
    }

    /// The first joint that is not measured at rest.
    pub(super) fn not_at_rest(&self, now: Instant) -> Option<JointIndex> {
        self.joints().find(|&joint| !self.group.is_at_rest(now, &self.settings, joint))
    }

    /// True if a joint is known to move. A drive that reports nothing may move or stand.
    pub(super) fn any_moves(&self, now: Instant) -> bool {
        self.joints().any(|joint| self.group.is_moving(now, &self.settings, joint))
    }

    /// A motion has ended and all joints stand: Ready if all are homed, else Idle.
    pub(super) fn stand(&mut self, now: Instant) {
        self.keep_places();
        let state = if self.all_homed() { State::Ready } else { State::Idle };
        self.enter_standing(now, state);
    }

    /// The joints stand where they are now.
    pub(super) fn keep_places(&mut self) {
        for joint in self.joints() {
            let q_rad = self.group.position(joint).map_or(0.0, |position| position.q_rad);
            self.stood_at_rad.set(joint, q_rad);
        }
    }

    /// Faults and state changes while nothing moves.
    pub(super) fn judge_standing(&mut self, now: Instant) {
        let kind = self.kind();
        if matches!(kind, StateKind::Idle | StateKind::Ready | StateKind::Armed | StateKind::Stopped) {
            for joint in self.joints() {
                let silent = self.group.readings(joint).missed_in_row > self.settings.reply_missed_max;
                let standing = self.group.standing(joint);
                // After a stop the drives may be halted.
                let halted = standing.halted && kind != StateKind::Stopped;
                let cause = standing.cause.or(halted.then_some(Cause::DriveError));
                if let Some(cause) = if silent { Some(Cause::DriveSilent) } else { cause } {
                    self.fail(now, Fault::at(cause, joint));
                    return;
                }
            }
            self.judge_places(now, None);
        } else if kind == StateKind::Fault {
            self.repeat_halt(now);
        }
        match (self.kind(), self.all_homed()) {
            (StateKind::Idle, true) if self.all_at_rest(now) => self.stand(now),
            (StateKind::Ready, false) => self.enter_standing(now, State::Idle),
            (StateKind::Armed, false) => {
                let lost = self.joints().find(|&joint| !self.group.is_homed(joint));
                self.fail(now, Fault { cause: Cause::DriveLostHome, joint: lost });
            }
            _ => {}
        }
    }

    /// A joint that moves although the group stands, or although another one is at work.
    pub(super) fn judge_places(&mut self, now: Instant, at_work: Option<JointIndex>) {
        for joint in self.joints().filter(|&joint| Some(joint) != at_work) {
            let Some(position) = self.group.position(joint) else { continue };
            let Standing { reports_motion, yields, .. } = self.group.standing(joint);
            // Written so that NaN counts as motion.
            let in_place = (position.q_rad - self.stood_at_rad.get(joint)).abs() <= PLACE_RAD;
            if in_place && !reports_motion {
                continue;
            }
            if self.kind() == StateKind::Idle && yields {
                self.stood_at_rad.set(joint, position.q_rad);
                continue;
            }
            self.fail(now, Fault::at(Cause::MovesUnordered, joint));
            return;
        }
    }

    /// Repeats the halt broadcast after a fault while anything moves.
    pub(super) fn repeat_halt(&mut self, now: Instant) {
        if self.halt_due <= now && self.any_moves(now) {
            self.halt(now);
            if self.kind() == StateKind::Fault {
                self.group.command(now, &self.settings, Command::Stand { armed: false });
            }
        }
    }
}
