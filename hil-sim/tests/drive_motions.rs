//! Every motion, one case each, and the configuration bits that change motions and answers.

use crate::drive_rig::{PUT, Rig, frame, id, text};
use hil_sim::drive::options::BeyondSoftLimit;
use protocol::powercube::{
    Broadcast, Config, CubeState, MotionAck, MotionCommand, MotionKind, MotionPosition, MotionRequest,
    Parameter, Reply, Request, ShortState, SimpleCommand, Value,
};
use protocol::units::{Amperes, RadPerSec, Radians};

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
            let motion = if ack == MotionAck::Simple {
                MotionRequest::simple(command)
            } else {
                MotionRequest::extended(command)
            };
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
    let simple = Request::Move(MotionRequest::simple(MotionCommand::Ramp { target: Radians::new(0.5) }));
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
        rig.ask(Request::Move(MotionRequest::simple(MotionCommand::Current(Amperes::new(6.0)))));
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
