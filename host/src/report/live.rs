//! The page of the live view: style and picture in space of a report, fed by a WebSocket.

use nalgebra::Vector3;
use operator::analysis::POSITION_BOUND_RAD;
use operator::analysis::release::flight;
use operator::live::age::OLD_AFTER;
use operator::machine::Machine;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;
use serde::Serialize;

use super::page::document;
use super::scene::{Space, Step, bodies, link, list, point};

/// Points of the planned flight.
const FLIGHT_STEPS: u32 = 40;
const LIVE: &str = include_str!("assets/live.js");

/// What the page knows before anything was heard.
#[derive(Serialize)]
struct Live<'a> {
    title: &'a str,
    version: &'static str,
    joints: &'a [String],
    bound_mrad: f64,
    old_after_s: f64,
    scene: Space,
}

/// The page for a robot on the bus called `bus`; with `plan` its target is shown.
#[must_use]
pub fn page(robot: &RobotModel, bus: &str, plan: Option<&PlanFile>) -> String {
    let machine = Machine::of(robot);
    let title = format!("{} on {bus}", machine.robot);
    let live = Live {
        title: &title,
        version: env!("CARGO_PKG_VERSION"),
        joints: &machine.joints,
        bound_mrad: (1e3 * POSITION_BOUND_RAD).round(),
        old_after_s: OLD_AFTER.as_secs_f64(),
        scene: scene(robot, plan),
    };
    document(&title, "live", &live, LIVE)
}

/// Points of the planned flight, in m.
fn planned_flight(plan: &PlanFile) -> Vec<Vector3<f64>> {
    let (p, v) = (Vector3::from(plan.release.position_m), Vector3::from(plan.release.velocity_m_s));
    let time = |i: u32| plan.landing.flight_s * f64::from(i) / f64::from(FLIGHT_STEPS);
    flight(plan)
        .map_or_else(Vec::new, |model| (0..=FLIGHT_STEPS).map(|i| model.fly(&p, &v, time(i)).p).collect())
}

/// What the picture in space knows before anything was heard: the bodies, and where they can be.
fn scene(robot: &RobotModel, plan: Option<&PlanFile>) -> Space {
    let stretched = robot.fk(&robot_model::JointVec::zeros(robot.n()));
    let reach_m =
        stretched.x_w.iter().map(|x| x.pos.norm()).fold(robot.ball(&stretched).pos.norm(), f64::max);
    let sides = [-0.5, 0.5].map(|side| [[side, 0.0, 0.0], [0.0, side, 1.0]]);
    let flown = plan.map_or_else(Vec::new, planned_flight);
    let bounds: Vec<Vector3<f64>> = sides
        .as_flattened()
        .iter()
        .map(|share| Vector3::from(*share) * (reach_m + 0.1))
        .chain(flown.iter().copied())
        .collect();
    let links = stretched.x_w.iter().map(link).collect();
    let ball = Some(point(&robot.ball(&stretched).pos));
    Space {
        floor: robot.world().floor_z_m,
        top: 0.3,
        radius: robot.gripper().ball_radius_m,
        last: robot.n(),
        target: plan.map(|plan| point(&Vector3::from(plan.target.position_m))),
        flight: list(&flown),
        bounds: list(&bounds),
        boxes: bodies(robot).collect(),
        steps: vec![Step { t: 0.0, ball, normal: None, links }],
        ..Space::default()
    }
}
