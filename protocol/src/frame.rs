//! A CAN frame: classical (data or remote, 0..=8 bytes) or CAN FD (0..=64 bytes), 11- or 29-bit id.

use core::fmt;

use crate::id::Id;

/// Most data bytes of a classical CAN frame.
pub const MAX_DATA_LEN: usize = 8;

/// Most data bytes that a [`Frame`] of this build holds: 64 with the feature `long-frames`, otherwise 8, also of CAN FD.
pub const CAPACITY: usize = if cfg!(feature = "long-frames") { 64 } else { MAX_DATA_LEN };

/// Data bytes of CAN FD by the length code.
const FD_LENGTHS: [u8; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

/// Why a frame could not be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// More than [`MAX_DATA_LEN`] data bytes, or a remote frame asking for more.
    TooLong {
        /// The rejected length in bytes.
        len: usize,
    },
    /// No length of a CAN FD frame (0 to 8, 12, 16, 20, 24, 32, 48, 64 bytes), or more than [`CAPACITY`].
    FdLength {
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
            Self::FdLength { len } => write!(
                f,
                "{len} bytes are no length of a CAN FD frame (0 to 8, 12, 16, 20, 24, 32, 48, 64; here at most {CAPACITY})"
            ),
        }
    }
}

impl core::error::Error for FrameError {}

/// Flags of a CAN FD frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FdFlags {
    /// Bit rate switch: length code, data and checksum go at the data rate.
    pub brs: bool,
    /// Error state indicator: the sender is error-passive.
    pub esi: bool,
}

impl FdFlags {
    /// With bit rate switch, from an error-active sender.
    pub const BRS: Self = Self { brs: true, esi: false };

    /// As Linux and candump write them: 1 BRS, 2 ESI.
    pub const fn nibble(self) -> u8 {
        self.brs as u8 | (self.esi as u8) << 1
    }

    /// The same way back; other bits are left out.
    pub const fn from_nibble(nibble: u8) -> Self {
        Self { brs: nibble & 1 != 0, esi: nibble & 2 != 0 }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Format {
    Data,
    Remote,
    Fd(FdFlags),
}

/// One CAN frame, classical or FD.
///
/// [`Frame::dlc`] is the number of data bytes or, of a remote frame, of requested bytes; raw length codes 9..=15 of a classical
/// frame, which ISO 11898-1 allows to mean 8, must be folded to 8 by the reader of raw bits.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    format: Format,
    dlc: u8,
    /// Bytes from `dlc` on are zero, so that derived equality is equality of frames.
    bytes: [u8; CAPACITY],
}

impl Frame {
    /// Classical data frame with the bytes of `data`; refuses more than eight.
    pub fn new(id: impl Into<Id>, data: &[u8]) -> Result<Self, FrameError> {
        if data.len() > MAX_DATA_LEN {
            return Err(FrameError::TooLong { len: data.len() });
        }
        Ok(Self::filled(id.into(), Format::Data, data))
    }

    /// CAN FD frame with the bytes of `data`; refuses lengths that CAN FD does not have, and more than [`CAPACITY`].
    pub fn new_fd(id: impl Into<Id>, flags: FdFlags, data: &[u8]) -> Result<Self, FrameError> {
        if data.len() > CAPACITY || !FD_LENGTHS.iter().any(|len| usize::from(*len) == data.len()) {
            return Err(FrameError::FdLength { len: data.len() });
        }
        Ok(Self::filled(id.into(), Format::Fd(flags), data))
    }

    /// The bytes of `data` fit.
    fn filled(id: Id, format: Format, data: &[u8]) -> Self {
        let mut bytes = [0; CAPACITY];
        // Not `copy_from_slice`: optimised for size, its length check stays, and with it a panic.
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = *from;
        }
        Self { id, format, dlc: data.len() as u8, bytes }
    }

    /// Classical data frame of a length known at compile time; does not compile for more than eight bytes.
    pub fn from_array<const N: usize>(id: impl Into<Id>, data: [u8; N]) -> Self {
        const { assert!(N <= MAX_DATA_LEN, "a classical CAN frame holds at most eight bytes") };
        let mut bytes = [0; CAPACITY];
        for (to, from) in bytes.iter_mut().zip(data) {
            *to = from;
        }
        Self { id: id.into(), format: Format::Data, dlc: N as u8, bytes }
    }

    /// Remote frame that requests `dlc` bytes; refuses more than eight.
    pub fn remote(id: impl Into<Id>, dlc: usize) -> Result<Self, FrameError> {
        if dlc > MAX_DATA_LEN {
            return Err(FrameError::TooLong { len: dlc });
        }
        Ok(Self { id: id.into(), format: Format::Remote, dlc: dlc as u8, bytes: [0; CAPACITY] })
    }

