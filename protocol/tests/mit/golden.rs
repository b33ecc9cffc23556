//! Frames that the public client `damiao-motor` 1.0.6 sends, and what they mean.

use protocol::mit::{
    Clipped, Command, CommandError, MOTORS, Mit, MotorId, Ranges, Register, RegisterAnswer, RegisterRequest,
    RegisterValue, State, Status,
};
use protocol::{Frame, Id, StandardId};

pub(crate) fn ranges_of(name: &str) -> Ranges {
    MOTORS.iter().find(|motor| motor.name == name).unwrap().ranges
}

pub(crate) fn id(n: u8) -> MotorId {
    MotorId::new(n).unwrap()
}

pub(crate) fn master(id: u16) -> StandardId {
    StandardId::new(id).unwrap()
}

fn frame(id: u16, data: [u8; 8]) -> Frame {
    Frame::from_array(Id::Standard(StandardId::new(id).unwrap()), data)
}

#[test]
fn set_point_of_the_public_client_is_ours_but_for_its_truncation() {
    let mit = Mit { p_rad: 1.0, v_rad_s: 2.0, kp_nm_rad: 100.0, kd_nm_s_rad: 2.0, t_nm: 3.0 };
    let (ours, clipped) = Command::Mit(mit).encode(id(1), &ranges_of("8009")).unwrap();
    assert_eq!(clipped, Clipped::default());
    // The client truncates position to 8A3C and velocity to 85A; 2138.5 lies between 85A and 85B.
    assert_eq!(ours, frame(1, [0x8A, 0x3D, 0x85, 0xB3, 0x33, 0x66, 0x68, 0x71]));
    let theirs = frame(1, [0x8A, 0x3C, 0x85, 0xA3, 0x33, 0x66, 0x68, 0x71]);
    let (motor, Command::Mit(read)) = Command::decode(&theirs, &ranges_of("8009")).unwrap() else {
        panic!("a set point")
    };
    assert_eq!(motor, id(1));
    for (read, sent, step) in [
        (read.p_rad, 1.0, 25.0 / 65535.0),
        (read.v_rad_s, 2.0, 90.0 / 4095.0),
        (read.kp_nm_rad, 100.0, 500.0 / 4095.0),
        (read.kd_nm_s_rad, 2.0, 5.0 / 4095.0),
        (read.t_nm, 3.0, 108.0 / 4095.0),
    ] {
        assert!((read - sent).abs() <= step, "{read} {sent}");
    }
}

#[test]
fn frames_and_what_they_mean() {
    let ranges = ranges_of("4310");
    for (sent, on) in [
        (Command::Enable, frame(3, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC])),
        (Command::Disable, frame(3, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFD])),
        (Command::ZeroHere, frame(3, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFE])),
        (Command::ClearFault, frame(3, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFB])),
        (
            Command::PositionVelocity { p_rad: 1.0, v_max_rad_s: -2.0 },
            frame(0x103, [0, 0, 0x80, 0x3F, 0, 0, 0, 0xC0]),
        ),
        (Command::Velocity { v_rad_s: 1.0 }, frame(0x203, [0, 0, 0x80, 0x3F, 0, 0, 0, 0])),
        (
            Command::PositionForce { p_rad: 1.0, v_max_centirad_s: 300, current_share: 10_000 },
            frame(0x303, [0, 0, 0x80, 0x3F, 0x2C, 0x01, 0x10, 0x27]),
        ),
    ] {
        assert_eq!(sent.encode(id(3), &ranges), Ok((on, Clipped::default())));
        assert_eq!(Command::decode(&on, &ranges), Ok((id(3), sent)));
    }
    // As `openarm_can` sends it.
    let short = Frame::new(Id::Standard(StandardId::new(0x203).unwrap()), &[0, 0, 0x80, 0x3F]).unwrap();
    assert_eq!(Command::decode(&short, &ranges), Ok((id(3), Command::Velocity { v_rad_s: 1.0 })));
    let short = Frame::new(Id::Standard(StandardId::new(0x103).unwrap()), &[0, 0, 0x80, 0x3F]).unwrap();
    assert_eq!(Command::decode(&short, &ranges), Err(CommandError::NotForAMotor));
    for (sent, on) in [
        // Time-out of 100 ms; which mode?
        (
            RegisterRequest::Write(Register::TimeOut, RegisterValue::Whole(2000)),
            [1, 0, 0x55, 9, 0xD0, 0x07, 0, 0],
        ),
        (RegisterRequest::Read(Register::Mode), [1, 0, 0x33, 0x0A, 0, 0, 0, 0]),
        (RegisterRequest::State, [1, 0, 0xCC, 0, 0, 0, 0, 0]),
        (RegisterRequest::Store, [1, 0, 0xAA, 1, 0, 0, 0, 0]),
    ] {
        let on = frame(0x7FF, on);
        assert_eq!((sent.encode(id(1)), RegisterRequest::decode(&on)), (on, Some((id(1), sent))));
    }
}

