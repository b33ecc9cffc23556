//! From silence to torque: what is compared, what is proven, and that nothing moves.

use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::groups::mit::Mismatch;
use firmware::orders::Order;
use firmware::state::StateKind;
use hil_sim::drive::mit::{MitMotor, MitOptions};
use protocol::mit::{Command, Mit, Register, RegisterValue, Status};

use crate::rig::{JOINTS, Rig, TIME_OUT_US, TYPES, id, joint, master, ranges, settings};

/// A motor whose shaft, at 0 on the bench, reads `shaft_rad`.
fn motor_reading(index: usize, shaft_rad: f64) -> MitMotor {
    let options = MitOptions::of(TYPES[index], id(index), master(index)).unwrap();
    MitMotor::new(MitOptions { zero_rad: -shaft_rad, ..options }, 0.0)
}

#[test]
fn motors_are_found_without_a_motion_and_the_first_gains_are_where_the_shaft_stands() {
    let mut rig = Rig::new();
    for i in 0..JOINTS {
        rig.motor(i, |motor| *motor = motor_reading(i, -0.3 * i as f64));
    }
    // The shafts stand away from their zeros: a set point of 0 would be a leap.
    let before = rig.shafts();
    rig.run_to(500, StateKind::Idle);
    for (i, stood_rad) in before.into_iter().enumerate() {
        let commands = rig.commands(i, protocol::Instant::ZERO);
        let enabled = commands.iter().position(|(_, command)| *command == Command::Enable).unwrap();
        let no_gains = |command: &Command| {
            matches!(command, Command::Mit(Mit { kp_nm_rad, kd_nm_s_rad, t_nm, .. })
                if *kp_nm_rad == 0.0 && *kd_nm_s_rad == 0.0 && t_nm.abs() < 0.02)
        };
        assert!(no_gains(&commands[enabled - 1].1), "joint {i}: {:?}", commands[enabled - 1]);
        let first = rig.set_points(i, protocol::Instant::ZERO).into_iter().find(|(_, m)| m.kp_nm_rad > 0.0);
        let (_, first) = first.unwrap();
        assert!(
            (f64::from(first.p_rad) - stood_rad).abs() < 1e-3 && first.v_rad_s.abs() < 0.012,
            "{first:?}"
        );
        assert_eq!(rig.motor(i, |motor| motor.status()), Status::Enabled);
    }
    assert_eq!(rig.controller().counters().replies_missed, 0);
    let moved = rig.track.iter().flat_map(|(_, q)| (0..JOINTS).map(|i| (q[i] - before[i]).abs()));
    assert!(moved.fold(0.0, f64::max) < 2e-3);
}

#[test]
fn a_range_an_id_or_a_mode_that_differs_is_refused_with_joint_register_and_both_values() {
    let velocity = |found| Mismatch {
        register: Register::VelocityMax,
        found: RegisterValue::Float(found),
        expected: RegisterValue::Float(10.0),
    };
    let mut rig = Rig::with(&settings(), |i, options| {
        if i == 3 {
            options.motor.ranges = protocol::mit::Ranges::new(12.5, 8.0, 28.0).unwrap();
        }
    });
    rig.run_to(500, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveSettingsDiffer, Some(joint(3))));
    assert_eq!(rig.controller().group().mismatch(), Some(&(joint(3), velocity(8.0))));
    assert!((0..JOINTS).all(|i| rig.motor(i, |motor| motor.status()) == Status::Disabled));
    // Corrected, and the fault cleared.
    rig.motor(3, |motor| *motor = motor_reading(3, 0.0));
    rig.clear();
    rig.run_to(500, StateKind::Idle);
    assert_eq!(rig.controller().group().mismatch(), None);
}

#[test]
fn a_motor_without_mode_and_time_out_gets_both_and_a_silent_one_is_named() {
    let mut rig = Rig::with(&settings(), |i, options| options.mode = if i == 2 { 2 } else { 1 });
    rig.run_to(500, StateKind::Idle);
    // 15 ms: the proof took it, and afterwards it is fed.
    assert_eq!(TIME_OUT_US, 15_000);
    rig.run_us(200_000);
    assert_eq!(rig.motor(2, |motor| motor.status()), Status::Enabled);
    let mut rig = Rig::new();
    rig.motor(5, |motor| motor.set_power(false));
    rig.run_to(2_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveMissing, Some(joint(5))));
}

