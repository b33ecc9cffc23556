//! Every command, parameter and motion of the module, one case each, and every habit of the known clients.

mod drive_rig;

use drive_rig::{MS, Rig, id};
use hil_sim::drive::options::{
    BeyondMaximum, BeyondSoftLimit, HomeWhenHalted, InternalCommand, Persistence, Refusal, SignOfLife,
    StateFrames, UnknownRequest,
};
use protocol::powercube::address::BROADCAST_ID;
use protocol::powercube::{
    BaudRate, Broadcast, Channel, Command, Config, CubeState, FirmwareVersion, Motion, MotionAck,
    MotionCommand, MotionKind, MotionPosition, Parameter, Reply, Request, ShortState, SimpleCommand, Value,
    ValueKind,
};
use protocol::units::{Amperes, RadPerSec, Radians};
use protocol::{Duration, Frame};

const GET: u16 = 0x0C1;
const PUT: u16 = 0x0E1;

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(protocol::StandardId::new(id).unwrap(), data).unwrap()
}

fn text(frames: &[Frame]) -> Vec<String> {
    frames.iter().map(ToString::to_string).collect()
}

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
    let mut told = Rig::homed(|o| {
        o.drive.beyond_maximum = BeyondMaximum::Refuse;
        o.drive.refusal = Refusal::Code(0x01);
    });
    assert_eq!(told.set(Parameter::TargetVel, Value::F32(99.0)), Some(0x01));
    assert_eq!(told.set(Parameter::ActPos, Value::F32(0.0)), Some(0x01), "read only");
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
    use hil_sim::crew::{Crew, Link};
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.cell.link(0), Link::On);
    rig.all(Broadcast::Baud(BaudRate::Kbit250));
    assert_eq!(rig.cell.link(0), Link::OtherRate);
    let now = rig.now;
    rig.drive_mut().restart(now);
    assert_eq!(rig.cell.link(0), Link::Off, "booting");
    rig.run_ms(600);
    assert_eq!(rig.cell.link(0), Link::On, "not saved, so the old rate is back");
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

// ---- Motions ----

/// Every motion, simple and extended: the answer, and where it leads.
#[test]
fn every_motion_is_answered_in_its_form_and_moves() {
    let ticks = 51_247.89;
    let rad = |v: f32| Radians::new(v);
    type Check = fn(&Rig) -> bool;
    let near_half: Check = |rig| (rig.q(0) - 0.5).abs() < 2e-3;
    let moving_up: Check = |rig| rig.cell.plant().axis(0).v_rad_s > 0.15;
    let table: Vec<(MotionCommand, usize, Check)> = vec![
        (MotionCommand::Ramp { target: rad(0.5) }, 6, near_half),
        (MotionCommand::Step { target: rad(0.5), time_ms: 500 }, 8, near_half),
        (MotionCommand::Velocity(RadPerSec::new(0.2)), 6, moving_up),
        (MotionCommand::Current(Amperes::new(4.5)), 6, moving_up),
        (MotionCommand::RampInc { target_ticks: (0.5 * ticks) as i32 }, 6, near_half),
        (MotionCommand::StepInc { target_ticks: (0.5 * ticks) as i32, time_ms: 500 }, 8, near_half),
        (MotionCommand::VelocityInc { ticks_per_s: (0.2 * ticks) as i32 }, 6, moving_up),
        // 75 of 500 digits of 30 A.
        (MotionCommand::CurrentInc { digits: 75 }, 4, moving_up),
        (MotionCommand::CurrentIncWide { digits: 75 }, 6, moving_up),
        (MotionCommand::CosLoop { position: rad(0.5), period_ms: 4_000 }, 8, near_half),
        (MotionCommand::RampLoop { position: rad(0.5), period_ms: 4_000 }, 8, near_half),
    ];
    assert_eq!(table.len(), MotionKind::ALL.len() + 1, "current in digits has two lengths");
    for (command, dlc, check) in table {
        for ack in [MotionAck::Simple, MotionAck::Extended] {
            let kind = command.kind();
            let Some(code) = kind.code(ack) else { continue };
            let motion =
                if ack == MotionAck::Simple { Motion::simple(command) } else { Motion::extended(command) };
            let mut rig = Rig::homed(|_| ());
            let request = Request::Move(motion).encode(id(1));
            assert_eq!(request.dlc(), dlc, "{motion}");
            let answers = rig.exchange(&request);
            let [answer] = answers[..] else { panic!("{motion}: {answers:?}") };
            assert_eq!(answer.data()[..2], [0x0B, code], "{motion}");
            match ack {
                MotionAck::Simple => assert_eq!(answer.data()[2..], [0x64], "{motion}"),
                MotionAck::Extended => {
                    assert_eq!(answer.dlc(), 8, "{motion}");
                    let Ok((_, Reply::MotionExtended { position, .. })) = Reply::decode(&answer) else {
                        panic!()
                    };
                    match position {
                        MotionPosition::Radians(q) => {
                            assert!((q.get() - 0.1).abs() < 1e-4, "before the move: {q}");
                        }
                        MotionPosition::Ticks(n) => assert!((n - 5125).abs() < 8, "before the move: {n}"),
                    }
                }
            }
            rig.run_ms(1_998);
            assert!(check(&rig), "{motion}: at {} rad, {:?}", rig.q(0), rig.cell.plant().axis(0));
        }
    }
}

