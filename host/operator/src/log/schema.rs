//! The protobuf messages of the MCAP log, and the file descriptor sets with which a viewer understands them.
//!
//! Written by hand, because a few flat messages do not need a code generator. Wire format: *Protocol Buffers
//! encoding*; description: `google/protobuf/descriptor.proto`.
//!
//! What viewers know by name uses the public schemas of Foxglove (MIT licence). Their descriptions are in
//! `schemas/foxglove.binpb`, as their publisher's package has them; `tests/interop/log/make_schemas.py` writes the file, and CI
//! compares it with the package.

/// Wire types.
const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const BYTES: u64 = 2;

/// Field types of `FieldDescriptorProto.Type`.
#[derive(Clone, Copy)]
enum Type {
    Double = 1,
    Uint64 = 4,
    Bool = 8,
    String = 9,
    Message = 11,
    Bytes = 12,
    Uint32 = 13,
}

/// A message under construction.
#[derive(Clone, Debug, Default)]
pub struct Message(Vec<u8>);

impl Message {
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    /// Unsigned number or bool.
    #[must_use]
    pub fn uint(mut self, field: u64, value: u64) -> Self {
        varint(&mut self.0, field << 3 | VARINT);
        varint(&mut self.0, value);
        self
    }

    #[must_use]
    pub fn double(mut self, field: u64, value: f64) -> Self {
        varint(&mut self.0, field << 3 | FIXED64);
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    /// Double that is left out if it is not known.
    #[must_use]
    pub fn double_if(self, field: u64, value: Option<f64>) -> Self {
        match value {
            Some(value) => self.double(field, value),
            None => self,
        }
    }

    /// Bytes, text or an inner message.
    #[must_use]
    pub fn bytes(mut self, field: u64, value: &[u8]) -> Self {
        varint(&mut self.0, field << 3 | BYTES);
        varint(&mut self.0, value.len() as u64);
        self.0.extend_from_slice(value);
        self
    }
}

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// `cubectl.Frame`: one frame of the bus.
pub const FRAME: &str = "cubectl.Frame";
/// `cubectl.ModuleState`: position and state of a drive, as it reported them.
pub const MODULE_STATE: &str = "cubectl.ModuleState";
/// `cubectl.BusError`: what a CAN controller noticed.
pub const BUS_ERROR: &str = "cubectl.BusError";
/// `cubectl.GroupState`: the joint group as its controller reports it.
pub const GROUP_STATE: &str = "cubectl.GroupState";
/// `cubectl.JointState`: one joint as its controller reports it.
pub const JOINT_STATE: &str = "cubectl.JointState";
/// `cubectl.FreezeFrame`: everything known at the moment of a fault.
pub const FREEZE_FRAME: &str = "cubectl.FreezeFrame";
/// Something that happened, as text.
pub const EVENT: &str = "foxglove.Log";
/// Angles of the joints.
pub const JOINT_STATES: &str = "foxglove.JointStates";
/// Places of the links.
pub const TRANSFORMS: &str = "foxglove.FrameTransforms";
/// Bodies of the links, and the ball.
pub const SCENE: &str = "foxglove.SceneUpdate";

/// `FileDescriptorSet` of the public schemas.
pub const PUBLIC: &[u8] = include_bytes!("schemas/foxglove.binpb");

type Fields = &'static [(&'static str, Type)];

