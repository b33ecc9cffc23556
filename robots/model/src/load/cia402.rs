//! `[joint.cia402]` and `[gripper.cia402]`: CANopen servos.

use canopen_protocol::NodeId;
use toml_reader::Value;

use super::{Section, families};
use crate::cia402::{Cia402Mode, Cia402Output, Cia402Servo};
use crate::error::{LoadError, Problem};
use crate::model::Joint;

/// Highest node of a servo: the one above is the controller's.
const NODE_MAX: i64 = 0x7E;

/// Outputs for what hangs on the servo; the lower bits are the brake and others of the profile.
const OUTPUT_BITS: std::ops::RangeInclusive<i64> = 16..=31;

/// The servos of all joints, or of no joint.
pub(super) fn read(
    sections: &[Section<'_>],
    joints: &[Joint],
) -> Result<Option<Vec<Cia402Servo>>, LoadError> {
    let node = |servo: &Cia402Servo| servo.node.get();
    families::read(("cia402", "CANopen servo"), sections, joints, node, |part, _, _| read_servo(part))
}

/// The output that opens the hand, or nothing.
pub(super) fn read_output(
    gripper: &Section<'_>,
    servos: Option<&[Cia402Servo]>,
) -> Result<Option<Cia402Output>, LoadError> {
    let Some(part) = gripper.optional("cia402", Value::section)? else { return Ok(None) };
    let Some(servos) = servos else {
        return Err(gripper.error("cia402", Problem::GripperAlone("output of a CANopen servo")));
    };
    let node = part.required("output_of", |v| v.integer(1..=NODE_MAX))?;
    let joint = servos.iter().position(|servo| i64::from(servo.node.get()) == node);
    let Some(joint) = joint else {
        return Err(part.error("output_of", Problem::NoServoOfOutput(node as u8)));
    };
    let bit = part.required("bit", |v| v.integer(OUTPUT_BITS))? as u8;
    part.finish()?;
    Ok(Some(Cia402Output { joint, bit }))
}

fn read_servo(part: &Section<'_>) -> Result<Cia402Servo, LoadError> {
    let node = part.required("node", |v| {
        let number = v.integer(1..=NODE_MAX)?;
        u8::try_from(number).ok().and_then(NodeId::new).ok_or_else(|| v.wrong_type("the number of a node"))
    })?;
    let modes = [
        ("cyclic_position", Cia402Mode::CyclicPosition),
        ("interpolated_position", Cia402Mode::InterpolatedPosition),
    ];
    let mode = part.optional("mode", |v| v.word(&modes))?.unwrap_or(Cia402Mode::CyclicPosition);
    let is_absolute = part.required("encoder", |v| v.word(&[("absolute", true), ("incremental", false)]))?;
    if mode == Cia402Mode::InterpolatedPosition && !is_absolute {
        return Err(part.error("encoder", Problem::InterpolatesWithoutZero));
    }
    Ok(Cia402Servo {
        node,
        counts_per_turn: part.required("counts_per_turn", |v| v.integer(360..=i64::from(i32::MAX) / 4))?
            as u32,
        rated_nm: part.required("rated_nm", Value::positive)?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
        is_absolute,
        mode,
    })
}
