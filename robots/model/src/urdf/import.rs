//! Import of serial revolute arms from URDF, as text of a robot file.
//!
//! URDF has no accelerations, currents, supplies or grippers. So the result is not a model but a robot file: the
//! content of the URDF, plus stated assumptions that its owner can correct, read by the same loader as any other
//! robot file.
//!
//! roxmltree reads the XML (no dependencies, knows line numbers); urdf-rs would bring two dozen crates, drops the
//! line numbers that errors need, and leaves merging of fixed joints and all checks to the caller anyway.

use nalgebra::Matrix3;

use super::arm;
use super::hand::release_frame;
use super::mesh::MeshFiles;
use super::parts::{Axis, Body, Draft, Effort, UrdfOptions};
use super::toml_text::robot_file;
use super::tree::{Inertial, Reader, UrdfError, UrdfProblem, UrdfTree};
use crate::model::RobotModel;
use crate::per_joint::JointVec;
use crate::pose::Pose;

/// A robot file made from URDF.
#[derive(Debug, Clone, PartialEq)]
pub struct UrdfRobot {
    /// TOML text that [`crate::RobotModel::from_toml`] reads.
    pub toml: String,
    /// Number of moving joints.
    pub joints: usize,
    /// What was assumed or left out, one sentence each. Assumed values carry the mark [`crate::survey::ASSUMED`] in the text.
    pub notes: Vec<String>,
}

/// [`robot_file_with_meshes`] without mesh files: meshes are left out with a note.
pub fn robot_file_from_urdf(file: &str, text: &str, options: &UrdfOptions) -> Result<UrdfRobot, UrdfError> {
    robot_file_with_meshes(file, text, options, &|name| Err(format!("{name} was not read")))
}

/// Makes a robot file from the URDF text of a serial arm; `file` is only used in messages, `meshes` reads mesh files.
///
/// Fixed joints are merged into the body before them. A hand is merged too: prismatic and mimic joints, fingers and
/// other branches behind the arm are held at zero. Cylinders, spheres and meshes become boxes around them.
/// Continuous joints get a range of ±180°.
///
/// # Errors
/// [`UrdfError`] names file, line and reason: not a tree, branching arms, prismatic and other joints, missing masses.
pub fn robot_file_with_meshes(
    file: &str,
    text: &str,
    options: &UrdfOptions,
    meshes: &MeshFiles<'_>,
) -> Result<UrdfRobot, UrdfError> {
    let reader = Reader { file, meshes };
    let tree = reader.read(text)?;
    let root = root_of(&reader, &tree)?;
    let chain = arm::joints(&reader, &tree, root, options.end_effector.as_deref())?;
    let mut notes = Vec::new();
    let base = collect_body(&tree, root, &chain, &mut notes);
    let mut axes: Vec<Axis> = Vec::new();
    for k in &chain {
        let joint = &tree.joints[*k];
        let Some(mut turn) = joint.turn else { continue };
        let before = axes.last().map_or(&base, |axis| &axis.body);
        // Its parent is in the body before: the chain has no gap.
        let x_parent = before.links.iter().find(|(link, _)| *link == joint.parent);
        let origin = x_parent.map_or_else(Pose::identity, |(_, x)| *x) * joint.origin;
        let body = collect_body(&tree, joint.child, &chain, &mut notes);
        if body.inertial.is_none() {
            return Err(reader.error(body.line, UrdfProblem::NoInertial(body.name)));
        }
        if turn.range_rad.is_none() {
            notes.push(format!(
                "joint `{}` is continuous; its range is set to -180 to 180 degrees",
                joint.name
            ));
        }
        turn.velocity_rad_s = turn.velocity_rad_s.filter(|v| *v > 0.0);
        if turn.velocity_rad_s.is_none() {
            let v = options.velocity_default_rad_s;
            notes.push(format!("joint `{}` has no velocity limit; {v} rad/s is assumed", joint.name));
        }
        axes.push(Axis { name: joint.name.clone(), origin, turn, body });
    }
    let Some(last) = axes.last() else {
        return Err(reader.error(tree.links[root].line, UrdfProblem::NoJoints));
    };
    let wanted = options.end_effector.as_ref();
    let found = last.body.links.iter().find(|(k, _)| Some(&tree.links[*k].name) == wanted);
    let end_effector = found.map_or_else(Pose::identity, |(_, x)| *x);
    let release = release_frame(&axes, &end_effector).unwrap_or_else(Pose::identity);
    let efforts = efforts(&axes);
    let speed = |axis: &Axis| axis.turn.velocity_rad_s.unwrap_or(options.velocity_default_rad_s);
    let power_w = axes.iter().zip(&efforts).map(|(axis, effort)| speed(axis) * effort.nm).fold(0.0, f64::max);
    let mut voltage_v = VOLTAGE_V;
    while power_w > CURRENT_MAX_A * voltage_v {
        voltage_v *= 2.0;
    }
    notes.push(format!(
        "accelerations are assumed as {} times the velocity limits, jerks as {} times those; drives are generic ones for the simulator, \
         made from speed and torque of each joint",
        options.acceleration_per_velocity_1_s, options.jerk_per_acceleration_1_s
    ));
    notes.push(
        "the hand is assumed to hold a ball of 0.03 m radius in front of all that the last joint moves"
            .to_owned(),
    );
    let (joints, name) = (axes.len(), tree.name.as_str());
    let mut draft = Draft {
        name,
        file,
        base,
        axes,
        efforts,
        end_effector,
        release,
        voltage_v,
        untested: Vec::new(),
        floor_z_m: options.floor_z_m.unwrap_or(0.0),
        floor_from_link: 2.min(joints),
        notes,
    };
    // A file that cannot be loaded is refused when it is used, with the line in it.
    if let Ok(model) = RobotModel::from_toml(file, &robot_file(&draft, options)) {
        leave_out_what_always_touches(&model, options, &mut draft);
    }
    Ok(UrdfRobot { toml: robot_file(&draft, options), joints, notes: draft.notes })
}

