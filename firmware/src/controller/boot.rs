//! Start-up: find each drive, see what it is, switch its watchdog on, and prove once that the watchdog
//! stops it.
//!
//! A drive is asked in steps; a step without answer is tried again. The watchdogs are proven together: one sign of
//! life starts them, then none is sent until they must have expired, and every drive has to report that it stopped. A
//! reset ends the test. Nothing has moved, and nothing may before.

use core::borrow::BorrowMut;

use protocol::powercube::{Config, CubeState, Parameter, Reply, Request, Value};
use protocol::{Duration, Instant, JointIndex};

use super::{BootProgress, Controller};
use crate::fault::{Cause, Fault};
use crate::spline::Spline;
use crate::state::BootStage;
use crate::store::Storage;

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
        }
        if reset {
            self.send_reset(now);
            if self.watchdog_proven {
                self.send_watchdog(now);
            }
            self.machine.transition_to_boot(
                now,
                &mut self.trace,
                BootStage::Settle { until: now + RESET_SETTLE },
            );
        } else {
            self.machine.transition_to_boot(now, &mut self.trace, BootStage::Scan);
        }
    }

    pub(super) fn boot_tick(&mut self, now: Instant, stage: BootStage) {
        match stage {
            BootStage::Settle { until } => {
                if until <= now {
                    self.boot = Default::default();
                    self.machine.transition_to_boot(now, &mut self.trace, BootStage::Scan);
                }
            }
            BootStage::Scan => {
                if self.joints().all(|joint| self.boot.at(joint).step == DONE) {
                    self.end_scan(now);
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
                if self.joints().all(|joint| self.boot.at(joint).step == DONE) {
                    self.end_boot(now);
                } else {
                    self.ask_all(now);
                }
            }
        }
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

    pub(super) fn boot_on_missed(&mut self, now: Instant, stage: BootStage, joint: JointIndex) {
        // A drive that answers no writes takes this one without an answer; the configuration is read again.
        if stage == BootStage::Scan && self.boot.at(joint).step == SET_CONFIG {
            let BootProgress { tries, .. } = *self.boot.at(joint);
            self.boot.set(joint, BootProgress { step: CONFIG, tries });
        }
        let _ = now;
    }

    pub(super) fn boot_on_answer(
        &mut self,
        now: Instant,
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
        let _ = now;
    }

    fn end_scan(&mut self, now: Instant) {
        let old = self.joints().find(|&joint| !self.has_pos_state(joint));
        if let Some(joint) = old {
            self.fail(now, Fault::at(Cause::FirmwareTooOld, joint));
            return;
        }
        if !self.settings.watchdog_enable {
            self.end_boot(now);
        } else if self.settings.watchdog_prove && !self.watchdog_proven {
            // The one sign of life that starts them.
            self.send_watchdog(now);
            self.watchdog_due = None;
            let wait = Duration::from_micros(2 * u64::from(self.settings.watchdog_timeout_us));
            self.machine.transition_to_boot(now, &mut self.trace, BootStage::Starve { until: now + wait });
        } else {
            self.send_watchdog(now);
            self.end_boot(now);
        }
    }

    fn judge_watchdogs(&mut self, now: Instant) {
        let stopped = CubeState::ERROR.union(CubeState::COMM_ERROR).union(CubeState::HALTED);
        let running = self
            .joints()
            .find(|&joint| self.drives.at(joint).state.is_none_or(|(state, _)| !state.intersects(stopped)));
        if let Some(joint) = running {
            self.fail(now, Fault::at(Cause::WatchdogUnproven, joint));
            return;
        }
        self.watchdog_proven = true;
        self.send_reset(now);
        self.send_watchdog(now);
        self.restart_at(STATE);
        self.machine.transition_to_boot(
            now,
            &mut self.trace,
            BootStage::Recover { until: now + RESET_SETTLE },
        );
    }

    fn end_boot(&mut self, now: Instant) {
        let homed = self.all_homed();
        if homed {
            self.machine.transition_to_ready(now, &mut self.trace);
        } else {
            self.machine.transition_to_idle(now, &mut self.trace);
        }
        self.judge_standing(now);
    }
}
