//! Uses every codec of `protocol` in both directions, so that a linked program shows what they cost
//! and that no path in them can panic.
//!
//! Whatever comes in goes through `black_box`, so that the optimiser can assume nothing about it, and
//! whatever comes out does too. The program is not meant to do anything useful when it runs.
#![no_std]
#![no_main]

use core::hint::black_box;

use protocol::{ExtendedId, Frame, Id, Instant, StandardId};

#[cfg(any(feature = "cyphal", feature = "cyphal-node"))]
mod cyphal;
#[cfg(feature = "nodes")]
mod nodes;
#[cfg(feature = "powercube")]
mod powercube;
#[cfg(feature = "text")]
mod text;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::bkpt();
    }
}

/// A frame of which nothing is known.
fn any_frame() -> Frame {
    let raw: u32 = black_box(0);
    let id = if black_box(false) {
        Id::Extended(ExtendedId::from_low_bits(raw))
    } else {
        Id::Standard(StandardId::from_low_bits(raw as u16))
    };
    let bytes: [u8; 8] = black_box([0; 8]);
    let len: usize = black_box(0);
    let frame = if black_box(false) {
        Frame::remote(id, len)
    } else {
        Frame::new(id, bytes.get(..len).unwrap_or(&[]))
    };
    frame.unwrap_or(Frame::from_array(id, []))
}

/// Parts of the compiler's runtime that any program has (copying and clearing memory, long division),
/// so that they count as start-up code and not as the part that happens to use them first.
#[inline(never)]
fn runtime() {
    let mut bytes: [u8; 64] = black_box([0; 64]);
    let len: usize = black_box(0);
    for (to, from) in bytes.iter_mut().zip(black_box([1; 64])) {
        *to = from;
    }
    if let Some(head) = bytes.get_mut(len..) {
        head.fill(black_box(0));
    }
    black_box(bytes);
    black_box([0_u64; 64]);
    black_box(black_box([0_u64; 64]));
    black_box(black_box(1_u64) / 1_000_000);
    black_box(black_box(1_f64) as f32);
}

#[cortex_m_rt::entry]
fn main() -> ! {
    #[cfg(any(feature = "cyphal", feature = "cyphal-node"))]
    let mut station = cyphal::Station::new();
    #[cfg(feature = "nodes")]
    let mut nodes = nodes::Nodes::new();
    loop {
        let frame = any_frame();
        let now = Instant::from_micros(black_box(0));
        #[cfg(feature = "powercube")]
        powercube::exercise(&frame);
        #[cfg(any(feature = "cyphal", feature = "cyphal-node"))]
        station.exercise(now, &frame);
        #[cfg(feature = "nodes")]
        nodes.exercise(now, &frame);
        #[cfg(feature = "text")]
        text::exercise(now, &frame);
        #[cfg(feature = "bits")]
        {
            black_box(protocol::bits::length(&frame));
            black_box(protocol::bits::arbitration_length(&frame));
        }
        #[cfg(feature = "planted-panic")]
        black_box([1_u8, 2, 3][black_box(0_usize)]);
        runtime();
        black_box((frame, now));
    }
}
