//! Commands, refusals, register values and samples between the wire and the controller.

use protocol::cyphal::bits::Decode;
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmPrepare, Authorization, ClearFault, Gripper, Home, Jog, Run, Unlock,
};
use protocol::cyphal::cubecell::group_state;
use protocol::cyphal::cubecell::target::TargetState;
use protocol::cyphal::uavcan::command::{Status, standard};
use protocol::cyphal::uavcan::value::ValueBuf;
use protocol::{Duration, Instant, JOINTS_MAX, JointIndex};

use crate::events::Action;
use crate::fault::{Cause, Refusal};
use crate::orders::{Order, Target};
use crate::registers::{Kind, Number};
use crate::retarget::EndState;
use crate::store::FileName;
use crate::telemetry::GroupSample;

/// Order of a command; an error if the command is unknown or its parameter cannot be read.
pub(super) fn order_of(number: u16, parameter: &[u8]) -> Result<Order, Status> {
    fn read<'a, T: Decode<'a>>(parameter: &'a [u8]) -> Result<T, Status> {
        T::from_bytes(parameter).map_err(|_| Status::BAD_PARAMETER)
    }
    let ms = |ms: u16| Duration::from_millis(ms.into());
    let name = |parameter| {
        read::<command::Trajectory>(parameter)
            .map(|file| FileName { crc64: file.trajectory_crc64, len: file.length_bytes })
    };
    Ok(match number {
        command::ARM_PREPARE => {
            let ArmPrepare { trajectory_crc64, valid_ms } = read(parameter)?;
            Order::ArmPrepare { crc64: trajectory_crc64, valid: ms(valid_ms) }
        }
        command::ARM_CONFIRM => {
            let ArmConfirm { token, valid_ms } = read(parameter)?;
            Order::ArmConfirm { token, valid: ms(valid_ms) }
        }
        command::DISARM => Order::Disarm,
        command::RUN => {
            let Run { trajectory_crc64: crc64, length_bytes: len, start_us } = read(parameter)?;
            let name = FileName { crc64, len };
            match start_us {
                0 => Order::Run(name),
                start_us => Order::RunAt { name, start: Instant::from_micros(start_us) },
            }
        }
        command::STOP => Order::Stop,
        command::CLEAR_FAULT => {
            let ClearFault { fault_cause } = read(parameter)?;
            Order::ClearFault { code: fault_cause }
        }
        command::HOME => {
            let Home { joint_mask } = read(parameter)?;
            Order::Home { mask: joint_mask }
        }
        command::JOG => {
            let Jog { joint, qd_rad_s, hold_ms } = read(parameter)?;
            let joint = JointIndex::new(joint.into()).map_err(|_| Status::BAD_PARAMETER)?;
            Order::Jog { joint, qd_rad_s, hold: ms(hold_ms) }
        }
        command::COMMIT_TRAJECTORY => Order::Commit(name(parameter)?),
        command::GRIPPER => {
            let Gripper { open } = read(parameter)?;
            Order::Gripper { open }
        }
        command::CHALLENGE => Order::Challenge,
        command::AUTHORIZE => {
            let Authorization { nonce, code } = read(parameter)?;
            Order::Authorize { nonce, code }
        }
        command::UNLOCK => {
            let Unlock { robot_crc32, valid_s } = read(parameter)?;
            Order::Unlock { robot_crc32, valid: Duration::from_secs(valid_s.into()) }
        }
        standard::STORE_PERSISTENT_STATES => Order::SaveSettings,
        _ => return Err(Status::BAD_COMMAND),
    })
}

/// A new end state as the controller knows it; an event that it does not know is refused.
///
/// # Errors
/// [`Cause::TargetEvent`].
pub fn target_of(message: &TargetState) -> Result<Target, Refusal> {
    let at = Instant::from_micros(message.arrive_us);
    let mut target = Target { at, joints: message.joints().len() as u8, ..Target::default() };
    for (to, from) in target.state.0.iter_mut().zip(message.joints()) {
        *to = EndState { q_rad: from.q_urad as f32 * 1e-6, qd_rad_s: from.qd_rad_s };
    }
    for (index, (to, from)) in target.events.iter_mut().zip(message.events()).enumerate() {
        let action =
            Action::from_number(from.action).ok_or(Refusal::in_file(Cause::TargetEvent, None, index))?;
        let at = Instant::from_micros(message.arrive_us.saturating_add_signed(from.offset_us.into()));
        *to = Some((at, action));
    }
    Ok(target)
}

pub(super) const fn status_of(cause: Cause) -> Status {
    match cause {
        Cause::OrderNotNow | Cause::GripperBusy | Cause::BankBusy => Status::BAD_STATE,
        Cause::BadValue | Cause::JointUnknown | Cause::StartPassed | Cause::StartTooFar => {
            Status::BAD_PARAMETER
        }
        Cause::OtherHost | Cause::CodeMissing | Cause::CodeWrong => Status::NOT_AUTHORIZED,
        _ => Status::FAILURE,
    }
}

pub(super) fn to_message(refusal: &Refusal) -> command::Refusal {
    command::Refusal {
        cause: refusal.cause.code(),
        joint: refusal.joint.map_or(0, |joint| joint.get() as u8 + 1),
        index: refusal.index,
    }
}

