//! Start-up: find each drive, see what it is, switch its watchdog on, and prove that the watchdog stops it.
//!
//! A drive is asked in steps; a step without an answer is tried again. A drive that is halted or in error is reset
//! once, after it has come to rest; if it stays so, the start ends with the drive's cause. A drive that moves although it
//! is not halted is moved from outside: the start ends with a halt broadcast.
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

use protocol::powercube::{Config, CubeState, Parameter, Reply, Request, Value};
use protocol::{Duration, Instant, JointIndex};

use super::readiness::RESET_SETTLE;
use super::settings::WATCHDOG_ENABLE;
use super::words::check_state_word;
use super::{Mode, PowerCubes};
use crate::fault::{Cause, Fault};
use crate::group::GroupEvent;
use crate::joints::PerJoint;
use crate::rest::{HALT_REST_MAX, Rest};
use crate::settings::Settings;

/// Attempts of one step.
const TRIES: u8 = 5;

/// Steps of one drive.
const VERSION: u8 = 0;
const CONFIG: u8 = 1;
const SET_CONFIG: u8 = 2;
const CURRENT: u8 = 3;
const STATE: u8 = 4;
const POSITION: u8 = 5;
const DONE: u8 = 6;

/// Stage of the search for the drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Waits after a reset broadcast, or until halted drives have come to rest.
    Settle {
        /// End of the wait.
        until: Instant,
        /// As in [`Self::Scan`].
        waits_left: u8,
    },
    /// Each drive is asked and set up, step by step.
    Scan {
        /// How often the scan may be repeated because a drive is halted or in error; 0 after a reset.
        waits_left: u8,
    },
    /// Signs of life go out; each drive must report no error, no halt and no motion.
    Check,
    /// No sign of life is sent, so the watchdogs must expire.
    Starve {
        /// End of the silence.
        until: Instant,
    },
    /// Each drive's state word is read: its watchdog must have stopped it.
    Judge,
    /// The reset was broadcast; each drive is read until it stands.
    Recover {
        /// End of the wait.
        until: Instant,
    },
}

impl Stage {
    /// A scan that may wait for halted drives to come to rest.
    pub(super) const FIRST_SCAN: Self = Self::Scan { waits_left: 5 };
}

/// Start-up of one drive.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BootProgress {
    step: u8,
    tries: u8,
}

