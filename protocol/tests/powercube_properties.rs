//! Properties of all messages of the M5 protocol, not only of the vectors.

use proptest::prelude::*;
use protocol::powercube::broadcast::BroadcastFrame;
use protocol::powercube::request::AddressedRequest;
use protocol::powercube::{
    BaudRate, Broadcast, Channel, CubeState, Dio, MotionAck, MotionCommand, MotionKind, MotionPosition,
    MotionRequest, Parameter, PosStateDio, Reply, Request, ShortState, SimpleCommand, Value, ValueKind,
};
use protocol::units::{Amperes, RadPerSec, Radians};
use protocol::{ExtendedId, Frame, Id, ModuleId, StandardId};

/// Finite floats of every size; NaN compares unequal and is covered on the level of bytes.
fn float() -> impl Strategy<Value = f32> {
    prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL | prop::num::f32::INFINITE
}

fn module() -> impl Strategy<Value = ModuleId> {
    (1u8..=31).prop_map(|id| ModuleId::new(id).unwrap())
}

fn value(kind: ValueKind) -> BoxedStrategy<Value> {
    match kind {
        ValueKind::F32 => float().prop_map(Value::F32).boxed(),
        ValueKind::I32 => any::<i32>().prop_map(Value::I32).boxed(),
        ValueKind::U32 => any::<u32>().prop_map(Value::U32).boxed(),
        ValueKind::I16 => any::<i16>().prop_map(Value::I16).boxed(),
        ValueKind::U16 => any::<u16>().prop_map(Value::U16).boxed(),
        ValueKind::U8 => any::<u8>().prop_map(Value::U8).boxed(),
        ValueKind::PosStateDio => (float(), any::<u8>(), any::<u8>())
            .prop_map(|(position_rad, short, dio)| {
                let short_state = ShortState::from_bits(short);
                Value::PosStateDio(PosStateDio { position_rad, short_state, dio: Dio(dio) })
            })
            .boxed(),
    }
}

fn parameter() -> impl Strategy<Value = Parameter> {
    (0..Parameter::TABLE.len()).prop_map(|row| Parameter::TABLE[row].parameter)
}

fn parameter_and_value() -> impl Strategy<Value = (Parameter, Value)> {
    parameter().prop_flat_map(|parameter| (Just(parameter), value(parameter.kind())))
}

fn simple() -> impl Strategy<Value = SimpleCommand> {
    (0..SimpleCommand::ALL.len()).prop_map(|at| SimpleCommand::ALL[at])
}

fn motion() -> impl Strategy<Value = MotionRequest> {
    let rad = || float().prop_map(Radians::new);
    let command = prop_oneof![
        rad().prop_map(|target| MotionCommand::Ramp { target }),
        (rad(), any::<u16>()).prop_map(|(target, time_ms)| MotionCommand::Step { target, time_ms }),
        float().prop_map(|v| MotionCommand::Velocity(RadPerSec::new(v))),
        float().prop_map(|v| MotionCommand::Current(Amperes::new(v))),
        any::<i32>().prop_map(|target_ticks| MotionCommand::RampInc { target_ticks }),
        (any::<i32>(), any::<u16>())
            .prop_map(|(target_ticks, time_ms)| MotionCommand::StepInc { target_ticks, time_ms }),
        any::<i32>().prop_map(|ticks_per_s| MotionCommand::VelocityInc { ticks_per_s }),
        any::<i16>().prop_map(|digits| MotionCommand::CurrentInc { digits }),
        any::<i32>().prop_map(|digits| MotionCommand::CurrentIncWide { digits }),
        (rad(), any::<u16>())
            .prop_map(|(position, period_ms)| MotionCommand::CosLoop { position, period_ms }),
        (rad(), any::<u16>())
            .prop_map(|(position, period_ms)| MotionCommand::RampLoop { position, period_ms }),
    ];
    (command, any::<bool>()).prop_map(|(command, extended)| {
        if extended { MotionRequest::extended(command) } else { MotionRequest::simple(command) }
    })
}

fn request() -> impl Strategy<Value = Request> {
    prop_oneof![
        simple().prop_map(Request::Simple),
        any::<[u8; 7]>().prop_map(Request::Internal),
        parameter().prop_map(Request::Get),
        parameter_and_value().prop_map(|(parameter, value)| Request::set(parameter, value).unwrap()),
        motion().prop_map(Request::Move),
        (any::<i32>(), any::<u16>())
            .prop_map(|(target_ticks, time_ms)| Request::SetStepInc { target_ticks, time_ms }),
    ]
}