#[test]
fn bus_is_kept_for_the_motors_that_are_held_while_another_one_is_looked_for_and_after_it_is_lost() {
    let mut rig = Rig::new();
    assert!(!rig.controller().needs_wire(), "no motor is held yet");
    rig.motor(5, |motor| motor.set_power(false));
    let enabled = |rig: &mut Rig, i| rig.motor(i, |motor| motor.status()) == Status::Enabled;
    rig.run_us(200_000);
    assert_eq!(rig.kind(), StateKind::Boot);
    assert!((0..JOINTS).all(|i| enabled(&mut rig, i) == (i != 5)));
    // The silent one does not keep others waiting: within a period the held ones have answered.
    rig.run_until(4, |rig| rig.controller().needs_wire());
    rig.run_until(4, |rig| !rig.controller().needs_wire());
    rig.run_to(2_000, StateKind::Fault);
    // The others are still held.
    rig.run_until(4, |rig| rig.controller().needs_wire());
    rig.run_until(4, |rig| !rig.controller().needs_wire());
}

#[test]
fn a_time_out_that_does_not_stop_the_motor_is_refused() {
    let mut rig = Rig::new();
    rig.motor(4, |motor| motor.faults_mut().time_out_is_dead = true);
    rig.run_to(500, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::WatchdogUnproven, Some(joint(4))));
}

#[test]
fn a_motor_that_lost_its_link_is_cleared_by_a_person_only() {
    let mut rig = Rig::ready();
    // The controller is held up by nothing: the motor is cut off from its commands, and comes back.
    rig.motor(1, |motor| motor.set_power(false));
    rig.run_to(200, StateKind::Fault);
    assert_eq!(rig.fault().unwrap().joint, Some(joint(1)));
    rig.motor(1, |motor| motor.set_power(true));
    rig.run_us(100_000);
    assert_eq!(rig.motor(1, |motor| motor.status()), Status::Disabled, "nobody enables it by himself");
    rig.clear();
    rig.run_to(500, StateKind::Idle);
    assert!(!rig.controller().group().is_homed(joint(1)), "the turn may be lost");
    assert_eq!(rig.motor(1, |motor| motor.status()), Status::Enabled);
}

#[test]
fn a_turn_that_was_lost_is_found_again_or_refused() {
    // Zero at 1.5 rad beyond half a turn: the shaft reads -1.78 at the joint's 4.5.
    let mut wide = settings();
    let limits = wide.joint.at_mut(joint(0));
    (limits.q_min_rad, limits.q_max_rad) = (0.0, 5.0);
    let lost = |rig: &mut Rig| {
        rig.motor(0, |motor| {
            motor.set_power(false);
            motor.set_power(true);
        });
    };
    let mut rig = Rig::with(&wide, |_, _| {});
    rig.motor(0, |motor| *motor = motor_reading(0, -1.783_185));
    lost(&mut rig);
    rig.run_to(500, StateKind::Idle);
    let q_rad = rig.controller().group().position(joint(0)).unwrap().q_rad;
    assert!((q_rad - 4.5).abs() < 2e-3, "{q_rad}");
    rig.order(Order::Home { mask: 0x7F });
    rig.run_to(1_000, StateKind::Ready);
    // No turn lies within the limits.
    let mut narrow = settings();
    let limits = narrow.joint.at_mut(joint(0));
    (limits.q_min_rad, limits.q_max_rad) = (0.5, 2.0);
    let mut rig = Rig::with(&narrow, |_, _| {});
    rig.run_to(500, StateKind::Idle);
    rig.order(Order::Home { mask: 1 });
    rig.run_to(200, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::HomingFailed, Some(joint(0))));
}

#[test]
fn a_range_that_does_not_hold_the_limits_of_the_joint_is_refused() {
    let mut wide = settings();
    let limits = wide.joint.at_mut(joint(2));
    (limits.q_min_rad, limits.offset_rad, limits.inverted) = (-7.0, 6.0, true);
    let mut rig = Rig::with(&wide, |_, _| {});
    rig.run_to(500, StateKind::Fault);
    let (refused, mismatch) = *rig.controller().group().mismatch().unwrap();
    assert_eq!(refused, joint(2));
    assert_eq!(mismatch.to_string(), "register 21 of the motor holds 12.5, the settings need 13");
}

#[test]
fn a_motor_that_was_left_on_is_refused_and_keeps_its_load_until_a_person_resets_it() {
    let mut rig = Rig::new();
    let leave_on = |rig: &mut Rig| {
        let (frame, _) = Command::Enable.encode(id(2), &ranges(2)).unwrap();
        rig.motor(2, |motor| protocol::Node::handle_frame(motor, protocol::Instant::ZERO, &frame));
    };
    leave_on(&mut rig);
    rig.run_to(500, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::WatchdogUnproven, Some(joint(2))));
    assert_eq!(rig.motor(2, |motor| motor.status()), Status::Enabled);
    rig.clear();
    rig.run_to(500, StateKind::Idle);
}
