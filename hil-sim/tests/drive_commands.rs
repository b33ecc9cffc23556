//! Every parameter and command of the module, one case each: lengths, types, gates, access, refusals.

use crate::drive_rig::{GET, PUT, Rig, frame, id, text};
use hil_sim::drive::options::{BeyondMaximum, InternalCommand, Persistence, RefusedReply, UnknownRequest};
use protocol::Frame;
use protocol::powercube::address::BROADCAST_ID;
use protocol::powercube::{
    BaudRate, Broadcast, Channel, Command, CubeState, FirmwareVersion, Parameter, Reply, Request,
    SimpleCommand, Value, ValueKind,
};

// ---- Parameters ----

#[test]
fn every_readable_parameter_answers_with_its_type_and_length_and_no_other_does() {
    for firmware in [0x3519, 0x4614] {
        let mut rig = Rig::bench(firmware, |_| ());
        for code in 0..=255_u8 {
            let answers = rig.exchange(&frame(GET, &[0x0A, code]));
            let row = Parameter::from_code(code).map(Parameter::info);
            match row.filter(|row| row.readable(FirmwareVersion(firmware))) {
                None => assert_eq!(answers, [], "{firmware:04X}: {code:02X} is not readable"),
                Some(row) => {
                    let [answer] = answers[..] else { panic!("{firmware:04X} {}: {answers:?}", row.name) };
                    assert_eq!(answer.id(), Channel::Ack.id(id(1)));
                    assert_eq!(answer.dlc(), 2 + row.kind.wire_len(), "{}", row.name);
                    assert_eq!(answer.data()[..2], [0x0A, code], "{}", row.name);
                }
            }
        }
    }
}

#[test]
fn every_writable_parameter_takes_its_own_value_back_and_no_other_is_written() {
    for firmware in [0x3519, 0x4614] {
        let mut rig = Rig::bench(firmware, |_| ());
        for row in Parameter::TABLE {
            let value = match (rig.ask(Request::Get(row.parameter)), row.kind) {
                (Some(Reply::Value(_, value)), _) => value,
                // Write only, or behind a gate.
                (_, ValueKind::F32) => Value::F32(1.0),
                (_, ValueKind::I32) => Value::I32(1),
                (_, ValueKind::U32) => Value::U32(1),
                (_, ValueKind::I16) => Value::I16(1),
                (_, ValueKind::U16) => Value::U16(1),
                (_, ValueKind::U8) => Value::U8(1),
                (_, ValueKind::PosStateDio) => continue,
            };
            let answers = rig.exchange(&Request::set(row.parameter, value).unwrap().encode(id(1)));
            if row.writable(FirmwareVersion(firmware)) {
                let expected = format!("0A1#08{:02X}64", row.parameter.code());
                assert_eq!(text(&answers), [expected], "{firmware:04X} {}", row.name);
            } else {
                assert_eq!(answers, [], "{firmware:04X} {} is not writable", row.name);
            }
        }
    }
}

#[test]
fn identity_and_limits_are_those_of_the_nameplate() {
    let mut rig = Rig::homed(|_| ());
    for (parameter, expected) in [
        (Parameter::DefVersion, f64::from(0x4614)),
        (Parameter::DefSerialNo, 1001.0),
        (Parameter::DefAddress, 1.0),
        (Parameter::DefCanBaud, 3.0),
        (Parameter::DefGearRatio, 161.0),
        (Parameter::DefIncPerTurn, 2000.0),
        // 2000 ticks × 161 / 2π.
        (Parameter::IncRatio, 51_247.89),
        (Parameter::MinPos, -std::f64::consts::PI),
        (Parameter::MaxPos, std::f64::consts::PI),
        (Parameter::MaxVel, 149_f64.to_radians()),
        (Parameter::MaxAcc, 596_f64.to_radians()),
        (Parameter::MaxCur, 30.0),
        (Parameter::DefMaxDeltaPos, 0.1),
        (Parameter::ActC0, 32.0),
        (Parameter::DefBurnCount, 0.0),
        (Parameter::MotorSupply, 24.0),
        (Parameter::LogicSupply, 24.0),
        (Parameter::Temperature, 25.0),
        (Parameter::ActPos, 0.1),
        (Parameter::PosInc, 5125.0),
        (Parameter::ActVel, 0.0),
        (Parameter::Cur, 0.0),
    ] {
        let found = rig.get(parameter);
        assert!((found - expected).abs() <= 2e-6 * expected.abs().max(10.0), "{parameter}: {found}");
    }
}

