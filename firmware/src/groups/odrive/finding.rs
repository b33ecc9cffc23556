//! How an axis is found: from silence to torque, without a motion.
//!
//! ```text
//! Look ──► Version ──► Row 0.. ──► Place ──► Close ──► Silence ──► Recover ──► Place ──► Close ──► Held
//!  │ fault, left on ▲                          └────────────── proven before ──────────────────────► │
//!  └► Release, Clear┘                                                        fault, no answer ──► Off
//! ```
//!
//! * What an axis is in shows in its heartbeats alone, and they come by themselves. So nothing is sent to it in `Look`: an axis that another
//!   program left on starves, or is refused. One that starts with a search of its index is waited for.
//! * Limits, gains and mode are written at each start, twice: no message of 0.5 shows them. With [`Endpoints`](super::Endpoints) those of 0.6
//!   are read back.
//! * The watchdog is proven: while it holds its joint the axis gets no frame, and must fall to idle with that error. Brakes close then; a joint
//!   without one sinks until the loop is closed again. As shipped the watchdog is off.
//! * The input is the measured position before the loop is closed.
//! * Estimates that come by themselves have no time: such an axis is refused.
//! * An axis in error is refused until a person clears it, but for the watchdog's: that is what the end of the last controller left.

use protocol::odrive::{AxisState, ControlMode, Heartbeat, InputMode, Order, Report, Request, Sdo, Version};
use protocol::{Duration, Instant, JointIndex};

use super::Odrive;
use super::mismatch::Mismatch;
use super::options::{Axis, Parameter, VELOCITY_MAX_REV_S};
use crate::fault::Cause;
use crate::groups::answers::Answers;
use crate::groups::leading::Mode;
use crate::settings::{JointSettings, Settings};

/// Time for an axis to start and to send a heartbeat.
const BOOT_MAX: Duration = Duration::from_millis(3_000);
/// Time for a search of the index, or another procedure that an axis starts with.
const PROCEDURE_MAX: Duration = Duration::from_millis(20_000);
/// Time for a state that was ordered.
const STEP_MAX: Duration = Duration::from_millis(1_000);
/// Between two orders of a state: heartbeats come every 100 ms.
const ORDER_EVERY: Duration = Duration::from_millis(150);
/// From the end of the time-out to a heartbeat that shows it.
const SHOWN_MAX: Duration = Duration::from_millis(250);
/// Times that the loop is closed.
const CLOSINGS_MAX: u8 = 5;
/// Periods without an answer that are one.
const ASKED_MAX: u8 = 20;
/// Room above the speed of the joint: the loop of the axis corrects with it.
pub(super) const SPEED_ROOM: f32 = 1.25;
/// Steps in a unit of a field that is fed forward.
const STEPS: u32 = 1_000;
/// Error of an axis that starves.
const WATCHDOG_05: u32 = 0x800;
const WATCHDOG_06: u32 = 0x100_0000;

/// "Error" of 0.6 while it starts.
const INITIALIZING_06: u32 = 0x1;

/// What is asked next of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Step {
    /// Nothing is sent.
    #[default]
    Look,
    Release,
    Clear,
    Version,
    /// One of [`rows`].
    Row(u8),
    /// No frame until the watchdog strikes.
    Silence,
    Recover,
    /// Where it stands.
    Place,
    /// The loop is being closed.
    Close,
    /// It takes set points.
    Held,
    /// It gets no set point any more.
    Off,
}

/// One exchange of the set-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Row {
    /// Nothing answers it.
    Order(Order),
    /// Written, then read.
    Set(Parameter, [u8; 4]),
    /// Read.
    Is(Parameter, [u8; 4]),
}

/// Time without a frame after which an axis gives no torque.
fn time_out(settings: &Settings) -> Duration {
    Duration::from_micros(settings.watchdog_timeout_us.into())
}

/// What is set before the loop is closed. Orders that nothing answers come twice: a frame may be lost.
fn rows(axis: Axis, settings: &Settings, limits: &JointSettings) -> [Row; 15] {
    let whole = u32::to_le_bytes;
    let time_out_s = settings.watchdog_timeout_us as f32 * 1e-6;
    let rev_s = SPEED_ROOM * axis.to_rev(limits.v_max_rad_s);
    let limits = Row::Order(Order::Limits { rev_s, current_a: axis.current_max_a });
    let position = Row::Order(Order::PositionGain(axis.position_gain_1_s));
    let velocity = Row::Order(Order::VelocityGains(axis.velocity_gain_nm_s, axis.integral_gain_nm));
    let mode = Row::Order(Order::Mode(ControlMode::Position, InputMode::Direct));
    [
        Row::Set(Parameter::EstimatesPeriod, whole(0)),
        Row::Set(Parameter::VelocityScale, whole(STEPS)),
        Row::Set(Parameter::TorqueScale, whole(STEPS)),
        Row::Set(Parameter::WatchdogTime, time_out_s.to_le_bytes()),
        Row::Set(Parameter::WatchdogOn, whole(1)),
        limits,
        position,
        velocity,
        mode,
        limits,
        position,
        velocity,
        mode,
        Row::Is(Parameter::ControlMode, whole(3)),
        Row::Is(Parameter::InputMode, whole(1)),
    ]
}

