//! Start-up: find each drive, see what it is, switch its watchdog on, and prove that the watchdog stops it.
//!
//! A drive is asked in steps; a step without an answer is tried again. A drive that is halted or in error is reset
//! once, after it has come to rest; if it stays so, the start ends with the drive's cause. A drive that moves although it
//! is not halted is moved by somebody else: the start ends with a halt broadcast.
//!
//! # Proof of the watchdogs
//!
//! The watchdogs of all drives are proven together:
//!
//! 1. Signs of life go out. They start the watchdogs.
//! 2. Each drive's state word is read after the first sign of life: no error, no halt, no motion.
//! 3. No sign of life and no request is sent for twice the watchdog time.
//! 4. Each drive must report COMM_ERROR, and ERROR or HALTED with it. Step 2 shows that these bits are new. ERROR or HALTED
//!    alone may come from a stop button; COMM_ERROR alone may be a transmission error, and the drive goes on.
//! 5. A reset ends the test. Each drive must report no error, no halt and no motion again.
//!
//! It does not matter whether a drive counts other frames as signs of life (step 3 sends none), whether it shows HALTED,
//! or whether a reset ends a running watchdog (`powercube-protocol` section 7).
//!
//! A proof is never kept: each pass through Boot proves again, at power on and at each clearing of a fault. A drive may have
//! been exchanged or switched off meanwhile, and nothing that it reports excludes this. A proof holds until the next
//! pass through Boot, because nothing else writes the configuration of the drives.

use core::borrow::BorrowMut;

use protocol::powercube::{Config, CubeState, Parameter, Reply, Request, Value};
use protocol::{Duration, Instant, JointIndex};

use super::standing::HALT_REST_MAX;
use super::{BootProgress, Controller};
use crate::fault::{Cause, Fault};
use crate::rest::Rest;
use crate::spline::Spline;
use crate::state::BootStage;
use crate::store::Storage;
use crate::supervisor;

/// Attempts of one step.
const TRIES: u8 = 5;
/// Drives take time after a reset; hosts of the field wait 0.2 to 0.5 s.
pub(super) const RESET_SETTLE: Duration = Duration::from_millis(200);

/// Steps of one drive.
const VERSION: u8 = 0;
const CONFIG: u8 = 1;
const SET_CONFIG: u8 = 2;
const CURRENT: u8 = 3;
const STATE: u8 = 4;
const POSITION: u8 = 5;
const DONE: u8 = 6;

impl<S: Storage, M: BorrowMut<Spline>> Controller<S, M> {
    /// Looks for the drives, from the beginning. With `reset` errors and halts are cleared first.
    pub(super) fn start_boot(&mut self, now: Instant, reset: bool) {
        self.schedule.clear_all();
        self.pace.forget();
        self.boot = Default::default();
        for joint in self.joints() {
            let drive = self.drives.at_mut(joint);
            (drive.state, drive.position, drive.missed_in_row, drive.over_current) = (None, None, 0, 0);
            (drive.rest, drive.motion_words) = (Rest::default(), 0);
        }
        if self.settings.watchdog_enable {
            // A watchdog that still runs from before must not expire during the search.
            self.send_watchdog(now);
        }
        if reset {
            self.send_reset(now);
            self.settle(now, 0);
        } else {
            self.machine.transition_to_boot(now, &mut self.trace, BootStage::FIRST_SCAN);
        }
    }

    fn settle(&mut self, now: Instant, waits_left: u8) {
        let stage = BootStage::Settle { until: now + RESET_SETTLE, waits_left };
        self.machine.transition_to_boot(now, &mut self.trace, stage);
    }

    pub(super) fn boot_tick(&mut self, now: Instant, stage: BootStage) {
        match stage {
            BootStage::Settle { until, waits_left } => {
                if until <= now {
                    self.boot = Default::default();
                    self.machine.transition_to_boot(now, &mut self.trace, BootStage::Scan { waits_left });
                }
            }
            BootStage::Scan { waits_left } => {
                if self.is_boot_done() {
                    self.end_scan(now, waits_left);
                } else {
                    self.ask_all(now);
                }
            }
            BootStage::Check => {
                if self.is_boot_done() {
                    self.end_check(now);
                } else {
                    self.ask_all(now);
                }
            }
            BootStage::Starve { until } => {
                if until <= now {
                    self.restart_at(STATE);
                    self.machine.transition_to_boot(now, &mut self.trace, BootStage::Judge);
                }
            }
            BootStage::Judge => {
                if self.joints().all(|joint| self.boot.at(joint).step > STATE) {
                    self.judge_watchdogs(now);
                } else {
                    self.ask_all(now);
                }
            }
            BootStage::Recover { until } => {
                if until > now {
                    return;
                }
                if self.is_boot_done() {
                    self.end_boot(now, until);
                } else {
                    self.ask_all(now);
                }
            }
        }
    }

