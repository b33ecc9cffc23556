//! Any frame: the fast count of its bits, the walk through them and the definition agree, within the
//! published bounds.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::bits;
use protocol_fuzz::{Input, crc_and_stuff_bits};

fuzz_target!(|bytes: &[u8]| {
    let frame = Input(bytes).frame();
    let (crc, stuff) = crc_and_stuff_bits(&frame);
    let length = bits::length(&frame);
    assert_eq!((bits::crc(&frame), length.stuff), (crc, stuff));
    let walk = bits::Bits::new(&frame);
    assert_eq!(walk.clone().filter(|bit| bit.stuff).count() as u32, stuff);
    assert_eq!(walk.count() as u32, length.frame());
    let (extended, len) = (frame.is_extended(), frame.data().len());
    assert!(length.frame() <= bits::worst_case(extended, len).frame());
    assert_eq!(length.unstuffed, bits::best_case(extended, len).unstuffed);
});
