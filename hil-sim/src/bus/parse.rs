//! A receiver's view of a frame: sampled bits in, fields and verdicts out.

use protocol::{ExtendedId, Frame, Id, StandardId};

use super::encode::RECESSIVE;

/// Generator of the checksum without its leading term: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CRC15: u16 = 0x4599;

/// Takes one more bit into the checksum register.
const fn crc_step(crc: u16, bit: bool) -> u16 {
    let feedback = (crc >> 14 & 1) ^ bit as u16;
    let shifted = (crc << 1) & 0x7FFF;
    if feedback == 1 { shifted ^ CRC15 } else { shifted }
}

/// Index (before stuffing, start of frame is 0) of the RTR bit of the base format, SRR of the extended.
const INDEX_RTR: u16 = 12;
/// Index of the IDE bit.
const INDEX_IDE: u16 = 13;
/// Index of the RTR bit of the extended format.
const INDEX_RTR_EXTENDED: u16 = 32;

/// What one more sampled bit meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A bit inside the stuffed part; more follow.
    More,
    /// The last bit of the stuffed part: next comes the CRC delimiter.
    Complete,
    /// Sixth equal bit: the stuffing rule is broken.
    StuffError,
}

/// Reader of the stuffed part of a frame, start of frame to checksum.
#[derive(Clone, Debug)]
pub struct Parser {
    /// Unstuffed bits so far, first bit highest.
    word: u128,
    /// Number of unstuffed bits so far.
    count: u16,
    /// Number of unstuffed bits in all; unknown (maximum) until the DLC is read.
    end: u16,
    /// Header length, 19 or 39; unknown (maximum) until IDE is read.
    header: u16,
    crc: u16,
    last: bool,
    run: u8,
}

impl Parser {
    /// A reader that has seen the (dominant) start of frame.
    pub fn after_start_of_frame() -> Self {
        Self { word: 0, count: 1, end: u16::MAX, header: u16::MAX, crc: 0, last: false, run: 1 }
    }

    /// True if the next bit must be a stuff bit.
    pub fn expects_stuff_bit(&self) -> bool {
        self.run == 5
    }

    /// True if the next bit belongs to the arbitration field of a frame in the given format; for a
    /// stuff bit: if it lies before the RTR bit (rule 3, exception 2).
    pub fn in_arbitration(&self, extended: bool) -> bool {
        self.count <= if extended { INDEX_RTR_EXTENDED } else { INDEX_RTR }
    }

    /// Takes one sampled bit.
    pub fn accept(&mut self, bit: bool) -> Step {
        if self.run == 5 {
            if bit == self.last {
                return Step::StuffError;
            }
            self.last = bit;
            self.run = 1;
            return if self.count == self.end { Step::Complete } else { Step::More };
        }
        self.run = if bit == self.last { self.run + 1 } else { 1 };
        self.last = bit;
        self.word = self.word << 1 | u128::from(bit);
        self.crc = crc_step(self.crc, bit);
        if self.count == INDEX_IDE {
            self.header = if bit == RECESSIVE { 39 } else { 19 };
        }
        self.count += 1;
        if self.count == self.header {
            self.end = self.header + 8 * self.data_len() + 15;
        }
        if self.count == self.end && self.run < 5 { Step::Complete } else { Step::More }
    }

    fn is_extended(&self) -> bool {
        self.header == 39
    }

    /// The bit of unstuffed index `index`, which must be below `count`.
    fn bit(&self, index: u16) -> bool {
        self.word >> (self.count - 1 - index) & 1 == 1
    }

    fn is_remote(&self) -> bool {
        self.bit(if self.is_extended() { INDEX_RTR_EXTENDED } else { INDEX_RTR })
    }

    fn dlc(&self) -> u16 {
        let raw = (self.word >> (self.count - self.header)) as u16 & 0xF;
        // ISO 11898-1: 9..=15 mean eight bytes.
        raw.min(8)
    }

    fn data_len(&self) -> u16 {
        if self.is_remote() { 0 } else { self.dlc() }
    }

    /// True if the checksum matched; meaningful after [`Step::Complete`].
    pub fn checksum_ok(&self) -> bool {
        // Running the received checksum through the register leaves zero.
        self.crc == 0
    }

    /// The frame; `None` before [`Step::Complete`].
    pub fn frame(&self) -> Option<Frame> {
        if self.count != self.end {
            return None;
        }
        let field = |from: u16, len: u16| {
            (self.word >> (self.count - from - len)) as u32 & (u32::MAX >> (32 - u32::from(len)))
        };
        let base = field(1, 11);
        let id = if self.is_extended() {
            Id::Extended(ExtendedId::from_low_bits(base << 18 | field(14, 18)))
        } else {
            Id::Standard(StandardId::from_low_bits(base as u16))
        };
        if self.is_remote() {
            return Frame::remote(id, usize::from(self.dlc())).ok();
        }
        let mut bytes = [0; 8];
        for (index, byte) in (0..self.data_len()).zip(&mut bytes) {
            *byte = field(self.header + 8 * index, 8) as u8;
        }
        Frame::new(id, &bytes[..usize::from(self.data_len())]).ok()
    }
}

/// Any classical frame, for property tests of the bus.
#[cfg(test)]
pub(crate) fn any_frame() -> impl proptest::strategy::Strategy<Value = Frame> {
    use proptest::prelude::*;
    (any::<u32>(), any::<bool>(), any::<bool>(), proptest::collection::vec(any::<u8>(), 0..=8)).prop_map(
        |(raw, extended, remote, data)| {
            let id = if extended {
                Id::Extended(ExtendedId::from_low_bits(raw))
            } else {
                Id::Standard(StandardId::from_low_bits(raw as u16))
            };
            if remote { Frame::remote(id, data.len()) } else { Frame::new(id, &data) }.unwrap()
        },
    )
}

#[cfg(test)]
mod tests {
    use super::super::encode::WireBits;
    use super::*;
    use proptest::prelude::*;

    fn read(bits: &WireBits, flip: Option<u32>) -> (Parser, Step) {
        let mut parser = Parser::after_start_of_frame();
        let mut step = Step::More;
        for i in 1..bits.len() {
            step = parser.accept(bits.get(i) ^ (Some(i) == flip));
            if step == Step::StuffError {
                break;
            }
        }
        (parser, step)
    }

    proptest! {
        #[test]
        fn every_frame_is_read_back_from_its_bits(frame in any_frame()) {
            let (parser, step) = read(&WireBits::new(&frame), None);
            prop_assert_eq!(step, Step::Complete);
            prop_assert!(parser.checksum_ok());
            prop_assert_eq!(parser.frame(), Some(frame));
        }

        #[test]
        fn one_flipped_bit_is_never_taken_for_a_good_frame(frame in any_frame(), at: prop::sample::Index) {
            let bits = WireBits::new(&frame);
            let flip = 1 + at.index(bits.len() as usize - 1) as u32;
            let (parser, step) = read(&bits, Some(flip));
            // Stuff error, wrong checksum, or a length that no longer ends here.
            prop_assert!(step != Step::Complete || !parser.checksum_ok());
        }
    }
}
