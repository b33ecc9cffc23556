//! Every bit of the state word: its cause, its effect, how it is cleared. And the faults of a module.

use crate::drive_rig::{Rig, id};
use hil_sim::fault::{FaultTarget, PhysicalFault, Place};
use hil_sim::participants::Participants;
use protocol::powercube::{
    Config, CubeState, Dio, MotionCommand, MotionRequest, Parameter, Request, ShortState, SimpleCommand,
    Value,
};
use protocol::units::{Amperes, Radians};
use protocol::{Duration, Frame};

const MODULE: fn() -> Place = || Place::Module(id(1));

fn begin(rig: &mut Rig, fault: &PhysicalFault) {
    let now = rig.now;
    rig.cell.advance(now);
    rig.cell.begin_fault(now, MODULE(), fault).unwrap();
}

fn end(rig: &mut Rig, fault: &PhysicalFault) {
    let now = rig.now;
    rig.cell.end_fault(now, MODULE(), fault);
}

fn reset(rig: &mut Rig) -> CubeState {
    rig.simple(SimpleCommand::Reset);
    rig.run_ms(200);
    rig.state()
}

/// One way to raise each bit of the word.
fn raise(bit: CubeState) -> CubeState {
    let mut rig = match bit {
        CubeState::SWR => Rig::homed(|o| o.start_q_rad = Some(vec![-0.02])),
        CubeState::SW1 => Rig::homed(|o| o.start_q_rad = Some(vec![-3.19])),
        CubeState::SW2 => Rig::homed(|o| o.start_q_rad = Some(vec![3.19])),
        CubeState::POW_WDG_TEMP => Rig::homed(|o| o.drive.ambient_c = 120.0),
        CubeState::POW_FET_TEMP => Rig::homed(|o| o.drive.ambient_c = 95.0),
        CubeState::CURLIMIT => Rig::homed(|o| o.mechanics.coulomb_rad_s2 = Some(20.0)),
        CubeState::BRAKEACTIVE => Rig::homed(|o| o.drive.config = Config::BRAKE_AT_POWERON),
        CubeState::BEYOND_SOFT | CubeState::BEYOND_HARD => Rig::homed(|o| o.start_q_rad = Some(vec![3.1])),
        _ => Rig::homed(|_| ()),
    };
    match bit {
        CubeState::HALTED => {
            rig.simple(SimpleCommand::Halt);
        }
        CubeState::TOW_ERROR => {
            begin(&mut rig, &PhysicalFault::Blocked);
            rig.velocity(0.5);
            rig.run_ms(500);
        }
        CubeState::COMM_ERROR => {
            rig.add_config(Config::WATCHDOG_ENABLE);
            rig.exchange(&protocol::powercube::Broadcast::Watchdog.encode());
            rig.run_ms(60);
        }
        CubeState::CURLIMIT => {
            rig.set_f(Parameter::MaxCur, 3.0);
            rig.velocity(1.0);
            rig.run_ms(20);
        }
        CubeState::MOTION | CubeState::RAMP_ACC => {
            rig.velocity(1.0);
            rig.run_ms(50);
        }
        CubeState::RAMP_STEADY => {
            rig.velocity(0.2);
            rig.run_ms(300);
        }
        CubeState::RAMP_DEC => {
            rig.velocity(1.0);
            rig.run_ms(400);
            rig.velocity(0.0);
            rig.run_ms(50);
        }
        CubeState::RAMP_END => {
            rig.move_to(0.15);
            rig.run_ms(1_000);
        }
        CubeState::INPROGRESS | CubeState::FULLBUFFER => {
            for target in [0.15, 0.2] {
                rig.ask(Request::Move(MotionRequest::simple(MotionCommand::Step {
                    target: Radians::new(target),
                    time_ms: 500,
                })));
            }
        }
        CubeState::POW_VOLT_ERR | CubeState::POWERFAULT => {
            rig.set_f(Parameter::MinMotorVoltage, 30.0);
            rig.run_ms(50);
        }
        CubeState::SETUP_OR_LOGIC_VOLT => {
            rig.set_f(Parameter::MaxLogicVoltage, 20.0);
            rig.run_ms(50);
        }
        CubeState::POW_SHORTCUR | CubeState::ERROR => begin(&mut rig, &PhysicalFault::OverCurrent),
        CubeState::POW_HALLERR => begin(&mut rig, &PhysicalFault::HallError),
        CubeState::POW_INTEGRALERR => {
            rig.set_f(Parameter::NominalMotorCurrent, 0.5);
            rig.set(Parameter::NominalCurrentTime, Value::I32(100));
            rig.velocity(0.5);
            rig.run_ms(800);
        }
        CubeState::CPU_OVERLOAD => {
            let now = rig.now;
            rig.drive_mut().inject(now, CubeState::CPU_OVERLOAD);
        }
        CubeState::BEYOND_SOFT => {
            rig.velocity(0.5);
            rig.run_ms(500);
        }
        CubeState::BEYOND_HARD => {
            // Soft limits out of the way: the module believes to be elsewhere.
            let now = rig.now;
            rig.drive_mut().restart(now);
            rig.run_ms(700);
            rig.velocity(0.5);
            rig.run_ms(800);
        }
        _ => {}
    }
    rig.state()
}

