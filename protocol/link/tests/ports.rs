//! One bus behind a socketcand and an SLCAN port.

use can_link::{
    BusServer, BusSpec, Clock, Event, Link, Relay, ServerEvent, ServerOptions, open, serve_all, wait,
};
use protocol::{Duration, ExtendedId, Frame, Instant, StandardId};

/// Longer than anything here takes on a busy machine.
const PATIENCE: Instant = Instant::from_micros(20_000_000);

/// Serves until `done`, with the frames that came in and who sent them.
fn serve_until(
    bus: &mut dyn BusServer,
    clock: Clock,
    mut done: impl FnMut(&mut dyn BusServer, &[(can_link::ClientId, Frame)]) -> bool,
) -> Vec<(can_link::ClientId, Frame)> {
    let mut frames = Vec::new();
    loop {
        while let Some(event) = bus.next_event() {
            if let ServerEvent::Frame { client, frame, .. } = event {
                frames.push((client, frame));
            }
        }
        if done(bus, &frames) {
            return frames;
        }
        assert!(clock.now() < PATIENCE, "only {} frames", frames.len());
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
}

fn drain(link: &mut dyn Link, into: &mut Vec<Frame>) {
    while let Some(event) = link.receive().unwrap() {
        if let Event::Frame { frame, .. } = event {
            into.push(frame);
        }
    }
}

#[test]
fn clients_of_different_ports_are_different_clients_of_one_bus() {
    let clock = Clock::start();
    let specs: Vec<BusSpec> = ["socketcand://127.0.0.1:0/can0", "slcan://127.0.0.1:0"]
        .iter()
        .map(|spec| spec.parse().unwrap())
        .collect();
    let options = ServerOptions { relay: Relay::ByOwner, ..ServerOptions::default() };
    let mut bus = serve_all(&specs, clock, options).unwrap();
    let names: Vec<BusSpec> = bus.name().split(", ").map(|name| name.parse().unwrap()).collect();
    // Opening waits for the other side's answers, so it needs a thread of its own.
    let opening = std::thread::spawn(move || {
        let clock = Clock::start();
        names.iter().map(|spec| open(spec, clock).unwrap()).collect::<Vec<_>>()
    });
    serve_until(&mut *bus, clock, |_, _| opening.is_finished());
    let mut clients = opening.join().unwrap();
    assert_eq!(bus.client_count(), 2);

    let one = Frame::from_array(StandardId::new(0x0A5).unwrap(), [0x08, 0x4F, 0x64]);
    let two = Frame::from_array(ExtendedId::new(0x7F).unwrap(), [0xFF; 8]);
    clients[0].send(&one).unwrap();
    clients[1].send(&two).unwrap();
    let came = serve_until(&mut *bus, clock, |_, frames| {
        for client in &mut clients {
            drain(&mut **client, &mut Vec::new());
        }
        frames.len() == 2
    });
    let sender = |frame: Frame| came.iter().find(|(_, came)| *came == frame).unwrap().0;
    assert_ne!(sender(one), sender(two));

    // Each client sees the other's frame, and not its own.
    bus.broadcast(clock.now(), &one, Some(sender(one)));
    bus.broadcast(clock.now(), &two, Some(sender(two)));
    let mut seen = [Vec::new(), Vec::new()];
    serve_until(&mut *bus, clock, |bus, _| {
        for (client, seen) in clients.iter_mut().zip(&mut seen) {
            drain(&mut **client, seen);
        }
        let until = clock.now() + Duration::from_millis(1);
        wait(&[bus as &dyn Link], &clock, Some(until)).unwrap();
        seen.iter().all(|seen| !seen.is_empty())
    });
    assert_eq!(seen, [vec![two], vec![one]]);
    assert_eq!(bus.stats().frames_in, 2);
}
