//! How a motor is found: from silence to torque, without a motion.
//!
//! ```text
//! Look ──► Register 0..9 ──► Zero ──► Enable ──► Silence ──► Expired ──► Recover ──► Zero ──► Enable ──► Held
//!  │ fault, left on ▲                    └─────────────── proven before ────────────────────────────────► │
//!  └► Clear, Release┘  only with a reset                                             fault, no answer ──► Off
//! ```
//!
//! * A motor acts on the set point that it got last, also on one that came while it was off. So one with zero gains and zero torque comes
//!   before each enabling, and the first set point with gains is the measured position.
//! * Nothing on the wire shows a range that differs from the settings: all values are wrong by their ratio. Registers are compared first.
//! * The time-out is proven: enabled without torque, the motor gets no command, and must report that its link is lost. A motor that somebody
//!   else left enabled proves it by itself while nobody speaks to it; if it does not, it is refused. A reset switches it off.
//!   The time-out cannot be left off.
//! * A motor that this group holds already, and that answers, stays as it is: to prove anything again would drop the arm.

use protocol::mit::{
    Command, Mit as SetPoint, Register, RegisterAnswer, RegisterRequest, RegisterValue, State, Status,
};
use protocol::{Duration, Instant, JointIndex};

use super::Mit;
use super::mismatch::Mismatch;
use super::options::Motor;
use crate::fault::Cause;
use crate::groups::leading::Mode;
use crate::joints::at_least;
use crate::settings::{JointSettings, Settings};

/// Periods for which one step may last.
pub(super) const STEP_PERIODS: u32 = 200;
/// Unit of the time-out register, µs.
const TIME_OUT_UNIT_US: u32 = 50;
/// MIT frames.
const MODE: RegisterValue = RegisterValue::Whole(1);

/// What is asked next of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Step {
    /// The state, which acts on nothing.
    #[default]
    Look,
    Clear,
    Release,
    /// A row of [`register`].
    Register(u8),
    Zero,
    Enable,
    /// No command until then.
    Silence {
        until: Instant,
    },
    Expired,
    Recover,
    /// It takes set points.
    Held,
    /// It gets no set point any more.
    Off,
}

/// What is sent in a step.
pub(super) enum Ask {
    Register(RegisterRequest),
    Command(Command),
}

/// Time without a command after which a motor gives no torque.
pub(super) fn time_out(settings: &Settings) -> Duration {
    Duration::from_micros(settings.watchdog_timeout_us.into())
}

/// Requests for registers in their order, with the value that must come back. Ids and ranges are read. Mode and time-out are written to
/// RAM, then read: the answer to a write may repeat what was asked. The bit rate is compared on CAN FD only.
pub(super) fn register(
    row: u8,
    motor: &Motor,
    settings: &Settings,
    fd_rate: Option<u32>,
) -> Option<(RegisterRequest, RegisterValue)> {
    use RegisterValue::{Float, Whole};
    let time_out = Whole(settings.watchdog_timeout_us / TIME_OUT_UNIT_US);
    let read = |register, value| Some((RegisterRequest::Read(register), value));
    let write = |register, value| Some((RegisterRequest::Write(register, value), value));
    match row {
        0 => read(Register::MotorId, Whole(motor.id.get().into())),
        1 => read(Register::MasterId, Whole(motor.master.get().into())),
        2 => read(Register::PositionMax, Float(motor.ranges.p_max_rad())),
        3 => read(Register::VelocityMax, Float(motor.ranges.v_max_rad_s())),
        4 => read(Register::TorqueMax, Float(motor.ranges.t_max_nm())),
        5 => write(Register::Mode, MODE),
        6 => write(Register::TimeOut, time_out),
        7 => read(Register::Mode, MODE),
        8 => read(Register::TimeOut, time_out),
        9 => read(Register::BitRate, Whole(fd_rate?)),
        _ => None,
    }
}

/// Whether a register holds what it should. Never a time-out of zero: the motor would keep its last command for ever.
pub(super) fn holds(register: Register, found: RegisterValue, expected: RegisterValue) -> bool {
    match (found, expected) {
        (RegisterValue::Whole(found), RegisterValue::Whole(expected)) => {
            found == expected && (found > 0 || register != Register::TimeOut)
        }
        (RegisterValue::Float(found), RegisterValue::Float(expected)) => {
            (found - expected).abs() <= 1e-4 * expected.abs()
        }
        _ => false,
    }
}

/// A range of positions that does not hold the soft limits of the joint.
pub(super) fn too_narrow(answer: &RegisterAnswer, limits: &JointSettings) -> Option<Mismatch> {
    let RegisterAnswer { register: register @ Register::PositionMax, value: found, .. } = *answer else {
        return None;
    };
    let [low, high] = [limits.q_min_rad, limits.q_max_rad].map(|q_rad| limits.to_drive_rad(q_rad).abs());
    let needed = RegisterValue::Float(at_least(low, high));
    matches!((found, needed), (RegisterValue::Float(found), RegisterValue::Float(needed)) if needed > found)
        .then_some(Mismatch { register, found, expected: needed })
}

