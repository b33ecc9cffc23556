//! What ends a motion, and what the motors do then: these arms have no brakes.

use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::orders::Order;
use firmware::state::StateKind;
use protocol::mit::{Command, State, Status};
use protocol::{Duration, Instant};

use crate::rig::{JOINTS, PERIOD_US, Rig, TIME_OUT_US, joint, master, quintic_file, ranges, settings};

const PERIOD: Duration = Duration::from_micros(PERIOD_US);

/// From `since` on each set point of the joint is slower than the one before, by what it may brake with, until it stands.
fn brakes_from(rig: &Rig, index: usize, since: Instant) {
    let limits = *settings().joint.at(joint(index));
    let step = f64::from(limits.a_max_rad_s2) * PERIOD_US as f64 * 1e-6;
    let speeds: Vec<f64> =
        rig.set_points(index, since).iter().map(|(_, mit)| f64::from(mit.v_rad_s.abs())).collect();
    // Half a step of the velocity field, twice.
    let raw = 2.0 * f64::from(ranges(index).v_max_rad_s()) / 4095.0;
    let mut wanted = speeds[0];
    assert!(wanted > 0.5, "joint {index} moves: {wanted}");
    for speed in &speeds[1..] {
        wanted = (wanted - step).max(0.0);
        assert!((speed - wanted).abs() <= 2.0 * raw, "joint {index}: {speed} {wanted}");
    }
    assert!(wanted == 0.0);
}

/// Healthy motors stand where they stopped, with torque.
fn others_are_held(rig: &mut Rig, lost: usize) {
    let before = rig.shafts();
    rig.run_us(1_000_000);
    let after = rig.shafts();
    for i in (0..JOINTS).filter(|i| *i != lost) {
        assert_eq!(rig.motor(i, |motor| motor.status()), Status::Enabled, "joint {i}");
        assert!((after[i] - before[i]).abs() < 2e-3, "joint {i}: {} {}", before[i], after[i]);
    }
}

#[test]
fn a_motor_that_falls_silent_stops_all_within_a_period_and_is_switched_off() {
    let mut rig = Rig::moving();
    let cut = rig.now();
    rig.motor(2, |motor| motor.set_power(false));
    rig.run_until(50, |rig| rig.kind() != StateKind::Running);
    // Two answers in a row must be missing.
    let noticed = rig.now();
    assert!(noticed <= cut + PERIOD * 4, "{noticed:?} {cut:?}");
    rig.run_to(1_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveSilent, Some(joint(2))));
    for i in (0..JOINTS).filter(|i| *i != 2) {
        // The rig looks each millisecond: what was sent in the period before is the last set point of the path.
        brakes_from(&rig, i, noticed.saturating_sub(PERIOD));
    }
    assert!(rig.commands(2, noticed).iter().any(|(_, command)| *command == Command::Disable));
    assert!(rig.set_points(2, noticed + PERIOD).is_empty(), "nothing is left that could act on its return");
    others_are_held(&mut rig, 2);
    assert!(rig.set_points(2, noticed + PERIOD).is_empty());
}

#[test]
fn a_motor_that_reports_no_torque_stops_all_with_its_cause() {
    let mut rig = Rig::moving();
    let cut = rig.now();
    rig.motor(4, |motor| {
        motor.set_power(false);
        motor.set_power(true);
    });
    rig.run_until(50, |rig| rig.kind() != StateKind::Running);
    assert!(rig.now() <= cut + PERIOD * 2);
    rig.run_to(1_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::DriveError, Some(joint(4))));
    others_are_held(&mut rig, 4);
    assert_eq!(rig.motor(4, |motor| motor.status()), Status::Disabled);
    // Cleared by a person it is looked for; the others stay as they are.
    let from = rig.now();
    rig.clear();
    rig.run_to(500, StateKind::Idle);
    assert!((0..JOINTS).all(|i| rig.motor(i, |motor| motor.status()) == Status::Enabled));
    let is_power = |c: &Command| matches!(c, Command::Enable | Command::Disable | Command::ClearFault);
    for i in (0..JOINTS).filter(|i| *i != 4) {
        assert!(!rig.commands(i, from).iter().any(|(_, command)| is_power(command)), "joint {i}");
        assert!(rig.controller().group().is_homed(joint(i)));
    }
}

#[test]
fn motors_without_commands_stop_by_themselves_and_nothing_acts_when_the_bus_is_back() {
    let mut rig = Rig::moving();
    rig.cut_commands(Duration::from_millis(300));
    rig.run_us(u64::from(TIME_OUT_US) + PERIOD_US + 1_000);
    assert!((0..JOINTS).all(|i| rig.motor(i, |motor| motor.status()) == Status::LinkLost));
    rig.run_to(1_000, StateKind::Fault);
    assert_eq!(rig.fault().unwrap().cause, Cause::DriveSilent);
    rig.run_us(600_000);
    let back = rig.now();
    rig.run_us(500_000);
    assert!((0..JOINTS).all(|i| rig.set_points(i, back).is_empty()));
    assert!((0..JOINTS).all(|i| rig.motor(i, |motor| motor.status()) == Status::LinkLost));
    rig.clear();
    rig.run_to(500, StateKind::Idle);
}

