//! Drives and host link are two ports: distinguished by the id width on one bus, by the bus of the frame on two.

use crate::bench::host::{Call, Host};
use crate::bench::*;
use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::groups::powercube::PowerCubes;
use firmware::host_link::{HostBus, Port};
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use protocol::cyphal::cubecell::{command, stop};
use protocol::cyphal::id::{NodeId, Priority, Route, TransferId};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::powercube::{Parameter, Reply, Value};
use protocol::{Duration, Frame, Instant, ModuleId};

/// Calls and frames of a whole throw over the host link, on one bus.
fn recorded() -> (Vec<Call>, Vec<(Instant, Frame)>) {
    let mut host = Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.run(1_400_000, |_, _| {});
    assert!(host.bench.distance_from_path() < 1e-3, "the throw itself must work");
    (host.bench.controller.calls, host.bench.controller.frames)
}

fn node(host_bus: HostBus) -> ControllerNode<RamStorage, Spline, PowerCubes> {
    let settings = Options::default().settings;
    let (identity, seed) = (Default::default(), Seed::FORESEEABLE);
    let mut node = ControllerNode::new(Instant::ZERO, RamStorage::new(), &settings, identity, seed);
    node.set_host_bus(host_bus);
    node
}

/// The same calls by port: the frames of the drives' port and of the host's port, in order.
fn play(calls: &[Call], host_bus: HostBus) -> Vec<(Instant, Port, Frame, StateKind)> {
    let mut node = node(host_bus);
    let mut sent = Vec::new();
    for call in calls {
        match &call.input {
            None => node.handle_deadline(call.at),
            Some(frame) if frame.is_extended() => node.handle_host_frame(call.at, frame),
            Some(frame) => node.handle_packet(call.at, frame),
        }
        let kind = node.controller().state().kind();
        while let Some(frame) = node.poll_packet() {
            sent.push((call.at, Port::Drives, frame, kind));
        }
        while let Some(frame) = node.poll_host_frame() {
            sent.push((call.at, Port::Host, frame, kind));
        }
    }
    sent
}

#[test]
fn one_bus_is_the_two_ports_distinguished_by_id_width() {
    let (calls, frames) = recorded();
    let sent: Vec<(Instant, Frame)> = play(&calls, HostBus::Shared)
        .iter()
        .map(|(at, port, frame, _)| {
            assert_eq!(*port, Port::on_one_bus(frame));
            (*at, *frame)
        })
        .collect();
    assert!(sent.len() > 5_000);
    assert_eq!(sent, frames);
}

#[test]
fn host_link_on_a_bus_of_its_own_leaves_the_drives_frames_as_they_are_and_does_not_wait_for_them() {
    let (calls, _) = recorded();
    let (shared, own) = (play(&calls, HostBus::Shared), play(&calls, HostBus::Own));
    let of = |sent: &[(Instant, Port, Frame, StateKind)], port| -> Vec<(Instant, Frame)> {
        sent.iter().filter(|sent| sent.1 == port).map(|sent| (sent.0, sent.2)).collect()
    };
    assert_eq!(of(&own, Port::Drives), of(&shared, Port::Drives));
    // The n-th host frame during the run is never later, and most are earlier: they do not wait for control cycles.
    let times = |sent: &[(Instant, Port, Frame, StateKind)]| -> Vec<u64> {
        let running = sent.iter().filter(|sent| sent.1 == Port::Host && sent.3 == StateKind::Running);
        running.map(|sent| sent.0.as_micros()).collect()
    };
    let (shared, own) = (times(&shared), times(&own));
    let pairs = own.len().min(shared.len());
    assert!(pairs > 100, "{pairs} frames during the run");
    let earlier: Vec<u64> =
        own.iter().zip(&shared).map(|(own, shared)| shared.saturating_sub(*own)).collect();
    assert!(own.iter().zip(&shared).all(|(own, shared)| own <= shared));
    let mean_us = earlier.iter().sum::<u64>() / pairs as u64;
    println!("{pairs} host frames during the run leave {mean_us} us earlier on a bus of their own");
    // A telemetry message is a burst of frames, so waits add up; each burst ends before the next one, 100 ms later.
    assert!((3_000..100_000).contains(&mean_us), "{mean_us} us");
}

#[test]
fn frame_that_comes_by_the_other_port_means_nothing() {
    let (calls, _) = recorded();
    let mut node = node(HostBus::Own);
    for call in calls.iter().take_while(|call| call.at < Instant::from_micros(800_000)) {
        match &call.input {
            None => node.handle_deadline(call.at),
            Some(frame) if frame.is_extended() => node.handle_host_frame(call.at, frame),
            Some(frame) => node.handle_packet(call.at, frame),
        }
        while node.poll_packet().is_some() || node.poll_host_frame().is_some() {}
    }
    assert_eq!(node.controller().state().kind(), StateKind::Ready);
    let now = Instant::from_micros(800_000);

    // A stop message on the drives' bus is not a Cyphal frame there, with any id.
    let mut queue: TxQueue<2, 64> = TxQueue::new();
    let route = Route::Message { subject: stop::SUBJECT, source: NodeId::from_low_bits(99) };
    let deadline = now + Duration::from_secs(1);
    let meta = TxMeta { route, priority: Priority::Exceptional, transfer_id: TransferId::ZERO, deadline };
    queue.push(&meta, &stop::Stop::default()).unwrap();
    let stop = queue.pop().unwrap();
    node.handle_packet(now, &stop);
    assert_eq!(node.controller().state().kind(), StateKind::Ready);

    // A state word on the host's bus is not a frame of a drive.
    let word = Reply::Value(Parameter::CubeState, Value::U32(1)).encode(ModuleId::new(3).unwrap());
    let counters = node.controller().group().drive(joint(2)).counters;
    node.handle_host_frame(now, &word);
    assert_eq!(node.controller().group().drive(joint(2)).counters, counters, "not even as an unasked reply");
    node.handle_packet(now, &word);
    assert_eq!(node.controller().group().drive(joint(2)).counters.unasked, counters.unasked + 1);

    node.handle_host_frame(now, &stop);
    assert_eq!(node.controller().state().kind(), StateKind::Stopped);
}
