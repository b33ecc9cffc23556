//! How a servo is found: from silence to torque, without a motion.
//!
//! ```text
//! Look ──► Row 0.. ──► Configured ──► Enabling ──► Enabled ──► Silence ──► Judged ──► Clearing ──► Enabling ──► Enabled ──► Held
//!  │ no answer ▲        waits for all    │ towards torque, word by word                   │                                 │
//!  └───────────┘        SYNC begins      └────────── proven before ───────────────────────────────────────────────────────► │
//!                                                                                                        fault, no answer ──► Off
//! ```
//!
//! * Each object that is written is read back: some maps are fixed, and some servos take a value and keep another one.
//! * Units, mode and profile are read and compared. Nothing in process data shows that they differ.
//! * The target is the measured position before the servo gets torque: with torque it goes to the last target that it got.
//! * The supervision of the controller's heartbeat is proven: all servos have torque at rest, the heartbeat stays away, and each must end in
//!   a fault by itself. A module that interpolates may end without torque and without a fault: not each has object 6007. A node without object
//!   1029 goes pre-operational then. So all nodes are started again, and new process data show the states.
//! * A servo in a fault is refused until a person clears it, but for the fault that the end of the last controller left. Its error is object
//!   603F; without it, the newest entry of object 1003; without both, the cause is not known ([`Cause::DriveError`]).
//! * A servo that this group holds already, and that answers, stays as it is if all others do, too.

use protocol::canopen::NodeId;
use protocol::canopen::cia402::{Control, State, Status};
use protocol::canopen::client::{Failure, Transfer};
use protocol::canopen::nmt;
use protocol::canopen::sdo::AbortCode;
use protocol::{Duration, Instant, JointIndex};

use super::Cia402;
use super::mismatch::{Found, Mismatch};
use super::options::{Follow, HOST_NODE, Servo};
use super::rows::{self, BEFORE_ZERO, Kind, LAST_ERROR, Row, homing_rows, little_endian, row};
use crate::fault::Cause;
use crate::groups::leading::Mode;
use crate::groups::position::Drive as _;
use crate::settings::Settings;

/// Time for an answer to service data.
const PATIENCE: Duration = Duration::from_millis(100);
/// Time for a servo to boot and to answer.
const BOOT_MAX: Duration = Duration::from_millis(3_000);
/// Time for a state, a mode or torque.
const STEP_MAX: Duration = Duration::from_millis(1_000);
/// Heartbeats of the servos.
pub(super) const HEARTBEAT: Duration = Duration::from_millis(50);
/// Profile 402.
const PROFILE: u32 = 402;
/// Error of a servo that misses the heartbeat of its controller.
const HEARTBEAT_LOST: u16 = 0x8130;
/// Time until a servo has torque that looks for its commutation first.
const COMMUTATION_MAX: Duration = Duration::from_millis(8_000);

/// What is asked next of a servo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Step {
    /// Pre-operational; its type is asked.
    #[default]
    Look,
    /// One of [`rows::all`].
    Row(u8),
    /// Waits for the others.
    Configured,
    /// Word by word to torque.
    Enabling,
    /// It has torque.
    Enabled,
    /// No heartbeat comes to it.
    Silence,
    /// Its node is started again, and shows whether it has stopped.
    Judged,
    /// Its fault is reset.
    Clearing,
    /// It takes set points.
    Held,
    /// One of [`homing_rows`].
    Homing(u8),
    /// It takes its place as zero.
    Zero,
    /// It gets no set point any more.
    Off,
}

/// What an emergency, or object 603F, stands for.
pub(super) const fn cause_of(code: u16) -> Cause {
    match code {
        0x2000..=0x2FFF => Cause::OverCurrent,
        0x3000..=0x3FFF => Cause::DriveSupply,
        0x4000..=0x5FFF => Cause::DrivePowerFault,
        HEARTBEAT_LOST | 0x8250 => Cause::DriveWatchdog,
        0x8611 => Cause::DriveTowError,
        _ => Cause::DriveError,
    }
}

impl Cia402 {
    fn row(&self, settings: &Settings, joint: JointIndex) -> Option<Row> {
        let servo = self.options.servo(joint)?;
        match self.drives.at(joint).step {
            Step::Look => Some(row(Kind::Is, 0x1000, 0, 4, PROFILE)),
            Step::Row(number) => {
                let row = rows::all(&self.options, servo, settings, joint).nth(number.into())?;
                Some(row.with_units(self.drives.at(joint).units))
            }
            Step::Homing(number) => homing_rows().get(usize::from(number)).copied(),
            _ => None,
        }
    }

