//! The content that an authentication code covers, byte for byte, so that any client can compute one.
//!
//! A controller with a key carries out an order that can move the arm, or that changes settings of motion, only after
//! [`CHALLENGE`](super::command::CHALLENGE) and [`AUTHORIZE`](super::command::AUTHORIZE) of the same node:
//!
//! ```text
//! code = first 16 bytes of HMAC-SHA-256(key, CONTEXT ‖ nonce ‖ node-ID of the sender ‖ content)
//! content of a command        = 1 ‖ number (2 bytes, little endian) ‖ parameter as sent
//! content of a register write = 2 ‖ length of the name ‖ name ‖ value as sent (tag, count, elements)
//! ```
//!
//! Two commands name things that others on the bus could change. Their content ends with a digest:
//!
//! ```text
//! COMMIT_TRAJECTORY   file   = SHA-256 of the trajectory file
//! ARM_CONFIRM         digest = SHA-256(file ‖ rows), as in the ArmOffer
//! rows: of each register that a run depends on, in the order of the controller's list of registers; all of its settings but
//!       telemetry.period_us and the uavcan.* ones
//! row  = CRC-32 of the name ‖ count of numbers (1 byte) ‖ 0 0 0 ‖ eight numbers of 4 bytes (f32, u32, or 0 and 1), unused ones 0
//! ```
//!
//! A host computes the digest from the file that it has and the settings that it has read. The digest of an offer
//! is only for comparison: a host that signs it unread signs any content.

use super::super::bits::{BufferTooSmall, Encode, Writer};
use super::super::uavcan::command::standard;
use super::super::uavcan::value::Value;
use super::command;
pub use super::command::{CODE_LEN, DIGEST_LEN, NONCE_LEN};

/// Begins what is hashed: a code made for something else never fits.
pub const CONTEXT: &[u8] = b"cubecell.authorize.1";
/// Bytes of a key.
pub const KEY_LEN: usize = 32;
/// Most bytes of a content: a controller with a key refuses longer orders.
pub const CONTENT_LEN_MAX: usize = 128;
/// Register for the key (`unstructured`, [`KEY_LEN`] bytes; an empty value removes the key). Reads as no bytes.
pub const KEY_REGISTER: &str = "security.key";
/// Register that shows whether a key is set (`bit`).
pub const KEYED_REGISTER: &str = "security.keyed";

/// True for commands that a controller with a key accepts only with a code. A [`JOG`](command::JOG) needs one when it begins.
pub const fn needs_code(number: u16) -> bool {
    matches!(
        number,
        command::ARM_CONFIRM
            | command::RUN
            | command::HOME
            | command::JOG
            | command::COMMIT_TRAJECTORY
            | command::GRIPPER
            | command::UNLOCK
            | standard::STORE_PERSISTENT_STATES
    )
}

/// Content of an order, ready to be hashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Content {
    bytes: [u8; CONTENT_LEN_MAX],
    len: usize,
}

impl Content {
    fn of(fill: impl FnOnce(&mut Writer<'_>)) -> Result<Self, BufferTooSmall> {
        let mut bytes = [0; CONTENT_LEN_MAX];
        let mut out = Writer::new(&mut bytes);
        fill(&mut out);
        let len = out.finish()?;
        Ok(Self { bytes, len })
    }

    /// Content of a command.
    ///
    /// # Errors
    /// It is longer than [`CONTENT_LEN_MAX`].
    pub fn of_command(number: u16, parameter: &[u8]) -> Result<Self, BufferTooSmall> {
        Self::of(|out| {
            out.u8(1);
            out.u16(number);
            out.bytes(parameter);
        })
    }

    /// Content of a register write.
    ///
    /// # Errors
    /// As [`Self::of_command`].
    pub fn of_register(name: &[u8], value: &Value<'_>) -> Result<Self, BufferTooSmall> {
        Self::of(|out| {
            out.u8(2);
            // A name has at most 255 bytes on the wire.
            out.u8(name.len() as u8);
            out.bytes(name);
            value.encode(out);
        })
    }

    /// The same content with a digest of a file, or of a file and its settings.
    ///
    /// # Errors
    /// As [`Self::of_command`].
    pub fn about(&self, digest: &[u8; DIGEST_LEN]) -> Result<Self, BufferTooSmall> {
        Self::of(|out| {
            out.bytes(self.as_slice());
            out.bytes(digest);
        })
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&[])
    }
}
