//! The controller through its Cyphal link, with a host of `protocol`'s own client code: everything a throw needs;
//! and the link never disturbs the drives.

use crate::bench::host::{Host, SERVER};
use crate::bench::*;
use firmware::fault::Cause;
use firmware::settings::Settings;
use firmware::state::StateKind;
use protocol::Instant;
use protocol::cyphal::bits::{Decode, Encode};
use protocol::cyphal::cubecell::command::{self, Refusal, Trajectory};
use protocol::cyphal::cubecell::stop;
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::command::standard;
use protocol::cyphal::uavcan::command::{self as commands, CommandRequest, Status};
use protocol::cyphal::uavcan::info;
use protocol::cyphal::uavcan::register::{self, AccessRequest, AccessResponse};
use protocol::cyphal::uavcan::value::{Value, ValueBuf};

#[test]
fn throw_over_the_wire_is_as_good_as_by_hand_and_telemetry_does_not_disturb_it() {
    let mut host = Host::new();
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    let joints_before = host.joints;
    // At start-up the port list stands before requests in the bench's first-in-first-out queue.
    let missed_before = host.group.unwrap().replies_missed;
    host.run(1_600_000, |_, _| {});
    assert_eq!(
        host.bench.kind(),
        StateKind::Ready,
        "{:?} {:?}",
        host.bench.controller.core().freeze_frame().map(|f| (f.at, f.fault)),
        host.group
    );
    assert!(host.bench.distance_from_path() < 1e-3);
    let group = host.group.unwrap();
    println!("{group:?}, {} joint states", host.joints - joints_before);
    assert!((10..=18).contains(&(host.joints - joints_before)), "every 100 ms");
    assert!(group.cycles_late < 25 && group.replies_missed == missed_before);
    assert!(
        group.trajectory_committed && group.trajectory_crc64 == name.trajectory_crc64 && group.host_alive
    );
}

/// A request of a node as it comes from the bus, now.
fn inject(host: &mut Host, from: u8, service: ServiceId, transfer_id: u8, request: &dyn Encode) {
    let (source, destination) = (NodeId::from_low_bits(from), SERVER);
    let meta = TxMeta {
        route: Route::Request { service, source, destination },
        priority: Priority::Nominal,
        transfer_id: TransferId::from_low_bits(transfer_id),
        deadline: Instant::FAR_FUTURE,
    };
    let mut queue: TxQueue<2, 100> = TxQueue::new();
    queue.push(&meta, request).unwrap();
    while let Some(frame) = queue.pop() {
        host.bench.inject(&frame);
    }
}

#[test]
fn stop_and_disarm_by_command_are_carried_out_whatever_waits_to_be_answered() {
    let cases = [
        (standard::EMERGENCY_STOP, true, StateKind::Stopping),
        (command::STOP, true, StateKind::Stopping),
        (command::STOP, false, StateKind::Stopped),
        (command::DISARM, false, StateKind::Ready),
    ];
    for (number, runs, expected) in cases {
        let mut host = Host::new();
        let name = host.armed();
        if runs {
            assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
            host.run(300_000, |_, _| {});
        }
        // The answers of one instant cannot be sent at once: the queue fills up.
        for transfer_id in 0..12 {
            inject(&mut host, 50, info::SERVICE, transfer_id, &());
        }
        let before = host.bench.kind();
        inject(&mut host, 51, register::LIST, 0, &register::ListRequest { index: 0 });
        assert_eq!(host.bench.kind(), before);
        inject(&mut host, 51, commands::SERVICE, 1, &CommandRequest { command: number, parameter: &[] });
        assert_eq!(host.bench.kind(), expected, "command {number} in {before:?}");
    }
}

#[test]
fn a_host_whose_heartbeat_comes_late_is_warned_once_before_a_later_one_is_too_late() {
    let mut host = Host::new();
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(200_000, |_, _| {});
    assert!(host.records.is_empty(), "every 30 ms of 100 is in time: {:?}", host.records);
    host.beat_us = 70_000;
    host.run(400_000, |_, _| {});
    assert_eq!(host.records, ["host late: over half of host.timeout_us"]);
    assert_eq!(host.bench.kind(), StateKind::Running, "late, but not too late");
    host.beat_us = 110_000;
    host.run(300_000, |_, _| {});
    assert_ne!(host.bench.kind(), StateKind::Running);
    let fault = host.bench.controller.core().state().fault();
    assert_eq!(fault.map(|fault| fault.cause), Some(Cause::HostLost));
}