/// Port numbers are 16 bits wide in the standard, all other numbers as wide as they are here.
pub(super) fn to_value(name: &str, kind: Kind, numbers: &[Number]) -> Option<ValueBuf> {
    let (mut floats, mut naturals, mut bits) =
        ([0.0f32; JOINTS_MAX], [0u32; JOINTS_MAX], [false; JOINTS_MAX]);
    let places = floats.iter_mut().zip(&mut naturals).zip(&mut bits);
    for (((float, natural), bit), number) in places.zip(numbers) {
        match *number {
            Number::Real32(x) => *float = x,
            Number::Natural32(x) => *natural = x,
            Number::Bit(x) => *bit = x,
        }
    }
    let count = numbers.len();
    match kind {
        Kind::Real32 => ValueBuf::try_from(floats.get(..count)?).ok(),
        Kind::Natural32 if name.starts_with("uavcan.") => Some(ValueBuf::from(*naturals.first()? as u16)),
        Kind::Natural32 => ValueBuf::try_from(naturals.get(..count)?).ok(),
        Kind::Bit => ValueBuf::bits(bits.get(..count)?).ok(),
    }
}

/// The message with the state of the group. `complete`: a whole file is in the upload bank.
pub fn group_message(sample: &GroupSample, sequence: u16, complete: bool) -> group_state::GroupState {
    let us16 = |span: Duration| u16::try_from(span.as_micros()).unwrap_or(u16::MAX);
    let ms = (sample.arming_left.as_micros().min(u64::from(u32::MAX)) as u32) / 1_000;
    group_state::GroupState {
        uptime_us: sample.at.as_micros(),
        sequence,
        state: sample.state,
        fault_joint: sample.fault.and_then(|fault| fault.joint).map_or(0, |joint| joint.get() as u8 + 1),
        fault_cause: sample.fault.map_or(0, |fault| fault.cause.code()),
        homed_mask: sample.homed_mask,
        trajectory_stored: complete,
        trajectory_committed: sample.committed.is_some(),
        host_alive: sample.host_alive,
        gripper_open: sample.gripper_open,
        bus_warning: false,
        limits_unlocked: sample.limits_unlocked,
        keyed: sample.keyed,
        cycle_us: us16(sample.cycle),
        cycle_jitter_us: us16(sample.jitter),
        cycles_late: sample.counters.cycles_late,
        replies_missed: sample.counters.replies_missed,
        cycles_saturated: sample.counters.cycles_saturated,
        bus_load_permille: 0,
        trajectory_crc64: sample.committed.map_or(0, |name| name.crc64),
        trajectory_time_us: sample.path_us,
        arming_left_ms: u16::try_from(ms).unwrap_or(u16::MAX),
        start_in_us: sample
            .start_left
            .map_or(0, |left| u32::try_from(left.as_micros()).unwrap_or(u32::MAX).max(1)),
        targets_taken: sample.targets_taken,
        differs: sample.differs,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::cyphal::bits::Encode;

    fn bytes(parameter: &impl Encode) -> ([u8; 64], usize) {
        let mut buffer = [0; 64];
        let len = parameter.to_bytes(&mut buffer).unwrap();
        (buffer, len)
    }

    #[test]
    fn every_command_number_becomes_its_order() {
        let five_s = Duration::from_secs(5);
        let name = FileName { crc64: 7, len: 80 };
        let joint = JointIndex::new(2).unwrap();
        let order = |number, parameter: ([u8; 64], usize)| order_of(number, &parameter.0[..parameter.1]);
        let none = || ([0; 64], 0);
        let run = |start_us| bytes(&Run { trajectory_crc64: 7, length_bytes: 80, start_us });
        let at = Instant::from_micros(3);
        let jog = Order::Jog { joint, qd_rad_s: 0.1, hold: Duration::from_millis(200) };
        let unlock = Order::Unlock { robot_crc32: 9, valid: Duration::from_secs(60) };
        let cases = [
            (
                1,
                bytes(&ArmPrepare { trajectory_crc64: 7, valid_ms: 5_000 }),
                Order::ArmPrepare { crc64: 7, valid: five_s },
            ),
            (
                2,
                bytes(&ArmConfirm { token: 8, valid_ms: 5_000 }),
                Order::ArmConfirm { token: 8, valid: five_s },
            ),
            (3, none(), Order::Disarm),
            (4, run(0), Order::Run(name)),
            (4, run(3), Order::RunAt { name, start: at }),
            (5, none(), Order::Stop),
            (6, bytes(&ClearFault { fault_cause: 104 }), Order::ClearFault { code: 104 }),
            (7, bytes(&Home { joint_mask: 5 }), Order::Home { mask: 5 }),
            (8, bytes(&Jog { joint: 2, qd_rad_s: 0.1, hold_ms: 200 }), jog),
            (9, bytes(&command::Trajectory { trajectory_crc64: 7, length_bytes: 80 }), Order::Commit(name)),
            (10, bytes(&Gripper { open: true }), Order::Gripper { open: true }),
            (11, none(), Order::Challenge),
            (13, bytes(&Unlock { robot_crc32: 9, valid_s: 60 }), unlock),
            (65_530, none(), Order::SaveSettings),
        ];
        for (number, parameter, expected) in cases {
            assert_eq!(order(number, parameter), Ok(expected), "command {number}");
        }
        assert_eq!(order(0, none()), Err(Status::BAD_COMMAND));
        let nobody = bytes(&Jog { joint: 8, qd_rad_s: 0.1, hold_ms: 200 });
        assert_eq!(order(8, nobody), Err(Status::BAD_PARAMETER));
    }
}
