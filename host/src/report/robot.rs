//! A robot as a picture: side and top, at zero and in a pose, with joint frames, collision boxes and limits. One SVG file
//! with colours of its own, for viewers and pages alike.

use std::fmt::Write as _;

use nalgebra::{Vector2, Vector3};
use robot_model::collision::{CollisionChecker, Obb, Scene};
use robot_model::{Frames, JointVec, RobotModel};

use super::chart::escape;

/// Size of a panel, and the space around it.
const PANEL: f64 = 340.0;
const GAP: f64 = 28.0;
const HEAD: f64 = 64.0;
/// Height of a row of the table of limits.
const ROW: f64 = 22.0;
/// Length of a frame's axes, part of the arm's reach.
const AXIS_SHARE: f64 = 0.07;

/// How the world is seen: what points to the right and what up.
#[derive(Clone, Copy)]
struct View {
    name: &'static str,
    right: Vector3<f64>,
    up: Vector3<f64>,
    labels: [&'static str; 2],
}

fn views() -> [View; 2] {
    [
        View { name: "side", right: Vector3::x(), up: Vector3::z(), labels: ["x", "z"] },
        View { name: "top", right: Vector3::x(), up: Vector3::y(), labels: ["x", "y"] },
    ]
}

/// Where a panel stands in the picture, and its scale: the same for all four.
#[derive(Clone, Copy)]
struct Panel {
    left: f64,
    top: f64,
    view: View,
    /// Centre of what is drawn, in the view, m.
    centre: Vector2<f64>,
    px_per_m: f64,
}

impl Panel {
    fn seen(view: &View, p: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(p.dot(&view.right), p.dot(&view.up))
    }

