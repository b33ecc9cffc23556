//! A frame as the bits that a transmitter puts on the wire, in a form the bit-by-bit gear can index.

use protocol::Frame;
use protocol::bits::{self, Bits, Field};

/// Recessive level; dominant is `false`, so that the bus is the logical AND of all outputs.
pub const RECESSIVE: bool = true;
/// Dominant level: wins over recessive.
pub const DOMINANT: bool = false;

/// The stuffed part of a frame, start of frame to checksum, as sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireBits {
    bits: [u64; 3],
    len: u8,
}

impl WireBits {
    /// Writes out the bits of a frame.
    pub fn new(frame: &Frame) -> Self {
        let mut out = Self { bits: [0; 3], len: 0 };
        for bit in Bits::new(frame).take_while(|bit| bit.field <= Field::Crc) {
            out.bits[usize::from(out.len / 64)] |= u64::from(bit.recessive) << (out.len % 64);
            out.len += 1;
        }
        out
    }

    /// Number of bits, stuff bits included.
    pub const fn len(&self) -> u32 {
        self.len as u32
    }

    /// Never true: a frame has at least 34 bits.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The bit at `index`; recessive beyond the end, as a transmitter leaves the tail to others.
    pub const fn get(&self, index: u32) -> bool {
        if index >= self.len as u32 {
            return RECESSIVE;
        }
        self.bits[(index / 64) as usize] >> (index % 64) & 1 == 1
    }
}

/// Bits from start of frame to the last bit of end of frame, without intermission.
pub fn frame_bits(frame: &Frame) -> u32 {
    bits::length(frame).frame()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use protocol::StandardId;

    proptest! {
        #[test]
        fn counted_length_is_the_number_of_bits_written_out(frame in super::super::parse::any_frame()) {
            prop_assert_eq!(frame_bits(&frame), WireBits::new(&frame).len() + bits::FIXED_FORM);
        }
    }

    #[test]
    fn all_zero_frame_of_id_zero_is_stuffed_as_worked_by_hand() {
        // Start of frame, id, RTR, IDE, r0, DLC and checksum are all dominant: 34 zero bits. The first stuff bit
        // follows bit 5; after it each run of five zeros starts again: after bits 5, 10, 15, 20, 25, 30.
        let expected: String = "00000[1]00000[1]00000[1]00000[1]00000[1]00000[1]0000"
            .chars()
            .filter(|c| "01".contains(*c))
            .collect();
        let frame = Frame::from_array(StandardId::ZERO, []);
        let wire = WireBits::new(&frame);
        let text: String = (0..wire.len()).map(|i| if wire.get(i) { '1' } else { '0' }).collect();
        assert_eq!(text, expected);
        assert_eq!(frame_bits(&frame), 34 + 6 + 10);
        assert!(wire.get(wire.len()) == RECESSIVE);
    }
}
