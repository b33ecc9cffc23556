//! Literal frames of the M5 protocol with their meaning, both directions.
//!
//! The bytes are those of the protocol reference (section 2, 3 and 4 tables and its trace for module
//! 5) or worked out by hand from the layouts given there.

use crate::common::frame;
use protocol::ModuleId;
use protocol::powercube::broadcast::{Broadcast, BroadcastError, BroadcastFrame};
use protocol::powercube::request::AddressedRequest;
use protocol::powercube::{
    BaudRate, Channel, CubeState, Dio, MotionCommand, MotionKind, MotionPosition, MotionRequest, Parameter,
    PosStateDio, Reply, ReplyError, Request, RequestError, ShortState, SimpleCommand, Value,
};
use protocol::units::{Amperes, RadPerSec, Radians};

fn cube(id: u8) -> ModuleId {
    ModuleId::new(id).unwrap()
}

#[track_caller]
fn is_request(text: &str, module: u8, request: Request) {
    let bytes = frame(text);
    assert_eq!(request.encode(cube(module)), bytes, "encode {request:?}");
    let decoded = AddressedRequest::decode(&bytes).unwrap();
    assert_eq!(decoded, AddressedRequest { module: cube(module), channel: request.channel(), request });
}

#[track_caller]
fn is_reply(text: &str, module: u8, reply: Reply) {
    let bytes = frame(text);
    assert_eq!(reply.encode(cube(module)), bytes, "encode {reply:?}");
    assert_eq!(Reply::decode(&bytes), Ok((cube(module), reply)));
}

#[test]
fn ramp_extended_trace_of_the_reference() {
    // moveRampExtended(1.0 rad, 0.25 rad/s, 0.5 rad/s²) to module 5, and the module's answer.
    is_request("0E5#084F0000803E", 5, Request::Set(Parameter::TargetVel, Value::F32(0.25)));
    is_reply("0A5#084F64", 5, Reply::SetAck { parameter: Parameter::TargetVel, code: Some(0x64) });
    is_request("0E5#08500000003F", 5, Request::Set(Parameter::TargetAcc, Value::F32(0.5)));
    is_reply("0A5#085064", 5, Reply::SetAck { parameter: Parameter::TargetAcc, code: Some(0x64) });
    let ramp = MotionCommand::Ramp { target: Radians::new(1.0) };
    is_request("0E5#0B0E0000803F", 5, Request::Move(MotionRequest::extended(ramp)));
    // At -0.5 rad, moving, input 1 high, output 2 high.
    is_reply(
        "0A5#0B0E000000BF1042",
        5,
        Reply::MotionExtended {
            kind: MotionKind::Ramp,
            position: MotionPosition::Radians(Radians::new(-0.5)),
            short_state: ShortState::MOTION,
            dio: Dio::new(0b0010, 0b0100),
        },
    );
}

#[test]
fn one_byte_commands_and_their_answers() {
    for (request, reply, command) in [
        ("0E5#00", "0A5#00", SimpleCommand::Reset),
        ("0E5#01", "0A5#01", SimpleCommand::Home),
        ("0E5#02", "0A5#02", SimpleCommand::Halt),
        ("0E5#03", "0A5#03", SimpleCommand::ToggleHome),
        ("0E5#07", "0A5#07", SimpleCommand::Watchdog),
        ("0E5#09", "0A5#09", SimpleCommand::Recalc),
        ("0E5#10", "0A5#10", SimpleCommand::SaveParameters),
        ("0E5#12", "0A5#12", SimpleCommand::ResetClock),
    ] {
        is_request(request, 5, Request::Simple(command));
        is_reply(reply, 5, Reply::Simple(command));
    }
}

#[test]
fn internal_command_carries_seven_bytes() {
    is_request("0FF#0401020304050607", 31, Request::Internal([1, 2, 3, 4, 5, 6, 7]));
    is_reply("0BF#0407060504030201", 31, Reply::Internal([7, 6, 5, 4, 3, 2, 1]));
}

