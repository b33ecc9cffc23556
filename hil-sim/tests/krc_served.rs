//! The controller behind real sockets of this machine, in lock step: nothing depends on the speed of the machine.

use std::cell::Cell;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

use crate::krc_rig::{ARM, MS, between, config, wide};
use hil_sim::krc::bench::{RobotFault, RobotFaults};
use hil_sim::krc::options::Space;
use hil_sim::krc::serve::{Mode, ServeError, ServeOptions, Served, serve};
use hil_sim::krc::{DatagramLink, Direction, Krc, KrcEvent, LinkFault, LinkFaultKind, LinkOptions};
use rsi_protocol::Generation;

/// What a client of a few lines answers: a sine on A1, by the number in the telegram.
fn answer(telegram: &str) -> Option<String> {
    let ipoc = between(telegram, "<IPOC>", "</IPOC>")?;
    let a1 = 2.0 * (ipoc.parse::<f64>().ok()? * 0.004).sin();
    Some(format!(
        "<Sen Type=\"ImFree\"><AK A1=\"{a1:.6}\" A2=\"0\" A3=\"0\" A4=\"0\" A5=\"0\" A6=\"0\"/><IPOC>{ipoc}</IPOC></Sen>"
    ))
}

/// Answers telegrams until it gets an empty datagram, or until the connection is closed.
fn client(protocol: &str, piece: usize) -> (SocketAddr, JoinHandle<u64>) {
    if protocol == "TCP" {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let run = move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.set_nodelay(true).unwrap();
            let (mut text, mut buffer, mut answers) = (String::new(), [0; 777], 0);
            while let Ok(length @ 1..) = stream.read(&mut buffer) {
                text.push_str(std::str::from_utf8(&buffer[..length]).unwrap());
                while let Some((telegram, rest)) = text.split_once("</Rob>") {
                    let Some(answer) = answer(telegram) else { break };
                    let answer = format!("{answer}\r\n");
                    if answer.as_bytes().chunks(piece).any(|piece| stream.write_all(piece).is_err()) {
                        return answers;
                    }
                    answers += 1;
                    text = rest.to_owned();
                }
            }
            answers
        };
        return (address, std::thread::spawn(run));
    }
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap();
    let run = move || {
        let (mut buffer, mut answers) = ([0; 2048], 0);
        loop {
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            if length == 0 {
                return answers;
            }
            if let Some(answer) = answer(std::str::from_utf8(&buffer[..length]).unwrap()) {
                socket.send_to(answer.as_bytes(), from).unwrap();
                answers += 1;
            }
        }
    };
    (address, std::thread::spawn(run))
}

struct Run {
    generation: Generation,
    protocol: &'static str,
    cycles: u64,
    link_faults: Vec<LinkFault>,
    robot_faults: Vec<RobotFault>,
    /// The client writes its answers to a stream in pieces of this many bytes.
    piece: usize,
}

impl Run {
    fn new(generation: Generation, protocol: &'static str, cycles: u64) -> Self {
        Self { generation, protocol, cycles, link_faults: Vec::new(), robot_faults: Vec::new(), piece: 50 }
    }

    /// Figures, log, and the number of answers that the client gave.
    fn go(&self) -> (Result<Served, ServeError>, String, u64) {
        let mut options = wide(self.generation);
        options.late.limit = 100_000;
        let mut krc = Krc::new(ARM.clone(), config(self.protocol, Space::Axes, true), options, 7).unwrap();
        let (pc, client) = client(self.protocol, self.piece);
        let options = ServeOptions {
            pc,
            mode: Mode::LockStep,
            cycles: Some(self.cycles),
            // Only a hung client takes as long.
            answer_limit: protocol::Duration::from_secs(120),
        };
        let mut link = DatagramLink::new(
            LinkOptions { in_order: self.protocol == "TCP", ..LinkOptions::default() },
            &self.link_faults,
            7,
        );
        let mut log = String::new();
        let mut observe = |event: &KrcEvent| log.push_str(&format!("{event}\n"));
        let mut faults = RobotFaults::new(&self.robot_faults);
        let served = serve(&mut krc, &mut link, &mut faults, &options, &|| true, &mut observe);
        if self.protocol == "UDP" {
            UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&[], pc).unwrap();
        }
        drop(krc);
        (served, log, client.join().unwrap())
    }
}

const ALL: [(Generation, &str); 3] =
    [(Generation::KrC2, "UDP"), (Generation::KrC2, "TCP"), (Generation::KrC4, "UDP")];

