//! From a robot file to a [`RobotModel`].
//!
//! One function per table of the file; units are in the key names and are converted here and nowhere else.

mod bodies;
mod frames;
mod reader;

pub(crate) use frames::turn_z_to;

use std::path::Path;

use nalgebra::Matrix3;
use toml::de::DeTable;

use crate::collision::{CollisionModel, PairRule};
use crate::error::{LoadError, Problem};
use crate::family::{Family, FamilyName};
use crate::model::{Drive, DriveLoop, Gripper, Joint, JointLimits, RobotModel, Supply, World};
use crate::pose::Pose;
use reader::{Section, Source};

/// Version of the robot file that this program reads.
pub const SCHEMA_VERSION: i64 = 1;

/// Robot files that are part of the program: name and text.
const BUILT_IN: [(&str, &str); 3] = [
    ("powercube6", include_str!("../../../robots/powercube6.toml")),
    ("kr16_2", include_str!("../../../robots/kr16_2.toml")),
    ("pincher4", include_str!("../../../robots/pincher4.toml")),
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
pub(crate) fn text_of(name_or_path: &str) -> Result<(String, String), LoadError> {
    if let Some(text) = built_in_text(name_or_path) {
        return Ok((format!("<builtin>/{name_or_path}.toml"), text.to_owned()));
    }
    match std::fs::read_to_string(Path::new(name_or_path)) {
        Ok(text) => Ok((name_or_path.to_owned(), text)),
        Err(e) => {
            let problem = if e.kind() == std::io::ErrorKind::NotFound {
                Problem::UnknownRobot { known: built_in_robots() }
            } else {
                Problem::Unreadable(e.to_string())
            };
            Err(LoadError { file: name_or_path.to_owned(), line: None, key: String::new(), problem })
        }
    }
}

/// Number of joints a robot text describes, without checking the rest.
pub(crate) fn joint_count(file: &str, text: &str) -> Result<usize, LoadError> {
    let source = Source { file, text };
    let document = parse(source)?;
    Ok(Section::root(source, &document).sections("joint")?.len())
}

fn parse<'a>(source: Source<'a>) -> Result<toml::Spanned<DeTable<'a>>, LoadError> {
    DeTable::parse(source.text).map_err(|e| {
        let at = e.span().map_or(0, |s| s.start);
        source.error(at, String::new(), Problem::Syntax(e.message().to_owned()))
    })
}

impl<const N: usize> RobotModel<N> {
    /// Reads a built-in robot by name, or a robot file by path.
    ///
    /// # Errors
    /// [`LoadError`] names file, line, key and reason; a robot with another number of joints than `N` is one.
    pub fn load(name_or_path: &str) -> Result<Self, LoadError> {
        let (file, text) = text_of(name_or_path)?;
        Self::from_toml(&file, &text)
    }

    /// Reads a robot from TOML text; `file` is only used in error messages.
    ///
    /// # Errors
    /// As [`RobotModel::load`].
    pub fn from_toml(file: &str, text: &str) -> Result<Self, LoadError> {
        let source = Source { file, text };
        let document = parse(source)?;
        read_model(&Section::root(source, &document))
    }
}

