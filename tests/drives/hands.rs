//! What opens the hand: an ODrive of its own, and an output of a CANopen servo.

use firmware::fault::Cause;
use firmware::groups::cia402::{self, Cia402, GripperOutput, Servo};
use firmware::groups::odrive::{self, GripperAxis, Home, Odrive};
use firmware::orders::Order;
use firmware::state::StateKind;
use hil_sim::drive::cia402::{CanopenServo, ServoOptions};
use hil_sim::drive::odrive::{OdriveAxis, OdriveOptions};
use protocol::odrive::Version;
use protocol::{Duration, Instant};

use crate::rig::joint;
use crate::six::{JOINTS, Six, stands_rad};
use crate::{cia402_rig, odrive_rig};

const OPEN_RAD: f32 = -1.0;
/// Place of the axis of the fingers.
const FINGERS: usize = JOINTS;
/// Bit of the output.
const BIT: u8 = 16;

/// Six axes, and one that moves fingers; they are closed.
fn with_fingers() -> Six<Odrive, OdriveAxis> {
    let axes: [odrive::Axis; JOINTS] =
        core::array::from_fn(|i| odrive_rig::axis(i, Version::V06, Home::Joint));
    let gripper = GripperAxis {
        axis: odrive_rig::axis(FINGERS, Version::V06, Home::Joint),
        open_rad: OPEN_RAD,
        closed_rad: 0.0,
    };
    let options = odrive::Options::new(&axes).and_then(|all| all.with_gripper(gripper)).unwrap();
    let motor = |i| {
        let options = OdriveOptions {
            gear: odrive_rig::GEAR.into(),
            counted: 1.0,
            watchdog: Some(Duration::from_micros(odrive_rig::TIME_OUT_US.into())),
            estimates: None,
            ..OdriveOptions::new(odrive_rig::node(i), Version::V06)
        };
        OdriveAxis::new(options, if i == FINGERS { 0.0 } else { stands_rad(i) })
    };
    let motors = (0..=FINGERS).map(motor).collect();
    Six::six(&odrive_rig::settings(), Odrive::new(options), motors, OdriveAxis::shaft_rad)
}

fn fingers_rad(rig: &mut Six<Odrive, OdriveAxis>) -> f64 {
    rig.drive(FINGERS, |axis, _| axis.shaft_rad())
}

#[test]
fn fingers_stand_until_the_first_order_then_hold_what_was_ordered_also_in_a_halt() {
    let mut rig = with_fingers().made_ready(2_000);
    assert!(fingers_rad(&mut rig).abs() < 1e-3);
    rig.order(Order::Gripper { open: true });
    // The shaft of the bench is heavy for the current of the axis.
    rig.run_us(2_000_000);
    assert!((fingers_rad(&mut rig) + 1.0).abs() < 5e-3, "{}", fingers_rad(&mut rig));
    rig.stop_now();
    rig.run_us(500_000);
    assert!((fingers_rad(&mut rig) + 1.0).abs() < 5e-3, "{}", fingers_rad(&mut rig));
    rig.order(Order::Gripper { open: false });
    rig.run_us(2_000_000);
    assert!(fingers_rad(&mut rig).abs() < 5e-3, "{}", fingers_rad(&mut rig));
}

/// The axis of the fingers has no part in the loop: the others go on as without it.
#[test]
fn an_arm_with_fingers_follows_its_plan_and_the_bus_has_room() {
    let mut rig = with_fingers().made_ready(2_000);
    let start = rig.start();
    rig.run_to(3_000, StateKind::Ready);
    let away_rad = rig.away_rad(start).into_iter().fold(0.0, f64::max);
    assert!(away_rad < 5e-3, "{away_rad}");
    assert!(fingers_rad(&mut rig).abs() < 1e-3);
    assert!(rig.load(start) < 0.8, "{}", rig.load(start));
}

