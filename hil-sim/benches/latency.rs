//! How long a client on socketcand waits for an answer: six drives in real time behind a TCP port of this machine.
//!
//! `cargo bench -p hil-sim --bench latency`; prints the distribution, asserts nothing. The simulated part is known (two
//! frames on a bus of 1 Mbit/s and a processing time of 100 to 300 µs drawn for each answer); what is more was added
//! by two programs, the kernel between them and whatever else the machine does.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::{BusSpec, CanLink, Clock, LinkEvent, open, wait};
use hil_sim::realtime::{Door, Realtime};
use hil_sim::scenario::Scenario;
use protocol::bits::length;
use protocol::{Duration, Frame, Instant, StandardId};

const DRIVES: u16 = 6;
const PATIENCE: Duration = Duration::from_secs(1);

fn main() {
    // `cargo test --benches` runs this too: one short round then.
    let rounds = if std::env::args().any(|arg| arg == "--bench") { 2_000 } else { 20 };
    let spec: BusSpec = "socketcand://127.0.0.1:0/can0".parse().expect("a spec");
    let clock = Clock::start();
    let door = Door::open(&spec, clock).expect("a free port");
    let address: BusSpec = door.name().parse().expect("names are specs");
    let over = Arc::new(AtomicBool::new(false));
    let server = std::thread::spawn({
        let over = Arc::clone(&over);
        move || serve(door, clock, &over)
    });
    let mut client = open(&address, clock).expect("the port is served");
    println!("{DRIVES} drives at {address}, {rounds} rounds each way, delays in us:");
    let one: Vec<u64> = (0..rounds).map(|k| ask(&mut *client, &clock, &[1 + k as u16 % DRIVES])[0]).collect();
    show("one request at a time", one);
    let all: Vec<u16> = (1..=DRIVES).collect();
    let last = (0..rounds).map(|_| *ask(&mut *client, &clock, &all).last().expect("six")).collect();
    show("all six asked at once, to the last answer", last);
    over.store(true, Ordering::Relaxed);
    let (late, lost) = server.join().expect("the server ends");
    let (request, answer) = (request(1), Frame::from_array(id(0x0A1), [0x0A, 0x62, 1, 2, 3, 4, 5, 6]));
    let bits = length(&request).with_interframe_space() + length(&answer).frame();
    println!("of one request: {bits} bits on the bus, 100 to 300 processing; the rest is the machine's");
    println!("frames leave late by: {late}; {lost} lost");
}

fn serve(door: Door, clock: Clock, over: &AtomicBool) -> (String, u64) {
    let mut scenario = Scenario::default();
    scenario.cell.drive.starts_homed = true;
    let cell = scenario.cell().expect("built in");
    let mut realtime =
        Realtime::new(cell, scenario.bus, scenario.seed, Vec::new(), vec![door], clock).expect("a world");
    while !over.load(Ordering::Relaxed) {
        realtime.turn(Instant::FAR_FUTURE, &mut ()).expect("the world goes on");
    }
    (realtime.lateness().to_string(), realtime.lost())
}

fn id(raw: u16) -> StandardId {
    StandardId::from_low_bits(raw)
}

/// Position and state of a module.
fn request(module: u16) -> Frame {
    Frame::from_array(id(0x0C0 + module), [0x0A, 0x62])
}

/// Asks all `modules` at once; microseconds until each answer, in the order of their arrival.
fn ask(link: &mut dyn CanLink, clock: &Clock, modules: &[u16]) -> Vec<u64> {
    let start = clock.now();
    for module in modules {
        link.send(&request(*module)).expect("the server reads");
    }
    let mut delays = Vec::with_capacity(modules.len());
    while delays.len() < modules.len() {
        match link.receive().expect("the server lives") {
            Some(LinkEvent::Frame { frame, .. }) if (0x0A1..=0x0A6).contains(&frame.id().raw()) => {
                delays.push(clock.now().saturating_since(start).as_micros());
            }
            Some(_) => {}
            None => wait(&[&*link], clock, Some(start + PATIENCE)).expect("poll works"),
        }
        assert!(clock.now() < start + PATIENCE, "a drive is silent");
    }
    delays
}

fn show(what: &str, mut delays: Vec<u64>) {
    delays.sort_unstable();
    let at = |share: f64| delays[((delays.len() - 1) as f64 * share) as usize];
    println!(
        "  {what:<44} min {:>5}, median {:>5}, 90 % {:>5}, 99 % {:>6}, 99.9 % {:>6}, max {:>6}",
        at(0.0),
        at(0.5),
        at(0.9),
        at(0.99),
        at(0.999),
        at(1.0)
    );
}
