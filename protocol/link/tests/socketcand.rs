//! The socketcand server against our client and against raw sockets, over 127.0.0.1.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::mpsc;
use std::thread;
use std::time::Duration as StdDuration;

use crate::common::{PATIENCE, assert_all_kinds_cross, collect, samples};
use can_link::socketcand::{Client, ClientId, Relay, Server, ServerEvent, ServerOptions};
use can_link::{CanLink, Clock, LinkError, LinkEvent, OpenError, SendError, wait};
use protocol::text::BusName;
use protocol::{Duration, ExtendedId, FdFlags, Frame};

fn server(options: ServerOptions) -> Server {
    Server::listen("127.0.0.1", 0, "can0", Clock::start(), options).unwrap()
}

/// Runs `work` on its own thread while the server is served here; returns what both saw.
fn serve_while<T: Send + 'static>(
    server: &mut Server,
    work: impl FnOnce() -> T + Send + 'static,
) -> (T, Vec<ServerEvent>) {
    let clock = Clock::start();
    let (done, result) = mpsc::channel();
    let worker = thread::spawn(move || done.send(work()));
    let mut events = Vec::new();
    loop {
        while let Some(event) = server.next_event() {
            events.push(event);
        }
        if let Ok(value) = result.try_recv() {
            worker.join().unwrap().unwrap();
            return (value, events);
        }
        assert!(clock.now() < PATIENCE, "the worker hangs; so far: {events:?}");
        let until = clock.now() + Duration::from_millis(5);
        wait(&[&*server], &clock, Some(until)).unwrap();
    }
}

fn connect(server: &mut Server) -> Client {
    let port = server.local_addr().port();
    let (client, _) = serve_while(server, move || {
        Client::connect("127.0.0.1", port, BusName::new("can0").unwrap(), Clock::start())
    });
    client.unwrap()
}

#[test]
fn frames_of_every_kind_cross_in_both_directions_unchanged_and_in_order() {
    let mut server = server(ServerOptions::default());
    let mut client = connect(&mut server);
    assert_all_kinds_cross(&mut server, &mut client);
}

#[test]
fn can_fd_frames_are_refused_by_a_client_and_not_sent_as_others_by_a_server() {
    let mut server = server(ServerOptions::default());
    let mut client = connect(&mut server);
    let frame = samples()[0].with_fd(FdFlags::BRS);
    let error = client.send(&frame).unwrap_err();
    assert!(matches!(error, SendError::Link(LinkError::ClassicalOnly { .. })), "{error}");
    assert!(client.takes_fd().is_err() && server.takes_fd().is_err());
    server.send(&frame).unwrap();
    server.send(&samples()[1]).unwrap();
    assert_eq!(collect(&mut server, &mut client, 1), [samples()[1]]);
    assert_eq!(server.stats().dropped_out, 1);
    // The client is still in use.
    client.send(&samples()[2]).unwrap();
    assert_eq!(collect(&mut client, &mut server, 1), [samples()[2]]);
}

#[test]
fn a_clients_frame_reaches_the_bus_and_the_other_clients_but_not_itself() {
    let mut server = server(ServerOptions::default());
    let (mut alice, mut bob) = (connect(&mut server), connect(&mut server));
    let frame = samples()[0];
    alice.send(&frame).unwrap();
    assert_eq!(collect(&mut server, &mut bob, 1), [frame]);
    // A frame from the bus is the next thing the sender sees: its own never came back.
    server.send(&samples()[1]).unwrap();
    assert_eq!(collect(&mut server, &mut alice, 1), [samples()[1]]);
}

#[test]
fn with_relay_by_owner_only_the_owner_passes_frames_on() {
    let mut server = server(ServerOptions { relay: Relay::ByOwner, ..ServerOptions::default() });
    let (mut alice, mut bob) = (connect(&mut server), connect(&mut server));
    alice.send(&samples()[0]).unwrap();
    let (sender, at): (ClientId, _) = loop {
        if let Some(ServerEvent::Frame { client, at, .. }) = server.next_event() {
            break (client, at);
        }
    };
    // If the server had relayed by itself, this would not be the first frame that Bob sees.
    server.broadcast(at, &samples()[1], Some(sender));
    server.broadcast(at, &samples()[2], None);
    assert_eq!(collect(&mut server, &mut bob, 2), samples()[1..3]);
    assert_eq!(collect(&mut server, &mut alice, 1), samples()[2..3]);
}

