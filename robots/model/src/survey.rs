//! What the owner of a robot file should check: values that are missing, assumed or implausible, each with its line.
//!
//! The loader refuses a file at its first error. A person who writes a file needs all errors, and also values that
//! are allowed but implausible: an arm that cannot hold its own weight, a link with the density of air. The bounds
//! are wide: a finding is nearly always a wrong unit or a forgotten value.

use toml_reader::{Problem as DocumentProblem, Source, Value};

use crate::collision::{CollisionChecker, Scene};
use crate::error::{LoadError, Problem};
use crate::model::RobotModel;
use crate::per_joint::JointVec;

type Section<'a> = toml_reader::Section<'a, Problem>;

/// Comment that marks a value which was not looked up: `velocity_max_deg_s = 90  # assumed: why`.
pub const ASSUMED: &str = "# assumed:";

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weight {
    /// The file cannot be used.
    Error,
    /// It can be used; the value is hardly true.
    Implausible,
    /// The value can be used, but was not looked up.
    Assumed,
}

/// A finding about a robot file.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How bad it is.
    pub weight: Weight,
    /// Line in the file, from 1.
    pub line: Option<usize>,
    /// Path of the key, such as `joint[2].range_deg`.
    pub key: String,
    /// What is wrong.
    pub what: String,
    /// What to do.
    pub next: String,
}

/// Keys that a table must have, and where their values come from.
const WORLD: [(&str, &str); 2] = [
    ("gravity_m_s2", "9.81, unless the arm leaves the Earth"),
    (
        "floor_z_m",
        "height of the floor below the first joint's frame, m (negative: the arm stands on something)",
    ),
];
const JOINT: [(&str, &str); 6] = [
    ("name", "any name that is used once"),
    ("frame", "from the drawing; robots/README.md lists the keys of the three conventions"),
    ("range_deg", "the data sheet: range of the axis"),
    ("velocity_max_deg_s", "the data sheet: top speed of the axis"),
    ("acceleration_max_deg_s2", "the data sheet, or top speed divided by the measured time to reach it"),
    ("jerk_max_deg_s3", "the data sheet; else ten to a hundred times the acceleration"),
];
const GRIPPER: [(&str, &str); 6] = [
    ("release_x_axis", "a direction across the throw, in the end effector's frame"),
    ("release_y_axis", "across both: z cross x"),
    (
        "release_z_axis",
        "the direction in which the ball leaves the open gripper, in the end effector's frame",
    ),
    ("release_origin_m", "centre of the held ball in the end effector's frame, m"),
    ("ball_radius_m", "measure the ball"),
    ("ball_mass_kg", "weigh the ball; 0 leaves its mass out of the dynamics"),
];
const COLLISION: [(&str, &str); 2] = [
    ("link_distance_min", "2, unless boxes of neighbours but one overlap at rest"),
    ("floor_from_link", "2: the first link that may touch the floor"),
];

/// Checks the text of a robot file; `file` is only used in messages. Findings come in order of their lines.
///
/// # Errors
/// The text is not TOML, or a table has another type.
pub fn survey(file: &str, text: &str) -> Result<Vec<Finding>, LoadError> {
    let source = Source { file, text };
    let document = source.parse()?;
    let root: Section<'_> = source.root(&document);
    let mut findings = Vec::new();
    missing(&root, &mut findings)?;
    if findings.is_empty() {
        match RobotModel::from_toml(file, text) {
            Err(refusal) => findings.push(Finding {
                weight: Weight::Error,
                line: refusal.line,
                key: refusal.key,
                what: refusal.problem.to_string(),
                next: "correct this value and check again".to_owned(),
            }),
            Ok(robot) => implausible(&robot, &root, &mut findings)?,
        }
    }
    assumed(text, &mut findings);
    findings.sort_by_key(|finding| finding.line);
    Ok(findings)
}

/// A finding at a key of a table, or at the table if the key is not there.
fn at(section: &Section<'_>, key: &str, weight: Weight, what: String, next: &str) -> Finding {
    let place = section.error(key, DocumentProblem::Missing);
    Finding { weight, line: place.line, key: place.key, what, next: next.to_owned() }
}

fn require(section: &Section<'_>, keys: &[(&str, &str)], findings: &mut Vec<Finding>) {
    for (key, next) in keys.iter().filter(|(key, _)| !section.has(key)) {
        findings.push(at(section, key, Weight::Error, "missing".to_owned(), next));
    }
}

fn missing(root: &Section<'_>, findings: &mut Vec<Finding>) -> Result<(), LoadError> {
    require(
        root,
        &[
            ("schema", "schema = 1"),
            ("name", "name of the robot"),
            (
                "family",
                "\"general\"; robots/README.md names the families with closed-form inverse kinematics",
            ),
            ("frame_convention", "\"modified_dh\", \"standard_dh\" or \"fixed_axis\""),
            ("world", "a table [world] with gravity_m_s2 and floor_z_m"),
            ("joint", "a table [[joint]] for each joint, from the base to the hand"),
            ("link", "a table [[link]] for each joint: what it moves"),
            ("gripper", "a table [gripper]: where the ball is held"),
            ("collision", "a table [collision]: which boxes are tested"),
        ],
        findings,
    );
    for (key, keys) in [("world", &WORLD[..]), ("gripper", &GRIPPER), ("collision", &COLLISION)] {
        if let Some(section) = root.optional(key, Value::section)? {
            require(&section, keys, findings);
        }
    }
    for section in root.sections("joint")? {
        require(&section, &JOINT, findings);
    }
    for section in root.sections("link")? {
        require(&section, &[("name", "any name that is used once")], findings);
        if !section.has("inertial") && !section.has("box") {
            let next = "an `inertial` table, or boxes with masses";
            findings.push(at(&section, "inertial", Weight::Error, "the link has no mass".to_owned(), next));
        }
    }
    Ok(())
}

