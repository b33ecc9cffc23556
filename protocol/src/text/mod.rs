//! CAN frames as text: three line formats that common tools use.
//!
//! | module | format | used by |
//! |---|---|---|
//! | [`candump`] | `(1.000000) can0 123#1122` in log files | can-utils, SavvyCAN, cantools, python-can |
//! | [`slcan`] | `t12321122` over serial lines | LAWICEL adapters and compatible ones |
//! | [`socketcand`] | `< send 123 2 11 22 >` over TCP | socketcand, python-can, SavvyCAN, Kayak |
//!
//! Each codec works both ways and without a heap: a decoder reads a byte slice and borrows from it, an encoder
//! returns a [`TextBuf`] that is long enough for the longest line of its kind. Assemblers of bounded size cut
//! streams into lines and recover after garbage.
//!
//! Encoders do not go through [`core::fmt`], whose padding code carries panic paths into a firmware
//! image; the `Display` implementations beside them are for hosts.

mod buffer;
pub mod candump;
mod cursor;
pub mod slcan;
pub mod socketcand;

pub use buffer::{BusName, BusNameError, TextBuf};
pub use cursor::{Expected, SyntaxError};

/// Strategies for the property tests of all formats.
#[cfg(test)]
pub(crate) mod arbitrary {
    use crate::frame::{FdFlags, Frame};
    use crate::id::{ExtendedId, Id, StandardId};
    use proptest::collection::vec;
    use proptest::prelude::*;

    /// Classical frames and those of CAN FD.
    pub(crate) fn any_frame() -> impl Strategy<Value = Frame> {
        (frame(), any::<Option<(bool, bool)>>(), vec(any::<u8>(), 0..=64)).prop_map(|(frame, fd, data)| {
            let Some((brs, esi)) = fd else { return frame };
            let fitting = (0..=data.len()).rev();
            let long = fitting.map(|len| Frame::new_fd(frame.id(), FdFlags { brs, esi }, &data[..len]));
            long.flatten().next().unwrap()
        })
    }

    /// Every kind of classical frame, both id formats, all lengths.
    pub(crate) fn frame() -> impl Strategy<Value = Frame> {
        (any::<u32>(), any::<bool>(), any::<bool>(), vec(any::<u8>(), 0..=8)).prop_map(
            |(raw, extended, remote, data)| {
                let id = if extended {
                    Id::Extended(ExtendedId::from_low_bits(raw))
                } else {
                    Id::Standard(StandardId::from_low_bits(raw as u16))
                };
                let frame = if remote { Frame::remote(id, data.len()) } else { Frame::new(id, &data) };
                frame.unwrap()
            },
        )
    }

    /// Hostile input, longer than any line.
    pub(crate) fn bytes() -> impl Strategy<Value = Vec<u8>> {
        vec(any::<u8>(), 0..140)
    }
}
