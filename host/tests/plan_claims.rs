//! No number of a plan file is free: each is refused once it is false, or nothing that a throw does follows from it.

use std::fmt::Debug;
use std::path::Path;

use nalgebra::Vector3;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::paper::{GridAxis, PaperOptions};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::follow::verify::verify;
use planner::plan::file::{PlanFile, RobotId};
use planner::plan::problem::{Obstacle, Options, Problem};
use planner::plan::search::{Budget, Planner, Watch};
use planner::plan::seeds;
use planner::plan::statistics::{Noise, Region};
use planner::record::{MovePlan, PlanRecord};
use planner::store::fingerprint_of;
use planner::verify::check;
use robot_model::Pose;
use serde_json::Value;

/// Pointers to the numbers of a JSON value.
fn numbers(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(at.to_owned()),
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(k, v)| numbers(v, &format!("{at}/{k}"), found));
        }
        Value::Object(fields) => fields.iter().for_each(|(k, v)| numbers(v, &format!("{at}/{k}"), found)),
        _ => {}
    }
}

/// Changes every number of the plan, and wants a refusal (`None`) or the same effect, except where a pointer begins with one of
/// `inputs`. How many were refused, how many were without effect.
fn spoil<T: PartialEq + Debug>(
    json: &str,
    inputs: &[&str],
    effect: impl Fn(&str) -> Option<T>,
) -> [usize; 2] {
    let whole: Value = serde_json::from_str(json).expect("JSON");
    let sound = effect(json).expect("the plan is good");
    let (mut pointers, mut counts) = (Vec::new(), [0; 2]);
    numbers(&whole, "", &mut pointers);
    for pointer in &pointers {
        let number = whole.pointer(pointer).expect("there");
        let false_ones = match number.as_u64() {
            Some(n) => vec![Value::from(-1e9), Value::from(n + 1), Value::from(n + 1_000_000)],
            None => {
                let x = number.as_f64().expect("a number");
                vec![Value::from(-1e9), Value::from(x + 0.5 * x.abs() + 0.1)]
            }
        };
        for reported in false_ones {
            let mut spoiled = whole.clone();
            *spoiled.pointer_mut(pointer).expect("there") = reported.clone();
            let Some(found) = effect(&spoiled.to_string()) else {
                counts[0] += 1;
                continue;
            };
            counts[1] += 1;
            let free = found == sound || inputs.iter().any(|input| pointer.starts_with(input));
            assert!(free, "{pointer}: {reported} in place of {number} is taken, and changes the throw");
        }
    }
    counts
}

#[test]
fn every_number_of_a_throw_is_refused_if_it_is_false_or_has_no_effect() {
    let arm = Arm::load("powercube6").expect("built in");
    let post = Obstacle {
        name: "post".to_owned(),
        x_wo: Pose::translation(0.3, 0.0, 0.6),
        half_m: Vector3::new(0.05, 0.05, 0.05),
    };
    let options = Options {
        obstacles: vec![post],
        drag_per_m: 0.05,
        magnus_rad_s: Vector3::new(0.0, 0.1, 0.0),
        ..Options::best()
    };
    let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), options).expect("valid");
    let budget = Budget { starts: 6, all: false, time: None, seed: 1 };
    let best =
        Planner::new(&problem).search(&seeds::built_in(&arm), &budget, &Watch::default()).expect("in reach");
    let region = Some(Region::Disc { radius_m: 0.05 });
    let plan = PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), region).expect("comes down");
    let path = Path::new("p.json");
    let effect = |json: &str| {
        let plan = PlanFile::from_json(path, json).ok()?;
        // The quick part of the check first.
        let holds = plan.false_claim(&arm).is_none() && check(&arm, &plan).ok();
        if !holds {
            return None;
        }
        let again = plan.computed_again(&arm)?.landing;
        let target = (plan.meeting_m(), plan.target.course.clone(), plan.target.opening);
        Some((
            format!("{:?}", plan.scene()),
            plan.motion,
            target,
            again.mean_m,
            again.covariance_m2,
            again.magnus_rad_s,
        ))
    };
    let [refused, idle] = spoil(&plan.to_json(), &["/obstacles"], effect);
    println!("throw: {refused} refused, {idle} without effect");
    assert!(refused > 400 && idle < 40, "{refused} {idle}");
}

#[test]
fn every_number_of_a_throw_that_follows_the_flight_is_refused_if_it_is_false_or_has_no_effect() {
    let arm = Arm::load("kr16_2").expect("built in");
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let setting = Setting::new(&arm, Vector3::new(2.0, 0.0, 0.6), limits);
    let grid = PaperOptions {
        radius_m: GridAxis { from: 1.2, to: 1.6, count: 5 },
        height_m: GridAxis { from: 1.0, to: 1.6, count: 5 },
        beta_deg: GridAxis { from: 0.0, to: 30.0, count: 5 },
        ..PaperOptions::covering(1.8, 0.675, 0.0, 1.0)
    };
    let found = planner::follow::paper::plan(&setting, &grid).expect("feasible");
    let fingerprint = fingerprint_of(&arm);
    let robot = RobotId { name: "kr16_2".into(), source: "kr16_2".into(), fingerprint };
    let plan = FollowPlan::new(&setting, LimitSource::ControllerModel, robot, Form::Paper, &found, 0.0);
    let path = Path::new("p.json");
    let effect = |json: &str| {
        let plan = FollowPlan::from_json(path, json).ok()?;
        plan.require_true(path, &arm).ok()?;
        // The robot begins a plan with its own lag, and opens the gripper anew.
        let opened = plan.opened_for(&arm, 0.0, 0.0);
        verify(&arm, &limits, &plan).is_good().then_some((
            opened.steps,
            opened.release_time_s,
            opened.target_m,
        ))
    };
    let [refused, idle] = spoil(&plan.to_json(), &[], effect);
    println!("follow: {refused} refused, {idle} without effect");
    assert!(refused > 1_000 && idle < 60, "{refused} {idle}");
}

#[test]
fn a_motion_without_claims_is_what_it_says() {
    let arm = Arm::load("powercube6").expect("built in");
    let problem = Problem::new(&arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).expect("valid");
    let budget = Budget { starts: 6, all: false, time: None, seed: 1 };
    let best =
        Planner::new(&problem).search(&seeds::built_in(&arm), &budget, &Watch::default()).expect("in reach");
    let plan = PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None).expect("comes down");
    let moved = MovePlan::new(plan.robot.clone(), plan.motion);
    let effect = |json: &str| match PlanRecord::from_json(Path::new("p.json"), json).ok()? {
        PlanRecord::Move(plan) => Some(plan.motion),
        _ => None,
    };
    spoil(&moved.to_json(), &["/motion"], effect);
}