fn reply() -> impl Strategy<Value = Reply> {
    let kind = || (0..MotionKind::ALL.len()).prop_map(|at| MotionKind::ALL[at]);
    let extended = (kind(), float(), any::<i32>(), any::<u8>(), any::<u8>()).prop_filter_map(
        "loops have no extended answer",
        |(kind, position_rad, ticks, short, dio)| {
            kind.code(MotionAck::Extended)?;
            let position = if kind.in_ticks() {
                MotionPosition::Ticks(ticks)
            } else {
                MotionPosition::Radians(Radians::new(position_rad))
            };
            let short_state = ShortState::from_bits(short);
            Some(Reply::MotionExtended { kind, position, short_state, dio: Dio(dio) })
        },
    );
    prop_oneof![
        simple().prop_map(Reply::Simple),
        any::<[u8; 7]>().prop_map(Reply::Internal),
        parameter_and_value().prop_map(|(parameter, value)| Reply::Value(parameter, value)),
        (parameter(), any::<Option<u8>>()).prop_map(|(parameter, code)| Reply::SetAck { parameter, code }),
        (kind(), any::<u8>()).prop_map(|(kind, code)| Reply::MotionAck { kind, code }),
        extended,
        Just(Reply::SetStepInc),
        any::<u32>().prop_map(|bits| Reply::State(CubeState::from_bits(bits))),
    ]
}

fn broadcast() -> impl Strategy<Value = BroadcastFrame> {
    let orders = prop_oneof![
        Just(Broadcast::Reset),
        Just(Broadcast::Home),
        Just(Broadcast::Halt),
        Just(Broadcast::Watchdog),
        Just(Broadcast::SavePosition),
        Just(Broadcast::StartMotion),
    ];
    prop_oneof![
        (orders, any::<bool>()).prop_map(|(broadcast, padded)| BroadcastFrame { broadcast, padded }),
        (0u8..4).prop_map(|code| BroadcastFrame {
            broadcast: Broadcast::Baud(BaudRate::from_code(code).unwrap()),
            padded: false,
        }),
    ]
}

fn any_frame() -> impl Strategy<Value = Frame> {
    (any::<u32>(), any::<bool>(), any::<bool>(), prop::collection::vec(any::<u8>(), 0..=8)).prop_map(
        |(raw, extended, remote, data)| {
            let id: Id = if extended {
                ExtendedId::from_low_bits(raw).into()
            } else {
                StandardId::from_low_bits(raw as u16).into()
            };
            if remote { Frame::remote(id, data.len()) } else { Frame::new(id, &data) }.unwrap()
        },
    )
}

