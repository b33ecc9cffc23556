//! Authority over the wire: two nodes at one controller, lost answers, restarts, and codes as any client makes them.

use crate::bench::host::Host;
use crate::bench::*;
use firmware::authority::{Key, Peer, code_of};
use firmware::fault::Cause;
use firmware::state::StateKind;
use protocol::cyphal::bits::{Decode, Encode, to_bytes};
use protocol::cyphal::cubecell::authorization::{Content, KEY_REGISTER, KEYED_REGISTER};
use protocol::cyphal::cubecell::command::{
    self, ArmConfirm, ArmOffer, ArmPrepare, Authorization, Challenge, Refusal, Trajectory, Unlock,
};
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::register::{self, AccessRequest, AccessResponse};
use protocol::cyphal::uavcan::value::{Value, ValueBuf};
use sha2::{Digest as _, Sha256};

const FIRST: NodeId = NodeId::from_low_bits(42);
const SECOND: NodeId = NodeId::from_low_bits(43);
const KEY: [u8; 32] = [0x5A; 32];

/// Ready with the throw committed by the first node.
fn committed() -> (Host, Trajectory) {
    let mut host = Host::new();
    host.run(800_000, |_, _| {});
    let bytes = throw_file(3_000, false);
    host.upload(&bytes);
    let name = Trajectory {
        trajectory_crc64: protocol::cyphal::crc::Crc64::of(&bytes),
        length_bytes: bytes.len() as u32,
    };
    assert_eq!(host.command(command::COMMIT_TRAJECTORY, &name).0, Status::SUCCESS);
    (host, name)
}

fn offer(host: &mut Host, name: &Trajectory) -> ArmConfirm {
    let prepare = ArmPrepare { trajectory_crc64: name.trajectory_crc64, valid_ms: 5_000 };
    let (status, output) = host.command(command::ARM_PREPARE, &prepare);
    assert_eq!(status, Status::SUCCESS);
    ArmConfirm { token: ArmOffer::from_bytes(&output).unwrap().token, valid_ms: 5_000 }
}

fn refused((status, output): &(Status, Vec<u8>)) -> Cause {
    assert_ne!(*status, Status::SUCCESS);
    Cause::from_code(Refusal::from_bytes(output).unwrap().cause).unwrap()
}

/// Value of the register after the access, and its number of bytes.
fn access(host: &mut Host, name: &str, value: Value<'_>) -> (Option<bool>, Option<f32>, usize) {
    let answer = host.ask(register::ACCESS, &AccessRequest { name: name.as_bytes(), value });
    let value = AccessResponse::from_bytes(&answer).unwrap().value;
    (value.bool(0), value.f32(0), value.bytes().len())
}

#[test]
fn two_nodes_race_for_the_arm_and_exactly_the_first_one_gets_it() {
    let (mut host, name) = committed();
    let confirm = offer(&mut host, &name);
    host.address = SECOND;
    let answer = host.command(command::ARM_CONFIRM, &confirm);
    assert_eq!(answer.0, Status::NOT_AUTHORIZED);
    assert_eq!(refused(&answer), Cause::OtherHost);
    let prepare = ArmPrepare { trajectory_crc64: name.trajectory_crc64, valid_ms: 5_000 };
    assert_eq!(refused(&host.command(command::ARM_PREPARE, &prepare)), Cause::OtherHost);
    let slower = ValueBuf::try_from(&[1.0f32; 6][..]).unwrap();
    let (_, kept, _) = access(&mut host, "joint.v_max_rad_s", slower.as_value());
    assert!(kept.unwrap() > 2.0);
    host.address = FIRST;
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
    assert_eq!(host.bench.kind(), StateKind::Armed);
    // The second node may disarm the arm, and then the first one may begin again.
    host.address = SECOND;
    assert_eq!(host.command(command::DISARM, &command::ClearFault::default()).0, Status::SUCCESS);
    assert_eq!(host.bench.kind(), StateKind::Ready);
    host.address = FIRST;
    let confirm = offer(&mut host, &name);
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
}

