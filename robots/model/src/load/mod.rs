//! From a robot file to a [`RobotModel`].
//!
//! One function per table of the file; units are in the key names and are converted only here.

mod bodies;
mod fingers;
mod frames;

pub(crate) use frames::turn_z_to;

use std::ops::RangeInclusive;
use std::path::Path;

use nalgebra::Matrix3;
use toml_reader::{DESCRIPTION_MAX_BYTES, Problem as DocumentProblem, Source, Value};

use crate::boxes::{CollisionModel, PairRule};
use crate::drives::{Drives, Tables, read_generic};
use crate::error::{LoadError, Problem};
use crate::family::{Family, FamilyName};
use crate::model::{DriveLoop, Gripper, Joint, JointLimits, Link, RobotModel, Supply, World};
use crate::per_joint::{JOINTS_MAX, PerJoint};
use crate::pose::Pose;

/// A table of a robot file.
pub(crate) type Section<'a> = toml_reader::Section<'a, Problem>;

/// Version of the robot file that this program reads.
pub const SCHEMA_VERSION: i64 = 1;

/// Robot files that are part of the program: name and text.
const BUILT_IN: [(&str, &str); 3] = [
    ("powercube6", include_str!("../../../powercube6.toml")),
    ("kr16_2", include_str!("../../../kr16_2.toml")),
    ("pincher4", include_str!("../../../pincher4.toml")),
];

/// Names of the robots that are part of the program.
#[must_use]
pub fn built_in_robots() -> Vec<&'static str> {
    BUILT_IN.iter().map(|(name, _)| *name).collect()
}

