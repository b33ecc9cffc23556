//! A client written by hand leads a simulated robot through a small sine path.
//!
//! Controller and client talk over a socket of this machine. The client uses string search only, so it shows what any
//! program has to do: wait for a telegram, take the newest one, answer at once with its IPOC.
//!
//! ```sh
//! cargo run -p hil-sim --example rsi_sine                       # lock step: the robot waits for each answer
//! cargo run -p hil-sim --example rsi_sine -- kr_c4 --real-time  # 4 ms cycles by the clock, with answer times
//! cargo run -p hil-sim --example rsi_sine -- kr_c2_tcp --cycles 10000
//! ```

use std::error::Error;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::path::Path;
use std::thread::JoinHandle;
use std::time::Duration;

use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::serve::{Mode, ServeOptions, serve};
use hil_sim::krc::{KrcEvent, KrcScenario};
use rsi_protocol::Protocol;

/// Amplitude on A1, degrees, and period in telegrams.
const AMPLITUDE_DEG: f64 = 3.0;
const PERIOD: f64 = 400.0;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let name = arguments.first().filter(|word| !word.starts_with('-')).map_or("kr_c2", String::as_str);
    let cycles = arguments.iter().position(|word| word == "--cycles").and_then(|at| arguments.get(at + 1));
    let cycles = cycles.map_or(Ok(2000), |text| text.parse())?;
    let real_time = arguments.iter().any(|word| word == "--real-time");

    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenarios/krc/{name}.toml"));
    let scenario = KrcScenario::load(&path)?;
    let (pc, client) = start_client(scenario.config.protocol)?;
    let options = ServeOptions {
        pc,
        mode: if real_time { Mode::RealTime } else { Mode::LockStep },
        cycles: Some(cycles),
        answer_limit: protocol::Duration::from_secs(10),
    };
    let mut krc = scenario.controller()?;
    let (mut largest, mut largest_lag) = (0.0_f64, 0.0_f64);
    let mut observe = |event: &KrcEvent| {
        if let KrcEvent::Cycle(cycle) = event {
            largest = largest.max(cycle.actual_deg[0].abs());
            largest_lag = largest_lag.max((cycle.actual_deg[0] - cycle.set_deg[0]).abs());
        }
    };
    let mut faults = RobotFaults::new(&scenario.robot_faults);
    let served = serve(&mut krc, &mut scenario.link(), &mut faults, &options, &|| true, &mut observe)?;
    drop(krc);
    let answers = client.join().map_err(|_| "the client ended with a panic")?;

    let mode = if real_time { "in real time" } else { "in lock step" };
    println!(
        "{name}, {:?}, {mode}: {} telegrams, {answers} answers",
        scenario.config.protocol, served.telegrams
    );
    println!("late {}, refused {}, fault {:?}", served.late, served.refused, served.fault);
    println!("A1 moved {largest:.3} deg, largest lag {largest_lag:.3} deg");
    let times: Vec<String> = [0.5, 0.9, 0.99, 0.999, 1.0]
        .iter()
        .filter_map(|share| Some(format!("{} % {}", share * 100.0, served.answer_time(*share)?)))
        .collect();
    println!("answer times: {}; held up {} times", times.join(", "), served.held_up);
    Ok(())
}

/// Listens, and answers in a thread until no telegram came for a second; gives the number of answers.
fn start_client(protocol: Protocol) -> Result<(SocketAddr, JoinHandle<u64>), Box<dyn Error>> {
    let quiet = Some(Duration::from_secs(1));
    match protocol {
        Protocol::Udp => {
            let socket = UdpSocket::bind("127.0.0.1:0")?;
            let address = socket.local_addr()?;
            let answer_all = move || {
                let mut client = Client::default();
                let mut buffer = [0; 2048];
                // The exchange begins when the robot does; it ends when nothing comes any more.
                while let Ok((mut length, mut from)) = socket.recv_from(&mut buffer) {
                    let _ = socket.set_nonblocking(true);
                    // Only the newest telegram is answered.
                    while let Ok((newer, newer_from)) = socket.recv_from(&mut buffer) {
                        (length, from) = (newer, newer_from);
                    }
                    let _ = socket.set_nonblocking(false);
                    let _ = socket.set_read_timeout(quiet);
                    let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
                    if let Some(answer) = client.answer(&text) {
                        let _ = socket.send_to(answer.as_bytes(), from);
                    }
                }
                client.answers
            };
            Ok((address, std::thread::spawn(answer_all)))
        }
        Protocol::Tcp => {
            let listener = TcpListener::bind("127.0.0.1:0")?;
            let address = listener.local_addr()?;
            let answer_all = move || {
                let mut client = Client::default();
                let Ok((mut stream, _)) = listener.accept() else { return 0 };
                let _ = stream.set_nodelay(true);
                let (mut text, mut buffer) = (String::new(), [0; 2048]);
                while let Ok(length @ 1..) = stream.read(&mut buffer) {
                    text.push_str(&String::from_utf8_lossy(&buffer[..length]));
                    // The newest whole telegram; what follows it is the beginning of the next.
                    let Some(end) = text.rfind("</Rob>").map(|at| at + "</Rob>".len()) else { continue };
                    let rest = text.split_off(end);
                    let begin = text.rfind("<Rob ").unwrap_or(0);
                    if let Some(answer) = client.answer(&text[begin..]) {
                        let _ = stream.write_all(answer.as_bytes());
                    }
                    text = rest;
                }
                client.answers
            };
            Ok((address, std::thread::spawn(answer_all)))
        }
    }
}

#[derive(Default)]
struct Client {
    answers: u64,
}

impl Client {
    fn answer(&mut self, telegram: &str) -> Option<String> {
        let ipoc = telegram.split_once("<IPOC>")?.1.split_once("</IPOC>")?.0;
        // The first telegram of a KR C2 has no axes; zeros do no harm.
        let k = if telegram.contains("<AIPos") { self.answers } else { 0 };
        self.answers += u64::from(telegram.contains("<AIPos"));
        // Begins with zero velocity and, by the square, zero acceleration.
        let phase = std::f64::consts::TAU * k as f64 / PERIOD;
        let a1 = AMPLITUDE_DEG * phase.sin() * (k as f64 / PERIOD).min(1.0).powi(2);
        Some(format!(
            "<Sen Type=\"ImFree\"><AKorr A1=\"{a1:.6}\" A2=\"0.0\" A3=\"0.0\" A4=\"0.0\" A5=\"0.0\" A6=\"0.0\"/>\
             <IPOC>{ipoc}</IPOC></Sen>"
        ))
    }
}