/// The three frames of moveRampExtended(1.0, 0.25, 0.5), as the manufacturer's library sends them.
#[test]
fn ramp_extended_trace_of_the_reference_is_answered_byte_for_byte() {
    let mut rig = Rig::homed(|o| o.start_q_rad = Some(vec![0.0]));
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x08, 0x4F, 0, 0, 0x80, 0x3E]))), ["0A1#084F64"]);
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x08, 0x50, 0, 0, 0, 0x3F]))), ["0A1#085064"]);
    let answer = rig.exchange(&frame(PUT, &[0x0B, 0x0E, 0, 0, 0x80, 0x3F]));
    // Position 0, moving, inputs and outputs low; the home switch is active at its edge.
    let short = ShortState::MOTION.union(ShortState::SWR).bits();
    assert_eq!(text(&answer), [format!("0A1#0B0E00000000{short:02X}00")]);
    rig.run_ms(4_400);
    assert!(!rig.state().contains(CubeState::RAMP_END), "1 rad at 0.25 rad/s and 0.5 rad/s² takes 4.5 s");
    rig.run_ms(200);
    assert!(rig.state().contains(CubeState::RAMP_END));
    assert!((rig.get(Parameter::ActPos) - 1.0).abs() < 1e-3);
}

#[test]
fn motion_while_halted_is_answered_with_not_ok_and_not_executed() {
    let mut rig = Rig::homed(|_| ());
    rig.simple(SimpleCommand::Halt);
    let Some(Reply::MotionExtended { short_state, .. }) = rig.move_to(0.5) else { panic!() };
    assert!(short_state.contains(ShortState::NOT_OK));
    let simple = Request::Move(Motion::simple(MotionCommand::Ramp { target: Radians::new(0.5) }));
    assert_eq!(rig.ask(simple), Some(Reply::MotionAck { kind: MotionKind::Ramp, code: 0x64 }));
    rig.run_ms(500);
    assert!((rig.q(0) - 0.1).abs() < 1e-3);
}

#[test]
fn target_beyond_the_soft_limit_is_clipped_refused_or_run_into_by_option() {
    let start = |choice: BeyondSoftLimit| {
        let mut rig = Rig::homed(|o| {
            o.drive.beyond_soft_limit = choice;
            o.start_q_rad = Some(vec![2.9]);
        });
        let answer = rig.move_to(4.0);
        rig.run_ms(3_000);
        (answer.is_some(), rig.q(0), rig.state())
    };
    let pi = std::f64::consts::PI;
    let (answered, q, state) = start(BeyondSoftLimit::Clip);
    assert!(answered && (q - pi).abs() < 1e-3 && state.contains(CubeState::RAMP_END));
    let (answered, q, state) = start(BeyondSoftLimit::Refuse);
    assert!(!answered && (q - 2.9).abs() < 1e-3 && !state.contains(CubeState::ERROR));
    let (answered, q, state) = start(BeyondSoftLimit::Run);
    assert!(
        answered && q > pi && state.contains(CubeState::BEYOND_SOFT | CubeState::ERROR | CubeState::HALTED)
    );
}

