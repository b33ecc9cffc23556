//! What the readers of all families share.

use toml_reader::Value;

use super::{FingerTravel, TABLES};
use crate::error::{LoadError, Problem};
use crate::load::Section;
use crate::model::Joint;

/// Tables of a robot file that describe drives.
pub(crate) struct Tables<'a> {
    pub(crate) root: &'a Section<'a>,
    /// Of the joints, base first.
    pub(crate) joints: &'a [Section<'a>],
    pub(crate) described: &'a [Joint],
    pub(crate) gripper: &'a Section<'a>,
    pub(crate) bus: Option<&'a Section<'a>>,
}

/// Refuses a joint with drives of two families.
pub(super) fn require_one(tables: &Tables<'_>) -> Result<(), LoadError> {
    for (section, joint) in tables.joints.iter().zip(tables.described) {
        let mut there = TABLES.iter().filter(|(key, _)| section.has(key));
        if let (Some(_), Some((key, _))) = (there.next(), there.last()) {
            return Err(section.error(key, Problem::TwoFamilies(joint.name.clone())));
        }
    }
    Ok(())
}

/// The table `key` of all joints, or of no joint. `what` is the drive, for people. `read` gets the table, that of the joint, and the joint.
pub(super) fn of_joints<T>(
    (key, what): (&'static str, &'static str),
    tables: &Tables<'_>,
    mut read: impl FnMut(&Section<'_>, &Section<'_>, &Joint) -> Result<T, LoadError>,
) -> Result<Option<Vec<T>>, LoadError> {
    let (mut drives, mut bare) = (Vec::new(), None);
    for (section, joint) in tables.joints.iter().zip(tables.described) {
        let Some(part) = section.optional(key, Value::section)? else {
            bare = bare.or(Some((section, joint)));
            continue;
        };
        drives.push(read(&part, section, joint)?);
        part.finish()?;
    }
    match bare {
        Some((section, joint)) if !drives.is_empty() => {
            Err(section.error(key, Problem::FamilyMissing { what, joint: joint.name.clone() }))
        }
        _ => Ok(Some(drives).filter(|drives| !drives.is_empty())),
    }
}

/// Numbers on the bus that are taken: which, and by what.
#[derive(Default)]
pub(super) struct Taken(Vec<(u16, String)>);

impl Taken {
    /// Takes a number for `owner`; `problem` of the first owner if it has one.
    pub(super) fn take(
        &mut self,
        (section, key): (&Section<'_>, &str),
        number: u16,
        owner: &str,
        problem: impl FnOnce(String) -> Problem,
    ) -> Result<(), LoadError> {
        if let Some((_, first)) = self.0.iter().find(|(taken, _)| *taken == number) {
            return Err(section.error(key, problem(first.clone())));
        }
        self.0.push((number, owner.to_owned()));
        Ok(())
    }

    pub(super) fn take_node(
        &mut self,
        section: &Section<'_>,
        node: u8,
        owner: &str,
    ) -> Result<(), LoadError> {
        let problem = |owner| Problem::NumberTaken { what: format!("node {node}"), owner };
        self.take((section, "node"), node.into(), owner, problem)
    }
}

/// Fingers that a motor turns, by `open_deg` and `closed_deg`.
pub(super) fn travel(part: &Section<'_>, max_deg: f64) -> Result<FingerTravel, LoadError> {
    let angle = |key| part.required(key, |v| v.number_in(-max_deg, max_deg)).map(f64::to_radians);
    let travel = FingerTravel { open_rad: angle("open_deg")?, closed_rad: angle("closed_deg")? };
    if travel.open_rad == travel.closed_rad {
        return Err(part.error("open_deg", Problem::GripperStill));
    }
    part.finish()?;
    Ok(travel)
}

/// Refuses the first limit of a joint that is larger than its drive can be ordered: rows of key, value and maximum, in the unit of the file.
/// `holder` is what clips it, for people.
pub(super) fn require_range(
    section: &Section<'_>,
    rows: &[(&str, f64, f64)],
    holder: impl FnOnce() -> String,
) -> Result<(), LoadError> {
    match rows.iter().find(|(_, value, max)| value > max) {
        Some((key, value, max)) => {
            Err(section.error(key, Problem::BeyondDrive { value: *value, max: *max, holder: holder() }))
        }
        None => Ok(()),
    }
}
