//! SLCAN, the line protocol of serial CAN adapters (LAWICEL CAN232 and CANUSB, and compatible ones).
//!
//! The host sends a command, ended by CR; the adapter answers CR (done) or BELL (refused), and sends received
//! frames as lines of their own.
//!
//! | type | what |
//! |---|---|
//! | [`Command`] | host to adapter: `S8`, `O`, `t0A53084F64`, … |
//! | [`Reply`] | adapter to host: CR, BELL, `z`, `t0A53084F64`, `F00`, … |
//! | [`Assembler`] | bytes of the line to whole lines |
//!
//! Hexadecimal digits are read in either case and written in upper case. Received frames may carry a
//! time stamp of four digits: milliseconds that wrap at one minute.
//!
//! Source: LAWICEL CAN232 manual (version 3) and CANUSB manual; `slcan` driver of Linux for `L` and
//! for acknowledges.

mod assembler;
mod command;
mod reply;

pub use assembler::{Assembled, Assembler};
pub use command::{Bitrate, Command};
pub use reply::Reply;

use super::buffer::TextBuf;
use super::cursor::{Cursor, Expected, Payload, SyntaxError, remote_frame};
use crate::frame::Frame;
use crate::id::{ExtendedId, Id, StandardId};

/// Longest line made or accepted, without its end, in bytes: a frame with time stamp has 30; the rest leaves room
/// for long version strings.
pub const LINE_MAX: usize = 64;

/// Ends a command and most replies.
pub const CR: u8 = b'\r';

/// The reply to a command that was not carried out; stands alone, without CR.
pub const BELL: u8 = 0x07;

/// Time stamps count milliseconds from 0 and wrap to 0 when they would reach this value.
pub const TIMESTAMP_PERIOD_MS: u16 = 60_000;

/// True for the letters that start a frame line.
const fn is_frame_letter(byte: u8) -> bool {
    matches!(byte, b't' | b'T' | b'r' | b'R')
}

/// A whole frame line up to a possible time stamp: letter, id, length, data.
fn frame(cursor: &mut Cursor<'_>) -> Result<Frame, SyntaxError> {
    let letter = cursor.peek();
    cursor.advance();
    let start = cursor.position();
    let id = if matches!(letter, Some(b'T' | b'R')) {
        ExtendedId::new(cursor.hex_exact(8)?)
            .map(Id::Extended)
            .map_err(|_| cursor.error_at(start, Expected::ExtendedId))?
    } else {
        // Three digits go up to FFF.
        StandardId::new(cursor.hex_exact(3)? as u16)
            .map(Id::Standard)
            .map_err(|_| cursor.error_at(start, Expected::StandardId))?
    };
    let dlc = cursor.dlc()?;
    if matches!(letter, Some(b'r' | b'R')) {
        return Ok(remote_frame(id, dlc));
    }
    let mut payload = Payload::default();
    for _ in 0..dlc {
        // Cannot be full: the length code is at most eight.
        payload.push(cursor.data_byte()?);
    }
    Ok(payload.data_frame(id))
}

fn push_frame<const N: usize>(text: &mut TextBuf<N>, frame: &Frame) {
    text.push(match (frame.is_remote(), frame.is_extended()) {
        (false, false) => b't',
        (false, true) => b'T',
        (true, false) => b'r',
        (true, true) => b'R',
    });
    text.push_id(frame.id());
    // One digit, at most 8: decimal and hexadecimal are the same, and this form needs no division.
    text.push_hex(frame.dlc() as u32, 1);
    text.push_data(frame.data());
}