/// What the errors of a heartbeat stand for.
pub(super) const fn cause_of(error: u32, version: Version) -> Cause {
    // 0.5 reports motor, encoder and controller in other messages.
    let [watchdog, supply, current, power] = match version {
        Version::V05 => [WATCHDOG_05, 0, 0, 0x4_0000],
        Version::V06 => [WATCHDOG_06, 0xF00, 0x1000, 0x1000_6020],
    };
    if error & watchdog != 0 {
        Cause::DriveWatchdog
    } else if error & supply != 0 {
        Cause::DriveSupply
    } else if error & current != 0 {
        Cause::OverCurrent
    } else if error & power != 0 {
        Cause::DrivePowerFault
    } else {
        Cause::DriveError
    }
}

const fn is_watchdog(error: u32, version: Version) -> bool {
    match version {
        Version::V05 => error == WATCHDOG_05,
        Version::V06 => error == WATCHDOG_06,
    }
}

impl Odrive {
    pub(super) fn mismatched(&mut self, joint: JointIndex, mismatch: Mismatch) {
        self.mismatch = Some((joint, mismatch));
        self.refuse(joint, Cause::DriveSettingsDiffer);
    }

    /// The row of a step; those of parameters without a number are left out.
    pub(super) fn row(&self, settings: &Settings, joint: JointIndex, axis: Axis) -> Option<Row> {
        let is_there = |row: &Row| match row {
            Row::Order(_) => true,
            Row::Set(..) | Row::Is(..) => self.options.endpoints().is_some(),
        };
        let Step::Row(number) = self.drives.at(joint).step else { return None };
        rows(axis, settings, &self.limits(settings, joint)).into_iter().filter(is_there).nth(number.into())
    }

    /// What an axis is sent while it is looked for.
    pub(super) fn ask(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        axis: Axis,
    ) -> [Option<Message>; 2] {
        let row = self.row(settings, joint, axis);
        let is_gripper = self.gripper_place(settings) == Some(joint);
        let endpoint = |parameter| self.options.endpoints().and_then(|all| all.number(parameter));
        let drive = self.drives.at_mut(joint);
        let is_due = drive.ordered_at.is_none_or(|at| now.saturating_since(at) >= ORDER_EVERY);
        let state = |wanted| is_due.then_some(Message::Order(Order::State(wanted)));
        let messages = match drive.step {
            Step::Look | Step::Silence => [None, None],
            Step::Release => [state(AxisState::Idle), None],
            Step::Clear | Step::Recover => [is_due.then_some(Message::Order(Order::ClearErrors)), None],
            Step::Version => [Some(Message::Request(Request::Version)), None],
            Step::Row(_) => match row {
                Some(Row::Order(order)) => [Some(Message::Order(order)), None],
                // Written first, then read until it answers.
                Some(Row::Set(parameter, value)) => endpoint(parameter).map_or([None, None], |endpoint| {
                    let value = (drive.asked == 0).then_some(value);
                    [Some(Message::Order(Order::Sdo(Sdo { endpoint, value }))), None]
                }),
                Some(Row::Is(parameter, _)) => endpoint(parameter).map_or([None, None], |endpoint| {
                    [Some(Message::Order(Order::Sdo(Sdo { endpoint, value: None }))), None]
                }),
                None => [None, None],
            },
            Step::Place => [Some(Message::Request(Request::Estimates)), None],
            // The input first.
            Step::Close if drive.asked == 0 => [Some(Message::SetPoint), None],
            Step::Close => [state(AxisState::ClosedLoop), Some(Message::SetPoint)],
            Step::Held if is_gripper => [Some(Message::SetPoint), None],
            Step::Held => [Some(Message::SetPoint), Some(Message::Request(Request::Estimates))],
            Step::Off => [Some(Message::Order(Order::Estop)), Some(Message::Request(Request::Estimates))],
        };
        if is_due && messages.iter().flatten().any(Message::is_repeated) {
            drive.ordered_at = Some(now);
        }
        drive.asked = drive.asked.saturating_add(1);
        messages
    }

