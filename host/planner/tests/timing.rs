//! Motions from paths: limits on dense samples, closed forms, and what other laws need at least.

use planner::motion::Motion;
use planner::plan::rng::SplitMix64;
use planner::timing::{GivenError, Limits, Path, Row, Straight, along, motion_of_rows, straight};
use proptest::prelude::*;

fn limits(n: usize, v: f64, a: f64, j: f64) -> Limits {
    Limits::new(&vec![v; n], &vec![a; n], &vec![j; n]).unwrap()
}

/// Largest speed, acceleration and jerk of any joint, by differences of the sampled angles alone.
fn sampled(motion: &Motion, dt: f64) -> [f64; 3] {
    let steps = (motion.duration_s() / dt).ceil() as usize;
    let q: Vec<_> = (0..=steps + 2).map(|i| motion.at(i as f64 * dt - dt).q).collect();
    let mut most = [0.0_f64; 3];
    for w in q.windows(2) {
        most[0] = most[0].max((w[1] - w[0]).amax() / dt);
    }
    for w in q.windows(3) {
        most[1] = most[1].max((w[2] - w[1] * 2.0 + w[0]).amax() / (dt * dt));
    }
    for w in q.windows(4) {
        most[2] = most[2].max((w[3] - w[2] * 3.0 + w[1] * 3.0 - w[0]).amax() / dt.powi(3));
    }
    most
}

#[test]
fn straight_motion_reaches_each_limit_it_can_and_exceeds_no_limit() {
    let limits = limits(6, 2.0, 8.0, 80.0);
    for way in [1e-4, 0.01, 0.1, 0.3, 1.0, 3.0] {
        let motion: Motion =
            straight(&[0.0; 6], &[way, -way, 0.5 * way, 0.0, 0.1 * way, way], &limits).unwrap();
        let [v, a, j] = sampled(&motion, motion.duration_s() / 3_000.0);
        assert!(
            v <= 2.0 * (1.0 + 1e-6) && a <= 8.0 * (1.0 + 1e-6) && j <= 80.0 * (1.0 + 1e-4),
            "{way}: {v} {a} {j}"
        );
        assert!(j >= 80.0 * 0.99, "{way}: the jerk is used: {j}");
        // 3 rad suffice for the cruise: v/a + a/j + way/v.
        if way == 3.0 {
            assert!((motion.duration_s() - (0.25 + 0.1 + 1.5)).abs() < 1e-8 && (v - 2.0).abs() < 1e-6);
        }
        assert_eq!(motion.stop_rad()[1], -way);
    }
}

proptest! {
    #[test]
    fn straight_profile_is_as_long_as_the_sum_of_its_parts_says_and_no_part_is_negative(
        way in 1e-6..10.0_f64, v in 0.05..5.0_f64, a in 0.1..50.0_f64, j in 0.5..1000.0_f64
    ) {
        let p = Straight::new(way, v, a, j);
        prop_assert!(p.jerk_s >= 0.0 && p.cruise_s >= 0.0 && p.accelerate_s >= 2.0 * p.jerk_s - 1e-12);
        // Way of two ramps and the cruise, by the peak speed: independent of how the pieces are integrated.
        let top = a.min(j * p.jerk_s) * (p.accelerate_s - p.jerk_s);
        prop_assert!((top * (p.accelerate_s + p.cruise_s) - way).abs() < 1e-9 * way.max(1.0));
        prop_assert!(top <= v * (1.0 + 1e-9));
        // No law is faster than the one without the limit of jerk.
        let no_jerk = Straight::new(way, v, a, f64::INFINITY);
        let plain = if way > v * v / a { way / v + v / a } else { 2.0 * (way / a).sqrt() };
        prop_assert!((no_jerk.duration_s() - plain).abs() < 1e-9);
        prop_assert!(p.duration_s() >= plain - 1e-12);
    }
}

/// Corners of a random path of `count` points.
fn corners(rng: &mut SplitMix64, count: usize) -> Vec<Vec<f64>> {
    (0..count).map(|_| (0..6).map(|_| 2.0 * rng.unit() - 1.0).collect()).collect()
}

#[test]
fn motions_along_paths_keep_the_limits_pass_the_corners_and_end_at_rest() {
    let (v, a, j) = (2.0, 8.0, 80.0);
    let limits = limits(6, v, a, j);
    let mut rng = SplitMix64::new(5);
    for round in 0..40 {
        let points = corners(&mut rng, 2 + round % 6);
        let blend = [0.0, 0.01, 0.1, 0.5][round % 4];
        let path = Path::through(&points, blend).unwrap();
        let motion: Motion = along(&path, &limits).unwrap();
        let [sv, sa, sj] = sampled(&motion, 1e-3);
        assert!(sv <= v * 1.000_1 && sa <= a * 1.000_1 && sj <= j * 1.01, "{round}: {sv} {sa} {sj}");
        assert_eq!(motion.start_rad().as_slice(), &points[0][..]);
        assert_eq!(motion.stop_rad().as_slice(), &points[points.len() - 1][..]);
        let ends = [motion.knots[0], motion.knots[motion.knots.len() - 1]];
        assert!(ends.iter().all(|knot| knot.qd_rad_s.amax() == 0.0));
        for point in &points {
            let near = (0..=4_000)
                .map(|i| motion.at(motion.duration_s() * f64::from(i) / 4_000.0).q)
                .map(|q| q.iter().zip(point).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt())
                .fold(f64::INFINITY, f64::min);
            assert!(near <= blend + 3e-3, "{round}: {near} rad from a corner with a blend of {blend}");
        }
    }
}