#[test]
fn orders_whose_answers_were_lost_come_again_and_do_no_harm() {
    let (mut host, name) = committed();
    for _ in 0..3 {
        assert_eq!(host.command(command::COMMIT_TRAJECTORY, &name).0, Status::SUCCESS);
    }
    let voided = offer(&mut host, &name);
    let confirm = offer(&mut host, &name);
    assert_eq!(refused(&host.command(command::ARM_CONFIRM, &voided)), Cause::TokenWrong);
    for _ in 0..3 {
        assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
    }
    for _ in 0..3 {
        assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    }
    host.run(1_700_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert!(host.bench.distance_from_path() < 1e-3);
}

#[test]
fn a_host_that_starts_anew_under_the_same_number_does_not_inherit_the_motion() {
    let (mut host, name) = committed();
    let confirm = offer(&mut host, &name);
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
    host.run(60_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Armed);
    // No heartbeat is missing.
    host.uptime_s = 0;
    host.run(60_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    host.uptime_s = 9;
    let confirm = offer(&mut host, &name);
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(200_000, |_, _| {});
    host.uptime_s = 0;
    host.run(60_000, |_, _| {});
    let fault = host.bench.controller.core().state().fault().unwrap();
    assert_eq!(fault.cause, Cause::HostLost);
}

#[test]
fn an_unlock_shows_in_the_group_state_and_ends() {
    let (mut host, _) = committed();
    let robot_crc32 = host.bench.controller.core().settings().limits_robot_crc32;
    assert!(!host.group.unwrap().limits_unlocked);
    let unlock = |valid_s| Unlock { robot_crc32, valid_s };
    assert_eq!(host.command(command::UNLOCK, &unlock(1)).0, Status::SUCCESS);
    host.run(20_000, |_, _| {});
    assert!(host.group.unwrap().limits_unlocked);
    let wide = ValueBuf::try_from(&[9.0f32; 6][..]).unwrap();
    assert_eq!(access(&mut host, "joint.v_max_rad_s", wide.as_value()).1, Some(9.0));
    host.run(1_100_000, |_, _| {});
    assert!(!host.group.unwrap().limits_unlocked);
    assert!(access(&mut host, "joint.v_max_rad_s", Value::EMPTY).1.unwrap() < 3.0);
    assert_eq!(
        refused(&host.command(command::UNLOCK, &Unlock { robot_crc32: 1, valid_s: 1 })),
        Cause::WrongRobot
    );
}

fn content(number: u16, parameter: &dyn Encode) -> Content {
    let mut bytes = [0; 64];
    let len = to_bytes(parameter, &mut bytes).unwrap();
    Content::of_command(number, &bytes[..len]).unwrap()
}

/// Content of a confirmation that covers the present file and settings of the controller.
fn covered(host: &Host, confirm: &ArmConfirm) -> Content {
    let file: [u8; 32] = Sha256::digest(throw_file(3_000, false)).into();
    let digest = firmware::registers::run_digest(&file, host.bench.controller.core().settings());
    content(command::ARM_CONFIRM, confirm).about(&digest).unwrap()
}

fn authorize(host: &mut Host, content: &Content) -> Authorization {
    let (status, output) = host.command(command::CHALLENGE, &command::ClearFault::default());
    assert_eq!(status, Status::SUCCESS);
    let Challenge { nonce, valid_ms } = Challenge::from_bytes(&output).unwrap();
    assert_eq!(valid_ms, 5_000);
    let code = code_of(&Key::new(KEY), &nonce, Peer::new(host.address.get()), content.as_slice());
    let authorization = Authorization { nonce, code };
    assert_eq!(host.command(command::AUTHORIZE, &authorization).0, Status::SUCCESS);
    authorization
}

#[test]
fn a_key_set_over_the_wire_is_never_read_back_and_locks_strangers_out() {
    let (mut host, name) = committed();
    assert_eq!(access(&mut host, KEYED_REGISTER, Value::EMPTY).0, Some(false));
    let set = Value::unstructured(&KEY).unwrap();
    assert_eq!(access(&mut host, KEY_REGISTER, set).2, 0, "the answer does not hold the key");
    assert_eq!(access(&mut host, KEYED_REGISTER, Value::EMPTY).0, Some(true));
    assert_eq!(access(&mut host, KEY_REGISTER, Value::EMPTY).2, 0);
    host.run(150_000, |_, _| {});
    assert!(host.group.unwrap().keyed);

    // Another node without the key: first with its own number, then with the number of the host.
    let other_key = Value::unstructured(&[1; 32]).unwrap();
    for address in [SECOND, FIRST] {
        host.address = address;
        let confirm = offer(&mut host, &name);
        assert_eq!(refused(&host.command(command::ARM_CONFIRM, &confirm)), Cause::CodeMissing);
        assert_eq!(
            refused(&host.command(command::HOME, &command::Home { joint_mask: 1 })),
            Cause::CodeMissing
        );
        for key in [other_key, Value::unstructured(&[]).unwrap()] {
            access(&mut host, KEY_REGISTER, key);
            assert_eq!(access(&mut host, KEYED_REGISTER, Value::EMPTY).0, Some(true));
        }
        let slower = ValueBuf::try_from(&[1.0f32; 6][..]).unwrap();
        assert!(access(&mut host, "joint.v_max_rad_s", slower.as_value()).1.unwrap() > 2.0);
        assert_eq!(host.command(command::DISARM, &command::ClearFault::default()).0, Status::SUCCESS);
    }

    // The owner; and another node that repeats under its own number what it overheard, before and after.
    let confirm = offer(&mut host, &name);
    let about = covered(&host, &confirm);
    let heard = authorize(&mut host, &about);
    let longer = ArmConfirm { valid_ms: 30_000, ..confirm };
    assert_eq!(refused(&host.command(command::ARM_CONFIRM, &longer)), Cause::CodeWrong, "another content");
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert_eq!(refused(&host.command(command::AUTHORIZE, &heard)), Cause::CodeWrong, "used up");
    authorize(&mut host, &about);
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
    assert_eq!(host.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS, "its answer was lost");
    assert_eq!(host.bench.kind(), StateKind::Armed);
    assert_eq!(refused(&host.command(command::RUN, &name)), Cause::CodeMissing);
    authorize(&mut host, &content(command::RUN, &name));
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(1_700_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert_eq!(host.command(command::RUN, &name).0, Status::BAD_STATE, "after the run");
}

#[test]
fn a_register_write_with_its_code_is_taken_and_the_same_code_takes_no_other_value() {
    let (mut host, _) = committed();
    access(&mut host, KEY_REGISTER, Value::unstructured(&KEY).unwrap());
    let name = "joint.v_max_rad_s";
    let [one, two] = [1.0f32, 1.5].map(|x| ValueBuf::try_from(&[x; 6][..]).unwrap());
    let content = Content::of_register(name.as_bytes(), &one.as_value()).unwrap();
    authorize(&mut host, &content);
    assert!(access(&mut host, name, two.as_value()).1.unwrap() > 2.0, "another value");
    authorize(&mut host, &content);
    assert_eq!(access(&mut host, name, one.as_value()).1, Some(1.0));
    assert_eq!(access(&mut host, name, two.as_value()).1, Some(1.0), "a code is for one write");
}

/// HMAC-SHA-256 by Python's standard library: `hmac.new(key, context + nonce + node + content, "sha256")`.
#[test]
fn a_code_is_what_any_other_client_computes() {
    let content = Content::of_command(command::ARM_CONFIRM, &[1, 2, 3, 4, 0x88, 0x13]).unwrap();
    let code = code_of(&Key::new(KEY), &[7; 8], Peer::new(42), content.as_slice());
    assert_eq!(code, CODE_OF_PYTHON);
}

const CODE_OF_PYTHON: [u8; 16] =
    [0xfc, 0x94, 0x4c, 0x78, 0x3d, 0x54, 0x23, 0x5a, 0xf7, 0xd7, 0xb6, 0xd2, 0xff, 0x91, 0x3c, 0xf9];
