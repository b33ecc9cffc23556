//! MIT frames of Damiao motors, both directions: one command and one answer of eight bytes per motor and period.
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | [`range`] | [`Ranges`]: ranges of the bit fields of a motor; [`MOTORS`]: the makers' table |
//! | [`command`] | [`Command`]: set points of the four modes, enable, disable, zero, clear |
//! | [`state`] | [`State`]: the answer to every command |
//! | [`register`] | [`Register`]: settings of the motor; [`RegisterRequest`], [`RegisterAnswer`] |
//!
//! # On the wire
//!
//! * 11-bit ids, eight data bytes; four are enough for a velocity (mode 3). Commands go to the id of the motor (register 8), answers
//!   come on its master id (register 7), requests for registers go to 0x7FF and name the motor in their data.
//! * A motor answers each command once. It sends nothing by itself, and does not answer a set point of a mode that is not in force.
//! * Position, velocity, gains and torque are bit fields that span a range. **The range is a setting of the motor
//!   (registers 21 to 23). With another range the values of a host are wrong by the ratio, and nothing on the wire shows it.**
//! * A state and an answer of a register have the same id and length. [`RegisterAnswer::decode`] needs the request.
//!
//! # Sources
//!
//! No real motor was at hand. Frames agree with a public client (`damiao-motor` 1.0.6) and with the library of OpenArm's maker
//! (`openarm_can` after 1.2.0), which has driven the simulated arm over CAN FD. Tables come from both. They truncate a value to its
//! field; this package rounds it.

pub mod command;
pub mod range;
pub mod register;
pub mod state;

pub use command::{Clipped, Command, CommandError, Mit};
pub use range::{KD_MAX_NM_S_RAD, KP_MAX_NM_RAD, MOTORS, MotorType, Ranges};
pub use register::{DATA_RATES, Register, RegisterAnswer, RegisterRequest, RegisterValue};
pub use state::{State, Status};

use core::fmt;

use crate::{Frame, Id, StandardId};

/// Id of requests for registers and of [`RegisterRequest::State`].
pub const REGISTER_ID: u16 = 0x7FF;

/// Id to which a motor listens (register 8), 1 to 127.
///
/// An answer holds the low four bits only: with ids above 15 the master ids distinguish motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MotorId(u8);

impl MotorId {
    /// `None` outside 1 to 127.
    pub const fn new(id: u8) -> Option<Self> {
        match id {
            1..=0x7F => Some(Self(id)),
            _ => None,
        }
    }

    /// The number.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// The part of it that stands in an answer.
    pub const fn nibble(self) -> u8 {
        self.0 & 0x0F
    }
}

impl fmt::Display for MotorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#04x}", self.0)
    }
}

/// A data frame with eight bytes. `id` has eleven bits; higher bits are cut off.
fn frame(id: u16, data: [u8; 8]) -> Frame {
    Frame::from_array(Id::Standard(StandardId::from_low_bits(id)), data)
}

/// Standard id and data of a frame with eight bytes, classical or CAN FD.
fn parts(frame: &Frame) -> Option<(u16, [u8; 8])> {
    let Id::Standard(id) = frame.id() else { return None };
    Some((id.get(), frame.data().try_into().ok()?))
}

/// Id and data of a velocity in four bytes, as `openarm_can` sends it. Four zeros are added.
fn short_velocity(frame: &Frame) -> Option<(u16, [u8; 8])> {
    let (Id::Standard(id), &[a, b, c, d]) = (frame.id(), frame.data()) else { return None };
    (id.get() >> 8 == 2).then_some((id.get(), [a, b, c, d, 0, 0, 0, 0]))
}