#[test]
fn step_in_ticks_has_a_command_byte_of_its_own() {
    // -1000 ticks in 50 ms.
    is_request("0E1#0D18FCFFFF3200", 1, Request::SetStepInc { target_ticks: -1000, time_ms: 50 });
    is_reply("0A1#0D", 1, Reply::SetStepInc);
    // The answer's length is not known: more bytes are an answer too.
    assert_eq!(Reply::decode(&frame("0A1#0D64")), Ok((cube(1), Reply::SetStepInc)));
}

#[test]
fn parameters_of_every_type() {
    // float: actual position 1 rad.
    is_request("0C5#0A3C", 5, Request::Get(Parameter::ActPos));
    is_reply("0A5#0A3C0000803F", 5, Reply::Value(Parameter::ActPos, Value::F32(1.0)));
    // int32: -2 ticks.
    is_request("0C5#0A5A", 5, Request::Get(Parameter::PosInc));
    is_reply("0A5#0A5AFEFFFFFF", 5, Reply::Value(Parameter::PosInc, Value::I32(-2)));
    // uint32: state word with HOME_OK and RAMP_END; serial number.
    let state = (CubeState::HOME_OK | CubeState::RAMP_END).bits();
    is_request("0C5#0A27", 5, Request::Get(Parameter::CubeState));
    is_reply("0A5#0A2702800000", 5, Reply::Value(Parameter::CubeState, Value::U32(state)));
    is_request("0C5#0A1A", 5, Request::Get(Parameter::DefSerialNo));
    is_reply("0A5#0A1A15CD5B07", 5, Reply::Value(Parameter::DefSerialNo, Value::U32(123_456_789)));
    // uint16: firmware 4.6.14.
    is_request("0C5#0A1D", 5, Request::Get(Parameter::DefVersion));
    is_reply("0A5#0A1D1446", 5, Reply::Value(Parameter::DefVersion, Value::U16(0x4614)));
    // int16: loop gain 32.
    is_request("0E5#08542000", 5, Request::Set(Parameter::ActC0, Value::I16(32)));
    is_reply("0A5#0A542000", 5, Reply::Value(Parameter::ActC0, Value::I16(32)));
    // uint8: bit rate code 3.
    is_request("0E5#082203", 5, Request::Set(Parameter::DefCanBaud, Value::U8(3)));
    is_reply("0A5#0A2203", 5, Reply::Value(Parameter::DefCanBaud, Value::U8(3)));
    // Position, short state and lines in one answer: 0.25 rad, not OK, outputs 0 and 3.
    is_request("0C5#0A62", 5, Request::Get(Parameter::PosStateDio));
    let composite =
        PosStateDio { position_rad: 0.25, short_state: ShortState::NOT_OK, dio: Dio::new(0, 0b1001) };
    is_reply("0A5#0A620000803E0190", 5, Reply::Value(Parameter::PosStateDio, Value::PosStateDio(composite)));
}

