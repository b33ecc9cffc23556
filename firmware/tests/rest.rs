//! Rest is measured: no timer enters a state in which the arm stands, and all such states are supervised.

use crate::bench::*;
use firmware::fault::{Cause, Fault};
use firmware::groups::powercube::{Mode, Stage};
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::{State, StateKind};
use protocol::Duration;
use protocol::powercube::CubeState;

const STANDING: [StateKind; 4] = [StateKind::Idle, StateKind::Ready, StateKind::Armed, StateKind::Stopped];

/// Below this a joint stands, rad/s: one step of the encoder in the window of the measurement, and its settling.
const STANDS_RAD_S: f64 = 0.02;

fn fault(bench: &Bench) -> Option<Fault> {
    bench.controller.state().fault()
}

fn speed_max(bench: &Bench) -> f64 {
    bench.drives.iter().map(|drive| drive.speed().abs()).fold(0.0, f64::max)
}

/// Runs until `done`; panics if the group reports that it stands while a joint moves.
fn run_watched(bench: &mut Bench, us: u64, done: impl Fn(&Bench) -> bool) {
    let end = bench.now + us;
    while bench.now < end && !done(bench) {
        bench.run_for(500);
        let speed = speed_max(bench);
        assert!(
            !STANDING.contains(&bench.kind()) || speed < STANDS_RAD_S,
            "{:?} at {} us with {speed} rad/s",
            bench.kind(),
            bench.now
        );
    }
}

fn thrown() -> Bench {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench
}

fn parking() -> Bench {
    let mut bench = thrown();
    bench.run_until(1_500_000, |bench| {
        matches!(bench.controller.state(), State::Running { parking: Some(_), .. })
    });
    bench
}

/// Parking after a throw without feedback that began `away_rad` beside its path.
fn parking_beside(away_rad: f64) -> Bench {
    let mut settings = Settings::powercube6();
    for joint in settings.joints() {
        let joint = settings.joint.at_mut(joint);
        joint.start_tolerance_rad = 0.15;
        (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = (0.0, 0.0, 0.0);
    }
    settings.gains_certificate_crc32 = firmware::registers::certificate_crc32(&settings);
    let start = throw_start().map(|q| q + away_rad);
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &start);
    bench.start(&throw_file(3_000, true));
    bench.run_until(1_500_000, |bench| {
        matches!(bench.controller.state(), State::Running { parking: Some(_), .. })
    });
    bench
}

#[test]
fn run_ends_in_ready_when_every_joint_stands() {
    let mut bench = thrown();
    run_watched(&mut bench, 3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
}

/// Regression: 300 ms after the end of a plan the group became Ready although a joint still moved.
#[test]
fn joint_that_moves_on_after_the_plan_is_a_fault_and_never_ready() {
    for creep_rad_s in [-0.2, 0.02, 0.05] {
        let mut bench = parking();
        bench.drives[2].creep_rad_s = creep_rad_s;
        let from = bench.now;
        run_watched(&mut bench, 3_000_000, |bench| bench.kind() == StateKind::Fault);
        let after_us = bench.now - from;
        println!("creeps with {creep_rad_s} rad/s: {:?} after {after_us} us", fault(&bench));
        assert_eq!(fault(&bench).and_then(|fault| fault.joint), Some(joint(2)));
        assert!((10_000..1_500_000).contains(&after_us), "{after_us} us");
        bench.run_for(50_000);
        assert!(bench.sent_after(from, is_halt).is_some() && speed_max(&bench) < STANDS_RAD_S);
    }
}

#[test]
fn host_that_is_lost_while_the_joints_are_parked_halts_them() {
    let mut bench = parking();
    bench.drives[2].creep_rad_s = 0.012;
    bench.heartbeat = false;
    let from = bench.now;
    run_watched(&mut bench, 1_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench), Some(Fault::group(Cause::HostLost)));
    assert!((70_000..=104_000).contains(&(bench.now - from)), "{} us", bench.now - from);
}

#[test]
fn drive_that_falls_silent_while_the_joints_are_parked_halts_them() {
    let mut bench = parking();
    bench.drives[4].silent = true;
    run_watched(&mut bench, 50_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench), Some(Fault::at(Cause::DriveSilent, joint(4))));
}