/// Voltage of generic drives; doubled until no drive needs more than the current.
const VOLTAGE_V: f64 = 48.0;
/// The largest current of a drive, A; a controller takes up to 60 A.
const CURRENT_MAX_A: f64 = 50.0;
/// Assumed torque over the largest torque that gravity can cause.
const EFFORT_RESERVE: f64 = 2.0;

/// Torques of the joints. If the file gives no torque: twice the torque of gravity with everything behind the joint stretched
/// out.
fn efforts(axes: &[Axis]) -> Vec<Effort> {
    let of = |k: usize| {
        let given = axes[k].turn.effort_nm.filter(|nm| *nm > 0.0);
        let (mut reach_m, mut nm) = (0.0, 0.0);
        for (i, axis) in axes.iter().enumerate().skip(k) {
            reach_m += if i > k { axis.origin.pos.norm() } else { 0.0 };
            nm += axis.body.inertial.map_or(0.0, |own| 9.81 * own.mass_kg * (reach_m + own.com_m.norm()));
        }
        let assumed = ((EFFORT_RESERVE * nm * 10.0).ceil() / 10.0).max(1.0);
        Effort { nm: given.unwrap_or(assumed), given: given.is_some() }
    };
    (0..axes.len()).map(of).collect()
}

/// Poses that are tried.
const POSES: usize = 400;
/// Share of poses: links that touch in more of them, and are near each other in the chain, touch because of their boxes.
const TOUCHING_SHARE: f64 = 0.4;

/// Links at most this many joints apart that touch in the start pose of a simulated arm also do so because of their boxes.
const NEAR_LINKS: usize = 3;
/// Room between floor and arm where a simulated one starts, m.
const FLOOR_ROOM_M: f64 = 0.05;
/// Share of poses: a link that touches the floor in more of them is mounted so low that it nearly always does.
const FLOOR_SHARE: f64 = 0.98;

