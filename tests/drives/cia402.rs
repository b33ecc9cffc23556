//! CANopen servos: found, configured, held, led along a plan; and each of their faults with its number and within its time.

use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::groups::cia402::{Found, Home};
use firmware::orders::Order;
use firmware::state::StateKind;
use hil_sim::drive::cia402::ServoOptions;
use protocol::canopen::cia402::State;
use protocol::canopen::{Function, nmt};
use protocol::{Duration, Instant};

use crate::cia402_rig::{PERIOD_US, Rig, node, settings};
use crate::rig::joint;
use crate::six::{JOINTS, stands_rad};

const PERIOD: Duration = Duration::from_micros(PERIOD_US);
/// Longest search: boot, about 90 exchanges with each servo, the proof of 30 ms, rest.
const FIND_MS: u64 = 1_500;

/// Healthy servos stand where they stopped, with torque.
pub(crate) fn others_are_held(rig: &mut Rig, lost: usize) {
    let before = rig.shafts();
    rig.run_us(500_000);
    let after = rig.shafts();
    for i in (0..JOINTS).filter(|i| *i != lost) {
        assert_eq!(rig.drive(i, |servo, _| servo.state()), State::OperationEnabled, "joint {i}");
        assert!((after[i] - before[i]).abs() < 1e-3, "joint {i}: {} {}", before[i], after[i]);
    }
}

#[test]
fn servos_are_found_without_a_motion_and_set_up_before_the_first_sync() {
    let mut rig = Rig::new();
    rig.run_to(FIND_MS, StateKind::Idle);
    for i in 0..JOINTS {
        assert_eq!(rig.drive(i, |servo, _| servo.state()), State::OperationEnabled);
        let mut object = |index, sub| rig.drive(i, |servo, _| servo.object(index, sub)).unwrap();
        assert_eq!(object(0x60C2, 1), [2]);
        assert_eq!(object(0x60C2, 2), [(-3_i8) as u8]);
        assert_eq!(object(0x6061, 0), [8]);
        assert_eq!(object(0x1016, 1), [30, 0, 0x7F, 0]);
        assert_eq!(object(0x1A00, 0), [2]);
        // Turns per minute of the motor, behind a gear of 100.
        let wanted = settings().joint.at(joint(i)).v_max_rad_s * 60.0 / core::f32::consts::TAU * 100.0;
        let limit = u32::from_le_bytes(object(0x6080, 0).try_into().unwrap());
        assert!((wanted - 0.1..wanted + 1.1).contains(&(limit as f32)), "{limit} {wanted}");
        // Long before the word that gives torque the target is where the shaft stands.
        let words = rig.targets(i, Instant::ZERO);
        let enabled = words.iter().position(|(_, word, _)| *word == 0x0F).unwrap();
        assert!(enabled >= 2);
        assert!(words.iter().all(|(_, _, q_rad)| (q_rad - stands_rad(i)).abs() < 1e-4), "{words:?}");
    }
    let first_sync = rig.frames_of(Function::Sync, Instant::ZERO)[0].0;
    let last_map = (0..JOINTS).flat_map(|i| rig.frames_of(Function::SdoToNode(node(i)), Instant::ZERO));
    let last_map = last_map.map(|(at, _)| at).max().unwrap();
    assert!(last_map < first_sync, "{last_map:?} {first_sync:?}");
    assert_eq!(rig.controller().counters().replies_missed, 0);
    let moved = rig.track.iter().flat_map(|(_, q)| (0..JOINTS).map(|i| (q[i] - stands_rad(i)).abs()));
    assert!(moved.fold(0.0, f64::max) < 1e-4);
}

#[test]
fn units_modes_torque_maps_and_a_mode_that_is_not_shown_are_refused_with_the_object() {
    type Change = fn(&mut ServoOptions);
    let cases: [(Change, u16); 4] = [
        (|o| o.gear = 160, 0x6091),
        (|o| o.modes = 0x43, 0x6502),
        (|o| o.rated_nm = 40.0, 0x6076),
        (|o| o.maps_are_fixed = true, 0x1600),
    ];
    for (change, index) in cases {
        let mut rig = Rig::with(&settings(), Home::Absolute, |i, options| {
            if i == 3 {
                change(options);
            }
        });
        rig.refused(Cause::DriveSettingsDiffer, 3);
        let (at, mismatch) = *rig.controller().group().mismatch().unwrap();
        assert_eq!((at, mismatch.object.index), (joint(3), index), "{mismatch}");
        assert!(rig.frames_of(Function::Sync, Instant::ZERO).is_empty());
    }
    let mut rig = Rig::new();
    rig.drive(2, |servo, _| servo.faults_mut().mode_is_never_shown = true);
    rig.refused(Cause::DriveSettingsDiffer, 2);
    let (_, mismatch) = *rig.controller().group().mismatch().unwrap();
    assert_eq!((mismatch.object.index, mismatch.found, mismatch.expected), (0x6061, Found::Value(0), 8));
    assert_eq!(mismatch.to_string(), "object 6061:00 of the servo holds 0x0, the settings need 0x8");
}