    fn mismatched(&mut self, now: Instant, joint: JointIndex, mismatch: Mismatch) {
        self.mismatch = Some((joint, mismatch));
        if self.leader.is_finding() {
            self.refuse(joint, Cause::DriveSettingsDiffer);
        } else {
            // Homing leaves the servo between two modes.
            self.drives.at_mut(joint).go_to(now, Step::Off);
            self.fail(joint, Cause::HomingFailed);
        }
    }

    /// Begins the transfer of the step, unless one runs.
    pub(super) fn ask(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let (Some(row), Some(servo)) = (self.row(settings, joint), self.options.servo(joint)) else { return };
        let drive = self.drives.at_mut(joint);
        if drive.transfer.is_some() {
            return;
        }
        let writes = (row.is_set() || row.kind == Kind::Write) && !drive.is_written;
        let bytes = row.value.to_le_bytes();
        let value = bytes.get(..usize::from(row.bytes)).unwrap_or_default();
        let begun = if writes {
            Transfer::write(now, PATIENCE, servo.node, row.object, value).ok()
        } else {
            Some(Transfer::read(now, PATIENCE, servo.node, row.object))
        };
        let is_look = drive.step == Step::Look;
        if let Some((transfer, frame)) = begun {
            drive.transfer = Some(transfer);
            if is_look {
                self.send(nmt::Command::PreOperational.encode(Some(servo.node)));
            }
            self.send(frame);
        }
    }

    /// Looks whether the transfer of a joint has ended, and goes on.
    pub(super) fn proceed_transfer(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let drive = self.drives.at_mut(joint);
        let Some(outcome) = drive.transfer.as_ref().and_then(Transfer::outcome) else { return };
        let outcome = outcome.map(little_endian);
        let written = core::mem::take(&mut drive.is_written);
        drive.transfer = None;
        let Some(row) = self.row(settings, joint) else { return };
        match outcome {
            Err(Failure::TimeOut) => self.unanswered(now, joint),
            // A history without errors has no entry, which servos say in several ways.
            Err(Failure::Aborted(code))
                if (code == AbortCode::NO_OBJECT || row.object == LAST_ERROR)
                    && self.may_be_absent(joint, row) =>
            {
                self.next_row(now, settings, joint);
            }
            Err(failure) => {
                let code = if let Failure::Aborted(code) = failure { code } else { AbortCode::COMMAND };
                let mismatch =
                    Mismatch { object: row.object, found: Found::Refused(code), expected: row.value };
                self.mismatched(now, joint, mismatch);
            }
            Ok(_) if row.is_set() && !written => {
                self.drives.at_mut(joint).is_written = true;
            }
            Ok(value) => self.take_row(now, settings, joint, row, value),
        }
        self.ask_unless_polled(now, settings, joint, row.kind);
    }

    /// Of the units all objects are absent, or none.
    fn may_be_absent(&self, joint: JointIndex, row: Row) -> bool {
        let is_first = !matches!(row.kind, Kind::Unit(_)) || self.drives.at(joint).units == [0; 4];
        is_first && self.options.servo(joint).is_some_and(|servo| row.may_be_absent(servo))
    }

    /// The next request leaves at once; a value that is awaited is read once in a period.
    fn ask_unless_polled(&mut self, now: Instant, settings: &Settings, joint: JointIndex, kind: Kind) {
        if kind != Kind::Shows {
            self.ask(now, settings, joint);
        }
    }

    fn unanswered(&mut self, now: Instant, joint: JointIndex) {
        let drive = self.drives.at(joint);
        let boots = drive.step == Step::Look && now.saturating_since(drive.since) < BOOT_MAX;
        if !boots {
            self.refuse(joint, Cause::DriveMissing);
        }
        if self.drives.at(joint).is_held() {
            self.drives.at_mut(joint).go_to(now, Step::Off);
            self.fail(joint, Cause::HomingFailed);
        }
    }

