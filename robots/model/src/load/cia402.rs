//! `[joint.cia402]`: CANopen servos.

use canopen_protocol::NodeId;
use toml_reader::Value;

use super::{Section, families};
use crate::cia402::Cia402Servo;
use crate::error::LoadError;
use crate::model::Joint;

/// Highest node of a servo: the one above is the controller's.
const NODE_MAX: i64 = 0x7E;

/// The servos of all joints, or of no joint.
pub(super) fn read(
    sections: &[Section<'_>],
    joints: &[Joint],
) -> Result<Option<Vec<Cia402Servo>>, LoadError> {
    let node = |servo: &Cia402Servo| servo.node.get();
    families::read(("cia402", "CANopen servo"), sections, joints, node, |part, _, _| read_servo(part))
}

fn read_servo(part: &Section<'_>) -> Result<Cia402Servo, LoadError> {
    let node = part.required("node", |v| {
        let number = v.integer(1..=NODE_MAX)?;
        u8::try_from(number).ok().and_then(NodeId::new).ok_or_else(|| v.wrong_type("the number of a node"))
    })?;
    Ok(Cia402Servo {
        node,
        counts_per_turn: part.required("counts_per_turn", |v| v.integer(360..=i64::from(i32::MAX) / 4))?
            as u32,
        rated_nm: part.required("rated_nm", Value::positive)?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
        is_absolute: part.required("encoder", |v| v.word(&[("absolute", true), ("incremental", false)]))?,
    })
}
