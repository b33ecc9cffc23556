//! Rest: which joints stand, as measured; and the watch over a group that stands.
//!
//! # When a joint stands
//!
//! Its position has stayed within the steps of its encoder for [`rest::WINDOW`], and a state word read in that time shows
//! no MOTION. Ready and Stopped are entered, and a jog, a homing, a run and Boot end, when all joints stand in this sense.
//! There is no timer that makes a group stand. A time that passes without it ends in the fault RestNotReached.
//!
//! # The watch over a group that stands
//!
//! A joint that leaves its place by more than [`PLACE_RAD`], or shows MOTION in [`MOTION_WORDS`] state words in a row, moves.
//!
//! | state | a joint that moves |
//! |---|---|
//! | Ready, Armed, Stopped | fault MovesUnordered, halt broadcast |
//! | Idle | the same, unless the drive shows BRAKEACTIVE: its position loop is open, and people may move the joint by hand |
//! | Homing, Jogging | as in Ready, for the joints that are not at work |
//! | Fault | the halt broadcast is repeated every [`HALT_REPEAT`] until the joint stands; the first cause stays |
//!
//! In Fault people may move joints by hand: the repeated halt does not hinder them. In Stopped they may not, although the
//! drives are halted: a brake that slips looks the same.

use core::borrow::BorrowMut;

use protocol::powercube::CubeState;
use protocol::{Duration, Instant, JointIndex};

use super::Controller;
use crate::fault::{Cause, Fault};
use crate::rest;
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::Storage;
use crate::supervisor;

/// Distance from its place at which a standing joint counts as moving, rad: eight steps of the encoder. A joint gives
/// way by about one step when its brake opens or the ball leaves the hand.
const PLACE_RAD: f32 = 3e-3;
/// State words with MOTION in a row at which a standing joint counts as moving.
const MOTION_WORDS: u8 = 2;
/// Time between halt broadcasts while something moves that must not.
pub(super) const HALT_REPEAT: Duration = Duration::from_millis(100);
/// Longest time from a halt broadcast to measured rest: the slowest drive brakes from its highest speed in less than half
/// of it.
pub(super) const HALT_REST_MAX: Duration = Duration::from_millis(1_500);
/// Added to the computed time of a ramp before its end must be measured: the window and what a drive's loop settles.
pub(super) const REST_SLACK: Duration = Duration::from_millis(250);

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Age at which a position says nothing about now: standing drives are asked every second look.
    fn rest_age_max(&self) -> Duration {
        rest::WINDOW + Duration::from_micros(2 * u64::from(self.settings.monitor_period_us))
    }

    /// The same for a state word: every fourth look.
    fn word_age_max(&self) -> Duration {
        rest::WINDOW + Duration::from_micros(4 * u64::from(self.settings.monitor_period_us))
    }

    /// True if a joint is measured at rest.
    pub(super) fn is_at_rest(&self, now: Instant, joint: JointIndex) -> bool {
        let drive = self.drives.at(joint);
        let Some(since) = drive.rest.since(now, self.rest_age_max()) else { return false };
        drive.state.is_some_and(|(word, at)| at >= since && !word.intersects(CubeState::MOTION))
    }

    /// True if all joints are measured at rest.
    pub(super) fn all_at_rest(&self, now: Instant) -> bool {
        self.joints().all(|joint| self.is_at_rest(now, joint))
    }

    /// The first joint that is not measured at rest.
    pub(super) fn not_at_rest(&self, now: Instant) -> Option<JointIndex> {
        self.joints().find(|&joint| !self.is_at_rest(now, joint))
    }

    /// True if a joint is known to move. A drive that says nothing may move or not.
    pub(super) fn any_moves(&self, now: Instant) -> bool {
        self.joints().any(|joint| {
            let drive = self.drives.at(joint);
            let read = drive.state.is_some_and(|(_, at)| now.saturating_since(at) <= self.word_age_max());
            (read && drive.motion_words > 0) || drive.rest.is_moving(now, self.rest_age_max())
        })
    }

    /// A motion has ended and all joints stand: Ready if all are homed, else Idle.
    pub(super) fn stand(&mut self, now: Instant) {
        self.keep_places();
        if self.all_homed() {
            self.machine.transition_to_ready(now, &mut self.trace);
        } else {
            self.machine.transition_to_idle(now, &mut self.trace);
        }
    }

    /// The joints stand where they are now.
    pub(super) fn keep_places(&mut self) {
        for joint in self.joints() {
            let q_rad = self.drives.at(joint).position.map_or(0.0, |position| position.q_rad);
            self.stood_at_rad.set(joint, q_rad);
        }
    }

    /// Faults and state changes while nothing moves.
    pub(super) fn judge_standing(&mut self, now: Instant) {
        let kind = self.kind();
        let halted_is_fine = kind == StateKind::Stopped;
        if matches!(kind, StateKind::Idle | StateKind::Ready | StateKind::Armed | StateKind::Stopped) {
            for joint in self.joints() {
                let drive = self.drives.at(joint);
                let silent = drive.missed_in_row > self.settings.reply_missed_max;
                let word = drive.state.filter(|(_, at)| *at >= self.reset_at);
                let cause = word.and_then(|(state, _)| supervisor::check_state_word(state, halted_is_fine));
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
            (StateKind::Ready, false) => self.machine.transition_to_idle(now, &mut self.trace),
            (StateKind::Armed, false) => {
                let lost = self.joints().find(|&joint| !self.drive_is_homed(joint));
                self.fail(now, Fault { cause: Cause::DriveLostHome, joint: lost });
            }
            _ => {}
        }
    }

    /// A joint that moves although the group stands, or although another one is at work.
    pub(super) fn judge_places(&mut self, now: Instant, at_work: Option<JointIndex>) {
        for joint in self.joints().filter(|&joint| Some(joint) != at_work) {
            let drive = self.drives.at(joint);
            let Some(position) = drive.position else { continue };
            // Written so that a position that is no number counts as motion.
            let in_place = (position.q_rad - self.stood_at_rad.get(joint)).abs() <= PLACE_RAD;
            if in_place && drive.motion_words < MOTION_WORDS {
                continue;
            }
            let open = drive.state.is_some_and(|(word, _)| word.intersects(CubeState::BRAKEACTIVE));
            if self.kind() == StateKind::Idle && open {
                self.stood_at_rad.set(joint, position.q_rad);
                continue;
            }
            self.fail(now, Fault::at(Cause::MovesUnordered, joint));
            return;
        }
    }

    /// After a fault the halt broadcast is repeated while anything moves.
    pub(super) fn repeat_halt(&mut self, now: Instant) {
        if self.halt_due <= now && self.any_moves(now) {
            self.halt(now);
        }
    }
}
