//! The proof of the drives' watchdogs at start-up: what counts as a proof, and what does not.

use crate::bench::*;
use firmware::Controller;
use firmware::fault::{Cause, Fault};
use firmware::groups::powercube::PowerCubes;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use protocol::Frame;
use protocol::powercube::{Broadcast, CubeState};

/// A watchdog that never expires in a test.
const NEVER_US: u64 = 600_000_000;

fn boot(bench: &mut Bench) -> Option<Fault> {
    bench.run_until(3_000_000, |bench| bench.kind() != StateKind::Boot);
    bench.controller.state().fault()
}

/// The controller starts again; the drives stay as they are.
fn restart(bench: &mut Bench) {
    let mut fresh = Bench::new(Options::default());
    fresh.drives = std::mem::take(&mut bench.drives);
    for drive in &mut fresh.drives {
        drive.restart_clock();
    }
    *bench = fresh;
}

fn watchdogs_unproven(bench: &Bench) -> bool {
    bench.controller.state().fault().is_some_and(|fault| fault.cause == Cause::WatchdogUnproven)
}

fn is_broadcast(broadcast: Broadcast) -> impl Fn(&Frame) -> bool {
    move |frame| *frame == broadcast.encode()
}

/// Found by misuse: a stop had halted the drives, and a halted drive counted as stopped by its watchdog.
#[test]
fn drive_that_is_halted_before_the_start_proves_nothing_at_any_start() {
    let mut bench = Bench::new(Options::default());
    for drive in &mut bench.drives {
        drive.watchdog_us = NEVER_US;
    }
    boot(&mut bench);
    assert!(watchdogs_unproven(&bench), "first start: {:?}", bench.controller.state());
    for start in 2..4 {
        for drive in &mut bench.drives {
            drive.state = drive.state.union(CubeState::HALTED);
        }
        restart(&mut bench);
        boot(&mut bench);
        assert!(watchdogs_unproven(&bench), "start {start}: {:?}", bench.controller.state());
    }
    for clear in 1..4 {
        bench.run_for(100_000);
        bench.order(Order::ClearFault { code: Cause::WatchdogUnproven.code() }).unwrap();
        boot(&mut bench);
        assert!(watchdogs_unproven(&bench), "clear {clear}: {:?}", bench.controller.state());
    }
    assert_eq!(bench.count_sent(is_motion), 0);
}

#[test]
fn halted_drives_with_working_watchdogs_are_reset_and_proven() {
    let mut bench = Bench::new(Options::default());
    for drive in &mut bench.drives {
        drive.state = drive.state.union(CubeState::HALTED);
    }
    assert_eq!(boot(&mut bench), None);
    assert_eq!(bench.kind(), StateKind::Ready);
    let resets = bench.count_sent(is_broadcast(Broadcast::Reset));
    assert_eq!(resets, 2, "one before the proof, one after it");
    for drive in &bench.drives {
        assert!(!drive.state.intersects(CubeState::HALTED.union(CubeState::ERROR)), "{}", drive.state);
    }
}

#[test]
fn drive_that_stays_halted_after_a_reset_is_refused_by_name() {
    let mut bench = Bench::new(Options::default());
    bench.drives[3].stays_halted = true;
    bench.drives[3].state = bench.drives[3].state.union(CubeState::HALTED);
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::DriveError, joint(3))));

    let mut bench = Bench::new(Options::default());
    let supply = CubeState::ERROR.union(CubeState::POWERFAULT).union(CubeState::POW_VOLT_ERR);
    bench.drives[1].state = bench.drives[1].state.union(supply);
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::DriveSupply, joint(1))));
}

/// A person presses a stop button while the drives get no sign of life: this shows nothing about a watchdog.
#[test]
fn error_or_halt_without_communication_error_proves_nothing() {
    let error = CubeState::ERROR;
    for shown in [CubeState::HALTED, error, error.union(CubeState::HALTED), error.union(CubeState::TOW_ERROR)]
    {
        let mut bench = Bench::new(Options::default());
        bench.drives[4].watchdog_shows = shown;
        assert_eq!(boot(&mut bench), Some(Fault::at(Cause::WatchdogUnproven, joint(4))), "{shown}");
    }
}

/// A communication error alone may be a transmission error (`powercube-protocol` section 5): the search continues.
#[test]
fn communication_error_without_a_stop_proves_nothing() {
    let mut bench = Bench::new(Options::default());
    bench.drives[4].watchdog_shows = CubeState::COMM_ERROR;
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::WatchdogUnproven, joint(4))));
}

