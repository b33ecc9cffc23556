//! SLCAN host and adapter against each other and against raw bytes, over 127.0.0.1 and over
//! pseudo-terminals.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::mpsc;
use std::thread;

use crate::common::{PATIENCE, assert_all_kinds_cross, collect, samples};
use can_link::slcan::{Adapter, Host};
use can_link::{
    BusSpec, CanLink, Clock, LinkEvent, OpenError, ServerEvent, ServerOptions, open, serve, wait,
};
use protocol::text::slcan::Bitrate;
use protocol::{Duration, ExtendedId, Frame, Instant, StandardId};

/// Runs `work` on its own thread while `link` is served here; returns what both saw.
fn serve_while<T: Send + 'static>(
    link: &mut dyn CanLink,
    work: impl FnOnce() -> T + Send + 'static,
) -> (T, Vec<Frame>) {
    let clock = Clock::start();
    let (done, result) = mpsc::channel();
    let worker = thread::spawn(move || done.send(work()));
    let mut frames = Vec::new();
    loop {
        while let Some(event) = link.receive().unwrap() {
            if let LinkEvent::Frame { frame, .. } = event {
                frames.push(frame);
            }
        }
        if let Ok(value) = result.try_recv() {
            worker.join().unwrap().unwrap();
            return (value, frames);
        }
        assert!(clock.now() < PATIENCE, "the worker hangs");
        wait(&[&*link], &clock, Some(clock.now() + Duration::from_millis(5))).unwrap();
    }
}

fn port_of(link: &dyn CanLink) -> u16 {
    link.name().rsplit(':').next().unwrap().parse().unwrap()
}

fn tcp_adapter(options: ServerOptions) -> Adapter {
    Adapter::listen("127.0.0.1", 0, Bitrate::M1, Clock::start(), options).unwrap()
}

fn connect(adapter: &mut Adapter) -> Host {
    let port = port_of(adapter);
    let (host, _) =
        serve_while(adapter, move || Host::connect("127.0.0.1", port, Bitrate::M1, Clock::start()));
    host.unwrap()
}

/// Sends each command and reads until its answer is whole.
fn dialogue(stream: &mut (impl Read + Write), commands: &[&str]) -> Vec<String> {
    commands
        .iter()
        .map(|command| {
            stream.write_all(command.as_bytes()).unwrap();
            let mut answer = Vec::new();
            let mut byte = [0];
            while !matches!(answer.last(), Some(b'\r' | 0x07)) {
                stream.read_exact(&mut byte).unwrap();
                answer.push(byte[0]);
            }
            String::from_utf8(answer).unwrap()
        })
        .collect()
}

#[test]
fn frames_of_every_kind_cross_in_both_directions_over_tcp() {
    let mut adapter = tcp_adapter(ServerOptions::default());
    let mut host = connect(&mut adapter);
    assert_all_kinds_cross(&mut adapter, &mut host);
}

#[test]
fn frames_of_every_kind_cross_in_both_directions_over_a_pseudo_terminal() {
    let mut adapter = Adapter::at_pty(Bitrate::K500, Clock::start()).unwrap();
    let path: PathBuf = adapter.pty_path().unwrap().to_owned();
    let (host, _) = serve_while(&mut adapter, move || {
        // A baud rate means nothing to a pseudo-terminal, but setting it must not break it.
        Host::open_device(&path, Some(115_200), Bitrate::K500, Clock::start())
    });
    let mut host = host.unwrap();
    assert_all_kinds_cross(&mut adapter, &mut host);
}

#[test]
fn a_second_host_may_come_to_the_pseudo_terminal_after_the_first_has_left() {
    let mut adapter = Adapter::at_pty(Bitrate::M1, Clock::start()).unwrap();
    let path: PathBuf = adapter.pty_path().unwrap().to_owned();
    for _ in 0..2 {
        let path = path.clone();
        let (host, _) =
            serve_while(&mut adapter, move || Host::open_device(&path, None, Bitrate::M1, Clock::start()));
        let mut host = host.unwrap();
        host.send(&samples()[0]).unwrap();
        // The adapter reads this before the next client flushes the line.
        assert_eq!(collect(&mut host, &mut adapter, 1), [samples()[0]]);
    }
}