#[test]
fn current_motion_stays_at_nominal_unless_full_current_is_allowed() {
    let speed = |full: bool| {
        let mut rig = Rig::homed(|o| o.mechanics.coulomb_rad_s2 = Some(0.0));
        if full {
            rig.add_config(Config::ALLOW_FULL_CUR);
        }
        rig.set_f(Parameter::NominalMotorCurrent, 3.0);
        rig.ask(Request::Move(Motion::simple(MotionCommand::Current(Amperes::new(6.0)))));
        rig.run_ms(800);
        rig.cell.plant().axis(0).v_rad_s
    };
    // No load: speed settles near I / K_B, less the viscous 1.6 Nm s/rad: I = (K_B + K_M b) v.
    let expected = |current: f64| current / (2.9116 + 0.1419 * 0.02 * 206.0 / 149_f64.to_radians());
    for (full, current) in [(false, 3.0), (true, 6.0)] {
        let (found, expected) = (speed(full), expected(current));
        assert!((found / expected - 1.0).abs() < 0.03, "{current} A: {found} against {expected} rad/s");
    }
}

#[test]
fn sync_motion_waits_for_the_start_broadcast() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::SYNC_MOTION);
    rig.move_to(0.5);
    rig.run_ms(500);
    assert!((rig.q(0) - 0.1).abs() < 1e-3, "stored, not started");
    rig.all(Broadcast::StartMotion);
    rig.run_ms(2_000);
    assert!((rig.q(0) - 0.5).abs() < 1e-3);
    // A second start finds nothing stored.
    rig.all(Broadcast::StartMotion);
    rig.run_ms(100);
    assert!((rig.q(0) - 0.5).abs() < 1e-3);
}

#[test]
fn start_broadcast_without_sync_motion_does_nothing_visible() {
    let mut rig = Rig::homed(|_| ());
    rig.move_to(0.5);
    rig.all(Broadcast::StartMotion);
    rig.run_ms(2_000);
    assert!((rig.q(0) - 0.5).abs() < 1e-3);
}

// ---- Config bits ----

#[test]
fn disable_ack_silences_everything_but_get() {
    let mut rig = Rig::homed(|_| ());
    let config = Config::from_bits(rig.get(Parameter::Config) as u32).union(Config::DISABLE_ACK);
    assert_eq!(rig.set(Parameter::Config, Value::U32(config.bits())), None, "nor is the SET that does it");
    assert_eq!(rig.simple(SimpleCommand::Reset), None);
    assert_eq!(rig.move_to(0.3), None);
    rig.run_ms(2_000);
    assert!((rig.get(Parameter::ActPos) - 0.3).abs() < 1e-3, "obeyed all the same");
}

#[test]
fn m3_compatible_module_does_not_move_before_homing() {
    let mut rig = Rig::bench(0x3519, |_| ());
    rig.add_config(Config::M3_COMPATIBLE);
    rig.move_to(0.3);
    rig.run_ms(1_000);
    assert!((rig.q(0) - 0.1).abs() < 1e-4);
    let mut other = Rig::bench(0x3519, |_| ());
    other.move_to(0.3);
    other.run_ms(2_000);
    assert!((other.q(0) - 0.4).abs() < 1e-3, "0.3 rad from where it was switched on");
}

#[test]
fn disable_on_halt_switches_the_motor_off_instead_of_braking() {
    let coast = |off: bool| {
        let mut rig = Rig::homed(|o| {
            o.drive.brake = false;
            o.mechanics.coulomb_rad_s2 = Some(0.2);
        });
        if off {
            rig.add_config(Config::DISABLE_ON_HALT);
        }
        rig.velocity(1.0);
        rig.run_ms(500);
        rig.simple(SimpleCommand::Halt);
        let from = rig.q(0);
        rig.run_ms(500);
        rig.q(0) - from
    };
    // 1 rad/s braked with 10.4 rad/s² takes 48 mrad.
    assert!((0.03..0.06).contains(&coast(false)), "{}", coast(false));
    assert!(coast(true) > 0.25, "{}", coast(true));
}

