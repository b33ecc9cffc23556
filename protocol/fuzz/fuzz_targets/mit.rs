//! Any frame on any id: decoders return, and what they understand is written as it was read.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::mit::{Command, MOTORS, MotorId, Register, RegisterAnswer, RegisterRequest, State};
use protocol::StandardId;
use protocol_fuzz::Input;

fuzz_target!(|bytes: &[u8]| {
    let frame = Input(bytes).frame();
    for motor in &MOTORS {
        if let Ok((to, command)) = Command::decode(&frame, &motor.ranges) {
            let (written, _) = command.encode(to, &motor.ranges).expect("what was read is finite");
            assert_eq!(Command::decode(&written, &motor.ranges), Ok((to, command)));
            if !matches!(command, Command::Velocity { .. }) {
                assert_eq!(written, frame);
            }
        }
        let (of, master) = (MotorId::new(1).expect("an id"), StandardId::from_low_bits(0x11));
        if let Some(state) = State::decode(&frame, of, master, &motor.ranges) {
            assert_eq!(state.encode(master, &motor.ranges), frame);
        }
    }
    if let Some((to, request)) = RegisterRequest::decode(&frame) {
        // Bytes without meaning may differ, and a value may be a NaN: frames are compared.
        let written = request.encode(to);
        let (same, again) = RegisterRequest::decode(&written).expect("what was written is understood");
        assert_eq!((same, again.encode(same)), (to, written));
    }
    for register in Register::ALL {
        let (of, master) = (MotorId::new(1).expect("an id"), StandardId::from_low_bits(0x11));
        let asked = RegisterRequest::Read(register);
        if let Some(answer) = RegisterAnswer::decode(&frame, of, master, &asked) {
            assert_eq!(answer.encode(of, master), frame);
        }
    }
});
