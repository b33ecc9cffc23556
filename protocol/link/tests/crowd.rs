//! A server whose clients are many, silent, gone, or send without end: over real sockets, with a clock that the test moves.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;

use can_link::socketcand::{ClientId, Relay, Server, ServerEvent, ServerOptions};
use can_link::{CanLink, Clock, wait};
use protocol::{Duration, Frame, Instant, StandardId};

/// Longer than any step here takes on a busy machine: only a hang reaches it.
const PATIENCE: Instant = Instant::from_micros(120_000_000);

fn server(clock: Clock) -> Server {
    let options = ServerOptions { relay: Relay::ByOwner, ..ServerOptions::default() };
    Server::listen("127.0.0.1", 0, "can0", clock, options).unwrap()
}

fn connect(server: &Server) -> TcpStream {
    TcpStream::connect(server.local_addr()).unwrap()
}

/// Calls `look` until it returns a value; the system moves the bytes in between.
fn until<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let hang = Clock::start();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(hang.now() < PATIENCE, "this never comes");
        std::thread::yield_now();
    }
}

/// Everything that happens until `count` events came.
fn events(server: &mut Server, count: usize) -> Vec<ServerEvent> {
    let mut events = Vec::new();
    until(|| {
        events.extend(server.next_event());
        (events.len() >= count).then_some(())
    });
    events
}

/// A client in raw mode; its answers are read.
fn raw(server: &mut Server) -> (TcpStream, ClientId) {
    let mut stream = connect(server);
    stream.write_all(b"< open can0 >< rawmode >").unwrap();
    let Some(ServerEvent::Joined { client, .. }) = events(server, 1).pop() else {
        panic!("no client joined")
    };
    stream.set_nonblocking(true).unwrap();
    let (mut text, mut buffer) = (String::new(), [0; 64]);
    until(|| {
        server.next_event();
        if let Ok(count) = stream.read(&mut buffer) {
            text += &String::from_utf8_lossy(&buffer[..count]);
        }
        (text == "< hi >< ok >< ok >").then_some(())
    });
    (stream, client)
}

