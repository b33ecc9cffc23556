//! The protobuf messages of the MCAP log, and the file descriptor set with which a viewer understands them.
//!
//! Written by hand, because three flat messages do not need a code generator. Wire format: *Protocol Buffers
//! encoding*; description: `google/protobuf/descriptor.proto`.

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
    Bytes = 12,
    Uint32 = 13,
}

/// A message under construction.
#[derive(Clone, Debug, Default)]
pub struct Message(Vec<u8>);

impl Message {
    /// The bytes.
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

    /// Double.
    #[must_use]
    pub fn double(mut self, field: u64, value: f64) -> Self {
        varint(&mut self.0, field << 3 | FIXED64);
        self.0.extend_from_slice(&value.to_le_bytes());
        self
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
/// `cubectl.ModuleState`: position and state of a drive, as it told them.
pub const MODULE_STATE: &str = "cubectl.ModuleState";
/// `cubectl.BusError`: what a CAN controller noticed.
pub const BUS_ERROR: &str = "cubectl.BusError";

const FRAME_FIELDS: &[(&str, Type)] = &[
    ("time_us", Type::Uint64),
    ("id", Type::Uint32),
    ("extended", Type::Bool),
    ("remote", Type::Bool),
    ("sent", Type::Bool),
    ("data", Type::Bytes),
];
const MODULE_STATE_FIELDS: &[(&str, Type)] = &[
    ("time_us", Type::Uint64),
    ("module", Type::Uint32),
    ("position_rad", Type::Double),
    ("not_ok", Type::Bool),
    ("moving", Type::Bool),
    ("current_a", Type::Double),
];
const BUS_ERROR_FIELDS: &[(&str, Type)] =
    &[("time_us", Type::Uint64), ("class", Type::Uint32), ("text", Type::String)];

/// `FileDescriptorSet` with all three messages.
pub fn descriptor_set() -> Vec<u8> {
    let mut file = Message::default().bytes(1, b"cubectl.proto").bytes(2, b"cubectl");
    for (name, fields) in
        [("Frame", FRAME_FIELDS), ("ModuleState", MODULE_STATE_FIELDS), ("BusError", BUS_ERROR_FIELDS)]
    {
        let mut message = Message::default().bytes(1, name.as_bytes());
        for (index, (field, kind)) in fields.iter().enumerate() {
            // name = 1, number = 3, label = 4 (1: optional), type = 5.
            let field = Message::default()
                .bytes(1, field.as_bytes())
                .uint(3, index as u64 + 1)
                .uint(4, 1)
                .uint(5, *kind as u64);
            message = message.bytes(2, &field.0);
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