#[test]
fn every_command_has_the_answer_of_the_manual_in_every_state() {
    let mut adapter = tcp_adapter(ServerOptions::default());
    let port = port_of(&adapter);
    let (answers, frames) = serve_while(&mut adapter, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let closed = dialogue(
            &mut stream,
            &[
                "\r",
                "V\r",
                "N\r",
                "C\r",
                "F\r",
                "t1230\r",
                "S6\r",
                "S8\r",
                "s001C\r",
                "Z1\r",
                "M00000000\r",
                "mFFFFFFFF\r",
                "M00000001\r",
                "X\r",
            ],
        );
        let open = dialogue(
            &mut stream,
            &[
                "O\r",
                "O\r",
                "S8\r",
                "Z0\r",
                "F\r",
                "t12320102\r",
                "T000001230\r",
                "r1238\r",
                "t1239\r",
                "t12\r",
                "C\r",
            ],
        );
        let listening = dialogue(&mut stream, &["L\r", "t1230\r", "F\r", "C\r"]);
        (closed, open, listening)
    });
    let (done, bell) = ("\r", "\x07");
    assert_eq!(
        answers.0,
        [done, "V1013\r", "NSIM0\r", bell, bell, bell, bell, done, bell, done, done, done, bell, bell]
    );
    assert_eq!(answers.1, [done, bell, bell, bell, "F00\r", "z\r", "Z\r", "z\r", bell, bell, done]);
    assert_eq!(answers.2, [done, bell, "F00\r", done]);
    let id = StandardId::new(0x123).unwrap();
    assert_eq!(
        frames,
        [
            Frame::from_array(id, [1, 2]),
            Frame::from_array(ExtendedId::new(0x123).unwrap(), []),
            Frame::remote(id, 8).unwrap()
        ]
    );
    assert_eq!(adapter.stats().malformed_in, 3);
}

#[test]
fn time_stamps_come_when_asked_for_and_wrap_at_a_minute() {
    let mut adapter = tcp_adapter(ServerOptions::default());
    let port = port_of(&adapter);
    let (mut stream, _) = serve_while(&mut adapter, move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        assert_eq!(dialogue(&mut stream, &["Z1\r", "O\r"]), ["\r", "\r"]);
        stream
    });
    // 125.017 s is 5 017 ms (1399 hexadecimal) into its minute.
    adapter.broadcast(Instant::from_micros(125_017_000), &samples()[1], None);
    assert_eq!(dialogue(&mut stream, &[""]), ["t7FF01399\r"]);
}

#[test]
fn each_host_has_an_adapter_of_its_own_on_the_same_bus() {
    let mut adapter = tcp_adapter(ServerOptions::default());
    let (mut alice, mut bob) = (connect(&mut adapter), connect(&mut adapter));
    alice.send(&samples()[0]).unwrap();
    assert_eq!(collect(&mut adapter, &mut bob, 1), [samples()[0]]);
    adapter.send(&samples()[1]).unwrap();
    assert_eq!(collect(&mut adapter, &mut alice, 1), [samples()[1]]);
}

#[test]
fn a_board_that_listens_is_served_by_connecting_to_it() {
    let board = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = board.local_addr().unwrap().port();
    let mut adapter = Adapter::connect("127.0.0.1", port, Bitrate::M1, Clock::start()).unwrap();
    let (mut uart, _) = board.accept().unwrap();
    let ((answers, uart), frames) = serve_while(&mut adapter, move || {
        let answers = dialogue(&mut uart, &["C\r", "S8\r", "O\r", "t0A53084F64\r"]);
        (answers, uart)
    });
    drop(uart);
    assert_eq!(answers, ["\x07", "\r", "\r", "z\r"]);
    assert_eq!(frames, [samples()[0]]);
    // When the board is gone the link ends; a server with a port would wait for the next one.
    let clock = Clock::start();
    let error = loop {
        match adapter.receive() {
            Ok(_) => assert!(clock.now() < PATIENCE),
            Err(error) => break error,
        }
    };
    assert!(error.to_string().contains("closed the connection"), "{error}");
}

