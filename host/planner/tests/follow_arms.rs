//! The form of the paper on arms that are no KR 16: PowerCubes, and an arm like a UR5, which has no closed inverse kinematics here. Every
//! plan goes through the verifier. The ramps of the paper begin with a leap, so the limits are those of the controller model.

use nalgebra::Vector3;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::paper::{Criterion, GridAxis, PaperOptions, plan};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::follow::verify::verify;
use planner::plan::file::RobotId;

fn good_plan(arm: &Arm, target: [f64; 3], options: &PaperOptions) -> FollowPlan {
    let source = LimitSource::ControllerModel;
    let limits = Limits::of(arm, source);
    let setting = Setting::new(arm, Vector3::from(target), limits);
    let found = plan(&setting, options).expect("feasible");
    let robot =
        RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint: String::new() };
    let plan = FollowPlan::new(&setting, source, robot, Form::Paper, &found, 0.0);
    let report = verify(arm, &limits, &plan);
    assert!(report.is_good(), "{report:#?}");
    assert!(plan.used.iter().all(|used| *used <= 1.0) && plan.leap.size_deg_s2 > 100.0, "{:?}", plan.leap);
    plan
}

#[test]
fn the_powercube_arm_follows_the_flight_in_the_form_of_the_paper() {
    let arm = Arm::load("powercube6").expect("built in");
    let options = PaperOptions {
        criterion: Criterion::Points,
        ..PaperOptions::covering(1.05, 0.0, arm.world().floor_z_m, 0.6)
    };
    let plan = good_plan(&arm, [1.0, 1.0, -1.0], &options);
    assert!((2..=40).contains(&plan.followed_points), "{}", plan.followed_points);
}

/// Postures come from an iteration, about a thousand times as slow as a closed form: a grid around a release that is known to lead to a
/// throw, 0.93 m from A1 and 54 degrees beside the target.
#[test]
fn an_arm_like_a_ur5_follows_the_flight_in_the_form_of_the_paper() {
    let text = include_str!("../../../robots/model/tests/data/ur5.toml");
    let arm = Arm::from_toml("ur5.toml", text).expect("the fixture loads");
    let options = PaperOptions {
        radius_m: GridAxis { from: 0.85, to: 1.0, count: 3 },
        height_m: GridAxis { from: 0.15, to: 0.35, count: 3 },
        beta_deg: GridAxis { from: 24.0, to: 40.0, count: 3 },
        places: 9,
        sector_rad: 60.0_f64.to_radians(),
        rolls: 12,
        criterion: Criterion::Points,
        ..PaperOptions::covering(1.0, 0.0, arm.world().floor_z_m, 1.0)
    };
    let plan = good_plan(&arm, [1.5, 0.0, -0.3], &options);
    assert!((1..=20).contains(&plan.followed_points), "{}", plan.followed_points);
}
