use super::*;
use proptest::prelude::*;

fn joint(index: usize) -> JointIndex {
    JointIndex::new(index).unwrap()
}

/// The same polynomial in another form: double precision, Hermite basis functions.
fn oracle(c: &Cubic, tau: f64) -> (f64, f64, f64) {
    let [h, q0, v0, q1, v1] = [c.h_s, c.q0_rad, c.qd0_rad_s, c.q1_rad, c.qd1_rad_s].map(f64::from);
    let (t, t2, t3) = (tau, tau * tau, tau * tau * tau);
    let q = (2.0 * t3 - 3.0 * t2 + 1.0) * q0
        + (t3 - 2.0 * t2 + t) * h * v0
        + (3.0 * t2 - 2.0 * t3) * q1
        + (t3 - t2) * h * v1;
    let qd =
        (6.0 * t2 - 6.0 * t) * (q0 - q1) / h + (3.0 * t2 - 4.0 * t + 1.0) * v0 + (3.0 * t2 - 2.0 * t) * v1;
    let qdd = (12.0 * t - 6.0) * (q0 - q1) / (h * h) + (6.0 * t - 4.0) * v0 / h + (6.0 * t - 2.0) * v1 / h;
    (q, qd, qdd)
}

fn cubics() -> impl Strategy<Value = Cubic> {
    (0.002f32..2.0, -6.2f32..6.2, -4.0f32..4.0, -1.0f32..1.0, -4.0f32..4.0).prop_map(
        |(h_s, q0_rad, qd0_rad_s, mean, qd1_rad_s)| Cubic {
            h_s,
            q0_rad,
            qd0_rad_s,
            q1_rad: q0_rad + 4.0 * mean * h_s,
            qd1_rad_s,
        },
    )
}

/// Checks the stated errors of single precision, on segments of up to 8 rad: position, velocity, acceleration.
fn assert_within_the_stated_error(c: &Cubic, tau: f32) {
    let (q, qd, qdd) = oracle(c, tau.into());
    let (got, h) = (c.at(tau), f64::from(c.h_s));
    let off = [f64::from(got.q_rad) - q, f64::from(got.qd_rad_s) - qd, f64::from(got.qdd_rad_s2) - qdd];
    for (off, bound) in off.into_iter().zip([8e-6, 32e-6 / h, 96e-6 / (h * h)]) {
        assert!(off.abs() <= bound, "{off} beyond {bound} at {tau} of {c:?}");
    }
}

/// Found by the property test below, with tighter bounds: 7.6 and 5.5 rad of way in one segment that begins in the
/// opposite direction. Coefficients of 35 and -21 rad cancel to a few radians just before the end, and their
/// rounding remains.
#[test]
fn long_fast_segments_that_turn_round_stay_within_the_stated_error() {
    let turns =
        Cubic { h_s: 1.988_578_9, q0_rad: 0.0, qd0_rad_s: -3.123_651_7, q1_rad: 7.585_407_7, qd1_rad_s: 0.0 };
    assert_within_the_stated_error(&turns, 0.970_423_5);
    let swings = Cubic {
        h_s: 1.659_352_8,
        q0_rad: 0.0,
        qd0_rad_s: -3.438_891_2,
        q1_rad: 5.497_6,
        qd1_rad_s: -3.817_767_9,
    };
    assert_within_the_stated_error(&swings, 0.960_382_8);
}

proptest! {
    #[test]
    fn single_precision_stays_within_the_stated_error(c in cubics(), tau in 0.0f32..=1.0) {
        assert_within_the_stated_error(&c, tau);
    }

    #[test]
    fn extremes_bound_every_sample_and_are_attained(c in cubics()) {
        let worst = c.extremes();
        let mut seen = (f32::INFINITY, f32::NEG_INFINITY, 0.0f32, 0.0f32);
        for i in 0..=2000 {
            let s = c.at(i as f32 / 2000.0);
            seen = (seen.0.min(s.q_rad), seen.1.max(s.q_rad), seen.2.max(s.qd_rad_s.abs()), seen.3.max(s.qdd_rad_s2.abs()));
        }
        let (dq, dv) = (5e-6, 2e-5 / c.h_s);
        prop_assert!(worst.q_min_rad <= seen.0 + dq && worst.q_max_rad >= seen.1 - dq);
        prop_assert!(worst.qd_abs_rad_s >= seen.2 - dv);
        // The bound is not far above either: a grid of 2000 misses the top of a parabola by less than this.
        let slack = worst.qdd_abs_rad_s2 * c.h_s * c.h_s * 1e-6 + dq;
        prop_assert!(worst.q_min_rad >= seen.0 - slack && worst.q_max_rad <= seen.1 + slack);
    }

    #[test]
    fn seeking_in_any_order_gives_the_same_as_from_the_start(times in proptest::collection::vec(-10_000i64..600_000, 1..40)) {
        let mut spline = Spline::empty();
        spline.clear(1);
        for i in 0..50u32 {
            let state = PerJoint::splat((libm::sinf(i as f32), libm::cosf(i as f32)));
            let pushed = spline.push(&Knot { t_us: i * 10_000, state });
            prop_assert!(pushed);
        }
        for t in times {
            let mut fresh = spline.clone();
            (fresh.cursor, fresh.active) = (0, PerJoint::splat(Active::NONE));
            prop_assert_eq!(spline.at(joint(0), t), fresh.at(joint(0), t));
        }
    }
}