/// Fields of each message, numbered from 1.
const MESSAGES: &[(&str, Fields)] = &[
    (
        "Frame",
        &[
            ("time_us", Type::Uint64),
            ("id", Type::Uint32),
            ("extended", Type::Bool),
            ("remote", Type::Bool),
            ("sent", Type::Bool),
            ("data", Type::Bytes),
            ("can_fd", Type::Bool),
            ("bit_rate_switch", Type::Bool),
            ("error_state_indicator", Type::Bool),
        ],
    ),
    (
        "ModuleState",
        &[
            ("time_us", Type::Uint64),
            ("module", Type::Uint32),
            ("position_rad", Type::Double),
            ("not_ok", Type::Bool),
            ("moving", Type::Bool),
            ("current_a", Type::Double),
        ],
    ),
    ("BusError", &[("time_us", Type::Uint64), ("class", Type::Uint32), ("text", Type::String)]),
    (
        "GroupState",
        &[
            ("time_us", Type::Uint64),
            ("controller", Type::Uint32),
            ("state", Type::String),
            ("state_number", Type::Uint32),
            ("fault_cause", Type::Uint32),
            ("fault_joint", Type::Uint32),
            ("homed_mask", Type::Uint32),
            ("host_alive", Type::Bool),
            ("gripper_open", Type::Bool),
            ("cycle_us", Type::Uint32),
            ("cycle_jitter_us", Type::Uint32),
            ("cycles_late", Type::Uint32),
            ("replies_missed", Type::Uint32),
            ("cycles_saturated", Type::Uint32),
            ("bus_load", Type::Double),
            ("plan_time_s", Type::Double),
            ("uptime_us", Type::Uint64),
        ],
    ),
    (
        "JointState",
        &[
            ("time_us", Type::Uint64),
            ("joint", Type::Uint32),
            ("q_rad", Type::Double),
            ("qd_rad_s", Type::Double),
            ("error_q_rad", Type::Double),
            ("error_qd_rad_s", Type::Double),
            ("qdd_command_rad_s2", Type::Double),
            ("current_a", Type::Double),
            ("acceleration_clipped", Type::Bool),
            ("reply_missed", Type::Bool),
        ],
    ),
    (
        "FreezeFrame",
        &[
            ("time_us", Type::Uint64),
            ("fault_cause", Type::Uint32),
            ("fault_joint", Type::Uint32),
            ("state_before", Type::String),
            ("plan_time_s", Type::Double),
            ("drives", Type::Message),
            ("frames", Type::Message),
        ],
    ),
    (
        "FrozenDrive",
        &[
            ("module", Type::Uint32),
            ("position_rad", Type::Double),
            ("position_age_s", Type::Double),
            ("current_a", Type::Double),
            ("ramp_target_rad", Type::Double),
            ("ramp_a_rad_s2", Type::Double),
            ("state_word", Type::Uint32),
        ],
    ),
];

/// Inner messages: message, field, type. They are repeated.
const INNER: &[(&str, &str, &str)] =
    &[("FreezeFrame", "drives", ".cubectl.FrozenDrive"), ("FreezeFrame", "frames", ".cubectl.Frame")];

/// `FieldDescriptorProto`: name = 1, number = 3, label = 4 (1: optional, 3: repeated), type = 5, type name = 6.
fn field(name: &str, number: u64, kind: Type, of: Option<&str>, repeated: bool) -> Message {
    let field = Message::default()
        .bytes(1, name.as_bytes())
        .uint(3, number)
        .uint(4, if repeated { 3 } else { 1 })
        .uint(5, kind as u64);
    match of {
        Some(of) => field.bytes(6, of.as_bytes()),
        None => field,
    }
}

/// `FileDescriptorSet` with all messages of ours.
pub fn descriptor_set() -> Vec<u8> {
    let mut file = Message::default().bytes(1, b"cubectl.proto").bytes(2, b"cubectl");
    for (name, fields) in MESSAGES {
        let mut message = Message::default().bytes(1, name.as_bytes());
        for (number, (field_name, kind)) in (1..).zip(fields.iter()) {
            let inner = INNER.iter().find(|(of, named, _)| of == name && named == field_name);
            let described = field(field_name, number, *kind, inner.map(|inner| inner.2), inner.is_some());
            message = message.bytes(2, &described.0);
        }
        file = file.bytes(4, &message.0);
    }
    let file = file.bytes(12, b"proto3");
    Message::default().bytes(1, &file.0).0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_follows_the_examples_of_the_protobuf_documentation() {
        // "message Test1 { int32 a = 1; } with a = 150" and "Test2 { string b = 2; } with testing".
        assert_eq!(Message::default().uint(1, 150).into_bytes(), [0x08, 0x96, 0x01]);
        let bytes = Message::default().bytes(2, b"testing").into_bytes();
        assert_eq!(bytes, [0x12, 0x07, 0x74, 0x65, 0x73, 0x74, 0x69, 0x6e, 0x67]);
    }
}
