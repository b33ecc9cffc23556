//! A drive leaves out one answer during a homing or a jog. Each step is requested again: neither motion lasts
//! longer than allowed, and no drive keeps another current.

use crate::bench::*;
use firmware::orders::Order;
use firmware::state::StateKind;
use protocol::Duration;

/// Times of a lost answer after the order: all steps that begin a homing or a jog are within them.
const LOST_AT_US: [u64; 6] = [0, 2_000, 4_000, 8_000, 12_000, 20_000];

#[test]
fn jog_with_a_lost_answer_moves_with_the_lower_current_and_gives_it_back() {
    for lost_at_us in LOST_AT_US {
        let mut bench = Bench::ready(Options::default(), &[0.0; 6]);
        let current_a = bench.drives[2].max_cur;
        let jog = Order::Jog { joint: joint(2), qd_rad_s: 0.1, hold: Duration::from_millis(300) };
        bench.order(jog).unwrap();
        bench.run_for(lost_at_us);
        bench.drives[2].silent = true;
        bench.run_for(3_000);
        bench.drives[2].silent = false;
        let mut moved = false;
        for _ in 0..290 {
            bench.run_for(1_000);
            let drive = &bench.drives[2];
            moved |= drive.v > 0.0;
            assert!(drive.v == 0.0 || drive.max_cur < current_a, "lost after {lost_at_us} us: full current");
        }
        assert!(moved, "lost after {lost_at_us} us");
        bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
        assert_eq!(bench.drives[2].max_cur, current_a, "lost after {lost_at_us} us");
    }
}

#[test]
fn homing_with_a_lost_answer_searches_with_the_lower_current_and_gives_it_back() {
    for lost_at_us in LOST_AT_US {
        let mut bench = Bench::new(Options { homed: false, ..Options::default() });
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Idle);
        bench.run_for(50_000);
        let current_a = bench.drives[5].max_cur;
        bench.order(Order::Home { mask: 0x3F }).unwrap();
        bench.run_for(lost_at_us);
        bench.drives[5].silent = true;
        bench.run_for(3_000);
        bench.drives[5].silent = false;
        bench.run_for(100_000);
        assert!(bench.drives[5].max_cur < current_a, "lost after {lost_at_us} us");
        bench.run_until(10_000_000, |bench| bench.kind() == StateKind::Ready);
        assert_eq!(bench.kind(), StateKind::Ready, "lost after {lost_at_us} us");
        assert_eq!(bench.drives[5].max_cur, current_a, "lost after {lost_at_us} us");
    }
}