#[test]
fn bus_errors_arrive_with_their_class() {
    let mut server = server(ServerOptions::default());
    let mut client = connect(&mut server);
    server.broadcast_bus_error(protocol::Instant::ZERO, 0x40);
    let clock = Clock::start();
    let class = loop {
        assert!(server.receive().unwrap().is_none());
        if let Some(LinkEvent::BusError { error, .. }) = client.receive().unwrap() {
            break error.class;
        }
        wait(&[&server, &client], &clock, Some(clock.now() + Duration::from_millis(5))).unwrap();
        assert!(clock.now() < PATIENCE);
    };
    assert_eq!(class, 0x40);
}

#[test]
fn handshake_answers_come_alone_even_while_the_bus_is_busy() {
    // Time stands until the test moves it: a client of any speed reads each answer alone.
    let clock = Clock::manual();
    let mut server = Server::listen("127.0.0.1", 0, "can0", clock, ServerOptions::default()).unwrap();
    let port = server.local_addr().port();
    let mut chatter = connect(&mut server);
    // What python-can does: one recv per answer, compared as a whole.
    let (answers, _) = serve_while(&mut server, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut answers = Vec::new();
        let mut buffer = [0; 256];
        for command in ["", "< open can0 >", "< rawmode >"] {
            stream.write_all(command.as_bytes()).unwrap();
            for _ in 0..20 {
                chatter.send(&samples()[0]).unwrap();
                thread::sleep(StdDuration::from_micros(500));
            }
            let count = stream.read(&mut buffer).unwrap();
            answers.push(String::from_utf8_lossy(&buffer[..count]).into_owned());
        }
        // The delayed frames come 50 ms after the last answer.
        clock.set(protocol::Instant::from_micros(50_000));
        chatter.send(&samples()[0]).unwrap();
        let count = stream.read(&mut buffer).unwrap();
        answers.push(String::from_utf8_lossy(&buffer[..count]).into_owned());
        answers
    });
    assert_eq!(answers[..3], ["< hi >", "< ok >", "< ok >"]);
    assert!(answers[3].starts_with("< frame 0A5 "), "{}", answers[3]);
}

#[test]
fn wrong_commands_get_an_answer_and_the_connection_stays() {
    let mut server = server(ServerOptions::default());
    let port = server.local_addr().port();
    let (answers, events) = serve_while(&mut server, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut answers = Vec::new();
        let mut buffer = [0; 256];
        let overlong = format!("< {} >", "x".repeat(300));
        for command in [
            "",
            "< send 123 0 >",
            "< open can0 >",
            "< open can0 >",
            "< subscribe 0 0 123 >",
            "< send 123 2 1 >",
            &overlong,
            "< echo >",
        ] {
            stream.write_all(command.as_bytes()).unwrap();
            let count = stream.read(&mut buffer).unwrap();
            answers.push(String::from_utf8_lossy(&buffer[..count]).into_owned());
        }
        answers
    });
    assert_eq!(
        answers,
        [
            "< hi >",
            "< error open a bus first >",
            "< ok >",
            "< error a bus is open already >",
            "< error subscribe is not supported, use rawmode and send >",
            "< error column 16: expected 2 data bytes as the length code says, found ')' >",
            "< error message longer than 128 bytes >",
            "< echo >",
        ]
    );
    assert!(!events.iter().any(|event| matches!(event, ServerEvent::Frame { .. })));
    assert_eq!(server.stats().malformed_in, 3);
}

#[test]
fn asking_for_another_bus_is_refused_with_the_name_of_this_one() {
    let mut server = server(ServerOptions::default());
    let port = server.local_addr().port();
    let (result, _) = serve_while(&mut server, move || {
        Client::connect("127.0.0.1", port, BusName::new("can7").unwrap(), Clock::start()).map(|_| ())
    });
    let Err(OpenError::Refused { reason, .. }) = result else { panic!("{result:?}") };
    assert_eq!(reason, "could not open bus can7, this server has can0");
}