    fn place(&self, p: &Vector3<f64>) -> (f64, f64) {
        let d = (Self::seen(&self.view, p) - self.centre) * self.px_per_m;
        (self.left + PANEL / 2.0 + d.x, self.top + PANEL / 2.0 - d.y)
    }
}

/// A pose of the arm, ready to be drawn.
struct Posed {
    title: String,
    /// Base, joint origins, end effector, ball.
    chain: Vec<Vector3<f64>>,
    /// Origin and axes of each joint frame.
    frames: Vec<(Vector3<f64>, [Vector3<f64>; 3])>,
    boxes: Vec<Obb>,
    ball: Vector3<f64>,
    /// Names of two bodies that touch.
    contact: Option<String>,
}

fn posed(arm: &RobotModel, title: String, q: &JointVec) -> Posed {
    let frames: Frames = arm.fk(q);
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(arm, &scene);
    let contact = checker.first_contact(&frames);
    let contact = contact.map(|(a, b)| format!("{} touches {}", checker.name(a), checker.name(b)));
    let ball = arm.ball(&frames).pos;
    let mut chain = vec![Vector3::zeros()];
    chain.extend((0..arm.n()).map(|i| frames.origin(i)));
    chain.extend([arm.ee(&frames).pos, ball]);
    let axes = (0..arm.n()).map(|i| {
        let rot = frames.x_w[i].rot;
        (frames.origin(i), [0, 1, 2].map(|k| rot.column(k).into_owned()))
    });
    Posed { title, chain, frames: axes.collect(), boxes: arm.boxes_at(&frames), ball, contact }
}

/// The picture, as SVG text. `q_rad` is the second pose; angles outside the ranges are drawn as they are.
#[must_use]
pub fn picture(arm: &RobotModel, q_rad: &JointVec) -> String {
    let angles: Vec<String> = q_rad.iter().map(|q| format!("{:.0}°", q.to_degrees())).collect();
    let poses = [
        posed(arm, "all joints at zero".to_owned(), &JointVec::zeros(arm.n())),
        posed(arm, format!("pose {}", angles.join(" ")), q_rad),
    ];
    let floor = arm.world().floor_z_m;
    let (width, table_top) = (2.0 * PANEL + 3.0 * GAP, HEAD + 2.0 * (PANEL + 2.0 * GAP));
    let height = table_top + 40.0 + ROW * (arm.n() as f64 + 1.0);
    let mut out = String::new();
    let _ = write!(out, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" ");
    let _ = writeln!(
        out,
        "width=\"{width:.0}\" height=\"{height:.0}\" font-family=\"sans-serif\" font-size=\"12\">"
    );
    let _ = writeln!(out, "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>");
    text(&mut out, (GAP, 26.0), "start", "font-size=\"18\" font-weight=\"bold\"", arm.name());
    text(&mut out, (GAP, 46.0), "start", "fill=\"#555\"", arm.description());
    for (row, view) in views().iter().enumerate() {
        let (centre, px_per_m) = frame_of(view, &poses, floor);
        for (column, pose) in poses.iter().enumerate() {
            let left = GAP + column as f64 * (PANEL + GAP);
            let top = HEAD + GAP + row as f64 * (PANEL + 2.0 * GAP);
            let panel = Panel { left, top, view: *view, centre, px_per_m };
            draw(&mut out, &panel, pose, (row == 0).then_some(floor), arm.gripper().ball_radius_m);
        }
    }
    limits(&mut out, arm, q_rad, table_top);
    out.push_str("</svg>\n");
    out
}

/// Centre and scale that show everything of both poses in one view.
fn frame_of(view: &View, poses: &[Posed], floor: f64) -> (Vector2<f64>, f64) {
    let points =
        poses.iter().flat_map(|p| p.boxes.iter().flat_map(Obb::corners).chain(p.chain.iter().copied()));
    let mut low = Vector2::repeat(f64::INFINITY);
    let mut high = Vector2::repeat(f64::NEG_INFINITY);
    for p in points.chain([Vector3::new(0.0, 0.0, floor)]) {
        let seen = Panel::seen(view, &p);
        (low, high) = (low.inf(&seen), high.sup(&seen));
    }
    let span = (high - low).max().max(1e-3);
    ((low + high) / 2.0, 0.88 * PANEL / span)
}

fn draw(out: &mut String, panel: &Panel, pose: &Posed, floor: Option<f64>, ball_radius_m: f64) {
    let (left, top) = (panel.left, panel.top);
    let _ = writeln!(
        out,
        "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{PANEL}\" height=\"{PANEL}\" fill=\"#fafafa\" stroke=\"#ccc\"/>"
    );
    let title = format!("{}, {}", panel.view.name, pose.title);
    text(out, (left, top - 8.0), "start", "font-weight=\"bold\"", &title);
    if let Some(z) = floor {
        let y = panel.place(&Vector3::new(0.0, 0.0, z)).1;
        let _ = writeln!(
            out,
            "<line x1=\"{left:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{y:.1}\" stroke=\"#8a6d3b\" stroke-width=\"2\"/>",
            left + PANEL
        );
    }
    for body in &pose.boxes {
        let corners: Vec<(f64, f64)> = body.corners().map(|c| panel.place(&c)).collect();
        let outline: Vec<String> = hull(corners).iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let _ = writeln!(
            out,
            "<polygon points=\"{}\" fill=\"#4a90d9\" fill-opacity=\"0.13\" stroke=\"#4a90d9\" stroke-opacity=\"0.7\"/>",
            outline.join(" ")
        );
    }
    let chain: Vec<String> =
        pose.chain.iter().map(|p| panel.place(p)).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let _ = writeln!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#222\" stroke-width=\"3\" stroke-linejoin=\"round\"/>",
        chain.join(" ")
    );
    let length = AXIS_SHARE * PANEL / panel.px_per_m;
    for (k, (origin, axes)) in pose.frames.iter().enumerate() {
        let from = panel.place(origin);
        for (axis, colour) in axes.iter().zip(["#d62728", "#2ca02c", "#1f4fd6"]) {
            let to = panel.place(&(origin + axis * length));
            let _ = writeln!(
                out,
                "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"1.6\"/>",
                from.0, from.1, to.0, to.1
            );
        }
        // Frames at one place: their numbers stand side by side.
        let before = pose.frames.iter().take(k).filter(|(p, _)| {
            let at = panel.place(p);
            (at.0 - from.0).hypot(at.1 - from.1) < 9.0
        });
        let x = from.0 + 6.0 + 13.0 * before.count() as f64;
        text(out, (x, from.1 + 14.0), "start", "fill=\"#222\" font-size=\"11\"", &(k + 1).to_string());
    }
    let (x, y) = panel.place(&pose.ball);
    let r = (ball_radius_m * panel.px_per_m).max(2.0);
    let _ = writeln!(
        out,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\" fill=\"#f5a623\" stroke=\"#b36b00\"/>"
    );
    scale(out, panel);
    if let Some(contact) = &pose.contact {
        text(out, (left + 6.0, top + 16.0), "start", "fill=\"#c00\"", contact);
    }
}

/// A bar of round length, and the names of the axes.
fn scale(out: &mut String, panel: &Panel) {
    let length_m = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
        .into_iter()
        .rfind(|m| m * panel.px_per_m < 0.3 * PANEL)
        .unwrap_or(0.01);
    let (x, y) = (panel.left + 8.0, panel.top + PANEL - 10.0);
    let end = x + length_m * panel.px_per_m;
    let _ = writeln!(
        out,
        "<path d=\"M{x:.1} {:.1}V{y:.1}H{end:.1}V{:.1}\" fill=\"none\" stroke=\"#555\"/>",
        y - 4.0,
        y - 4.0
    );
    let [right, up] = panel.view.labels;
    let label = format!("{length_m} m ({right} to the right, {up} up)");
    text(out, (end + 6.0, y), "start", "fill=\"#555\" font-size=\"11\"", &label);
}

