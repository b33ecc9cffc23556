//! `[joint.cia402]` and `[gripper.cia402]`: CANopen servos of profile CiA 402.

use std::fmt;

use protocol::canopen::NodeId;
use toml_reader::Value;

use super::reading::{Taken, of_joints};
use super::{Common, Drives, Tables};
use crate::error::{LoadError, Problem};
use crate::load::Section;
use crate::model::RobotModel;

/// Highest node of a servo. The next number is the node of the controller.
const NODE_MAX: i64 = 0x7E;

/// Outputs for what hangs on the servo; the lower bits are the brake and others of the profile.
const OUTPUT_BITS: std::ops::RangeInclusive<i64> = 16..=31;

/// The servos of an arm.
#[derive(Debug, Clone)]
pub struct Cia402Servos {
    /// Of the joints, base first.
    pub servos: Vec<Cia402Servo>,
    /// What opens the hand.
    pub output: Option<Cia402Output>,
}

/// The digital output of a servo that opens the hand (object 60FE).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cia402Output {
    /// Joint whose servo has it, base first.
    pub joint: usize,
    /// Bit of the object, 16 to 31: 1 opens.
    pub bit: u8,
}

/// Mode in which a servo follows positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cia402Mode {
    /// Mode 8.
    CyclicPosition,
    /// Mode 7: modules that have no mode 8, as SCHUNK's.
    InterpolatedPosition,
}

/// The servo of a joint; all values at the joint, behind the gear.
#[derive(Clone, Copy, PartialEq)]
pub struct Cia402Servo {
    /// Node on the bus.
    pub node: NodeId,
    /// Counts per turn of the joint (objects 608F and 6091).
    pub counts_per_turn: u32,
    /// Rated torque, N·m (object 6076).
    pub rated_nm: f64,
    /// Inertia that the rotor adds, kg·m².
    pub rotor_kg_m2: f64,
    /// True if the encoder knows the joint position at power-on; otherwise a person moves the joint to its zero, which is set
    /// there.
    pub is_absolute: bool,
    /// See [`Cia402Mode`].
    pub mode: Cia402Mode,
}

/// Part of the fingerprint of the robot: the usual mode is left out, so that plans from before there were two stay valid.
impl fmt::Debug for Cia402Servo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, counts_per_turn, rated_nm, rotor_kg_m2, is_absolute, mode } = self;
        let mut text = f.debug_struct("Cia402Servo");
        text.field("node", node).field("counts_per_turn", counts_per_turn).field("rated_nm", rated_nm);
        text.field("rotor_kg_m2", rotor_kg_m2).field("is_absolute", is_absolute);
        if *mode != Cia402Mode::CyclicPosition {
            text.field("mode", mode);
        }
        text.finish()
    }
}

impl RobotModel {
    /// CANopen servos of profile CiA 402, base first, if the robot file describes them (for all joints or for no joint).
    #[must_use]
    pub fn cia402_servos(&self) -> Option<&Cia402Servos> {
        if let Some(Drives::Cia402(servos)) = self.moved_by() { Some(servos) } else { None }
    }
}

pub(super) fn read(tables: &Tables<'_>) -> Result<Option<(Cia402Servos, Common)>, LoadError> {
    let mut nodes = Taken::default();
    let servos = of_joints(("cia402", "CANopen servo"), tables, |part, _, joint| {
        let servo = read_servo(part)?;
        nodes.take_node(part, servo.node.get(), &joint.name)?;
        Ok(servo)
    })?;
    let output = read_output(tables.gripper, servos.as_deref())?;
    Ok(servos.map(|servos| {
        let common = Common {
            addresses: servos.iter().map(|servo| servo.node.get()).collect(),
            rotors_kg_m2: servos.iter().map(|servo| servo.rotor_kg_m2).collect(),
            motors_text: format!("{servos:?} {output:?}"),
            of_controller: Some("CANopen servos"),
            hand_lacks_opener: output.is_none(),
            ..Common::default()
        };
        (Cia402Servos { servos, output }, common)
    }))
}

/// The output that opens the hand, or nothing.
fn read_output(
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
        let why = format!("node {node} is the servo of no joint: name one whose output opens the hand");
        return Err(part.error("output_of", Problem::OfFamily(why.into())));
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
        let why = "a servo in interpolated position mode takes no zero from its place: it needs encoder = \"absolute\"";
        return Err(part.error("encoder", Problem::OfFamily(why.into())));
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
