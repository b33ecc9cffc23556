//! The form without a grid, on three arms; every plan is checked by the verifier and written to and read from JSON text.

use nalgebra::Vector3;
use planner::follow::best::{BestOptions, HandFreedom, plan};
use planner::follow::landing;
use planner::follow::limits::{Arm, Axes, LimitSource, Limits};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::{CommandRange, Setting};
use planner::follow::verify::verify;
use planner::plan::file::RobotId;

fn kr16() -> Arm {
    Arm::load("kr16_2").expect("built in")
}

fn robot(arm: &Arm) -> RobotId {
    RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint: String::new() }
}

fn short() -> BestOptions {
    BestOptions { starts: 24, kicks: 3, ..BestOptions::default() }
}

/// Plans, verifies, and returns the plan.
fn good_plan(setting: &Setting<'_>, source: LimitSource, options: &BestOptions) -> FollowPlan {
    let found = plan(setting, options).expect("feasible");
    let plan = FollowPlan::new(setting, source, robot(setting.arm), Form::Best(options.hand), &found, 0.0);
    let report = verify(setting.arm, &Limits::of(setting.arm, source), &plan);
    assert!(report.is_good(), "{} points: {:#?}", plan.followed_points, report);
    let again = FollowPlan::from_json("p.json".as_ref(), &plan.to_json()).expect("its own text is read");
    assert_eq!(again, plan);
    plan
}

fn kr16_plan(arm: &Arm, target: [f64; 3], lag_s: f64) -> FollowPlan {
    let source = LimitSource::ControllerModel;
    let setting = Setting { lag_s, ..Setting::new(arm, Vector3::from(target), Limits::of(arm, source)) };
    good_plan(&setting, source, &short())
}

#[test]
fn at_1_m_height_more_points_are_followed_than_by_the_reference_and_the_paper() {
    // Reference: 19 with tangent and roll; the paper's constant hand: 2 (synchronised), 4 (own ramps).
    let plan = kr16_plan(&kr16(), [2.5, 0.0, 1.0], 0.0);
    assert!((20..=60).contains(&plan.followed_points), "{}", plan.followed_points);
    assert!(
        plan.leap.size_deg_s2 <= 1800.0 && plan.used.iter().all(|u| *u <= 1.0),
        "{:?} {:?}",
        plan.leap,
        plan.used
    );
}

#[test]
fn set_points_keep_the_following_accelerations_of_the_robot_file() {
    let arm = kr16();
    let plan = kr16_plan(&arm, [2.5, 0.0, 0.6], 0.024);
    let file = arm.limit(|l| l.a_follow_max_rad_s2.expect("stated"));
    let commands: Vec<Axes> = plan.steps.iter().map(|step| Axes::from(step.command_rad)).collect();
    let differences = commands.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).abs() / plan.period_s.powi(2));
    let largest = differences.fold(Axes::zeros(6), |most, a| most.sup(&a));
    println!("largest {} deg/s2", largest.map(f64::to_degrees));
    assert!((0..6).all(|axis| largest[axis] <= file[axis]), "{largest}");
}

/// Points that the best form follows without lag at this distance and 0.6 m height, with the options of `follow_table`.
fn points_without_lag(distance_m: f64) -> usize {
    let (arm, source) = (kr16(), LimitSource::ControllerModel);
    let setting = Setting::new(&arm, Vector3::new(distance_m, 0.0, 0.6), Limits::of(&arm, source));
    let options = BestOptions { starts: 160, ..BestOptions::default() };
    good_plan(&setting, source, &options).followed_points
}

// References: 38 and 53 points, by a search that did not check bodies and had ramps of 120 deg/s2, and 41 and 61 points with ramps
// of 600. Without steps into bodies 42 are found here, each plan verified from its set points.
#[test]
#[ignore = "20 s: run by the stage long of CI"]
fn at_2_5_m_more_points_are_followed_than_by_the_reference() {
    let points = points_without_lag(2.5);
    assert!((40..45).contains(&points), "{points}");
}

#[test]
#[ignore = "20 s: run by the stage long of CI"]
fn at_2_m_as_many_points_are_followed_as_by_the_reference() {
    let points = points_without_lag(2.0);
    assert!((53..61).contains(&points), "{points}");
}