/// Also before a run: an armed group is disarmed when its host is silent, a ready group needs no host.
#[test]
fn a_late_host_of_an_armed_group_is_warned_and_one_of_a_ready_group_is_not() {
    let mut host = Host::new();
    host.run(800_000, |_, _| {});
    host.beat_us = 70_000;
    host.run(400_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert!(host.records.is_empty(), "{:?}", host.records);
    host.arm(&throw_file(3_000, false));
    host.run(400_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Armed);
    assert_eq!(host.records, ["host late: over half of host.timeout_us"]);
}

#[test]
fn stop_message_of_anybody_halts_within_a_millisecond() {
    let mut host = Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.run(300_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Running);
    let stranger = NodeId::from_low_bits(99);
    let route = Route::Message { subject: stop::SUBJECT, source: stranger };
    host.send(route, Priority::Exceptional, &stop::Stop::default());
    let at = host.bench.now;
    host.run(5_000, |_, _| {});
    let halted = host.bench.sent_after(at, is_halt).unwrap().as_micros() - at;
    println!("stop message queued to the end of the halt frame: {halted} us");
    assert!((50..1_000).contains(&halted));
    assert_eq!(host.bench.kind(), StateKind::Stopping, "the arm still moves");
    host.run(1_000_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Stopped);
}

#[test]
fn lost_heartbeat_of_the_host_stops_and_others_neither_keep_it_alive_nor_command() {
    let mut host = Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.address = NodeId::from_low_bits(43);
    let (status, output) = host.command(command::HOME, &command::Home { joint_mask: 1 });
    assert_eq!(status, Status::NOT_AUTHORIZED);
    assert_eq!(Refusal::from_bytes(&output).unwrap().cause, Cause::OtherHost.code());
    // Heartbeats now come from 43: the host is gone.
    host.run(200_000, |_, _| {});
    let fault = host.bench.controller.core().state().fault().unwrap();
    assert_eq!(fault.cause, Cause::HostLost);
}

#[test]
fn refusals_say_cause_joint_and_place() {
    let mut host = Host::new();
    host.run(800_000, |_, _| {});
    let (status, output) = host.command(command::RUN, &Trajectory { trajectory_crc64: 1, length_bytes: 2 });
    assert_eq!(status, Status::BAD_STATE);
    assert_eq!(Refusal::from_bytes(&output).unwrap().cause, Cause::OrderNotNow.code());
    assert_eq!(host.command(99, &command::Gripper { open: true }).0, Status::BAD_COMMAND);
    let jog = command::Jog { joint: 6, qd_rad_s: 0.1, hold_ms: 100 };
    let (status, output) = host.command(command::JOG, &jog);
    assert_eq!(status, Status::BAD_PARAMETER);
    assert_eq!(Refusal::from_bytes(&output).unwrap().cause, Cause::JointUnknown.code());
}

#[test]
fn registers_are_read_written_and_refused_over_the_wire() {
    let mut host = Host::new();
    host.run(800_000, |_, _| {});
    let read = |host: &mut Host, name: &str, value: Value<'_>| {
        let answer = host.ask(register::ACCESS, &AccessRequest { name: name.as_bytes(), value });
        let response = AccessResponse::from_bytes(&answer).unwrap();
        assert!(response.mutable);
        {
            let value = response.value;
            (value.f64(0).or(value.u64(0).map(|x| x as f64)), value.len())
        }
    };
    let defaults = Settings::powercube6();
    let v_max = f64::from(defaults.joint.0[0].v_max_rad_s);
    assert_eq!(read(&mut host, "joint.v_max_rad_s", Value::EMPTY), (Some(v_max), 6));
    assert_eq!(read(&mut host, "cycle.period_us", Value::EMPTY), (Some(3_000.0), 1));
    let buffer = ValueBuf::try_from(&[2.0f32; 6][..]).unwrap();
    assert_eq!(read(&mut host, "joint.v_max_rad_s", buffer.as_value()).0, Some(2.0));
    let buffer = ValueBuf::try_from(&[2.0f32; 5][..]).unwrap();
    assert_eq!(read(&mut host, "joint.v_max_rad_s", buffer.as_value()).0, Some(2.0), "five of six: refused");
    let buffer = ValueBuf::from(5u32);
    assert_eq!(read(&mut host, "cycle.period_us", buffer.as_value()).0, Some(3_000.0), "out of range");
}

#[test]
fn a_stop_by_whoever_runs_the_node_halts_the_drives_with_the_next_frame() {
    let mut host = Host::new();
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(600_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Running);
    assert!(host.bench.drives.iter().any(|drive| drive.speed().abs() > 0.1), "the arm moves");
    let asked_us = host.bench.now;
    host.stop_node();
    host.run(400_000, |_, _| {});
    let halted = host.bench.sent_after(asked_us, is_halt).map(|at| at.as_micros() - asked_us);
    // One frame may be on the wire, then the broadcast itself: 140 us each at most.
    assert!(halted.is_some_and(|after_us| after_us <= 300), "{halted:?}");
    assert_eq!(host.bench.kind(), StateKind::Stopped);
    assert!(host.bench.drives.iter().all(|drive| drive.speed().abs() < 1e-3), "the drives stand");
}
