//! A call or a frame of a script for the emulated board.

use protocol::{Frame, Id, Instant};

/// 24 bytes, in the form that `record_throw.rs` describes; without a frame, a call at a deadline.
pub(crate) fn record(at: Instant, frame: Option<&Frame>) -> [u8; 24] {
    let mut bytes = [0; 24];
    bytes[..8].copy_from_slice(&at.as_micros().to_le_bytes());
    let Some(frame) = frame else {
        bytes[8..12].copy_from_slice(&(1u32 << 29).to_le_bytes());
        return bytes;
    };
    let id = match frame.id() {
        Id::Standard(id) => u32::from(id.get()),
        Id::Extended(id) => id.get() | 1 << 31,
    };
    bytes[8..12].copy_from_slice(&(id | u32::from(frame.is_remote()) << 30).to_le_bytes());
    bytes[12] = frame.dlc() as u8;
    bytes[16..16 + frame.data().len()].copy_from_slice(frame.data());
    bytes
}