#[test]
fn every_bit_of_the_state_word_can_be_raised() {
    for info in CubeState::BITS {
        let bit = CubeState::from_bits(1 << info.bit);
        let state = raise(bit);
        assert!(state.contains(bit), "{}: {state}", info.name);
        if CubeState::CAUSES.contains(bit) {
            assert!(state.contains(CubeState::ERROR | CubeState::HALTED), "{}: {state}", info.name);
        }
        let phases = state.bits() & CubeState::RAMP_PHASE.bits();
        assert!(phases.count_ones() <= 1, "{}: {state}", info.name);
        let quiet = state.difference(bit).bits() & CubeState::CAUSES.difference(CubeState::POWERFAULT).bits();
        // The hot motor heats the stage; summary bits come with a cause.
        let brings = [CubeState::POW_WDG_TEMP, CubeState::POWERFAULT, CubeState::ERROR].contains(&bit);
        assert!(quiet == 0 || brings, "{} brings {state}", info.name);
    }
}

#[test]
fn module_at_rest_shows_home_and_nothing_else() {
    let mut rig = Rig::homed(|_| ());
    assert_eq!(rig.state(), CubeState::HOME_OK);
    assert_eq!(rig.state().short(), ShortState::EMPTY);
}

#[test]
fn errors_of_the_power_stage_stay_until_power_is_cycled() {
    for fault in [PhysicalFault::OverCurrent, PhysicalFault::HallError] {
        let mut rig = Rig::homed(|_| ());
        begin(&mut rig, &fault);
        assert!(rig.state().contains(CubeState::POWERFAULT | CubeState::BRAKEACTIVE), "motor off, brake on");
        end(&mut rig, &fault);
        assert!(reset(&mut rig).contains(CubeState::POWERFAULT | CubeState::ERROR | CubeState::HALTED));
        begin(&mut rig, &PhysicalFault::Restart);
        rig.run_ms(700);
        assert!(!rig.state().intersects(CubeState::CAUSES | CubeState::ERROR | CubeState::HALTED));
    }
}

#[test]
fn voltage_error_yields_to_reset_once_the_voltage_is_back() {
    let mut rig = Rig::homed(|_| ());
    rig.set_f(Parameter::MinMotorVoltage, 30.0);
    rig.run_ms(30);
    assert!(reset(&mut rig).contains(CubeState::POW_VOLT_ERR), "still too low");
    rig.set_f(Parameter::MinMotorVoltage, 18.0);
    assert!(!reset(&mut rig).intersects(CubeState::POW_VOLT_ERR | CubeState::POWERFAULT | CubeState::ERROR));
    rig.move_to(0.3);
    rig.run_ms(1_500);
    assert!((rig.q(0) - 0.3).abs() < 1e-3);
}