#[test]
fn stop_message_in_motion_is_stopped_only_when_every_joint_stands() {
    for into_us in [100_000, 300_000, 560_000, 800_000] {
        let mut bench = thrown();
        bench.run_for(into_us);
        let at = bench.now;
        bench.stop_now();
        assert_eq!(bench.kind(), StateKind::Stopping);
        run_watched(&mut bench, 2_000_000, |bench| bench.kind() == StateKind::Stopped);
        assert_eq!(fault(&bench), Some(Fault::group(Cause::StopMessage)), "{:?}", bench.controller.state());
        let halted = bench.sent_after(at, is_halt).unwrap().as_micros() - at;
        assert!((50..=1_000).contains(&halted), "{halted} us");
        assert!((50_000..700_000).contains(&(bench.now - at)), "stopped after {} us", bench.now - at);
    }
}

#[test]
fn halt_is_repeated_until_every_joint_stands() {
    let mut bench = thrown();
    bench.run_for(300_000);
    // The halt does not reach the third drive, which is on its way to a target three radians away.
    bench.drives[2].deaf_to_halts = 2;
    bench.stop_now();
    run_watched(&mut bench, 2_000_000, |bench| bench.kind() == StateKind::Stopped);
    assert_eq!(bench.kind(), StateKind::Stopped, "{:?}", bench.controller.state());
    assert!((3..=6).contains(&bench.count_sent(is_halt)), "{}", bench.count_sent(is_halt));

    let mut bench = thrown();
    bench.run_for(300_000);
    bench.drives[2].deaf_to_halts = u32::MAX;
    bench.drives[2].watchdog_us = u64::MAX / 2;
    bench.drives[2].creep_rad_s = 0.05;
    bench.stop_now();
    run_watched(&mut bench, 4_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench).map(|fault| fault.cause), Some(Cause::RestNotReached));
    let halts = bench.count_sent(is_halt);
    bench.run_for(1_000_000);
    let more = bench.count_sent(is_halt) - halts;
    assert!((8..=11).contains(&more), "{more} halts in the second after the fault");
}

#[test]
fn joint_that_moves_while_the_group_stands_is_a_fault_with_its_name() {
    for state in [StateKind::Idle, StateKind::Ready, StateKind::Armed, StateKind::Stopped] {
        for creep_rad_s in [-0.3, 0.03, 0.002] {
            let homed = state != StateKind::Idle;
            let mut bench = Bench::new(Options { homed, ..Options::default() });
            for (drive, q) in bench.drives.iter_mut().zip(throw_start()) {
                drive.place(q);
            }
            let first = if homed { StateKind::Ready } else { StateKind::Idle };
            bench.run_until(3_000_000, |bench| bench.kind() == first);
            bench.run_for(300_000);
            match state {
                StateKind::Armed => {
                    let name = bench.upload(&throw_file(3_000, true));
                    bench.arm(name);
                }
                StateKind::Stopped => {
                    bench.stop_now();
                    bench.run_for(100_000);
                }
                _ => {}
            }
            assert_eq!(bench.kind(), state);
            // Halted drives whose brake slips move, and do not report it.
            if state == StateKind::Stopped {
                bench.drives[1].slips_rad_s = creep_rad_s;
            } else {
                bench.drives[1].creep_rad_s = creep_rad_s;
            }
            let from = bench.now;
            bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Fault);
            let after_ms = (bench.now - from) / 1_000;
            println!("{state:?}, {creep_rad_s} rad/s: {:?} after {after_ms} ms", fault(&bench));
            assert_eq!(fault(&bench), Some(Fault::at(Cause::MovesUnordered, joint(1))), "{state:?}");
            // Three milliradians, or two state words 40 ms apart; and one monitor period.
            let bound_ms = if state == StateKind::Stopped { 3.4 / creep_rad_s.abs() + 41.0 } else { 121.0 };
            assert!(after_ms as f64 <= bound_ms, "{state:?}: {after_ms} ms");
            bench.run_for(2_000);
            assert!(bench.sent_after(from, is_halt).is_some());
        }
    }
}

#[test]
fn hands_may_move_joints_without_power_in_fault_and_in_idle() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.drives[1].state = bench.drives[1].state.union(CubeState::BRAKEACTIVE);
    bench.run_for(100_000);
    bench.drives[1].slips_rad_s = 0.1;
    bench.run_for(1_000_000);
    assert_eq!(bench.kind(), StateKind::Idle, "{:?}", bench.controller.state());

    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.drives[3].state = bench.drives[3].state.union(CubeState::ERROR.union(CubeState::TOW_ERROR));
    bench.run_until(200_000, |bench| bench.kind() == StateKind::Fault);
    let first = fault(&bench);
    bench.drives[1].slips_rad_s = 0.1;
    bench.run_for(1_000_000);
    assert_eq!(fault(&bench), first, "the first cause stays");
    let code = first.unwrap().cause.code();
    let refused = bench.order(Order::ClearFault { code }).unwrap_err();
    assert_eq!(refused.cause, Cause::StillMoving, "not while a person moves it");
    bench.drives[1].slips_rad_s = 0.0;
    bench.run_for(200_000);
    bench.order(Order::ClearFault { code }).unwrap();
    run_watched(&mut bench, 3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
}