    /// A heartbeat while the axis is looked for.
    pub(super) fn take_search_heartbeat(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        heartbeat: &Heartbeat,
    ) {
        let Mode::Finding { reset } = self.leader.mode else { return };
        let Some(Axis { version, .. }) = self.options.axis(joint) else { return };
        let drive = self.drives.at_mut(joint);
        let Heartbeat { state, error, .. } = *heartbeat;
        let step = drive.step;
        let for_long = now.saturating_since(drive.since);
        let silence = time_out(settings) + settings.cycle_period() * 2;
        let next = match (step, state) {
            (Step::Look | Step::Release, AxisState::Idle) => match error {
                0 => Step::Version,
                INITIALIZING_06 if version == Version::V06 => return,
                _ if reset || is_watchdog(error, version) => Step::Clear,
                _ => return self.refuse(joint, cause_of(error, version)),
            },
            (Step::Look, AxisState::ClosedLoop) if reset => Step::Release,
            (Step::Look, AxisState::ClosedLoop) if for_long > silence => {
                return self.refuse(joint, Cause::WatchdogUnproven);
            }
            (Step::Clear, _) if error == 0 => Step::Version,
            (Step::Recover, _) if error == 0 => Step::Place,
            (Step::Silence, AxisState::Idle) if is_watchdog(error, version) => {
                drive.is_proven = true;
                Step::Recover
            }
            (Step::Silence, AxisState::ClosedLoop) if for_long <= silence => return,
            (Step::Silence, AxisState::ClosedLoop) => return self.refuse(joint, Cause::WatchdogUnproven),
            (Step::Close, AxisState::ClosedLoop) if drive.ordered_at.is_some() && error == 0 => {
                let is_proven = drive.is_proven || !settings.watchdog_prove;
                if is_proven { Step::Held } else { Step::Silence }
            }
            (Step::Silence | Step::Row(_) | Step::Place | Step::Close, _) if error != 0 => {
                return self.refuse(joint, cause_of(error, version));
            }
            _ => return,
        };
        drive.go_to(now, next);
    }

    /// An answer to a request, other than estimates.
    pub(super) fn take_answer(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        report: &Report,
    ) {
        let Some(axis) = self.options.axis(joint).filter(|_| self.leader.is_finding()) else { return };
        let row = self.row(settings, joint, axis);
        let number = |parameter| self.options.endpoints().and_then(|all| all.number(parameter));
        let drive = self.drives.at(joint);
        match (*report, drive.step, row) {
            (Report::Version { firmware: [major, minor, revision, _], .. }, Step::Version, _) => {
                let found = [major, minor, revision];
                let needed = self.options.endpoints().map(|all| all.firmware);
                let fits = axis.version == Version::V06
                    && [major, minor] == [0, 6]
                    && needed.is_none_or(|needed| needed == found);
                if fits {
                    self.begin_rows(now, settings, joint, axis);
                } else {
                    let expected = axis.version;
                    self.mismatched(joint, Mismatch::Firmware { found: Some(found), expected });
                }
            }
            (
                Report::Sdo { endpoint, value },
                _,
                Some(Row::Set(parameter, wanted) | Row::Is(parameter, wanted)),
            ) if number(parameter) == Some(endpoint) && drive.asked > 1 => {
                if holds(parameter, value, wanted) {
                    self.next_row(now, settings, joint, axis);
                } else {
                    let found = Some(value);
                    self.mismatched(joint, Mismatch::Parameter { parameter, found, expected: wanted });
                }
            }
            _ => {}
        }
    }

    fn begin_rows(&mut self, now: Instant, settings: &Settings, joint: JointIndex, axis: Axis) {
        let needed_rev_s = axis.to_rev(self.limits(settings, joint).v_max_rad_s);
        if needed_rev_s <= VELOCITY_MAX_REV_S {
            self.drives.at_mut(joint).go_to(now, Step::Row(0));
        } else {
            self.mismatched(joint, Mismatch::Speed { needed_rev_s });
        }
    }

    fn next_row(&mut self, now: Instant, settings: &Settings, joint: JointIndex, axis: Axis) {
        let drive = self.drives.at_mut(joint);
        let Step::Row(number) = drive.step else { return };
        drive.go_to(now, Step::Row(number.saturating_add(1)));
        if self.row(settings, joint, axis).is_none() {
            self.drives.at_mut(joint).go_to(now, Step::Place);
        }
    }