/// Boxes extend beyond their links. Pairs that touch nearly everywhere are left out of the tests, with a note.
fn leave_out_what_always_touches(model: &RobotModel, options: &UrdfOptions, draft: &mut Draft<'_>) {
    let n = model.n();
    let boxes = model.collision().boxes();
    let (mut touching, mut below) = (vec![vec![0; n + 1]; n + 1], vec![0; n + 1]);
    let (low, high) = (model.q_min(), model.q_max());
    for number in 0..POSES {
        let share = |k: usize| radical_inverse(number + 1, [2, 3, 5, 7, 11, 13, 17][k]);
        let q = JointVec::from_fn(n, |k| low[k] + (high[k] - low[k]) * share(k));
        let placed = model.boxes_at(&model.fk(&q));
        let mut seen = vec![vec![false; n + 1]; n + 1];
        for (a, b) in model.collision().pairs().iter().map(|(a, b)| (usize::from(*a), usize::from(*b))) {
            let (link_a, link_b) = (boxes[a].link.min(boxes[b].link), boxes[a].link.max(boxes[b].link));
            if !seen[link_a][link_b] && placed[a].overlaps(&placed[b]) {
                seen[link_a][link_b] = true;
                touching[link_a][link_b] += 1;
            }
        }
        for (link, count) in below.iter_mut().enumerate().skip(1) {
            let floor_z_m = draft.floor_z_m;
            let touches = |(b, own): (&crate::boxes::Obb, usize)| {
                own == link && b.proximity_to_floor(floor_z_m).distance_m <= 0.0
            };
            *count += usize::from(placed.iter().zip(boxes.iter().map(|b| b.link)).any(touches));
        }
    }
    // A simulated arm starts within 0.1 rad of the middle of its ranges, and homes there.
    for q in [0.0, 0.1].map(|off| (low + high) * 0.5 + JointVec::repeat(n, off)) {
        let placed = model.boxes_at(&model.fk(&q));
        for (a, b) in model.collision().pairs().iter().map(|(a, b)| (usize::from(*a), usize::from(*b))) {
            let (link_a, link_b) = (boxes[a].link.min(boxes[b].link), boxes[a].link.max(boxes[b].link));
            if placed[a].overlaps(&placed[b]) && link_b - link_a <= NEAR_LINKS {
                touching[link_a][link_b] = POSES;
            }
        }
        let moving = placed.iter().zip(boxes).filter(|(_, own)| own.link >= draft.floor_from_link);
        let above_m =
            moving.map(|(b, _)| b.proximity_to_floor(draft.floor_z_m).distance_m).fold(f64::MAX, f64::min);
        if options.floor_z_m.is_none() && above_m < FLOOR_ROOM_M {
            draft.floor_z_m = plain(draft.floor_z_m + ((above_m - FLOOR_ROOM_M) * 10.0).floor() / 10.0);
        }
    }
    if options.floor_z_m.is_none() && draft.floor_z_m < 0.0 {
        draft.notes.push(format!(
            "the floor is assumed {} m below the base, so that the arm is free of it in the middle of its ranges; --floor-z-m says \
             where it is",
            -draft.floor_z_m
        ));
    }
    let often = |count: usize, share: f64| count as f64 > share * POSES as f64;
    let name = |link: usize| link.checked_sub(1).map_or("base", |k| model.links()[k].name.as_str());
    for (a, row) in touching.iter().enumerate() {
        for (b, count) in row.iter().enumerate().filter(|(_, count)| often(**count, TOUCHING_SHARE)) {
            draft.untested.push([a, b]);
            draft.notes.push(format!(
                "`{}` and `{}` are not tested for contact: their boxes touch {}",
                name(a),
                name(b),
                match *count {
                    POSES => "where the arm starts, in the middle of its ranges, or everywhere".to_owned(),
                    count => format!("in {count} of {POSES} random poses"),
                }
            ));
        }
    }
    while draft.floor_from_link < n && often(below[draft.floor_from_link], FLOOR_SHARE) {
        draft.notes.push(format!(
            "`{}` is not tested against the floor: it touches it in nearly all poses",
            name(draft.floor_from_link)
        ));
        draft.floor_from_link += 1;
    }
}

