//! A classical CAN frame: data or remote, 11- or 29-bit id, 0..=8 bytes.

use core::fmt;

use crate::id::Id;

/// Most data bytes of a classical CAN frame.
pub const MAX_DATA_LEN: usize = 8;

/// Why a frame could not be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// More than [`MAX_DATA_LEN`] data bytes, or a remote frame asking for more.
    TooLong {
        /// The rejected length in bytes.
        len: usize,
    },
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong { len } => {
                write!(f, "{len} bytes do not fit a classical CAN frame (at most {MAX_DATA_LEN})")
            }
        }
    }
}

impl core::error::Error for FrameError {}

/// One classical CAN frame.
///
/// The DLC is the number of data bytes (data frame) or of requested bytes (remote frame); raw DLC values 9..=15,
/// which ISO 11898-1 allows to mean 8, must be folded to 8 by the reader of raw bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    remote: bool,
    dlc: u8,
    /// Bytes from `dlc` on are zero, so that derived equality is equality of frames.
    bytes: [u8; MAX_DATA_LEN],
}

impl Frame {
    /// Data frame with the bytes of `data`; refuses more than eight.
    pub fn new(id: impl Into<Id>, data: &[u8]) -> Result<Self, FrameError> {
        if data.len() > MAX_DATA_LEN {
            return Err(FrameError::TooLong { len: data.len() });
        }
        let mut bytes = [0; MAX_DATA_LEN];
        // Not `copy_from_slice`: optimised for size, its length check stays, and with it a panic.
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = *from;
        }
        Ok(Self { id: id.into(), remote: false, dlc: data.len() as u8, bytes })
    }

    /// Data frame of a length known at compile time; does not compile for more than eight bytes.
    pub fn from_array<const N: usize>(id: impl Into<Id>, data: [u8; N]) -> Self {
        const { assert!(N <= MAX_DATA_LEN, "a classical CAN frame holds at most eight bytes") };
        let mut bytes = [0; MAX_DATA_LEN];
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = from;
        }
        Self { id: id.into(), remote: false, dlc: N as u8, bytes }
    }

    /// Remote frame that requests `dlc` bytes; refuses more than eight.
    pub fn remote(id: impl Into<Id>, dlc: usize) -> Result<Self, FrameError> {
        if dlc > MAX_DATA_LEN {
            return Err(FrameError::TooLong { len: dlc });
        }
        Ok(Self { id: id.into(), remote: true, dlc: dlc as u8, bytes: [0; MAX_DATA_LEN] })
    }

    /// The identifier.
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Data bytes; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        let len = if self.remote { 0 } else { self.dlc as usize };
        self.bytes.get(..len).unwrap_or(&[])
    }

    /// Data length code, 0..=8: bytes carried (data frame) or requested (remote frame).
    pub const fn dlc(&self) -> usize {
        self.dlc as usize
    }

    /// True for a remote transmission request.
    pub const fn is_remote(&self) -> bool {
        self.remote
    }

    /// True for a 29-bit id.
    pub const fn is_extended(&self) -> bool {
        self.id.is_extended()
    }

    /// Bits on the wire without stuff bits, interframe space included: ISO 11898-1 has 47 or 67 around the data.
    pub const fn nominal_bits(&self) -> u32 {
        let overhead = if self.is_extended() { 67 } else { 47 };
        overhead + if self.remote { 0 } else { 8 * self.dlc as u32 }
    }

    /// Arbitration field as a number: of the frames that start together, the smallest key wins.
    pub const fn arbitration_key(&self) -> u32 {
        self.id.arbitration_key(self.remote)
    }
}

/// `0A5#084F64`, `1000007F#`, `123#R4`: the frame field of a candump log line.
impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}#", self.id)?;
        if self.remote {
            write!(f, "R")?;
            if self.dlc > 0 {
                write!(f, "{}", self.dlc)?;
            }
        }
        for byte in self.data() {
            write!(f, "{byte:02X}")?;
        }
        Ok(())
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Frame({self})")
    }
}

impl embedded_can::Frame for Frame {
    fn new(id: impl Into<embedded_can::Id>, data: &[u8]) -> Option<Self> {
        Self::new(Id::from(id.into()), data).ok()
    }

    fn new_remote(id: impl Into<embedded_can::Id>, dlc: usize) -> Option<Self> {
        Self::remote(Id::from(id.into()), dlc).ok()
    }

    fn is_extended(&self) -> bool {
        Self::is_extended(self)
    }

    fn is_remote_frame(&self) -> bool {
        Self::is_remote(self)
    }

    fn id(&self) -> embedded_can::Id {
        self.id.into()
    }

    fn dlc(&self) -> usize {
        Self::dlc(self)
    }

    fn data(&self) -> &[u8] {
        Self::data(self)
    }
}

impl Frame {
    /// Copies any driver's frame type; refuses a driver that reports more than eight bytes.
    pub fn from_embedded_can(frame: &impl embedded_can::Frame) -> Result<Self, FrameError> {
        let id = Id::from(frame.id());
        if frame.is_remote_frame() { Self::remote(id, frame.dlc()) } else { Self::new(id, frame.data()) }
    }

    /// Builds a driver's frame type; `None` if the driver refuses the frame.
    pub fn to_embedded_can<F: embedded_can::Frame>(&self) -> Option<F> {
        let id = embedded_can::Id::from(self.id);
        if self.remote { F::new_remote(id, self.dlc()) } else { F::new(id, self.data()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{ExtendedId, StandardId};
    use proptest::prelude::*;

    fn standard(id: u16) -> Id {
        Id::Standard(StandardId::from_low_bits(id))
    }

    #[test]
    fn nine_bytes_are_refused_with_their_count() {
        assert_eq!(Frame::new(standard(1), &[0; 9]), Err(FrameError::TooLong { len: 9 }));
        assert_eq!(Frame::remote(standard(1), 9), Err(FrameError::TooLong { len: 9 }));
    }

    #[test]
    fn remote_frame_has_a_dlc_and_no_data() {
        let frame = Frame::remote(standard(0x123), 4).unwrap();
        assert_eq!((frame.dlc(), frame.data()), (4, &[][..]));
        assert_eq!(frame.to_string(), "123#R4");
    }

    #[test]
    fn display_is_the_candump_frame_field() {
        assert_eq!(Frame::from_array(standard(0x0A5), [0x08, 0x4F, 0x64]).to_string(), "0A5#084F64");
        let id = Id::Extended(ExtendedId::from_low_bits(0x7F));
        assert_eq!(Frame::from_array(id, []).to_string(), "0000007F#");
    }

    proptest! {
        #[test]
        fn embedded_can_round_trip_keeps_the_frame(
            raw in any::<u32>(), extended: bool, remote: bool,
            data in proptest::collection::vec(any::<u8>(), 0..=8),
        ) {
            let id = if extended {
                Id::Extended(ExtendedId::from_low_bits(raw))
            } else {
                Id::Standard(StandardId::from_low_bits(raw as u16))
            };
            let frame = if remote {
                Frame::remote(id, data.len()).unwrap()
            } else {
                Frame::new(id, &data).unwrap()
            };
            let copy: Frame = frame.to_embedded_can().unwrap();
            prop_assert_eq!(copy, frame);
            prop_assert_eq!(Frame::from_embedded_can(&frame), Ok(frame));
        }
    }
}