/// Range of each joint as a bar with the pose in it; speed, acceleration, torque.
fn limits(out: &mut String, arm: &RobotModel, q_rad: &JointVec, top: f64) {
    let columns = [GAP, GAP + 150.0, GAP + 400.0, GAP + 490.0, GAP + 620.0];
    let heads = ["joint", "range, °; dot: the pose", "speed, °/s", "acceleration, °/s²", "torque, Nm"];
    for (x, head) in columns.iter().zip(heads) {
        text(out, (*x, top + 16.0), "start", "font-weight=\"bold\"", head);
    }
    let limits = arm.joints().iter().map(|joint| joint.limits);
    let widest = limits.map(|l| l.q_max_rad.max(-l.q_min_rad)).fold(1e-3, f64::max);
    let bar = |q: f64| columns[1] + 110.0 + 60.0 * q / widest;
    for (k, (joint, q)) in arm.joints().iter().zip(q_rad.iter()).enumerate() {
        let y = top + 16.0 + ROW * (k as f64 + 1.0);
        let l = &joint.limits;
        let inside = (l.q_min_rad..=l.q_max_rad).contains(q);
        text(out, (columns[0], y), "start", "", &format!("{} {}", k + 1, joint.name));
        let _ = writeln!(
            out,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"8\" fill=\"#cfe2f3\" stroke=\"#4a90d9\"/>",
            bar(l.q_min_rad),
            y - 9.0,
            bar(l.q_max_rad) - bar(l.q_min_rad)
        );
        let at = q.clamp(-1.1 * widest, 1.1 * widest);
        let colour = if inside { "#222" } else { "#c00" };
        let _ = writeln!(
            out,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" fill=\"{colour}\"/>",
            bar(at),
            y - 5.0
        );
        text(out, (columns[1] + 44.0, y), "end", "", &format!("{:.0}", l.q_min_rad.to_degrees()));
        text(out, (columns[1] + 178.0, y), "start", "", &format!("{:.0}", l.q_max_rad.to_degrees()));
        text(out, (columns[2], y), "start", "", &format!("{:.0}", l.v_max_rad_s.to_degrees()));
        text(out, (columns[3], y), "start", "", &format!("{:.0}", l.a_max_rad_s2.to_degrees()));
        let torque = l.torque_max_nm.map_or_else(|| "not given".to_owned(), |t| format!("{t:.0}"));
        text(out, (columns[4], y), "start", "", &torque);
    }
}

fn text(out: &mut String, (x, y): (f64, f64), anchor: &str, style: &str, words: &str) {
    let _ = writeln!(
        out,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{}</text>",
        escape(words)
    );
}

/// Convex hull of points, counter-clockwise (monotone chain).
fn hull(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = |points: &mut dyn Iterator<Item = (f64, f64)>| {
        let mut chain: Vec<(f64, f64)> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut all = half(&mut points.iter().copied());
    all.extend(half(&mut points.iter().rev().copied()));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_square_with_a_point_inside_is_the_square() {
        let all = hull(vec![(0.0, 0.0), (1.0, 1.0), (0.5, 0.4), (1.0, 0.0), (0.0, 1.0)]);
        assert_eq!(all, [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
    }

    #[test]
    fn the_ball_is_drawn_where_the_kinematics_put_it() {
        let arm: RobotModel = RobotModel::load("powercube6").unwrap();
        let q = JointVec::from([0.4, -0.3, 0.5, 0.2, -0.6, 0.1]);
        let text = picture(&arm, &q);
        let document = roxmltree::Document::parse(&text).unwrap();
        let circles: Vec<(f64, f64)> = document
            .descendants()
            .filter(|n| n.has_tag_name("circle") && n.attribute("fill") == Some("#f5a623"))
            .map(|n| ["cx", "cy"].map(|key| n.attribute(key).unwrap().parse::<f64>().unwrap()).into())
            .collect();
        // Side and top, at zero and posed. Between the poses the ball moves in the picture as in the world.
        let [zero_side, posed_side, zero_top, posed_top] = circles[..] else { panic!("{circles:?}") };
        let ball = |q| arm.ball(&arm.fk(q)).pos;
        let moved = ball(&q) - ball(&JointVec::zeros(arm.n()));
        let side = (posed_side.0 - zero_side.0 - PANEL - GAP, zero_side.1 - posed_side.1);
        let top = (posed_top.0 - zero_top.0 - PANEL - GAP, zero_top.1 - posed_top.1);
        let (side_px_per_m, top_px_per_m) = (side.1 / moved.z, top.1 / moved.y);
        assert!((side.0 - moved.x * side_px_per_m).abs() < 0.5, "{side:?} {moved}");
        assert!((top.0 - moved.x * top_px_per_m).abs() < 0.5, "{top:?} {moved}");
        assert!(side_px_per_m > 50.0 && top_px_per_m > 50.0);
    }
}