/// Root mean square distance from the target of balls that leave axes which lag by a first order of `lag_s`, over openings within
/// `jitter_s`: small steps of Euler's method, set points joined by straight lines.
fn landings_rms_m(arm: &Arm, plan: &FollowPlan, lag_s: f64, jitter_s: f64) -> f64 {
    const SMALL: usize = 200;
    let h = plan.period_s / SMALL as f64;
    let command = |k: usize| Axes::from(plan.steps[k.min(plan.steps.len() - 1)].command_rad);
    let mut q = command(0);
    let late_s = lag_s - plan.lag_s;
    let (from_s, to_s) = (plan.release_time_s + late_s - jitter_s, plan.release_time_s + late_s + jitter_s);
    let mut squares = Vec::new();
    for n in 0..plan.steps.len() * SMALL {
        let (k, share) = (n / SMALL, (n % SMALL) as f64 / SMALL as f64);
        let qd = (command(k) * (1.0 - share) + command(k + 1) * share - q) / lag_s;
        if (from_s..=to_s).contains(&(n as f64 * h)) {
            let ball = |t_s: f64| arm.ball(&arm.fk(&(q + qd * t_s))).pos;
            let (p, v) = (ball(0.0), (ball(1e-5) - ball(-1e-5)) / 2e-5);
            let fall_s = (v.z + (v.z * v.z + 2.0 * 9.81 * (p.z - plan.target_m[2])).sqrt()) / 9.81;
            squares.push((p + v * fall_s - Vector3::from(plan.target_m)).xy().norm_squared());
        }
        q += qd * h;
    }
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn plan_for_another_lag_is_opened_and_turned_so_that_the_ball_lands_at_the_target() {
    let (arm, lag_s, jitter_s) = (kr16(), 0.042, 0.010);
    let plan = kr16_plan(&arm, [2.5, 0.3, 0.6], 0.0);
    assert!(plan.opened_for(&arm, 0.0, jitter_s) == plan, "its own lag");
    let opened = plan.opened_for(&arm, lag_s, jitter_s);
    let report = verify(&arm, &Limits::of(&arm, LimitSource::ControllerModel), &opened);
    assert!(report.is_good(), "{report:#?}");
    let [before, after] = [&plan, &opened].map(|plan| landings_rms_m(&arm, plan, lag_s, jitter_s));
    println!(
        "rms {:.1} mm in the middle of the window, {:.1} mm opened and turned",
        1e3 * before,
        1e3 * after
    );
    assert!(after < 0.5 * before && after < 0.02, "{before} {after}");
    assert_eq!(plan.require_lag(&arm, lag_s, jitter_s, 0.035), Ok(()));
    // A lag so different that no opening helps: refused with the motion of the axes, simulated in small steps.
    let slow_s = 0.400;
    let other = plan.require_lag(&arm, slow_s, jitter_s, 0.035).expect_err("far off");
    let off = landings_rms_m(&arm, &plan.opened_for(&arm, slow_s, jitter_s), slow_s, jitter_s + 0.006);
    println!("{other}; {off}");
    assert!(off > 0.035 && (1e-3 * other.off_mm / off - 1.0).abs() < 0.1, "{other} {off}");
    // The next measurement of the lag begins from the plan as it was made.
    let back = opened.opened_for(&arm, 0.0, jitter_s);
    assert_eq!(back.aim_m, None);
    assert!((back.release_time_s - plan.release_time_s).abs() < 1e-9);
    for (back, step) in back.steps.iter().zip(&plan.steps) {
        assert!((Axes::from(back.command_rad) - Axes::from(step.command_rad)).amax() < 1e-12);
    }
}

#[test]
fn the_lag_is_planned_for_in_the_commands() {
    let arm = kr16();
    let plan = kr16_plan(&arm, [2.5, 0.0, 0.6], 0.024);
    assert!((20..=60).contains(&plan.followed_points), "{}", plan.followed_points);
    let report = verify(&arm, &Limits::of(&arm, LimitSource::ControllerModel), &plan);
    // Joining set points by straight lines costs a few millimetres; without lead the ball would miss by far more.
    assert!(
        report.executed_landing_m > 0.0 && report.executed_landing_m < 0.02,
        "{}",
        report.executed_landing_m
    );
    let mut late = plan.clone();
    for step in &mut late.steps {
        step.command_rad = step.q_rad;
    }
    let late = verify(&arm, &Limits::of(&arm, LimitSource::ControllerModel), &late);
    assert!(late.executed_landing_m > 3.0 * report.executed_landing_m, "{}", late.executed_landing_m);
}

#[test]
#[ignore = "6 s: run by the stage long of CI"]
fn commands_stay_inside_what_the_program_of_the_robot_passes() {
    let (arm, target, source) = (kr16(), Vector3::new(2.5, 0.0, 0.6), LimitSource::ControllerModel);
    let free = Setting { lag_s: 0.024, ..Setting::new(&arm, target, Limits::of(&arm, source)) };
    let commands = |plan: &FollowPlan| plan.steps.iter().map(|s| s.command_rad[2]).collect::<Vec<_>>();
    let least = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
    let free_min_rad = least(&commands(&good_plan(&free, source, &short())));
    // The program passes 0.05 rad less on A3 than the free plan commands.
    let mut passed = CommandRange::default();
    passed.min_rad[2] = free_min_rad + 0.05;
    let inside = good_plan(&Setting { commands: passed, ..free }, source, &short());
    assert!(least(&commands(&inside)) >= passed.min_rad[2], "{} {free_min_rad}", least(&commands(&inside)));
}

#[test]
fn a_long_window_makes_the_landing_independent_of_the_opening() {
    let arm = kr16();
    let plan = kr16_plan(&arm, [2.5, 0.0, 0.6], 0.0);
    let (motion, target) = (plan.motion(), Vector3::from(plan.target_m));
    let middle_s = 0.5 * (motion.last - motion.first) as f64 * motion.period_s;
    let with = landing::sensitivity(&arm, &motion, &target, middle_s, 0.010);
    assert!(with.missed == 0 && with.largest_m < 2e-3, "{with:?}");
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let through = landing::without_following(&motion, &limits);
    let without = landing::sensitivity(&arm, &through, &target, 0.0, 0.010);
    // How much the ramps miss by depends on the throw: 15 mm rms here, 43 mm in the reference example.
    assert!(without.rms_m > 0.008 && without.largest_m > 10.0 * with.largest_m, "{without:?} {with:?}");
    assert!(without.rms_m < 0.12, "{without:?}");
}

#[test]
fn the_powercube_arm_follows_the_flight_within_the_limits_of_its_file() {
    let arm = Arm::load("powercube6").expect("built in");
    let source = LimitSource::RobotFile;
    let setting = Setting::new(&arm, Vector3::new(1.0, 1.0, -1.0), Limits::of(&arm, source));
    let plan = good_plan(&setting, source, &short());
    assert!((4..=60).contains(&plan.followed_points), "{}", plan.followed_points);
}

#[test]
fn an_arm_without_closed_form_follows_the_flight() {
    let text = include_str!("../../../robots/model/tests/data/ur5.toml");
    let arm = Arm::from_toml("ur5.toml", text).expect("the fixture loads");
    let source = LimitSource::RobotFile;
    let setting = Setting::new(&arm, Vector3::new(1.5, 0.0, -0.3), Limits::of(&arm, source));
    let plan = good_plan(
        &setting,
        source,
        &BestOptions { starts: 12, kicks: 0, draws: 8_000, ..BestOptions::default() },
    );
    assert!((4..=80).contains(&plan.followed_points), "{}", plan.followed_points);
}

#[test]
fn the_same_options_give_the_same_plan() {
    let arm = kr16();
    let setting =
        Setting::new(&arm, Vector3::new(2.2, 0.3, 0.8), Limits::of(&arm, LimitSource::ControllerModel));
    let options = BestOptions {
        starts: 8,
        kicks: 2,
        draws: 4000,
        hand: HandFreedom::Tangent,
        ..BestOptions::default()
    };
    let motion = || plan(&setting, &options).expect("feasible").motion;
    assert_eq!(motion(), motion());
}

#[test]
fn a_target_beyond_all_reach_is_refused_with_numbers() {
    let arm = kr16();
    let setting =
        Setting::new(&arm, Vector3::new(9.0, 0.0, 1.0), Limits::of(&arm, LimitSource::ControllerModel));
    let options = BestOptions { starts: 8, kicks: 0, draws: 4000, ..BestOptions::default() };
    let refused = plan(&setting, &options).expect_err("9 m");
    assert!(refused.size.counts.total() > 0, "{refused}");
}
