//! Deadlines that come together, and deadlines that are served late.

use crate::bench::*;
use firmware::events::{Action, PlanEvent, PlanEvents};
use firmware::fault::Cause;
use firmware::groups::powercube::settings::GRIPPER_ADDRESS;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::state::StateKind;
use firmware::trace::TraceEvent;
use firmware::trajectory_format::Header;
use protocol::Duration;

/// The output opens 20 ms before its time: both switch at 0.1 s. The bench refuses a deadline that stays where it is.
#[test]
fn two_switchings_of_the_gripper_at_one_time_are_both_served_at_once() {
    let mut settings = Settings::powercube6();
    GRIPPER_ADDRESS.set(&mut settings, 0);
    settings.gripper_opening_us = 20_000;
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
    let mut events = PlanEvents::default();
    for (t_us, action) in [(100_000, Action::Close), (120_000, Action::Open)] {
        assert!(events.push(PlanEvent { t_us, action }));
    }
    let (_, knots) = throw_knots();
    let header = Header { joints: 6, period_us: 3_000, events, ..Header::default() };
    bench.start(&file(&header, &knots));
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    let switched =
        bench.controller.trace().iter().filter(|(_, event)| matches!(event, TraceEvent::Gripper(_)));
    assert!(switched.count() <= 2);
    assert_eq!(bench.board_gripper.last().map(|(_, level)| *level), Some(true), "opened last");
}

#[test]
fn run_whose_start_passes_while_the_controller_is_held_up_does_not_begin() {
    for late_us in [0, 5_000, 15_000] {
        let mut bench = Bench::ready(Options::default(), &throw_start());
        let name = bench.upload(&throw_file(3_000, true));
        bench.arm(name);
        let start = bench.instant() + Duration::from_micros(300_000);
        bench.order(Order::RunAt { name, start }).unwrap();
        bench.run_for(270_000);
        assert_eq!(bench.kind(), StateKind::Armed);
        bench.hold_up(30_000 + late_us);
        let before: Vec<f64> = bench.drives.iter().map(|drive| drive.q).collect();
        bench.run_for(600_000);
        assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
        assert!(bench.drives.iter().zip(&before).all(|(drive, q)| (drive.q - q).abs() < 1e-3));
        let refused = |(_, event)| matches!(event, TraceEvent::Refused(_, Cause::StartPassed));
        assert!(bench.controller.trace().iter().any(refused), "the cause is kept");
    }
}

#[test]
fn run_that_is_held_up_between_its_begin_and_its_first_set_point_ends_without_a_motion() {
    for late_us in [7_000, 15_000, 20_000] {
        let mut bench = Bench::ready(Options::default(), &throw_start());
        let name = bench.upload(&throw_file(3_000, true));
        bench.arm(name);
        let start = bench.instant() + Duration::from_micros(300_000);
        bench.order(Order::RunAt { name, start }).unwrap();
        bench.run_until(300_000, |bench| bench.kind() == StateKind::Running);
        let left = start.saturating_since(bench.instant()).as_micros();
        assert!(left > 0, "held up before the start");
        let before: Vec<f64> = bench.drives.iter().map(|drive| drive.q).collect();
        bench.hold_up(left + late_us);
        bench.run_for(1_500_000);
        assert_eq!(bench.kind(), StateKind::Ready, "{late_us}: {:?}", bench.controller.state());
        assert!(bench.drives.iter().zip(&before).all(|(drive, q)| (drive.q - q).abs() < 1e-6), "{late_us}");
        let passed = |(_, event)| matches!(event, TraceEvent::Refused(_, Cause::StartPassed));
        assert!(bench.controller.trace().iter().any(passed), "the cause is kept");
        let at = bench.instant();
        assert!(!bench.controller.take_sample(at).gripper_open, "the ball stays in the hand");
    }
}

/// Nothing but the end of the offer falls on these times.
#[test]
fn each_deadline_has_passed_when_it_has_come() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    let valid = Duration::from_micros(123_457);
    let Done::Offer { .. } = bench.order(Order::ArmPrepare { crc64: name.crc64, valid }).unwrap() else {
        panic!()
    };
    bench.run_for(123_457);
    let at = bench.instant();
    assert_eq!(bench.controller.take_sample(at).arming_left, Duration::ZERO);
}
