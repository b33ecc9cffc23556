//! The verifier refuses plans that were broken on purpose, each for its reason, and accepts the plan they came from.

use std::path::Path;
use std::sync::LazyLock;

use nalgebra::Vector3;
use planner::follow::clear::Margins;
use planner::follow::found::Found;
use planner::follow::limits::{Arm, Axes, LimitSource, Limits};
use planner::follow::motion::{FollowMotion, RampPlan, Ramps};
use planner::follow::paper::{GridAxis, PaperOptions, plan};
use planner::follow::plan::{FollowPlan, Form, Phase};
use planner::follow::posture::Reach;
use planner::follow::ramp::RampShape;
use planner::follow::setting::{CommandRange, Setting};
use planner::follow::verify::{Check, Report, verify, verify_commands};
use planner::plan::file::{RobotId, VERSION};
use robot_model::Pose;

static ARM: LazyLock<Arm> = LazyLock::new(|| Arm::load("kr16_2").expect("built in"));

fn limits() -> Limits {
    Limits::of(&ARM, LimitSource::ControllerModel)
}

fn options() -> PaperOptions {
    PaperOptions {
        radius_m: GridAxis { from: 1.2, to: 1.6, count: 5 },
        height_m: GridAxis { from: 1.0, to: 1.6, count: 5 },
        beta_deg: GridAxis { from: 0.0, to: 30.0, count: 5 },
        ..PaperOptions::covering(1.8, 0.675, 0.0, 1.0)
    }
}

fn planned(margins: Margins, target: [f64; 3]) -> Option<FollowPlan> {
    let setting = Setting { margins, ..Setting::new(&ARM, Vector3::from(target), limits()) };
    let found = plan(&setting, &options()).ok()?;
    let robot = RobotId { name: "kr16_2".into(), source: "kr16_2".into(), fingerprint: String::new() };
    Some(FollowPlan::new(&setting, LimitSource::ControllerModel, robot, Form::Paper, &found, 0.0))
}

static PLAN: LazyLock<FollowPlan> =
    LazyLock::new(|| planned(Margins::default(), [2.0, 0.0, 0.6]).expect("feasible"));

fn broken(how: impl FnOnce(&mut FollowPlan)) -> Report {
    let mut plan = PLAN.clone();
    how(&mut plan);
    verify(&ARM, &limits(), &plan)
}

fn refuses(report: &Report, check: Check) {
    assert!(
        report.findings.iter().any(|f| f.check == check),
        "{check:?} is not among {:#?}",
        report.findings
    );
    assert!(report.findings.iter().all(|f| !f.to_string().is_empty()));
}

#[test]
fn the_unbroken_plan_is_good() {
    let report = verify(&ARM, &limits(), &PLAN);
    assert!(report.is_good(), "{report:#?}");
    assert!(report.off_parabola_m < 1e-6 && report.landing_m < 1e-3, "{report:?}");
    assert!(report.nearest_m > 0.0 && report.nearest_m < 1.0 && report.ball_m > 0.0);
}

/// The release of the plan alone, joined to its ramps within one and a half steps: the acceleration changes by most of its limit
/// between the step and the second one beside it.
fn single_point() -> FollowPlan {
    let setting = Setting::new(&ARM, Vector3::new(2.0, 0.0, 0.6), limits());
    let found = plan(&setting, &options()).expect("feasible");
    let release = found.motion.states[found.motion.first + found.release];
    let ramps = RampPlan { shape: RampShape { blend_s: 0.018, fade_s: 0.024 }, together: 1.0 };
    let [start, stop] = [Ramps::start, Ramps::stop].map(|side| side(&release, ramps, &setting.limits));
    let motion = FollowMotion::around(&[release], &start, &stop, setting.period_s);
    let flight = found.flight.from_time(found.release as f64 * setting.period_s);
    let found = Found { flight, motion, release: 0, ..found };
    let robot = RobotId { name: "kr16_2".into(), source: "kr16_2".into(), fingerprint: String::new() };
    FollowPlan::new(&setting, LimitSource::ControllerModel, robot, Form::Paper, &found, 0.0)
}

/// Differences of the angles across joins that short do not determine the speed at the step: they put this ball
/// centimetres beside the target.
#[test]
fn a_plan_with_a_single_point_lands_by_the_speeds_that_it_states() {
    let plan = single_point();
    assert_eq!(plan.followed_points, 1);
    let report = verify(&ARM, &limits(), &plan);
    assert!(report.is_good() && report.landing_m < 1e-4, "{report:#?}");
    let mut slower = plan;
    slower.steps[slower.window[0]].qd_rad_s[0] *= 0.99;
    refuses(&verify(&ARM, &limits(), &slower), Check::Landing);
}