fn read_model<const N: usize>(root: &Section<'_>) -> Result<RobotModel<N>, LoadError> {
    let found = root.any_integer("schema")?;
    if found != SCHEMA_VERSION {
        return Err(root.error("schema", Problem::Schema { found, supported: SCHEMA_VERSION }));
    }
    let name = root.text("name")?.to_owned();
    let description = root.text_or("description", "")?.to_owned();
    let world = read_world(&root.section("world")?)?;

    let joint_sections = root.sections("joint")?;
    if joint_sections.is_empty() {
        return Err(root.error("joint", Problem::Missing));
    }
    if joint_sections.len() != N {
        return Err(root.error("joint", Problem::JointCount { expected: N, found: joint_sections.len() }));
    }
    let frames = frames::read::<N>(root, &joint_sections)?;
    let joints = read_joints::<N>(&joint_sections, &frames.x_pj)?;
    let x_le = match root.section_if_given("end_effector")? {
        Some(section) => frames::read_pose(&section)?,
        None => Pose::identity(),
    };
    let x_ne = frames.x_jl[N - 1] * x_le;

    let drives = read_drives::<N>(&joint_sections)?;
    let supplies = read_supplies(root, &joints, drives.is_some())?;
    for section in &joint_sections {
        section.finish()?;
    }
    let drive_loop = root.section_if_given("drive_loop")?.map(|s| read_drive_loop(&s)).transpose()?;
    let gripper = read_gripper(&root.section("gripper")?)?;

    let (links, boxes) = bodies::read::<N>(root, &frames.x_jl)?;
    let rule = read_pair_rule(&root.section("collision")?, N)?;
    let ball_n = x_ne.transform_point(&gripper.x_eb.pos);
    let collision = CollisionModel::new(boxes, rule, &frames.x_pj, &ball_n);

    let family_name = root.choice("family", &FamilyName::WORDS)?;
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
        family,
        drives,
        supplies,
        drive_loop,
        world,
        collision,
    })
}

fn read_world(section: &Section<'_>) -> Result<World, LoadError> {
    let world =
        World { gravity_m_s2: section.non_negative("gravity_m_s2")?, floor_z_m: section.f64("floor_z_m")? };
    section.finish()?;
    Ok(world)
}

