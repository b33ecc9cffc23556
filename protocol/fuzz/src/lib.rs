//! What the fuzz targets share: frames from bytes, and the definition of a frame's bits.

use protocol::{ExtendedId, Frame, Id, StandardId};

/// Takes values off the head of the input; missing bytes are zero.
pub struct Input<'a>(pub &'a [u8]);

impl<'a> Input<'a> {
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    pub fn u32(&mut self) -> u32 {
        u32::from(self.u16()) | u32::from(self.u16()) << 16
    }

    pub fn take(&mut self, len: usize) -> &'a [u8] {
        let (head, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        head
    }

    /// Kind and length in one byte, two or four bytes of id, data. Seeds are written in this form.
    pub fn frame(&mut self) -> Frame {
        let kind = self.byte();
        let len = usize::from(kind & 0x0F).min(8);
        let id = if kind & 0x80 != 0 {
            Id::Extended(ExtendedId::from_low_bits(self.u32()))
        } else {
            Id::Standard(StandardId::from_low_bits(self.u16()))
        };
        let frame = if kind & 0x40 != 0 { Frame::remote(id, len) } else { Frame::new(id, self.take(len)) };
        frame.expect("at most eight bytes")
    }
}

/// CRC and stuff bits of a frame by the words of the standard, one bit after the other.
pub fn crc_and_stuff_bits(frame: &Frame) -> (u16, u32) {
    let mut bits = vec![false];
    let mut push = |value: u32, len: u32| bits.extend((0..len).rev().map(|place| value >> place & 1 == 1));
    let raw = frame.id().raw();
    if frame.is_extended() {
        push(raw >> 18, 11);
        push(0b11, 2);
        push(raw & 0x3_FFFF, 18);
    } else {
        push(raw, 11);
    }
    push(u32::from(frame.is_remote()), 1);
    push(0, 2);
    push(frame.dlc() as u32, 4);
    frame.data().iter().for_each(|byte| push(u32::from(*byte), 8));
    let crc = bits.iter().fold(0_u16, |crc, bit| {
        let feedback = bit ^ (crc & 0x4000 != 0);
        (crc << 1 & 0x7FFF) ^ if feedback { 0x4599 } else { 0 }
    });
    bits.extend((0..15).rev().map(|place| crc >> place & 1 == 1));
    let (mut last, mut run, mut stuff) = (true, 0, 0);
    for bit in bits {
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            stuff += 1;
            last = !bit;
            run = 1;
        }
    }
    (crc, stuff)
}
