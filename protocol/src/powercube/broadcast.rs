//! Orders to all modules at once, id 0x100; no module answers.

use core::fmt;

use super::address::BROADCAST_ID;
use super::baud::BaudRate;
use super::command::Command;
use crate::frame::Frame;
use crate::id::Id;

/// Order to all modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Broadcast {
    /// Clear error and halt state.
    Reset,
    /// Start homing.
    Home,
    /// Emergency stop.
    Halt,
    /// Sign of life.
    Watchdog,
    /// Change the bit rate at once.
    Baud(BaudRate),
    /// Latch the position (read back as parameter 0x63).
    SavePosition,
    /// Start the motions that wait for it.
    StartMotion,
}

/// Why a broadcast was not understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BroadcastError {
    /// Not a data frame on id 0x100.
    NotBroadcast(Id),
    /// No data.
    Empty,
    /// No broadcast with this command byte.
    UnknownCommand(u8),
    /// Length the command does not have.
    Length {
        /// Byte 0.
        code: u8,
        /// Bytes seen.
        len: usize,
    },
    /// Bit rate code above 3.
    UnknownBaudCode(u8),
}

impl fmt::Display for BroadcastError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotBroadcast(id) => write!(f, "{id} is not the broadcast id 100"),
            Self::Empty => f.write_str("broadcast without a command byte"),
            Self::UnknownCommand(code) => write!(f, "no broadcast has command {code:#04X}"),
            Self::Length { code, len } => write!(f, "broadcast {code:#04X} does not have {len} bytes"),
            Self::UnknownBaudCode(code) => write!(f, "bit rate code {code} is not 0..=3"),
        }
    }
}

impl core::error::Error for BroadcastError {}

/// A broadcast as it was on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BroadcastFrame {
    /// The order.
    pub broadcast: Broadcast,
    /// True if a zero byte followed, as the manufacturer's library sends it; never for
    /// [`Broadcast::Baud`], whose second byte is the code.
    pub padded: bool,
}

impl Broadcast {
    /// The command byte.
    pub const fn command(self) -> Command {
        match self {
            Self::Reset => Command::Reset,
            Self::Home => Command::Home,
            Self::Halt => Command::Halt,
            Self::Watchdog => Command::Watchdog,
            Self::Baud(_) => Command::Recalc,
            Self::SavePosition => Command::SavePosition,
            Self::StartMotion => Command::StartMotion,
        }
    }

    /// The frame without padding: one byte, two for the bit rate.
    pub fn encode(self) -> Frame {
        match self {
            Self::Baud(rate) => Frame::from_array(BROADCAST_ID, [Command::Recalc.code(), rate.code()]),
            other => Frame::from_array(BROADCAST_ID, [other.command().code()]),
        }
    }

    /// Understands a broadcast; accepts one byte or two for the orders without data.
    pub fn decode(frame: &Frame) -> Result<Self, BroadcastError> {
        BroadcastFrame::decode(frame).map(|decoded| decoded.broadcast)
    }
}

impl BroadcastFrame {
    /// The frame, byte for byte as it was.
    pub fn encode(self) -> Frame {
        match self {
            Self { broadcast: Broadcast::Baud(_), .. } | Self { padded: false, .. } => {
                self.broadcast.encode()
            }
            Self { broadcast, padded: true } => {
                Frame::from_array(BROADCAST_ID, [broadcast.command().code(), 0])
            }
        }
    }

    /// Understands a broadcast and keeps its padding.
    pub fn decode(frame: &Frame) -> Result<Self, BroadcastError> {
        if frame.id() != Id::Standard(BROADCAST_ID) || frame.is_remote() {
            return Err(BroadcastError::NotBroadcast(frame.id()));
        }
        let data = frame.data();
        let code = *data.first().ok_or(BroadcastError::Empty)?;
        let broadcast = match Command::from_code(code) {
            Some(Command::Reset) => Broadcast::Reset,
            Some(Command::Home) => Broadcast::Home,
            Some(Command::Halt) => Broadcast::Halt,
            Some(Command::Watchdog) => Broadcast::Watchdog,
            Some(Command::SavePosition) => Broadcast::SavePosition,
            Some(Command::StartMotion) => Broadcast::StartMotion,
            Some(Command::Recalc) => {
                let [_, rate] = data else { return Err(BroadcastError::Length { code, len: data.len() }) };
                let rate = BaudRate::from_code(*rate).ok_or(BroadcastError::UnknownBaudCode(*rate))?;
                return Ok(Self { broadcast: Broadcast::Baud(rate), padded: false });
            }
            _ => return Err(BroadcastError::UnknownCommand(code)),
        };
        match data {
            [_] => Ok(Self { broadcast, padded: false }),
            [_, 0] => Ok(Self { broadcast, padded: true }),
            _ => Err(BroadcastError::Length { code, len: data.len() }),
        }
    }
}
