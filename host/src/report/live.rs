//! The page of the live view: style and picture in space of a report, fed by a WebSocket.

use nalgebra::Vector3;
use operator::analysis::POSITION_BOUND_RAD;
use operator::analysis::release::flight;
use operator::live::age::OLD_AFTER;
use operator::machine::Machine;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;

use super::chart::escape;
use super::page::{SCENE, document};
use super::scene::{body, list, point};

/// Points of the planned flight.
const FLIGHT_STEPS: u32 = 40;
const LIVE: &str = include_str!("assets/live.js");

/// The page for a robot on the bus called `bus`; with `plan` its target is shown.
#[must_use]
pub fn page(robot: &RobotModel, bus: &str, plan: Option<&PlanFile>) -> String {
    let machine = Machine::of(robot);
    let title = format!("{} on {bus}", machine.robot);
    let names = serde_json::to_string(&machine.joints).unwrap_or_default();
    let tiles = [
        ("state", "state of the group"),
        ("plan", "time of the plan"),
        ("counts", "saturated, late cycles, missed answers"),
        ("period", "control period"),
        ("busload", "load of the bus"),
        ("errorcount", "errors of the bus"),
        ("gripper", "gripper"),
        ("session", "since the session began"),
    ];
    let tiles: String = tiles
        .iter()
        .map(|(id, what)| format!("<div class=\"tile\"><b id=\"{id}\">–</b><span>{what}</span></div>"))
        .collect();
    let body = format!(
        "<body class=\"live\"><main><header><h1>{heading}<span class=\"pill warn\" id=\"link\">connecting</span></h1><p>What passes on the \
         bus, fifty times a second. This page looks and stops; it moves nothing.</p></header>\
         <div class=\"stopbar\"><button id=\"stop\">Stop (Esc)</button><output id=\"stopped\"></output></div>\
         <p class=\"card\" id=\"ended\" hidden></p><p class=\"card bad\" id=\"fault\" hidden></p><div class=\"tiles\">{tiles}</div>\
         <div class=\"scene\"><figure class=\"card\"><canvas id=\"scene\" aria-label=\"arm\"></canvas><div class=\"bar\">\
         <button id=\"reset\">Reset</button><button id=\"top\">From above</button></div>{flight_note}</figure>\
         <div class=\"card scroll\"><table id=\"joints\"><tr><th class=\"l\">joint</th><th>q rad</th><th>speed rad/s</th>\
         <th>error mrad</th><th>current A</th><th>age ms</th><th class=\"l\">drive</th></tr></table></div></div>\
         <details open><summary><h2>Charts</h2></summary><p>The last ten seconds.</p>\
         <div class=\"two\"><figure class=\"card\" id=\"errors\"></figure><figure class=\"card\" id=\"currents\"></figure>\
         <figure class=\"card\" id=\"angles\"></figure><figure class=\"card\" id=\"load\"></figure></div></details>\
         <details open><summary><h2>Events</h2></summary><p>What controller, host and drives said; the newest first.</p>\
         <div class=\"card recent\"><table id=\"events\"><tr><th class=\"l\">time s</th><th class=\"l\">who</th><th class=\"l\">what</th></tr>\
         </table></div></details><footer>Served by cubectl {version} to this machine only.</footer></main>\
         <script>const scene={scene},live={{\"joints\":{names},\"bound_mrad\":{bound_mrad},\"old_after_s\":{old_after_s}}};{SCENE}</script><script>{LIVE}</script>",
        heading = escape(&title),
        flight_note =
            if plan.is_some() { "<figcaption>Dots: the flight as planned.</figcaption>" } else { "" },
        version = env!("CARGO_PKG_VERSION"),
        scene = scene(robot, plan),
        bound_mrad = (1e3 * POSITION_BOUND_RAD).round(),
        old_after_s = OLD_AFTER.as_secs_f64(),
    );
    document(&title, &body)
}

/// Points of the planned flight, in m.
fn planned_flight(plan: &PlanFile) -> Vec<Vector3<f64>> {
    let (p, v) = (Vector3::from(plan.release.position_m), Vector3::from(plan.release.velocity_m_s));
    let time = |i: u32| plan.landing.flight_s * f64::from(i) / f64::from(FLIGHT_STEPS);
    flight(plan)
        .map_or_else(Vec::new, |model| (0..=FLIGHT_STEPS).map(|i| model.fly(&p, &v, time(i)).p).collect())
}

/// What the picture in space knows before anything was heard: the bodies, and where they can be.
fn scene(robot: &RobotModel, plan: Option<&PlanFile>) -> String {
    let boxes: Vec<String> =
        robot.collision().boxes().iter().map(|b| body(b.link, &b.x_lb, &Vector3::from(b.half_m))).collect();
    let stretched = robot.fk(&robot_model::JointVec::zeros(robot.n()));
    let reach_m =
        stretched.x_w.iter().map(|x| x.pos.norm()).fold(robot.ball(&stretched).pos.norm(), f64::max);
    let floor_m = robot.world().floor_z_m;
    let sides = [-0.5, 0.5].map(|side| [[side, 0.0, 0.0], [0.0, side, 1.0]]);
    let flown = plan.map_or_else(Vec::new, planned_flight);
    let bounds: Vec<Vector3<f64>> = sides
        .as_flattened()
        .iter()
        .map(|share| Vector3::from(*share) * (reach_m + 0.1))
        .chain(flown.iter().copied())
        .collect();
    let links: Vec<String> = stretched.x_w.iter().map(super::scene::link).collect();
    let target = plan.map_or("null".to_owned(), |plan| point(&Vector3::from(plan.target.position_m)));
    format!(
        "{{\"floor\":{floor_m},\"top\":0.3,\"radius\":{},\"last\":{},\"release\":null,\"target\":{target},\"hand\":[],\
         \"planned\":null,\"flight\":{},\"ellipse\":null,\"bounds\":{},\"boxes\":[{}],\
         \"steps\":[{{\"t\":0,\"ball\":{},\"links\":[{}]}}]}}",
        robot.gripper().ball_radius_m,
        robot.n(),
        list(&flown),
        list(&bounds),
        boxes.join(","),
        point(&robot.ball(&stretched).pos),
        links.join(",")
    )
}
