//! Properties over all values and frames.

use proptest::prelude::*;
use protocol::mit::{
    Command, Mit, MotorId, Ranges, Register, RegisterAnswer, RegisterRequest, RegisterValue, State, Status,
};
use protocol::{Frame, Id, StandardId};

use super::golden::{id, master};

fn ranges() -> impl Strategy<Value = Ranges> {
    (1.0..20.0_f32, 1.0..60.0_f32, 0.5..300.0_f32).prop_map(|(p, v, t)| Ranges::new(p, v, t).unwrap())
}

fn frames() -> impl Strategy<Value = Frame> {
    // Ids of motors and of registers more often than others.
    let ids = prop_oneof![0..0x400_u16, Just(0x7FF), 0..0x800_u16];
    (ids, prop::collection::vec(any::<u8>(), 0..=8), any::<bool>()).prop_map(|(id, mut data, special)| {
        if special && data.len() == 8 {
            data[..7].fill(0xFF);
        }
        Frame::new(Id::Standard(StandardId::new(id).unwrap()), &data).unwrap()
    })
}

proptest! {
    #[test]
    fn a_set_point_is_read_as_it_was_meant_to_half_a_step_or_to_the_end_of_its_range(
        ranges in ranges(),
        (p, v, t) in (-1.5..1.5_f32, -1.5..1.5_f32, -1.5..1.5_f32),
        (kp, kd) in (-0.5..1.5_f32, -0.5..1.5_f32),
    ) {
        let ends = [ranges.p_max_rad(), ranges.v_max_rad_s(), ranges.t_max_nm()];
        let mit = Mit { p_rad: p * ends[0], v_rad_s: v * ends[1], kp_nm_rad: kp * 500.0, kd_nm_s_rad: kd * 5.0, t_nm: t * ends[2] };
        let (frame, clipped) = Command::Mit(mit).encode(id(5), &ranges).unwrap();
        let (motor, read) = Command::decode(&frame, &ranges).unwrap();
        let Command::Mit(read) = read else { return Err(TestCaseError::fail("no set point")) };
        prop_assert_eq!(motor, id(5));
        for (meant, read, end, low, steps, clipped) in [
            (mit.p_rad, read.p_rad, ends[0], -ends[0], 65535.0, clipped.p),
            (mit.v_rad_s, read.v_rad_s, ends[1], -ends[1], 4095.0, clipped.v),
            (mit.kp_nm_rad, read.kp_nm_rad, 500.0, 0.0, 4095.0, clipped.kp),
            (mit.kd_nm_s_rad, read.kd_nm_s_rad, 5.0, 0.0, 4095.0, clipped.kd),
            (mit.t_nm, read.t_nm, ends[2], -ends[2], 4095.0, clipped.t),
        ] {
            let half_step = 0.5 * (end - low) / steps;
            prop_assert!((read - meant.clamp(low, end)).abs() <= 1.01 * half_step + 1e-6 * end, "{} {}", meant, read);
            // A number within rounding of an end may count as either.
            let inside = (low..=end).contains(&meant);
            let at_an_end = (meant - low).abs().min((meant - end).abs()) < 1e-5 * end;
            prop_assert!(at_an_end || clipped != inside, "{}", meant);
        }
    }

    #[test]
    fn any_frame_is_read_or_refused_and_what_is_read_is_written_the_same(ranges in ranges(), frame in frames()) {
        if let Ok((motor, command)) = Command::decode(&frame, &ranges) {
            let (written, clipped) = command.encode(motor, &ranges).unwrap();
            prop_assert!(clipped == Default::default() || matches!(command, Command::Mit(_)));
            // The last four bytes of a velocity are not looked at.
            if !matches!(command, Command::Velocity { .. }) {
                prop_assert_eq!(written, frame);
            }
            prop_assert_eq!(Command::decode(&written, &ranges), Ok((motor, command)));
        }
        if let Some((motor, request)) = RegisterRequest::decode(&frame) {
            let again = request.encode(motor);
            prop_assert_eq!(RegisterRequest::decode(&again).map(|(motor, _)| motor), Some(motor));
            prop_assert_eq!(again.data()[..3].to_vec(), frame.data()[..3].to_vec());
        }
        for n in [1, 0x11] {
            if let Some(state) = State::decode(&frame, id(n), master(0x11), &ranges) {
                prop_assert_eq!(state.encode(master(0x11), &ranges), frame);
                prop_assert_eq!(state.status.is_fault(), !matches!(state.status, Status::Disabled | Status::Enabled));
            }
        }
    }

    #[test]
    fn every_register_is_read_and_written_both_ways(n in 1..=0x7F_u8, whole in any::<u32>(), float in -1e6..1e6_f32) {
        let motor = MotorId::new(n).unwrap();
        for register in Register::ALL {
            prop_assert_eq!(Register::of(register.number()), Some(register));
            let value = if register.is_whole() { RegisterValue::Whole(whole) } else { RegisterValue::Float(float) };
            for (asked, written) in [(RegisterRequest::Read(register), false), (RegisterRequest::Write(register, value), true)] {
                prop_assert_eq!(RegisterRequest::decode(&asked.encode(motor)), Some((motor, asked)));
                let answer = RegisterAnswer { register, written, value };
                let frame = answer.encode(motor, master(0x33));
                prop_assert_eq!(RegisterAnswer::decode(&frame, motor, master(0x33), &asked), Some(answer));
            }
        }
    }
}