#[test]
fn brake_at_power_on_keeps_the_brake_until_reset() {
    let mut rig = Rig::homed(|o| o.drive.config = Config::BRAKE_AT_POWERON);
    assert!(rig.state().contains(CubeState::BRAKEACTIVE));
    rig.move_to(0.3);
    rig.run_ms(500);
    assert!((rig.q(0) - 0.1).abs() < 1e-4);
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(150);
    assert!(!rig.state().contains(CubeState::BRAKEACTIVE));
    rig.move_to(0.3);
    rig.run_ms(1_500);
    assert!((rig.q(0) - 0.3).abs() < 1e-3);
}

// ---- Homing ----

#[test]
fn homing_finds_the_zero_in_the_direction_of_the_velocitys_sign() {
    for (start, velocity) in [(0.3, -0.3), (-0.4, 0.3), (-0.03, -0.3)] {
        let mut rig = Rig::bench(0x4614, |o| o.start_q_rad = Some(vec![start]));
        rig.set_f(Parameter::HomeVel, velocity);
        // Coming from below, the first edge is the cam's lower one.
        let edge = if velocity > 0.0 { -5_f64.to_radians() } else { 0.0 };
        rig.set_f(Parameter::HomeOffset, edge);
        assert!(rig.simple(SimpleCommand::Home).is_some(), "acknowledged at once");
        assert!(!rig.state().contains(CubeState::HOME_OK));
        assert!(rig.state().contains(CubeState::MOTION));
        rig.run_ms(4_000);
        let state = rig.state();
        assert!(state.contains(CubeState::HOME_OK | CubeState::RAMP_END), "start {start}: {state}");
        assert!(!state.intersects(CubeState::ERROR | CubeState::MOTION), "{state}");
        let (believed, truth) = (rig.get(Parameter::ActPos), rig.q(0));
        assert!((believed - truth).abs() < 3e-5, "start {start}: {believed} against {truth}");
    }
}

#[test]
fn homing_away_from_the_switch_turns_at_the_limit_switch() {
    let mut rig = Rig::bench(0x4614, |o| o.start_q_rad = Some(vec![-2.9]));
    rig.set_f(Parameter::HomeVel, -0.6);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(9_000);
    let state = rig.state();
    assert!(state.contains(CubeState::HOME_OK) && !state.intersects(CubeState::CAUSES), "{state}");
}

#[test]
fn homing_without_any_switch_ends_halted_without_home() {
    let mut rig = Rig::bench(0x4614, |_| ());
    let config = Config::from_bits(rig.get(Parameter::Config) as u32).difference(Config::SWR_ENABLED);
    rig.set(Parameter::Config, Value::U32(config.bits()));
    rig.set_f(Parameter::HomeVel, -2.0);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(8_000);
    let state = rig.state();
    assert!(state.contains(CubeState::HALTED) && !state.contains(CubeState::HOME_OK), "{state}");
}

#[test]
fn home_offset_is_what_the_module_reads_at_the_edge() {
    let mut rig = Rig::bench(0x4614, |_| ());
    rig.set_f(Parameter::HomeOffset, 0.7);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(3_000);
    assert!((rig.get(Parameter::ActPos) - rig.q(0) - 0.7).abs() < 3e-5);
}

#[test]
fn zero_move_goes_to_zero_after_homing() {
    let mut rig = Rig::bench(0x4614, |_| ());
    rig.add_config(Config::ZERO_MOVE_AFTER_HOK);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(5_000);
    assert!(rig.state().contains(CubeState::HOME_OK | CubeState::RAMP_END));
    assert!(rig.get(Parameter::ActPos).abs() < 2e-4, "{}", rig.get(Parameter::ActPos));
}

#[test]
fn index_makes_homing_repeatable_and_the_bare_switch_scatters() {
    let spread = |index: bool| {
        let errors: Vec<f64> = (0..12)
            .map(|seed| {
                let options = hil_sim::CellOptions::default();
                let mut rig = Rig::of(hil_sim::Cell::bench::<1>(0x4614, &options, seed).unwrap());
                rig.run_ms(150);
                if !index {
                    let config = Config::from_bits(rig.get(Parameter::Config) as u32);
                    let config = config.difference(Config::SWR_WITH_ENCODERZERO);
                    rig.set(Parameter::Config, Value::U32(config.bits()));
                }
                rig.simple(SimpleCommand::Home);
                rig.run_ms(3_000);
                let now = rig.now;
                rig.drive().believed_q_rad(now) - rig.q(0)
            })
            .collect();
        let mean = errors.iter().sum::<f64>() / 12.0;
        (errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / 12.0).sqrt()
    };
    assert!(spread(true) < 1e-9);
    // Standard deviation 0.2 mrad; twelve draws.
    assert!((5e-5..5e-4).contains(&spread(false)), "{}", spread(false));
}