    /// The same id and data as a CAN FD frame. A remote frame stays what it is: CAN FD has no such frames.
    #[must_use]
    pub const fn with_fd(self, flags: FdFlags) -> Self {
        if self.is_remote() { self } else { Self { format: Format::Fd(flags), ..self } }
    }

    /// The identifier.
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Data bytes; empty for a remote frame.
    pub fn data(&self) -> &[u8] {
        let len = if self.is_remote() { 0 } else { self.dlc as usize };
        self.bytes.get(..len).unwrap_or(&[])
    }

    /// Data bytes carried, 0..=8 (CAN FD up to 64), or requested (remote frame).
    pub const fn dlc(&self) -> usize {
        self.dlc as usize
    }

    /// True for a remote transmission request.
    pub const fn is_remote(&self) -> bool {
        matches!(self.format, Format::Remote)
    }

    /// Flags of a CAN FD frame; `None`: the frame is classical.
    pub const fn fd(&self) -> Option<FdFlags> {
        match self.format {
            Format::Fd(flags) => Some(flags),
            Format::Data | Format::Remote => None,
        }
    }

    /// Length code on the wire, 0..=15: above 8 of a CAN FD frame it stands for 12 to 64 bytes.
    pub fn length_code(&self) -> u8 {
        // Every length of a frame is in the table.
        FD_LENGTHS.iter().position(|len| *len == self.dlc).map_or(0, |code| code as u8)
    }

    /// True for a 29-bit id.
    pub const fn is_extended(&self) -> bool {
        self.id.is_extended()
    }

    /// Bits on the wire without stuff bits, interframe space included: ISO 11898-1 has 47 or 67 around the data, and 62 to 86
    /// in CAN FD. At which rate they go does not count here: see [`crate::bits::Length::time_ns`].
    pub const fn nominal_bits(&self) -> u32 {
        let overhead = match (self.format, self.is_extended()) {
            (Format::Fd(_), extended) => {
                let checksum = if self.dlc <= 16 { 32 } else { 37 };
                checksum + if extended { 49 } else { 30 }
            }
            (_, true) => 67,
            (_, false) => 47,
        };
        overhead + if self.is_remote() { 0 } else { 8 * self.dlc as u32 }
    }

    /// Arbitration field as a number: of the frames that start together, the smallest key wins.
    pub const fn arbitration_key(&self) -> u32 {
        self.id.arbitration_key(self.is_remote())
    }
}

/// `0A5#084F64`, `1000007F#`, `123#R4`, `001##1FFFC` (CAN FD, with its flags): the frame field of a candump log line.
impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}#", self.id)?;
        if let Some(flags) = self.fd() {
            write!(f, "#{}", flags.nibble())?;
        }
        if self.is_remote() {
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

    /// Builds a driver's frame type; `None` if the driver refuses the frame, and of CAN FD, which the trait does not have.
    pub fn to_embedded_can<F: embedded_can::Frame>(&self) -> Option<F> {
        let id = embedded_can::Id::from(self.id);
        match self.format {
            Format::Data => F::new(id, self.data()),
            Format::Remote => F::new_remote(id, self.dlc()),
            Format::Fd(_) => None,
        }
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

    #[test]
    fn can_fd_frames_have_the_lengths_of_the_standard_and_no_others() {
        let taken: Vec<usize> = (0..=80)
            .filter(|len| Frame::new_fd(standard(1), FdFlags::BRS, &[0xA5; 80][..*len]).is_ok())
            .collect();
        let lengths = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];
        assert_eq!(taken, lengths.into_iter().filter(|len| *len <= CAPACITY).collect::<Vec<_>>());
        for (code, len) in (0_u8..).zip(taken) {
            let frame = Frame::new_fd(standard(1), FdFlags::BRS, &[0xA5; 80][..len]).unwrap();
            assert_eq!((frame.length_code(), frame.dlc(), frame.data()), (code, len, &[0xA5; 80][..len]));
        }
        let error = Frame::new_fd(standard(1), FdFlags::BRS, &[0; 9]).unwrap_err();
        assert_eq!(error, FrameError::FdLength { len: 9 });
    }

    #[test]
    fn a_frame_as_can_fd_is_another_frame_and_no_classical_driver_takes_it() {
        let classical = Frame::from_array(standard(1), [0xFF, 0xFC]);
        let fd = classical.with_fd(FdFlags::BRS);
        assert_ne!(fd, classical);
        assert_eq!((fd.fd(), fd.data(), fd.id()), (Some(FdFlags::BRS), classical.data(), classical.id()));
        assert_eq!(fd.to_string(), "001##1FFFC");
        assert_eq!(fd.to_embedded_can::<Frame>(), None);
        let remote = Frame::remote(standard(1), 2).unwrap();
        assert_eq!(remote.with_fd(FdFlags::BRS), remote);
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