#[test]
fn voltage_must_stay_low_for_its_time() {
    let mut rig = Rig::homed(|_| ());
    rig.set(Parameter::MotorUndershootTime, Value::I32(200));
    rig.set_f(Parameter::MinMotorVoltage, 30.0);
    rig.run_ms(190);
    assert!(!rig.state().contains(CubeState::POW_VOLT_ERR));
    rig.run_ms(15);
    assert!(rig.state().contains(CubeState::POW_VOLT_ERR));
}

#[test]
fn tow_error_comes_at_its_limit_and_yields_to_reset() {
    let mut rig = Rig::homed(|_| ());
    rig.set_f(Parameter::MaxDeltaPos, 0.05);
    begin(&mut rig, &PhysicalFault::Blocked);
    rig.set_f(Parameter::TargetAcc, 10.0);
    rig.velocity(0.5);
    // 12.5 mrad in the 50 ms of acceleration, the rest of 50 mrad at 0.5 rad/s: 125 ms.
    rig.run_ms(118);
    assert!(!rig.state().contains(CubeState::TOW_ERROR), "{}", rig.get(Parameter::DeltaPos));
    rig.run_ms(8);
    assert!(rig.state().contains(CubeState::TOW_ERROR | CubeState::ERROR | CubeState::HALTED));
    end(&mut rig, &PhysicalFault::Blocked);
    let state = reset(&mut rig);
    assert!(!state.intersects(CubeState::TOW_ERROR | CubeState::ERROR | CubeState::HALTED), "{state}");
    rig.move_to(0.2);
    rig.run_ms(1_500);
    assert!((rig.q(0) - 0.2).abs() < 1e-3);
}

#[test]
fn velocity_toward_a_soft_limit_stops_beyond_it_and_only_the_way_back_is_open() {
    let mut rig = Rig::homed(|_| ());
    rig.set_f(Parameter::MaxPos, 0.5);
    rig.velocity(0.8);
    rig.run_ms(2_000);
    let state = rig.state();
    assert!(state.contains(CubeState::BEYOND_SOFT | CubeState::ERROR | CubeState::HALTED), "{state}");
    // v²/2a = 31 mm-rad of braking, 4 of lag.
    assert!((0.5..0.56).contains(&rig.q(0)), "{}", rig.q(0));
    assert!(!reset(&mut rig).intersects(CubeState::BEYOND_SOFT | CubeState::HALTED));
    rig.velocity(0.2);
    rig.run_ms(100);
    assert!(rig.state().contains(CubeState::BEYOND_SOFT), "outwards again");
    reset(&mut rig);
    rig.velocity(-0.2);
    rig.run_ms(1_000);
    assert!(!rig.state().intersects(CubeState::CAUSES) && rig.q(0) < 0.5);
}

#[test]
fn soft_limits_mean_nothing_before_homing() {
    let mut rig = Rig::bench(0x4614, |_| ());
    rig.set_f(Parameter::MaxPos, 0.2);
    rig.velocity(0.5);
    rig.run_ms(1_000);
    assert!(!rig.state().contains(CubeState::BEYOND_SOFT) && rig.q(0) > 0.4);
}

#[test]
fn halt_brakes_with_the_largest_acceleration_then_closes_the_brake() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(1.0);
    rig.run_ms(500);
    let from = rig.q(0);
    rig.simple(SimpleCommand::Halt);
    assert!(!rig.state().contains(CubeState::BRAKEACTIVE), "still turning");
    rig.run_ms(300);
    // v²/2a = 48 mrad, and up to 3 ms of answers on the way.
    assert!((0.045..0.058).contains(&(rig.q(0) - from)), "{}", rig.q(0) - from);
    assert!(rig.state().contains(CubeState::BRAKEACTIVE | CubeState::HALTED));
    assert!(!rig.state().intersects(CubeState::MOTION | CubeState::ERROR));
}

