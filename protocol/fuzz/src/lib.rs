//! What the fuzz targets share: frames from bytes.

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
