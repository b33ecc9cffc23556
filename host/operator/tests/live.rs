//! The live view over its port, used by its page and by a foreign page.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use operator::live::{LiveServer, LiveState, LiveTap, ServeError};
use operator::machine::Machine;
use operator::tap::{Tap, Way};
use protocol::powercube::{Parameter, Reply, Value};
use protocol::{Duration, Instant, ModuleId};
use robot_model::RobotModel;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

struct View {
    server: LiveServer,
    tap: LiveTap,
    stop: Arc<AtomicBool>,
}

fn view() -> View {
    let robot = RobotModel::load("powercube6").unwrap();
    let state = LiveState::new(Machine::of(&robot), Duration::ZERO, 1_000_000);
    let (state, stop) = (Arc::new(Mutex::new(state)), Arc::new(AtomicBool::new(false)));
    let any = "127.0.0.1:0".parse().unwrap();
    let page = "<!doctype html><title>page</title>".to_owned();
    let server = LiveServer::start(any, Arc::clone(&state), page, Arc::clone(&stop)).unwrap();
    View { server, tap: LiveTap(state), stop }
}

impl View {
    /// Module `module` reports its position.
    fn tell(&mut self, at_us: u64, module: u8, q_rad: f32) {
        let frame = Reply::Value(Parameter::ActPos, Value::F32(q_rad)).encode(ModuleId::new(module).unwrap());
        self.tap.frame(Instant::from_micros(at_us), Way::Received, &frame).unwrap();
    }

    /// Status line and body of an answer.
    fn ask(&self, head: &str) -> (String, String) {
        let address = self.server.address();
        let mut stream = TcpStream::connect(address).unwrap();
        let head = head.replace("PORT", &address.port().to_string());
        stream.write_all(format!("{}\r\n\r\n", head.replace('\n', "\r\n")).as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        (head.to_owned(), body.to_owned())
    }

    fn open(&self, path: &str, origin: Option<&str>) -> Result<WebSocket<TcpStream>, String> {
        let address: SocketAddr = self.server.address();
        let mut request = format!("ws://{address}{path}").into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", HeaderValue::from_str(origin).unwrap());
        }
        let stream = TcpStream::connect(address).unwrap();
        tungstenite::client(request, stream).map(|(socket, _)| socket).map_err(|error| error.to_string())
    }
}

fn json(socket: &mut WebSocket<TcpStream>) -> serde_json::Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

#[test]
fn a_page_sees_what_drives_report_and_where_the_arm_is() {
    let mut view = view();
    let mut socket = view.open("/live", None).unwrap();
    assert_eq!(json(&mut socket)["placed"], serde_json::Value::Null, "nothing was heard yet");
    let q_rad = [0.1_f32, -0.2, 0.3, -0.4, 0.5, -0.6];
    for (module, q) in (1..).zip(q_rad) {
        view.tell(1_000 * u64::from(module), module, q);
    }
    let seen = loop {
        let seen = json(&mut socket);
        if seen["frames"] == 6 {
            break seen;
        }
    };
    for (joint, q) in seen["joints"].as_array().unwrap().iter().zip(q_rad) {
        assert_eq!(joint["q_rad"].as_f64().unwrap(), f64::from(q));
    }
    assert_eq!(
        seen["joints"][0]["age_s"].as_f64().unwrap(),
        0.005,
        "the first one was heard 5 ms before the last"
    );
    let arm = RobotModel::load("powercube6").unwrap();
    let frames = arm.fk(&robot_model::JointVec::from_fn(6, |j| f64::from(q_rad[j])));
    let hand = arm.ball(&frames).pos;
    for (axis, want) in hand.iter().enumerate() {
        assert!((seen["placed"]["hand_m"][axis].as_f64().unwrap() - want).abs() < 1e-12);
    }
    for (axis, want) in frames.x_w[5].pos.iter().enumerate() {
        assert!((seen["placed"]["links"][5][9 + axis].as_f64().unwrap() - want).abs() < 1e-12);
    }
}

