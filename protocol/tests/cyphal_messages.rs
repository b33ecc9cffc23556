//! Messages bit for bit: against pycyphal, against literal bytes with their meaning, and there and back.

use proptest::prelude::*;
use protocol::cyphal::bits::{BufferTooSmall, Decode, DecodeError, Encode};
use protocol::cyphal::cubecell::command::{
    ArmConfirm, ArmOffer, ArmPrepare, Authorization, Challenge, ClearFault, ClockReading, Gripper, Home, Jog,
    Refusal, Room, Run, Trajectory, Unlock,
};
use protocol::cyphal::cubecell::group_state::{GroupState, State};
use protocol::cyphal::cubecell::joint_state::{JointFlags, JointSample, JointState};
use protocol::cyphal::cubecell::stop::{Reason, Sender, Stop};
use protocol::cyphal::cubecell::target::{TargetAnswer, TargetEvent, TargetJoint, TargetState};
use protocol::cyphal::uavcan::command::{CommandRequest, CommandResponse, Status};
use protocol::cyphal::uavcan::diagnostic::{Record, Severity};
use protocol::cyphal::uavcan::file::{FileError, ReadRequest, ReadResponse, WriteRequest, WriteResponse};
use protocol::cyphal::uavcan::heartbeat::{Health, Heartbeat, Mode};
use protocol::cyphal::uavcan::info::{NodeInfo, Version};
use protocol::cyphal::uavcan::port_list::{PortList, SubjectIds};
use protocol::cyphal::uavcan::register::{AccessRequest, AccessResponse, ListRequest, ListResponse};
use protocol::cyphal::uavcan::value::{Value, ValueBuf, ValueType};

/// Longest value of any type here.
const LEN_MAX: usize = 2300;

fn bytes_of(value: &impl Encode) -> Vec<u8> {
    let mut buffer = vec![0xCC; LEN_MAX];
    let len = value.to_bytes(&mut buffer).unwrap();
    buffer.truncate(len);
    buffer
}

fn reread<'a, T: Decode<'a> + Encode>(data: &'a [u8]) -> Result<Vec<u8>, DecodeError> {
    T::from_bytes(data).map(|value| bytes_of(&value))
}

/// Reads and writes again the bytes of the named type.
type Reread = fn(&[u8]) -> Result<Vec<u8>, DecodeError>;

const TYPES: [(&str, Reread); 35] = [
    ("Heartbeat", |b| reread::<Heartbeat>(b)),
    ("GetInfo.Response", |b| reread::<NodeInfo>(b)),
    ("port.List", |b| reread::<PortList>(b)),
    ("register.Value", |b| reread::<Value>(b)),
    ("register.Access.Request", |b| reread::<AccessRequest>(b)),
    ("register.Access.Response", |b| reread::<AccessResponse>(b)),
    ("register.List.Request", |b| reread::<ListRequest>(b)),
    ("register.List.Response", |b| reread::<ListResponse>(b)),
    ("ExecuteCommand.Request", |b| reread::<CommandRequest>(b)),
    ("ExecuteCommand.Response", |b| reread::<CommandResponse>(b)),
    ("file.Read.Request", |b| reread::<ReadRequest>(b)),
    ("file.Read.Response", |b| reread::<ReadResponse>(b)),
    ("file.Write.Request", |b| reread::<WriteRequest>(b)),
    ("file.Write.Response", |b| reread::<WriteResponse>(b)),
    ("diagnostic.Record", |b| reread::<Record>(b)),
    ("JointState", |b| reread::<JointState>(b)),
    ("GroupState", |b| reread::<GroupState>(b)),
    ("Stop", |b| reread::<Stop>(b)),
    ("ArmPrepare", |b| reread::<ArmPrepare>(b)),
    ("ArmOffer", |b| reread::<ArmOffer>(b)),
    ("ArmConfirm", |b| reread::<ArmConfirm>(b)),
    ("Trajectory", |b| reread::<Trajectory>(b)),
    ("ClearFault", |b| reread::<ClearFault>(b)),
    ("Challenge", |b| reread::<Challenge>(b)),
    ("Authorization", |b| reread::<Authorization>(b)),
    ("Unlock", |b| reread::<Unlock>(b)),
    ("Home", |b| reread::<Home>(b)),
    ("Jog", |b| reread::<Jog>(b)),
    ("Gripper", |b| reread::<Gripper>(b)),
    ("Refusal", |b| reread::<Refusal>(b)),
    ("TargetState", |b| reread::<TargetState>(b)),
    ("TargetAnswer", |b| reread::<TargetAnswer>(b)),
    ("Run", |b| reread::<Run>(b)),
    ("ClockReading", |b| reread::<ClockReading>(b)),
    ("Room", |b| reread::<Room>(b)),
];

