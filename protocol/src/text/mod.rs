//! CAN frames as text: three line formats that tools of the field speak.
//!
//! | module | format | spoken by |
//! |---|---|---|
//! | [`socketcand`] | `< send 123 2 11 22 >` over TCP | socketcand, python-can, SavvyCAN, Kayak |
//!
//! Each codec works both ways and without a heap: a decoder reads a byte slice and borrows from it,
//! an encoder returns a [`TextBuf`] that is long enough for the longest line of its kind. Streams are
//! cut into lines by assemblers of bounded size that find their way back after garbage.
//!
//! Encoders do not go through [`core::fmt`], whose padding code carries panic paths into a firmware
//! image; the `Display` implementations beside them are for hosts.

mod buffer;
mod cursor;
pub mod socketcand;

pub use buffer::{BusName, BusNameError, TextBuf};
pub use cursor::{Expected, SyntaxError};