#[test]
fn absolute_encoder_comes_up_homed_and_home_is_done_at_once() {
    let mut rig = Rig::bench(0x4614, |o| o.drive.absolute_encoder = true);
    assert!(rig.state().contains(CubeState::HOME_OK));
    rig.simple(SimpleCommand::Home);
    assert!(rig.state().contains(CubeState::HOME_OK) && !rig.state().contains(CubeState::MOTION));
    // HOME leads out of HALTED, with the loop closed.
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(50);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(150);
    rig.move_to(0.3);
    rig.run_ms(1_500);
    assert!((rig.q(0) - 0.3).abs() < 1e-3);
}

#[test]
fn home_while_halted_is_accepted_or_refused_by_option() {
    for (choice, homed) in [(HomeWhenHalted::Accept, true), (HomeWhenHalted::Refuse, false)] {
        let mut rig = Rig::bench(0x4614, |o| o.drive.home_when_halted = choice);
        rig.simple(SimpleCommand::Halt);
        assert!(rig.simple(SimpleCommand::Home).is_some());
        rig.run_ms(3_000);
        assert_eq!(rig.state().contains(CubeState::HOME_OK), homed);
    }
}

// ---- Watchdog ----

#[test]
fn watchdog_is_silent_until_the_first_refresh_and_stops_the_module_after_its_time_out() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    rig.run_ms(500);
    assert!(!rig.state().contains(CubeState::COMM_ERROR), "enabled alone stops nothing");
    rig.velocity(0.3);
    for _ in 0..20 {
        rig.offer(&Broadcast::Watchdog.encode());
        rig.run_ms(40);
    }
    assert!(!rig.state().contains(CubeState::ERROR), "refreshed every 40 ms");
    rig.offer(&Broadcast::Watchdog.encode());
    let refreshed = rig.now;
    rig.run_until(refreshed + Duration::from_micros(49_999));
    let now = rig.now;
    assert!(!rig.drive().state_word(now).contains(CubeState::COMM_ERROR), "49.999 ms");
    rig.run_until(refreshed + Duration::from_micros(50_000));
    let now = rig.now;
    let state = rig.drive().state_word(now);
    assert!(state.contains(CubeState::COMM_ERROR | CubeState::ERROR | CubeState::HALTED), "50 ms: {state}");
    rig.run_ms(500);
    let stopped = rig.q(0);
    rig.run_ms(500);
    assert!((rig.q(0) - stopped).abs() < 1e-6);
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(300);
    assert!(!rig.state().intersects(CubeState::ERROR | CubeState::HALTED), "disarmed until refreshed again");
}

#[test]
fn other_traffic_is_no_sign_of_life_unless_the_option_says_so() {
    for (choice, stopped) in [(SignOfLife::Refresh, true), (SignOfLife::AnyFrame, false)] {
        let mut rig = Rig::homed(|o| o.drive.sign_of_life = choice);
        rig.add_config(Config::WATCHDOG_ENABLE);
        rig.offer(&Broadcast::Watchdog.encode());
        for _ in 0..10 {
            rig.run_ms(10);
            rig.get(Parameter::ActPos);
        }
        assert_eq!(rig.state().contains(CubeState::COMM_ERROR), stopped);
    }
}

#[test]
fn watchdog_refresh_sent_to_one_module_counts_too() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    for _ in 0..10 {
        rig.offer(&frame(PUT, &[0x07]));
        rig.run_ms(40);
    }
    assert!(!rig.state().contains(CubeState::COMM_ERROR));
    rig.run_ms(60);
    assert!(rig.state().contains(CubeState::COMM_ERROR));
}

