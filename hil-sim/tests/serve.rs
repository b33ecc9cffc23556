//! `hil-sim serve` with several endpoints to one bus, and clients that come, go and misbehave.

use std::io::Write;
use std::net::TcpStream;
use std::process::{Command, Stdio};

use crate::served::{Client, Server, id, is_version, version_request};
use can_link::Clock;
use protocol::Instant;

const PROGRAM: &str = env!("CARGO_BIN_EXE_hil-sim");
const SOCKETCAND: &str = "socketcand://127.0.0.1:0/can0";
const SLCAN_TCP: &str = "slcan://127.0.0.1:0";
const SLCAN_PTY: &str = "slcan:/dev/ptmx";

#[test]
fn clients_of_all_endpoints_share_one_bus_with_the_drives() {
    let server = Server::start(PROGRAM, &[SOCKETCAND, SLCAN_TCP, SLCAN_PTY]);
    let mut clients: Vec<Client> = (0..3).map(|endpoint| server.client(endpoint)).collect();
    // A neighbour behind the first endpoint.
    clients.push(server.client(0));
    // All clients listen before the first frame counts: a drive answers each of them.
    for client in &mut clients {
        assert!(client.asks_version(6));
    }
    for (sender, module) in [(0, 1), (1, 2), (2, 3), (3, 4)] {
        let request = version_request(module);
        clients[sender].send(request);
        for (index, client) in clients.iter_mut().enumerate() {
            let heard = client.hear_until(|frame| is_version(module, frame));
            let requests = heard.iter().filter(|frame| **frame == request).count();
            // All others see the request once, before its answer; the sender does not see its own frame.
            assert_eq!(requests, usize::from(index != sender), "client {index}: {heard:?}");
        }
    }
    let report = server.finish();
    let names: Vec<&str> = report["bus"]["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["name"].as_str().unwrap())
        .collect();
    assert_eq!(names.len(), 6 + 1 + 3, "{names:?}");
    assert!(names[7].starts_with("socketcand://127.0.0.1:"), "{names:?}");
    assert!(names[9].starts_with("slcan:/dev/pts/"), "{names:?}");
    let sent: Vec<u64> = report["bus"]["nodes"].as_array().unwrap()[7..]
        .iter()
        .map(|node| node["sent"].as_u64().unwrap())
        .collect();
    assert_eq!(sent, [4, 2, 2]);
    assert_eq!(report["latency_us"]["count"], 8);
}

#[test]
fn clients_that_vanish_or_send_nonsense_do_not_disturb_others() {
    let server = Server::start(PROGRAM, &[SOCKETCAND, SLCAN_TCP]);
    let mut steady = server.client(0);
    assert!(steady.asks_version(1));
    let address =
        |endpoint: &str| endpoint.split("//").nth(1).unwrap().split(['/', '?']).next().unwrap().to_owned();
    let (socketcand, slcan) = (address(&server.endpoints[0]), address(&server.endpoints[1]));
    for round in 0..10 {
        // Half a frame, then gone; data unread, so that the connection is reset.
        let mut rude = TcpStream::connect(&socketcand).unwrap();
        rude.write_all(b"< open can0 >< rawmode >< send 0C1 2 0A").unwrap();
        let mut vandal = TcpStream::connect(&slcan).unwrap();
        vandal.write_all(b"O\rt0C120A1D\rt0C1\r\xFF\x00garbage without an end").unwrap();
        assert!(steady.asks_version(1 + round % 6));
        drop(rude);
        drop(vandal);
        // The next client finds a working adapter.
        assert!(server.client(1).asks_version(2));
        assert!(steady.asks_version(3));
    }
    let report = server.finish();
    assert_eq!(report["bus"]["nodes"].as_array().map(Vec::len), Some(6 + 1 + 2));
    assert_eq!(report["lost"], 0);
}

#[test]
fn client_that_floods_neither_starves_others_nor_keeps_the_server_awake() {
    let server = Server::start(PROGRAM, &[SOCKETCAND]);
    let address = server.endpoints[0].split('/').nth(2).unwrap().to_owned();
    let mut flood = TcpStream::connect(address).unwrap();
    flood.write_all(b"< open can0 >< rawmode >").unwrap();
    // The answers of the drives are read, as by a client that is in a hurry.
    let mut ear = flood.try_clone().unwrap();
    let reader = std::thread::spawn(move || std::io::copy(&mut ear, &mut std::io::sink()));
    let writer = std::thread::spawn(move || {
        let text = "< send 300 8 1 2 3 4 5 6 7 8 >".repeat(100);
        let mut frames = 0_u64;
        while flood.write_all(text.as_bytes()).is_ok() {
            frames += 100;
        }
        frames
    });
    let mut steady = server.client(0);
    // The flood is on the bus before the first request: a busy machine may start its thread late.
    assert!(!steady.hear_until(|frame| frame.id() == id(0x300).into()).is_empty());
    for round in 0..51 {
        assert!(steady.asks_version(1 + round % 6));
    }
    let report = server.finish();
    let offered = writer.join().unwrap();
    let _ = reader.join();
    let frames = report["world"]["frames"].as_u64().unwrap();
    assert_eq!(report["latency_us"]["count"], 51, "{report}");
    // The flood was carried, and slowed down to what the bus takes.
    assert!((51 * 2 + 51..=51 * 2 + offered).contains(&frames), "{frames} frames, {offered} offered");
    let turns = report["turns"].as_u64().unwrap();
    // A turn for the start and the end of each frame, one for each read of a client, and the regular wake-ups.
    let naps = 1 + (report["simulated_s"].as_f64().unwrap() / 0.05) as u64;
    let reads = frames / 50 + 3 * 51;
    assert!((51..=2 * frames + reads + 2 * naps).contains(&turns), "{turns} turns for {frames} frames");
}

#[test]
fn one_place_that_cannot_be_had_ends_the_program_with_its_name() {
    let out = Command::new(PROGRAM)
        .args(["serve", "--bus", SOCKETCAND, "--bus", "novcan9"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert_eq!(out.status.code(), Some(5));
    assert!(String::from_utf8_lossy(&out.stderr).contains("novcan9"));
}

#[test]
fn a_run_without_clients_ends_at_its_time() {
    let clock = Clock::start();
    let out = Command::new(PROGRAM)
        .args(["serve", "--bus", SOCKETCAND, "--bus", SLCAN_PTY, "--json", "--duration-s", "0.3"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(out.status.success());
    assert!(clock.now() >= Instant::from_micros(300_000));
    let report = String::from_utf8(out.stdout).unwrap().lines().last().unwrap().to_owned();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    // However late the machine is.
    assert_eq!(report["simulated_s"], 0.3, "{report}");
}
