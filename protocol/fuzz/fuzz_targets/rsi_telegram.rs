//! Any document: the readers return, and what is understood is written in a form that is understood the same way.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rsi_protocol::{Config, RobotState, Root, Telegram, WriteError, read_answer};
use std::sync::LazyLock;

static CONFIG: LazyLock<Config> = LazyLock::new(|| {
    Config::parse(include_str!("../../rsi/tests/data/axis_absolute.xml")).expect("the file is valid")
});

fuzz_target!(|bytes: &[u8]| {
    for root in [Root::Rob, Root::Sen] {
        let Ok(telegram) = Telegram::parse(bytes, root) else { continue };
        let _ = RobotState::read(&telegram);
        if let Ok(values) = read_answer(&telegram, &CONFIG) {
            assert!(values.iter().flatten().all(|value| value.number().is_none_or(f64::is_finite)));
        }
        match telegram.write() {
            Ok(written) => assert_eq!(Telegram::parse(&written, root), Ok(telegram)),
            // Names with letters that are not ASCII are read and not written.
            Err(WriteError::TooLong { .. } | WriteError::NotXml { .. }) => {}
            Err(other) => panic!("{other}"),
        }
    }
});