#[test]
fn a_page_can_stop_by_both_ways_and_no_other_message_does_anything() {
    let view = view();
    let mut socket = view.open("/live", None).unwrap();
    json(&mut socket);
    for text in ["", "run", "{\"stop\":true}", "STOP"] {
        socket.send(Message::text(text)).unwrap();
    }
    socket.send(Message::binary(b"stop".to_vec())).unwrap();
    // What comes after them was answered after them.
    for _ in 0..4 {
        json(&mut socket);
    }
    assert!(!view.stop.load(Ordering::Relaxed));
    socket.send(Message::text("stop")).unwrap();
    while !view.stop.load(Ordering::Relaxed) {
        json(&mut socket);
    }
    view.stop.store(false, Ordering::Relaxed);
    let (head, body) = view.ask("POST /stop HTTP/1.1\nHost: 127.0.0.1:PORT\nOrigin: http://127.0.0.1:PORT");
    assert!(head.starts_with("HTTP/1.1 200") && body == "stopping\n", "{head}");
    assert!(view.stop.load(Ordering::Relaxed));
}

#[test]
fn strangers_get_nothing_and_stop_nothing() {
    let view = view();
    let refused = |head: &str, status: &str| {
        let (answer, body) = view.ask(head);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{head}: {answer}");
        assert!(!body.contains("<title>"), "{head}");
    };
    refused("GET / HTTP/1.1\nHost: evil.example:PORT", "403");
    refused("GET / HTTP/1.1\nHost: localhost:PORT\nOrigin: http://evil.example", "403");
    refused("POST /stop HTTP/1.1\nHost: localhost:PORT\nOrigin: null", "403");
    refused("POST /stop HTTP/1.1\nHost: evil.example", "403");
    refused("GET /stop HTTP/1.1\nHost: localhost:PORT", "405");
    refused("GET /etc/passwd HTTP/1.1\nHost: localhost:PORT", "404");
    refused("GET /live HTTP/1.1\nHost: localhost:PORT\nUpgrade: websocket", "400");
    refused("hello", "400");
    refused(&format!("GET / HTTP/1.1\nX: {}", "x".repeat(40_000)), "431");
    assert!(!view.stop.load(Ordering::Relaxed));
    let error = view.open("/live", Some("http://evil.example")).err().unwrap();
    assert!(error.contains("403"), "{error}");
    let (head, body) = view.ask("GET / HTTP/1.1\nHost: localhost:PORT");
    assert!(head.contains("frame-ancestors 'none'") && body.contains("<title>page"), "{head}");
}

#[test]
fn a_port_that_other_machines_reach_is_refused() {
    let robot = RobotModel::load("powercube6").unwrap();
    let state = Arc::new(Mutex::new(LiveState::new(Machine::of(&robot), Duration::ZERO, 1_000_000)));
    let started = LiveServer::start("0.0.0.0:0".parse().unwrap(), state, String::new(), Arc::default());
    assert!(matches!(started.err(), Some(ServeError::NotLoopback(_))));
}

#[test]
fn a_job_that_is_over_leaves_its_last_picture_its_words_and_its_report() {
    let mut view = view();
    let mut socket = view.open("/live", None).unwrap();
    view.tell(1_000, 1, 0.25);
    let report = "GET /report HTTP/1.1\nHost: localhost:PORT";
    assert!(view.ask(report).0.starts_with("HTTP/1.1 404"), "there is none yet");
    assert!(json(&mut socket)["ended"].is_null());
    view.server
        .end("ended: landed 6.3 mm from the target".to_owned(), Some("<title>report</title>".to_owned()));
    let seen = loop {
        let seen = json(&mut socket);
        if !seen["ended"].is_null() {
            break seen;
        }
    };
    assert_eq!(seen["ended"]["text"], "ended: landed 6.3 mm from the target");
    assert_eq!(seen["ended"]["report"], true);
    assert_eq!(seen["joints"][0]["q_rad"], 0.25, "the last picture stays");
    let (head, body) = view.ask(report);
    assert!(head.starts_with("HTTP/1.1 200") && body == "<title>report</title>", "{head}");
}