#[test]
fn a_server_in_real_time_refuses_lock_step_and_says_what_to_write() {
    let mut server = server(ServerOptions::default());
    let port = server.local_addr().port();
    let (error, _) = serve_while(&mut server, move || {
        let spec: can_link::BusSpec = format!("lockstep://127.0.0.1:{port}/can0").parse().unwrap();
        can_link::open(&spec, spec.clock()).map(|_| ()).unwrap_err()
    });
    assert!(error.to_string().contains("this server runs in real time"), "{error}");
    assert!(error.next().unwrap().contains("name the bus socketcand://"), "{error}");
}

#[test]
fn a_port_without_a_server_is_reported() {
    let free = Server::listen("127.0.0.1", 0, "can0", Clock::start(), ServerOptions::default()).unwrap();
    let port = free.local_addr().port();
    drop(free);
    let error = Client::connect("127.0.0.1", port, BusName::new("can0").unwrap(), Clock::start());
    let Err(OpenError::Connect { address, .. }) = error.map(|_| ()) else { panic!("connected") };
    assert_eq!(address, format!("127.0.0.1:{port}"));
}

#[test]
fn a_port_in_use_says_so() {
    let first = server(ServerOptions::default());
    let port = first.local_addr().port();
    let second = Server::listen("127.0.0.1", port, "can0", Clock::start(), ServerOptions::default());
    let error = second.map(|_| ()).unwrap_err();
    assert!(error.next().unwrap().contains("another program serves this port"), "{error}");
}

#[test]
fn a_server_of_another_protocol_is_recognised() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let other = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(b"SSH-2.0-OpenSSH_9.2p1\r\n").unwrap();
    });
    let error = Client::connect("127.0.0.1", port, BusName::new("can0").unwrap(), Clock::start());
    let error = error.map(|_| ()).unwrap_err();
    assert!(matches!(error, OpenError::Protocol { .. }), "{error}");
    other.join().unwrap();
}

#[test]
fn a_client_that_reads_nothing_loses_frames_and_the_others_do_not() {
    let mut server = server(ServerOptions::default());
    let port = server.local_addr().port();
    let (lazy, _) = serve_while(&mut server, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut buffer = [0; 64];
        for command in ["", "< open can0 >", "< rawmode >"] {
            stream.write_all(command.as_bytes()).unwrap();
            assert!(stream.read(&mut buffer).unwrap() > 0);
        }
        stream
    });
    let mut client = connect(&mut server);
    // Sockets buffer some megabytes; send until the lazy client's share must be full.
    let mut sent = 0;
    while server.stats().dropped_out < 1_000 {
        for _ in 0..500 {
            server.send(&Frame::from_array(ExtendedId::MAX, [0x55; 8])).unwrap();
            sent += 1;
        }
        let before = client.stats().frames_in as usize;
        assert_eq!(collect(&mut server, &mut client, sent - before).len(), sent - before);
        assert!(sent < 1_000_000, "the lazy client never fills up");
    }
    assert_eq!(client.stats().frames_in as usize, sent);
    assert_eq!(server.client_count(), 2);
    drop(lazy);
    let clock = Clock::start();
    while server.client_count() == 2 {
        assert!(server.receive().unwrap().is_none());
        assert!(clock.now() < PATIENCE);
    }
}

#[test]
fn the_end_of_the_server_ends_the_client_with_a_reason_after_the_last_frame() {
    let mut server = server(ServerOptions::default());
    let mut client = connect(&mut server);
    thread::sleep(StdDuration::from_millis(60));
    server.send(&samples()[0]).unwrap();
    assert_eq!(collect(&mut server, &mut client, 1), [samples()[0]]);
    drop(server);
    let clock = Clock::start();
    let error = loop {
        match client.receive() {
            Ok(event) => assert_eq!(event, None),
            Err(error) => break error,
        }
        assert!(clock.now() < PATIENCE);
    };
    assert!(error.to_string().contains("closed the connection"), "{error}");
    assert!(client.send(&samples()[0]).is_err());
}

#[test]
fn clients_beyond_the_limit_are_refused_with_a_message() {
    let mut server = server(ServerOptions { clients_max: 1, ..ServerOptions::default() });
    let _first = connect(&mut server);
    let port = server.local_addr().port();
    let (answer, _) = serve_while(&mut server, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text
    });
    assert_eq!(answer, "< error too many clients, this server takes 1; end one and connect again >");
}
