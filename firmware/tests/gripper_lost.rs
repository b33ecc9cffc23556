//! The write that opens the gripper through a module is lost: it is repeated once, then the host gets a report.

use crate::bench::*;
use firmware::fault::Cause;
use firmware::groups::powercube::settings::GRIPPER_ADDRESS;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Frame;
use protocol::powercube::{AddressedRequest, Parameter, Request};

fn is_gripper_write(frame: &Frame) -> bool {
    matches!(
        AddressedRequest::decode(frame),
        Ok(AddressedRequest { request: Request::Set(Parameter::DioData, _), .. })
    )
}

/// A throw in which the module with the gripper misses this many of its writes.
fn throw_that_misses(writes: u32) -> Bench {
    let address = GRIPPER_ADDRESS.get(&Settings::powercube6()) as u8;
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let holder = bench.drives.iter().position(|drive| drive.module.get() == address).unwrap();
    bench.start(&throw_file(3_000, true));
    bench.drives[holder].misses_gripper_writes = writes;
    bench.run_until(4_000_000, |bench| !bench.kind().may_move());
    bench
}

#[test]
fn gripper_write_that_is_lost_is_repeated_once() {
    let bench = throw_that_misses(1);
    assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
    assert_eq!(bench.count_sent(is_gripper_write), 2);
    let writes = bench.log.iter().filter(|logged| is_gripper_write(&logged.frame));
    let at: Vec<u64> = writes.map(|logged| logged.at.as_micros()).collect();
    assert!(at[1] - at[0] < 12_000, "{at:?}");
    assert!(bench.drives.iter().any(|drive| drive.dio != 0), "open");
}

#[test]
fn gripper_that_stays_unanswered_ends_the_throw_with_its_cause() {
    let bench = throw_that_misses(u32::MAX);
    assert_eq!(bench.controller.state().fault().map(|fault| fault.cause), Some(Cause::GripperUnanswered));
    assert_eq!(bench.count_sent(is_gripper_write), 2, "once, and once more");
}

#[test]
fn stop_while_the_gripper_write_is_unanswered_keeps_the_ball() {
    let address = GRIPPER_ADDRESS.get(&Settings::powercube6()) as u8;
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let holder = bench.drives.iter().position(|drive| drive.module.get() == address).unwrap();
    bench.start(&throw_file(3_000, true));
    bench.drives[holder].misses_gripper_writes = 1;
    bench.run_until(2_000_000, |bench| bench.count_sent(is_gripper_write) == 1);
    bench.stop_now();
    bench.run_for(1_000_000);
    assert_eq!(bench.count_sent(is_gripper_write), 1);
    assert_eq!(bench.kind(), StateKind::Stopped);
}

#[test]
fn gripper_that_does_not_answer_an_order_is_a_fault_of_the_gripper() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    for drive in &mut bench.drives {
        drive.misses_gripper_writes = u32::MAX;
    }
    bench.order(Order::Gripper { open: true }).unwrap();
    bench.run_for(1_000_000);
    assert_eq!(bench.controller.state().fault().map(|fault| fault.cause), Some(Cause::GripperUnanswered));
}