#[test]
fn stated_speeds_that_are_not_those_of_the_angles_are_refused() {
    // On the parabola the flight shows it too.
    let report = broken(|p| p.steps[p.window[0] + 1].qd_rad_s[0] += 0.02);
    refuses(&report, Check::Landing);
    refuses(&report, Check::StatedSpeed);
    // In the ramps only the angles around do: there the third differences bound it to less than 1 deg/s.
    let report = broken(|p| p.steps[p.window[0] / 2].qd_rad_s[3] += 1.0_f64.to_radians());
    refuses(&report, Check::StatedSpeed);
    assert_eq!((report.findings.len(), report.findings[0].axis), (1, Some(4)), "{report:#?}");
    assert!(broken(|p| p.steps[p.window[0] / 2].qd_rad_s[3] += 1e-9).is_good());
    refuses(&broken(|p| p.steps[5].qd_rad_s[1] = f64::NAN), Check::StatedSpeed);
}

#[test]
fn a_displaced_set_point_breaks_jerk_and_leaves_the_parabola() {
    let report = broken(|p| {
        let k = p.window[0];
        p.steps[k].q_rad[1] += 2e-3;
        p.steps[k].command_rad[1] += 2e-3;
    });
    refuses(&report, Check::Jerk);
    refuses(&report, Check::Parabola);
}

#[test]
fn a_faster_clock_breaks_the_speeds() {
    let report = broken(|p| {
        p.period_s *= 0.8;
        for (k, step) in p.steps.iter_mut().enumerate() {
            step.t_s = k as f64 * p.period_s;
        }
    });
    refuses(&report, Check::Speed);
}

#[test]
fn another_target_is_not_hit() {
    refuses(&broken(|p| p.target_m[1] += 0.01), Check::Landing);
    refuses(&broken(|p| p.target_m[2] = 9.0), Check::Landing);
}

#[test]
fn a_whole_motion_turned_about_a1_misses_and_leaves_the_range() {
    let turned = |by: f64| {
        broken(|p| {
            for step in &mut p.steps {
                step.q_rad[0] += by;
                step.command_rad[0] += by;
            }
        })
    };
    refuses(&turned(0.01), Check::Parabola);
    refuses(&turned(std::f64::consts::TAU), Check::Range);
}

#[test]
fn commands_that_do_not_lead_are_not_executed_as_planned() {
    refuses(&broken(|p| p.lag_s = 0.024), Check::Lag);
    refuses(&broken(|p| p.steps[40].command_rad[2] += 0.01), Check::Lag);
}

#[test]
fn disorder_is_refused_first() {
    for report in [
        broken(|p| {
            p.steps.remove(5);
        }),
        broken(|p| p.steps[3].phase = Phase::Follow),
        broken(|p| p.steps[9].q_rad[4] = f64::NAN),
        broken(|p| p.window[1] += 1),
        broken(|p| p.followed_points += 1),
    ] {
        refuses(&report, Check::Steps);
    }
}

#[test]
fn a_turning_hand_is_no_plan_of_the_paper() {
    refuses(
        &broken(|p| {
            // The wrist roll leaves the ball where it is only along the tool axis: the hand turns.
            for (k, step) in p.steps.iter_mut().enumerate() {
                step.q_rad[5] += 1e-3 * k as f64;
                step.command_rad[5] += 1e-3 * k as f64;
            }
        }),
        Check::Across,
    );
}

/// The hand turned sideways by the same angle at every step of the window, with the ball on the parabola as before.
#[test]
fn a_hand_that_is_nowhere_across_the_flight_is_no_plan_of_the_paper() {
    let reach = Reach::new(&ARM);
    let sideways = Pose::rot_z(3.0_f64.to_radians());
    let report = broken(|p| {
        let [first, last] = p.window;
        for k in first..=last {
            let q = Axes::from(p.steps[k].q_rad);
            let x_wb = ARM.ball(&ARM.fk(&q));
            let turned = Pose::new(sideways.rot * x_wb.rot, x_wb.pos);
            let q = reach.near(&turned, &q).expect("in reach");
            (p.steps[k].q_rad, p.steps[k].command_rad) = (q.array(), q.array());
        }
    });
    refuses(&report, Check::Across);
    // Ball and turning are as before: only the angle to the flight is wrong.
    assert!(!report.findings.iter().any(|f| f.check == Check::Parabola), "{report:#?}");
    let across = report.findings.iter().find(|f| f.check == Check::Across).expect("found");
    assert!((0.02..0.053).contains(&across.value), "{across:?}");
}

#[test]
fn commands_that_the_program_of_the_robot_does_not_pass_are_refused_with_their_axis() {
    let of_axis = |i: usize| PLAN.steps.iter().map(move |s| s.command_rad[i]);
    let most = of_axis(1).fold(f64::NEG_INFINITY, f64::max);
    let mut passed = CommandRange::default();
    passed.max_rad[1] = most;
    assert!(verify_commands(&ARM, &limits(), &passed, &PLAN).is_good());
    passed.max_rad[1] = most - 0.02;
    let report = verify_commands(&ARM, &limits(), &passed, &PLAN);
    refuses(&report, Check::Commands);
    let finding = &report.findings[0];
    assert_eq!((finding.axis, report.findings.len()), (Some(2), 1), "{finding}");
    assert!((finding.value - most).abs() < 1e-12, "{finding}");
    passed = CommandRange::default();
    passed.min_rad[5] = of_axis(5).fold(f64::INFINITY, f64::min) + 1e-3;
    refuses(&verify_commands(&ARM, &limits(), &passed, &PLAN), Check::Commands);
}