fn read_joints<const N: usize>(sections: &[Section<'_>], x_pj: &[Pose; N]) -> Result<[Joint; N], LoadError> {
    let mut joints: Vec<Joint> = Vec::with_capacity(N);
    for (section, x_pj) in sections.iter().zip(x_pj) {
        let name = section.text("name")?.to_owned();
        if joints.iter().any(|j| j.name == name) {
            return Err(section.error("name", Problem::Duplicate(name)));
        }
        joints.push(Joint { name, x_pj: *x_pj, limits: read_limits(section)? });
    }
    Ok(exactly(joints))
}

fn read_limits(section: &Section<'_>) -> Result<JointLimits, LoadError> {
    let [min, max] = section.numbers("range_deg")?;
    if min >= max {
        return Err(section.error("range_deg", Problem::LimitsReversed { min, max }));
    }
    // More than two turns either way is a number in another unit, or a joint without limits, which no cable allows.
    for value in [min, max] {
        if value.abs() > 720.0 {
            return Err(section.error("range_deg", Problem::OutOfRange { value, min: -720.0, max: 720.0 }));
        }
    }
    let a_max_rad_s2 = section.positive("acceleration_max_deg_s2")?.to_radians();
    Ok(JointLimits {
        q_min_rad: min.to_radians(),
        q_max_rad: max.to_radians(),
        v_max_rad_s: section.positive("velocity_max_deg_s")?.to_radians(),
        a_max_rad_s2,
        a_control_max_rad_s2: section
            .positive_if_given("control_acceleration_max_rad_s2")?
            .unwrap_or(a_max_rad_s2),
        a_follow_max_rad_s2: section
            .positive_if_given("follow_acceleration_max_deg_s2")?
            .map(f64::to_radians),
        j_max_rad_s3: section.positive("jerk_max_deg_s3")?.to_radians(),
        torque_max_nm: section.positive_if_given("torque_max_nm")?,
    })
}

fn read_drives<const N: usize>(sections: &[Section<'_>]) -> Result<Option<[Drive; N]>, LoadError> {
    let mut drives: Vec<Drive> = Vec::new();
    let mut bare = None;
    for section in sections {
        let Some(part) = section.section_if_given("drive")? else {
            bare = bare.or(Some(section));
            continue;
        };
        let address = part.integer("address", 1..32)?;
        if let Some(k) = drives.iter().position(|d| i64::from(d.address) == address) {
            let owner = sections[k].text("name")?.to_owned();
            return Err(part.error("address", Problem::DuplicateAddress { address, owner }));
        }
        drives.push(Drive {
            module: part.text("module")?.to_owned(),
            address: address as u8,
            firmware: part.integer("firmware", 0..0x1_0000)? as u16,
            gear_ratio: part.positive("gear_ratio")?,
            encoder_slots: part.integer("encoder_slots", 1..1 << 24)? as u32,
            current_max_a: part.positive("current_max_a")?,
            k_b_a_s_rad: part.non_negative("k_b_a_s_rad")?,
            k_m_a_nm: part.non_negative("k_m_a_nm")?,
        });
        part.finish()?;
    }
    match bare {
        Some(section) if !drives.is_empty() => {
            Err(section.error("drive", Problem::DriveMissing(section.text("name")?.to_owned())))
        }
        Some(_) => Ok(None),
        None => Ok(Some(exactly(drives))),
    }
}

fn read_supplies<const N: usize>(
    root: &Section<'_>,
    joints: &[Joint; N],
    with_drives: bool,
) -> Result<Vec<Supply<N>>, LoadError> {
    let mut supplies: Vec<Supply<N>> = Vec::new();
    for section in root.sections("supply")? {
        let name = section.text("name")?.to_owned();
        if supplies.iter().any(|s| s.name == name) {
            return Err(section.error("name", Problem::Duplicate(name)));
        }
        let mut feeds = [false; N];
        for item in section.texts("joints")? {
            let index = joints
                .iter()
                .position(|j| j.name == item.text)
                .ok_or_else(|| item.error(Problem::UnknownJoint(item.text.to_owned())))?;
            let owner = supplies.iter().find(|s| s.feeds[index]).map(|s| s.name.clone());
            if let Some(owner) = owner.or_else(|| feeds[index].then(|| name.clone())) {
                return Err(item.error(Problem::JointInTwoSupplies { joint: item.text.to_owned(), owner }));
            }
            feeds[index] = true;
        }
        let (voltage_v, current_max_a) = (section.positive("voltage_v")?, section.positive("current_max_a")?);
        section.finish()?;
        supplies.push(Supply { name, voltage_v, current_max_a, feeds });
    }
    let unfed = (0..N).find(|k| !supplies.iter().any(|s| s.feeds[*k]));
    match unfed {
        Some(k) if with_drives => {
            Err(root.error("supply", Problem::JointWithoutSupply(joints[k].name.clone())))
        }
        _ => Ok(supplies),
    }
}

fn read_drive_loop(section: &Section<'_>) -> Result<DriveLoop, LoadError> {
    let out = DriveLoop {
        natural_frequency_rad_s: section.positive("natural_frequency_rad_s")?,
        damping_ratio: section.positive("damping_ratio")?,
        coulomb_friction_rad_s2: section.non_negative("coulomb_friction_rad_s2")?,
        position_resolution_rad: section.positive("position_resolution_deg")?.to_radians(),
        delay_periods: section.integer("delay_periods", 0..100)? as u32,
    };
    section.finish()?;
    Ok(out)
}

fn read_gripper(section: &Section<'_>) -> Result<Gripper, LoadError> {
    let x = section.numbers::<3>("release_x_axis")?;
    let y = section.numbers::<3>("release_y_axis")?;
    let z = section.numbers::<3>("release_z_axis")?;
    let rot = Matrix3::from_columns(&[x.into(), y.into(), z.into()]);
    let x_eb = Pose::new(rot, section.numbers::<3>("release_origin_m")?.into());
    let error = x_eb.rotation_error();
    if error > 1e-9 {
        return Err(section.error("release_x_axis", Problem::NotARotation(error)));
    }
    let gripper = Gripper {
        x_eb,
        ball_radius_m: section.positive("ball_radius_m")?,
        ball_mass_kg: section.non_negative("ball_mass_kg")?,
    };
    section.finish()?;
    Ok(gripper)
}

fn read_pair_rule(section: &Section<'_>, joints: usize) -> Result<PairRule, LoadError> {
    let links = joints as i64 + 1;
    let rule = PairRule {
        link_distance_min: section.integer("link_distance_min", 1..links)? as usize,
        floor_from_link: section.integer("floor_from_link", 1..links + 1)? as usize,
    };
    section.finish()?;
    Ok(rule)
}

/// A vector whose length has been checked, as an array.
fn exactly<T: std::fmt::Debug, const N: usize>(items: Vec<T>) -> [T; N] {
    items.try_into().expect("one item was pushed per joint, and the number of joints was checked")
}
