//! How an error of a drive is reported: as the first cause, by the name that the drive's state word gives it.

use crate::bench::*;
use firmware::fault::{Cause, Fault};
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::powercube::CubeState;

/// `into_us` after the start of the throw.
fn thrown(settings: Settings, into_us: u64) -> Bench {
    let mut bench = Bench::ready(Options { settings, ..Options::default() }, &throw_start());
    bench.start(&throw_file(settings.cycle_period_us, true));
    bench.run_for(2 * u64::from(settings.cycle_period_us) + into_us);
    assert_eq!(bench.kind(), StateKind::Running);
    bench
}

fn show(bench: &mut Bench, index: usize, bits: CubeState) {
    bench.drives[index].state = bench.drives[index].state.union(bits);
}

/// The fault of the group, which the freeze frame repeats.
fn ended(bench: &mut Bench) -> Option<Fault> {
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    let fault = bench.controller.state().fault();
    let freeze = bench.controller.freeze_frame().unwrap();
    assert_eq!((Some(freeze.fault), freeze.state), (fault, StateKind::Running));
    fault
}

const ERROR: CubeState = CubeState::ERROR;
const WATCHDOG: CubeState = CubeState::ERROR.union(CubeState::COMM_ERROR).union(CubeState::HALTED);

#[test]
fn error_of_one_drive_stops_all_and_its_state_word_names_the_cause() {
    for (bits, cause) in [
        (ERROR, Cause::DriveError),
        (CubeState::HALTED, Cause::DriveError),
        (ERROR.union(CubeState::TOW_ERROR), Cause::DriveTowError),
        (ERROR.union(CubeState::POWERFAULT), Cause::DrivePowerFault),
        (ERROR.union(CubeState::BEYOND_SOFT), Cause::DriveSoftLimit),
        (WATCHDOG, Cause::DriveWatchdog),
    ] {
        for settings in [Settings::powercube6(), Settings::powercube6_paper()] {
            for into_us in [350_000, 354_000, 368_000, 377_000] {
                let mut bench = thrown(settings, into_us);
                show(&mut bench, 1, bits);
                let (at, period_us) = (bench.now, u64::from(settings.cycle_period_us));
                bench.run_until(100_000, |bench| bench.kind() != StateKind::Running);
                assert!(bench.now - at <= 2 * period_us, "seen in the next answer");
                // The error of another drive is not the cause.
                show(&mut bench, 4, ERROR.union(CubeState::TOW_ERROR));
                let fault = ended(&mut bench);
                assert_eq!(fault, Some(Fault::at(cause, joint(1))), "{period_us} us, {into_us} us into");
                let path_us = bench.controller.freeze_frame().unwrap().path_us;
                assert!((340_000..420_000).contains(&path_us), "{path_us}");
            }
        }
    }
}

/// The short state in each answer reports that a drive is halted; its state word reports that its watchdog has expired.
#[test]
fn controller_that_was_held_up_beyond_the_watchdogs_reports_that_they_expired() {
    for into_us in (200_000..700_000).step_by(23_000) {
        let mut bench = thrown(Settings::powercube6(), into_us);
        bench.hold_up(75_000);
        bench.run_for(75_000);
        assert!(bench.drives.iter().all(|drive| drive.state.contains(CubeState::COMM_ERROR)), "{into_us} us");
        assert_eq!(ended(&mut bench).map(|fault| fault.cause), Some(Cause::DriveWatchdog), "{into_us} us");
    }
}

/// All watchdogs wait for the same sign of life: one that has expired explains the error of another drive.
#[test]
fn expired_watchdog_of_another_drive_names_an_error_that_nothing_else_names() {
    for into_us in (300_000..400_000).step_by(7_300) {
        let mut bench = thrown(Settings::powercube6(), into_us);
        show(&mut bench, 1, ERROR);
        bench.run_until(100_000, |bench| bench.kind() != StateKind::Running);
        assert_eq!(bench.controller.state().fault(), Some(Fault::at(Cause::DriveError, joint(1))));
        show(&mut bench, 4, WATCHDOG);
        assert_eq!(ended(&mut bench), Some(Fault::at(Cause::DriveWatchdog, joint(4))), "{into_us} us");
    }
}

#[test]
fn state_word_does_not_rename_a_cause_that_has_a_name() {
    for into_us in (300_000..400_000).step_by(7_300) {
        let mut bench = thrown(Settings::powercube6(), into_us);
        bench.heartbeat = false;
        bench.run_until(200_000, |bench| bench.kind() != StateKind::Running);
        show(&mut bench, 1, WATCHDOG);
        assert_eq!(ended(&mut bench), Some(Fault::group(Cause::HostLost)), "{into_us} us");
    }
}

/// Only an error that a drive reports about itself names the cause.
#[test]
fn silence_after_an_error_does_not_rename_it() {
    for into_us in (300_000..400_000).step_by(7_300) {
        let mut bench = thrown(Settings::powercube6(), into_us);
        show(&mut bench, 1, ERROR);
        bench.run_until(100_000, |bench| bench.kind() != StateKind::Running);
        bench.drives[1].silent = true;
        assert_eq!(ended(&mut bench), Some(Fault::at(Cause::DriveError, joint(1))), "{into_us} us");
    }
}
