//! The tracker client over sockets of this machine: DTrack with its command channel from the simulated tracker, and a VRPN server.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};

use hil_sim::tracker::serve::Sockets;
use hil_sim::tracker::{BodyMotion, BodyOptions, Tracker, TrackerOptions};
use operator::tracker::client::{Place, TrackerError, measure};
use operator::tracker::target::{NoTarget, Target, TargetRequest};
use protocol::{Duration, Instant};

fn any() -> SocketAddr {
    ([127, 0, 0, 1], 0).into()
}

/// Measures with a simulated tracker of 500 Hz that waits for commands.
fn measured(bodies: Vec<BodyOptions>, body: u32) -> (Result<Target, TrackerError>, bool, u64) {
    let options = TrackerOptions { period: Duration::from_millis(2), bodies, ..TrackerOptions::default() };
    let mut tracker = Tracker::new(options, 5);
    let mut sockets = Sockets::bind(any()).expect("a port");
    let commands = sockets.command_address().expect("bound").to_string();
    let over = AtomicBool::new(false);
    let target = std::thread::scope(|scope| {
        scope.spawn(|| sockets.run(&mut tracker, Instant::FAR_FUTURE, &|| !over.load(Ordering::Relaxed)));
        let place = Place::DTrack { data: any().to_string(), commands: Some(commands) };
        let target = measure(&place, &TargetRequest::new(body), &|| true);
        over.store(true, Ordering::Relaxed);
        target
    });
    (target, tracker.is_measuring(), sockets.served().datagrams)
}

#[test]
fn tracker_is_started_measured_and_stopped_over_its_command_port() {
    let motion = BodyMotion::at_rest([2_500.0, 50.0, 600.0]);
    let (target, measures, datagrams) = measured(vec![BodyOptions { id: 3, motion }], 3);
    let target = target.expect("a target");
    let away = target.mean_m.iter().zip([2.5, 0.05, 0.6]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!((1e-9..1e-4).contains(&away), "{target:?}");
    assert!(!measures && datagrams >= 60, "{datagrams}");
}

#[test]
fn body_that_the_tracker_does_not_see_is_reported_and_the_measurement_is_stopped() {
    let motion = BodyMotion::at_rest([2_500.0, 50.0, 600.0]);
    let (target, measures, _) = measured(vec![BodyOptions { id: 3, motion }], 4);
    assert!(matches!(target, Err(TrackerError::NoTarget(NoTarget::NotSeen { body: 4, .. }))), "{target:?}");
    assert!(!measures);
}

/// Big-endian words of a VRPN message, from the description of the wire format.
fn message(us: u64, sender: i32, kind: i32, body: &[u8]) -> Vec<u8> {
    let mut bytes = (24 + body.len() as u32).to_be_bytes().to_vec();
    for word in [(us / 1_000_000) as i32, (us % 1_000_000) as i32, sender, kind, 0] {
        bytes.extend(word.to_be_bytes());
    }
    bytes.extend(body);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

#[test]
fn target_of_a_vrpn_server_is_measured_and_a_server_that_closes_is_reported() {
    for poses in [200_u64, 20] {
        let listener = TcpListener::bind(any()).expect("a port");
        let server = listener.local_addr().expect("bound").to_string();
        let result = std::thread::scope(|scope| {
            scope.spawn(move || {
                let (mut stream, _) = listener.accept().expect("a client");
                let mut greeting = [0; 24];
                stream.read_exact(&mut greeting).expect("a greeting");
                assert!(greeting.starts_with(b"vrpn: ver. 07."), "{greeting:?}");
                let mut bytes = b"vrpn: ver. 07.35  0\0\0\0\0\0".to_vec();
                for (id, kind, text) in [(0, -1, "Tracker0"), (1, -2, "vrpn_Tracker Pos_Quat")] {
                    let mut body = (text.len() as u32 + 1).to_be_bytes().to_vec();
                    body.extend([text.as_bytes(), &[0]].concat());
                    bytes.extend(message(0, id, kind, &body));
                }
                for k in 0..poses {
                    let mut body = [0; 8].to_vec();
                    for number in [2.5, 0.05, 0.6, 0.0, 0.0, 0.0, 1.0_f64] {
                        body.extend(number.to_be_bytes());
                    }
                    bytes.extend(message(1_000 * k, 0, 1, &body));
                }
                // The client may have enough before all is sent.
                let _ = stream.write_all(&bytes);
            });
            let place = Place::Vrpn { server, tracker: "Tracker0".to_owned() };
            measure(&place, &TargetRequest::new(0), &|| true)
        });
        match poses {
            200 => {
                let mean_m = result.expect("a target").mean_m;
                assert!(
                    mean_m.iter().zip([2.5, 0.05, 0.6]).all(|(a, b)| (a - b).abs() < 1e-12),
                    "{mean_m:?}"
                );
            }
            _ => assert!(matches!(result, Err(TrackerError::Socket { .. })), "{result:?}"),
        }
    }
}
