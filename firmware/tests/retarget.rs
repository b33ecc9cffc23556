//! The law of new end states against brute force: continuity, the end state in time, the envelope, the least peak.

use std::ops::RangeInclusive;

use firmware::envelope::Envelope;
use firmware::retarget::{
    Course, EndState, JointEnvelope, OutOfReach, PIECE_MIN_US, REACH_MAX_US, REACH_MIN_US,
};
use firmware::settings::Settings;
use proptest::prelude::*;
use protocol::JointIndex;

const ENVELOPE: JointEnvelope =
    JointEnvelope { q_min_rad: -2.5, q_max_rad: 2.5, v_max_rad_s: 2.0, a_max_rad_s2: 9.0 };

/// Position, velocity and acceleration at a time since the begin, s, in double precision.
fn at(course: &Course, from_us: u32, t_s: f64) -> (f64, f64, f64) {
    let since = |t_us: u32| f64::from(t_us - from_us) * 1e-6;
    let piece = course.pieces().iter().rev().find(|piece| since(piece.t_us) <= t_s).unwrap();
    let dt = t_s - since(piece.t_us);
    let [q, v, a] = [piece.q_rad, piece.qd_rad_s, piece.qdd_rad_s2].map(f64::from);
    (q + v * dt + 0.5 * a * dt * dt, v + a * dt, a)
}

fn states() -> impl Strategy<Value = (u32, u32, EndState, EndState)> {
    let state = || (-2.4f32..2.4, -1.9f32..1.9).prop_map(|(q_rad, qd_rad_s)| EndState { q_rad, qd_rad_s });
    // Mostly short times, and ends that are near the continuation of the motion.
    let reach = prop_oneof![REACH_MIN_US..200_000u32, 200_000u32..1_500_000, 1_500_000..=REACH_MAX_US];
    (0u32..100_000_000, reach, state(), state(), 0.0f32..1.0).prop_map(
        |(from_us, reach_us, start, end, near)| {
            let t = reach_us as f32 * 1e-6;
            let straight = start.q_rad + 0.5 * (start.qd_rad_s + end.qd_rad_s) * t;
            let q_rad = near * end.q_rad + (1.0 - near) * straight;
            (from_us, from_us + reach_us, start, EndState { q_rad, ..end })
        },
    )
}

/// Least peak acceleration that the time allows without a limit of speed: bisection over two-piece motions.
fn least_peak(start: EndState, end: EndState, t: f64) -> f64 {
    let [q0, v0, q1, v1] = [start.q_rad, start.qd_rad_s, end.q_rad, end.qd_rad_s].map(f64::from);
    let way = q1 - q0;
    // With |acceleration| <= a the farthest and nearest way in the time, ending at v1.
    let reaches = |a: f64| {
        let change = v1 - v0;
        if change.abs() > a * t {
            return false;
        }
        let switch = |sign: f64| {
            let up = 0.5 * (t + sign * change / a);
            let v = v0 + sign * a * up;
            0.5 * (v0 + v) * up + 0.5 * (v + v1) * (t - up)
        };
        (switch(-1.0)..=switch(1.0)).contains(&way)
    };
    let (mut low, mut high) = (0.0, 1e6);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if reaches(middle) { high = middle } else { low = middle }
    }
    high
}

