//! Stops during stops: which cause stays, when a more severe reaction takes over, and how a path stop ends.

use crate::bench::*;
use firmware::fault::{Cause, Fault};
use firmware::orders::Order;
use firmware::rest::HALT_REST_MAX;
use firmware::settings::Settings;
use firmware::state::{State, StateKind, StopWay};
use firmware::trace::TraceEvent;
use protocol::powercube::CubeState;

const PERIOD_US: u64 = 3_000;

fn thrown(settings: Settings, into_us: u64) -> Bench {
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(2 * PERIOD_US + into_us);
    assert_eq!(bench.kind(), StateKind::Running);
    bench
}

fn way(bench: &Bench) -> Option<StopWay> {
    match bench.controller.state() {
        State::Stopping { way, .. } => Some(*way),
        _ => None,
    }
}

fn fault(bench: &Bench) -> Option<Fault> {
    bench.controller.state().fault()
}

fn further(bench: &Bench) -> Vec<Cause> {
    let faults = bench.controller.trace().iter().filter_map(|(_, event)| match event {
        TraceEvent::FurtherFault(fault) => Some(fault.cause),
        _ => None,
    });
    faults.collect()
}

#[test]
fn a_stop_during_start_up_halts_and_the_watchdogs_are_proven_from_the_beginning() {
    let mut proofs = 0;
    for into_us in (20_000..600_000).step_by(29_000) {
        let mut bench = Bench::new(Options::default());
        bench.run_for(into_us);
        if bench.kind() != StateKind::Boot {
            continue;
        }
        proofs += 1;
        let at = bench.now;
        bench.stop_now();
        assert_eq!(bench.kind(), StateKind::Boot, "{into_us} us");
        let mut expired = [false; 6];
        while bench.kind() == StateKind::Boot && bench.now < at + 5_000_000 {
            bench.run_for(1_000);
            for (expired, drive) in expired.iter_mut().zip(&bench.drives) {
                *expired |= bench.now > at + 20_000 && drive.state.contains(CubeState::COMM_ERROR);
            }
        }
        assert!(bench.sent_after(at, is_halt).is_some(), "{into_us} us");
        assert_eq!(bench.kind(), StateKind::Ready, "{into_us} us: {:?}", bench.controller.state());
        assert_eq!(expired, [true; 6], "{into_us} us: watchdogs that stopped their drive after the stop");
    }
    assert!(proofs >= 5, "{proofs} stops during a start");
}

#[test]
fn the_first_of_two_stops_is_the_cause() {
    let mut bench = thrown(Settings::powercube6(), 300_000);
    bench.stop_now();
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Stopped);
    bench.order(Order::Stop).unwrap();
    bench.run_for(20_000);
    assert_eq!(bench.kind(), StateKind::Stopped);
    assert_eq!(fault(&bench), Some(Fault::group(Cause::StopMessage)));
}

#[test]
fn a_fault_during_a_stop_is_the_cause_and_one_after_a_fault_is_only_noted() {
    // A fault replaces the stop that was ordered: it does not count as a further fault.
    let mut bench = thrown(Settings::powercube6(), 300_000);
    bench.order(Order::Stop).unwrap();
    bench.run_for(2 * PERIOD_US);
    bench.drives[2].silent = true;
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench), Some(Fault::at(Cause::DriveSilent, joint(2))));
    assert_eq!(further(&bench), []);
    // A second drive that falls silent while the group brakes for the first changes nothing but the trace.
    let mut bench = thrown(Settings::powercube6(), 300_000);
    bench.drives[2].silent = true;
    bench.run_until(100_000, |bench| bench.kind() == StateKind::Stopping);
    bench.drives[1].silent = true;
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(fault(&bench), Some(Fault::at(Cause::DriveSilent, joint(2))));
    assert!(further(&bench).contains(&Cause::DriveSilent), "{:?}", further(&bench));
}

#[test]
fn a_fault_while_halted_drives_brake_ends_in_fault() {
    let mut bench = thrown(Settings::powercube6(), 430_000);
    bench.stop_now();
    assert_eq!(way(&bench), Some(StopWay::Halted));
    bench.drives[2].silent = true;
    bench.run_until(1_000_000, |bench| bench.kind() != StateKind::Stopping);
    assert_eq!(bench.kind(), StateKind::Fault, "{:?}", bench.controller.state());
    assert_eq!(fault(&bench), Some(Fault::at(Cause::DriveSilent, joint(2))));
}