/// A height without the rounding error of tenths.
fn plain(z_m: f64) -> f64 {
    (z_m * 10.0).round() / 10.0
}

/// Van der Corput's sequence: digits of a number mirrored at the point, evenly distributed over 0 to 1.
fn radical_inverse(mut number: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while number > 0 {
        digit /= base as f64;
        value += digit * (number % base) as f64;
        number /= base;
    }
    value
}

fn root_of(reader: &Reader<'_>, tree: &UrdfTree) -> Result<usize, UrdfError> {
    for (k, link) in tree.links.iter().enumerate() {
        let parents: Vec<_> = tree.joints.iter().filter(|j| j.child == k).collect();
        if let [_, second, ..] = parents.as_slice() {
            let text = format!("link `{}` is the child of two joints", link.name);
            return Err(reader.error(second.line, UrdfProblem::NotATree(text)));
        }
    }
    let mut roots = (0..tree.links.len()).filter(|k| !tree.joints.iter().any(|j| j.child == *k));
    match (roots.next(), roots.next()) {
        (Some(root), None) => Ok(root),
        (Some(first), Some(second)) => {
            let (a, b) = (&tree.links[first].name, &tree.links[second].name);
            let text = format!("links `{a}` and `{b}` both have no parent");
            Err(reader.error(tree.links[second].line, UrdfProblem::NotATree(text)))
        }
        (None, _) => Err(reader.error(1, UrdfProblem::NotATree("every link has a parent".to_owned()))),
    }
}

/// A link with everything behind it that no joint of the arm moves.
fn collect_body(tree: &UrdfTree, first: usize, arm: &[usize], notes: &mut Vec<String>) -> Body {
    let mut body = Body {
        name: tree.links[first].name.clone(),
        line: tree.links[first].line,
        inertial: None,
        boxes: Vec::new(),
        links: Vec::new(),
    };
    // Every link has one parent (checked), so this visits each at most once.
    let mut pending = vec![(first, Pose::identity())];
    while let Some((k, x)) = pending.pop() {
        let link = &tree.links[k];
        body.links.push((k, x));
        for (number, joint) in tree.joints.iter().enumerate().filter(|(_, joint)| joint.parent == k) {
            if arm.contains(&number) {
                continue;
            }
            pending.push((joint.child, x * joint.origin));
            if joint.turn.is_some() || joint.foreign.is_some() {
                let kind = joint.foreign.as_deref().unwrap_or("behind the arm");
                notes.push(format!(
                    "joint `{}` ({kind}) is held at zero: `{}` is a part of `{}`",
                    joint.name, tree.links[joint.child].name, body.name
                ));
            }
        }
        if let Some(own) = &link.inertial {
            let own = moved(own, &x);
            body.inertial = Some(body.inertial.map_or(own, |so_far| merged(&so_far, &own)));
        }
        body.boxes.extend(link.boxes.iter().map(|b| (b.name.clone(), x * b.pose, b.half_m)));
        notes.extend(link.left_out.iter().cloned());
    }
    body
}

fn moved(inertial: &Inertial, x: &Pose) -> Inertial {
    Inertial {
        mass_kg: inertial.mass_kg,
        com_m: x.transform_point(&inertial.com_m),
        about_com: x.rot * inertial.about_com * x.rot.transpose(),
    }
}

fn merged(a: &Inertial, b: &Inertial) -> Inertial {
    let mass_kg = a.mass_kg + b.mass_kg;
    // Massless frames are common in URDF; two of them together have no centre.
    if mass_kg <= 0.0 {
        return *a;
    }
    let com_m = (a.com_m * a.mass_kg + b.com_m * b.mass_kg) / mass_kg;
    let steiner = |i: &Inertial| {
        let d = i.com_m - com_m;
        i.about_com + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * i.mass_kg
    };
    Inertial { mass_kg, com_m, about_com: steiner(a) + steiner(b) }
}