#[test]
fn answers_of_a_motor_are_distinguished_by_the_request() {
    let (ranges, on) = (ranges_of("4340"), master(0x11));
    let state = frame(0x11, [0xD1, 0x80, 0x00, 0x80, 0x08, 0x00, 40, 35]);
    let read = State::decode(&state, id(1), on, &ranges).unwrap();
    assert_eq!((read.status, read.transistors_c, read.rotor_c), (Status::LinkLost, 40, 35));
    assert!(read.p_rad.abs() < 2e-4 && read.v_rad_s.abs() < 3e-3 && read.t_nm.abs() < 7e-3, "{read:?}");
    assert_eq!(read.encode(on, &ranges), state);
    // Another motor, another master id.
    assert_eq!(State::decode(&state, id(2), on, &ranges), None);
    assert_eq!(State::decode(&state, id(1), master(0x12), &ranges), None);

    let asked = RegisterRequest::Read(Register::VelocityMax);
    let answer =
        RegisterAnswer { register: Register::VelocityMax, written: false, value: RegisterValue::Float(10.0) };
    let bytes = frame(0x11, [1, 0, 0x33, 22, 0, 0, 0x20, 0x41]);
    assert_eq!(answer.encode(id(1), on), bytes);
    assert_eq!(RegisterAnswer::decode(&bytes, id(1), on, &asked), Some(answer));
    for other in [RegisterRequest::Read(Register::Mode), RegisterRequest::State] {
        assert_eq!(RegisterAnswer::decode(&bytes, id(1), on, &other), None);
    }
    assert_eq!(RegisterAnswer::decode(&state, id(1), on, &asked), None);
}

#[test]
fn a_set_point_at_all_ends_is_never_an_order_to_set_the_zero() {
    let ranges = ranges_of("4310");
    for raw in 0xFF0..=0xFFF_u16 {
        let t_nm = -10.0 + f32::from(raw) / 4095.0 * 20.0;
        let mit = Mit { p_rad: 20.0, v_rad_s: 99.0, kp_nm_rad: 500.0, kd_nm_s_rad: 5.0, t_nm };
        let (frame, clipped) = Command::Mit(mit).encode(id(1), &ranges).unwrap();
        assert!(clipped.p && clipped.v && !clipped.kp && !clipped.kd && !clipped.t, "{clipped:?}");
        let (_, read) = Command::decode(&frame, &ranges).unwrap();
        assert!(matches!(read, Command::Mit(Mit { p_rad, .. }) if p_rad > 12.49), "{raw:#x}: {read:?}");
    }
}

#[test]
fn nothing_that_is_no_number_reaches_a_motor() {
    let ranges = ranges_of("4310");
    for bad in [f32::NAN, f32::INFINITY] {
        for command in [
            Command::Mit(Mit { p_rad: bad, ..Mit::default() }),
            Command::Mit(Mit { t_nm: bad, ..Mit::default() }),
            Command::PositionVelocity { p_rad: 0.0, v_max_rad_s: bad },
            Command::Velocity { v_rad_s: bad },
            Command::PositionForce { p_rad: bad, v_max_centirad_s: 0, current_share: 0 },
            Command::PositionForce { p_rad: 0.0, v_max_centirad_s: 0, current_share: 10_001 },
        ] {
            assert_eq!(command.encode(id(1), &ranges), Err(CommandError::NotANumber), "{command:?}");
        }
        let [a, b, c, d] = bad.to_le_bytes();
        let heard = frame(0x201, [a, b, c, d, 0, 0, 0, 0]);
        assert_eq!(Command::decode(&heard, &ranges), Err(CommandError::NotANumber));
        assert_eq!(Ranges::new(12.5, bad, 10.0), None);
    }
    assert_eq!(Ranges::new(12.5, 0.0, 10.0), None);
    assert!(MotorId::new(0).is_none() && MotorId::new(0x80).is_none());
}