/// Each stop is an order to halt, but a repeated stop gives a joint that does not come to rest no more time.
#[test]
fn stops_that_are_repeated_do_not_put_off_the_end_of_a_joint_that_moves_on() {
    let mut bench = thrown(Settings::powercube6(), 430_000);
    bench.drives[1].slips_rad_s = 0.3;
    bench.stop_now();
    let at = bench.now;
    while bench.kind() == StateKind::Stopping && bench.now < at + 4_000_000 {
        bench.run_for(100_000);
        let _ = bench.order(Order::Stop);
    }
    assert_eq!(bench.kind(), StateKind::Fault, "{:?}", bench.controller.state());
    let after_us = bench.now - at;
    assert!(after_us <= HALT_REST_MAX.as_micros() + 150_000, "{after_us} us");
}

#[test]
fn a_path_stop_that_takes_too_long_becomes_a_quick_stop() {
    let settings = Settings { stop_path_max_us: 60_000, ..Settings::powercube6() };
    let mut bench = thrown(settings, 430_000);
    bench.order(Order::Stop).unwrap();
    bench.run_for(50_000);
    assert_eq!(way(&bench), Some(StopWay::Path));
    bench.run_for(10_000 + 2 * PERIOD_US);
    assert_eq!(way(&bench), Some(StopWay::Quick));
    bench.run_until(1_500_000, |bench| bench.kind() == StateKind::Stopped);
    assert_eq!(fault(&bench), Some(Fault::group(Cause::StopOrdered)));
    let speed = bench.drives.iter().map(|drive| drive.v.abs()).fold(0.0, f64::max);
    assert!(speed < 0.02, "{speed} rad/s");
}

/// The joints settle on the standing reference before the halt, and the halt does not wait for the longest time of a stop.
#[test]
fn a_path_stop_halts_some_cycles_after_its_reference_stands() {
    for into_us in [100_000, 300_000, 430_000, 700_000] {
        let mut bench = thrown(Settings::powercube6(), into_us);
        bench.order(Order::Stop).unwrap();
        let stands = |bench: &Bench| match bench.controller.state() {
            State::Stopping { clock, way: StopWay::Path, .. } => clock.is_standing(),
            _ => false,
        };
        bench.run_until(1_500_000, stands);
        assert!(stands(&bench), "{into_us} us: {:?}", bench.controller.state());
        let at = bench.now;
        bench.run_until(100_000, |bench| bench.log.last().is_some_and(|logged| is_halt(&logged.frame)));
        let cycles = (bench.now - at) as f64 / PERIOD_US as f64;
        assert!(
            (2.5..=5.0).contains(&cycles),
            "{into_us} us: halt {cycles} cycles after the reference stands"
        );
    }
}

/// The slowest joint needs its speed over the share of its acceleration that stops use, and the path follows it. In
/// addition: commands that are on their way, three cycles to settle, and a measured rest.
#[test]
fn a_path_stop_takes_no_longer_than_its_slowest_joint_needs() {
    for into_us in (4_000..900_000).step_by(16_000) {
        let mut bench = thrown(Settings::powercube6(), into_us);
        let settings = *bench.controller.settings();
        let speeds = bench.drives.iter().map(|drive| drive.v.abs()).zip(&settings.joint.0);
        let share = f64::from(settings.stop_share);
        let needed_s =
            speeds.map(|(v, joint)| v / (share * f64::from(joint.a_max_rad_s2))).fold(0.0, f64::max);
        bench.order(Order::Stop).unwrap();
        let at = bench.now;
        bench.run_until(1_500_000, |bench| bench.kind() == StateKind::Stopped);
        let took_s = (bench.now - at) as f64 * 1e-6;
        let bounds = needed_s..=1.3 * needed_s + 0.1;
        assert!(bounds.contains(&took_s), "{into_us} us: {took_s:.3} s, {needed_s:.3} s needed");
    }
}