#[test]
fn stale_answers_stop_the_group_with_the_joint() {
    let mut rig = Rig::moving();
    let froze = rig.now();
    rig.motor(1, |motor| motor.faults_mut().answers_are_stale = true);
    rig.run_until(50, |rig| rig.kind() != StateKind::Running);
    assert!(rig.now() <= froze + PERIOD * 4);
    rig.run_to(1_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::PositionFrozen, Some(joint(1))));
    others_are_held(&mut rig, 1);
    // Answers that stop as the motion begins.
    let mut rig = Rig::ready();
    rig.start(&quintic_file());
    rig.run_us(10_000);
    rig.motor(1, |motor| motor.faults_mut().answers_are_stale = true);
    rig.run_to(1_000, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::PositionFrozen, Some(joint(1))));
    assert!(rig.shafts()[1].abs() < 0.05, "noticed early: {}", rig.shafts()[1]);
}

/// What looks like an answer of a motor far away from where it is.
fn forged(rig: &mut Rig, index: usize) -> protocol::Frame {
    let p_rad = rig.shafts()[index] as f32 + 1.0;
    let state = State {
        nibble: index as u8 + 1,
        status: Status::Enabled,
        p_rad,
        v_rad_s: 0.0,
        t_nm: 0.0,
        transistors_c: 25,
        rotor_c: 25,
    };
    state.encode(master(index), &ranges(index))
}

/// The time at which the burst of the next period begins, and some more.
fn into_period(rig: &mut Rig, us: u64) {
    let sent = rig.set_points(0, Instant::ZERO).last().unwrap().0;
    let next = sent + PERIOD + Duration::from_micros(us);
    let wait = next.saturating_since(rig.now()).as_micros() % PERIOD_US;
    rig.run_us(wait);
}

#[test]
fn one_torn_answer_is_left_out_and_a_second_one_stops_the_group() {
    for torn in [1, 2] {
        let mut rig = Rig::moving();
        for _ in 0..torn {
            into_period(&mut rig, 150);
            let frame = forged(&mut rig, 0);
            rig.forge(&frame);
            rig.run_us(1_500);
        }
        rig.run_us(700_000);
        match torn {
            1 => rig.run_to(1_500, StateKind::Ready),
            _ => {
                let fault = rig.fault().unwrap();
                assert_eq!((fault.cause, fault.joint), (Cause::ReplyImplausible, Some(joint(0))));
            }
        }
    }
}

#[test]
fn answers_that_nobody_waits_for_change_nothing() {
    let mut rig = Rig::moving();
    for _ in 0..20 {
        // After all answers of the period, and before the command can have been on the bus.
        for us in [2_300, 2_900] {
            into_period(&mut rig, us);
            for i in 0..JOINTS {
                let frame = forged(&mut rig, i);
                rig.forge(&frame);
            }
        }
    }
    rig.run_us(700_000);
    rig.run_to(1_500, StateKind::Ready);
}

#[test]
fn a_stop_holds_the_arm_and_the_next_motion_begins_from_there() {
    for along_the_path in [true, false] {
        let mut rig = Rig::moving();
        let ordered = rig.now();
        if along_the_path {
            rig.order(Order::Stop);
        } else {
            rig.stop_now();
        }
        rig.run_to(1_500, StateKind::Stopped);
        if !along_the_path {
            (0..JOINTS).for_each(|i| brakes_from(&rig, i, ordered));
        }
        others_are_held(&mut rig, JOINTS);
        let before = rig.shafts();
        let hold = Duration::from_millis(200);
        rig.order(Order::Jog { joint: joint(0), qd_rad_s: -0.2, hold });
        rig.run_to(1_000, StateKind::Ready);
        let after = rig.shafts();
        assert!((before[0] - after[0] - 0.04).abs() < 5e-3, "{} {}", before[0], after[0]);
        assert!((1..JOINTS).all(|i| (after[i] - before[i]).abs() < 1e-3));
    }
}

#[test]
fn a_stop_while_nothing_moves_moves_nothing() {
    let mut rig = Rig::ready();
    rig.order(Order::Stop);
    rig.run_to(200, StateKind::Stopped);
    others_are_held(&mut rig, JOINTS);
    assert!(rig.shafts().iter().all(|q_rad| q_rad.abs() < 2e-3));
    // The next start clears the halt.
    rig.start(&quintic_file());
    rig.run_us(1_200_000);
    rig.run_to(1_500, StateKind::Ready);
}