/// Largest commanded acceleration of each axis in deg/s², by differences of the set points.
fn accelerations_deg_s2(plan: &FollowPlan) -> Vec<f64> {
    let (first, last) = (plan.steps[0].command_rad, plan.steps[plan.steps.len() - 1].command_rad);
    let steps = plan.steps.iter().map(|step| step.command_rad);
    let all: Vec<[f64; 6]> = [first; 2].into_iter().chain(steps).chain([last; 2]).collect();
    let of =
        |w: &[[f64; 6]], axis: usize| (w[2][axis] - 2.0 * w[1][axis] + w[0][axis]) / plan.period_s.powi(2);
    (0..6).map(|axis| all.windows(3).map(|w| of(w, axis).to_degrees().abs()).fold(0.0, f64::max)).collect()
}

#[test]
fn set_points_keep_the_following_acceleration_of_the_robot_file_by_default() {
    // The numbers of robots/kr16_2.toml; the cut-out of the simulated controller is 2000 deg/s².
    let file = [600.0, 1300.0, 1300.0, 1300.0, 1300.0, 1300.0];
    let used = accelerations_deg_s2(&PLAN);
    assert!(used.iter().zip(file).all(|(used, file)| *used <= file * (1.0 + 1e-9)), "{used:?}");
}

#[test]
fn ball_in_the_hand_keeps_the_height_of_the_flange_above_the_floor() {
    let lowest = |of: fn(&Arm, &Axes) -> f64| {
        PLAN.steps.iter().map(|step| of(&ARM, &step.q_rad.into())).fold(f64::INFINITY, f64::min)
    };
    let ball_m = lowest(|arm, q| arm.ball(&arm.fk(q)).pos.z);
    let flange_m = lowest(|arm, q| arm.ee(&arm.fk(q)).pos.z.min(arm.fk(q).origin(2).z));
    assert!(ball_m < flange_m - 0.005, "the ball is the lowest: {ball_m} {flange_m}");
    refuses(&broken(|p| p.margins.floor_m = 0.5 * (ball_m + flange_m)), Check::Floor);
    let margins = Margins { floor_m: 0.5 * (ball_m + flange_m), ..Margins::default() };
    if let Some(higher) = planned(margins, [2.0, 0.0, 0.6]) {
        assert!(higher.steps.iter().all(|s| ARM.ball(&ARM.fk(&s.q_rad.into())).pos.z >= margins.floor_m));
    }
}

#[test]
fn a_higher_floor_and_a_lower_arm_are_found() {
    refuses(&broken(|p| p.margins.floor_m = 1.0), Check::Floor);
    let folded = broken(|p| {
        for step in &mut p.steps {
            step.q_rad[1] = 0.5;
            step.command_rad[1] = 0.5;
        }
    });
    refuses(&folded, Check::Boxes);
}

/// A grid that is set to ignore the ball after the release finds throws whose ball meets the hand; the verifier,
/// set to check it, refuses them.
#[test]
fn a_ball_that_meets_the_hand_is_refused() {
    let careless = Margins { grip_slack_m: 1.0, ..Margins::default() };
    let mut met = 0;
    for target in [[2.5, 0.0, 0.6], [2.3, 0.0, 0.6], [2.2, 0.0, 0.8], [2.0, 0.0, 0.6], [2.0, 0.0, 1.0]] {
        let Some(mut plan) = planned(careless, target) else { continue };
        plan.margins = Margins::default();
        let report = verify(&ARM, &limits(), &plan);
        met += usize::from(report.findings.iter().any(|f| f.check == Check::Ball));
    }
    assert!(met > 0, "none of the careless plans has its ball meet the hand");
}

#[test]
fn damaged_plan_files_are_refused_with_a_reason() {
    let (text, path) = (PLAN.to_json(), Path::new("p.json"));
    assert_eq!(FollowPlan::from_json(path, &text).expect("good"), *PLAN);
    let [this, next] = [VERSION, VERSION + 1].map(|version| format!("\"version\": {version}"));
    for (from, to, words) in [
        ("cubectl-plan", "cubectl-scan", "format"),
        (&this, &next, "update cubectl or plan again"),
        ("\"followed_points\": ", "\"followed_points\": 1", "window"),
        ("\"lag_s\"", "\"lagg_s\"", "lagg_s"),
    ] {
        assert!(text.contains(from), "{from}");
        let error = FollowPlan::from_json(path, &text.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(words), "{error}");
    }
    assert!(FollowPlan::from_json(path, &text[..text.len() / 2]).is_err());
}
