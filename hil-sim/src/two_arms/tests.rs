//! A ball, cups and hands that stand or turn.

use super::*;

/// Arm 1 holds its cup upright over its base, at rest; the ball comes from above with `v` and `off` beside the axis.
fn thrown(off_m: f64, v: [f64; 3], change: impl Fn(&mut TwoArmOptions)) -> TwoArmCell {
    let mut options = TwoArmOptions::two_arms().unwrap();
    options.tracker.noise_mm = 0.0;
    change(&mut options);
    let upright = [0.0, -90.0, -90.0, 0.0, 0.0, 0.0].map(f64::to_radians);
    let rest = JointsNow { q: JointVec::from(upright), qd: JointVec::zeros(6) };
    let mut cell = TwoArmCell::new(options, 0, [rest; 2]);
    let (mouth, _) = cell.mouth(&cell.hand(1), 0.0);
    cell.throw_in(LooseBall {
        p_m: mouth.pos + Vector3::new(off_m, 0.0, 0.3),
        v_m_s: Vector3::from(v),
        spin_rad_s: Vector3::zeros(),
    });
    for ms in 1..=2000 {
        cell.step(Instant::from_micros(ms * 1000), [rest; 2]);
    }
    cell
}

fn has(cell: &TwoArmCell, wanted: impl Fn(&TwoArmEvent) -> bool) -> bool {
    cell.events().iter().any(|(_, event)| wanted(event))
}

#[test]
fn a_ball_into_the_middle_of_the_cup_comes_to_rest_in_it() {
    let cell = thrown(0.0, [0.0, 0.0, -2.0], |_| {});
    assert_eq!(cell.resting_in(), Some(1));
    let rest_e_m = cell.options.cup.rest_e_m(0.03);
    let at = cell.hand(1).x_we.transform_point(&rest_e_m);
    assert!((cell.ball().0 - at).norm() < 1e-3, "{} {at}", cell.ball().0);
    let crossing = cell.events().iter().find_map(|(_, e)| match e {
        TwoArmEvent::Crossed { arm: 1, crossing } => Some(*crossing),
        _ => None,
    });
    let crossing = crossing.unwrap();
    let speed = (4.0_f64 + 2.0 * 9.81 * 0.3).sqrt();
    assert!(crossing.miss_m < 1e-3 && crossing.angle_rad < 1e-3, "{crossing:?}");
    assert!((crossing.speed_m_s - speed).abs() < 0.02, "{crossing:?}");
}

#[test]
fn a_ball_beside_the_cup_hits_its_rim_and_ends_on_the_floor() {
    let cell = thrown(0.075, [0.0, 0.0, -2.0], |_| {});
    assert_eq!(cell.resting_in(), None);
    assert!(has(&cell, |e| matches!(e, TwoArmEvent::HitCup { arm: 1, .. })));
    assert!(has(&cell, |e| *e == TwoArmEvent::HitFloor), "{:?}", cell.events());
}

#[test]
fn a_ball_that_bounces_well_jumps_out_of_a_shallow_cup() {
    let cell = thrown(0.03, [0.3, 0.0, -3.5], |options| {
        options.cup.surface.restitution = 0.9;
        options.cup.shape.depth_m = 0.05;
    });
    assert_eq!(cell.resting_in(), None, "{:?}", cell.events());
}

#[test]
fn open_jaws_are_no_cup() {
    let mut options = TwoArmOptions::two_arms().unwrap();
    options.tracker.noise_mm = 0.0;
    let rest = JointsNow { q: JointVec::zeros(6), qd: JointVec::zeros(6) };
    let cell = TwoArmCell::new(options, 0, [rest; 2]);
    assert_eq!(cell.jaws_open, [true, false]);
}

/// The release is given to the microsecond, and the ball leaves with the velocity of its place in the hand.
#[test]
fn a_released_ball_leaves_with_the_hands_velocity_and_the_tracker_sees_it_from_then_on() {
    let mut options = TwoArmOptions::two_arms().unwrap();
    options.tracker.noise_mm = 0.0;
    options.ball.drag_1_m = 0.0;
    let qd = JointVec::from([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let q0 = JointVec::from([0.0, -20.0, -110.0, 0.0, 0.0, 0.0].map(f64::to_radians));
    let at = |ms: u64| JointsNow { q: q0 + qd * (ms as f64 * 1e-3), qd };
    let rest = JointsNow { q: q0, qd: JointVec::zeros(6) };
    let mut cell = TwoArmCell::new(options, 0, [at(0), rest]);
    cell.release_at(Instant::from_micros(50_350));
    let mut stamps = Vec::new();
    for ms in 1..=150 {
        cell.step(Instant::from_micros(ms * 1000), [at(ms), rest]);
        while let Some(bytes) = cell.poll_datagram() {
            let frame = tracker_protocol::dtrack::DataFrame::parse(&bytes).unwrap();
            if frame.markers.is_some_and(|m| !m.is_empty()) {
                stamps.push(frame.ts2.unwrap().us % 1_000_000);
            }
        }
    }
    assert_eq!(cell.released_at(), Some((0, Instant::from_micros(50_350))));
    let model = &cell.options.arms[0].model;
    let frames = model.fk(&(q0 + qd * 0.05035));
    let ball = model.ball(&frames).pos;
    let v = Vector3::z().cross(&ball);
    let t = 0.150 - 0.05035;
    let expected = ball + v * t - Vector3::z() * (0.5 * 9.81 * t * t);
    assert!((cell.ball().0 - expected).norm() < 2e-4, "{} {expected}", cell.ball().0);
    // First flash after the release: the seventh after the one at zero.
    assert_eq!(stamps.first(), Some(&58_331));
    // 15 ms of latency: the flash at 133.3 ms has arrived, that at 141.7 ms has not.
    assert_eq!(stamps.last(), Some(&133_328));
}

#[test]
fn jaws_that_close_around_a_ball_at_rest_grip_it_where_it_lies_and_let_it_go_again() {
    let mut cell = thrown(0.03, [0.0, 0.0, -2.0], |_| {});
    assert_eq!((cell.resting_in(), cell.holder()), (Some(1), None));
    let lies_m = cell.ball().0;
    cell.set_jaws(1, false);
    assert_eq!((cell.resting_in(), cell.holder()), (Some(1), Some(1)));
    assert!((cell.ball().0 - lies_m).norm() < 1e-9);
    // The order to the other hand changes nothing for the ball.
    cell.set_jaws(0, false);
    assert_eq!(cell.holder(), Some(1));
    let rest = cell.joints;
    let begin = cell.now();
    cell.release_at(begin + Duration::from_millis(5));
    for ms in 1..=20 {
        cell.step(begin + Duration::from_millis(ms), rest);
    }
    assert_eq!((cell.resting_in(), cell.holder(), cell.jaws_open), (None, None, [false, true]));
    assert!(has(&cell, |e| *e == TwoArmEvent::Gripped { arm: 1 }));
}

#[test]
fn jaws_that_open_under_a_ball_let_it_fall_and_closing_beside_a_ball_grips_nothing() {
    let mut cell = thrown(0.0, [0.0, 0.0, -2.0], |_| {});
    cell.set_jaws(1, true);
    let (rest, begin) = (cell.joints, cell.now());
    for ms in 1..=1000 {
        cell.step(begin + Duration::from_millis(ms), rest);
    }
    assert_eq!((cell.resting_in(), cell.holder()), (None, None));
    cell.set_jaws(1, false);
    assert_eq!(cell.holder(), None);
}