/// Peak acceleration of a course without a cruise, and the range it must be in: the least that the time allows, with rounding.
fn peaks(
    course: &Course,
    (from_us, start): (u32, EndState),
    (to_us, end): (u32, EndState),
) -> (f64, RangeInclusive<f64>) {
    let (pieces, t) = (course.pieces(), f64::from(to_us - from_us) * 1e-6);
    let peak = f64::from(pieces[0].qdd_rad_s2.abs().max(pieces[2].qdd_rad_s2.abs()));
    let least = least_peak(start, end, t);
    // A piece is not shorter than this.
    let lengthened = least * 2.5e-6 * f64::from(PIECE_MIN_US) / t;
    // The speed at the switch has eight roundings of positions (0.24 urad) and twelve of speeds (0.12 urad/s). The time of the switch
    // has three of up to 0.5 us, the last to a whole microsecond. That changes the speed, and the length of the shorter piece.
    let shortest = f64::from((pieces[2].t_us - from_us).min(to_us - pieces[2].t_us)) * 1e-6;
    let rounding = (2e-6 / t + 1.5e-6 + 2.0 * least * 1.5e-6) / shortest;
    (peak, least - rounding..=least + lengthened + rounding)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn a_course_is_continuous_meets_its_end_state_in_time_and_then_rests(
        (from_us, to_us, start, end) in states(),
    ) {
        let Ok(course) = Course::solve((from_us, start), (to_us, end), &ENVELOPE) else { return Ok(()) };
        let t = f64::from(to_us - from_us) * 1e-6;
        let first = course.pieces()[0];
        prop_assert_eq!((first.q_rad, first.qd_rad_s, first.t_us), (start.q_rad, start.qd_rad_s, from_us));
        for pair in course.pieces().windows(2) {
            let h = f64::from(pair[1].t_us - pair[0].t_us) * 1e-6;
            let (q, v, _) = (
                f64::from(pair[0].q_rad) + f64::from(pair[0].qd_rad_s) * h
                    + 0.5 * f64::from(pair[0].qdd_rad_s2) * h * h,
                f64::from(pair[0].qd_rad_s) + f64::from(pair[0].qdd_rad_s2) * h,
                0.0,
            );
            let (dq, dv) = (q - f64::from(pair[1].q_rad), v - f64::from(pair[1].qd_rad_s));
            // Ends that are far outside any envelope have large numbers on the way: the bound is relative to them.
            let scale = 1.0 + pair.iter().map(|p| f64::from(p.q_rad.abs() + p.qd_rad_s.abs() * t as f32)).fold(0.0, f64::max);
            prop_assert!(dq.abs() <= 2e-6 * scale, "a step of {dq} rad");
            prop_assert!(dv.abs() <= 2e-5 * scale, "a step of {dv} rad/s");
        }
        let (q, v, _) = at(&course, from_us, t);
        prop_assert!((q - f64::from(end.q_rad)).abs() < 1e-6 && (v - f64::from(end.qd_rad_s)).abs() < 1e-6);
        let (_, v_after, a_after) = at(&course, from_us, t + 1.0);
        prop_assert_eq!((v_after, a_after), (0.0, 0.0));
    }

    #[test]
    fn what_passes_the_check_is_inside_by_dense_sampling_and_what_fails_is_outside(
        (from_us, to_us, start, end) in states(),
    ) {
        let course = match Course::solve((from_us, start), (to_us, end), &ENVELOPE) {
            Ok(course) => course,
            Err(OutOfReach::Velocity) => {
                // No motion within the speed covers the way in the time.
                let (t, way) = (f64::from(to_us - from_us) * 1e-6, f64::from(end.q_rad - start.q_rad).abs());
                prop_assert!(way > 0.95 * f64::from(ENVELOPE.v_max_rad_s) * t, "{way} rad in {t} s");
                return Ok(());
            }
            Err(other) => return Err(TestCaseError::fail(format!("{other:?}"))),
        };
        let t_end = f64::from(course.end_us() - from_us) * 1e-6;
        let steps = 4_000;
        let (mut low, mut high, mut fastest, mut hardest) = (f64::INFINITY, -f64::INFINITY, 0.0f64, 0.0f64);
        for k in 0..=steps {
            let (q, v, a) = at(&course, from_us, t_end * f64::from(k) / f64::from(steps));
            (low, high) = (low.min(q), high.max(q));
            (fastest, hardest) = (fastest.max(v.abs()), hardest.max(a.abs()));
        }
        let [q_min, q_max, v_max, a_max] =
            [ENVELOPE.q_min_rad, ENVELOPE.q_max_rad, ENVELOPE.v_max_rad_s, ENVELOPE.a_max_rad_s2].map(f64::from);
        let slack = 1e-4 * (1.0 + hardest);
        match course.check(&ENVELOPE) {
            Ok(()) => {
                prop_assert!(low >= q_min - 1e-5 && high <= q_max + 1e-5, "{low}..{high}");
                prop_assert!(fastest <= 1.0011 * v_max && hardest <= 1.0011 * a_max, "{fastest} {hardest}");
            }
            Err(OutOfReach::Position) => prop_assert!(low < q_min + slack || high > q_max - slack, "{low}..{high}"),
            Err(OutOfReach::Velocity) => prop_assert!(fastest > v_max, "{fastest}"),
            Err(OutOfReach::Acceleration) => prop_assert!(hardest > a_max, "{hardest}"),
            Err(OutOfReach::Numbers) => prop_assert!(false),
        }
    }

    #[test]
    fn the_peak_is_the_least_that_the_time_allows_where_the_speed_does_not_bind(
        (from_us, to_us, start, end) in states(),
    ) {
        let Ok(course) = Course::solve((from_us, start), (to_us, end), &ENVELOPE) else { return Ok(()) };
        // A cruise: the speed binds.
        prop_assume!(course.pieces()[1].t_us == course.pieces()[2].t_us);
        let (peak, least) = peaks(&course, (from_us, start), (to_us, end));
        prop_assert!(least.contains(&peak), "{peak} against {least:?}");
    }

    #[test]
    fn any_numbers_give_a_course_or_a_refusal(
        from_us: u32, to_us: u32, q0: f32, v0: f32, q1: f32, v1: f32,
    ) {
        let (start, end) = (EndState { q_rad: q0, qd_rad_s: v0 }, EndState { q_rad: q1, qd_rad_s: v1 });
        if let Ok(course) = Course::solve((from_us, start), (to_us, end), &ENVELOPE)
            && course.check(&ENVELOPE).is_ok()
        {
            for piece in course.pieces() {
                prop_assert!((-2.5..=2.5).contains(&piece.q_rad) && piece.qdd_rad_s2.abs() < 9.1);
            }
        }
    }
}

