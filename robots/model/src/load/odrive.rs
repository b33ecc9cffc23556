//! `[joint.odrive]` and `[gripper.odrive]`: ODrives.

use odrive_protocol::{NodeId, Version};
use toml_reader::Value;

use super::{Section, families};
use crate::error::{LoadError, Problem};
use crate::model::Joint;
use crate::odrive::{OdriveAxis, OdriveGripper};
use crate::travel::FingerTravel;

/// Highest node: addresses of a controller are 1 to 31.
const NODE_MAX: i64 = 31;

/// The axes of all joints, or of no joint.
pub(super) fn read(sections: &[Section<'_>], joints: &[Joint]) -> Result<Option<Vec<OdriveAxis>>, LoadError> {
    let node = |axis: &OdriveAxis| axis.node.get();
    families::read(("odrive", "ODrive axis"), sections, joints, node, |part, section, joint| {
        let axis = read_axis(part)?;
        require_range(section, joint, &axis)?;
        Ok(axis)
    })
}

/// The axis of the fingers, or nothing.
pub(super) fn read_gripper(
    gripper: &Section<'_>,
    axes: Option<&[OdriveAxis]>,
    joints: &[Joint],
) -> Result<Option<OdriveGripper>, LoadError> {
    let Some(part) = gripper.optional("odrive", Value::section)? else { return Ok(None) };
    let Some(axes) = axes else {
        return Err(gripper.error("odrive", Problem::GripperAlone("ODrive axis")));
    };
    let axis = read_axis(&part)?;
    if let Some(first) = axes.iter().position(|other| other.node == axis.node) {
        let owner = joints[first].name.clone();
        return Err(part.error("node", Problem::DuplicateNode { node: axis.node.get(), owner }));
    }
    if !axis.is_at_joint {
        return Err(part.error("encoder", Problem::GripperTurns));
    }
    // Without an inertia the fingers would take no time.
    part.required("rotor_kg_m2", Value::positive)?;
    let angle = |key| part.required(key, |v| v.number_in(-180.0, 180.0)).map(f64::to_radians);
    let travel = FingerTravel { open_rad: angle("open_deg")?, closed_rad: angle("closed_deg")? };
    if travel.open_rad == travel.closed_rad {
        return Err(part.error("open_deg", Problem::GripperStill));
    }
    part.finish()?;
    Ok(Some(OdriveGripper { axis, travel }))
}

fn read_axis(part: &Section<'_>) -> Result<OdriveAxis, LoadError> {
    let node = part.required("node", |v| {
        let number = v.integer(1..=NODE_MAX)?;
        u8::try_from(number).ok().and_then(NodeId::new).ok_or_else(|| v.wrong_type("the number of a node"))
    })?;
    Ok(OdriveAxis {
        node,
        version: part.required("version", |v| v.word(&[("0.5", Version::V05), ("0.6", Version::V06)]))?,
        gear_ratio: part.required("gear_ratio", Value::positive)?,
        is_at_joint: part.required("encoder", |v| v.word(&[("joint", true), ("motor", false)]))?,
        torque_nm_a: part.required("torque_nm_a", Value::positive)?,
        current_max_a: part.required("current_max_a", Value::positive)?,
        position_gain_1_s: part.required("position_gain_1_s", Value::positive)?,
        velocity_gain_nm_s: part.required("velocity_gain_nm_s", Value::positive)?,
        integral_gain_nm: part.or("integral_gain_nm", 0.0, Value::non_negative)?,
        brake: part.required("brake", Value::boolean)?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
    })
}

/// What the joint may do must fit into the fields of a set point, which clip what is larger, and into the current.
fn require_range(section: &Section<'_>, joint: &Joint, axis: &OdriveAxis) -> Result<(), LoadError> {
    let (limits, field) = (&joint.limits, OdriveAxis::FIELD_MAX);
    let torque_max_nm = axis.torque_max_nm().min(field * axis.gear_ratio);
    let rows = [
        ("velocity_max_deg_s", limits.v_max_rad_s.to_degrees(), field * 360.0 / axis.counted()),
        ("torque_max_nm", limits.torque_max_nm.unwrap_or(0.0), torque_max_nm),
    ];
    match rows.into_iter().find(|(_, value, max)| value > max) {
        Some((key, value, max)) => Err(section.error(key, Problem::BeyondOdriveRange { value, max })),
        None => Ok(()),
    }
}
