//! Exact length of a CAN frame on the wire, in bits.
//!
//! ```text
//! base      SOF  id 11  RTR IDE r0                    DLC 4  data 8n  CRC 15 | CRC-del ACK ACK-del EOF 7 | IFS 3
//! extended  SOF  id 11  SRR IDE  id 18  RTR r1 r0     DLC 4  data 8n  CRC 15 | CRC-del ACK ACK-del EOF 7 | IFS 3
//!           '------------------- stuffed ---------------------------------'   '---- fixed form ------'
//! ```
//!
//! After five equal bits of the stuffed part the transmitter inserts one of the other value, which counts as the
//! first of the next five. The same holds at the last bit of the CRC. A remote frame has no data, whatever its DLC.
//! The interframe space does not belong to a frame and is counted on its own.
//!
//! CAN FD, with the bits between the bars at the data rate if BRS is recessive:
//!
//! ```text
//! base      SOF  id 11  RRS IDE FDF res BRS |         ESI  DLC 4  data 8n  count 4  CRC 17 or 21 | CRC-del ACK ACK-del EOF 7 | IFS 3
//! extended  SOF  id 11  SRR IDE  id 18  RRS FDF res BRS | ESI  DLC 4  data 8n  count 4  CRC 17 or 21 | CRC-del ACK ACK-del EOF 7 | IFS 3
//!           '------------------- stuffed -------------------------------'  '- fixed stuff bits -'   '---- fixed form ------'
//! ```
//!
//! Up to 16 bytes the CRC has 17 bits, above 21. A fixed stuff bit stands before the stuff count and after every four bits of count
//! and CRC; it also takes the place of a stuff bit after the last data bit.
//!
//! [`length`] takes two table lookups per byte.
//!
//! Source: ISO 11898-1:2015 (Bosch CAN 2.0 part B, sections 3.1 and 5). Bounds: R. I. Davis, A. Burns, R. J.
//! Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted, revisited and
//! revised", Real-Time Systems 35 (2007), equations 1 and 2.

use crate::frame::{FdFlags, Frame, MAX_DATA_LEN};
use crate::id::Id;

/// Bits between two frames in which no node may transmit.
pub const INTERFRAME_SPACE: u32 = 3;

/// CRC delimiter, ACK slot, ACK delimiter and seven bits of end of frame: never stuffed.
pub const FIXED_FORM: u32 = 10;

const CRC_LEN: u32 = 15;

/// Generator of the CRC without its leading term: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
const CRC_POLYNOMIAL: u16 = 0x4599;

/// Equal bits in a row after which one of the other value is inserted.
const STUFF_AFTER: u8 = 5;

/// Length of a frame from SOF to the end of frame, without the interframe space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Length {
    /// Bits before stuffing.
    pub unstuffed: u32,
    /// Inserted bits.
    pub stuff: u32,
    /// Those of both that go at the data rate; 0 of a classical frame.
    pub fast: u32,
}

impl Length {
    /// Bits on the wire, SOF to end of frame.
    pub const fn frame(self) -> u32 {
        self.unstuffed + self.stuff
    }

    /// Bits from one SOF to the earliest next one.
    pub const fn with_interframe_space(self) -> u32 {
        self.frame() + INTERFRAME_SPACE
    }

    /// Bits before the data rate begins.
    pub const fn before_fast(self) -> u32 {
        self.frame() - self.fast - FIXED_FORM
    }

    /// Time from one SOF to the earliest next one, ns, if a bit of the nominal rate lasts `bit_ns` and one of the data rate
    /// `fast_bit_ns`. Saturates.
    pub const fn time_ns(self, bit_ns: u64, fast_bit_ns: u64) -> u64 {
        let nominal = (self.with_interframe_space() - self.fast) as u64;
        nominal.saturating_mul(bit_ns).saturating_add((self.fast as u64).saturating_mul(fast_bit_ns))
    }
}

/// Exact length of `frame`.
pub fn length(frame: &Frame) -> Length {
    if let Some(flags) = frame.fd() {
        return fd_length(frame, flags);
    }
    let sequence = Sequence::of(frame);
    // Alternating bits in front fill up to whole bytes and leave the counter as an idle bus does: recessive, so
    // that SOF starts a new run.
    let padding = if frame.is_extended() { 0b01 } else { 0b01_0101 };
    let padded = padding << sequence.len | sequence.bits;
    let len = sequence.len.next_multiple_of(8);
    let left_aligned = padded << (u128::BITS - len);
    let mut state = STATE_AFTER_RECESSIVE;
    let mut stuff = 0;
    for byte in left_aligned.to_be_bytes().into_iter().take(len as usize / 8) {
        let step = stuff_step(state, byte);
        stuff += u32::from(step >> 3);
        state = step & 7;
    }
    Length { unstuffed: sequence.len + FIXED_FORM, stuff, fast: 0 }
}

