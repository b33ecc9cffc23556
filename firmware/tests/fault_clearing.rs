//! Fault ends only when it is cleared, with the number of the fault that was seen.

use crate::bench::*;
use firmware::fault::Cause;
use firmware::orders::Order;
use firmware::registers::{self, Number, Writable};
use firmware::state::StateKind;
use protocol::Duration;
use protocol::powercube::CubeState;

/// Every register that needs a new search, with a value that changes it.
fn writes(bench: &Bench) -> Vec<(&'static str, Vec<Number>)> {
    let table = registers::all(bench.controller.settings()).enumerate();
    let searched = table.filter(|(_, info)| info.writable == Writable::NextStart);
    let changed = searched.map(|(index, info)| {
        let now = bench.controller.register(index).unwrap();
        let numbers: Vec<Number> = now
            .as_slice()
            .iter()
            .map(|number| match number {
                Number::Bit(on) => Number::Bit(!on),
                Number::Real32(x) => Number::Real32(x + 0.1),
                Number::Natural32(n) => {
                    Number::Natural32(if info.name == "group.joints" { n - 1 } else { n + 8 })
                }
            })
            .collect();
        (info.name, numbers)
    });
    changed.collect()
}

fn write(bench: &mut Bench, name: &str, numbers: &[Number]) -> Result<(), Cause> {
    let at = bench.instant();
    bench.controller.write_register(at, HOST, name, numbers).map_err(|refusal| refusal.cause)
}

fn in_fault() -> Bench {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.drives[2].state = bench.drives[2].state.union(CubeState::ERROR).union(CubeState::TOW_ERROR);
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    bench
}

#[test]
fn setting_that_needs_a_new_search_is_refused_in_fault_and_in_stopped() {
    let all = writes(&Bench::ready(Options::default(), &[0.0; 6]));
    assert!(all.len() >= 5, "{all:?}");
    for (name, numbers) in &all {
        let mut bench = in_fault();
        let state = *bench.controller.state();
        assert_eq!(write(&mut bench, name, numbers), Err(Cause::OrderNotNow), "{name} in Fault");
        bench.run_for(500_000);
        assert_eq!(*bench.controller.state(), state, "{name}");
        let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
        bench.stop_now();
        bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Stopped);
        assert_eq!(write(&mut bench, name, numbers), Err(Cause::OrderNotNow), "{name} in Stopped");
        assert_eq!(bench.kind(), StateKind::Stopped);
    }
}

#[test]
fn setting_that_needs_a_new_search_is_refused_while_a_joint_moves() {
    let mut bench = Bench::new(Options { homed: false, ..Options::default() });
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
    bench.run_for(100_000);
    // People may move a joint whose position loop is open.
    bench.drives[4].state = bench.drives[4].state.union(CubeState::BRAKEACTIVE);
    bench.run_for(50_000);
    bench.drives[4].slips_rad_s = 0.3;
    bench.run_for(100_000);
    assert_eq!(bench.kind(), StateKind::Idle);
    assert_eq!(write(&mut bench, "watchdog.prove", &[Number::Bit(false)]), Err(Cause::StillMoving));
    bench.drives[4].slips_rad_s = 0.0;
    bench.run_for(300_000);
    // To switch a drive's watchdog off widens a limit.
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    bench.order(Order::Unlock { robot_crc32, valid: Duration::from_secs(1) }).unwrap();
    assert_eq!(write(&mut bench, "watchdog.prove", &[Number::Bit(false)]), Ok(()));
}

#[test]
fn each_fault_has_a_picture_of_its_own() {
    let mut bench = in_fault();
    let first = bench.controller.freeze_frame().unwrap().fault;
    assert_eq!(first.cause, Cause::DriveTowError);
    bench.run_for(300_000);
    bench.order(Order::ClearFault { code: first.cause.code() }).unwrap();
    assert!(bench.controller.freeze_frame().is_none());
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
    bench.drives[3].silent = true;
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(bench.controller.freeze_frame().unwrap().fault.cause, Cause::DriveSilent);
}

#[test]
fn fault_is_not_cleared_before_rest_is_measured() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(500_000);
    bench.drives[2].state = bench.drives[2].state.union(CubeState::POWERFAULT).union(CubeState::ERROR);
    bench.run_until(500_000, |bench| bench.kind() == StateKind::Fault);
    let code = bench.controller.state().fault().unwrap().cause.code();
    // At first nothing is known: no reading is newer than the halt.
    let refused = bench.order(Order::ClearFault { code }).unwrap_err().cause;
    assert_eq!(refused, Cause::StillMoving);
    while bench.order(Order::ClearFault { code }).is_err() {
        bench.run_for(1_000);
        assert!(bench.now < 10_000_000);
    }
    for drive in &bench.drives {
        assert!(drive.v.abs() < 0.01, "cleared at {} rad/s", drive.v);
    }
}

/// A drive without power never measures rest: the search may begin after the time in which every joint has stopped.
#[test]
fn fault_of_a_drive_without_power_is_cleared_after_the_longest_time_to_rest() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.drives[3].silent = true;
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Fault);
    let code = bench.controller.state().fault().unwrap().cause.code();
    assert_eq!(bench.order(Order::ClearFault { code }).unwrap_err().cause, Cause::StillMoving);
    bench.run_for(3_000_000);
    bench.drives[3].silent = false;
    bench.order(Order::ClearFault { code }).unwrap();
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
}