#[test]
fn ten_thousand_cycles_over_loopback_have_no_late_answer() {
    for (generation, protocol) in ALL {
        let (served, _, answers) = Run::new(generation, protocol, 10_000).go();
        let served = served.unwrap();
        let case = format!("{generation:?} {protocol}");
        assert_eq!(
            (served.telegrams, served.late, served.refused, served.fault),
            (10_000, 0, 0, None),
            "{case}"
        );
        assert_eq!(answers, 10_000, "{case}");
    }
}

#[test]
fn robot_whose_client_begins_late_takes_one_answer_to_the_telegram_that_it_repeats() {
    const COPIES: usize = 3;
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let pc = socket.local_addr().unwrap();
    // Nothing is answered until the telegram has come three times; then every copy is.
    let client = std::thread::spawn(move || {
        let (mut buffer, mut first, mut answers) = ([0; 2048], Vec::new(), 0);
        loop {
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            if length == 0 {
                return (first, answers);
            }
            let telegram = std::str::from_utf8(&buffer[..length]).unwrap();
            // The one before the first with axes has a number only.
            let Some(answer) = answer(telegram).filter(|_| telegram.contains("AIPos")) else { continue };
            let times = if first.len() < COPIES {
                first.push(answer.clone());
                if first.len() == COPIES { COPIES } else { 0 }
            } else {
                1
            };
            for _ in 0..times {
                socket.send_to(answer.as_bytes(), from).unwrap();
                answers += 1;
            }
        }
    });
    let mut krc = Krc::new(ARM.clone(), config("UDP", Space::Axes, true), wide(Generation::KrC2), 7).unwrap();
    let options = ServeOptions {
        pc,
        mode: Mode::LockStep,
        cycles: Some(100),
        answer_limit: protocol::Duration::from_secs(120),
    };
    let mut link = DatagramLink::new(LinkOptions::default(), &[], 7);
    let mut faults = RobotFaults::new(&[]);
    let served = serve(&mut krc, &mut link, &mut faults, &options, &|| true, &mut |_| {}).unwrap();
    UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&[], pc).unwrap();
    let (first, answers) = client.join().unwrap();
    assert!(first.iter().all(|answer| *answer == first[0]), "{first:?}");
    // The first of the 100 telegrams has a number only.
    assert!(answers >= 99 + COPIES - 1, "{answers}");
    assert_eq!((served.telegrams, served.late, served.refused, served.fault), (100, 0, 0, None));
}

/// In real time, with answers that are in the socket long before the simulator reads it: after part of a cycle and after two.
#[test]
fn robot_that_is_held_up_blames_no_answer_that_waited_for_it() {
    let mut options = wide(Generation::KrC2);
    options.late.limit = 100_000;
    let mut krc = Krc::new(ARM.clone(), config("UDP", Space::Axes, true), options, 7).unwrap();
    let (answered, sent) = (Arc::new(AtomicU64::new(0)), Cell::new(0));
    let (socket, count) = (UdpSocket::bind("127.0.0.1:0").unwrap(), Arc::clone(&answered));
    let pc = socket.local_addr().unwrap();
    let client = std::thread::spawn(move || {
        let mut buffer = [0; 2048];
        loop {
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            if length == 0 {
                return;
            }
            if let Some(answer) = answer(std::str::from_utf8(&buffer[..length]).unwrap()) {
                socket.send_to(answer.as_bytes(), from).unwrap();
                count.fetch_add(1, Ordering::SeqCst);
            }
        }
    });
    let serving = ServeOptions {
        pc,
        mode: Mode::RealTime,
        cycles: Some(30),
        answer_limit: protocol::Duration::from_secs(120),
    };
    let goes_on = || {
        while answered.load(Ordering::SeqCst) < sent.get() {
            std::thread::yield_now();
        }
        std::thread::sleep(std::time::Duration::from_millis([0, 11, 28][sent.get() as usize % 3]));
        true
    };
    let mut observe =
        |event: &KrcEvent| sent.set(sent.get() + u64::from(matches!(event, KrcEvent::Cycle(_))));
    let mut link = DatagramLink::new(LinkOptions::default(), &[], 7);
    let served =
        serve(&mut krc, &mut link, &mut RobotFaults::default(), &serving, &goes_on, &mut observe).unwrap();
    UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&[], pc).unwrap();
    client.join().unwrap();
    assert_eq!((served.telegrams, served.late, served.refused, served.fault), (30, 0, 0, None));
    assert!(served.held_up >= 9, "{}", served.held_up);
}

