//! Emergencies (CiA 301, 7.2.7; codes of drives: CiA 402).

use crate::Frame;

use super::id::{Function, NodeId};

/// What a node reports when an error comes or goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// Error code; 0: all errors are gone.
    pub code: u16,
    /// Error register (object 1001).
    pub register: u8,
    /// What the maker adds.
    pub maker: [u8; 5],
}

impl Emergency {
    /// The frame of `node`.
    #[must_use]
    pub fn encode(&self, node: NodeId) -> Frame {
        let ([low, high], [a, b, c, d, e]) = (self.code.to_le_bytes(), self.maker);
        Function::Emergency(node).frame([low, high, self.register, a, b, c, d, e])
    }

    /// The node and its emergency. Shorter frames are refused: the meaning of their bytes is not standardised.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(NodeId, Self)> {
        let Function::Emergency(node) = Function::of_frame(from)? else { return None };
        let [low, high, register, maker @ ..] = *from.data().first_chunk::<8>()?;
        Some((node, Self { code: u16::from_le_bytes([low, high]), register, maker }))
    }

    /// What the code means, as far as its class is standard.
    #[must_use]
    pub const fn meaning(&self) -> &'static str {
        match self.code {
            0x0000 => "errors are gone",
            0x2310 => "continuous over-current",
            0x2000..=0x2FFF => "current",
            0x3210 => "supply above its limit",
            0x3220 => "supply below its limit",
            0x3000..=0x3FFF => "voltage",
            0x4000..=0x4FFF => "temperature",
            0x5000..=0x5FFF => "hardware of the drive",
            0x6000..=0x6FFF => "software of the drive",
            0x7305 => "encoder",
            0x7000..=0x7FFF => "additional module",
            0x8110 => "frames were lost: overrun",
            0x8120 => "error passive",
            0x8130 => "a heartbeat stayed away",
            0x8140 => "back from bus-off",
            0x8210 | 0x8220 => "a PDO of another length",
            0x8250 => "an RPDO stayed away",
            0x8611 => "following error",
            0x8000..=0x8FFF => "monitoring",
            _ => "of the maker",
        }
    }
}
