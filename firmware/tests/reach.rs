//! Jog, release and stop of a joint on and outside its soft limits: it moves as ordered or not at all, and never
//! starts moving at its release. Checked by the position of the drive itself.

use crate::bench::*;
use firmware::orders::Order;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Duration;
use protocol::powercube::{AddressedRequest, Request};

/// Way from 0.2 rad/s to rest with 1 rad/s2, and as much again for the lag and the steps of the encoder.
const REST_WAY_RAD: f64 = 0.02;
const LAG_RAD: f64 = 4e-3;
const JOINT: usize = 2;

fn jog(qd_rad_s: f32, hold_ms: u64) -> Order {
    Order::Jog { joint: joint(JOINT), qd_rad_s, hold: Duration::from_millis(hold_ms) }
}

/// Ready, with the joint so far from its upper (side 1) or lower limit (side -1), rad; positive is outside.
fn beside_limit(side: f64, outside_rad: f64, homed: bool) -> (Bench, f64) {
    let limits = *Settings::powercube6().joint.at(joint(JOINT));
    let limit = if side > 0.0 { limits.q_max_rad } else { limits.q_min_rad };
    let q_rad = f64::from(limit) + side * outside_rad;
    let mut bench = Bench::new(Options { homed, ..Options::default() });
    bench.drives[JOINT].place(q_rad);
    let wanted = if homed { StateKind::Ready } else { StateKind::Idle };
    bench.run_until(3_000_000, |bench| bench.kind() == wanted);
    bench.run_for(60_000);
    (bench, q_rad)
}

/// Jogs with the order repeated, then stops repeating it; returns where the joint was at release and where it rests.
fn jog_and_let_go(bench: &mut Bench, qd_rad_s: f32, for_ms: u64) -> (f64, f64) {
    for _ in 0..for_ms / 25 {
        bench.order(jog(qd_rad_s, 50)).unwrap();
        bench.run_for(25_000);
    }
    bench.order(jog(0.0, 50)).unwrap();
    let released_at = bench.drives[JOINT].q;
    bench.run_until(3_000_000, |bench| !bench.kind().may_move());
    bench.run_for(300_000);
    (released_at, bench.drives[JOINT].q)
}

#[test]
fn joint_outside_its_limits_that_is_jogged_inwards_stops_when_it_is_let_go() {
    for side in [1.0, -1.0] {
        let (mut bench, q_rad) = beside_limit(side, 0.2, true);
        let (released, rests) = jog_and_let_go(&mut bench, -0.2 * side as f32, 300);
        assert!(side * (q_rad - released) > 0.01, "it moves inwards: {q_rad} to {released}");
        let further = side * (released - rests);
        assert!((0.0..REST_WAY_RAD + LAG_RAD).contains(&further), "side {side}: {further} rad after release");
        assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
    }
}

#[test]
fn joint_on_or_outside_a_limit_that_is_jogged_outwards_does_not_move_and_does_not_start_when_it_is_let_go() {
    for side in [1.0, -1.0] {
        for outside_rad in [0.0, 0.01, 0.2] {
            let (mut bench, q_rad) = beside_limit(side, outside_rad, true);
            let (released, rests) = jog_and_let_go(&mut bench, 0.2 * side as f32, 300);
            for q in [released, rests] {
                assert!((q - q_rad).abs() < 1e-3, "side {side}, {outside_rad} rad outside: {q_rad} to {q}");
            }
            assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
        }
    }
}

#[test]
fn joint_inside_its_limits_stops_at_the_limit_or_after_its_braking_way() {
    for side in [1.0, -1.0] {
        let (mut bench, q_rad) = beside_limit(side, -0.03, true);
        let (_, rests) = jog_and_let_go(&mut bench, 0.2 * side as f32, 400);
        assert!((side * (rests - q_rad) - 0.03).abs() < 1e-3, "at the limit: {rests}");
        let (released, rests) = jog_and_let_go(&mut bench, -0.2 * side as f32, 400);
        let further = side * (released - rests);
        assert!((0.0..REST_WAY_RAD + LAG_RAD).contains(&further), "{further}");
    }
}

#[test]
fn joint_outside_its_limits_whose_host_is_lost_during_a_jog_stops_after_its_braking_way() {
    for side in [1.0, -1.0] {
        let (mut bench, _) = beside_limit(side, 0.2, true);
        bench.order(jog(-0.2 * side as f32, 500)).unwrap();
        bench.run_for(200_000);
        bench.heartbeat = false;
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Stopping);
        let stopped_at = bench.drives[JOINT].q;
        bench.run_for(1_000_000);
        let further = side * (stopped_at - bench.drives[JOINT].q);
        assert!(
            (-1e-4..REST_WAY_RAD + LAG_RAD).contains(&further),
            "side {side}: {further} rad after the stop"
        );
    }
}

/// Its position counts from where it was switched on: it may be far from the true position.
#[test]
fn joint_without_a_zero_that_is_stopped_during_a_jog_stops_after_its_braking_way() {
    for side in [1.0, -1.0] {
        let (mut bench, _) = beside_limit(side, 0.5, false);
        bench.order(jog(0.2 * side as f32, 500)).unwrap();
        bench.run_for(300_000);
        let stopped_at = bench.drives[JOINT].q;
        bench.order(Order::Stop).unwrap();
        bench.run_for(1_000_000);
        let further = side * (bench.drives[JOINT].q - stopped_at);
        assert!(
            (-1e-4..REST_WAY_RAD + LAG_RAD).contains(&further),
            "side {side}: {further} rad after the stop"
        );
        assert_eq!(bench.kind(), StateKind::Stopped, "{:?}", bench.controller.state());
    }
}

/// A motion that is on the bus already ends within a step of the encoder.
#[test]
fn jog_that_is_let_go_before_it_has_begun_moves_nothing() {
    for let_go_us in [0, 2_000, 5_000, 10_000, 15_000, 20_000] {
        let (mut bench, q_rad) = beside_limit(1.0, -0.5, true);
        bench.order(jog(0.2, 500)).unwrap();
        bench.run_until(let_go_us, |bench| bench.sent_after(0, is_motion).is_some());
        let begun = bench.sent_after(0, is_motion).is_some();
        bench.order(jog(0.0, 50)).unwrap();
        bench.run_until(2_000_000, |bench| bench.kind() == StateKind::Ready);
        let moved = (bench.drives[JOINT].q - q_rad).abs();
        assert!(begun || moved < 5e-4, "let go after {let_go_us} us: {moved} rad");
    }
}

#[test]
fn stop_of_a_jog_that_has_not_begun_sends_no_motion() {
    let (mut bench, _) = beside_limit(1.0, -0.5, true);
    let motions = |bench: &Bench| {
        let sent = bench.log.iter().filter(|logged| logged.by_controller);
        let requests = sent.filter_map(|logged| AddressedRequest::decode(&logged.frame).ok());
        requests.filter(|addressed| matches!(addressed.request, Request::Move(_))).count()
    };
    let before = motions(&bench);
    bench.order(jog(0.2, 500)).unwrap();
    bench.run_for(500);
    assert_eq!(bench.kind(), StateKind::Jogging);
    bench.order(Order::Stop).unwrap();
    bench.run_for(1_000_000);
    assert_eq!(motions(&bench), before);
    assert_eq!(bench.kind(), StateKind::Stopped, "{:?}", bench.controller.state());
}