#[test]
fn switching_the_watchdog_off_disarms_it() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::WATCHDOG_ENABLE);
    rig.offer(&Broadcast::Watchdog.encode());
    let config = Config::from_bits(rig.get(Parameter::Config) as u32).difference(Config::WATCHDOG_ENABLE);
    rig.set(Parameter::Config, Value::U32(config.bits()));
    rig.run_ms(200);
    assert!(!rig.state().contains(CubeState::COMM_ERROR));
}

// ---- Timing, queue, unsolicited frames ----

#[test]
fn answers_come_in_order_after_the_processing_delay_with_its_jitter() {
    let mut rig = Rig::homed(|_| ());
    let mut delays = Vec::new();
    for _ in 0..300 {
        rig.frames.clear();
        let asked = rig.now;
        rig.offer(&frame(GET, &[0x0A, 0x3C]));
        rig.run_ms(1);
        delays.push(rig.frames[0].0.saturating_since(asked).as_micros());
    }
    let (least, most) = (delays.iter().min().unwrap(), delays.iter().max().unwrap());
    assert!((100..=110).contains(least) && (290..=300).contains(most), "{least} to {most} µs");
    rig.frames.clear();
    for parameter in [0x3C, 0x41, 0x4D, 0x27] {
        rig.offer(&frame(GET, &[0x0A, parameter]));
    }
    rig.run_ms(3);
    let order: Vec<u8> = rig.frames.iter().map(|(_, f)| f.data()[1]).collect();
    assert_eq!(order, [0x3C, 0x41, 0x4D, 0x27]);
}

#[test]
fn requests_beyond_the_queue_are_lost_and_counted() {
    let mut rig = Rig::homed(|o| o.drive.queue_depth = 3);
    rig.frames.clear();
    for _ in 0..10 {
        rig.offer(&frame(GET, &[0x0A, 0x3C]));
    }
    rig.run_ms(10);
    assert_eq!((rig.frames.len(), rig.drive().counters().overflowed), (3, 7));
}

#[test]
fn state_frames_come_on_change_when_the_option_says_so() {
    let mut rig = Rig::homed(|o| o.drive.state_frames = StateFrames::OnChange { every: MS });
    rig.run_ms(5);
    rig.frames.clear();
    rig.run_ms(50);
    assert_eq!(rig.frames, [], "nothing changes");
    rig.offer(&Broadcast::Halt.encode());
    rig.run_ms(3);
    let (at, first) = rig.frames[0];
    assert_eq!(first.id(), Channel::State.id(id(1)));
    assert_eq!(first.dlc(), 4, "32-bit state word, no command byte");
    let Ok((_, Reply::State(state))) = Reply::decode(&first) else { panic!() };
    assert!(state.contains(CubeState::HALTED) && rig.now.saturating_since(at) <= Duration::from_millis(3));
}

#[test]
fn sync_transmit_sends_state_frames_in_a_fixed_interval() {
    let mut rig =
        Rig::homed(|o| o.drive.state_frames = StateFrames::SyncTransmit { every: Duration::from_millis(10) });
    rig.run_ms(50);
    assert_eq!(rig.frames, []);
    rig.add_config(Config::SYNC_TRANSMIT);
    rig.frames.clear();
    rig.run_ms(100);
    assert!((9..=11).contains(&rig.frames.len()), "{}", rig.frames.len());
}

// ---- Habits of the known clients ----

#[test]
fn request_on_the_other_channel_is_answered_all_the_same() {
    let mut rig = Rig::homed(|_| ());
    // One host polls the address on the PUT id and reads parameters on the GET id.
    assert_eq!(text(&rig.exchange(&frame(PUT, &[0x0A, 0x20]))), ["0A1#0A2001"]);
    assert_eq!(text(&rig.exchange(&frame(GET, &[0x00]))), ["0A1#00"]);
}

#[test]
fn scan_of_all_addresses_finds_the_modules_that_are_there() {
    let robot = robot_model::AnyRobot::load("powercube6").unwrap();
    let mut rig = Rig::of(hil_sim::Cell::new(&robot, &hil_sim::CellOptions::default(), 1).unwrap());
    let found: Vec<u8> = protocol::ModuleId::all()
        .filter(|module| rig.ask_module(*module, Request::Get(Parameter::DefVersion)).is_some())
        .map(protocol::ModuleId::get)
        .collect();
    assert_eq!(found, [1, 2, 3, 4, 5, 6]);
}

