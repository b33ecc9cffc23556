//! HTML page of a robot: in space on the way from zero to a pose, from the side and from above with joint frames, and its limits.

use nalgebra::Vector3;
use robot_model::collision::{CollisionChecker, Scene};
use robot_model::{JointVec, RobotModel};

use super::chart::{Chart, Curve, Pen};
use super::page::{Answer, Block, Page, Tone, cell, number};
use super::scene;

/// Length of a frame's axes, part of the arm's reach.
const AXIS_SHARE: f64 = 0.07;
/// Along all edges of a box, by the numbers of its corners.
const EDGES: [usize; 16] = [0, 1, 3, 2, 0, 4, 5, 1, 5, 7, 3, 7, 6, 2, 6, 4];
/// Colours.
const BODIES: usize = 5;
const CHAIN: usize = 6;
const BALL: usize = 1;

/// What points to the right and up, and their names.
type View = (&'static str, fn(&Vector3<f64>) -> (f64, f64), [&'static str; 2]);
const VIEWS: [View; 2] = [
    ("from the side", |p| (p.x, p.z), ["x in m", "z in m"]),
    ("from above", |p| (p.x, p.y), ["x in m", "y in m"]),
];

/// One self-contained HTML file. `q_rad` is the second pose; angles outside the ranges are shown as they are.
#[must_use]
pub fn html(arm: &RobotModel, q_rad: &JointVec) -> String {
    let poses = [("at zero", JointVec::zeros(arm.n())), ("in the pose", *q_rad)];
    let contacts = poses.iter().filter_map(|(name, q)| Some(format!("{name} {}", contact(arm, q)?)));
    let outside = arm
        .joints()
        .iter()
        .zip(q_rad.iter())
        .filter(|(joint, q)| !(joint.limits.q_min_rad..=joint.limits.q_max_rad).contains(*q));
    let outside = outside.map(|(joint, _)| format!("in the pose {} is outside its range", joint.name));
    let wrong: Vec<String> = contacts.chain(outside).collect();
    let answer = if wrong.is_empty() {
        let why = "no bodies touch, and every joint is in its range";
        Answer::new("both poses can be taken", Tone::Good, why, "plan a throw: `cubectl plan throw`")
    } else {
        let next = "if the arm can do this, mend its boxes or ranges: `cubectl robot check`";
        Answer::new("a pose cannot be taken", Tone::Warn, wrong.join("; "), next)
    };
    let mut page = Page::new(arm.name(), arm.description(), &answer);
    page.section("In space", "From all joints at zero to the pose. Drag to turn, wheel to zoom.");
    let q_at = |t_s: f64| *q_rad * t_s.clamp(0.0, 1.0);
    let way = scene::SceneMotion { q_at: &q_at, to_s: 1.0, flight: None, planned: None };
    page.scene(scene::data(arm, None, &way), None);
    page.section(
        "From the side and from above",
        "Light blue: collision boxes. Black: line through the joint origins to the ball (orange). Orange, green and blue lines: x, y and z \
         of the joint frames, with the number of the joint.",
    );
    for view in &VIEWS {
        let both = poses.iter().map(|(name, q)| Block::Chart(seen(arm, view, name, q)));
        page.push(Block::Beside(both.collect()));
    }
    page.part("Limits", "");
    let rows = arm.joints().iter().zip(q_rad.iter()).enumerate().map(|(k, (joint, q))| {
        let (l, degrees) = (&joint.limits, |rad: f64| number(rad.to_degrees(), 0));
        let inside = (l.q_min_rad..=l.q_max_rad).contains(q);
        let torque = l.torque_max_nm.map_or_else(|| cell("not given"), |t| number(t, 0));
        vec![
            cell(format!("{} {}", k + 1, joint.name)),
            degrees(l.q_min_rad),
            degrees(l.q_max_rad),
            (degrees(*q).0, if inside { Tone::Plain } else { Tone::Bad }),
            degrees(l.v_max_rad_s),
            degrees(l.a_max_rad_s2),
            torque,
        ]
    });
    let head = ["joint", "from °", "to °", "pose °", "speed °/s", "acceleration °/s²", "torque Nm"];
    page.table(&head, rows.collect());
    page.finish()
}