impl PowerCubes {
    /// Looks for the drives, from the beginning. With `reset` errors and halts are cleared first.
    pub(super) fn find(&mut self, now: Instant, settings: &Settings, reset: bool) {
        self.schedule.clear_all();
        self.timing.forget();
        self.progress = PerJoint::default();
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            (drive.state, drive.position, drive.missed_in_row, drive.over_current) = (None, None, 0, 0);
            (drive.rest, drive.motion_words) = (Rest::default(), 0);
            (drive.max_cur_a, drive.config) = (None, None);
        }
        if WATCHDOG_ENABLE.get(settings) {
            // A watchdog that still runs from before must not expire during the search.
            self.send_watchdog(now, settings);
        }
        let stage = if reset {
            self.send_reset(now, settings);
            Stage::Settle { until: now + RESET_SETTLE, waits_left: 0 }
        } else {
            Stage::FIRST_SCAN
        };
        self.mode = Mode::Finding(stage);
    }

    fn settle(&mut self, now: Instant, waits_left: u8) {
        self.enter(Stage::Settle { until: now + RESET_SETTLE, waits_left });
    }

    fn enter(&mut self, stage: Stage) {
        self.mode = Mode::Finding(stage);
        self.push(GroupEvent::Progress);
    }

    pub(super) fn finding_period(&mut self, now: Instant, settings: &Settings, stage: Stage) {
        match stage {
            Stage::Settle { until, waits_left } => {
                if until <= now {
                    self.progress = PerJoint::default();
                    self.enter(Stage::Scan { waits_left });
                }
            }
            Stage::Scan { waits_left } => {
                if self.is_scan_done(settings) {
                    self.end_scan(now, settings, waits_left);
                } else {
                    self.ask_all(settings);
                }
            }
            Stage::Check => {
                if self.is_scan_done(settings) {
                    self.end_check(now, settings);
                } else {
                    self.ask_all(settings);
                }
            }
            Stage::Starve { until } => {
                if until <= now {
                    self.restart_at(settings, STATE);
                    self.enter(Stage::Judge);
                }
            }
            Stage::Judge => {
                if settings.joints().all(|joint| self.progress.at(joint).step > STATE) {
                    self.judge_watchdogs(now, settings);
                } else {
                    self.ask_all(settings);
                }
            }
            Stage::Recover { until } => {
                if until > now {
                    return;
                }
                if self.is_scan_done(settings) {
                    self.end_recovery(now, settings, until);
                } else {
                    self.ask_all(settings);
                }
            }
        }
    }

    fn is_scan_done(&self, settings: &Settings) -> bool {
        settings.joints().all(|joint| self.progress.at(joint).step == DONE)
    }

    fn restart_at(&mut self, settings: &Settings, step: u8) {
        for joint in settings.joints() {
            self.progress.set(joint, BootProgress { step, tries: 0 });
        }
    }

    /// Each idle drive gets its next question.
    fn ask_all(&mut self, settings: &Settings) {
        for joint in settings.joints() {
            if !self.schedule.is_done(joint, self.drives.at(joint)) {
                continue;
            }
            let progress = self.progress.at_mut(joint);
            if progress.tries >= TRIES {
                self.fail(Fault::at(Cause::DriveMissing, joint));
                return;
            }
            if let Some(request) = self.next_request(settings, joint) {
                self.progress.at_mut(joint).tries += 1;
                self.schedule.push(joint, request);
            }
        }
    }

    fn next_request(&self, settings: &Settings, joint: JointIndex) -> Option<Request> {
        Some(match self.progress.at(joint).step {
            VERSION => Request::Get(Parameter::DefVersion),
            CONFIG => Request::Get(Parameter::Config),
            SET_CONFIG => Request::Set(Parameter::Config, Value::U32(self.wanted_config(settings, joint)?)),
            CURRENT => Self::current_write(settings, joint),
            STATE => Request::Get(Parameter::CubeState),
            POSITION if self.has_pos_state(joint) => Request::Get(Parameter::PosStateDio),
            POSITION => Request::Get(Parameter::ActPos),
            _ => return None,
        })
    }

    /// Configuration the drive must have, if it is not the one it has: watchdog as set, answers to writes, motions that
    /// start at once.
    fn wanted_config(&self, settings: &Settings, joint: JointIndex) -> Option<u32> {
        let config = self.drives.at(joint).config?;
        let wanted = config
            .with(Config::WATCHDOG_ENABLE, WATCHDOG_ENABLE.get(settings))
            .with(Config::DISABLE_ACK, false)
            .with(Config::SYNC_MOTION, false);
        (wanted != config).then_some(wanted.bits())
    }

    pub(super) fn finding_on_missed(&mut self, stage: Stage, joint: JointIndex) {
        // A drive that answers no writes takes this one without an answer; the configuration is read again.
        if matches!(stage, Stage::Scan { .. }) && self.progress.at(joint).step == SET_CONFIG {
            let BootProgress { tries, .. } = *self.progress.at(joint);
            self.progress.set(joint, BootProgress { step: CONFIG, tries });
        }
    }

    pub(super) fn finding_on_answer(
        &mut self,
        settings: &Settings,
        stage: Stage,
        joint: JointIndex,
        request: Request,
        reply: &Reply,
    ) {
        let asked = self.next_request(settings, joint).map(|wanted| wanted.command() == request.command());
        if asked != Some(true) {
            return;
        }
        let step = self.progress.at(joint).step;
        let next = match (step, request, *reply) {
            (VERSION, Request::Get(Parameter::DefVersion), Reply::Value(..)) => CONFIG,
            (CONFIG, Request::Get(Parameter::Config), Reply::Value(_, Value::U32(bits))) => {
                self.drives.at_mut(joint).config = Some(Config::from_bits(bits));
                if self.wanted_config(settings, joint).is_some() { SET_CONFIG } else { CURRENT }
            }
            // Read back: a drive may acknowledge and not do it. Tries count on, so this ends.
            (SET_CONFIG, Request::Set(Parameter::Config, _), Reply::SetAck { .. }) => {
                let BootProgress { tries, .. } = *self.progress.at(joint);
                self.progress.set(joint, BootProgress { step: CONFIG, tries });
                return;
            }
            (CURRENT, Request::Set(Parameter::MaxCur, _), Reply::SetAck { .. }) => STATE,
            (STATE, Request::Get(Parameter::CubeState), Reply::Value(..)) => POSITION,
            (POSITION, Request::Get(Parameter::PosStateDio | Parameter::ActPos), Reply::Value(..)) => DONE,
            _ => return,
        };
        self.progress.set(joint, BootProgress { step: next, tries: 0 });
        // The next question goes out at once; while the watchdogs are judged there is none.
        if stage != Stage::Judge
            && next != DONE
            && let Some(request) = self.next_request(settings, joint)
        {
            self.progress.at_mut(joint).tries += 1;
            self.schedule.push(joint, request);
        }
    }

    fn end_scan(&mut self, now: Instant, settings: &Settings, waits_left: u8) {
        let old = settings.joints().find(|&joint| !self.has_pos_state(joint));
        if let Some(joint) = old {
            self.fail(Fault::at(Cause::FirmwareTooOld, joint));
            return;
        }
        if let Some(fault) = self.unfit_drive(settings) {
            let is = |bits| settings.joints().any(|joint| self.state_word(joint).intersects(bits));
            if waits_left == 0 || fault.cause == Cause::MovesUnordered {
                self.fail(fault);
            } else if is(CubeState::MOTION) {
                self.settle(now, waits_left - 1);
            } else {
                self.send_reset(now, settings);
                if WATCHDOG_ENABLE.get(settings) {
                    // As in `find`.
                    self.send_watchdog(now, settings);
                }
                self.settle(now, 0);
            }
            return;
        }
        if WATCHDOG_ENABLE.get(settings) {
            self.send_watchdog(now, settings);
        }
        if WATCHDOG_ENABLE.get(settings) && settings.watchdog_prove {
            self.restart_at(settings, STATE);
            self.enter(Stage::Check);
        } else {
            self.recover(settings, now);
        }
    }

    fn end_check(&mut self, now: Instant, settings: &Settings) {
        if let Some(fault) = self.unfit_drive(settings) {
            self.fail(fault);
            return;
        }
        self.watchdog_due = None;
        let wait = Duration::from_micros(2 * u64::from(settings.watchdog_timeout_us));
        self.enter(Stage::Starve { until: now + wait });
    }

    /// The state word as last read; empty if none was read.
    fn state_word(&self, joint: JointIndex) -> CubeState {
        self.drives.at(joint).state.map_or(CubeState::EMPTY, |(state, _)| state)
    }

    /// The first drive that moves by itself; else the first one that is halted or in error.
    fn unfit_drive(&self, settings: &Settings) -> Option<Fault> {
        let stopped = CubeState::ERROR.union(CubeState::HALTED);
        let moves = |word: CubeState| word.intersects(CubeState::MOTION) && !word.intersects(stopped);
        if let Some(joint) = settings.joints().find(|&joint| moves(self.state_word(joint))) {
            return Some(Fault::at(Cause::MovesUnordered, joint));
        }
        settings.joints().find_map(|joint| {
            let cause = check_state_word(self.state_word(joint))?;
            Some(Fault::at(cause, joint))
        })
    }

    fn judge_watchdogs(&mut self, now: Instant, settings: &Settings) {
        let stopped = CubeState::ERROR.union(CubeState::HALTED);
        let proven = |word: CubeState| word.contains(CubeState::COMM_ERROR) && word.intersects(stopped);
        let unproven = settings.joints().find(|&joint| !proven(self.state_word(joint)));
        if let Some(joint) = unproven {
            self.fail(Fault::at(Cause::WatchdogUnproven, joint));
            return;
        }
        self.send_reset(now, settings);
        self.send_watchdog(now, settings);
        self.recover(settings, now + RESET_SETTLE);
    }

    fn recover(&mut self, settings: &Settings, until: Instant) {
        self.restart_at(settings, STATE);
        self.enter(Stage::Recover { until });
    }

    /// All drives have been read since `read_from`: they are fit, and are read on until they stand.
    fn end_recovery(&mut self, now: Instant, settings: &Settings, read_from: Instant) {
        let unrested = settings.joints().find(|&joint| !self.stands(now, settings, joint));
        if let Some(fault) = self.unfit_drive(settings) {
            self.fail(fault);
        } else if unrested.is_none() {
            self.push(GroupEvent::Found);
        } else if now >= read_from + HALT_REST_MAX {
            self.fail(Fault { cause: Cause::RestNotReached, joint: unrested });
        } else {
            self.restart_at(settings, STATE);
            self.ask_all(settings);
        }
    }
}
