//! Frames from text, written independently of the crate's own text codec.

pub(crate) mod cyphal_app;
pub(crate) mod cyphal_rig;

use protocol::{Frame, Id, StandardId};

/// `0E5#084F0000803E` with an 11-bit id.
pub(crate) fn frame(text: &str) -> Frame {
    let (id, data) = text.split_once('#').expect("id#data");
    let id = u16::from_str_radix(id, 16).expect("hexadecimal id");
    let data: Vec<u8> = (0..data.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&data[at..at + 2], 16).expect("hexadecimal byte"))
        .collect();
    Frame::new(Id::Standard(StandardId::new(id).expect("11-bit id")), &data).expect("at most eight bytes")
}