#[test]
fn silent_connections_expire_and_make_room_for_others() {
    let clock = Clock::manual();
    let mut server = server(clock);
    let (_raw, listener) = raw(&mut server);
    let silent: Vec<_> = (1..32).map(|_| connect(&server)).collect();
    let joined = events(&mut server, silent.len());
    assert!(joined.iter().all(|event| matches!(event, ServerEvent::Joined { .. })), "{joined:?}");
    assert_eq!(server.client_count(), 32);

    // The next one gets the reason of the refusal, and what to do.
    let mut refused = connect(&server);
    let mut text = String::new();
    until(|| {
        assert_eq!(server.next_event(), None);
        refused.set_nonblocking(true).unwrap();
        let mut buffer = [0; 256];
        match refused.read(&mut buffer) {
            Ok(0) => Some(()),
            Ok(count) => {
                text += &String::from_utf8_lossy(&buffer[..count]);
                None
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => None,
            Err(error) => panic!("{error}"),
        }
    });
    assert_eq!(text, "< error too many clients, this server takes 32; end one and connect again >");

    // What the listener got to read is over by then.
    clock.set(Instant::from_micros(1_000_000));
    assert_eq!(server.next_event(), None);
    // One microsecond before the end of the handshake all are connected; after it only those that opened the bus.
    let end = Instant::ZERO + ServerOptions::default().handshake_max;
    assert_eq!(server.deadline(), Some(end));
    clock.set(Instant::from_micros(end.as_micros() - 1));
    assert_eq!((server.next_event(), server.client_count()), (None, 32));
    clock.set(end);
    let left = events(&mut server, silent.len());
    for event in &left {
        assert!(
            matches!(event, ServerEvent::Left { reason: "did not open the bus in time", client } if *client != listener),
            "{event:?}"
        );
    }
    assert_eq!(server.client_count(), 1);
    clock.set(Instant::from_micros(1_000_000_000));
    assert_eq!((server.next_event(), server.client_count()), (None, 1));
    raw(&mut server);
    assert_eq!(server.client_count(), 2);
}

#[test]
fn client_that_reads_nothing_for_ten_seconds_is_disconnected_and_no_other() {
    let clock = Clock::manual();
    let mut server = server(clock);
    let (_lazy, lazy) = raw(&mut server);
    let (mut reader, _) = raw(&mut server);
    clock.set(Instant::from_micros(1_000_000));
    let frame = Frame::from_array(StandardId::MAX, [0x55; 8]);
    let mut sink = vec![0; 1 << 20];
    let mut flood = |server: &mut Server, reader: &mut TcpStream| {
        server.broadcast(clock.now(), &frame, None);
        while matches!(reader.read(&mut sink), Ok(count) if count > 0) {}
    };
    // Fill what the system buffers, then the queue of the server.
    let mut sent = 0;
    while server.stats().dropped_out < 10 {
        flood(&mut server, &mut reader);
        sent += 1;
        assert!(sent < 1_000_000, "the queue of a client that does not read has no end");
    }
    let stall = server.deadline().expect("the stalled client has a deadline");
    let full_at = Instant::from_micros(1_000_000);
    assert_eq!(stall.saturating_since(full_at), Duration::from_secs(10));
    clock.set(stall);
    flood(&mut server, &mut reader);
    let left = events(&mut server, 1);
    assert_eq!(left, [ServerEvent::Left { client: lazy, reason: "reads nothing" }]);
    assert_eq!(server.client_count(), 1);
}

#[test]
fn flooding_client_without_room_does_not_wake_the_server_and_loses_nothing() {
    let clock = Clock::manual();
    let mut server = server(clock);
    let (mut flood, flooding) = raw(&mut server);
    let (mut other, _) = raw(&mut server);
    let text: String = (0..2_000).map(|n| format!("< send 300 2 {:X} {:X} >", n >> 8, n & 0xFF)).collect();
    // As much as the system buffers, at most all.
    let mut written = 0;
    until(|| match flood.write(&text.as_bytes()[written..]) {
        Ok(count) => {
            written += count;
            (written == text.len()).then_some(())
        }
        Err(_) => Some(()),
    });
    // The owner has no room for the flood. Reads fill the inbox, and then nothing is left to wake for.
    let mut turns = 0;
    until(|| {
        turns += 1;
        assert_eq!(server.next_event_from(&mut |client| client != flooding), None);
        let (before, due) = (clock.now(), clock.now() + Duration::from_millis(1));
        wait(&[&server], &clock, Some(due)).unwrap();
        // The clock moves only when no link has something to do.
        (clock.now() > before && turns > 3).then_some(())
    });
    for _ in 0..1_000 {
        assert_eq!(server.next_event_from(&mut |client| client != flooding), None);
        let due = clock.now() + Duration::from_millis(1);
        wait(&[&server], &clock, Some(due)).unwrap();
        assert_eq!(clock.now(), due, "the flood wakes a server that has no room for it");
    }
    // Another client is heard at once.
    other.write_all(b"< send 123 1 7 >").unwrap();
    let heard = until(|| server.next_event_from(&mut |client| client != flooding));
    assert!(matches!(heard, ServerEvent::Frame { frame, .. } if frame.data() == [7]), "{heard:?}");
    // With room again, everything comes, in order.
    let mut next = 0;
    until(|| {
        while let Some(event) = server.next_event() {
            let ServerEvent::Frame { frame, .. } = event else { panic!("{event:?}") };
            assert_eq!(frame.data(), u16::to_be_bytes(next));
            next += 1;
        }
        if written < text.len() {
            written += flood.write(&text.as_bytes()[written..]).unwrap_or(0);
        }
        (next == 2_000).then_some(())
    });
}

#[test]
fn frames_of_several_clients_are_handed_out_one_of_each() {
    let clock = Clock::manual();
    let mut server = server(clock);
    let mut clients: Vec<_> = (0..3).map(|_| raw(&mut server)).collect();
    for (stream, _) in &mut clients {
        stream.write_all("< send 100 0 >".repeat(50).as_bytes()).unwrap();
    }
    // Held back until all of them wait.
    let mut waiting = Vec::new();
    until(|| {
        assert_eq!(
            server.next_event_from(&mut |client| {
                waiting.push(client);
                false
            }),
            None
        );
        waiting.sort();
        waiting.dedup();
        (waiting.len() == 3).then_some(())
    });
    let mut order = Vec::new();
    until(|| {
        while let Some(event) = server.next_event() {
            let ServerEvent::Frame { client, .. } = event else { panic!("{event:?}") };
            order.push(client);
        }
        (order.len() == 150).then_some(())
    });
    for round in order.chunks(3).take(20) {
        let mut round = round.to_vec();
        round.sort();
        round.dedup();
        assert_eq!(round.len(), 3, "{order:?}");
    }
}