/// `powercube-protocol` section 7 leaves open whether other frames keep a watchdog quiet, whether HALTED is shown, and
/// whether a reset ends a running watchdog.
#[test]
fn every_kind_of_real_watchdog_is_proven_and_a_dead_one_of_the_same_kind_is_not() {
    let error = CubeState::ERROR.union(CubeState::COMM_ERROR);
    for any_frame_is_life in [false, true] {
        for reset_keeps_watchdog in [false, true] {
            for watchdog_shows in [error, error.union(CubeState::HALTED)] {
                for halted in [false, true] {
                    let mut bench = Bench::new(Options::default());
                    for drive in &mut bench.drives {
                        (drive.any_frame_is_life, drive.reset_keeps_watchdog) =
                            (any_frame_is_life, reset_keeps_watchdog);
                        drive.watchdog_shows = watchdog_shows;
                        drive.state = drive.state.with(CubeState::HALTED, halted);
                    }
                    let kind =
                        format!("{any_frame_is_life} {reset_keeps_watchdog} {watchdog_shows} {halted}");
                    assert_eq!(boot(&mut bench), None, "{kind}");
                    assert_eq!(bench.kind(), StateKind::Ready, "{kind}");
                    // The watchdog of one drive fails in operation.
                    bench.drives[2].watchdog_us = NEVER_US;
                    bench.run_for(200_000);
                    bench.stop_now();
                    bench.run_for(100_000);
                    restart(&mut bench);
                    assert_eq!(
                        boot(&mut bench),
                        Some(Fault::at(Cause::WatchdogUnproven, joint(2))),
                        "{kind}"
                    );
                }
            }
        }
    }
}

#[test]
fn clear_proves_the_watchdogs_again() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.drives[1].state = bench.drives[1].state.union(CubeState::ERROR.union(CubeState::TOW_ERROR));
    bench.run_until(200_000, |bench| bench.kind() == StateKind::Fault);
    // The drive was exchanged meanwhile, or a person switched its watchdog off and on.
    bench.drives[5].watchdog_us = NEVER_US;
    bench.run_for(100_000);
    bench.order(Order::ClearFault { code: Cause::DriveTowError.code() }).unwrap();
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::WatchdogUnproven, joint(5))));
    bench.drives[5].watchdog_us = 50_000;
    bench.run_for(100_000);
    bench.order(Order::ClearFault { code: Cause::WatchdogUnproven.code() }).unwrap();
    assert_eq!(boot(&mut bench), None);
    assert_eq!(bench.kind(), StateKind::Ready);
}

/// A watchdog that needs longer than the settings allow does not count.
#[test]
fn watchdog_that_is_slower_than_set_is_not_proven() {
    for (watchdog_us, proven) in [(20_500, true), (99_000, true), (130_000, false), (1_000_000, false)] {
        let mut bench = Bench::new(Options::default());
        bench.drives[0].watchdog_us = watchdog_us;
        let fault = boot(&mut bench);
        assert_eq!(fault.is_none(), proven, "{watchdog_us} us: {fault:?}");
    }
}

/// Another controller on the bus, or a person at another host, moves the arm.
#[test]
fn drive_that_moves_at_the_start_is_halted_and_named() {
    let mut bench = Bench::new(Options::default());
    (bench.drives[2].target, bench.drives[2].v_ramp, bench.drives[2].a_ramp) = (Some(2.0), 0.3, 2.0);
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::MovesUnordered, joint(2))));
    bench.run_for(300_000);
    assert!(bench.count_sent(is_halt) >= 1);
    assert!(bench.drives[2].v.abs() < 0.01, "{}", bench.drives[2].v);
}

/// The settings may switch the test off; a halted drive is still found, reset and read again.
#[test]
fn without_the_proof_a_halted_drive_is_reset_and_one_that_stays_halted_is_refused() {
    let settings = Settings { watchdog_prove: false, ..Settings::powercube6() };
    let mut bench = Bench::new(Options { settings, ..Options::default() });
    bench.drives[0].state = bench.drives[0].state.union(CubeState::HALTED);
    assert_eq!(boot(&mut bench), None);
    assert_eq!(bench.kind(), StateKind::Ready);
    let mut bench = Bench::with(
        Controller::<_, _, PowerCubes>::new(
            RamStorage::new(),
            &settings,
            firmware::authority::Seed::FORESEEABLE,
        ),
        Options { settings, ..Options::default() },
    );
    bench.drives[0].stays_halted = true;
    bench.drives[0].state = bench.drives[0].state.union(CubeState::HALTED);
    assert_eq!(boot(&mut bench), Some(Fault::at(Cause::DriveError, joint(0))));
}