    /// Goes on with what no answer ends.
    pub(super) fn proceed_search(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        axis: Axis,
    ) {
        let row = self.row(settings, joint, axis);
        let drive = self.drives.at(joint);
        let for_long = now.saturating_since(drive.since);
        let was_heard = drive.heartbeat.is_some() && now.saturating_since(drive.heard_at) < STEP_MAX;
        if drive.unasked > 1 {
            return self.mismatched(joint, Mismatch::UnaskedEstimates);
        }
        match (drive.step, row) {
            (Step::Row(_), Some(Row::Order(_))) if drive.asked > 0 => {
                self.next_row(now, settings, joint, axis);
            }
            (Step::Row(_), Some(Row::Set(parameter, expected) | Row::Is(parameter, expected)))
                if drive.asked > ASKED_MAX =>
            {
                self.mismatched(joint, Mismatch::Parameter { parameter, found: None, expected });
            }
            (Step::Version, _) if drive.asked > ASKED_MAX => match axis.version {
                Version::V05 => self.begin_rows(now, settings, joint, axis),
                expected @ Version::V06 => {
                    self.mismatched(joint, Mismatch::Firmware { found: None, expected });
                }
            },
            // An arm without brakes may have sunk meanwhile.
            (Step::Close, _) if for_long > ORDER_EVERY && drive.closings < CLOSINGS_MAX => {
                let drive = self.drives.at_mut(joint);
                drive.answers = Answers::default();
                drive.go_to(now, Step::Place);
            }
            (Step::Place, _) => {
                let limits = self.limits(settings, joint);
                if let Some(q_rad) = self.drives.at_mut(joint).stand_here(axis, &limits) {
                    self.leader.stand(joint, q_rad);
                    let drive = self.drives.at_mut(joint);
                    drive.closings = drive.closings.saturating_add(1);
                    drive.go_to(now, Step::Close);
                } else if for_long > STEP_MAX {
                    self.refuse(joint, Cause::DriveMissing);
                }
            }
            (Step::Look, _) if for_long > if was_heard { PROCEDURE_MAX } else { BOOT_MAX } => {
                self.refuse(joint, if was_heard { Cause::DriveError } else { Cause::DriveMissing });
            }
            (Step::Silence, _) if for_long > time_out(settings) + SHOWN_MAX + STEP_MAX => {
                self.refuse(joint, Cause::DriveMissing);
            }
            (Step::Release | Step::Clear | Step::Recover | Step::Close, _) if for_long > STEP_MAX => {
                self.refuse(joint, if was_heard { Cause::DriveError } else { Cause::DriveMissing });
            }
            _ => {}
        }
    }
}

/// What is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Message {
    Request(Request),
    Order(Order),
    /// Position, velocity and torque of the period.
    SetPoint,
}

impl Message {
    /// An order of a state, or one that clears errors.
    const fn is_repeated(&self) -> bool {
        matches!(self, Self::Order(Order::State(_) | Order::ClearErrors))
    }
}

/// Whether a parameter holds what it should; bytes beyond its type say nothing.
fn holds(parameter: Parameter, found: [u8; 4], wanted: [u8; 4]) -> bool {
    match parameter {
        Parameter::WatchdogTime => {
            let [found, wanted] = [found, wanted].map(f32::from_le_bytes);
            (found - wanted).abs() <= 1e-4 * wanted
        }
        Parameter::WatchdogOn | Parameter::ControlMode | Parameter::InputMode => {
            found.first() == wanted.first()
        }
        Parameter::EstimatesPeriod | Parameter::VelocityScale | Parameter::TorqueScale => found == wanted,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_has_its_cause_and_one_byte_of_a_parameter_is_compared_where_it_has_no_more() {
        use Version::{V05, V06};
        for (error, version, cause) in [
            (0x800, V05, Cause::DriveWatchdog),
            (0x100_0000, V06, Cause::DriveWatchdog),
            (0x100, V06, Cause::DriveSupply),
            (0x100, V05, Cause::DriveError),
            (0x1000, V06, Cause::OverCurrent),
            (0x4000, V06, Cause::DrivePowerFault),
            (0x4000, V05, Cause::DriveError),
            (0x200_0000, V06, Cause::DriveError),
        ] {
            assert_eq!(cause_of(error, version), cause, "{error:#x}");
        }
        assert!(holds(Parameter::WatchdogOn, [1, 7, 7, 7], [1, 0, 0, 0]));
        assert!(!holds(Parameter::WatchdogOn, [0, 1, 0, 0], [1, 0, 0, 0]));
        assert!(!holds(Parameter::VelocityScale, [0xE8, 3, 1, 0], 1000_u32.to_le_bytes()));
        assert!(!holds(Parameter::WatchdogTime, 0.1_f32.to_le_bytes(), 0.05_f32.to_le_bytes()));
        assert!(!holds(Parameter::WatchdogTime, f32::NAN.to_le_bytes(), 0.05_f32.to_le_bytes()));
    }
}