#[test]
fn on_a_line_the_motion_along_a_path_is_the_straight_one_and_rounding_corners_saves_time() {
    let limits = limits(6, 2.0, 8.0, 80.0);
    let (from, to) = ([0.0; 6], [2.0, 1.0, 0.0, -1.0, 0.5, 0.2]);
    let best: Motion = straight(&from, &to, &limits).unwrap();
    let path = Path::through(&[from, to], 0.1).unwrap();
    let motion: Motion = along(&path, &limits).unwrap();
    let ratio = motion.duration_s() / best.duration_s();
    assert!((0.999..1.02).contains(&ratio), "{ratio}");

    let points = corners(&mut SplitMix64::new(8), 6);
    let of = |blend| along(&Path::through(&points, blend).unwrap(), &limits).unwrap().duration_s();
    let resting = of(0.0);
    assert!([0.001, 0.02, 0.1].into_iter().all(|blend| of(blend) <= resting));
    assert!(of(0.4) < of(0.2) && of(0.2) < 0.97 * resting && of(0.4) < 0.85 * resting);
}

#[test]
fn without_a_limit_of_jerk_a_path_is_as_fast_as_the_slowest_joint_allows() {
    let limits = Limits::new(&[2.0; 6], &[8.0; 6], &[f64::INFINITY; 6]).unwrap();
    let path = Path::through(&[[0.0; 6], [1.0, 0.5, 0.0, 0.0, 0.0, 0.0]], 0.0).unwrap();
    let motion: Motion = along(&path, &limits).unwrap();
    assert!((motion.duration_s() - (0.5 + 0.25)).abs() < 5e-3, "{}", motion.duration_s());
}

fn rows(speeds: bool) -> Vec<Row> {
    let q = |t: f64| {
        (
            0.3 * (1.0 - (std::f64::consts::PI * t).cos()),
            0.3 * std::f64::consts::PI * (std::f64::consts::PI * t).sin(),
        )
    };
    (0..=20)
        .map(|i| {
            let t_s = f64::from(i) * 0.1;
            let (q, v) = q(t_s);
            Row { t_s: 5.0 + t_s, q_rad: vec![q; 6], qd_rad_s: speeds.then(|| vec![v; 6]) }
        })
        .collect()
}

#[test]
fn points_with_times_are_followed_at_these_times_with_and_without_their_speeds() {
    let limits = limits(6, 2.0, 8.0, 80.0);
    for speeds in [false, true] {
        let motion: Motion = motion_of_rows(&rows(speeds), &limits).unwrap();
        assert!((motion.duration_s() - 2.0).abs() < 1e-12);
        for i in 0..=200 {
            let t = f64::from(i) * 0.01;
            let wanted = 0.3 * (1.0 - (std::f64::consts::PI * t).cos());
            assert!((motion.at(t).q[3] - wanted).abs() < 1e-4, "{t}");
        }
    }
}

#[test]
fn points_with_times_that_exceed_a_limit_name_joint_time_value_and_limit() {
    let text = motion_of_rows(&rows(true), &limits(6, 0.9, 8.0, 80.0)).unwrap_err().to_string();
    assert!(
        text.starts_with("joint 1: speed 0.9") && text.contains("exceeds the limit 0.9000 rad/s"),
        "{text}"
    );
    let acceleration = motion_of_rows(&rows(true), &limits(6, 2.0, 2.0, 80.0)).unwrap_err();
    assert!(
        matches!(acceleration, GivenError::Limit { what: "acceleration", limit: 2.0, .. }),
        "{acceleration:?}"
    );
    let jerk = motion_of_rows(&rows(true), &limits(6, 2.0, 8.0, 5.0)).unwrap_err();
    assert!(matches!(jerk, GivenError::Limit { what: "jerk", .. }), "{jerk:?}");
    let mut late = rows(false);
    late[7].t_s = late[6].t_s;
    assert_eq!(
        motion_of_rows(&late, &limits(6, 2.0, 8.0, 80.0)).unwrap_err(),
        GivenError::Order { row: 7, t_s: late[6].t_s, before_s: late[6].t_s }
    );
    let mut moving = rows(true);
    moving.truncate(10);
    let text = motion_of_rows(&moving, &limits(6, 2.0, 8.0, 80.0)).unwrap_err().to_string();
    assert!(text.contains("must begin and end at rest"), "{text}");
}