#[test]
fn boot_ends_only_when_every_joint_stands() {
    let mut bench = Bench::new(Options::default());
    // The joint drifts after the last reset, and the drive does not report it.
    bench.run_until(3_000_000, |bench| {
        matches!(bench.controller.group().mode(), Mode::Finding(Stage::Recover { .. }))
    });
    bench.drives[5].slips_rad_s = 0.05;
    bench.run_for(700_000);
    assert_eq!(bench.kind(), StateKind::Boot);
    bench.drives[5].slips_rad_s = 0.0;
    bench.run_for(200_000);
    assert_eq!(bench.kind(), StateKind::Ready);

    let mut bench = Bench::new(Options::default());
    bench.drives[5].slips_rad_s = 0.05;
    bench.run_until(5_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench), Some(Fault::at(Cause::RestNotReached, joint(5))));
}

#[test]
fn jog_and_homing_end_only_when_the_joint_stands() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    let jog = Order::Jog { joint: joint(2), qd_rad_s: 0.2, hold: Duration::from_millis(200) };
    bench.order(jog).unwrap();
    run_watched(&mut bench, 3_000_000, |bench| bench.kind() == StateKind::Ready && bench.now > 1_000_000);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());

    bench.order(jog).unwrap();
    bench.run_for(300_000);
    bench.drives[2].slips_rad_s = 0.03;
    run_watched(&mut bench, 3_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench).and_then(|fault| fault.joint), Some(joint(2)));

    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.run_for(50_000);
    bench.order(Order::Home { mask: 0b1000 }).unwrap();
    bench.run_for(200_000);
    bench.drives[3].slips_rad_s = 0.05;
    bench.run_for(1_000_000);
    assert_eq!(bench.kind(), StateKind::Homing, "the zero is found, the joint moves");
    bench.drives[3].slips_rad_s = 0.0;
    bench.run_for(300_000);
    assert_eq!(bench.kind(), StateKind::Idle, "five joints have no zero: {:?}", bench.controller.state());
}

/// Found with a joint that was held: the arming was refused while the arm still moved, and then the arm was no longer
/// supervised.
#[test]
fn arming_is_refused_until_every_joint_stands_and_its_brake_is_open() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    bench.stop_now();
    bench.run_for(100_000);
    let valid = Duration::from_secs(5);
    let Ok(firmware::orders::Done::Offer { token, .. }) =
        bench.order(Order::ArmPrepare { crc64: name.crc64, valid })
    else {
        panic!("no offer")
    };
    let reset_at = bench.now;
    bench.run_for(150_000);
    let refused = bench.order(Order::ArmConfirm { token, valid }).unwrap_err();
    assert_eq!(refused.cause, Cause::DriveNotReady, "{} us after the reset", bench.now - reset_at);
    bench.run_for(60_000);
    bench.order(Order::ArmConfirm { token, valid }).unwrap();
}

/// A state word that shows MOTION excludes rest. The time is that of the slowest ramp to the last knot, with speed
/// v and acceleration a of a jog: braking, the way at v, 2 v/a for its ends; then the slack in which a drive
/// settles.
#[test]
fn rest_that_is_not_reached_after_the_plan_is_a_fault_in_the_time_of_a_jog() {
    let (v, a) = (0.25, 1.0);
    for away_rad in [0.0, 0.1] {
        let mut bench = parking_beside(away_rad);
        let at = bench.now;
        let ways = bench.drives.iter().enumerate().map(|(index, drive)| {
            let way_rad = (drive.q - throw_reference(index, 1.0).0).abs();
            drive.v.abs() / a + (way_rad + 0.5 * drive.v * drive.v / a) / v
        });
        let expected_s = ways.fold(0.0, f64::max) + 2.0 * v / a + 0.25;
        // So slow that the measured position stands.
        bench.drives[2].creep_rad_s = 1e-9;
        bench.run_until(5_000_000, |bench| bench.kind() == StateKind::Fault);
        assert_eq!(fault(&bench), Some(Fault::at(Cause::RestNotReached, joint(2))), "{away_rad} rad beside");
        let took_s = (bench.now - at) as f64 * 1e-6;
        assert!((took_s - expected_s).abs() < 0.015, "{took_s} s for {expected_s} s");
    }
}