#[test]
fn garbage_costs_one_line_and_the_host_counts_what_it_cannot_read() {
    let far = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = far.local_addr().unwrap().port();
    let talker = thread::spawn(move || {
        let (mut stream, _) = far.accept().unwrap();
        // Stale lines of an earlier session, then one answer per request.
        stream.write_all(b"23084F64\rt7FF0\r").unwrap();
        let mut heard = String::new();
        for question in ["S8\r", "O\r"] {
            let mut byte = [0];
            while !heard.ends_with(question) {
                stream.read_exact(&mut byte).unwrap();
                heard.push(char::from(byte[0]));
            }
            stream.write_all(b"\r").unwrap();
        }
        stream.write_all(b"t0A53084F64\r\xFF\xFE\x80garbage\rt7FF0\r\x07").unwrap();
        stream.read_to_string(&mut heard).unwrap();
        heard
    });
    let clock = Clock::start();
    let mut host = Host::connect("127.0.0.1", port, Bitrate::M1, clock).unwrap();
    let mut frames = Vec::new();
    while frames.len() < 2 || host.stats().refused_out == 0 {
        match host.receive().unwrap() {
            Some(LinkEvent::Frame { frame, .. }) => frames.push(frame),
            _ => wait(&[&host], &clock, Some(clock.now() + Duration::from_millis(5))).unwrap(),
        }
        assert!(clock.now() < PATIENCE);
    }
    assert_eq!(frames, samples()[..2]);
    assert_eq!((host.stats().malformed_in, host.stats().refused_out), (1, 1));
    drop(host);
    assert_eq!(talker.join().unwrap(), "\r\r\rC\rS8\rO\rC\r");
}

#[test]
fn a_wrong_bit_rate_and_a_silent_device_are_distinguished() {
    let mut adapter = tcp_adapter(ServerOptions::default());
    let port = port_of(&adapter);
    let (result, _) = serve_while(&mut adapter, move || {
        Host::connect("127.0.0.1", port, Bitrate::K125, Clock::start()).map(|_| ())
    });
    let Err(OpenError::Refused { bus, .. }) = &result else { panic!("{result:?}") };
    assert_eq!(bus, "125000 bit/s");

    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port();
    let result = Host::connect("127.0.0.1", port, Bitrate::M1, Clock::start()).map(|_| ());
    let Err(OpenError::Protocol { found, .. }) = &result else { panic!("{result:?}") };
    assert!(found.contains("no answer to 'S8'"), "{found}");
}

#[test]
fn files_that_are_no_device_are_refused_with_advice() {
    let clock = Clock::start();
    let open =
        |path: &str| Host::open_device(path.as_ref(), None, Bitrate::M1, clock).map(|_| ()).unwrap_err();
    let error = open("/dev/ttyACM93");
    assert!(matches!(error, OpenError::Device { .. }), "{error}");
    assert!(error.to_string().contains("/dev/ttyACM93"), "{error}");
    let error = open("/dev/null");
    assert!(matches!(error, OpenError::NotSerial { .. }), "{error}");
}

#[test]
fn a_device_in_use_is_not_opened_twice() {
    let mut adapter = Adapter::at_pty(Bitrate::M1, Clock::start()).unwrap();
    let path: PathBuf = adapter.pty_path().unwrap().to_owned();
    let (result, _) = serve_while(&mut adapter, move || {
        let first = Host::open_device(&path, None, Bitrate::M1, Clock::start())?;
        let second = Host::open_device(&path, None, Bitrate::M1, Clock::start()).map(|_| ());
        drop(first);
        Ok::<_, OpenError>(second)
    });
    let error = result.unwrap().unwrap_err();
    assert!(error.next().unwrap().contains("another program uses it"), "{error}");
}

#[test]
fn a_spec_leads_to_a_link_that_works_whatever_is_spoken() {
    for text in ["socketcand://127.0.0.1:0/can0", "slcan://127.0.0.1:0", "slcan:/dev/ptmx"] {
        let clock = Clock::start();
        let mut server = serve(&text.parse().unwrap(), clock, ServerOptions::default()).unwrap();
        let spec: BusSpec = server.name().parse().unwrap();
        let (client, _) = serve_while(&mut server, move || open(&spec, Clock::start()));
        let mut client = client.unwrap();
        client.send(&samples()[0]).unwrap();
        let sender = loop {
            if let Some(ServerEvent::Frame { client, frame, .. }) = server.next_event() {
                assert_eq!(frame, samples()[0], "{text}");
                break client;
            }
            assert!(clock.now() < PATIENCE, "{text}");
        };
        server.broadcast(clock.now(), &samples()[1], Some(sender));
        server.broadcast(clock.now(), &samples()[2], None);
        assert_eq!(collect(&mut server, &mut client, 1), [samples()[2]], "{text}");
        assert_eq!(server.client_count(), 1);
    }
}

#[test]
fn what_cannot_be_opened_or_served_says_what_to_do_instead() {
    let clock = Clock::start();
    let error = open(&BusSpec::Sim, clock).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("the cell inside this program"), "{error}");
    let spec = BusSpec::SocketCan { interface: "vcan0".into() };
    let error = serve(&spec, clock, ServerOptions::default()).map(|_| ()).unwrap_err();
    assert!(error.next().unwrap().contains("socketcand://127.0.0.1:29536/vcan0"), "{error}");
}
