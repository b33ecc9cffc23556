//! Drives of the joints: of one family, on all joints or on none.

use toml_reader::Value;

use super::Section;
use crate::error::{LoadError, Problem};
use crate::model::Joint;

/// Tables of a joint that describe its drive.
pub(super) const FAMILIES: [(&str, &str); 4] = [
    ("drive", "[joint.drive]"),
    ("mit", "[joint.mit]"),
    ("cia402", "[joint.cia402]"),
    ("odrive", "[joint.odrive]"),
];

/// Refuses a joint with drives of two families.
pub(super) fn require_one(sections: &[Section<'_>], joints: &[Joint]) -> Result<(), LoadError> {
    for (section, joint) in sections.iter().zip(joints) {
        let mut there = FAMILIES.into_iter().filter(|(key, _)| section.has(key));
        if let (Some(_), Some((key, _))) = (there.next(), there.last()) {
            return Err(section.error(key, Problem::TwoFamilies(joint.name.clone())));
        }
    }
    Ok(())
}

/// The table `key` of all joints, or of no joint; no node twice. `what` is the drive, for people.
pub(super) fn read<T>(
    (key, what): (&'static str, &'static str),
    sections: &[Section<'_>],
    joints: &[Joint],
    node_of: impl Fn(&T) -> u8,
    read: impl Fn(&Section<'_>, &Section<'_>, &Joint) -> Result<T, LoadError>,
) -> Result<Option<Vec<T>>, LoadError> {
    let (mut drives, mut bare) = (Vec::<T>::new(), None);
    for (section, joint) in sections.iter().zip(joints) {
        let Some(part) = section.optional(key, Value::section)? else {
            bare = bare.or(Some((section, joint)));
            continue;
        };
        let drive = read(&part, section, joint)?;
        let node = node_of(&drive);
        if let Some(first) = drives.iter().position(|other| node_of(other) == node) {
            let owner = joints[first].name.clone();
            return Err(part.error("node", Problem::DuplicateNode { node, owner }));
        }
        part.finish()?;
        drives.push(drive);
    }
    match bare {
        Some((section, joint)) if !drives.is_empty() => {
            Err(section.error(key, Problem::FamilyMissing { what, joint: joint.name.clone() }))
        }
        _ => Ok(Some(drives).filter(|drives| !drives.is_empty())),
    }
}