/// Frames that look like the protocol: right ids, real command bytes, any rest.
fn likely_frame() -> impl Strategy<Value = Frame> {
    let id = prop_oneof![Just(0x060u16), Just(0x0A0), Just(0x0C0), Just(0x0E0)];
    let id = prop_oneof![(id, 0u16..32).prop_map(|(base, module)| base + module), Just(0x100)];
    (id, 0u8..0x14, prop::collection::vec(any::<u8>(), 0..=7)).prop_map(|(id, command, rest)| {
        let data = [vec![command], rest].concat();
        Frame::new(StandardId::from_low_bits(id), &data).unwrap()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn a_request_comes_back_as_it_was_sent(module in module(), request in request(), put: bool) {
        let channel = if put { Channel::Put } else { Channel::Get };
        let sent = AddressedRequest { module, channel, request };
        prop_assert_eq!(AddressedRequest::decode(&sent.encode()), Ok(sent));
    }

    #[test]
    fn a_reply_comes_back_as_it_was_sent(module in module(), reply in reply()) {
        prop_assert_eq!(Reply::decode(&reply.encode(module)), Ok((module, reply)));
    }

    #[test]
    fn a_broadcast_comes_back_as_it_was_sent(sent in broadcast()) {
        prop_assert_eq!(BroadcastFrame::decode(&sent.encode()), Ok(sent));
        prop_assert_eq!(Broadcast::decode(&sent.encode()), Ok(sent.broadcast));
    }

    #[test]
    fn valid_bytes_are_reproduced(frame in likely_frame()) {
        if let Ok(request) = AddressedRequest::decode(&frame) {
            prop_assert_eq!(request.encode(), frame);
        }
        if let Ok(broadcast) = BroadcastFrame::decode(&frame) {
            prop_assert_eq!(broadcast.encode(), frame);
        }
        match Reply::decode(&frame) {
            // Tolerated forms: answers to SET beyond three bytes and to the step command beyond one.
            Ok((_, Reply::SetAck { .. })) if frame.dlc() > 3 => {}
            Ok((_, Reply::SetStepInc)) if frame.dlc() > 1 => {}
            Ok((module, reply)) => prop_assert_eq!(reply.encode(module), frame),
            Err(_) => {}
        }
    }

    #[test]
    fn no_frame_is_two_things_at_once(frame in likely_frame()) {
        let meanings = [
            AddressedRequest::decode(&frame).is_ok(),
            BroadcastFrame::decode(&frame).is_ok(),
            Reply::decode(&frame).is_ok(),
        ];
        prop_assert!(meanings.into_iter().filter(|&understood| understood).count() <= 1);
    }

    #[test]
    fn any_frame_decodes_without_panic_and_errors_are_printable(frame in any_frame()) {
        if let Err(error) = AddressedRequest::decode(&frame) {
            prop_assert!(!error.to_string().is_empty());
        }
        if let Err(error) = Reply::decode(&frame) {
            prop_assert!(!error.to_string().is_empty());
        }
        if let Err(error) = BroadcastFrame::decode(&frame) {
            prop_assert!(!error.to_string().is_empty());
        }
    }

    #[test]
    fn every_request_has_one_kind_of_answer(asked in request(), reply in reply()) {
        // What answers a request repeats its command byte.
        if reply.answers(&asked) {
            let module = ModuleId::MIN;
            prop_assert_eq!(reply.encode(module).data()[0], asked.encode(module).data()[0]);
        }
    }

    #[test]
    fn a_value_of_another_type_is_refused(parameter in parameter(), other in parameter()) {
        let kind = other.kind();
        let value = match kind {
            ValueKind::F32 => Value::F32(0.0),
            ValueKind::I32 => Value::I32(0),
            ValueKind::U32 => Value::U32(0),
            ValueKind::I16 => Value::I16(0),
            ValueKind::U16 => Value::U16(0),
            ValueKind::U8 => Value::U8(0),
            ValueKind::PosStateDio => return Ok(()),
        };
        prop_assert_eq!(Request::set(parameter, value).is_ok(), parameter.kind() == kind);
    }
}

/// Requests and the reply that belongs to each; some commands occur twice, to check that they are distinguished.
#[test]
fn reply_answers_the_request_of_its_command_parameter_motion_and_form_and_no_other() {
    let ramp = MotionCommand::Ramp { target: Radians::new(1.0) };
    let speed = MotionCommand::Velocity(RadPerSec::new(0.5));
    let short = |command| Request::Move(MotionRequest::simple(command));
    let long = |command| Request::Move(MotionRequest::extended(command));
    let short_answer = |kind| Reply::MotionAck { kind, code: 0x64 };
    let long_answer = |kind| Reply::MotionExtended {
        kind,
        position: MotionPosition::Radians(Radians::new(0.1)),
        short_state: ShortState::from_bits(0),
        dio: Dio(0),
    };
    let value = Value::F32(1.0);
    let written = |parameter| Reply::SetAck { parameter, code: Some(0x64) };
    let pairs = [
        (Request::Simple(SimpleCommand::Halt), Reply::Simple(SimpleCommand::Halt)),
        (Request::Simple(SimpleCommand::Reset), Reply::Simple(SimpleCommand::Reset)),
        (Request::Internal([1; 7]), Reply::Internal([2; 7])),
        (Request::SetStepInc { target_ticks: 5, time_ms: 7 }, Reply::SetStepInc),
        (Request::Get(Parameter::ActPos), Reply::Value(Parameter::ActPos, value)),
        (Request::Get(Parameter::ActVel), Reply::Value(Parameter::ActVel, value)),
        (Request::Set(Parameter::TargetVel, value), written(Parameter::TargetVel)),
        (Request::Set(Parameter::TargetAcc, value), written(Parameter::TargetAcc)),
        (short(ramp), short_answer(MotionKind::Ramp)),
        (short(speed), short_answer(MotionKind::Velocity)),
        (long(ramp), long_answer(MotionKind::Ramp)),
        (long(speed), long_answer(MotionKind::Velocity)),
    ];
    for (i, (request, _)) in pairs.iter().enumerate() {
        for (j, (_, reply)) in pairs.iter().enumerate() {
            assert_eq!(reply.answers(request), i == j, "{reply:?} to {request:?}");
        }
    }
}

#[test]
fn remote_frames_are_neither_requests_nor_replies() {
    let module = ModuleId::new(3).unwrap();
    for channel in [Channel::Ack, Channel::Get, Channel::Put, Channel::State] {
        let frame = Frame::remote(channel.id(module), 4).unwrap();
        assert!(Reply::decode(&frame).is_err(), "{channel:?}");
        assert!(AddressedRequest::decode(&frame).is_err(), "{channel:?}");
    }
}
