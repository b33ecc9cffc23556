//! A run that begins at a time of the controller's clock: when the arm moves, and what ends the wait.

use crate::bench::*;
use firmware::events::{Action, PlanEvent, PlanEvents};
use firmware::fault::{Cause, Fault};
use firmware::orders::Order;
use firmware::state::StateKind;
use firmware::store::FileName;
use firmware::trajectory_format::Header;
use protocol::powercube::CubeState;
use protocol::{Duration, Instant};

fn armed() -> (Bench, FileName) {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    bench.arm(name);
    (bench, name)
}

fn run_at(bench: &mut Bench, name: FileName, in_us: u64) -> Result<Instant, Cause> {
    let start = bench.instant() + Duration::from_micros(in_us);
    bench.order(Order::RunAt { name, start }).map(|_| start).map_err(|refusal| refusal.cause)
}

/// Time at which the first joint has moved by 1 mrad, measured at the drives.
fn moved_at(bench: &mut Bench, limit_us: u64) -> u64 {
    let (end, begin) = (bench.now + limit_us, bench.drives[0].q);
    while bench.now < end && (bench.drives[0].q - begin).abs() < 1e-3 {
        bench.run_for(100);
    }
    bench.now
}

#[test]
fn the_plan_begins_at_the_ordered_time_to_the_microsecond_wherever_the_monitor_is() {
    for in_us in [20_000, 250_000, 254_321, 257_900, 1_000_000, 12_000_000] {
        let (mut bench, name) = armed();
        let start = run_at(&mut bench, name, in_us).unwrap();
        let state = bench.kind();
        assert_eq!(state, if in_us < 30_000 { StateKind::Running } else { StateKind::Armed });
        let at = bench.instant();
        let left = bench.controller.take_sample(at).start_left;
        assert_eq!(left, (in_us >= 30_000).then(|| Duration::from_micros(in_us)), "it shows");
        bench.run_until(20_000_000, |bench| bench.kind() == StateKind::Running);
        assert!(bench.instant() < start, "the group leads the drives before the plan begins");
        let moved = moved_at(&mut bench, in_us + 1_000_000);
        // The reference has moved 1 mrad after 1.9 t³ or so: compare with the reference itself.
        let t = (moved - start.as_micros()) as f64 * 1e-6;
        let expected = (throw_reference(0, t).0 - throw_reference(0, 0.0).0).abs();
        assert!((expected - 1e-3).abs() < 5e-4, "{in_us}: {expected} rad after {t} s");
        // And the ball is released in time.
        let release = start.as_micros() + (HA * 1e6).round() as u64;
        bench.run_for(release - bench.now - 30_000);
        assert!(!bench.controller.take_sample(start).gripper_open);
        bench.run_for(30_000);
        assert!(bench.controller.take_sample(start).gripper_open);
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
        assert_eq!(bench.kind(), StateKind::Ready);
    }
}

#[test]
fn a_start_that_has_passed_is_too_near_or_too_far_is_refused_and_the_group_stays_armed() {
    let (mut bench, name) = armed();
    let past = bench.instant().saturating_sub(Duration::from_millis(1));
    let refused = bench.order(Order::RunAt { name, start: past }).unwrap_err().cause;
    assert_eq!(refused, Cause::StartPassed);
    assert_eq!(run_at(&mut bench, name, 5_999), Err(Cause::StartPassed), "two cycles of 3 ms are needed");
    assert_eq!(run_at(&mut bench, name, 30_000_001), Err(Cause::StartTooFar));
    assert_eq!(bench.kind(), StateKind::Armed);
    assert!(run_at(&mut bench, name, 6_000).is_ok());
    assert_eq!(bench.kind(), StateKind::Running);
    // The same order again: its answer was lost.
    assert!(run_at(&mut bench, name, 6_000).is_ok());
}

#[test]
fn whatever_ends_the_wait_leaves_the_arm_where_it_stands() {
    type End = fn(&mut Bench);
    let ends: [(End, StateKind); 5] = [
        (|bench| _ = bench.order(Order::Disarm).unwrap(), StateKind::Ready),
        (|bench| _ = bench.order(Order::Stop).unwrap(), StateKind::Stopped),
        (|bench| bench.stop_now(), StateKind::Stopped),
        (|bench| bench.heartbeat = false, StateKind::Ready),
        (|bench| bench.drives[2].silent = true, StateKind::Fault),
    ];
    for (index, (end, expected)) in ends.into_iter().enumerate() {
        let (mut bench, name) = armed();
        let before: Vec<f64> = bench.drives.iter().map(|drive| drive.q).collect();
        run_at(&mut bench, name, 900_000).unwrap();
        bench.run_for(300_000);
        assert_eq!(bench.kind(), StateKind::Armed);
        end(&mut bench);
        bench.run_for(2_500_000);
        assert_eq!(bench.kind(), expected, "{index}");
        assert_eq!(bench.count_sent(is_motion), 0, "{index}");
        let moved = bench.drives.iter().zip(&before).any(|(drive, q)| (drive.q - q).abs() > 1e-6);
        assert!(!moved, "{index}");
    }
}

#[test]
fn a_drive_that_is_halted_during_the_wait_is_a_fault_and_nothing_starts() {
    let (mut bench, name) = armed();
    run_at(&mut bench, name, 500_000).unwrap();
    bench.run_for(200_000);
    bench.drives[1].state = CubeState::from_bits(bench.drives[1].state.bits() | CubeState::HALTED.bits());
    bench.run_for(1_000_000);
    let fault = bench.controller.state().fault();
    assert_eq!(fault, Some(Fault::at(Cause::DriveError, joint(1))));
    assert_eq!(bench.count_sent(is_motion), 0);
}

#[test]
fn a_later_order_moves_the_start() {
    let (mut bench, name) = armed();
    run_at(&mut bench, name, 200_000).unwrap();
    let start = run_at(&mut bench, name, 600_000).unwrap();
    bench.run_for(500_000);
    assert_eq!(bench.kind(), StateKind::Armed);
    bench.run_until(200_000, |bench| bench.kind() == StateKind::Running);
    assert!(bench.instant() < start && bench.instant() + Duration::from_millis(40) > start);
}

#[test]
fn each_event_of_a_plan_switches_the_output_at_its_time() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let mut events = PlanEvents::NONE;
    for (t_us, action) in [(100_000, Action::Close), (300_000, Action::Open), (600_000, Action::Close)] {
        assert!(events.push(PlanEvent { t_us, action }));
    }
    let (_, knots) = throw_knots();
    let header = Header { joints: 6, period_us: 3_000, events, ..Header::default() };
    let name = bench.upload(&file(&header, &knots));
    bench.arm(name);
    let start = run_at(&mut bench, name, 100_000).unwrap().as_micros();
    let opening = u64::from(bench.controller.settings().gripper_opening_us);
    let (mut changes, mut last) = (Vec::new(), bench.drives[5].dio);
    while bench.now < start + 900_000 {
        bench.run_for(50);
        if bench.drives[5].dio != last {
            last = bench.drives[5].dio;
            changes.push((bench.now, last != 0));
        }
    }
    let expected = [(start + 300_000 - opening, true), (start + 600_000, false)];
    assert_eq!(changes.len(), 2, "closed before: the first close changes nothing: {changes:?}");
    for ((at, open), (due, wanted)) in changes.into_iter().zip(expected) {
        assert_eq!(open, wanted);
        // A write waits for the frames that are on the bus.
        assert!((due..due + 1_500).contains(&at), "{at} for {due}");
    }
}
