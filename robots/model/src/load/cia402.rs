//! `[joint.cia402]`: CANopen servos.

use canopen_protocol::NodeId;
use toml_reader::Value;

use super::Section;
use crate::cia402::Cia402Servo;
use crate::error::{LoadError, Problem};
use crate::model::Joint;

/// Highest node of a servo: the one above is the controller's.
const NODE_MAX: i64 = 0x7E;

/// The servos of all joints, or of no joint.
pub(super) fn read(
    sections: &[Section<'_>],
    joints: &[Joint],
) -> Result<Option<Vec<Cia402Servo>>, LoadError> {
    let (mut servos, mut bare) = (Vec::<Cia402Servo>::new(), None);
    for (section, joint) in sections.iter().zip(joints) {
        let Some(part) = section.optional("cia402", Value::section)? else {
            bare = bare.or(Some((section, joint)));
            continue;
        };
        if section.has("drive") || section.has("mit") {
            return Err(section.error("cia402", Problem::Cia402BesideDrive(joint.name.clone())));
        }
        let servo = read_servo(&part)?;
        if let Some(first) = servos.iter().position(|other| other.node == servo.node) {
            let (node, owner) = (servo.node.get(), joints[first].name.clone());
            return Err(part.error("node", Problem::DuplicateNode { node, owner }));
        }
        part.finish()?;
        servos.push(servo);
    }
    match bare {
        Some((section, joint)) if !servos.is_empty() => {
            Err(section.error("cia402", Problem::Cia402Missing(joint.name.clone())))
        }
        _ => Ok(Some(servos).filter(|servos| !servos.is_empty())),
    }
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