fn unhex(text: &str) -> Vec<u8> {
    let digits = text.trim_start_matches('-').as_bytes();
    digits.chunks(2).map(|d| u8::from_str_radix(str::from_utf8(d).unwrap(), 16).unwrap()).collect()
}

#[test]
fn every_type_reads_and_writes_as_the_reference_implementation_does() {
    let mut seen = std::collections::BTreeMap::<&str, usize>::new();
    for line in include_str!("cyphal_vectors.txt").lines().filter(|line| !line.starts_with('#')) {
        let [name, input, output] = line.split(' ').collect::<Vec<_>>().try_into().unwrap();
        let (_, reread) = TYPES.iter().find(|(known, _)| *known == name).expect("known type");
        let mut data = unhex(input);
        if name != "port.List" {
            // As the receiver does: zeros up to the extent. They would hide a cut delimited part,
            // which PortList is read without.
            data.resize(LEN_MAX, 0);
        }
        let got = reread(&data);
        match output {
            "invalid" => assert!(got.is_err(), "{name} {input}"),
            _ => assert_eq!(got, Ok(unhex(output)), "{name} {input}"),
        }
        *seen.entry(name).or_default() += 1;
    }
    assert_eq!(seen.len(), TYPES.len());
    assert!(seen.values().all(|count| *count == 16), "{seen:?}");
}

#[test]
fn valid_bytes_need_no_zeros_behind_them() {
    for line in include_str!("cyphal_vectors.txt").lines().filter(|line| !line.starts_with('#')) {
        let [name, _, output] = line.split(' ').collect::<Vec<_>>().try_into().unwrap();
        if output != "invalid" {
            let (_, reread) = TYPES.iter().find(|(known, _)| *known == name).unwrap();
            let data = unhex(output);
            assert_eq!(reread(&data).as_ref(), Ok(&data), "{name} {output}");
        }
    }
}

// ---- literal bytes -------------------------------------------------------------------------------

#[test]
fn heartbeat_of_the_specification() {
    let heartbeat =
        Heartbeat { uptime_s: 3, health: Health::Nominal, mode: Mode::INITIALIZATION, vendor_status: 0xA1 };
    assert_eq!(bytes_of(&heartbeat), [3, 0, 0, 0, 0, 1, 0xA1]);
}

#[test]
fn node_info_of_the_specification() {
    let name = b"org.uavcan.pyuavcan.demo.basic_usage";
    let info =
        NodeInfo { protocol: Version::new(1, 0), software: Version::new(1, 0), name, ..NodeInfo::default() };
    let mut expected = vec![1, 0, 0, 0, 1, 0];
    expected.extend([0; 24]);
    expected.push(0x24);
    expected.extend(name);
    expected.extend([0, 0]);
    assert_eq!(bytes_of(&info), expected);
}

#[test]
fn a_register_access_cut_to_five_bytes_is_an_error_and_zero_extended_a_name_of_zeros() {
    let bytes = [0xFF, b'a', b'b', b'c', b'd'];
    let cut = DecodeError::ArrayCut { needed: 255, present: 4 };
    assert_eq!(AccessRequest::from_bytes(&bytes), Err(cut));
    let mut extended = [0; 515];
    extended[..5].copy_from_slice(&bytes);
    let request = AccessRequest::from_bytes(&extended).unwrap();
    assert_eq!((request.name.len(), request.value), (255, Value::EMPTY));
}