impl Step {
    /// What the motor is asked.
    pub(super) fn ask(self, motor: &Motor, settings: &Settings, fd_rate: Option<u32>) -> Option<Ask> {
        Some(match self {
            Self::Look | Self::Expired => Ask::Register(RegisterRequest::State),
            Self::Register(row) => Ask::Register(register(row, motor, settings, fd_rate)?.0),
            Self::Clear | Self::Recover => Ask::Command(Command::ClearFault),
            Self::Release | Self::Off => Ask::Command(Command::Disable),
            Self::Zero => Ask::Command(Command::Mit(SetPoint::default())),
            Self::Enable => Ask::Command(Command::Enable),
            Self::Silence { .. } | Self::Held => return None,
        })
    }

    /// The step after a state. `is_proven`: the time-out stopped the motor before; `left_alone`: for longer than the time-out nobody
    /// could have fed it but another program.
    pub(super) fn after_state(
        self,
        now: Instant,
        settings: &Settings,
        status: Status,
        reset: bool,
        is_proven: bool,
        left_alone: bool,
    ) -> Result<Self, Cause> {
        let silence = time_out(settings) + settings.cycle_period() * 2;
        Ok(match (self, status) {
            (Self::Look | Self::Clear | Self::Release, Status::Disabled) => Self::Register(0),
            (Self::Look, Status::Enabled) if reset => Self::Release,
            (Self::Look, Status::Enabled) if left_alone => return Err(Cause::WatchdogUnproven),
            (Self::Look, Status::Enabled) => Self::Look,
            (Self::Look, _) if reset => Self::Clear,
            (Self::Zero, Status::Disabled) => Self::Enable,
            (Self::Enable, Status::Enabled) if is_proven || !settings.watchdog_prove => Self::Held,
            (Self::Enable, Status::Enabled) => Self::Silence { until: now + silence },
            (Self::Expired, Status::LinkLost) => Self::Recover,
            (Self::Expired, _) => return Err(Cause::WatchdogUnproven),
            (Self::Recover, Status::Disabled) => Self::Zero,
            // Asked again: a motor needs a moment.
            (Self::Clear | Self::Recover | Self::Release, _) | (Self::Enable, Status::Disabled) => self,
            _ => return Err(cause(status).unwrap_or(Cause::DriveError)),
        })
    }
}

/// What is wrong with a motor that should give torque.
pub(super) const fn cause(status: Status) -> Option<Cause> {
    Some(match status {
        Status::Enabled => return None,
        Status::Disabled | Status::Unknown(_) => Cause::DriveError,
        Status::OverVoltage | Status::UnderVoltage => Cause::DriveSupply,
        Status::OverCurrent | Status::Overload => Cause::OverCurrent,
        Status::TransistorsHot | Status::RotorHot => Cause::DrivePowerFault,
        Status::LinkLost => Cause::DriveWatchdog,
    })
}

impl Mit {
    /// An answer to a request for a register.
    pub(super) fn take_register(
        &mut self,
        settings: &Settings,
        joint: JointIndex,
        motor: &Motor,
        answer: RegisterAnswer,
    ) {
        let Step::Register(row) = self.drives.at(joint).step else { return };
        let fd_rate = self.options.fd_rate();
        let Some((_, expected)) = register(row, motor, settings, fd_rate) else { return };
        let mismatch = Mismatch { register: answer.register, found: answer.value, expected };
        let mismatch = if holds(answer.register, answer.value, expected) {
            too_narrow(&answer, &self.limits(settings, joint))
        } else {
            Some(mismatch)
        };
        if let Some(mismatch) = mismatch {
            self.mismatch = Some((joint, mismatch));
            self.refuse(joint, Cause::DriveSettingsDiffer);
            return;
        }
        let is_last = register(row.saturating_add(1), motor, settings, fd_rate).is_none();
        let next = if is_last { Step::Zero } else { Step::Register(row.saturating_add(1)) };
        self.drives.at_mut(joint).go_to(next);
    }

    /// A state while the motor is looked for.
    pub(super) fn take_search_state(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        state: &State,
    ) {
        let Mode::Finding { reset } = self.leader.mode else { return };
        let limits = self.limits(settings, joint);
        let drive = self.drives.at_mut(joint);
        let silence = time_out(settings) + settings.cycle_period() * 2;
        let left_alone = drive.looked_since.is_some_and(|since| now.saturating_since(since) > silence);
        match drive.step.after_state(now, settings, state.status, reset, drive.is_proven, left_alone) {
            Ok(next) => {
                drive.is_proven |= next == Step::Recover;
                drive.go_to(next);
                let q_rad = if next == Step::Held { drive.hold_here(&limits) } else { None };
                if let Some(q_rad) = q_rad {
                    self.leader.stand(joint, q_rad);
                }
            }
            Err(cause) => self.refuse(joint, cause),
        }
    }
}
