//! Any stream: lines come out bounded, each is read by both sides without harm, and what is
//! understood is written in a form that is understood the same way. After garbage and one line end,
//! the next line is read.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::text::slcan::{Assembled, Assembler, CR, Command, LINE_MAX, Reply};

fuzz_target!(|stream: &[u8]| {
    let mut assembler = Assembler::new();
    for byte in stream {
        if let Some(Assembled::Line(line)) = assembler.push(*byte) {
            check(line);
        }
    }
    assembler.push(CR);
    for byte in b"t1232AABB" {
        assert_eq!(assembler.push(*byte), None);
    }
    assert_eq!(assembler.push(CR), Some(Assembled::Line(b"t1232AABB")));
});

fn check(line: &[u8]) {
    assert!(line.len() <= LINE_MAX);
    match Command::parse(line) {
        Ok(command) => {
            let text = command.encode();
            assert!(!text.is_truncated());
            let (end, written) = text.as_bytes().split_last().expect("ends with CR");
            assert_eq!((*end, Command::parse(written)), (CR, Ok(command)));
        }
        Err(error) => assert!((1..=line.len() + 1).contains(&error.column)),
    }
    match Reply::parse(line) {
        Ok(reply) => {
            let text = reply.encode();
            let (end, written) = text.as_bytes().split_last().expect("ends with CR");
            assert_eq!(*end, CR);
            // A line of exactly the limit has no room for its end: its text is cut by one byte.
            if line.len() < LINE_MAX {
                assert_eq!(Reply::parse(written), Ok(reply));
            }
        }
        Err(error) => assert!((1..=line.len() + 1).contains(&error.column)),
    }
}