#[test]
fn value_above_its_maximum_is_clipped_or_refused_by_option() {
    let mut clip = Rig::homed(|_| ());
    assert_eq!(clip.set(Parameter::TargetVel, Value::F32(99.0)), Some(0x64));
    let mut silent = Rig::homed(|o| o.drive.beyond_maximum = BeyondMaximum::Refuse);
    assert_eq!(silent.set(Parameter::TargetVel, Value::F32(99.0)), None);
    let mut reported = Rig::homed(|o| {
        o.drive.beyond_maximum = BeyondMaximum::Refuse;
        o.drive.refusal = RefusedReply::Code(0x01);
    });
    assert_eq!(reported.set(Parameter::TargetVel, Value::F32(99.0)), Some(0x01));
    assert_eq!(reported.set(Parameter::ActPos, Value::F32(0.0)), Some(0x01), "read only");
    for rig in [&mut clip, &mut silent] {
        assert_eq!(rig.set(Parameter::MaxVel, Value::F32(f32::NAN)), None, "no number is never taken");
    }
}

#[test]
fn parameters_survive_a_restart_only_when_saved() {
    let mut rig = Rig::homed(|_| ());
    rig.set_f(Parameter::MaxVel, 1.0);
    assert_eq!(rig.simple(SimpleCommand::SaveParameters), Some(Reply::Simple(SimpleCommand::SaveParameters)));
    rig.set_f(Parameter::MaxVel, 0.5);
    let now = rig.now;
    rig.drive_mut().restart(now);
    assert_eq!(rig.ask(Request::Get(Parameter::DefVersion)), None, "silent while it boots");
    rig.run_ms(600);
    assert_eq!(rig.get(Parameter::MaxVel), 1.0);
    assert_eq!(rig.get(Parameter::DefBurnCount), 1.0);
    assert!(!rig.state().contains(CubeState::HOME_OK), "an incremental encoder has lost its zero");
}

#[test]
fn new_address_acts_after_save_and_restart() {
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.set(Parameter::DefAddress, Value::U8(9)), Some(0x64));
    assert!(rig.ask(Request::Get(Parameter::DefVersion)).is_some(), "still the old address");
    rig.simple(SimpleCommand::SaveParameters);
    let now = rig.now;
    rig.drive_mut().restart(now);
    rig.run_ms(600);
    assert_eq!(rig.ask(Request::Get(Parameter::DefVersion)), None);
    assert!(rig.ask_module(id(9), Request::Get(Parameter::DefVersion)).is_some());
}

#[test]
fn digital_lines_are_read_and_written() {
    let mut rig = Rig::homed(|_| ());
    rig.drive_mut().set_inputs(0b0101);
    assert_eq!(rig.set(Parameter::DioData, Value::U32(0xA0)), Some(0x64));
    assert_eq!(rig.get(Parameter::DioData) as u32 & 0xFF, 0xA5);
    let answer = rig.exchange(&frame(GET, &[0x0A, 0x62]));
    assert_eq!(answer[0].data()[7], 0xA5);
}

#[test]
fn raw_count_and_ticks_follow_the_position() {
    let mut rig = Rig::bench(0x4614, |_| ());
    // Not homed: the module counts from where it was switched on.
    assert_eq!((rig.get(Parameter::ActPos), rig.get(Parameter::PosCount)), (0.0, 0.0));
    rig.simple(SimpleCommand::Home);
    rig.run_ms(2_000);
    assert!(rig.state().contains(CubeState::HOME_OK));
    let (position, ticks, count) =
        (rig.get(Parameter::ActPos), rig.get(Parameter::PosInc), rig.get(Parameter::PosCount));
    assert!((ticks / 51_247.89 - position).abs() < 2e-5);
    // Counted from 0.1 rad.
    assert!((count / 51_247.89 + 0.1 - position).abs() < 1e-4, "{count} against {position}");
    assert!((rig.get(Parameter::RefPosCount) / 51_247.89 + 0.1).abs() < 1e-4, "the edge is at 0");
}

#[test]
fn reported_position_has_the_resolution_of_the_option() {
    let step = 0.02_f64.to_radians();
    let mut rig = Rig::homed(|o| o.drive.position_resolution_rad = Some(step));
    let position = rig.get(Parameter::ActPos);
    let steps = position / step;
    assert!((steps - steps.round()).abs() < 1e-3 && (position - 0.1).abs() <= 0.5 * step);
}

// ---- Commands ----

#[test]
fn every_command_byte_gets_the_answer_of_the_reference() {
    let table: &[(&[u8], &[&str])] = &[
        (&[0x00], &["0A1#00"]),
        (&[0x01], &["0A1#01"]),
        (&[0x02], &["0A1#02"]),
        // Known by name only.
        (&[0x03], &[]),
        (&[0x04, 1, 2, 3, 4, 5, 6, 7], &["0A1#0401020304050607"]),
        // One host sends it here and reads nothing.
        (&[0x07], &[]),
        (&[0x08, 0x4F, 0, 0, 0x80, 0x3E], &["0A1#084F64"]),
        (&[0x09], &["0A1#09"]),
        (&[0x0A, 0x1D], &["0A1#0A1D1446"]),
        (&[0x0D, 0, 0, 0, 0, 50, 0], &["0A1#0D"]),
        // Broadcasts only.
        (&[0x0E], &[]),
        (&[0x0F], &[]),
        (&[0x10], &["0A1#10"]),
        (&[0x12], &["0A1#12"]),
    ];
    assert_eq!(table.len() + 1, Command::ALL.len(), "0x0B has a test of its own");
    for (request, expected) in table {
        let mut rig = Rig::homed(|_| ());
        let answers = rig.exchange(&frame(PUT, request));
        assert_eq!(text(&answers), *expected, "{request:02X?}");
    }
}