/// Start-up of the widespread ROS driver: RESET, identity, 0x62; not homed shows NOT_OK, so HALT and HOME; then it
/// waits for HOME_OK and RAMP_END, and sends the start broadcast after every group of motions.
#[test]
fn ros_driver_starts_up_homes_and_moves() {
    let mut rig = Rig::bench(0x3519, |_| ());
    assert!(rig.simple(SimpleCommand::Reset).is_some());
    for parameter in [0x1A, 0x1D, 0x01, 0x1B, 0x58] {
        assert_eq!(rig.exchange(&frame(GET, &[0x0A, parameter])).len(), 1);
    }
    let status = rig.exchange(&frame(GET, &[0x0A, 0x62]));
    assert_eq!(status[0].dlc(), 8);
    assert!(status[0].data()[6] & ShortState::NOT_OK.bits() != 0, "not homed");
    rig.simple(SimpleCommand::Halt);
    rig.simple(SimpleCommand::Home);
    let mut polls = 0;
    while !rig.state().contains(CubeState::HOME_OK | CubeState::RAMP_END) {
        polls += 1;
        assert!(polls < 1_500, "homing is limited to 15 s");
        rig.run_ms(10);
    }
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(500);
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(300);
    let step =
        Request::Move(Motion::extended(MotionCommand::Step { target: Radians::new(0.1), time_ms: 300 }));
    let Some(Reply::MotionExtended { short_state, .. }) = rig.ask(step) else { panic!() };
    rig.all(Broadcast::StartMotion);
    assert!(!short_state.contains(ShortState::NOT_OK), "{short_state}");
    rig.run_ms(600);
    assert!((rig.get(Parameter::ActPos) - 0.1).abs() < 1e-3);
}

#[test]
fn current_in_digits_is_taken_with_two_and_with_four_bytes() {
    for data in [&[0x0B, 0x0D, 150, 0][..], &[0x0B, 0x0D, 150, 0, 0, 0][..]] {
        let mut rig = Rig::homed(|_| ());
        assert_eq!(text(&rig.exchange(&frame(PUT, data))), ["0A1#0B0D64"]);
        rig.run_ms(300);
        assert!(rig.cell.plant().axis(0).v_rad_s > 0.05);
        assert_eq!(rig.get(Parameter::CurInc), 150.0);
    }
}

#[test]
fn negative_ramp_velocity_counts_by_its_magnitude() {
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.set(Parameter::TargetVel, Value::F32(-0.5)), Some(0x64));
    rig.move_to(0.6);
    rig.run_ms(3_000);
    assert!((rig.q(0) - 0.6).abs() < 1e-3);
}

#[test]
fn second_step_is_buffered_and_a_stream_of_steps_runs_evenly() {
    let mut rig = Rig::homed(|_| ());
    let step = |target: f32| {
        Request::Move(Motion::extended(MotionCommand::Step { target: Radians::new(target), time_ms: 100 }))
    };
    rig.ask(step(0.15));
    let Some(Reply::MotionExtended { short_state, .. }) = rig.ask(step(0.20)) else { panic!() };
    assert!(short_state.contains(ShortState::INPROGRESS | ShortState::FULLBUFFER), "{short_state}");
    let mut speeds = Vec::new();
    for _ in 0..15 {
        rig.run_ms(10);
        speeds.push(rig.cell.plant().axis(0).v_rad_s);
    }
    // 0.05 rad in 100 ms, twice without a stop between.
    assert!(speeds[3..].iter().all(|v| (0.45..0.55).contains(v)), "{speeds:?}");
    rig.run_ms(200);
    assert!((rig.q(0) - 0.2).abs() < 1e-3);
}

#[test]
fn deadline_in_the_past_is_served_late_without_harm() {
    use hil_sim::crew::Crew;
    let mut rig = Rig::homed(|_| ());
    rig.offer(&frame(GET, &[0x0A, 0x3C]));
    let late = rig.now + Duration::from_millis(30);
    rig.cell.advance(late);
    let node = rig.cell.node(0);
    node.handle_timeout(late);
    node.handle_timeout(late);
    assert!(node.poll_frame().is_some() && node.poll_frame().is_none());
    assert_eq!(node.poll_timeout(), None);
}
