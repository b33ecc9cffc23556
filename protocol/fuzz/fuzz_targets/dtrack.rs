//! Any datagram and any message of the command channel: what is understood is written and understood the same way.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tracker_protocol::dtrack::{Answer, Command, DataFrame, DayClock, Messages};

fuzz_target!(|bytes: &[u8]| {
    if let Ok(frame) = DataFrame::parse(bytes) {
        // At the resolution of the wire: the second writing repeats the first.
        let written = frame.write();
        let again = DataFrame::parse(&written).expect("what is written is read");
        assert_eq!(again.write(), written);
        let mut clock = DayClock::new();
        for body in frame.bodies.iter().flatten() {
            if let Ok(Some(pose)) = frame.pose(body.id, &mut clock) {
                assert!(pose.rotation_wxyz.iter().all(|x| x.is_finite()));
            }
        }
    }
    for message in Messages::default().push(bytes).into_iter().flatten() {
        if let Some(command) = Command::parse(&message) {
            assert_eq!(Command::parse(&command.to_string()), Some(command));
        }
        if let Some(answer) = Answer::parse(&message) {
            assert_eq!(Answer::parse(&answer.to_string()), Some(answer));
        }
    }
});
