//! Frames that another program (cantools) made from the DBC files of `odrive-can` 2.1.0, and what they mean.

use Version::{V05, V06};
use protocol::odrive::{
    AxisState, Clipped, ControlMode, Errors, Heartbeat, InputMode, NodeId, NotFinite, Order, Report, Request,
    Sdo, Version,
};
use protocol::{Frame, Id, StandardId};

fn node(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

fn frame(id: u16, hex: &str) -> Frame {
    let data: Vec<u8> = hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    Frame::new(Id::Standard(StandardId::new(id).unwrap()), &data).unwrap()
}

#[test]
fn orders_are_the_frames_of_the_maker() {
    let both = [
        (Order::Position { rev: 1.6, rev_s: 0.5, nm: 0.01 }, 0x0C, "cd cc cc 3f f4 01 0a 00"),
        (Order::Velocity { rev_s: -2.5, nm: 0.25 }, 0x0D, "00 00 20 c0 00 00 80 3e"),
        (Order::Torque { nm: -0.125 }, 0x0E, "00 00 00 be 00 00 00 00"),
        (Order::Limits { rev_s: 70.0, current_a: 15.0 }, 0x0F, "00 00 8c 42 00 00 70 41"),
        (Order::TrapezoidVelocity(10.0), 0x11, "00 00 20 41 00 00 00 00"),
        (Order::TrapezoidAcceleration(100.0, 50.0), 0x12, "00 00 c8 42 00 00 48 42"),
        (Order::State(AxisState::ClosedLoop), 0x07, "08 00 00 00 00 00 00 00"),
        (Order::Mode(ControlMode::Position, InputMode::Direct), 0x0B, "03 00 00 00 01 00 00 00"),
        (Order::PositionGain(20.0), 0x1A, "00 00 a0 41 00 00 00 00"),
        (Order::VelocityGains(0.16, 0.32), 0x1B, "0a d7 23 3e 0a d7 a3 3e"),
        (Order::Estop, 0x02, ""),
    ];
    let old = [
        (Order::CountHere(-8192), 0x19, "00 e0 ff ff 00 00 00 00"),
        (Order::ClearErrors, 0x18, ""),
        (Order::Reboot, 0x16, ""),
    ];
    let new = [
        (Order::PositionHere(-0.75), 0x19, "00 00 40 bf 00 00 00 00"),
        (Order::ClearErrors, 0x18, "00"),
        (Order::Reboot, 0x16, "00"),
        (Order::Sdo(Sdo { endpoint: 0x1234, value: None }), 0x04, "00 34 12 00 00 00 00 00"),
        (Order::Sdo(Sdo { endpoint: 0x1234, value: Some([1, 2, 3, 4]) }), 0x04, "01 34 12 00 01 02 03 04"),
    ];
    let all = both.iter().flat_map(|row| [(row, V05), (row, V06)]);
    for ((order, command, hex), version) in
        all.chain(old.iter().map(|row| (row, V05))).chain(new.iter().map(|row| (row, V06)))
    {
        let on = frame(5 << 5 | command, hex);
        assert_eq!(order.encode(node(5), version), Ok((on, Clipped::default())), "{order:?}");
        assert_eq!(Order::decode(&on, version), Some((node(5), *order)));
        assert_eq!(Report::decode(&on, version), None, "{order:?}");
    }
}

#[test]
fn reports_are_the_frames_of_the_maker() {
    let heartbeat =
        |error, state, detail| Report::Heartbeat(Heartbeat { error, state, trajectory_done: true, detail });
    for (version, report, command, hex) in [
        (V05, Report::Estimates { rev: 1.25, rev_s: -0.5 }, 0x09, "00 00 a0 3f 00 00 00 bf"),
        (V06, Report::Estimates { rev: 1.25, rev_s: -0.5 }, 0x09, "00 00 a0 3f 00 00 00 bf"),
        (V05, Report::Iq { wanted_a: 1.5, measured_a: 1.25 }, 0x14, "00 00 c0 3f 00 00 a0 3f"),
        (V06, Report::Supply { volts: 48.0, amperes: -0.5 }, 0x17, "00 00 40 42 00 00 00 bf"),
        // The watchdog, idle; the encoder has an error.
        (V05, heartbeat(0x800, AxisState::Idle, 0b010), 0x01, "00 08 00 00 01 00 01 80"),
        (V06, heartbeat(0x0100_0000, AxisState::ClosedLoop, 1), 0x01, "00 00 00 01 08 01 01 00"),
        (V05, Report::Errors(Errors { active: 0x10, disarm_reason: None }), 0x03, "10 00 00 00 00 00 00 00"),
        (
            V06,
            Report::Errors(Errors { active: 0x0100_0000, disarm_reason: Some(0x4000) }),
            0x03,
            "00 00 00 01 00 40 00 00",
        ),
        (
            V06,
            Report::Version { protocol: 2, hardware: [4, 4, 58], firmware: [0, 6, 10, 0] },
            0x00,
            "02 04 04 3a 00 06 0a 00",
        ),
        (V06, Report::Temperature { transistors_c: 41.5, motor_c: 60.25 }, 0x15, "00 00 26 42 00 00 71 42"),
        (V06, Report::Torques { wanted_nm: 0.5, estimated_nm: 0.45 }, 0x1C, "00 00 00 3f 66 66 e6 3e"),
        (V06, Report::Address { serial: 0x385F_324D_3037 }, 0x06, "05 37 30 4d 32 5f 38 00"),
    ] {
        let on = frame(5 << 5 | command, hex);
        assert_eq!(report.encode(node(5), version), on, "{report:?}");
        assert_eq!(Report::decode(&on, version), Some((node(5), report)));
    }
}

#[test]
fn what_is_fed_forward_ends_at_its_field_and_says_so() {
    // 2.6 rad/s behind a gear ratio of 161 are 66.6 turns a second: twice the range of the field.
    let rev_s = 2.6 / std::f32::consts::TAU * 161.0;
    let order = Order::Position { rev: 0.0, rev_s, nm: -40.0 };
    let (on, clipped) = order.encode(node(1), V05).unwrap();
    assert_eq!(clipped, Clipped { velocity: true, torque: true });
    let (_, read) = Order::decode(&on, V05).unwrap();
    assert_eq!(read, Order::Position { rev: 0.0, rev_s: 32.767, nm: -32.768 });
}

#[test]
fn requests_are_frames_without_data_or_remote_ones_and_old_axes_know_fewer() {
    for (request, command, old) in [
        (Request::Version, 0x00, false),
        (Request::Errors, 0x03, true),
        (Request::Address, 0x06, false),
        (Request::Estimates, 0x09, true),
        (Request::Iq, 0x14, true),
        (Request::Temperature, 0x15, false),
        (Request::Supply, 0x17, true),
        (Request::Torques, 0x1C, false),
    ] {
        let id = Id::Standard(StandardId::new(3 << 5 | command).unwrap());
        for frame in [request.encode(node(3)), Frame::remote(id, 8).unwrap()] {
            assert_eq!(Request::decode(&frame, V06), Some((node(3), request)));
            assert_eq!(Request::decode(&frame, V05), old.then_some((node(3), request)));
            assert_eq!(Report::decode(&frame, V06), None);
        }
    }
}

#[test]
fn nothing_that_is_no_number_reaches_an_axis_and_what_is_one_is_read_as_it_came() {
    for bad in [f32::NAN, f32::NEG_INFINITY] {
        for order in [
            Order::Position { rev: bad, rev_s: 0.0, nm: 0.0 },
            Order::Position { rev: 0.0, rev_s: bad, nm: 0.0 },
            Order::Velocity { rev_s: 0.0, nm: bad },
            Order::Torque { nm: bad },
            Order::Limits { rev_s: bad, current_a: 1.0 },
            Order::PositionHere(bad),
        ] {
            assert_eq!(order.encode(node(1), V06), Err(NotFinite), "{order:?}");
        }
        let on = Report::Estimates { rev: bad, rev_s: bad }.encode(node(1), V06);
        let Some((_, Report::Estimates { rev, .. })) = Report::decode(&on, V06) else { panic!("estimates") };
        assert_eq!(rev.to_bits(), bad.to_bits());
    }
    let nan = frame(1 << 5 | 0x0E, "00 00 c0 7f 00 00 00 00");
    assert_eq!(Order::decode(&nan, V06), None);
    assert!(NodeId::new(63).is_none());
}