    fn is_boot_done(&self) -> bool {
        self.joints().all(|joint| self.boot.at(joint).step == DONE)
    }

    fn restart_at(&mut self, step: u8) {
        for joint in self.joints() {
            self.boot.set(joint, BootProgress { step, tries: 0 });
        }
    }

    /// Each idle drive gets its next question.
    fn ask_all(&mut self, now: Instant) {
        for joint in self.joints() {
            if !self.schedule.is_done(joint, self.drives.at(joint)) {
                continue;
            }
            let progress = self.boot.at_mut(joint);
            if progress.tries >= TRIES {
                self.fail(now, Fault::at(Cause::DriveMissing, joint));
                return;
            }
            if let Some(request) = self.boot_request(joint) {
                self.boot.at_mut(joint).tries += 1;
                self.schedule.push(joint, request);
            }
        }
    }

    fn boot_request(&self, joint: JointIndex) -> Option<Request> {
        let limits = self.settings.joint.at(joint);
        Some(match self.boot.at(joint).step {
            VERSION => Request::Get(Parameter::DefVersion),
            CONFIG => Request::Get(Parameter::Config),
            SET_CONFIG => Request::Set(Parameter::Config, Value::U32(self.wanted_config(joint)?)),
            CURRENT => Request::Set(Parameter::MaxCur, Value::F32(limits.current_max_a)),
            STATE => Request::Get(Parameter::CubeState),
            POSITION if self.has_pos_state(joint) => Request::Get(Parameter::PosStateDio),
            POSITION => Request::Get(Parameter::ActPos),
            _ => return None,
        })
    }

    /// Configuration the drive must have, if it is not the one it has: watchdog as set, answers to writes, motions that
    /// start at once.
    fn wanted_config(&self, joint: JointIndex) -> Option<u32> {
        let config = self.drives.at(joint).config?;
        let wanted = config
            .with(Config::WATCHDOG_ENABLE, self.settings.watchdog_enable)
            .with(Config::DISABLE_ACK, false)
            .with(Config::SYNC_MOTION, false);
        (wanted != config).then_some(wanted.bits())
    }

    pub(super) fn boot_on_missed(&mut self, stage: BootStage, joint: JointIndex) {
        // A drive that answers no writes takes this one without an answer; the configuration is read again.
        if matches!(stage, BootStage::Scan { .. }) && self.boot.at(joint).step == SET_CONFIG {
            let BootProgress { tries, .. } = *self.boot.at(joint);
            self.boot.set(joint, BootProgress { step: CONFIG, tries });
        }
    }

    pub(super) fn boot_on_answer(
        &mut self,
        stage: BootStage,
        joint: JointIndex,
        request: Request,
        reply: &Reply,
    ) {
        let asked = self.boot_request(joint).map(|wanted| wanted.command() == request.command());
        if asked != Some(true) {
            return;
        }
        let step = self.boot.at(joint).step;
        let next = match (step, request, *reply) {
            (VERSION, Request::Get(Parameter::DefVersion), Reply::Value(..)) => CONFIG,
            (CONFIG, Request::Get(Parameter::Config), Reply::Value(_, Value::U32(bits))) => {
                self.drives.at_mut(joint).config = Some(Config::from_bits(bits));
                if self.wanted_config(joint).is_some() { SET_CONFIG } else { CURRENT }
            }
            // Read back: a drive may acknowledge and not do it. Tries count on, so this ends.
            (SET_CONFIG, Request::Set(Parameter::Config, _), Reply::SetAck { .. }) => {
                let BootProgress { tries, .. } = *self.boot.at(joint);
                self.boot.set(joint, BootProgress { step: CONFIG, tries });
                return;
            }
            (CURRENT, Request::Set(Parameter::MaxCur, _), Reply::SetAck { .. }) => STATE,
            (STATE, Request::Get(Parameter::CubeState), Reply::Value(..)) => POSITION,
            (POSITION, Request::Get(Parameter::PosStateDio | Parameter::ActPos), Reply::Value(..)) => DONE,
            _ => return,
        };
        self.boot.set(joint, BootProgress { step: next, tries: 0 });
        // The next question goes out at once; while the watchdogs are judged there is none.
        if stage != BootStage::Judge
            && next != DONE
            && let Some(request) = self.boot_request(joint)
        {
            self.boot.at_mut(joint).tries += 1;
            self.schedule.push(joint, request);
        }
    }