#[test]
fn current_limit_is_a_warning_that_reset_clears() {
    let mut rig = Rig::homed(|o| o.mechanics.coulomb_rad_s2 = Some(20.0));
    rig.set_f(Parameter::MaxCur, 3.0);
    rig.set_f(Parameter::MaxDeltaPos, 0.1);
    rig.velocity(1.0);
    rig.run_ms(20);
    assert!(rig.state().contains(CubeState::CURLIMIT));
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(300);
    rig.set_f(Parameter::MaxCur, 30.0);
    assert!(!reset(&mut rig).intersects(CubeState::CURLIMIT));
}

#[test]
fn home_switch_is_a_limit_after_homing_when_configured() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::CHANGE_SWR_TO_LIMIT);
    rig.velocity(-0.3);
    rig.run_ms(1_500);
    assert!(rig.state().contains(CubeState::BEYOND_HARD));
    assert!((-0.1..0.0).contains(&rig.q(0)), "{}", rig.q(0));
}

#[test]
fn external_switch_and_low_active_bits_are_honoured() {
    let mut rig = Rig::homed(|_| ());
    rig.add_config(Config::SWR_USE_EXTERNAL);
    assert!(!rig.state().contains(CubeState::SWR));
    rig.drive_mut().set_inputs(0b0001);
    assert!(rig.state().contains(CubeState::SWR));
    rig.add_config(Config::SWR_LOW_ACTIVE);
    assert!(!rig.state().contains(CubeState::SWR));
}

#[test]
fn setup_bit_shows_errors_on_output_zero() {
    let mut rig = Rig::homed(|_| ());
    let setup = rig.get(Parameter::DefSetup) as u32 | 1 << 17;
    rig.set(Parameter::DefSetup, Value::U32(setup));
    assert_eq!(rig.drive().outputs() & 1, 0);
    begin(&mut rig, &PhysicalFault::OverCurrent);
    assert_eq!(rig.drive().outputs() & 1, 1);
    let answer: Vec<Frame> = rig.exchange(&Request::Get(Parameter::PosStateDio).encode(id(1)));
    assert_eq!(Dio(answer[0].data()[7]).outputs(), 1);
}

// ---- Faults ----

#[test]
fn frozen_module_keeps_showing_what_was_while_it_moves_on() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(0.3);
    rig.run_ms(400);
    begin(&mut rig, &PhysicalFault::Frozen);
    let (shown, truth) = (rig.get(Parameter::ActPos), rig.q(0));
    rig.run_ms(500);
    assert_eq!(rig.get(Parameter::ActPos), shown);
    assert!(rig.q(0) > truth + 0.14);
    end(&mut rig, &PhysicalFault::Frozen);
    assert!((rig.get(Parameter::ActPos) - rig.q(0)).abs() < 1e-3);
}

#[test]
fn slow_module_answers_later_by_the_given_time() {
    let mut rig = Rig::homed(|_| ());
    let fault = PhysicalFault::Slow(Duration::from_millis(5));
    begin(&mut rig, &fault);
    assert_eq!(rig.ask(Request::Get(Parameter::ActPos)), None, "not within 2 ms");
    rig.run_ms(4);
    assert_eq!(rig.frames.len(), 1);
    end(&mut rig, &fault);
    assert!(rig.ask(Request::Get(Parameter::ActPos)).is_some());
}

#[test]
fn restart_in_motion_drops_the_brake_loses_home_and_comes_back_after_the_boot_time() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(0.5);
    rig.run_ms(500);
    let restarted = rig.now;
    begin(&mut rig, &PhysicalFault::Restart);
    rig.run_ms(100);
    let stopped = rig.q(0);
    assert_eq!(rig.ask(Request::Get(Parameter::CubeState)), None);
    rig.run_until(restarted + Duration::from_millis(501));
    assert!(rig.ask(Request::Get(Parameter::CubeState)).is_some());
    assert!(!rig.state().contains(CubeState::HOME_OK));
    assert!(
        (rig.q(0) - stopped).abs() < 1e-3 && rig.get(Parameter::ActPos).abs() < 1e-3,
        "counts from zero again"
    );
}