#[test]
fn same_seed_gives_the_same_log_over_loopback() {
    for (generation, protocol) in ALL {
        let fault = |kind, direction, from, until, probability| LinkFault {
            kind,
            direction,
            from: MS(from),
            until: MS(until),
            probability,
        };
        let late = LinkFaultKind::Late(protocol::Duration::from_millis(5));
        let mut run = Run::new(generation, protocol, 1500);
        run.link_faults = vec![
            fault(LinkFaultKind::Lost, Direction::ToRobot, 500, 1000, 0.1),
            fault(late, Direction::ToClient, 800, 1500, 0.2),
            fault(LinkFaultKind::Doubled, Direction::ToClient, 1000, 2000, 0.2),
            fault(LinkFaultKind::WrongIpoc(-3), Direction::ToRobot, 2000, 2500, 0.1),
        ];
        let (first, log, _) = run.go();
        let (second, again, _) = run.go();
        let (first, second) = (first.unwrap(), second.unwrap());
        assert_eq!((first.late, first.refused), (second.late, second.refused));
        assert!(first.late >= 5 && first.fault.is_none(), "{first:?}");
        assert_eq!(log, again);
    }
}

/// Faults strike whole answers, however the stream is cut.
#[test]
fn size_of_the_pieces_of_a_stream_changes_nothing() {
    let run = |piece| {
        let mut run = Run::new(Generation::KrC2, "TCP", 300);
        run.piece = piece;
        run.link_faults = vec![LinkFault {
            kind: LinkFaultKind::Lost,
            direction: Direction::ToRobot,
            from: MS(0),
            until: MS(10_000),
            probability: 0.2,
        }];
        let (served, log, _) = run.go();
        (served.unwrap().late, log)
    };
    let (late, log) = run(1000);
    assert!((40..=80).contains(&late), "{late} of 300 at 20 %");
    assert_eq!(run(1), (late, log.clone()));
    assert_eq!(run(37), (late, log));
}

#[test]
fn new_program_run_has_a_new_socket_and_goes_on() {
    let mut run = Run::new(Generation::KrC2, "UDP", 600);
    run.robot_faults =
        vec![RobotFault::Restart { at: MS(2000), pause: protocol::Duration::from_millis(100) }];
    let (served, log, _) = run.go();
    assert_eq!(served.unwrap().late, 0);
    assert_eq!(log.matches(" started\n").count(), 2, "{log}");
}

#[test]
fn fault_ends_the_exchange_and_the_run() {
    let mut run = Run::new(Generation::KrC2, "TCP", 100_000);
    run.robot_faults = vec![RobotFault::CutOut { at: MS(1206) }];
    let (served, log, answers) = run.go();
    let served = served.unwrap();
    assert_eq!(served.fault.map(hil_sim::krc::FaultCause::name), Some("cut-out"));
    assert_eq!((served.telegrams, answers), (101, 101));
    assert!(log.contains(" standing\n"), "{log}");
}

#[test]
fn robot_reports_that_no_client_listens_or_that_no_client_answers() {
    let mut krc = Krc::new(ARM.clone(), config("TCP", Space::Axes, true), wide(Generation::KrC2), 1).unwrap();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let mut options = ServeOptions {
        pc: port,
        mode: Mode::LockStep,
        cycles: Some(10),
        answer_limit: protocol::Duration::from_millis(50),
    };
    let run = |krc: &mut Krc, options: &ServeOptions| {
        let mut link = DatagramLink::new(LinkOptions::default(), &[], 1);
        serve(krc, &mut link, &mut RobotFaults::default(), options, &|| true, &mut |_| {})
    };
    let error = run(&mut krc, &options).unwrap_err();
    assert!(matches!(error, ServeError::Unreachable { .. }), "{error}");
    assert!(error.next().unwrap().contains("start the client first"), "{error}");
    assert_eq!(krc.state(), hil_sim::krc::State::Off);
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    options.pc = silent.local_addr().unwrap();
    let mut krc = Krc::new(ARM.clone(), config("UDP", Space::Axes, true), wide(Generation::KrC4), 1).unwrap();
    let error = run(&mut krc, &options).unwrap_err();
    assert!(matches!(error, ServeError::NoAnswer { ipoc: 4710, .. }), "{error}");
}
