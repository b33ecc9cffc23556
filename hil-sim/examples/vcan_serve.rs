//! `hil-sim serve` on a CAN interface of a real kernel: run by `.ci/vcan-vm`, as root, with `ip` in the path and no
//! interface up yet.
//!
//!     vcan_serve PATH-OF-HIL-SIM
//!
//! A program and not a test, because it makes interfaces of the machine it runs on.

#[path = "../tests/served/mod.rs"]
mod served;

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Instant as WallClock;

use protocol::{Duration, Frame};
use served::{Client, PATIENCE, Server, id, is_version, version_request};

const HOME_OK: u32 = 0x2;
const RAMP_END: u32 = 0x8000;

fn main() {
    let program = std::env::args().nth(1).expect("the path of hil-sim");
    ip("link add vcan0 type vcan");
    ip("link set vcan0 up");
    // The same bus at a kernel interface and at a TCP port.
    let server = Server::start(&program, &["vcan0", "socketcand://127.0.0.1:0/can0"]);
    let (mut kernel, mut port) = (server.client(0), server.client(1));
    // Whoever answers on the port's bus is there, so the port listens from here on.
    assert!(port.asks_version(1));
    kernel.hear_until(|frame| is_version(1, frame));

    assert_eq!(scan(&mut kernel), [1, 2, 3, 4, 5, 6]);
    println!("scan of vcan0 finds the six drives and nobody else … ok");
    for module in 1..=6 {
        let asked = version_request(module);
        let heard = port.hear_until(|frame| is_version(module, frame));
        assert_eq!(heard.iter().filter(|frame| **frame == asked).count(), 1, "{heard:?}");
    }
    println!("a client at the port has heard each request of the kernel's client once … ok");

    let took = home(&mut kernel, 6);
    println!("drive 6 homed through vcan0 in {took:.1} s … ok");
    let (from, to) = ramp(&mut kernel, 6, 0.3);
    println!("drive 6 moved by ramp from {from:+.4} to {to:+.4} rad … ok");

    let report = server.finish();
    assert_eq!(report["lost"], 0, "{report}");
    println!(
        "{} answers, latency at the simulator in us {} … ok",
        report["latency_us"]["count"], report["latency_us"]
    );

    interface_goes_down(&program);
    println!("an interface that goes down ends the program with code 5 and the command that helps … ok");
    println!("all checks passed");
}

fn ip(arguments: &str) {
    let status = Command::new("ip").args(arguments.split(' ')).status().expect("ip runs");
    assert!(status.success(), "ip {arguments}");
}

/// Asks all addresses for their version; who has answered once nobody has for a while, in the order of the answers.
/// An emulated machine may take its time, so no answer is given up before the last request is out.
fn scan(client: &mut Client) -> Vec<u16> {
    for module in 1..=31 {
        client.send(version_request(module));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let mut found = Vec::new();
    while let Some(frame) = client.hear(Duration::from_secs(3)) {
        found.extend((1..=31).filter(|module| is_version(*module, &frame)));
    }
    found
}

/// Sends a request; data of the answer that repeats its first bytes.
fn ask(client: &mut Client, base: u16, module: u16, data: &[u8]) -> Vec<u8> {
    let echoed = &data[..data.len().min(2)];
    client.send(Frame::new(id(base + module), data).expect("up to eight bytes"));
    let heard = client
        .hear_until(|frame| frame.id() == id(0x0A0 + module).into() && frame.data().starts_with(echoed));
    heard.last().expect("the answer").data().to_vec()
}

fn state(client: &mut Client, module: u16) -> u32 {
    let data = ask(client, 0x0C0, module, &[0x0A, 0x27]);
    u32::from_le_bytes(data[2..].try_into().expect("DLC 6"))
}

fn f32_of(data: &[u8]) -> f32 {
    f32::from_le_bytes(data[2..6].try_into().expect("four bytes"))
}

/// Waits until all of `bits` are set in the state word; seconds.
fn until(client: &mut Client, module: u16, bits: u32) -> f64 {
    let start = WallClock::now();
    while state(client, module) & bits != bits {
        assert!(start.elapsed().as_secs_f64() < PATIENCE.as_secs_f64(), "{:#x}", state(client, module));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    start.elapsed().as_secs_f64()
}

fn home(client: &mut Client, module: u16) -> f64 {
    assert_eq!(ask(client, 0x0E0, module, &[0x00]), [0x00]);
    assert_eq!(ask(client, 0x0E0, module, &[0x01]), [0x01]);
    assert_eq!(state(client, module) & HOME_OK, 0, "HOME_OK falls until homing has ended");
    until(client, module, HOME_OK | RAMP_END)
}

/// SET velocity, SET acceleration, ramp with position in the answer; start and end, rad.
fn ramp(client: &mut Client, module: u16, by: f32) -> (f32, f32) {
    let set = |parameter: u8, value: f32| {
        let [a, b, c, d] = value.to_le_bytes();
        [0x08, parameter, a, b, c, d]
    };
    assert_eq!(ask(client, 0x0E0, module, &set(0x4F, 0.5)), [0x08, 0x4F, 0x64]);
    assert_eq!(ask(client, 0x0E0, module, &set(0x50, 2.0)), [0x08, 0x50, 0x64]);
    let from = f32_of(&ask(client, 0x0C0, module, &[0x0A, 0x3C]));
    let [a, b, c, d] = (from + by).to_le_bytes();
    let answer = ask(client, 0x0E0, module, &[0x0B, 0x0E, a, b, c, d]);
    assert!(answer.len() == 8 && (f32_of(&answer) - from).abs() < 0.01, "{answer:02x?}");
    until(client, module, RAMP_END);
    let to = f32_of(&ask(client, 0x0C0, module, &[0x0A, 0x3C]));
    assert!((to - from - by).abs() < 0.01, "{from} to {to}");
    (from, to)
}

fn interface_goes_down(program: &str) {
    let mut child = Command::new(program)
        .args(["serve", "--bus", "vcan0", "--json", "--duration-s", "60"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("hil-sim runs");
    let mut first = String::new();
    BufReader::new(child.stdout.as_mut().expect("piped")).read_line(&mut first).expect("a line");
    assert!(first.contains("vcan0"), "{first}");
    ip("link set vcan0 down");
    let out = child.wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(5), "{said}");
    assert!(said.contains("sudo ip link set vcan0 up"), "{said}");
}