#[test]
fn a_silent_servo_a_dead_supervision_and_one_that_was_left_on_are_refused() {
    let mut rig = Rig::new();
    rig.drive(5, |servo, _| servo.faults_mut().is_silent = true);
    rig.refused(Cause::DriveMissing, 5);
    rig.drive(5, |servo, _| servo.faults_mut().is_silent = false);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
    let mut rig = Rig::new();
    rig.drive(1, |servo, _| servo.faults_mut().supervision_is_dead = true);
    rig.refused(Cause::WatchdogUnproven, 1);
    // The controller before has ended: its heartbeat stayed away.
    let mut rig = Rig::new();
    rig.run_us(201_000);
    (0..JOINTS).for_each(|i| rig.drive(i, |servo, now| servo.fail(now, 0x8130)));
    rig.run_to(FIND_MS, StateKind::Idle);
    // A servo in another fault from before.
    let mut rig = Rig::new();
    rig.run_us(201_000);
    rig.drive(4, |servo, now| servo.fail(now, 0x4310));
    rig.refused(Cause::DrivePowerFault, 4);
    rig.clear();
    rig.run_to(FIND_MS, StateKind::Idle);
    // Object 603F is 0. The history of errors still has an old loss of the heartbeat.
    let mut rig = Rig::new();
    rig.run_us(201_000);
    rig.drive(4, |servo, now| servo.fail(now, 0));
    rig.drive(4, |servo, now| servo.emergency(now, 0x8130));
    rig.refused(Cause::DriveError, 4);
}

#[test]
fn six_joints_follow_a_plan_at_2_ms_and_the_bus_is_not_full() {
    let mut rig = Rig::ready();
    let start = rig.start();
    let from = rig.now();
    rig.run_us(1_000_000);
    let load = rig.load(from);
    rig.run_to(1_500, StateKind::Ready);
    let worst = rig.away_rad(start);
    println!("away {worst:?} rad, load {load}");
    assert!(worst.iter().all(|away| (1e-5..3e-3).contains(away)), "{worst:?}");
    assert_eq!(rig.controller().counters().cycles_late, 0);
    assert_eq!(rig.controller().counters().replies_missed, 0);
    assert!((0.5..0.85).contains(&load), "{load}");
}

#[test]
fn a_silent_servo_stops_all_within_three_periods() {
    let mut rig = Rig::moving();
    let cut = rig.now();
    rig.drive(2, |servo, _| servo.faults_mut().is_silent = true);
    rig.ends_with(cut, 4, Cause::DriveSilent, 2);
    // From the next set point on each joint is slower than before.
    for i in (0..JOINTS).filter(|i| *i != 2) {
        let targets = rig.targets(i, cut + PERIOD * 3);
        let steps: Vec<f64> = targets.windows(2).map(|pair| (pair[1].2 - pair[0].2).abs()).collect();
        let count = std::f64::consts::TAU / 409_600.0;
        assert!(
            steps[0] > 1e-3 && steps.windows(2).all(|pair| pair[1] <= pair[0] + 2.0 * count),
            "joint {i}"
        );
        assert!(steps.last().is_some_and(|step| *step < count));
    }
    others_are_held(&mut rig, 2);
}

#[test]
fn an_emergency_ends_the_motion_with_its_cause_and_code() {
    for (code, cause) in [
        (0x8110, Cause::DriveError),
        (0x2310, Cause::OverCurrent),
        (0x3220, Cause::DriveSupply),
        (0x4310, Cause::DrivePowerFault),
        (0x8611, Cause::DriveTowError),
    ] {
        let mut rig = Rig::moving();
        let since = rig.now();
        // 8110 is a note: the drive goes on.
        rig.drive(1, |servo, now| match code {
            0x8110 => servo.emergency(now, code),
            _ => servo.fail(now, code),
        });
        rig.ends_with(since, 2, cause, 1);
        let state = rig.controller().group().readings(joint(1)).state.unwrap();
        assert_eq!(state >> 16, u32::from(code));
        others_are_held(&mut rig, 1);
        // A person clears it.
        rig.clear();
        rig.run_to(FIND_MS, StateKind::Idle);
        others_are_held(&mut rig, JOINTS);
    }
}