#[test]
fn unknown_commands_wrong_lengths_and_other_modules_get_silence() {
    let mut rig = Rig::homed(|_| ());
    for data in [
        &[][..],
        &[0x05],
        &[0xFF],
        &[0x00, 0x00],
        &[0x08, 0x4F, 0, 0],
        &[0x08],
        &[0x0A],
        &[0x0A, 0x3C, 0],
        &[0x0B, 0x0E],
        &[0x0B, 0x05, 0, 0, 0, 0],
        &[0x0D, 1],
    ] {
        assert_eq!(rig.exchange(&frame(PUT, data)), [], "{data:02X?}");
    }
    assert_eq!(rig.exchange(&frame(0x0E2, &[0x00])), [], "another address");
    assert_eq!(rig.exchange(&Frame::remote(Channel::Get.id(id(1)), 2).unwrap()), [], "a remote frame");
    assert_eq!(rig.drive().counters().not_understood, 11);
}

#[test]
fn internal_command_is_echoed_or_ignored_by_option() {
    let mut rig = Rig::homed(|o| o.drive.internal = InternalCommand::Silence);
    assert_eq!(rig.ask(Request::Internal([7; 7])), None);
}

#[test]
fn unknown_request_is_echoed_by_option() {
    let mut rig = Rig::homed(|o| o.drive.unknown = UnknownRequest::Echo);
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x05, 0xAB]))), ["0A1#05AB"]);
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x03]))), ["0A1#03"]);
    assert_eq!(rig.exchange(&frame(PUT, &[])), [], "nothing to echo");
}

#[test]
fn writes_are_permanent_at_once_by_option() {
    let mut rig = Rig::homed(|o| o.drive.persistence = Persistence::AtOnce);
    rig.set_f(Parameter::MaxVel, 1.0);
    let now = rig.now;
    rig.drive_mut().restart(now);
    rig.run_ms(600);
    assert_eq!(rig.get(Parameter::MaxVel), 1.0);
}

#[test]
fn recalc_takes_changed_gains_over_and_not_before() {
    // A gain of 1 % sags under friction and lags: following error of 13 mrad becomes more.
    let lag = |recalc: bool| {
        let mut rig = Rig::homed(|_| ());
        rig.set(Parameter::ActC0, Value::I16(16));
        if recalc {
            rig.simple(SimpleCommand::Recalc);
        }
        rig.velocity(0.5);
        rig.run_ms(600);
        rig.get(Parameter::DeltaPos)
    };
    let (kept, taken) = (lag(false), lag(true));
    // 2ζ/ωn × 0.5 rad/s: 2.5 mrad, and 5 mrad with half the natural frequency; friction adds some.
    assert!((0.0024..0.0028).contains(&kept), "{kept}");
    assert!((0.0049..0.0056).contains(&taken), "{taken}");
}

#[test]
fn baud_broadcast_changes_the_rate_at_once_without_answer() {
    use hil_sim::participants::{BusConnection, Participants};
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.cell.connection(0), BusConnection::On);
    rig.all(Broadcast::Baud(BaudRate::Kbit250));
    assert_eq!(rig.cell.connection(0), BusConnection::OtherRate);
    let now = rig.now;
    rig.drive_mut().restart(now);
    assert_eq!(rig.cell.connection(0), BusConnection::Off, "booting");
    rig.run_ms(600);
    assert_eq!(rig.cell.connection(0), BusConnection::On, "not saved, so the old rate is back");
}

#[test]
fn broadcasts_with_one_and_with_two_bytes_do_the_same() {
    for padding in [&[][..], &[0][..]] {
        let padded = |code: u8| frame(BROADCAST_ID.get(), &[&[code], padding].concat());
        let mut rig = Rig::homed(|_| ());
        rig.exchange(&padded(0x02));
        assert!(rig.state().contains(CubeState::HALTED));
        rig.exchange(&padded(0x00));
        assert!(!rig.state().contains(CubeState::HALTED));
        rig.exchange(&padded(0x01));
        assert!(!rig.state().contains(CubeState::HOME_OK));
        rig.run_ms(3_000);
        assert!(rig.state().contains(CubeState::HOME_OK));
        rig.exchange(&padded(0x0E));
        assert!((rig.get(Parameter::SavePos) - rig.get(Parameter::ActPos)).abs() < 1e-6);
    }
}

#[test]
fn saved_position_is_the_one_at_the_broadcast() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(0.5);
    rig.run_ms(500);
    let at = rig.q(0);
    rig.all(Broadcast::SavePosition);
    rig.run_ms(200);
    let saved = rig.get(Parameter::SavePos);
    assert!((saved - at).abs() < 1e-4, "{saved} against {at}");
    assert!(rig.get(Parameter::ActPos) > saved + 0.08);
}
