//! A frame as the bits that a transmitter puts on the wire.

use protocol::{Frame, Id};

/// Recessive level; dominant is `false`, so that the bus is the logical AND of all outputs.
pub const RECESSIVE: bool = true;
/// Dominant level: wins over recessive.
pub const DOMINANT: bool = false;

/// Bits after the stuffed part: CRC delimiter, ACK slot, ACK delimiter, seven bits of end of frame.
pub const TAIL_BITS: u32 = 10;
/// Bits of intermission between two frames.
pub const INTERMISSION_BITS: u32 = 3;
/// Most bits from start of frame to the end of the checksum, stuff bits included: an extended frame of
/// eight bytes has 118 bits before stuffing, and one stuff bit per four of them after the first.
pub const STUFFED_BITS_MAX: u32 = 118 + (118 - 1) / 4;

/// Generator x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1 without its leading term.
const CRC15: u16 = 0x4599;

/// Takes one more bit into the checksum register.
pub(super) const fn crc_step(crc: u16, bit: bool) -> u16 {
    let feedback = (crc >> 14 & 1) ^ bit as u16;
    let shifted = (crc << 1) & 0x7FFF;
    if feedback == 1 { shifted ^ CRC15 } else { shifted }
}

/// Start of frame to the last data bit before stuffing, left to right in the low `len` bits.
pub(super) fn header_and_data(frame: &Frame) -> (u128, u32) {
    let rtr = u128::from(frame.is_remote());
    let dlc = frame.dlc() as u128;
    // Dominant is 0: start of frame, IDE of the base format and the reserved bits add nothing.
    let (mut word, mut len) = match frame.id() {
        Id::Standard(id) => ((u128::from(id.get()) << 1 | rtr) << 6 | dlc, 19),
        Id::Extended(id) => {
            let (high, low) = (u128::from(id.get() >> 18), u128::from(id.get() & 0x3_FFFF));
            // SRR and IDE are both recessive.
            ((((high << 2 | 0b11) << 18 | low) << 1 | rtr) << 6 | dlc, 39)
        }
    };
    for byte in frame.data() {
        word = word << 8 | u128::from(*byte);
        len += 8;
    }
    (word, len)
}

/// The stuffed part of a frame, start of frame to checksum, as sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WireBits {
    bits: [u64; 3],
    len: u8,
}

impl WireBits {
    /// Encodes: fields, checksum, one complementary bit after every five equal ones.
    ///
    /// A run of five that ends with the last checksum bit gets its stuff bit too, before the delimiter.
    pub fn new(frame: &Frame) -> Self {
        let (word, len) = header_and_data(frame);
        let mut crc = 0;
        for i in (0..len).rev() {
            crc = crc_step(crc, word >> i & 1 == 1);
        }
        let (word, len) = (word << 15 | u128::from(crc), len + 15);
        let mut out = Self { bits: [0; 3], len: 0 };
        let (mut last, mut run) = (RECESSIVE, 0);
        for i in (0..len).rev() {
            let bit = word >> i & 1 == 1;
            out.push(bit);
            run = if bit == last { run + 1 } else { 1 };
            last = bit;
            if run == 5 {
                out.push(!bit);
                last = !bit;
                run = 1;
            }
        }
        out
    }

    fn push(&mut self, bit: bool) {
        self.bits[usize::from(self.len / 64)] |= u64::from(bit) << (self.len % 64);
        self.len += 1;
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
    WireBits::new(frame).len() + TAIL_BITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::{ExtendedId, StandardId};

    fn standard(id: u16, data: &[u8]) -> Frame {
        Frame::new(StandardId::new(id).unwrap(), data).unwrap()
    }

    fn text(frame: &Frame) -> String {
        let bits = WireBits::new(frame);
        (0..bits.len()).map(|i| if bits.get(i) { '1' } else { '0' }).collect()
    }

    /// Every bit written out by hand, the stuff bits in brackets for the reader.
    fn by_hand(bits: &str) -> String {
        bits.chars().filter(|c| "01".contains(*c)).collect()
    }

    #[test]
    fn all_zero_frame_of_id_zero_is_stuffed_after_every_fourth_bit_as_worked_by_hand() {
        // SOF, id, RTR, IDE, r0, DLC and checksum are all dominant: 34 zero bits. The first stuff bit
        // follows bit 5; after it each run of five zeros starts anew: after bits 5, 10, 15, 20, 25, 30.
        let expected = by_hand("00000[1]00000[1]00000[1]00000[1]00000[1]00000[1]0000");
        assert_eq!(text(&standard(0, &[])), expected);
        assert_eq!(frame_bits(&standard(0, &[])), 34 + 6 + 10);
    }

    #[test]
    fn base_frame_with_one_byte_is_as_worked_by_hand() {
        // id 0x14 = 00000010100, DLC 1, data 0x01; checksum by long division of the message times
        // x^15 by the generator, stuffing by looking at the end of the text.
        let frame = standard(0x14, &[0x01]);
        let message: u64 = 0x14 << 15 | 1 << 8 | 0x01;
        let generator: u64 = 0xC599;
        let mut rest = message << 15;
        for shift in (0..=27).rev() {
            if rest >> (shift + 15) & 1 == 1 {
                rest ^= generator << shift;
            }
        }
        let unstuffed = format!("{message:027b}{rest:015b}");
        let mut stuffed = String::new();
        for bit in unstuffed.chars() {
            stuffed.push(bit);
            for (run, other) in [("00000", '1'), ("11111", '0')] {
                if stuffed.ends_with(run) {
                    stuffed.push(other);
                    break;
                }
            }
        }
        assert_eq!(text(&frame), stuffed);
    }

    #[test]
    fn longest_frames_stay_below_the_published_bounds() {
        // Worst cases of the response-time literature (Davis et al. 2007): 135 bits for 11-bit and 160 for 29-bit
        // ids with eight bytes, three bits of intermission included.
        let zero = frame_bits(&standard(0, &[0; 8])) + INTERMISSION_BITS;
        assert!((125..=135).contains(&zero), "{zero}");
        let id = ExtendedId::new(0).unwrap();
        let extended = frame_bits(&Frame::new(id, &[0; 8]).unwrap()) + INTERMISSION_BITS;
        assert!((145..=160).contains(&extended), "{extended}");
        assert_eq!(STUFFED_BITS_MAX, 147);
    }

    #[test]
    fn alternating_bits_need_no_stuffing() {
        // 0x555 and 0x55 alternate; only DLC 8 = 1000 and the checksum can add runs.
        let frame = standard(0x555, &[0x55; 8]);
        let (word, len) = header_and_data(&frame);
        assert_eq!(len, 83);
        assert_eq!(word & 0xFFFF, 0x5555);
        assert!(WireBits::new(&frame).len() - 98 <= 3);
    }

    #[test]
    fn remote_frame_carries_its_dlc_and_no_data() {
        let frame = Frame::remote(StandardId::new(0x123).unwrap(), 8).unwrap();
        let (word, len) = header_and_data(&frame);
        assert_eq!((word, len), (0x123 << 7 | 1 << 6 | 8, 19));
        let id = ExtendedId::new(0x1ABC_DEF5).unwrap();
        let (word, len) = header_and_data(&Frame::remote(id, 2).unwrap());
        let (base, rest) = (0x1ABC_DEF5_u128 >> 18, 0x1ABC_DEF5_u128 & 0x3_FFFF);
        assert_eq!((word, len), (base << 27 | 0b11 << 25 | rest << 7 | 1 << 6 | 2, 39));
    }
}