fn fd_length(frame: &Frame, flags: FdFlags) -> Length {
    let control = u64::from(flags.esi) << 4 | u64::from(frame.length_code());
    let (header, len) = match frame.id() {
        // FDF and BRS are recessive, RRS, IDE and res dominant.
        Id::Standard(id) => (u64::from(id.get()) << 5 | 0b100, FD_BASE_HEADER),
        // SRR and IDE are recessive, too.
        Id::Extended(id) => {
            let (base, low) = (u64::from(id.get() >> 18), u64::from(id.get() & 0x3_FFFF));
            (base << 24 | 0b11 << 22 | low << 4 | 0b100, FD_EXTENDED_HEADER)
        }
    };
    let header = header | u64::from(flags.brs);
    let (mut state, mut stuff) = (STATE_AFTER_RECESSIVE, 0);
    let mut take = |bits: u64, len: u32| {
        for place in (0..len).rev() {
            let (stuffed, next) = stuff_bit(state, bits >> place & 1 != 0);
            stuff += u32::from(stuffed);
            state = next;
        }
        stuff
    };
    let before = take(header, len);
    take(control, FD_CONTROL);
    let mut last = control & 1 != 0;
    for byte in frame.data() {
        let step = stuff_step(state, *byte);
        stuff += u32::from(step >> 3);
        (state, last) = (step & 7, byte & 1 != 0);
    }
    // The fixed stuff bit stands where a last one would.
    stuff -= u32::from((state & 4 != 0) != last);
    let data_phase = fd_data_phase(frame.dlc());
    let fast = if flags.brs { data_phase + stuff - before } else { 0 };
    Length { unstuffed: len + data_phase + FIXED_FORM, stuff, fast }
}

/// SOF to BRS of CAN FD.
const FD_BASE_HEADER: u32 = 17;
/// The same with an id of 29 bits.
const FD_EXTENDED_HEADER: u32 = 36;
/// ESI and length code.
const FD_CONTROL: u32 = 5;

/// ESI to CRC of CAN FD, fixed stuff bits included, others not.
const fn fd_data_phase(data_len: usize) -> u32 {
    FD_CONTROL + 8 * data_len as u32 + if data_len <= 16 { 27 } else { 32 }
}

/// Upper bound of a CAN FD frame with `data_len` data bytes, at most 64: every fourth bit stuffed after the first five, which
/// no frame reaches.
pub const fn fd_worst_case(extended: bool, brs: bool, data_len: usize) -> Length {
    let best = fd_best_case(extended, brs, data_len);
    let before = (if extended { FD_EXTENDED_HEADER } else { FD_BASE_HEADER } - 1) / 4;
    let behind = (FD_CONTROL + 8 * data_len as u32) / 4;
    let fast = if brs { best.fast + behind } else { 0 };
    Length { unstuffed: best.unstuffed, stuff: before + behind, fast }
}

/// Lower bound of a CAN FD frame with `data_len` data bytes, at most 64: no stuff bit but the fixed ones.
pub const fn fd_best_case(extended: bool, brs: bool, data_len: usize) -> Length {
    let data_phase = fd_data_phase(data_len);
    let header = if extended { FD_EXTENDED_HEADER } else { FD_BASE_HEADER };
    Length { unstuffed: header + data_phase + FIXED_FORM, stuff: 0, fast: if brs { data_phase } else { 0 } }
}

/// Upper bound for any classical frame of this format with `data_len` data bytes (0 for a remote frame; more
/// than eight count as eight).
///
/// Every fourth bit stuffed after the first five: with the interframe space the 47 + 8n + (34 + 8n -
/// 1)/4 and 67 + 8n + (54 + 8n - 1)/4 of Davis et al. Frames that reach it need not exist: the fixed
/// bits of the control field and the CRC are not free.
pub const fn worst_case(extended: bool, data_len: usize) -> Length {
    let stuffed_part = stuffed_part(extended, data_len);
    Length { unstuffed: stuffed_part + FIXED_FORM, stuff: (stuffed_part - 1) / 4, fast: 0 }
}

/// Lower bound for any classical frame of this format with `data_len` data bytes (0 for a remote frame; more
/// than eight count as eight): no stuff bit at all.
///
/// Reached with some ids for most lengths; not by base format data frames of 0 to 3 bytes, whose RTR,
/// IDE, r0 and leading DLC bits are five or more dominant ones in a row.
pub const fn best_case(extended: bool, data_len: usize) -> Length {
    Length { unstuffed: stuffed_part(extended, data_len) + FIXED_FORM, stuff: 0, fast: 0 }
}