    fn end_scan(&mut self, now: Instant, waits_left: u8) {
        let old = self.joints().find(|&joint| !self.has_pos_state(joint));
        if let Some(joint) = old {
            self.fail(now, Fault::at(Cause::FirmwareTooOld, joint));
            return;
        }
        if let Some(fault) = self.unfit_drive() {
            let is = |bits| self.joints().any(|joint| self.state_word(joint).intersects(bits));
            if waits_left == 0 || fault.cause == Cause::MovesUnordered {
                self.fail(now, fault);
            } else if is(CubeState::MOTION) {
                self.settle(now, waits_left - 1);
            } else {
                self.send_reset(now);
                if self.settings.watchdog_enable {
                    // As in `start_boot`.
                    self.send_watchdog(now);
                }
                self.settle(now, 0);
            }
            return;
        }
        if self.settings.watchdog_enable {
            self.send_watchdog(now);
        }
        if self.settings.watchdog_enable && self.settings.watchdog_prove {
            self.restart_at(STATE);
            self.machine.transition_to_boot(now, &mut self.trace, BootStage::Check);
        } else {
            self.recover(now, now);
        }
    }

    fn end_check(&mut self, now: Instant) {
        if let Some(fault) = self.unfit_drive() {
            self.fail(now, fault);
            return;
        }
        self.watchdog_due = None;
        let wait = Duration::from_micros(2 * u64::from(self.settings.watchdog_timeout_us));
        self.machine.transition_to_boot(now, &mut self.trace, BootStage::Starve { until: now + wait });
    }

    /// The state word as last read; empty if none was read.
    fn state_word(&self, joint: JointIndex) -> CubeState {
        self.drives.at(joint).state.map_or(CubeState::EMPTY, |(state, _)| state)
    }

    /// The first drive that moves by itself; else the first one that is halted or in error.
    fn unfit_drive(&self) -> Option<Fault> {
        let stopped = CubeState::ERROR.union(CubeState::HALTED);
        let moves = |word: CubeState| word.intersects(CubeState::MOTION) && !word.intersects(stopped);
        if let Some(joint) = self.joints().find(|&joint| moves(self.state_word(joint))) {
            return Some(Fault::at(Cause::MovesUnordered, joint));
        }
        self.joints().find_map(|joint| {
            let cause = supervisor::check_state_word(self.state_word(joint), false)?;
            Some(Fault::at(cause, joint))
        })
    }

    fn judge_watchdogs(&mut self, now: Instant) {
        let stopped = CubeState::ERROR.union(CubeState::HALTED);
        let proven = |word: CubeState| word.contains(CubeState::COMM_ERROR) && word.intersects(stopped);
        let unproven = self.joints().find(|&joint| !proven(self.state_word(joint)));
        if let Some(joint) = unproven {
            self.fail(now, Fault::at(Cause::WatchdogUnproven, joint));
            return;
        }
        self.send_reset(now);
        self.send_watchdog(now);
        self.recover(now, now + RESET_SETTLE);
    }

    fn recover(&mut self, now: Instant, until: Instant) {
        self.restart_at(STATE);
        self.machine.transition_to_boot(now, &mut self.trace, BootStage::Recover { until });
    }

    /// All drives have been read since `read_from`: they are fit, and are read on until they stand.
    fn end_boot(&mut self, now: Instant, read_from: Instant) {
        if let Some(fault) = self.unfit_drive() {
            self.fail(now, fault);
        } else if self.all_at_rest(now) {
            self.stand(now);
        } else if now >= read_from + HALT_REST_MAX {
            self.fail(now, Fault { cause: Cause::RestNotReached, joint: self.not_at_rest(now) });
        } else {
            self.restart_at(STATE);
            self.ask_all(now);
        }
    }
}