/// Bounds for real arms: from the slowest to the fastest data sheet at hand, with a factor of three on both sides.
const TIME_TO_TOP_SPEED_S: [f64; 2] = [0.01, 5.0];
const TIME_TO_FULL_ACCELERATION_S: [f64; 2] = [0.0005, 2.0];
const DENSITY_KG_M3: [f64; 2] = [30.0, 12_000.0];
const GRAVITY_M_S2: [f64; 2] = [9.7, 9.9];

fn is_outside(value: f64, [low, high]: [f64; 2]) -> bool {
    !(low..=high).contains(&value)
}

fn implausible(arm: &RobotModel, root: &Section<'_>, findings: &mut Vec<Finding>) -> Result<(), LoadError> {
    let mut add = |section: &Section<'_>, key: &str, what: String, next: &str| {
        findings.push(at(section, key, Weight::Implausible, what, next));
    };
    let (worlds, joints, links) =
        (root.optional("world", Value::section)?, root.sections("joint")?, root.sections("link")?);
    if let Some(world) = &worlds
        && is_outside(arm.world().gravity_m_s2, GRAVITY_M_S2)
    {
        let what = format!("{} m/s² is not the gravity of the Earth", arm.world().gravity_m_s2);
        add(world, "gravity_m_s2", what, "9.81");
    }
    let hold_nm = arm.holding_torques();
    for ((joint, section), hold_nm) in arm.joints().iter().zip(&joints).zip(hold_nm.iter()) {
        let limits = &joint.limits;
        let ramp_s = limits.v_max_rad_s / limits.a_max_rad_s2;
        if is_outside(ramp_s, TIME_TO_TOP_SPEED_S) {
            let what = format!("top speed after {ramp_s:.3} s of full acceleration");
            add(section, "acceleration_max_deg_s2", what, "degrees per second squared, at the joint");
        }
        let ramp_s = limits.a_max_rad_s2 / limits.j_max_rad_s3;
        if is_outside(ramp_s, TIME_TO_FULL_ACCELERATION_S) {
            let what = format!("full acceleration after {ramp_s:.5} s of full jerk");
            add(section, "jerk_max_deg_s3", what, "degrees per second cubed, at the joint");
        }
        if let Some(max) = limits.torque_max_nm
            && max < *hold_nm
        {
            let what = format!("{max} Nm do not hold the arm up: {hold_nm:.1} Nm are needed at worst");
            add(
                section,
                "torque_max_nm",
                what,
                "torque at the joint, behind the gear; or the masses of the links",
            );
        }
    }
    for (k, (link, section)) in arm.links().iter().zip(&links).enumerate() {
        let boxes = arm.collision().boxes().iter().filter(|b| b.link == k + 1);
        let volume_m3: f64 = boxes.map(|b| 8.0 * b.half_m.product()).sum();
        let density = link.inertia.mass_kg() / volume_m3;
        if volume_m3 == 0.0 {
            let what = "the link has no box: nothing keeps it from a collision".to_owned();
            add(section, "box", what, "one to three boxes around the link");
        } else if is_outside(density, DENSITY_KG_M3) {
            let what = format!("{density:.0} kg/m³: {} kg in its boxes", link.inertia.mass_kg());
            add(
                section,
                if section.has("inertial") { "inertial" } else { "box" },
                what,
                "kilograms, and half sizes in metres",
            );
        }
    }
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(arm, &scene);
    let zero = JointVec::zeros(arm.n());
    // Outside its range the zero of a joint is not a pose of the arm.
    let contact = arm.in_range(&zero, 0.0).then(|| checker.first_contact(&arm.fk(&zero))).flatten();
    if let Some((a, b)) = contact {
        let what = format!("{} touches {} with all joints at zero", checker.name(a), checker.name(b));
        if let Some(section) = root.optional("collision", Value::section)? {
            let next = "`cubectl robot show` draws the boxes; smaller boxes, or a larger link_distance_min";
            add(&section, "link_distance_min", what, next);
        }
    }
    for (k, (joint, section)) in arm.joints().iter().zip(&joints).enumerate() {
        if is_outside(0.0, [joint.limits.q_min_rad, joint.limits.q_max_rad]) {
            let what = format!("zero is outside the range of joint {}", k + 1);
            add(section, "range_deg", what, "the zero of the joint is where its frames line up");
        }
    }
    Ok(())
}

/// Values with the mark.
fn assumed(text: &str, findings: &mut Vec<Finding>) {
    for (number, line) in text.lines().enumerate() {
        let Some((before, why)) = line.split_once(ASSUMED) else { continue };
        let Some((key, _)) = before.split_once('=') else { continue };
        findings.push(Finding {
            weight: Weight::Assumed,
            line: Some(number + 1),
            key: key.trim().to_owned(),
            what: why.trim().to_owned(),
            next: "look it up, then remove the mark `# assumed:`".to_owned(),
        });
    }
}
