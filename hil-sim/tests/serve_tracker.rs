//! The simulated tracker behind sockets of this machine. Nothing depends on the speed of the machine.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hil_sim::tracker::serve::Sockets;
use hil_sim::tracker::{Tracker, TrackerScenario};
use protocol::Instant;
use tracker_protocol::dtrack::{DataFrame, DayClock, FrameGate, Messages, Verdict};

fn ask(stream: &mut TcpStream, command: &str) -> String {
    stream.write_all(command.as_bytes()).unwrap();
    stream.write_all(&[0]).unwrap();
    let (mut messages, mut byte) = (Messages::default(), [0]);
    loop {
        stream.read_exact(&mut byte).unwrap();
        if let Some(message) = messages.push(&byte).pop() {
            return message.unwrap();
        }
    }
}

#[test]
fn client_starts_the_measurement_over_tcp_and_gets_poses_over_udp() {
    let scenario =
        TrackerScenario::from_toml("a.toml", include_str!("../scenarios/tracker/target.toml")).unwrap();
    let mut tracker = Tracker::new(scenario.options, scenario.seed);
    let mut sockets = Sockets::bind(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
    let commands = sockets.command_address().unwrap();
    let ends = Arc::new(AtomicBool::new(false));
    let server = std::thread::spawn({
        let ends = Arc::clone(&ends);
        move || {
            sockets.run(&mut tracker, Instant::FAR_FUTURE, &|| !ends.load(Ordering::SeqCst));
            sockets.served()
        }
    });
    let data = UdpSocket::bind("127.0.0.1:0").unwrap();
    let port = data.local_addr().unwrap().port();
    let mut stream = TcpStream::connect(commands).unwrap();
    assert_eq!(ask(&mut stream, "dtrack2 get system access"), "dtrack2 set system access full");
    assert_eq!(ask(&mut stream, &format!("dtrack2 set output net ch01 udp my_ip {port}")), "dtrack2 ok");
    assert_eq!(ask(&mut stream, "dtrack2 set output active ch01 all yes"), "dtrack2 ok");
    assert_eq!(ask(&mut stream, "dtrack2 tracking start"), "dtrack2 ok");
    let (mut buffer, mut gate, mut clock) = ([0; 32_768], FrameGate::new(100), DayClock::new());
    for k in 0..20 {
        let length = data.recv(&mut buffer).unwrap();
        let frame = DataFrame::parse(&buffer[..length]).unwrap();
        let verdict = gate.judge(frame.frame);
        assert!(matches!(verdict, Verdict::First | Verdict::New { skipped: 0 }), "frame {k}: {verdict:?}");
        let pose = frame.pose(0, &mut clock).unwrap().unwrap();
        let off = [pose.position_m[0] - 2.5, pose.position_m[1], pose.position_m[2] - 0.6];
        // Six standard deviations of the noise of 0.2 mm.
        assert!(off.iter().all(|x| x.abs() < 1.2e-3), "{pose:?}");
    }
    assert_eq!(ask(&mut stream, "dtrack2 get status active"), "dtrack2 set status active mea");
    assert_eq!(ask(&mut stream, "dtrack2 tracking stop"), "dtrack2 ok");
    ends.store(true, Ordering::SeqCst);
    let served = server.join().unwrap();
    assert!(served.datagrams >= 20 && served.connections == 1, "{served:?}");
}

#[test]
fn port_that_is_taken_is_reported_with_a_next_step() {
    let first = Sockets::bind(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
    let error = Sockets::bind(first.command_address().unwrap()).unwrap_err();
    assert_eq!(error.next().unwrap(), "choose a port that is free", "{error}");
}