#[test]
fn motions_simple_and_with_answer() {
    let ramp = MotionCommand::Ramp { target: Radians::new(1.0) };
    let step = MotionCommand::Step { target: Radians::new(0.125), time_ms: 50 };
    let velocity = MotionCommand::Velocity(RadPerSec::new(0.25));
    let current = MotionCommand::Current(Amperes::new(-1.5));
    let ramp_inc = MotionCommand::RampInc { target_ticks: -1000 };
    let step_inc = MotionCommand::StepInc { target_ticks: -1000, time_ms: 50 };
    let velocity_inc = MotionCommand::VelocityInc { ticks_per_s: 500 };
    let current_inc = MotionCommand::CurrentInc { digits: -500 };
    let current_wide = MotionCommand::CurrentIncWide { digits: -500 };
    for (simple, extended, command) in [
        ("0E5#0B040000803F", "0E5#0B0E0000803F", ramp),
        ("0E5#0B060000003E3200", "0E5#0B100000003E3200", step),
        ("0E5#0B070000803E", "0E5#0B110000803E", velocity),
        ("0E5#0B080000C0BF", "0E5#0B120000C0BF", current),
        ("0E5#0B0918FCFFFF", "0E5#0B1318FCFFFF", ramp_inc),
        ("0E5#0B0B18FCFFFF3200", "0E5#0B1518FCFFFF3200", step_inc),
        ("0E5#0B0CF4010000", "0E5#0B16F4010000", velocity_inc),
        ("0E5#0B0D0CFE", "0E5#0B170CFE", current_inc),
        ("0E5#0B0D0CFEFFFF", "0E5#0B170CFEFFFF", current_wide),
    ] {
        is_request(simple, 5, Request::Move(MotionRequest::simple(command)));
        is_request(extended, 5, Request::Move(MotionRequest::extended(command)));
    }
    let cosine = MotionCommand::CosLoop { position: Radians::new(0.125), period_ms: 1000 };
    is_request("0E5#0B180000003EE803", 5, Request::Move(MotionRequest::simple(cosine)));
    let zigzag = MotionCommand::RampLoop { position: Radians::new(0.125), period_ms: 1000 };
    is_request("0E5#0B190000003EE803", 5, Request::Move(MotionRequest::simple(zigzag)));
}

#[test]
fn motion_answers_repeat_the_motion_in_its_unit() {
    is_reply("0A5#0B0464", 5, Reply::MotionAck { kind: MotionKind::Ramp, code: 0x64 });
    is_reply("0A5#0B1864", 5, Reply::MotionAck { kind: MotionKind::CosLoop, code: 0x64 });
    is_reply(
        "0A5#0B13E80300002000",
        5,
        Reply::MotionExtended {
            kind: MotionKind::RampInc,
            position: MotionPosition::Ticks(1000),
            short_state: ShortState::RAMP_END,
            dio: Dio::default(),
        },
    );
}

#[test]
fn increments_of_a_ramp_are_set_one_by_one() {
    // moveRampInc(-1000, 500, 250).
    is_request("0E5#0829F4010000", 5, Request::Set(Parameter::TargetVelInc, Value::I32(500)));
    is_request("0E5#082AFA000000", 5, Request::Set(Parameter::TargetAccInc, Value::I32(250)));
}

#[test]
fn broadcasts_with_and_without_the_manufacturers_padding() {
    for (bare, padded, broadcast) in [
        ("100#00", "100#0000", Broadcast::Reset),
        ("100#01", "100#0100", Broadcast::Home),
        ("100#02", "100#0200", Broadcast::Halt),
        ("100#07", "100#0700", Broadcast::Watchdog),
        ("100#0E", "100#0E00", Broadcast::SavePosition),
        ("100#0F", "100#0F00", Broadcast::StartMotion),
    ] {
        assert_eq!(broadcast.encode(), frame(bare));
        assert_eq!(Broadcast::decode(&frame(bare)), Ok(broadcast));
        let kept = BroadcastFrame::decode(&frame(padded)).unwrap();
        assert_eq!(kept, BroadcastFrame { broadcast, padded: true });
        assert_eq!(kept.encode(), frame(padded));
    }
    assert_eq!(Broadcast::Baud(BaudRate::Kbit1000).encode(), frame("100#0903"));
    assert_eq!(Broadcast::decode(&frame("100#0901")), Ok(Broadcast::Baud(BaudRate::Kbit250)));
}

#[test]
fn state_frame_is_the_bare_state_word() {
    is_reply("065#06000000", 5, Reply::State(CubeState::HOME_OK | CubeState::HALTED));
}

#[test]
fn polling_on_the_put_id_is_understood_and_kept_apart() {
    // One host asks for the default address on the PUT id.
    let decoded = AddressedRequest::decode(&frame("0E5#0A20")).unwrap();
    assert_eq!(decoded.request, Request::Get(Parameter::DefAddress));
    assert_eq!(decoded.channel, Channel::Put);
    assert_eq!(decoded.encode(), frame("0E5#0A20"));
}

