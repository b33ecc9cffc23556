//! Before the group is armed, each drive holds what the settings require, and this stays so while the group stands.

use crate::bench::*;
use firmware::fault::Cause;
use firmware::orders::{Done, Order};
use firmware::registers::Number;
use firmware::state::StateKind;
use protocol::Duration;
use protocol::powercube::Config;

const VALID: Duration = Duration::from_secs(10);

fn cause(bench: &Bench) -> Option<Cause> {
    bench.controller.state().fault().map(|fault| fault.cause)
}

/// Stops the motion that an order has begun, by order or by message, then arms.
fn stop_and_arm(order: Order, by_message: bool) {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let name = bench.upload(&throw_file(3_000, true));
    let full_a: Vec<f32> = bench.drives.iter().map(|drive| drive.max_cur).collect();
    bench.order(order).unwrap();
    bench.run_for(150_000);
    assert!(bench.drives.iter().zip(&full_a).any(|(drive, full_a)| drive.max_cur < *full_a), "lowered");
    if by_message {
        bench.stop_now();
    } else {
        bench.order(Order::Stop).unwrap();
    }
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Stopped);
    assert_eq!(bench.kind(), StateKind::Stopped);
    // At once: the values may still be on their way back to the drives.
    let prepared = bench.order(Order::ArmPrepare { crc64: name.crc64, valid: VALID });
    let Ok(Done::Offer { token, .. }) = prepared else { panic!("{prepared:?}") };
    for _ in 0..60 {
        bench.run_for(10_000);
        if bench.order(Order::ArmConfirm { token, valid: VALID }).is_ok() {
            let held_a: Vec<f32> = bench.drives.iter().map(|drive| drive.max_cur).collect();
            assert_eq!(held_a, full_a, "armed with {held_a:?} A");
            return;
        }
        if bench.kind() != StateKind::Stopped {
            break;
        }
    }
    // A homing that was stopped leaves a joint without its zero: the group cannot be armed.
    let homed =
        bench.drives.iter().all(|drive| drive.state.contains(protocol::powercube::CubeState::HOME_OK));
    assert!(!homed, "never armed: {:?}", bench.controller.state());
    let held_a: Vec<f32> = bench.drives.iter().map(|drive| drive.max_cur).collect();
    assert_eq!(held_a, full_a, "{:?}", bench.controller.state());
}

#[test]
fn a_jog_or_homing_that_is_stopped_leaves_no_drive_with_another_current_when_the_group_is_armed() {
    for by_message in [false, true] {
        stop_and_arm(
            Order::Jog { joint: joint(2), qd_rad_s: -0.1, hold: Duration::from_millis(400) },
            by_message,
        );
        stop_and_arm(Order::Home { mask: 0b10_0000 }, by_message);
    }
}

#[test]
fn current_limit_that_is_changed_at_rest_reaches_its_drive() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let at = bench.instant();
    let numbers: Vec<Number> = bench.controller.settings().joint.0[..6]
        .iter()
        .map(|joint| Number::Real32(joint.current_max_a * 0.75))
        .collect();
    bench.controller.write_register(at, HOST, "joint.current_max_a", &numbers).unwrap();
    bench.run_for(100_000);
    for (drive, number) in bench.drives.iter().zip(&numbers) {
        assert_eq!(Number::Real32(drive.max_cur), *number);
    }
}

#[test]
fn drive_whose_current_limit_or_configuration_another_node_changes_is_noticed_while_the_group_stands() {
    type Change = fn(&mut BenchDrive);
    let changes: [Change; 2] = [
        |drive| drive.max_cur = 1.0,
        |drive| drive.config = drive.config.with(Config::WATCHDOG_ENABLE, false),
    ];
    for change in changes {
        for armed in [false, true] {
            let mut bench = Bench::ready(Options::default(), &throw_start());
            let name = bench.upload(&throw_file(3_000, true));
            if armed {
                bench.arm(name);
            }
            change(&mut bench.drives[3]);
            bench.run_for(1_000_000);
            assert_eq!(bench.kind(), StateKind::Fault, "armed: {armed}");
            assert_eq!(cause(&bench), Some(Cause::DriveAltered));
            assert_eq!(bench.controller.state().fault().unwrap().joint, Some(joint(3)));
        }
    }
}

#[test]
fn drive_whose_configuration_another_node_changes_during_a_run_stops_it() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_for(100_000);
    bench.drives[1].config = bench.drives[1].config.with(Config::WATCHDOG_ENABLE, false);
    bench.run_until(500_000, |bench| bench.kind() == StateKind::Stopping);
    assert_eq!(cause(&bench), Some(Cause::DriveAltered));
    bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(bench.kind(), StateKind::Fault);
}

#[test]
fn run_keeps_its_cycles_while_what_the_drives_hold_is_read() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    bench.start(&throw_file(3_000, true));
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
    assert!(bench.controller.counters().cycles_late < 25);
}
