//! Import of serial revolute arms from URDF, as text of a robot file.
//!
//! URDF knows no accelerations, currents, supplies or grippers. So the result is not a model but a robot file: what
//! URDF says, plus stated assumptions that its owner can correct, read by the same loader as any other robot file.
//!
//! roxmltree reads the XML (no dependencies, knows line numbers); urdf-rs would bring two dozen crates, drops the
//! line numbers that errors need, and leaves merging of fixed joints and all checks to the caller anyway.

use nalgebra::Matrix3;

use super::parts::{Axis, Body, UrdfOptions};
use super::toml_text;
use super::tree::{Inertial, Reader, UrdfError, UrdfProblem, UrdfTree};
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

/// Makes a robot file from the URDF text of a serial arm; `file` is only used in messages.
///
/// Fixed joints are merged into the body before them. Cylinders and spheres become the boxes around them; meshes are
/// left out with a note. Continuous joints get a range of ±180°.
///
/// # Errors
/// [`UrdfError`] names file, line and reason: not a tree, branching arms, prismatic and other joints, missing masses.
pub fn robot_file_from_urdf(file: &str, text: &str, options: &UrdfOptions) -> Result<UrdfRobot, UrdfError> {
    let reader = Reader { file };
    let tree = reader.read(text)?;
    let root = root_of(&reader, &tree)?;
    let mut notes = Vec::new();
    let base = collect_body(&tree, root, &mut notes);
    let mut axes: Vec<Axis> = Vec::new();
    let mut last = base.clone();
    while let Some((joint, x_body_parent)) = moving_joint(&reader, &tree, &last)? {
        let joint = &tree.joints[joint];
        let Some(turn) = joint.turn else { break };
        let body = collect_body(&tree, joint.child, &mut notes);
        if body.inertial.is_none() {
            return Err(reader.error(body.line, UrdfProblem::NoInertial(body.name)));
        }
        if turn.range_rad.is_none() {
            notes.push(format!(
                "joint `{}` is continuous; its range is set to -180 to 180 degrees",
                joint.name
            ));
        }
        if turn.velocity_rad_s.is_none() {
            let v = options.velocity_default_rad_s;
            notes.push(format!("joint `{}` has no velocity limit; {v} rad/s is assumed", joint.name));
        }
        last = body.clone();
        axes.push(Axis { name: joint.name.clone(), origin: x_body_parent * joint.origin, turn, body });
    }
    if axes.is_empty() {
        return Err(reader.error(tree.links[root].line, UrdfProblem::NoJoints));
    }
    let end_effector = end_effector(&reader, &tree, &last, options)?;
    notes.push(format!(
        "accelerations are assumed as {} times the velocity limits, jerks as {} times those; no drives, no currents",
        options.acceleration_per_velocity_1_s, options.jerk_per_acceleration_1_s
    ));
    notes.push("the hand is assumed to hold a ball of 0.03 m radius at the end effector".to_owned());
    let toml = toml_text::robot_file(&tree.name, file, &base, &axes, &end_effector, &notes, options);
    Ok(UrdfRobot { toml, joints: axes.len(), notes })
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

/// A link with everything fixed to it.
fn collect_body(tree: &UrdfTree, first: usize, notes: &mut Vec<String>) -> Body {
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
        let fixed = tree.joints.iter().filter(|j| j.parent == k && j.turn.is_none());
        pending.extend(fixed.map(|j| (j.child, x * j.origin)));
        if let Some(own) = &link.inertial {
            let own = moved(own, &x);
            body.inertial = Some(body.inertial.map_or(own, |so_far| merged(&so_far, &own)));
        }
        body.boxes.extend(link.boxes.iter().map(|b| (b.name.clone(), x * b.pose, b.half_m)));
        notes.extend(link.left_out.iter().map(|what| format!("{what} is left out of the collision model")));
    }
    body
}

/// The one moving joint that starts from a body, with the pose of its parent link in the body.
fn moving_joint(
    reader: &Reader<'_>,
    tree: &UrdfTree,
    body: &Body,
) -> Result<Option<(usize, Pose)>, UrdfError> {
    let mut found: Option<(usize, Pose)> = None;
    for (link, x) in &body.links {
        for (k, joint) in tree.joints.iter().enumerate() {
            if joint.parent != *link || joint.turn.is_none() {
                continue;
            }
            if let Some((first, _)) = found {
                let joints = vec![tree.joints[first].name.clone(), joint.name.clone()];
                return Err(reader.error(joint.line, UrdfProblem::Branch { link: body.name.clone(), joints }));
            }
            found = Some((k, *x));
        }
    }
    Ok(found)
}

fn end_effector(
    reader: &Reader<'_>,
    tree: &UrdfTree,
    last: &Body,
    options: &UrdfOptions,
) -> Result<Pose, UrdfError> {
    let Some(wanted) = &options.end_effector else {
        return Ok(Pose::identity());
    };
    let found = last.links.iter().find(|(k, _)| tree.links[*k].name == *wanted);
    found.map(|(_, x)| *x).ok_or_else(|| {
        let there = last.links.iter().map(|(k, _)| tree.links[*k].name.clone()).collect();
        reader.error(last.line, UrdfProblem::NoSuchEndEffector { wanted: wanted.clone(), there })
    })
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
