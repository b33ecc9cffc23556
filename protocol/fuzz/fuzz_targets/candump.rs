//! Any line: the parser returns, errors point into the line, and a line that is understood is written in a form
//! that is read as the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::text::candump::{ParseError, Record};

fuzz_target!(|line: &[u8]| match Record::parse(line) {
    Ok(record) => {
        let text = record.encode();
        assert!(!text.is_truncated());
        assert_eq!(Record::parse(text.as_bytes()), Ok(record));
    }
    Err(ParseError::Syntax(error)) => {
        assert!((1..=line.len() + 1).contains(&error.column));
        assert_eq!(error.found, line.get(error.column - 1).copied());
    }
    Err(ParseError::NotADataFrame { class, .. }) => assert!(class < 1 << 29),
});