#[test]
fn register_value_types_have_their_tags_and_prefixes() {
    let hex = |value: &ValueBuf| bytes_of(&value.as_value());
    assert_eq!(bytes_of(&Value::EMPTY), [0]);
    assert_eq!(bytes_of(&Value::string("ab").unwrap()), [1, 2, 0, b'a', b'b']);
    assert_eq!(bytes_of(&Value::unstructured(&[7]).unwrap()), [2, 1, 0, 7]);
    let bits = ValueBuf::bits(&[true, false, true, true, false, false, false, false, true]).unwrap();
    assert_eq!(hex(&bits), [3, 9, 0, 0b1101, 1]);
    assert_eq!(hex(&ValueBuf::from(-2_i64)), [4, 1, 0xFE, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF]);
    assert_eq!(hex(&ValueBuf::from(-2_i32)), [5, 1, 0xFE, 0xFF, 0xFF, 0xFF]);
    assert_eq!(hex(&ValueBuf::from(-2_i16)), [6, 1, 0xFE, 0xFF]);
    assert_eq!(hex(&ValueBuf::from(-2_i8)), [7, 1, 0, 0xFE]);
    assert_eq!(hex(&ValueBuf::from(2_u64)), [8, 1, 2, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(hex(&ValueBuf::from(2_u32)), [9, 1, 2, 0, 0, 0]);
    assert_eq!(hex(&ValueBuf::from(2_u16)), [10, 1, 2, 0]);
    assert_eq!(hex(&ValueBuf::from(2_u8)), [11, 1, 0, 2]);
    assert_eq!(hex(&ValueBuf::from(1.0_f64)), [12, 1, 0, 0, 0, 0, 0, 0, 0xF0, 0x3F]);
    assert_eq!(hex(&ValueBuf::from(1.0_f32)), [13, 1, 0, 0, 0x80, 0x3F]);
    assert_eq!(Value::from_bytes(&[14, 2, 0x00, 0x3C, 0x00, 0xC0]).unwrap().f32(1), Some(-2.0));
    assert_eq!(Value::from_bytes(&[15]), Err(DecodeError::UnknownTag(15)));
}

#[test]
fn register_values_are_read_by_what_they_are() {
    let naturals = ValueBuf::try_from([1_u64, u64::MAX].as_slice()).unwrap();
    let value = naturals.as_value();
    assert_eq!((value.u64(0), value.u64(1), value.u64(2)), (Some(1), Some(u64::MAX), None));
    assert_eq!((value.i64(0), value.i64(1), value.f32(0), value.bool(0)), (Some(1), None, None, None));
    let integer = ValueBuf::from(-1_i16);
    assert_eq!((integer.as_value().i64(0), integer.as_value().u64(0)), (Some(-1), None));
    let real = ValueBuf::try_from([0.1_f64, -0.5].as_slice()).unwrap();
    assert_eq!((real.as_value().f64(0), real.as_value().f32(1)), (Some(0.1), Some(-0.5)));
    assert_eq!(real.as_value().to_string(), "0.1 -0.5");
    let bits = ValueBuf::bits(&[true, false]).unwrap();
    assert_eq!((bits.as_value().bool(1), bits.as_value().to_string()), (Some(false), "1 0".into()));
    assert_eq!(Value::unstructured(&[0xAB, 1]).unwrap().to_string(), "AB 01");
    assert_eq!(Value::EMPTY.to_string(), "(empty)");
}

#[test]
fn register_values_of_full_capacity_fit_and_longer_ones_are_refused_with_the_limit() {
    assert!(ValueBuf::try_from([0.0_f32; 64].as_slice()).is_ok());
    let refused = ValueBuf::try_from([0.0_f32; 65].as_slice()).unwrap_err();
    assert_eq!((refused.len, refused.capacity), (65, 64));
    assert!(ValueBuf::bits(&[true; 2048]).is_ok());
    assert!(ValueBuf::bits(&[true; 2049]).is_err());
    assert!(Value::unstructured(&[0; 257]).is_err());
    assert_eq!(bytes_of(&Value::unstructured(&[1; 256]).unwrap()).len(), Value::LEN_MAX);
}

#[test]
fn an_end_state_of_six_joints_takes_six_frames_and_its_bytes_are_the_documented_ones() {
    let joints = [TargetJoint { q_urad: -1_000_000, qd_rad_s: 1.5 }; 6];
    let state = TargetState::new(0x01_0203_0405_0607, 9, &joints, &[]);
    let bytes = bytes_of(&state);
    assert_eq!(bytes[..9], [7, 6, 5, 4, 3, 2, 1, 9, 6]);
    // -1 000 000 is 0xF0BDC0 in 24 bits; 1.5 is 0x3E00 in 16.
    assert_eq!(bytes[9..14], [0xC0, 0xBD, 0xF0, 0x00, 0x3E]);
    // Seven bytes per frame, two of them a checksum at the end.
    assert_eq!((bytes.len(), (bytes.len() + 2).div_ceil(7)), (40, 6));
    let event = TargetEvent { action: 1, offset_us: -20_000 };
    let with_event = TargetState::new(0, 0, &joints, &[event]);
    assert_eq!(bytes_of(&with_event)[39..], [1, 1, 0xE0, 0xB1, 0xFF]);
    assert_eq!(TargetState::from_bytes(&bytes_of(&with_event)).unwrap().events(), [event]);
}

#[test]
fn a_run_without_a_start_time_has_the_bytes_of_a_trajectory_name() {
    let name = Trajectory { trajectory_crc64: 7, length_bytes: 184 };
    let run = Run { trajectory_crc64: 7, length_bytes: 184, start_us: 0 };
    assert_eq!(Run::from_bytes(&bytes_of(&name)), Ok(run));
}

#[test]
fn command_answer_without_output_is_read_from_servers_of_older_versions() {
    let response = CommandResponse::from_bytes(&[5]).unwrap();
    assert_eq!(response, CommandResponse { status: Status::BAD_STATE, output: &[] });
}

#[test]
fn file_write_has_a_forty_bit_offset_and_two_prefixes() {
    let request = WriteRequest { offset: 0x01_0203_0405, path: b"t", data: &[9] };
    assert_eq!(bytes_of(&request), [5, 4, 3, 2, 1, 1, b't', 1, 0, 9]);
    assert_eq!(bytes_of(&WriteResponse { result: Err(FileError::OUT_OF_SPACE) }), [28, 0]);
    assert_eq!(WriteResponse::from_bytes(&[]).unwrap().result, Ok(()));
}

#[test]
fn stop_is_four_bytes_and_any_bytes_are_a_stop() {
    let stop = Stop { reason: Reason::OPERATOR, sender: Sender::CUBECTL, detail: 0x0102 };
    assert_eq!(bytes_of(&stop), [1, 1, 2, 1]);
    assert_eq!(Stop::from_bytes(&[]), Ok(Stop::default()));
    assert!(Stop::from_bytes(&[0xFF; 8]).is_ok());
}

#[test]
fn joint_state_of_two_joints_byte_by_byte() {
    let joint = JointSample {
        q_rad: 1.0,
        qd_rad_s: -2.0,
        error_q_rad: 0.5,
        error_qd_rad_s: 0.0,
        qdd_command_rad_s2: 10.0,
        current_a: f32::INFINITY,
        drive_state_byte: 0x10,
        flags: JointFlags::ACCELERATION_CLIPPED.with(JointFlags::HOMED),
    };
    let state = JointState::new(0x01_0203_0405_0607, 0x1234, &[joint, JointSample::default()]);
    let mut expected = vec![7, 6, 5, 4, 3, 2, 1, 0x34, 0x12, 2];
    expected.extend([0, 0, 0x80, 0x3F, 0x00, 0xC0, 0x00, 0x38, 0, 0, 0x00, 0x49, 0x00, 0x7C, 0x10, 0x11]);
    expected.extend([0; 16]);
    assert_eq!(bytes_of(&state), expected);
    assert_eq!(JointState::from_bytes(&expected), Ok(state));
}

#[test]
fn undefined_group_state_is_an_error_and_not_another_state() {
    let mut bytes = bytes_of(&GroupState { state: State::Jogging, ..GroupState::default() });
    assert!(GroupState::from_bytes(&bytes).is_ok());
    bytes[9] = 10;
    assert_eq!(GroupState::from_bytes(&bytes), Err(DecodeError::UnknownValue(10)));
}

#[test]
fn too_small_buffer_is_refused_with_the_size_that_is_needed() {
    let refused = Heartbeat::default().to_bytes(&mut [0; 6]);
    assert_eq!(refused, Err(BufferTooSmall { needed: 7, available: 6 }));
}

#[test]
fn port_list_answers_who_speaks_about_what() {
    // One publisher in the sparse form, all subjects heard, no client, server 430 in a mask.
    let mut bytes = vec![4, 0, 0, 0, 1, 1, 0x55, 0x1D];
    bytes.extend([1, 0, 0, 0, 2]);
    bytes.extend([0, 0, 0, 0]);
    bytes.extend([64, 0, 0, 0]);
    bytes.extend((0..64).map(|byte| if byte == 430 / 8 { 1 << (430 % 8) } else { 0 }));
    let list = PortList::from_bytes(&bytes).unwrap();
    let subject = |id| protocol::cyphal::id::SubjectId::new(id).unwrap();
    let service = |id| protocol::cyphal::id::ServiceId::new(id).unwrap();
    assert!(list.publishers.contains(subject(7509)) && !list.publishers.contains(subject(7510)));
    assert_eq!(list.subscribers, SubjectIds::Total);
    assert!(list.servers.contains(service(430)) && !list.servers.contains(service(431)));
    assert!(!list.clients.contains(service(430)));
}

// ---- there and back ------------------------------------------------------------------------------

fn value_buf() -> impl Strategy<Value = ValueBuf> {
    let all = proptest::collection::vec(any::<u8>(), 0..=256);
    (0_u8..=14, all).prop_map(|(tag, data)| {
        let kind = ValueType::from_tag(tag).unwrap();
        if kind == ValueType::Empty {
            return ValueBuf::EMPTY;
        }
        let bits = kind.element_bits();
        let count = data.len() * 8 / bits;
        let mut wire = vec![tag];
        wire.extend((count as u16).to_le_bytes().iter().take(if bits <= 8 { 2 } else { 1 }));
        wire.extend(&data[..count * bits / 8]);
        Value::from_bytes(&wire).unwrap().into()
    })
}

fn sample() -> impl Strategy<Value = JointSample> {
    // Halves are exact in f32, so the comparison can be exact.
    let half = || (-2048_i16..=2048, -10_i32..5).prop_map(|(m, e)| f32::from(m) * 2_f32.powi(e));
    (any::<f32>(), [half(), half(), half(), half(), half()], any::<u8>(), 0_u8..128).prop_map(
        |(q_rad, [qd_rad_s, error_q_rad, error_qd_rad_s, qdd_command_rad_s2, current_a], short, flags)| {
            let all = [
                JointFlags::ACCELERATION_CLIPPED,
                JointFlags::SPEED_LIMITED,
                JointFlags::POSITION_LIMITED,
                JointFlags::REPLY_MISSED,
                JointFlags::HOMED,
                JointFlags::DRIVE_ERROR,
                JointFlags::HALTED,
            ];
            let set = all.into_iter().enumerate().filter(|(bit, _)| flags >> bit & 1 != 0);
            JointSample {
                q_rad,
                qd_rad_s,
                error_q_rad,
                error_qd_rad_s,
                qdd_command_rad_s2,
                current_a,
                drive_state_byte: short,
                flags: set.fold(JointFlags::NONE, |sum, (_, flag)| sum.with(flag)),
            }
        },
    )
}

macro_rules! comes_back {
    ($type:ty, $value:expr) => {
        let bytes = bytes_of(&$value);
        prop_assert_eq!(<$type>::from_bytes(&bytes), Ok($value));
    };
}

proptest! {
    #[test]
    fn any_bytes_are_read_without_panic_and_what_is_read_is_written_stably(
        data in proptest::collection::vec(any::<u8>(), 0..600),
    ) {
        for (name, reread) in TYPES {
            if let Ok(once) = reread(&data) {
                let twice = reread(&once);
                prop_assert_eq!(twice, Ok(once), "{}", name);
            }
        }
    }

    #[test]
    fn register_access_comes_back(
        name in proptest::collection::vec(any::<u8>(), 0..=255),
        value in value_buf(), mutable: bool, persistent: bool, timestamp_us in 0_u64..1 << 56,
    ) {
        let request = AccessRequest { name: &name, value: value.as_value() };
        let bytes = bytes_of(&request);
        prop_assert_eq!(AccessRequest::from_bytes(&bytes), Ok(request));
        let response = AccessResponse { timestamp_us, mutable, persistent, value: value.as_value() };
        let bytes = bytes_of(&response);
        prop_assert_eq!(AccessResponse::from_bytes(&bytes), Ok(response));
        prop_assert_eq!(ValueBuf::from(value.as_value()), value);
    }

    #[test]
    fn files_and_commands_come_back(
        offset in 0_u64..1 << 40,
        path in proptest::collection::vec(any::<u8>(), 0..=255),
        data in proptest::collection::vec(any::<u8>(), 0..=256),
        code: u16,
    ) {
        let result = if code == 0 { Ok(()) } else { Err(FileError(code)) };
        let (read, write) = (ReadRequest { offset, path: &path }, WriteRequest { offset, path: &path, data: &data });
        comes_back!(ReadRequest, read);
        comes_back!(WriteRequest, write);
        let (read, write) = (ReadResponse { result, data: &data }, WriteResponse { result });
        comes_back!(ReadResponse, read);
        comes_back!(WriteResponse, write);
        let command = CommandRequest { command: code, parameter: &path };
        comes_back!(CommandRequest, command);
        let text = Record { timestamp_us: offset, severity: Severity::Alert, text: &path };
        comes_back!(Record, text);
    }

    #[test]
    fn joint_states_come_back(
        uptime_us in 0_u64..1 << 56, cycle: u16, joints in proptest::collection::vec(sample(), 0..=8),
    ) {
        let state = JointState::new(uptime_us, cycle, &joints);
        prop_assert_eq!(state.joints(), &joints[..]);
        let bytes = bytes_of(&state);
        prop_assert_eq!(bytes.len(), 10 + 16 * joints.len());
        prop_assert_eq!(JointState::from_bytes(&bytes), Ok(state));
    }

    #[test]
    fn numbers_of_any_width_come_back_from_registers(
        reals in proptest::collection::vec(any::<f32>(), 0..=64),
        wide in proptest::collection::vec(any::<i64>(), 0..=32),
    ) {
        let value = ValueBuf::try_from(&reals[..]).unwrap();
        for (i, real) in reals.iter().enumerate() {
            prop_assert_eq!(value.as_value().f32(i).map(f32::to_bits), Some(real.to_bits()));
        }
        let value = ValueBuf::try_from(&wide[..]).unwrap();
        for (i, number) in wide.iter().enumerate() {
            prop_assert_eq!(value.as_value().i64(i), Some(*number));
        }
        prop_assert_eq!(value.as_value().len(), wide.len());
    }
}