/// By its next heartbeat, or when none has come for half a second: the arm stops along its plan, and is held.
#[test]
fn an_axis_of_the_fingers_that_fails_or_is_silent_stops_the_arm_along_its_plan() {
    for (fault, periods) in [
        ((|axis, _| axis.fail(0x2000)) as fn(&mut OdriveAxis, Instant), 60),
        ((|axis, _| axis.faults_mut().is_silent = true), 240),
    ] {
        let mut rig = with_fingers().made_ready(2_000).moved_on();
        let since = rig.now();
        rig.drive(FINGERS, fault);
        rig.run_until(900, |rig| rig.kind() != StateKind::Running);
        let took = rig.now().saturating_since(since);
        assert!(took <= Duration::from_micros(odrive_rig::PERIOD_US) * periods, "{took:?}");
        rig.run_to(1_500, StateKind::Fault);
        let found = rig.fault().unwrap();
        assert_eq!((found.cause, found.joint), (Cause::GripperUnanswered, Some(joint(FINGERS))));
        rig.run_us(600_000);
        let before = rig.shafts();
        rig.run_us(300_000);
        for (before, after) in before.into_iter().zip(rig.shafts()) {
            assert!((before - after).abs() < 1e-3, "{before} {after}");
        }
    }
}

#[test]
fn an_axis_of_the_fingers_that_does_not_answer_is_missing_and_nothing_gets_ready() {
    let mut rig = with_fingers();
    rig.drive(FINGERS, |axis, _| axis.faults_mut().is_silent = true);
    rig.refused(Cause::DriveMissing, FINGERS);
}

/// Six servos; an output of the last one opens the hand.
fn with_output() -> Six<Cia402, CanopenServo> {
    let servos: [Servo; JOINTS] = core::array::from_fn(|i| Servo {
        node: cia402_rig::node(i),
        counts_per_turn: 409_600,
        rated_mnm: 50_000,
        home: cia402::Home::Absolute,
        follow: cia402::Follow::Cyclic,
    });
    let gripper = GripperOutput { joint: joint(JOINTS - 1), bit: BIT };
    let options = cia402::Options::new(&servos).and_then(|all| all.with_gripper(gripper)).unwrap();
    let servo = |i| {
        let gripper_bit = (i == JOINTS - 1).then_some(BIT);
        CanopenServo::new(
            ServoOptions { gripper_bit, ..ServoOptions::of(cia402_rig::node(i)) },
            stands_rad(i),
        )
    };
    let servos = (0..JOINTS).map(servo).collect();
    Six::six(&cia402_rig::settings(), Cia402::new(options), servos, CanopenServo::shaft_rad)
}

fn output(rig: &mut Six<Cia402, CanopenServo>) -> (bool, Instant) {
    rig.drive(JOINTS - 1, |servo, _| servo.gripper().unwrap())
}

#[test]
fn an_output_switches_at_once_when_it_is_ordered_and_stays_so_in_a_halt_and_a_search() {
    let mut rig = with_output().made_ready(2_000);
    assert!(!output(&mut rig).0);
    let ordered = rig.now();
    rig.order(Order::Gripper { open: true });
    rig.run_us(5_000);
    let (is_open, since) = output(&mut rig);
    // Behind the frames of one period.
    assert!(is_open && since.saturating_since(ordered) < Duration::from_micros(1_500), "{since:?}");
    rig.stop_now();
    rig.run_us(500_000);
    assert_eq!(output(&mut rig), (true, since));
    rig.order(Order::Gripper { open: false });
    rig.run_us(5_000);
    assert!(!output(&mut rig).0);
}

/// The servo that has it starts again: it forgets its outputs, and gets them back when it is found.
#[test]
fn an_order_to_the_output_is_given_again_to_a_servo_that_started_anew() {
    let mut rig = with_output().made_ready(2_000);
    rig.order(Order::Gripper { open: true });
    rig.run_us(20_000);
    rig.drive(JOINTS - 1, |servo, now| {
        servo.set_power(now, false);
        servo.set_power(now, true);
    });
    rig.run_to(1_500, StateKind::Fault);
    assert!(!output(&mut rig).0, "without power");
    rig.clear();
    rig.run_to(4_000, StateKind::Idle);
    assert!(output(&mut rig).0);
}