fn contact(arm: &RobotModel, q: &JointVec) -> Option<String> {
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(arm, &scene);
    let (a, b) = checker.first_contact(&arm.fk(q))?;
    Some(format!("{} touches {}", checker.name(a), checker.name(b)))
}

fn seen(arm: &RobotModel, (from, flat, labels): &View, name: &str, q: &JointVec) -> Chart {
    let frames = arm.fk(q);
    let ball = arm.ball(&frames).pos;
    let origins: Vec<Vector3<f64>> = (0..arm.n()).map(|k| frames.origin(k)).collect();
    let chain = [Vector3::zeros()].into_iter().chain(origins.iter().copied());
    let chain: Vec<_> = chain.chain([arm.ee(&frames).pos, ball]).map(|p| flat(&p)).collect();
    let mut curves: Vec<Curve> = arm
        .boxes_at(&frames)
        .iter()
        .map(|body| {
            let corners: Vec<_> = body.corners().map(|p| flat(&p)).collect();
            Curve::line("", BODIES, EDGES.map(|k| corners[k]).to_vec())
        })
        .collect();
    curves.push(Curve::line("joints", CHAIN, chain));
    let points = curves.iter().flat_map(|curve| &curve.points);
    let length = AXIS_SHARE * points.map(|p| p.0.hypot(p.1)).fold(0.0, f64::max);
    for (axis, (name, colour)) in [("x", 1), ("y", 2), ("z", 0)].into_iter().enumerate() {
        for (k, origin) in origins.iter().enumerate() {
            let end = origin + frames.x_w[k].rot.column(axis) * length;
            let name = if k == 0 { name } else { "" };
            curves.push(Curve::line(name, colour, vec![flat(origin), flat(&end)]));
        }
    }
    curves.push(Curve::line("ball", BALL, vec![flat(&ball)]).drawn(Pen::Marks));
    if labels[1].starts_with('z') {
        let floor_m = arm.world().floor_z_m;
        curves.push(Curve::line("floor", 7, vec![(-length, floor_m), (length, floor_m)]).drawn(Pen::Dashed));
    }
    let labelled = origins.iter().enumerate().map(|(k, origin)| (flat(origin), (k + 1).to_string()));
    let chart = Chart::new(format!("{from}, {name}"), labels[0], labels[1], curves).equal();
    Chart { labels: labelled.collect(), ..chart }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ball_is_shown_where_the_kinematics_put_it() {
        let arm = RobotModel::load("powercube6").unwrap();
        let q = JointVec::from([0.4, -0.3, 0.5, 0.2, -0.6, 0.1]);
        let ball = arm.ball(&arm.fk(&q)).pos;
        for (view, at) in VIEWS.iter().zip([(ball.x, ball.z), (ball.x, ball.y)]) {
            let chart = seen(&arm, view, "in the pose", &q);
            let shown = chart.curves.iter().find(|curve| curve.name == "ball").unwrap();
            assert_eq!(shown.points, [at]);
            assert_eq!(chart.labels.len(), 6);
            let joints = chart.curves.iter().find(|curve| curve.name == "joints").unwrap();
            assert_eq!(joints.points.last(), Some(&at));
        }
    }

    #[test]
    fn a_line_along_the_edges_of_a_box_has_each_of_the_twelve() {
        let mut edges: Vec<_> = EDGES.windows(2).map(|e| (e[0].min(e[1]), e[0].max(e[1]))).collect();
        assert!(edges.iter().all(|(a, b)| (a ^ b).is_power_of_two()));
        edges.sort_unstable();
        edges.dedup();
        assert_eq!(edges.len(), 12);
    }
}
