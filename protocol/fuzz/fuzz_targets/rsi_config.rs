//! Any configuration file: it is read or refused with a line of the file, and what is read obeys the bounds.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rsi_protocol::{Config, Source};

fuzz_target!(|text: &str| match Config::parse(text) {
    Ok(config) => {
        assert!(config.port > 0 && config.send.len() <= 128 && config.receive.len() <= 128);
        for entry in &config.receive {
            assert!(!matches!(entry.source, Source::Object(0 | 65..)));
        }
        for places in [config.axis_correction(), config.cartesian_correction()].into_iter().flatten() {
            assert!(places.iter().all(|place| *place < config.receive.len()));
        }
    }
    Err(error) => assert!((1..=text.lines().count() as u32 + 1).contains(&error.line), "{error}"),
});