#[test]
fn lost_counts_shift_the_position_without_any_bit() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(0.3);
    rig.run_ms(300);
    begin(&mut rig, &PhysicalFault::EncoderOffset { offset_rad: 0.05 });
    rig.run_ms(300);
    let now = rig.now;
    assert!((rig.drive().believed_q_rad(now) - rig.q(0) - 0.05).abs() < 1e-6);
    assert!(!rig.state().intersects(CubeState::CAUSES | CubeState::HALTED));
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(300);
    rig.simple(SimpleCommand::Home);
    rig.run_ms(5_000);
    let now = rig.now;
    assert!((rig.drive().believed_q_rad(now) - rig.q(0)).abs() < 1e-6, "homing finds the zero again");
}

#[test]
fn a_halted_drive_that_loses_counts_closes_its_brake_because_it_sees_no_motion() {
    let mut rig = Rig::homed(|_| ());
    // Two seconds of losing counts.
    begin(&mut rig, &PhysicalFault::EncoderOffset { offset_rad: 1.0 });
    rig.run_ms(200);
    let (before, seen) = (rig.q(0), rig.get(Parameter::ActVel).abs());
    rig.run_ms(100);
    // The position loop follows the counts; the module sees a joint at rest.
    assert!((0.045..0.055).contains(&(before - rig.q(0)).abs()), "{}", before - rig.q(0));
    assert!(seen < 0.02, "{seen}");
    rig.simple(SimpleCommand::Halt);
    rig.run_ms(100);
    let halted = rig.q(0);
    rig.run_ms(1_000);
    assert!((rig.q(0) - halted).abs() < 1e-3, "moved on by {} rad", rig.q(0) - halted);
}

#[test]
fn blocked_axis_shows_in_a_current_motion_as_standing() {
    let mut rig = Rig::homed(|_| ());
    begin(&mut rig, &PhysicalFault::Blocked);
    rig.ask(Request::Move(MotionRequest::simple(MotionCommand::Current(Amperes::new(10.0)))));
    rig.run_ms(500);
    assert!((rig.q(0) - 0.1).abs() < 1e-4);
    end(&mut rig, &PhysicalFault::Blocked);
    rig.run_ms(500);
    assert!(rig.q(0) > 0.2);
}

#[test]
fn impact_shows_in_the_current_and_a_current_motion_shows_what_was_ordered() {
    let mut rig = Rig::homed(|_| ());
    rig.velocity(0.5);
    rig.run_ms(400);
    // Wheel without gravity: the running current only, 2.9 A·s/rad.
    assert!((rig.get(Parameter::Cur) - 1.456).abs() < 0.01, "{}", rig.get(Parameter::Cur));
    begin(&mut rig, &PhysicalFault::Blocked);
    rig.run_ms(60);
    let pressed = rig.get(Parameter::Cur);
    // The loop pushes with all that 30 A allow, 206 N·m, less 20 N·m of friction: 26 A.
    assert!((24.0..30.0).contains(&pressed), "{pressed} A");
    end(&mut rig, &PhysicalFault::Blocked);
    rig.run_ms(500);
    reset(&mut rig);
    rig.ask(Request::Move(MotionRequest::simple(MotionCommand::Current(Amperes::new(-5.0)))));
    rig.run_ms(20);
    assert_eq!(rig.get(Parameter::Cur), 5.0);
}

#[test]
fn faults_that_do_not_apply_are_refused_with_a_reason() {
    let mut rig = Rig::homed(|_| ());
    let now = rig.now;
    for (place, fault) in [
        (Place::Module(id(7)), PhysicalFault::Frozen),
        (Place::Module(id(1)), PhysicalFault::StuckGripper),
        (Place::Supply(0), PhysicalFault::SupplyLoss { remaining: 0.0 }),
        (Place::Gripper, PhysicalFault::Frozen),
    ] {
        let refused = rig.cell.begin_fault(now, place, &fault).unwrap_err();
        assert!(!refused.why.is_empty() && refused.place == place);
    }
}