/// The TOML text of a built-in robot, as a start for one's own file.
#[must_use]
pub fn built_in_text(name: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// File name and text for a built-in name or a path.
///
/// # Errors
/// There is no such robot and no such file, or the file cannot be read.
pub fn text_of(name_or_path: &str) -> Result<(String, String), LoadError> {
    if let Some(text) = built_in_text(name_or_path) {
        return Ok((format!("<builtin>/{name_or_path}.toml"), text.to_owned()));
    }
    match toml_reader::read_text(Path::new(name_or_path), DESCRIPTION_MAX_BYTES) {
        Ok(text) => Ok((name_or_path.to_owned(), text)),
        Err(e) => {
            let problem = if e.kind() == std::io::ErrorKind::NotFound {
                Problem::UnknownRobot { known: built_in_robots() }
            } else {
                DocumentProblem::unreadable(&e).into()
            };
            Err(LoadError::of_file(name_or_path, problem))
        }
    }
}

/// Numbers of joints that are read: those that throws are tested with.
const JOINTS: RangeInclusive<usize> = 4..=7;

impl RobotModel {
    /// Reads a built-in robot by name, or a robot file by path.
    ///
    /// # Errors
    /// [`LoadError`] names file, line, key and reason; it is also returned for fewer than four joints or more than seven.
    pub fn load(name_or_path: &str) -> Result<Self, LoadError> {
        let (file, text) = text_of(name_or_path)?;
        Self::from_toml(&file, &text)
    }

    /// As [`RobotModel::load`], for programs that need exactly `joints` joints: an industrial robot of six axes, a two-arm
    /// cell, an arm for discs.
    ///
    /// # Errors
    /// As [`RobotModel::load`], and [`Problem::JointCount`].
    pub fn load_with_joints(name_or_path: &str, joints: usize) -> Result<Self, LoadError> {
        let model = Self::load(name_or_path)?;
        if model.n() == joints {
            return Ok(model);
        }
        let problem = Problem::JointCount { needed: joints, found: model.n() };
        Err(LoadError { key: "joint".to_owned(), ..LoadError::of_file(name_or_path, problem) })
    }

    /// Reads a robot from TOML text; `file` is only used in error messages.
    ///
    /// # Errors
    /// As [`RobotModel::load`].
    pub fn from_toml(file: &str, text: &str) -> Result<Self, LoadError> {
        let source = Source { file, text };
        let document = source.parse()?;
        read_model(&source.root(&document))
    }
}

fn read_model(root: &Section<'_>) -> Result<RobotModel, LoadError> {
    root.schema("schema", SCHEMA_VERSION)?;
    let joint_sections = root.sections("joint")?;
    if joint_sections.is_empty() {
        return Err(root.error("joint", DocumentProblem::Missing));
    }
    let n = joint_sections.len();
    if !JOINTS.contains(&n) {
        let (min, max) = (*JOINTS.start() as f64, *JOINTS.end() as f64);
        return Err(root.error("joint", DocumentProblem::OutOfRange { value: n as f64, min, max }));
    }
    let name = root.required("name", Value::text)?.to_owned();
    let description = root.or("description", "", Value::text)?.to_owned();
    let world = read_world(&root.required("world", Value::section)?)?;

    let frames = frames::read(root, &joint_sections)?;
    let joints = read_joints(&joint_sections, &frames.x_pj)?;
    let x_le = match root.optional("end_effector", Value::section)? {
        Some(section) => frames::read_pose(&section)?,
        None => Pose::identity(),
    };
    let x_ne = frames.x_jl[n - 1] * x_le;

    let gripper_section = root.required("gripper", Value::section)?;
    let bus = root.optional("bus", Value::section)?;
    let (gripper, bus) = (&gripper_section, bus.as_ref());
    let tables = Tables { root, joints: &joint_sections, described: &joints, gripper, bus };
    let mut drives = Drives::read(&tables)?;
    let mut supplies = read_supplies(root, &joints, matches!(drives, Some((Drives::PowerCubes(_), _))))?;
    if let Some(section) = root.optional("generic_drives", Value::section)? {
        let (modules, supply) = read_generic(root, &section, &tables)?;
        (drives, supplies) = (Some(modules), vec![supply]);
    }
    for section in &joint_sections {
        section.finish()?;
    }
    let drive_loop = root.optional("drive_loop", Value::section)?.map(|s| read_drive_loop(&s)).transpose()?;
    let gripper = read_gripper(&gripper_section)?;
    let fingers =
        root.optional("fingers", Value::section)?.map(|s| fingers::read(&s, &gripper)).transpose()?;

    let (links, boxes) = bodies::read(root, &frames.x_jl)?;
    let rule = read_pair_rule(&root.required("collision", Value::section)?, &links)?;
    let ball_n = x_ne.transform_point(&gripper.x_eb.pos);
    let collision = CollisionModel::new(boxes, rule, &frames.x_pj, &ball_n);

    let family_name = root.required("family", |v| v.word(&FamilyName::WORDS))?;
    let family = Family::fit(family_name, &frames.x_pj, &x_ne)
        .map_err(|why| root.error("family", Problem::FamilyMismatch(why)))?;
    root.finish()?;
    Ok(RobotModel {
        name,
        description,
        joints,
        links,
        x_ne,
        gripper,
        fingers,
        family,
        drives,
        supplies,
        drive_loop,
        world,
        collision,
    })
}

fn read_world(section: &Section<'_>) -> Result<World, LoadError> {
    let world = World {
        gravity_m_s2: section.required("gravity_m_s2", Value::non_negative)?,
        floor_z_m: section.required("floor_z_m", Value::number)?,
    };
    section.finish()?;
    Ok(world)
}

fn read_joints(sections: &[Section<'_>], x_pj: &[Pose]) -> Result<Vec<Joint>, LoadError> {
    let mut joints: Vec<Joint> = Vec::with_capacity(sections.len());
    for (section, x_pj) in sections.iter().zip(x_pj) {
        let name = section.required("name", Value::text)?.to_owned();
        if joints.iter().any(|j| j.name == name) {
            return Err(section.error("name", Problem::Duplicate(name)));
        }
        joints.push(Joint { name, x_pj: *x_pj, limits: read_limits(section)? });
    }
    Ok(joints)
}

fn read_limits(section: &Section<'_>) -> Result<JointLimits, LoadError> {
    let [min, max] = section.required("range_deg", Value::numbers)?;
    if min >= max {
        return Err(section.error("range_deg", Problem::LimitsReversed { min, max }));
    }
    // More than two turns either way is a number in another unit, or a joint without limits, which the cables do not allow.
    for value in [min, max] {
        if value.abs() > 720.0 {
            return Err(
                section.error("range_deg", DocumentProblem::OutOfRange { value, min: -720.0, max: 720.0 })
            );
        }
    }
    let a_max_rad_s2 = section.required("acceleration_max_deg_s2", Value::positive)?.to_radians();
    Ok(JointLimits {
        q_min_rad: min.to_radians(),
        q_max_rad: max.to_radians(),
        v_max_rad_s: section.required("velocity_max_deg_s", speed)?.to_radians(),
        a_max_rad_s2,
        a_control_max_rad_s2: section
            .optional("control_acceleration_max_rad_s2", Value::positive)?
            .unwrap_or(a_max_rad_s2),
        a_follow_max_rad_s2: section
            .optional("follow_acceleration_max_deg_s2", Value::positive)?
            .map(f64::to_radians),
        j_max_rad_s3: section.required("jerk_max_deg_s3", Value::positive)?.to_radians(),
        torque_max_nm: section.optional("torque_max_nm", Value::positive)?,
    })
}

/// A joint speed; a motor's speed, or another unit, is far beyond it.
fn speed(value: &Value<'_, Problem>) -> Result<f64, LoadError> {
    value.positive()?;
    value.number_in(0.0, SPEED_MAX_DEG_S)
}

/// Heaviest ball, kg: more than the hand of any arm of this size carries.
const BALL_MASS_MAX_KG: f64 = 5.0;

/// Ten turns a second.
const SPEED_MAX_DEG_S: f64 = 3600.0;

fn read_supplies(root: &Section<'_>, joints: &[Joint], with_drives: bool) -> Result<Vec<Supply>, LoadError> {
    let mut supplies: Vec<Supply> = Vec::new();
    for section in root.sections("supply")? {
        let name = section.required("name", Value::text)?.to_owned();
        if supplies.iter().any(|s| s.name == name) {
            return Err(section.error("name", Problem::Duplicate(name)));
        }
        let mut feeds = PerJoint::<bool>::default_of(joints.len());
        for item in section.required("joints", Value::items)? {
            let joint = item.text()?;
            let index = joints
                .iter()
                .position(|j| j.name == joint)
                .ok_or_else(|| item.error(Problem::UnknownJoint(joint.to_owned())))?;
            let owner = supplies.iter().find(|s| s.feeds[index]).map(|s| s.name.clone());
            if let Some(owner) = owner.or_else(|| feeds[index].then(|| name.clone())) {
                return Err(item.error(Problem::JointInTwoSupplies { joint: joint.to_owned(), owner }));
            }
            feeds[index] = true;
        }
        let (voltage_v, current_max_a) = (
            section.required("voltage_v", Value::positive)?,
            section.required("current_max_a", Value::positive)?,
        );
        section.finish()?;
        supplies.push(Supply { name, voltage_v, current_max_a, feeds });
    }
    let unfed = (0..joints.len()).find(|k| !supplies.iter().any(|s| s.feeds[*k]));
    match unfed {
        Some(k) if with_drives => {
            Err(root.error("supply", Problem::JointWithoutSupply(joints[k].name.clone())))
        }
        _ => Ok(supplies),
    }
}

fn read_drive_loop(section: &Section<'_>) -> Result<DriveLoop, LoadError> {
    let out = DriveLoop {
        natural_frequency_rad_s: section.required("natural_frequency_rad_s", Value::positive)?,
        damping_ratio: section.required("damping_ratio", Value::positive)?,
        coulomb_friction_rad_s2: section.required("coulomb_friction_rad_s2", Value::non_negative)?,
        position_resolution_rad: section.required("position_resolution_deg", Value::positive)?.to_radians(),
        delay_periods: section.required("delay_periods", |v| v.integer(0..=99))? as u32,
    };
    section.finish()?;
    Ok(out)
}

fn read_gripper(section: &Section<'_>) -> Result<Gripper, LoadError> {
    let x = section.required("release_x_axis", Value::numbers::<3>)?;
    let y = section.required("release_y_axis", Value::numbers::<3>)?;
    let z = section.required("release_z_axis", Value::numbers::<3>)?;
    let rot = Matrix3::from_columns(&[x.into(), y.into(), z.into()]);
    let x_eb = Pose::new(rot, section.required("release_origin_m", Value::numbers::<3>)?.into());
    let error = x_eb.rotation_error();
    if error > 1e-9 {
        return Err(section.error("release_x_axis", Problem::NotARotation(error)));
    }
    let gripper = Gripper {
        x_eb,
        ball_radius_m: section.required("ball_radius_m", Value::positive)?,
        ball_mass_kg: section.required("ball_mass_kg", |v| v.number_in(0.0, BALL_MASS_MAX_KG))?,
    };
    section.finish()?;
    Ok(gripper)
}

fn read_pair_rule(section: &Section<'_>, links: &[Link]) -> Result<PairRule, LoadError> {
    let count = links.len() as i64 + 1;
    let mut rule = PairRule {
        link_distance_min: section.required("link_distance_min", |v| v.integer(1..=count - 1))? as usize,
        floor_from_link: section.required("floor_from_link", |v| v.integer(1..=count))? as usize,
        untested: [0; JOINTS_MAX + 1],
    };
    for pair in section.or("untested", Vec::new(), Value::items)? {
        let mut numbers = Vec::new();
        for item in pair.items()? {
            let name = item.text()?;
            let number = match links.iter().position(|link| link.name == name) {
                Some(k) => k + 1,
                None if name == "base" => 0,
                None => return Err(item.error(Problem::UnknownLink(name.to_owned()))),
            };
            numbers.push(number);
        }
        let [a, b] = *numbers else { return Err(pair.wrong_type("the names of two links")) };
        rule.leave_out(a, b);
    }
    section.finish()?;
    Ok(rule)
}
