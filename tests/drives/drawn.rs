//! Drawn faults at drawn times of a motion, for each family of six drives: what the controller reports is what the shafts did.
//!
//! Wrong: ready although the plan was not followed, or a healthy joint that is not held. Silent: a drive with a lasting fault, and neither a
//! stop nor a fault.

use firmware::group::DriveGroup;
use firmware::groups::cia402::Cia402;
use firmware::groups::odrive::Odrive;
use firmware::state::StateKind;
use hil_sim::drive::bench::ShaftMotor;
use hil_sim::drive::cia402::CanopenServo;
use hil_sim::drive::odrive::OdriveAxis;
use hil_sim::rng::Rng;
use protocol::{Frame, Instant};

use crate::six::{JOINTS, Six};
use crate::{cia402_ip, cia402_rig};

/// Motions of each family.
const RUNS: u64 = 40;
/// Farther from the plan than a motion that ends well, rad.
const AWAY_RAD: f64 = 5e-3;
/// A joint that is held stays within this, rad.
const HELD_RAD: f64 = 2e-3;

/// A fault, its name, and whether it lasts: then the motion must not end well.
type Row<M> = (&'static str, bool, fn(&mut M, Instant));

const SERVOS: [Row<CanopenServo>; 8] = [
    ("none", false, |_, _| {}),
    ("silent", true, |servo, _| servo.faults_mut().is_silent = true),
    ("stale", true, |servo, _| servo.faults_mut().answers_are_stale = true),
    ("torn once", false, |servo, _| servo.faults_mut().torn_answers = 1),
    ("torn twice", true, |servo, _| servo.faults_mut().torn_answers = 2),
    ("every seventh lost", false, |servo, _| servo.faults_mut().answer_lost_every = 7),
    ("hot", true, |servo, now| servo.fail(now, 0x4310)),
    ("no power", true, |servo, now| servo.set_power(now, false)),
];

const AXES: [Row<OdriveAxis>; 10] = [
    ("none", false, |_, _| {}),
    ("silent", true, |axis, _| axis.faults_mut().is_silent = true),
    ("stale", true, |axis, _| axis.faults_mut().estimates_are_stale = true),
    ("no number", true, |axis, _| axis.faults_mut().estimates_are_nan = true),
    ("torn once", false, |axis, _| axis.faults_mut().torn_estimates = 1),
    ("torn twice", true, |axis, _| axis.faults_mut().torn_estimates = 2),
    ("every seventh lost", false, |axis, _| axis.faults_mut().answer_lost_every = 7),
    ("idle without an error", true, |axis, _| axis.fall_idle()),
    ("hot", true, |axis, _| axis.fail(0x2000)),
    ("no power", true, |axis, now| axis.set_power(now, false)),
];

fn check<G: DriveGroup<Packet = Frame>, M: ShaftMotor>(
    rows: &[Row<M>],
    new: impl Fn() -> Six<G, M>,
    is_held: impl Fn(&M) -> bool,
) {
    let (mut ends, mut stops) = (0, 0);
    for seed in 0..RUNS {
        let mut rng = Rng::stream(seed, "drawn faults");
        let (name, lasts, fault) = rows[(seed as usize) % rows.len()];
        let index = rng.below(JOINTS as u64) as usize;
        let mut rig = new();
        let start = rig.start();
        // Up to the last tenth of the plan, in which little moves.
        rig.run_us(20_000 + rng.below(900_000));
        rig.drive(index, fault);
        rig.run_until(2_500, |rig| !matches!(rig.kind(), StateKind::Running | StateKind::Stopping));
        let what = format!("seed {seed}, {name} of joint {index}: {:?}", rig.controller().state());
        let is_ready = rig.kind() == StateKind::Ready;
        rig.run_us(600_000);
        let before = rig.shafts();
        rig.run_us(200_000);
        let after = rig.shafts();
        let healthy = (0..JOINTS).filter(|i| !lasts || *i != index);
        for i in healthy {
            assert!(rig.drive(i, |drive, _| is_held(drive)), "wrong: {what}: joint {i} has no torque");
            assert!((after[i] - before[i]).abs() < HELD_RAD, "wrong: {what}: joint {i} moves");
        }
        if is_ready {
            ends += 1;
            let away_rad = rig.away_rad(start).into_iter().fold(0.0, f64::max);
            assert!(away_rad < AWAY_RAD, "wrong: {what}: {away_rad} rad from the plan");
            // One that struck when the motion was over is found while the arm stands.
            assert!(!lasts || rig.kind() == StateKind::Fault, "silent: {what}");
        } else {
            stops += 1;
            assert!(rig.fault().is_some_and(|fault| fault.joint.is_some()), "silent: {what}");
        }
    }
    println!("{RUNS} motions: {ends} ended as planned, {stops} were stopped; 0 wrong, 0 silent");
    assert!(ends >= 10 && stops >= 10, "{ends} {stops}: too little happens to show anything");
}

#[test]
fn servos_with_drawn_faults_do_what_the_controller_reports() {
    check(&SERVOS, Six::<Cia402, CanopenServo>::ready, |servo| {
        servo.state() == protocol::canopen::cia402::State::OperationEnabled
    });
}

#[test]
fn modules_that_interpolate_with_drawn_faults_do_what_the_controller_reports() {
    let ready = || cia402_rig::Rig::interpolating(cia402_ip::short).made_ready(2_000);
    check(&SERVOS, ready, |servo| servo.state() == protocol::canopen::cia402::State::OperationEnabled);
}

#[test]
fn odrives_with_drawn_faults_do_what_the_controller_reports() {
    check(&AXES, Six::<Odrive, OdriveAxis>::ready, |axis| {
        axis.state() == protocol::odrive::AxisState::ClosedLoop
    });
}