    fn take_row(&mut self, now: Instant, settings: &Settings, joint: JointIndex, row: Row, value: u32) {
        let Some(servo) = self.options.servo(joint) else { return };
        let mode = self.leader.mode;
        let drive = self.drives.at_mut(joint);
        match row.kind {
            Kind::Unit(part) => {
                if let Some(unit) = drive.units.get_mut(usize::from(part)) {
                    *unit = value;
                }
                let [counts, turns, motor, shaft] = drive.units.map(u64::from);
                let wanted = u64::from(servo.counts_per_turn) * turns * shaft;
                if part == 3 && (counts * motor != wanted || wanted == 0) {
                    let per_turn = (counts * motor).checked_div(turns * shaft).unwrap_or(0);
                    let found = Found::CountsPerTurn(u32::try_from(per_turn).unwrap_or(u32::MAX));
                    let mismatch = Mismatch { object: row.object, found, expected: servo.counts_per_turn };
                    return self.mismatched(now, joint, mismatch);
                }
            }
            Kind::Error => drive.error = drive.error.or(Some(value as u16)),
            Kind::State => {
                let resets = mode == Mode::Finding { reset: true };
                let cause = match Status(value as u16).state() {
                    // What the end of a controller leaves. Clearing it moves nothing.
                    Some(State::Fault) if drive.error == Some(HEARTBEAT_LOST) => None,
                    Some(State::Fault | State::FaultReaction) => Some(cause_of(drive.error.unwrap_or(0))),
                    // Nobody proved that it stops without its host.
                    Some(State::OperationEnabled | State::QuickStopActive) if !drive.is_ours => {
                        Some(Cause::WatchdogUnproven)
                    }
                    _ => None,
                };
                if let Some(cause) = cause.filter(|_| !resets) {
                    return self.refuse(joint, cause);
                }
            }
            Kind::Is if drive.step == Step::Look => {
                if value & 0xFFFF != PROFILE {
                    let found = Found::Value(value);
                    let mismatch = Mismatch { object: row.object, found, expected: row.value };
                    return self.mismatched(now, joint, mismatch);
                }
            }
            Kind::Write => {}
            Kind::Shows if !row.holds(value) && now.saturating_since(drive.since) < STEP_MAX => return,
            _ => {
                if !row.holds(value) {
                    let mismatch =
                        Mismatch { object: row.object, found: Found::Value(value), expected: row.value };
                    return self.mismatched(now, joint, mismatch);
                }
            }
        }
        self.next_row(now, settings, joint);
    }

    fn next_row(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let Some(servo) = self.options.servo(joint) else { return };
        let drive = self.drives.at(joint);
        let next = match drive.step {
            Step::Look => Step::Row(0),
            Step::Row(number) => {
                let next = number.saturating_add(1);
                let is_last = rows::all(&self.options, servo, settings, joint).nth(next.into()).is_none();
                if is_last { Step::Configured } else { Step::Row(next) }
            }
            Step::Homing(number) if number + 1 == BEFORE_ZERO => Step::Zero,
            Step::Homing(number) if usize::from(number) + 1 >= homing_rows().len() => {
                return self.at_home(now, settings, joint);
            }
            Step::Homing(number) => Step::Homing(number + 1),
            other => other,
        };
        self.drives.at_mut(joint).go_to(now, next);
    }

    fn at_home(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        self.drives.at_mut(joint).go_to(now, Step::Held);
        self.end_homing(settings, joint);
    }

    /// Process data while the servo is looked for, or takes its zero.
    pub(super) fn take_search_state(&mut self, now: Instant, joint: JointIndex) {
        let drive = self.drives.at_mut(joint);
        let (Some(status), Some(state)) = (drive.status, drive.state()) else { return };
        match (drive.step, state) {
            (Step::Enabling, State::OperationEnabled) => {
                drive.is_ours = true;
                if drive.follows {
                    drive.go_to(now, Step::Enabled);
                }
            }
            (Step::Enabling | Step::Enabled, State::Fault | State::FaultReaction) => {
                let cause = cause_of(drive.emergency);
                self.refuse(joint, cause);
            }
            (Step::Clearing, State::SwitchOnDisabled) => {
                drive.emergency = 0;
                drive.go_to(now, Step::Enabling);
            }
            (Step::Zero, _) if status.mode_fails() => {
                drive.go_to(now, Step::Off);
                self.fail(joint, Cause::HomingFailed);
            }
            (Step::Zero, _) if status.target_reached() && status.mode_works() => {
                drive.go_to(now, Step::Homing(BEFORE_ZERO));
            }
            _ => {}
        }
    }

