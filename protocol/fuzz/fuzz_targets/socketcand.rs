//! Any stream: messages come out bounded and bracketed, each is read by both sides without harm, and
//! what is understood is written in a form that is understood the same way.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::text::socketcand::{Assembled, Assembler, Command, CommandError, MESSAGE_MAX, Message};

fuzz_target!(|stream: &[u8]| {
    let mut assembler = Assembler::new();
    for byte in stream {
        if let Some(Assembled::Message(text)) = assembler.push(*byte) {
            check(text);
        }
    }
    // After any input, a whole message is read.
    let mut last = None;
    for byte in b"< echo >" {
        last = assembler.push(*byte).map(|assembled| assembled == Assembled::Message(b"< echo >"));
    }
    assert_eq!(last, Some(true));
    assert!(assembler.garbage_bytes() <= stream.len() as u64);
});

fn check(text: &[u8]) {
    assert!(text.len() <= MESSAGE_MAX && text.starts_with(b"<") && text.ends_with(b">"));
    match Command::parse(text) {
        Ok(command) => {
            let written = command.encode();
            assert!(!written.is_truncated());
            assert_eq!(Command::parse(written.as_bytes()), Ok(command));
        }
        Err(CommandError::Syntax(error)) => assert!((1..=text.len() + 1).contains(&error.column)),
        Err(CommandError::Unsupported { .. } | CommandError::Unknown) => {}
    }
    if let Ok(message) = Message::parse(text) {
        let written = message.encode();
        assert!(!written.is_truncated());
        // The text of a refusal is cleaned when written; a second pass changes nothing.
        let again = Message::parse(written.as_bytes()).expect("what was written is understood");
        assert_eq!(again.encode().as_bytes(), written.as_bytes());
        if !matches!(message, Message::Refused { .. }) {
            assert_eq!(again, message);
        }
    }
}