#[test]
fn a_lost_heartbeat_and_a_node_that_starts_again_end_the_motion() {
    let mut rig = Rig::moving();
    let since = rig.now();
    rig.drive(3, |servo, _| servo.faults_mut().heartbeat_is_lost = true);
    rig.ends_with(since, 101, Cause::DriveSilent, 3);
    // Cleared while it is still lost, it is a fault again.
    rig.clear();
    rig.run_us(50_000);
    rig.refused(Cause::DriveSilent, 3);
    let mut rig = Rig::moving();
    let since = rig.now();
    rig.drive(3, |servo, now| {
        protocol::Node::handle_frame(servo, now, &nmt::Command::ResetNode.encode(None));
    });
    rig.ends_with(since, 4, Cause::DriveSilent, 3);
    others_are_held(&mut rig, 3);
    let mut rig = Rig::moving();
    let since = rig.now();
    rig.drive(3, |servo, now| {
        protocol::Node::handle_frame(servo, now, &nmt::Command::PreOperational.encode(None));
    });
    rig.ends_with(since, 4, Cause::DriveSilent, 3);
}

#[test]
fn one_torn_position_is_left_out_two_in_a_row_and_stale_ones_stop_the_group() {
    let mut rig = Rig::moving();
    rig.drive(0, |servo, _| servo.faults_mut().torn_answers = 1);
    rig.run_us(100_000);
    assert_eq!(rig.kind(), StateKind::Running);
    let mut rig = Rig::moving();
    let since = rig.now();
    rig.drive(0, |servo, _| servo.faults_mut().torn_answers = 2);
    rig.ends_with(since, 4, Cause::ReplyImplausible, 0);
    let mut rig = Rig::moving();
    let since = rig.now();
    rig.drive(4, |servo, _| servo.faults_mut().answers_are_stale = true);
    rig.run_until(100, |rig| rig.kind() != StateKind::Running);
    assert!(rig.now() <= since + PERIOD * 8);
    rig.run_to(1_500, StateKind::Fault);
    let fault = rig.fault().unwrap();
    assert_eq!((fault.cause, fault.joint), (Cause::PositionFrozen, Some(joint(4))));
}

#[test]
fn process_data_that_nobody_waits_for_change_nothing() {
    let mut rig = Rig::moving();
    for _ in 0..20 {
        // After all answers of the period, and again before the next SYNC can have been answered.
        let sync = rig.frames_of(Function::Sync, Instant::ZERO).last().unwrap().0;
        for us in [1_300, 2_060] {
            let at = sync + Duration::from_micros(us);
            rig.run_us(at.saturating_since(rig.now()).as_micros());
            for i in 0..JOINTS {
                let frame = Function::Tpdo(1, node(i)).frame([0x27, 0x16, 0, 0, 1, 0]);
                rig.forge(&frame);
            }
        }
    }
    rig.run_us(700_000);
    rig.run_to(1_500, StateKind::Ready);
}

#[test]
fn lost_answers_are_bridged() {
    let mut rig = Rig::ready();
    rig.drive(3, |servo, _| servo.faults_mut().answer_lost_every = 7);
    rig.start();
    rig.run_us(1_000_000);
    rig.run_to(1_500, StateKind::Ready);
    assert!(rig.controller().counters().replies_missed > 40);
}

#[test]
fn a_stop_holds_the_arm_and_the_next_motion_begins_from_there() {
    for along_the_path in [true, false] {
        let mut rig = Rig::moving();
        if along_the_path {
            rig.order(Order::Stop);
        } else {
            rig.stop_now();
        }
        rig.run_to(1_500, StateKind::Stopped);
        others_are_held(&mut rig, JOINTS);
        let before = rig.shafts();
        rig.order(Order::Jog { joint: joint(0), qd_rad_s: -0.2, hold: Duration::from_millis(200) });
        rig.run_to(1_000, StateKind::Ready);
        let after = rig.shafts();
        assert!((before[0] - after[0] - 0.04).abs() < 2e-3, "{} {}", before[0], after[0]);
        assert!((1..JOINTS).all(|i| (after[i] - before[i]).abs() < 1e-4));
    }
}

#[test]
fn servos_with_incremental_encoders_take_the_place_as_zero() {
    let incremental = |_: usize, options: &mut ServoOptions| options.is_absolute = false;
    let mut rig = Rig::with(&settings(), Home::Here, incremental);
    rig.run_to(FIND_MS, StateKind::Idle);
    rig.order(Order::Jog { joint: joint(2), qd_rad_s: 0.2, hold: Duration::from_millis(200) });
    rig.run_to(1_000, StateKind::Idle);
    assert!(rig.shafts()[2] > 0.03);
    rig.order(Order::Home { mask: 0x3F });
    rig.run_to(3_000, StateKind::Ready);
    assert!(rig.shafts().iter().all(|q_rad| q_rad.abs() < 1e-4), "{:?}", rig.shafts());
    let q_rad = rig.controller().group().position(joint(2)).unwrap().q_rad;
    assert!(q_rad.abs() < 1e-4, "{q_rad}");
    rig.order(Order::Jog { joint: joint(2), qd_rad_s: 0.2, hold: Duration::from_millis(200) });
    rig.run_to(1_000, StateKind::Ready);
    assert!((rig.shafts()[2] - 0.04).abs() < 2e-3);
}
