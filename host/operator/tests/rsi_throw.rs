//! Throws of an industrial robot over RSI in virtual time. The witness is the simulated robot: when the ball left its hand, and
//! where it landed, follow from its actual axes, which the controller does not see.

use std::path::Path;
use std::sync::OnceLock;

use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use operator::rsi::cell::{self, Seen};
use operator::rsi::program::{Lag, prepare, station};
use operator::rsi::station::{Stage, Station};
use planner::follow::best::{self, BestOptions, HandFreedom};
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::plan::file::RobotId;
use planner::store::robot_fingerprint;

const TARGET: [f64; 3] = [2.5, 0.0, 0.6];
const LAG_S: f64 = 0.024;
/// Radius of a bottle, m.
const HIT_M: f64 = 0.035;

fn arm() -> Arm {
    Arm::load("kr16_2").expect("built in")
}

fn plan() -> &'static FollowPlan {
    static PLAN: OnceLock<FollowPlan> = OnceLock::new();
    PLAN.get_or_init(|| {
        let arm = arm();
        let source = LimitSource::ControllerModel;
        let setting =
            Setting { lag_s: LAG_S, ..Setting::new(&arm, Vector3::from(TARGET), Limits::of(&arm, source)) };
        let options = BestOptions { starts: 24, kicks: 0, ..BestOptions::default() };
        let found = best::plan(&setting, &options).expect("feasible");
        let fingerprint = format!("{:016x}", robot_fingerprint(&arm));
        let robot = RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint };
        FollowPlan::new(&setting, source, robot, Form::Best(HandFreedom::TangentAndRoll), &found, 0.0)
    })
}

/// A KR C2 whose program stands at the start of the plan.
fn scenario(seed: u64) -> KrcScenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../hil-sim/scenarios/krc/kr_c2.toml");
    let mut scenario = KrcScenario::load(&path).expect("a scenario");
    prepare(&mut scenario, &arm(), plan());
    scenario.seed = seed;
    scenario
}

fn thrown_with(scenario: &KrcScenario, plan: &FollowPlan, lag: Lag) -> (Seen, Station) {
    let mut station = station(scenario, &arm(), plan, lag).expect("a station");
    let seen = cell::run(scenario, &mut station).expect("a robot");
    (seen, station)
}

fn true_lag(scenario: &KrcScenario) -> Lag {
    let lag = &scenario.options.lag;
    Lag { dead_time: lag.dead_time, time_constant: lag.time_constant }
}

fn thrown(scenario: &KrcScenario) -> (Seen, Station) {
    thrown_with(scenario, plan(), true_lag(scenario))
}

/// Distance of the landing from the target in the plane of the target, m.
fn error_m(seen: &Seen) -> Option<f64> {
    let landing = seen.landing.as_ref()?;
    Some((landing.p_m - Vector3::from(TARGET)).xy().norm())
}

#[test]
fn robot_follows_the_flight_and_the_ball_lands_at_the_target() {
    let scenario = scenario(1);
    let (seen, station) = thrown(&scenario);
    assert!(matches!(station.stage(), Stage::Finished { .. }), "{:?} {:?}", station.stage(), seen.fault);
    assert_eq!((seen.late, seen.refused, &seen.fault), (0, 0, &None));
    let error = error_m(&seen).expect("a landing");
    println!(
        "{} points, landing error {:.1} mm, path delay {:.2} ms",
        plan().followed_points,
        1e3 * error,
        1e3 * station.path_delay_s()
    );
    assert!((1e-6..HIT_M).contains(&error), "{error}");
    // Actual axes at the times of the plan against the plan, by the robot's own record.
    let Stage::Finished { started_at } = *station.stage() else { panic!("finished") };
    let mut worst = 0.0_f64;
    for cycle in &seen.cycles {
        let Some(since) = cycle.at.checked_since(started_at) else { continue };
        let k = (since.as_micros() / 12_000) as usize;
        let Some(step) = plan().steps.get(k) else { continue };
        for axis in 0..6 {
            worst = worst.max((cycle.actual_deg[axis] - step.q_rad[axis].to_degrees()).abs());
        }
    }
    println!("largest distance from the plan {worst:.4} deg");
    assert!((1e-4..0.6).contains(&worst), "{worst}");
}

#[test]
fn landings_over_seeds_hit_the_bottle_in_spite_of_noise_and_gripper_jitter() {
    let mut errors: Vec<f64> = (1..=40)
        .map(|seed| {
            let (seen, station) = thrown(&scenario(seed));
            assert!(matches!(station.stage(), Stage::Finished { .. }), "seed {seed}: {:?}", station.stage());
            error_m(&seen).unwrap_or(f64::INFINITY)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    let hit = errors.iter().filter(|error| **error <= HIT_M).count();
    println!(
        "seeds 1 to 40: median {:.1} mm, 95 % {:.1} mm, largest {:.1} mm, hits {hit}",
        1e3 * errors[20],
        1e3 * errors[37],
        1e3 * errors[39]
    );
    assert_eq!(hit, 40);
}
