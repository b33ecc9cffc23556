//! Throws with the whole cell in virtual time: plan, controller, bus, drives, arm and ball.
//!
//! The long runs are ignored by default: `cargo test --release -p cell-tests --test throw -- --ignored --nocapture`.
//! `THROWS` and `SEEDS` in the environment set how many.

mod rig;

use std::time::Instant as WallTime;

use hil_sim::mechanics::Flight;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector3, Vector6};
use planner::flight::Course;
use planner::plan::{Opening, Options};
use protocol::Duration;
use rayon::prelude::*;
use rig::{Outcome, Rig};

/// `robot-models` 1.7, and with free spin beyond the paper's reach.
const TARGETS_M: [[f64; 3]; 4] = [[1.0, 1.0, -1.0], [1.5, 0.0, -0.5], [2.0, 0.0, -1.0], [2.0, 0.0, 0.0]];

/// Of the arm's robot file.
const BALL_RADIUS_M: f64 = 0.03;

fn count(name: &str, default: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

#[test]
fn nominal_throws_land_within_five_millimetres_of_the_published_targets_in_the_median() {
    let rig = Rig::nominal();
    for target in TARGETS_M {
        let plan = rig.plan_thoroughly(target).unwrap_or_else(|| panic!("{target:?} is in reach"));
        // Gripper and encoders have their chances: the middle of three seeds, and none far out.
        let mut errors_m: Vec<f64> = (1..=3)
            .map(|seed| {
                let Outcome { landing_error_m, violations, .. } = rig.throw(&plan, seed);
                assert_eq!(violations, Vec::<String>::new(), "{target:?}, seed {seed}");
                landing_error_m
            })
            .collect();
        errors_m.sort_by(f64::total_cmp);
        println!(
            "{target:?}: {:.2} to {:.2} mm, median {:.2} mm",
            1e3 * errors_m[0],
            1e3 * errors_m[2],
            1e3 * errors_m[1]
        );
        assert!((1e-7..5e-3).contains(&errors_m[1]) && errors_m[2] < 0.01, "{target:?}: {errors_m:?}");
    }
}

/// Options of the default form without limits of the shift, for which a small search is enough.
fn nulled() -> Options {
    Options { delay_windows: Vec::new(), ..Options::best() }
}

#[test]
fn the_simulated_ball_passes_an_upright_opening_clear_of_its_rim() {
    let rig = Rig::nominal();
    let (centre, radius_m) = (Vector3::new(1.6, 0.2, -0.3), 0.1);
    let opening = Opening { normal: -Vector3::x(), radius_m, incidence_max_rad: 0.8 };
    let plan = rig.plan_with(centre.into(), Options { opening: Some(opening), ..nulled() });
    for seed in 1..=3 {
        let Outcome { landing_m, landing_error_m, released, .. } = rig.throw(&plan, seed);
        assert!(
            (landing_m.x - centre.x).abs() < 1e-6,
            "seed {seed}: on the plane of the opening: {landing_m}"
        );
        assert!(landing_error_m < 0.03, "seed {seed}: {landing_error_m} m from the centre");
        // The simulated world's own flight against the rim.
        let mut flight = Flight::new(released, 9.81, 0.0);
        let clear_m = (0..4_000)
            .map(|i| {
                let off = flight.at(f64::from(i) * 2.5e-4).p_m - centre;
                (off.yz().norm() - radius_m).hypot(off.x)
            })
            .fold(f64::INFINITY, f64::min);
        println!(
            "seed {seed}: {:.1} mm from the centre, {:.1} mm from the rim",
            1e3 * landing_error_m,
            1e3 * clear_m
        );
        assert!(clear_m > BALL_RADIUS_M, "seed {seed}: the ball touches the rim: {clear_m} m");
    }
}

#[test]
fn the_simulated_ball_meets_a_moving_target() {
    let rig = Rig::nominal();
    let (from, velocity) = (Vector3::new(1.3, -0.3, -0.6), Vector3::new(0.3, 0.5, 0.0));
    let course = Course::new(&[velocity.into()]).unwrap();
    let plan = rig.plan_with(from.into(), Options { course, ..nulled() });
    for seed in 1..=3 {
        let Outcome { released, late_s, .. } = rig.throw(&plan, seed);
        // The target starts at the planned release, whenever the ball is free.
        let mut flight = Flight::new(released, 9.81, 0.0);
        let nearest_m = (0..4_000)
            .map(|i| {
                let t_s = f64::from(i) * 2.5e-4;
                (flight.at(t_s).p_m - (from + velocity * (t_s + late_s))).norm()
            })
            .fold(f64::INFINITY, f64::min);
        println!("seed {seed}: {:.1} mm from the moving target", 1e3 * nearest_m);
        assert!(nearest_m < BALL_RADIUS_M, "seed {seed}: {nearest_m} m");
    }
}

/// What the fingers add to the landing: the same throws with and without them, against the prediction of both.
#[test]
fn fingers_move_the_simulated_landing_as_far_as_their_prediction_says() {
    let (instant, fingers) = (Rig::nominal(), Rig::with_fingers());
    let target = [2.0, 0.0, -1.0];
    let plan = fingers.plan_with(target, Options { finger_release: true, ..nulled() });
    let with = plan.landing.fingers.expect("was asked for");
    let added_m2 = trace(&with.covariance_m2) - trace(&plan.landing.covariance_m2);
    let seeds: u64 = 32;
    let moved_m2: Vec<f64> = (1..=seeds)
        .into_par_iter()
        .map(|seed| {
            let [a, b] = [&instant, &fingers].map(|rig| rig.throw(&plan, seed).landing_m);
            let moved = (b - a).xy() - Vector2::from(with.shift_m);
            moved.norm_squared()
        })
        .collect();
    let rms_m = (moved_m2.iter().sum::<f64>() / seeds as f64).sqrt();
    let ratio = rms_m / added_m2.sqrt();
    println!("{:.2} mm rms, predicted {:.2} mm", rms_m * 1e3, added_m2.sqrt() * 1e3);
    // The fingers move the ball along their own axis: 32 draws of one direction have a ratio within 0.6 to 1.5 with a
    // probability of 99.8 %.
    assert!((0.6..1.5).contains(&ratio), "{ratio}");
}

fn trace(covariance_m2: &[[f64; 2]; 2]) -> f64 {
    covariance_m2[0][0] + covariance_m2[1][1]
}

/// Azimuth all around, range and height as far as the stored throws lead.
fn random_target(rng: &mut planner::plan::rng::SplitMix64) -> [f64; 3] {
    let mut between = |low: f64, high: f64| low + (high - low) * rng.unit();
    let (azimuth, range, z) = (between(-3.1, 3.1), between(0.8, 2.4), between(-1.0, 0.4));
    [range * azimuth.cos(), range * azimuth.sin(), z]
}

fn many(throws: usize) {
    let rig = Rig::nominal();
    let begun = WallTime::now();
    let outcomes: Vec<([f64; 3], Outcome)> = (0..throws as u64)
        .into_par_iter()
        .map(|seed| {
            let mut rng = planner::plan::rng::SplitMix64::stream(77, seed);
            let (target, plan) = (0..1_000)
                .find_map(|_| {
                    let target = random_target(&mut rng);
                    rig.plan(target).map(|plan| (target, plan))
                })
                .unwrap_or_else(|| panic!("seed {seed}: no target in reach"));
            (target, rig.throw(&plan, seed))
        })
        .collect();
    let took_s = begun.elapsed().as_secs_f64();
    let mut errors: Vec<f64> = outcomes.iter().map(|(_, outcome)| outcome.landing_error_m).collect();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * errors[((errors.len() - 1) as f64 * share) as usize];
    let violated = outcomes.iter().filter(|(_, outcome)| !outcome.violations.is_empty()).count();
    println!(
        "{throws} throws in {took_s:.1} s, {:.0} ms each on {} threads; landing error median {:.2} mm, 99 % {:.2} mm, \
         largest {:.2} mm; {violated} with a limit violated; {} beyond 10 mm",
        1e3 * took_s / throws as f64,
        rayon::current_num_threads(),
        at(0.5),
        at(0.99),
        at(1.0),
        errors.iter().filter(|error| **error > 0.01).count()
    );
    for (seed, (target, outcome)) in outcomes.iter().enumerate() {
        assert!(outcome.violations.is_empty(), "seed {seed}, {target:?}: {:?}", outcome.violations);
        assert!(outcome.landing_error_m < 0.01, "seed {seed}, {target:?}: {} m", outcome.landing_error_m);
    }
    assert!(at(1.0) > 1e-3, "numbers too good to be true");
}

#[test]
fn throws_at_random_targets_keep_every_limit_and_hit() {
    many(8);
}

#[test]
#[ignore = "minutes: run by its CI stage"]
fn a_thousand_throws_at_random_targets_keep_every_limit_and_hit() {
    many(count("THROWS", 1_000));
}

/// Found by 200 perturbed arms: joint 4 answered 40 µs after the control step that waited for it, and one step of its
/// encoder, taken for a motion of 40 µs, was a joint measured faster than allowed (fault 301).
#[test]
fn an_answer_just_after_its_control_step_is_no_leap_in_speed() {
    let rig = Rig::perturbed();
    let plan = rig.plan(TARGETS_M[3]).unwrap();
    let Outcome { landing_error_m, violations, .. } = rig.throw(&plan, 172);
    assert_eq!(violations, Vec::<String>::new());
    assert!(landing_error_m < 0.01, "{landing_error_m} m");
}

/// What is needed of a run for its statistics.
struct Spread {
    landing_m: Vector2<f64>,
    /// Ball at the release, against the plan at that instant: position and velocity.
    deviation: Vector6<f64>,
}

fn covariance_2(points: &[Vector2<f64>]) -> Matrix2<f64> {
    let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix2<f64>>()
        / (points.len() - 1) as f64
}

/// 200 arms that are not the model: masses ± 10 %, friction ± 50 %, answers after 50 to 400 µs, gripper ± 2 ms. The
/// prediction: release jitter by the planner's own statistics, tracking by the covariance of the ball's state
/// over as many other seeds, mapped to the landing by the flight's Jacobian.
///
/// Where the scatter comes from, each source alone over 100 seeds, root mean square of the landing in mm at the two targets:
///
/// | source | (1, 1, -1) | (2, 0, 0) |
/// |---|---|---|
/// | none: the nominal cell, whose drives answer after 200 ± 100 µs | 0.85 | 1.02 |
/// | gripper ± 2 ms | 0.86 | 1.02 |
/// | masses ± 10 % | 0.96 | 1.11 |
/// | friction ± 50 % | 1.20 | 1.00 |
/// | all | 1.16 | 0.97 |
///
/// Nearly all of it is in the nominal cell: the time of an answer decides which of the encoder's steps of 0.02° it reads, and
/// the law follows that. The release adds 0.02 mm, because the plans null its delay. So the prediction overestimates no
/// source: measured and predicted are two samples of the same scatter, each uncertain by 5 % with 200 seeds. Their ratio is 0.98
/// at (1, 1, -1) and 1.07 at (2, 0, 0).
#[test]
#[ignore = "minutes: run by its CI stage"]
fn the_spread_over_perturbed_arms_is_the_predicted_one() {
    let seeds = count("SEEDS", 200);
    assert!(seeds >= 200, "the ratio of fewer than 200 arms is too uncertain for a bound of 25 %");
    let rig = Rig::perturbed();
    for target in [TARGETS_M[0], TARGETS_M[3]] {
        let plan = rig.plan(target).unwrap_or_else(|| panic!("{target:?} is in reach"));
        // Drives that all answer after 400 us leave no room in a cycle of 3 ms: the controller does not arm, and says so.
        let run = |seed: u64| match rig.try_throw(&plan, seed) {
            Ok(outcome) => {
                assert!(outcome.violations.is_empty(), "seed {seed}: {:?}", outcome.violations);
                Some(Spread {
                    landing_m: Vector2::new(outcome.landing_m.x, outcome.landing_m.y),
                    deviation: outcome.deviation,
                })
            }
            Err(error) => {
                assert!(error.to_string().contains("(fault 713)"), "seed {seed}: {error}");
                None
            }
        };
        let calibration: Vec<Spread> =
            (10_000..10_000 + seeds as u64).into_par_iter().filter_map(run).collect();
        let measured: Vec<Spread> = (0..seeds as u64).into_par_iter().filter_map(run).collect();
        let stopped = seeds - measured.len();

        let n = calibration.len() as f64;
        let mean: Vector6<f64> = calibration.iter().map(|s| s.deviation).sum::<Vector6<f64>>() / n;
        let tracking: Matrix6<f64> = calibration
            .iter()
            .map(|s| (s.deviation - mean) * (s.deviation - mean).transpose())
            .sum::<Matrix6<f64>>()
            / (n - 1.0);
        let g = rig.landing_jacobian(&plan);
        let jitter = rig.jitter_covariance(&plan, Duration::from_millis(2));
        let predicted: Matrix2<f64> = g * tracking * g.transpose() + jitter;
        let found = covariance_2(&measured.iter().map(|s| s.landing_m).collect::<Vec<_>>());
        let rms = |c: &Matrix2<f64>| c.trace().sqrt();
        let ratio = rms(&found) / rms(&predicted);
        let aim = Vector3::from(target);
        let worst =
            measured.iter().map(|s| (s.landing_m - Vector2::new(aim.x, aim.y)).norm()).fold(0.0, f64::max);
        println!(
            "{target:?}: {seeds} seeds, spread {:.2} mm measured, {:.2} mm predicted (ratio {ratio:.3}); farthest {:.2} mm; \
             {stopped} refused for late answers",
            1e3 * rms(&found),
            1e3 * rms(&predicted),
            1e3 * worst
        );
        // 200 points of a normal scatter along one line leave each of the two uncertain by 5 %, their ratio by 7 %: three and a
        // half of that.
        assert!((ratio - 1.0).abs() < 0.25, "{target:?}: {ratio}");
        assert!(stopped * 20 <= seeds, "{target:?}: {stopped} of {seeds} refused");
    }
}
