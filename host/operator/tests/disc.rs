//! Catches of discs as runs of a controller, judged by geometry alone.

use operator::dialogue::operator::OperatorError;
use operator::disc::{DriveLost, Judged, close_s, run};
use planner::disc::Joints;
use planner::disc::aero::Body;
use planner::disc::arm::{DiscArm, READY_RAD};
use planner::disc::flight::{Air, DiscState, Path};
use planner::disc::intercept::{Plan, Settings, plan};
use planner::disc::paper::Throw;
use planner::motion_law::State;
use robot_model::RobotModel;

struct Case {
    robot: RobotModel,
    arm: DiscArm,
    path: Path,
    plan: Plan,
}

fn case(throw: &Throw, jerk: bool) -> Case {
    let robot = RobotModel::load("pincher4").unwrap();
    let model = &robot;
    let arm = DiscArm::new(model.clone()).unwrap();
    let body = Body::of_paper();
    let released = DiscState::released(throw, nalgebra::Vector3::z(), 0.0, &body);
    let path = Path::flown(&body, &Air::vacuum(), &released, 3.0);
    let rest = READY_RAD.map(State::rest);
    let plan = plan(&arm, &path, &rest, &Settings { jerk, ..Settings::default() }).unwrap();
    Case { robot, arm, path, plan }
}

fn executed(case: &Case, lost: Option<DriveLost>) -> Judged {
    run(&case.robot, &case.arm, &case.path, &case.plan, lost).unwrap()
}

fn own(start_m: [f64; 3], velocity_m_s: [f64; 3]) -> Throw {
    Throw { start_m: start_m.into(), velocity_m_s: velocity_m_s.into() }
}

#[test]
fn planned_catches_are_catches_of_the_joints_as_the_drives_move_them() {
    for (name, throw, jerk) in [
        ("flat", Throw::flat(), false),
        ("own", own([0.5, -2.2, 0.7], [0.0, 3.8, 1.5]), false),
        ("own, with jerk limits", own([0.5, -2.6, 0.7], [0.0, 3.2, 3.0]), true),
    ] {
        let case = case(&throw, jerk);
        let judged = executed(&case, None);
        println!("{name}: {:?} {:?}", judged.tracking, judged.verdict.caught);
        assert!(judged.executed.reported.is_ok(), "{name}: {:?}", judged.executed.reported);
        assert!(judged.verdict.caught.is_some(), "{name}: {:?}", judged.verdict);
        // The drives do not follow exactly, and the disc forgives what they do.
        let worst = judged.tracking.worst_rad.max();
        assert!((1e-5..8e-3).contains(&worst), "{name}: {worst} rad");
        assert!(judged.tracking.tip_m.0 < 8e-3, "{name}: {:?}", judged.tracking);
        let close_s = close_s(&case.arm, &case.path, &case.plan);
        let closed_s = judged.executed.closed_s.unwrap();
        assert!((-0.001..0.002).contains(&(closed_s - close_s)), "{name}: {closed_s} instead of {close_s} s");
        let allowed = Joints::from(case.arm.model.limit(|l| l.v_max_rad_s).array());
        assert!(judged.speed_rad_s.component_div(&allowed).max() < 1.03, "{name}: {}", judged.speed_rad_s);
    }
}

#[test]
fn a_drive_lost_in_flight_is_reported_and_is_not_a_catch() {
    let case = case(&Throw::flat(), false);
    let judged = executed(&case, Some(DriveLost { joint: 1, at_s: 0.2 }));
    assert!(
        matches!(judged.executed.reported, Err(OperatorError::Stopped { .. })),
        "{:?}",
        judged.executed.reported
    );
    assert!(judged.verdict.caught.is_none(), "{:?}", judged.verdict);
}

/// The observer sees the joints and the order to close: without the order, or with a late one, nothing is caught.
#[test]
fn a_disc_that_flies_otherwise_is_no_catch() {
    let mut case = case(&Throw::flat(), false);
    let body = Body::of_paper();
    let other =
        Throw { start_m: Throw::flat().start_m - nalgebra::Vector3::new(0.0, 0.3, 0.0), ..Throw::flat() };
    let released = DiscState::released(&other, nalgebra::Vector3::z(), 0.0, &body);
    case.path = Path::flown(&body, &Air::vacuum(), &released, 3.0);
    let judged = executed(&case, None);
    assert!(judged.executed.reported.is_ok() && judged.verdict.caught.is_none(), "{:?}", judged.verdict);
}