#[test]
fn reference_stands_before_the_start_and_after_the_end() {
    let mut spline = Spline::empty();
    assert_eq!(spline.at(joint(0), 5), Setpoint::default());
    spline.clear(1);
    assert!(spline.push(&Knot { t_us: 0, state: PerJoint::splat((1.0, 0.5)) }));
    assert!(!spline.push(&Knot { t_us: 0, state: PerJoint::default() }), "time must grow");
    assert!(spline.push(&Knot { t_us: 10_000, state: PerJoint::splat((2.0, 0.5)) }));
    let standing = |q_rad| Setpoint { q_rad, ..Setpoint::default() };
    assert_eq!(spline.at(joint(0), -1), standing(1.0));
    assert_eq!(spline.at(joint(0), 10_000), standing(2.0));
    assert_eq!(spline.at(joint(0), i64::MAX), standing(2.0));
    assert_eq!(spline.at(joint(0), 0).qd_rad_s, 0.5);
}

#[test]
fn a_full_spline_takes_no_more_knots() {
    let mut spline = Spline::empty();
    for (joints, most) in [(1, 256), (6, 256), (7, 221), (8, 195)] {
        spline.clear(joints);
        for i in 0..most {
            let state = PerJoint::splat((i as f32, -1.0));
            assert!(spline.push(&Knot { t_us: i * 5_000, state }), "{joints} joints, knot {i}");
        }
        assert!(!spline.push(&Knot { t_us: u32::MAX, ..Knot::default() }));
        assert_eq!((spline.len(), knots_max(joints)), (most as usize, most as usize));
        assert_eq!(spline.knot(100).map(|knot| knot.state.0[joints - 1]), Some((100.0, -1.0)));
    }
}

#[test]
fn throw_cubic_has_the_acceleration_of_the_printed_formula() {
    // s = t - ha: qd = qd_r (1 - s²/ha²): at t = 0 acceleration 2 qd_r / ha, at release zero.
    let (qd_r, ha) = (2.548_397_f32, 0.56);
    let c = Cubic { h_s: ha, q0_rad: 0.0, qd0_rad_s: 0.0, q1_rad: 2.0 / 3.0 * qd_r * ha, qd1_rad_s: qd_r };
    assert!((c.at(0.0).qdd_rad_s2 - 2.0 * qd_r / ha).abs() < 1e-5);
    assert!(c.at(1.0).qdd_rad_s2.abs() < 1e-5);
    assert!((c.extremes().qdd_abs_rad_s2 - 2.0 * qd_r / ha).abs() < 1e-5);
}

/// Knots are added and forgotten for two hours; times on the wire begin anew every 71 minutes.
#[test]
fn ring_of_knots_gives_the_same_as_each_segment_by_itself_for_two_hours() {
    const STEP_US: u64 = 500_000;
    let state = |k: u64| PerJoint::splat((libm::sinf(k as f32), libm::cosf(k as f32)));
    let knot = |k: u64| Knot { t_us: (k * STEP_US) as u32, state: state(k) };
    let mut spline = Spline::empty();
    spline.clear(8);
    (0..100).for_each(|k| assert!(spline.push(&knot(k))));
    assert!(!spline.is_altered());
    let most = knots_max(8) as u64;
    let mut next = 100;
    for now in 50..14_400 {
        let t_us = (now * STEP_US) as i64 + 123_456;
        spline.forget_before(t_us - 1_000_000);
        while spline.room() > 0 {
            assert!(spline.extend(&knot(next)));
            next += 1;
        }
        assert!((now + most - 4..=now + most).contains(&next), "{now} {next}");
        assert!(!spline.extend(&knot(next)) && spline.is_altered());
        for (k, at_us) in
            [(now, t_us), (now - 1, t_us - STEP_US as i64), (next - 2, ((next - 2) * STEP_US) as i64)]
        {
            let (from, to) = (state(k).0[7], state(k + 1).0[7]);
            let cubic = Cubic { h_s: 0.5, q0_rad: from.0, qd0_rad_s: from.1, q1_rad: to.0, qd1_rad_s: to.1 };
            let into_s = (at_us - (k * STEP_US) as i64) as f32 * 1e-6;
            assert_eq!(spline.at(joint(7), at_us), cubic.at(into_s / 0.5), "{k}");
        }
        assert_eq!(spline.end_us(), ((next - 1) * STEP_US) as i64);
    }
    spline.clear(6);
    assert!(spline.is_empty() && !spline.is_altered() && spline.end_us() == 0);
}