    /// What all servos wait for.
    pub(super) fn proceed_search(&mut self, now: Instant, settings: &Settings) {
        let all =
            |group: &Self, step: Step| settings.joints().all(|joint| group.drives.at(joint).step == step);
        for joint in settings.joints() {
            let drive = self.drives.at(joint);
            let interpolates = self.interpolates(joint);
            let most = match drive.step {
                Step::Enabling if interpolates => COMMUTATION_MAX,
                Step::Enabling | Step::Judged | Step::Clearing => STEP_MAX,
                _ => continue,
            };
            if now.saturating_since(drive.since) > most {
                let cause =
                    if drive.answers.missed_in_row > 0 { Cause::DriveMissing } else { Cause::DriveError };
                return self.refuse(joint, cause);
            }
        }
        if all(self, Step::Configured) {
            self.start_all(now, settings, Step::Enabling);
            (self.own.is_synchronous, self.own.beats_at) = (true, now);
        } else if all(self, Step::Enabled) {
            let is_proven = settings.joints().all(|joint| self.drives.at(joint).is_proven);
            let next = if is_proven || !settings.watchdog_prove { Step::Held } else { Step::Silence };
            self.own.proof_ends_at = now + rows::time_out(settings) + settings.cycle_period() * 4;
            self.all_to(now, settings, next);
        } else if all(self, Step::Silence) && now >= self.own.proof_ends_at {
            self.start_all(now, settings, Step::Judged);
        } else if all(self, Step::Judged) && settings.joints().all(|j| self.drives.at(j).status.is_some()) {
            self.end_proof(now, settings);
        }
    }

    /// Starts the nodes: their process data run, and those from before count no more.
    fn start_all(&mut self, now: Instant, settings: &Settings, step: Step) {
        for joint in settings.joints() {
            if let Some(Servo { node, .. }) = self.options.servo(joint) {
                self.send(nmt::Command::Start.encode(Some(node)));
            }
            let drive = self.drives.at_mut(joint);
            (drive.heard_at, drive.status) = (now, None);
            drive.go_to(now, step);
        }
    }

    fn all_to(&mut self, now: Instant, settings: &Settings, step: Step) {
        settings.joints().for_each(|joint| self.drives.at_mut(joint).go_to(now, step));
    }

    fn end_proof(&mut self, now: Instant, settings: &Settings) {
        for joint in settings.joints() {
            let is_module = self.interpolates(joint);
            let drive = self.drives.at_mut(joint);
            drive.is_proven = match drive.state() {
                Some(State::Fault | State::FaultReaction) => true,
                // Without object 6007 it may lose its torque without a fault.
                Some(State::SwitchOnDisabled) => is_module,
                _ => false,
            };
            if !drive.is_proven {
                return self.refuse(joint, Cause::WatchdogUnproven);
            }
        }
        self.all_to(now, settings, Step::Clearing);
    }

    /// The control word of a servo.
    pub(super) fn control_of(&self, joint: JointIndex) -> Control {
        let drive = self.drives.at(joint);
        let state = drive.state();
        let enabled =
            if self.interpolates(joint) { Control::ENABLE.with_mode_bit() } else { Control::ENABLE };
        match drive.step {
            Step::Zero => Control::ENABLE.with_mode_bit(),
            Step::Enabling if state == Some(State::OperationEnabled) => enabled,
            Step::Enabling => state.and_then(Control::towards_enabled).unwrap_or(Control::DISABLE_VOLTAGE),
            Step::Clearing if self.is_odd => Control::FAULT_RESET,
            Step::Clearing => Control::DISABLE_VOLTAGE,
            Step::Off => Control::QUICK_STOP,
            _ => enabled,
        }
    }

    pub(super) fn interpolates(&self, joint: JointIndex) -> bool {
        self.options.servo(joint).is_some_and(|servo| servo.follow == Follow::Interpolated)
    }

    /// Node of the controller.
    pub(super) fn host_node() -> Option<NodeId> {
        NodeId::new(HOST_NODE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_code_has_its_cause() {
        for (code, cause) in [
            (0x2310, Cause::OverCurrent),
            (0x3220, Cause::DriveSupply),
            (0x4310, Cause::DrivePowerFault),
            (0x7305, Cause::DriveError),
            (0x8110, Cause::DriveError),
            (0x8130, Cause::DriveWatchdog),
            (0x8611, Cause::DriveTowError),
        ] {
            assert_eq!(cause_of(code), cause, "{code:x}");
        }
    }
}
