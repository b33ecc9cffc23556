//! Any byte stream: every byte is accounted for, memory is bounded, the size of the pieces changes nothing.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rsi_protocol::{Framer, MAX_READ_BYTES, StreamItem};

fn cut(bytes: &[u8], size: usize) -> (Vec<Vec<u8>>, usize, usize) {
    let mut framer = Framer::new();
    let (mut documents, mut dropped) = (Vec::new(), 0);
    for chunk in bytes.chunks(size) {
        for item in framer.push(chunk) {
            match item {
                StreamItem::Document(document) => documents.push(document),
                StreamItem::Dropped(count) => dropped += count,
            }
        }
        assert!(framer.pending() <= MAX_READ_BYTES);
    }
    (documents, dropped, framer.pending())
}

fuzz_target!(|bytes: &[u8]| {
    let whole = cut(bytes, bytes.len().max(1));
    let blank = bytes.iter().filter(|byte| byte.is_ascii_whitespace() || **byte == 0).count();
    let reported = whole.0.iter().map(Vec::len).sum::<usize>() + whole.1 + whole.2;
    assert!(reported <= bytes.len() && bytes.len() <= reported + blank);
    let size = usize::from(bytes.first().copied().unwrap_or(0) % 16) + 1;
    assert_eq!(cut(bytes, size), whole);
});