#[test]
fn a_last_piece_of_3_ms_after_9_s_has_the_least_peak_within_rounding() {
    let start = EndState { q_rad: -0.79256755, qd_rad_s: 1.7508895 };
    let end = EndState { q_rad: -1.4684088, qd_rad_s: -1.8928216 };
    let course = Course::solve((0, start), (9_366_344, end), &ENVELOPE).unwrap();
    let (peak, least) = peaks(&course, (0, start), (9_366_344, end));
    assert!(least.contains(&peak), "{peak} against {least:?}");
    assert!(least.end() - least.start() < 5e-3 * peak, "{least:?}");
}

#[test]
fn the_published_check_values_come_out() {
    let wide = JointEnvelope { q_min_rad: -9.0, q_max_rad: 9.0, v_max_rad_s: 3.0, a_max_rad_s2: 9.0 };
    let (start, end) = (EndState::default(), EndState { q_rad: 1.0, qd_rad_s: 1.0 });
    let course = Course::solve((0, start), (1_000_000, end), &wide).unwrap();
    let [first, _, second, ..] = course.pieces() else { panic!() };
    assert!((first.qdd_rad_s2 - 2.414).abs() < 1e-3, "{first:?}");
    assert!((second.t_us as f32 * 1e-6 - 0.707).abs() < 1e-3, "{second:?}");
    assert!((second.qd_rad_s - 1.707).abs() < 1e-3, "{second:?}");
}

#[test]
fn the_speed_of_the_envelope_becomes_a_piece_of_constant_speed() {
    let end = EndState { q_rad: 1.5, qd_rad_s: 0.5 };
    let course = Course::solve((0, EndState::default()), (1_000_000, end), &ENVELOPE).unwrap();
    let [_, cruise, last, ..] = course.pieces() else { panic!() };
    assert!((cruise.qd_rad_s - 2.0).abs() < 1e-4 && last.t_us - cruise.t_us > 100_000, "{course:?}");
    assert_eq!(course.check(&ENVELOPE), Ok(()));
    let too_far = EndState { q_rad: 2.1, qd_rad_s: 0.5 };
    let refused = Course::solve((0, EndState::default()), (1_000_000, too_far), &ENVELOPE);
    assert_eq!(refused, Err(OutOfReach::Velocity));
}

#[test]
fn an_end_state_whose_braking_leaves_the_envelope_is_refused() {
    // The end state can be reached, but 2²/18 rad of braking do not fit behind it.
    let end = |q_rad| EndState { q_rad, qd_rad_s: 1.9 };
    let check = |q_rad| {
        let start = EndState { q_rad: q_rad - 0.5, qd_rad_s: 0.0 };
        Course::solve((0, start), (600_000, end(q_rad)), &ENVELOPE).unwrap().check(&ENVELOPE)
    };
    assert_eq!(check(2.29), Ok(()));
    assert_eq!(check(2.31), Err(OutOfReach::Position));
}

#[test]
fn no_course_within_the_widest_envelope_is_turned_into_braking_by_the_drives() {
    // The drives brake when less way is left to a soft limit than full braking takes and one period of travel.
    let settings = Settings::powercube6();
    let widest = Envelope::widest(&settings);
    let joint = JointIndex::new(0).unwrap();
    let (limits, bounds) = (settings.joint.at(joint), widest.joint.at(joint));
    let period_s = f64::from(settings.cycle_period_s());
    let mut closest = f64::INFINITY;
    for k in 0..200 {
        let qd_rad_s = bounds.v_max_rad_s * (k as f32 / 200.0);
        // Braking ends exactly at the edge of the envelope.
        let q_rad = bounds.q_max_rad - 0.5 * qd_rad_s * qd_rad_s / bounds.a_max_rad_s2 - 1e-5;
        let start = EndState { q_rad: q_rad - 0.4, qd_rad_s: 0.0 };
        let course = Course::solve((0, start), (700_000, EndState { q_rad, qd_rad_s }), bounds).unwrap();
        assert_eq!(course.check(bounds), Ok(()), "{qd_rad_s}");
        for step in 0..2_000 {
            let (q, v, _) = at(&course, 0, f64::from(step) * 5e-4);
            let room = f64::from(limits.q_max_rad) - q;
            let needed = v * v / (2.0 * f64::from(limits.a_max_rad_s2)) + v.abs() * period_s;
            closest = closest.min(room - needed);
        }
    }
    assert!((-1e-5..1e-3).contains(&closest), "{closest}");
}
