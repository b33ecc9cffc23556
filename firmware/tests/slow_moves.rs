//! Homing and jogging at the edges: what is refused, what a halted group does first, and the effect of a lost repetition.

use crate::bench::*;
use firmware::fault::Cause;
use firmware::orders::Order;
use firmware::state::StateKind;
use protocol::Duration;

fn jog(index: usize, hold_ms: u64) -> Order {
    Order::Jog { joint: joint(index), qd_rad_s: 0.2, hold: Duration::from_millis(hold_ms) }
}

fn stopped() -> Bench {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.stop_now();
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Stopped);
    assert_eq!(bench.kind(), StateKind::Stopped);
    bench
}

#[test]
fn homing_of_no_joint_or_of_one_that_is_not_there_is_refused() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    for mask in [0, 0x40, 0x41] {
        assert_eq!(bench.order(Order::Home { mask }).unwrap_err().cause, Cause::JointUnknown, "{mask:#x}");
    }
    assert_eq!(bench.kind(), StateKind::Ready);
}

#[test]
fn a_jog_in_stopped_clears_the_halt_and_moves() {
    let mut bench = stopped();
    // The drives take 0.2 s from a reset to their next motion.
    bench.order(jog(2, 500)).unwrap();
    bench.run_for(450_000);
    assert!(bench.drives[2].q > 0.02, "{} rad", bench.drives[2].q);
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Ready);
    assert_eq!(bench.kind(), StateKind::Ready);
}

#[test]
fn a_homing_in_stopped_clears_the_halt_and_finds_the_zero() {
    let mut bench = stopped();
    bench.order(Order::Home { mask: 0b100 }).unwrap();
    bench.run_until(3_000_000, |bench| bench.kind() != StateKind::Homing);
    assert_eq!(bench.kind(), StateKind::Ready);
}

/// The controller reads the drives all the time: at any moment an answer from before the reset may be on its way.
#[test]
fn an_answer_from_before_the_reset_is_not_taken_for_one_after_it() {
    for order in [jog(2, 500), Order::Home { mask: 0b100 }] {
        for phase_us in (0..60_000).step_by(89) {
            let mut bench = stopped();
            bench.run_for(20_000 + phase_us);
            bench.order(order).unwrap();
            bench.run_for(450_000);
            let state = bench.controller.state();
            assert_ne!(bench.kind(), StateKind::Fault, "{order:?}, {phase_us} us: {state:?}");
        }
    }
}

#[test]
fn another_joint_is_not_jogged_before_the_first_one_stands() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.order(jog(2, 300)).unwrap();
    bench.run_for(100_000);
    assert_eq!(bench.order(jog(3, 300)).unwrap_err().cause, Cause::OrderNotNow);
    bench.order(jog(2, 300)).unwrap();
    bench.run_for(100_000);
    assert_eq!(bench.drives[3].q, 0.0);
}

/// The ramp to rest has begun: a new order would have to begin anew.
#[test]
fn a_jog_that_was_let_go_is_not_taken_up_again_before_it_stands() {
    let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
    bench.order(jog(2, 100)).unwrap();
    bench.run_for(180_000);
    assert_eq!(bench.kind(), StateKind::Jogging);
    assert_eq!(bench.order(jog(2, 100)).unwrap_err().cause, Cause::OrderNotNow);
    bench.run_until(1_000_000, |bench| bench.kind() == StateKind::Ready);
    bench.order(jog(2, 100)).unwrap();
}
