//! The form of the paper on an arm that is not a KR 16. The verifier checks the plan. The ramps of the paper begin
//! with a leap, so the limits are those of the controller model.

use nalgebra::Vector3;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::paper::{Criterion, PaperOptions, plan};
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
