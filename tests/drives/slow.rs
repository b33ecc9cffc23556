//! Jogging: to a limit, released, from outside the limits.

use firmware::group::DriveGroup;
use firmware::orders::Order;
use firmware::state::StateKind;
use protocol::Duration;

use crate::rig::{Rig, joint, settings};

const HOLD: Duration = Duration::from_millis(200);

fn jog(rig: &mut Rig, index: usize, qd_rad_s: f32, ms: u64) {
    for _ in 0..ms / 100 {
        rig.order(Order::Jog { joint: joint(index), qd_rad_s, hold: HOLD });
        rig.run_us(100_000);
    }
}

#[test]
fn a_jog_that_is_not_repeated_ramps_to_rest() {
    let mut rig = Rig::ready();
    jog(&mut rig, 3, 0.2, 500);
    assert_eq!(rig.kind(), StateKind::Jogging);
    let last = rig.now();
    rig.run_to(1_000, StateKind::Ready);
    // The hold of the last order, the ramp of 0.2 s, the window of rest.
    assert!(rig.now().saturating_since(last).as_micros() < 500_000, "{:?}", rig.now().saturating_since(last));
    // 0.6 s at 0.2 rad/s with ramps of 1 rad/s2.
    let q_rad = rig.shafts()[3];
    assert!((q_rad - 0.12).abs() < 5e-3, "{q_rad}");
    let fastest = rig.track.windows(2).map(|pair| (pair[1].1[3] - pair[0].1[3]) / 1e-3).fold(0.0, f64::max);
    assert!((0.19..0.23).contains(&fastest), "{fastest}");
    let others = [0, 1, 2, 4, 5, 6].map(|i| rig.shafts()[i].abs()).into_iter().fold(0.0, f64::max);
    assert!(others < 1e-3, "{others}");
}

#[test]
fn a_jog_ends_at_the_limit_and_leads_back_from_it() {
    let mut near = settings();
    near.joint.at_mut(joint(3)).q_max_rad = 0.1;
    near.gains_certificate_crc32 = firmware::registers::certificate_crc32(&near);
    let mut rig = Rig::with(&near, |_, _| {});
    rig.run_to(500, StateKind::Idle);
    rig.order(Order::Home { mask: 0x7F });
    rig.run_to(1_000, StateKind::Ready);
    jog(&mut rig, 3, 0.25, 1_500);
    rig.run_to(1_000, StateKind::Ready);
    let furthest = rig.track.iter().map(|(_, q)| q[3]).fold(0.0, f64::max);
    assert!((0.098..0.102).contains(&furthest), "{furthest}");
    jog(&mut rig, 3, -0.25, 300);
    rig.run_to(1_000, StateKind::Ready);
    assert!(rig.shafts()[3] < 0.04);
}

#[test]
fn a_joint_that_is_not_at_home_is_jogged_back_into_its_limits() {
    let mut away = settings();
    away.joint.at_mut(joint(0)).q_min_rad = 0.1;
    let mut rig = Rig::with(&away, |_, _| {});
    rig.run_to(500, StateKind::Idle);
    // Outwards and back: without a place within the limits its position says nothing about them.
    jog(&mut rig, 0, -0.2, 200);
    rig.run_to(1_000, StateKind::Idle);
    assert!(rig.shafts()[0] < -0.03);
    jog(&mut rig, 0, 0.25, 1_000);
    rig.run_to(1_000, StateKind::Idle);
    rig.order(Order::Home { mask: 0x7F });
    rig.run_to(1_000, StateKind::Ready);
    assert!(rig.controller().group().is_homed(joint(0)));
}
