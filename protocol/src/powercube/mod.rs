//! PowerCube M5 protocol ("m5api", "amtec"): the drives on the wire, both directions.
//!
//! A host is built from [`Request`] and [`Broadcast`] (encode) and [`Reply`] (decode), a module from the opposite
//! halves. Both come from one description, so they always agree.
//!
//! | module | holds |
//! |---|---|
//! | [`address`] | ids on the bus: which module, which channel |
//! | [`command`] | byte 0: the commands |
//! | [`parameter`] | the parameter table: type, access, unit, firmware gate of each; codec, documentation and DBC are made from it |
//! | [`value`] | typed parameter values and the composite position/state/inputs answer |
//! | [`motion`] | ramp, step, velocity, current; float and ticks; with and without position in the answer |
//! | [`request`], [`broadcast`], [`reply`] | whole frames |
//! | [`state`], [`config`] | state word, short state, digital lines; configuration and set-up bits |
//! | [`firmware`] | version words, gates between generations |
//! | [`baud`] | bit rate codes |
//! | [`dbc`] | the DBC file of all of these |
//!
//! Conventions: module address 1..=31 in the low five bits of an 11-bit id; little endian; floats are
//! IEEE-754 binary32; rad, rad/s, rad/s², A, ms; "Inc" forms in encoder ticks.
//!
//! # Where the sources disagree, and what this codec does
//!
//! No manufacturer's manual and no real module was at hand; the facts come from independent host programs. Where
//! they disagree, the codec decodes tolerantly:
//!
//! * **GET or PUT id.** One host polls parameters on the PUT id and expects answers. Both channels
//!   are accepted for every command; [`Request::encode`] uses the customary one.
//! * **Broadcast length.** The manufacturer's library pads broadcasts to two bytes, others send
//!   one. Both decode; [`broadcast::BroadcastFrame::padded`] keeps which form was seen.
//! * **SET acknowledge.** Byte 2 is 0x64 for "accepted"; one host checks it, others only require three
//!   bytes or check nothing. Answers of 2 to 8 bytes decode; a missing byte is `None`.
//! * **Current in digits** (motions 0x0D and 0x17): int16 in three hosts, int32 in the
//!   manufacturer's library. Both lengths decode, to different variants.
//! * **Parameter 0x07** is a torque ratio or a current offset, **state bit 27** a set-up error or the
//!   logic voltage, depending on source and firmware: the name says so ([`state::CubeState::SETUP_OR_LOGIC_VOLT`]).
//! * **Target ticks 0x28..0x2A** are int32 in the manufacturer's library, uint32 elsewhere: int32
//!   here, the same bits.
//! * **Home offset** is parameter 0x59; the 0x89 seen in one program is a decimal 89 misread.
//! * Answers to unknown commands, unknown parameters and wrong lengths are unknown; hosts treat
//!   silence as a time-out, so a module built on this codec stays silent on a [`RequestError`].

pub mod address;
pub mod baud;
pub mod broadcast;
pub mod command;
pub mod config;
pub mod dbc;
pub mod firmware;
pub mod motion;
pub mod parameter;
pub mod reply;
pub mod request;
pub mod state;
pub mod value;

pub use address::{Address, Channel};
pub use baud::BaudRate;
pub use broadcast::{Broadcast, BroadcastError};
pub use command::{Command, SimpleCommand};
pub use config::{Config, Setup};
pub use firmware::{FirmwareVersion, Gate};
pub use motion::{MotionAck, MotionCommand, MotionKind, MotionRequest};
pub use parameter::{Parameter, ParameterInfo, Unit};
pub use reply::{MotionPosition, Reply, ReplyError};
pub use request::{AddressedRequest, Request, RequestError};
pub use state::{CubeState, Dio, ShortState};
pub use value::{PosStateDio, Value, ValueKind};

/// Byte 2 of the answer to an accepted SET, and of the simple answer to a motion.
pub const ACCEPTED: u8 = 0x64;

/// `N` little-endian bytes of `data` from `at` on, if they are there.
fn bytes_at<const N: usize>(data: &[u8], at: usize) -> Option<[u8; N]> {
    data.get(at..)?.first_chunk::<N>().copied()
}