#[test]
fn set_answers_of_other_lengths_are_tolerated() {
    let short = Reply::decode(&frame("0A5#084F")).unwrap().1;
    assert_eq!(short, Reply::SetAck { parameter: Parameter::TargetVel, code: None });
    assert!(short.is_accepted());
    let long = Reply::decode(&frame("0A5#084F640000003E")).unwrap().1;
    assert_eq!(long, Reply::SetAck { parameter: Parameter::TargetVel, code: Some(0x64) });
    let refused = Reply::decode(&frame("0A5#084F00")).unwrap().1;
    assert!(!refused.is_accepted());
}

#[test]
fn a_reply_answers_only_its_own_request() {
    let velocity = Request::Set(Parameter::TargetVel, Value::F32(0.25));
    let acceleration = Request::Set(Parameter::TargetAcc, Value::F32(0.5));
    let ack = Reply::decode(&frame("0A5#085064")).unwrap().1;
    assert!(ack.answers(&acceleration));
    assert!(!ack.answers(&velocity));
    let ramp = MotionCommand::Ramp { target: Radians::new(1.0) };
    let extended = Reply::decode(&frame("0A5#0B0E000000BF1042")).unwrap().1;
    assert!(extended.answers(&Request::Move(MotionRequest::extended(ramp))));
    assert!(!extended.answers(&Request::Move(MotionRequest::simple(ramp))));
    assert!(!extended.answers(&Request::Get(Parameter::ActPos)));
    // A state word without a request is not an answer.
    assert!(!Reply::State(CubeState::EMPTY).answers(&Request::Get(Parameter::CubeState)));
}

#[test]
fn bad_requests_say_what_was_wrong() {
    let error = |text: &str| AddressedRequest::decode(&frame(text)).unwrap_err();
    assert!(matches!(error("0A5#00"), RequestError::NotARequest(_)));
    assert!(matches!(error("0E0#00"), RequestError::NotARequest(_)));
    assert_eq!(error("0E5#"), RequestError::Empty);
    assert_eq!(error("0E5#0C"), RequestError::UnknownCommand(0x0C));
    assert_eq!(error("0E5#0F"), RequestError::UnknownCommand(0x0F));
    assert_eq!(error("0C5#0A89"), RequestError::UnknownParameter(0x89));
    assert_eq!(error("0E5#0B0F00000000"), RequestError::UnknownMotion(0x0F));
    assert!(matches!(error("0E5#084F000080"), RequestError::Length { len: 5, .. }));
    assert!(matches!(error("0E5#0B0E0000803F00"), RequestError::Length { len: 7, .. }));
    assert!(matches!(error("0E5#0000"), RequestError::Length { len: 2, .. }));
}

#[test]
fn bad_replies_and_broadcasts_say_what_was_wrong() {
    let error = |text: &str| Reply::decode(&frame(text)).unwrap_err();
    assert!(matches!(error("0C5#0A3C"), ReplyError::NotAReply(_)));
    assert_eq!(error("0A5#"), ReplyError::Empty);
    assert_eq!(error("0A5#FF"), ReplyError::UnknownCommand(0xFF));
    assert!(matches!(error("0A5#0A3C0000"), ReplyError::Length { len: 4, .. }));
    assert!(matches!(error("065#000000"), ReplyError::Length { command: None, len: 3 }));
    let broadcast = |text: &str| Broadcast::decode(&frame(text)).unwrap_err();
    assert!(matches!(broadcast("101#00"), BroadcastError::NotBroadcast(_)));
    assert_eq!(broadcast("100#0904"), BroadcastError::UnknownBaudCode(4));
    assert_eq!(broadcast("100#09"), BroadcastError::Length { code: 9, len: 1 });
    assert_eq!(broadcast("100#0201"), BroadcastError::Length { code: 2, len: 2 });
    assert_eq!(broadcast("100#0A3C"), BroadcastError::UnknownCommand(0x0A));
}