/// SOF to CRC, before stuffing.
const fn stuffed_part(extended: bool, data_len: usize) -> u32 {
    let len = if data_len < MAX_DATA_LEN { data_len as u32 } else { MAX_DATA_LEN as u32 };
    let header = if extended { EXTENDED_HEADER } else { BASE_HEADER };
    header + 8 * len + CRC_LEN
}

/// The 15-bit CRC that a classical `frame` carries.
pub fn crc(frame: &Frame) -> u16 {
    let (header, _) = header(frame);
    // The register starts at zero, so leading zeros change nothing and the header can be taken in
    // whole bytes.
    let mut crc = 0;
    for byte in header.to_be_bytes().into_iter().skip(if frame.is_extended() { 3 } else { 5 }) {
        crc = crc_step(crc, byte);
    }
    for byte in frame.data() {
        crc = crc_step(crc, *byte);
    }
    crc
}

/// SOF to DLC, base format.
const BASE_HEADER: u32 = 19;
/// SOF to DLC, extended format.
const EXTENDED_HEADER: u32 = 39;

/// SOF to DLC as a number, and its length in bits.
fn header(frame: &Frame) -> (u64, u32) {
    let rtr = u64::from(frame.is_remote());
    let dlc = frame.dlc() as u64;
    match frame.id() {
        Id::Standard(id) => (u64::from(id.get()) << 7 | rtr << 6 | dlc, BASE_HEADER),
        Id::Extended(id) => {
            let (base, low) = (u64::from(id.get() >> 18), u64::from(id.get() & 0x3_FFFF));
            // SRR and IDE are recessive, r1 and r0 dominant.
            (base << 27 | 0b11 << 25 | low << 7 | rtr << 6 | dlc, EXTENDED_HEADER)
        }
    }
}

/// SOF to CRC before stuffing, right aligned: at most 118 bits.
struct Sequence {
    bits: u128,
    len: u32,
}

impl Sequence {
    fn of(frame: &Frame) -> Self {
        let (header, mut len) = header(frame);
        let mut bits = u128::from(header);
        for byte in frame.data() {
            bits = bits << 8 | u128::from(*byte);
            len += 8;
        }
        Self { bits: bits << CRC_LEN | u128::from(crc(frame)), len: len + CRC_LEN }
    }
}

fn crc_step(crc: u16, byte: u8) -> u16 {
    const TABLE: [u16; 256] = crc_table();
    let index = (crc >> 7) as u8 ^ byte;
    // A table of 256 has a place for every byte, so the fallback is never taken.
    (crc << 8 ^ TABLE.get(usize::from(index)).copied().unwrap_or(0)) & 0x7FFF
}

const fn crc_table() -> [u16; 256] {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u16) << 7;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x4000 == 0 { crc << 1 } else { crc << 1 ^ CRC_POLYNOMIAL };
            bit += 1;
        }
        // `byte` is below the length of the table.
        #[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
        {
            table[byte] = crc & 0x7FFF;
        }
        byte += 1;
    }
    table
}

/// Stuffing as a state machine: value of the last bit (bit 2), and how many of it are in a row less
/// one (bits 1 and 0). Five in a row are no state: the inserted bit makes it one of the other value.
const STATE_AFTER_RECESSIVE: u8 = 0b100;

/// Inserted bits within `byte` (upper five bits) and the state behind it (lower three).
fn stuff_step(state: u8, byte: u8) -> u8 {
    const TABLE: [u8; 2048] = stuff_table();
    let index = usize::from(state & 7) << 8 | usize::from(byte);
    // Eleven bits of index, 2048 places: the fallback is never taken.
    TABLE.get(index).copied().unwrap_or(0)
}

/// Whether a bit is inserted behind `bit`, and the state behind both.
const fn stuff_bit(state: u8, bit: bool) -> (bool, u8) {
    let bit = bit as u8;
    let run = if bit == state >> 2 & 1 { (state & 3) + 2 } else { 1 };
    if run == STUFF_AFTER { (true, (1 - bit) << 2) } else { (false, bit << 2 | (run - 1)) }
}

const fn stuff_table() -> [u8; 2048] {
    let mut table = [0; 2048];
    let mut index = 0;
    while index < 2048 {
        let mut state = (index >> 8) as u8;
        let mut inserted = 0;
        let mut place = 8;
        while place > 0 {
            place -= 1;
            let (stuffed, next) = stuff_bit(state, index >> place & 1 != 0);
            inserted += stuffed as u8;
            state = next;
        }
        #[expect(clippy::indexing_slicing, reason = "evaluated by the compiler only")]
        {
            table[index] = inserted << 3 | state;
        }
        index += 1;
    }
    table
}

#[cfg(test)]
mod tests;
