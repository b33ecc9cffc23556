//! `hil-sim serve` as a process, and clients of its endpoints; for suites that need both.

use std::io::{BufRead, BufReader, Lines, Write};
use std::process::{Child, ChildStdout, Command, Stdio};

use can_link::{BusSpec, CanLink, Clock, LinkEvent, open, wait};
use protocol::{Duration, Frame, StandardId};

/// Longer than anything here takes on a busy machine: only a hang reaches it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

/// A running simulator; killed if a test ends without [`Server::finish`].
pub(crate) struct Server {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
    /// Names of the endpoints, in the order of the command line; specs for clients.
    pub(crate) endpoints: Vec<String>,
}

impl Server {
    /// Starts `program` and waits until all its endpoints are open.
    pub(crate) fn start(program: &str, buses: &[&str]) -> Self {
        let mut command = Command::new(program);
        command.args(["serve", "--json", "--duration-s", "600"]);
        for bus in buses {
            command.args(["--bus", bus]);
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let endpoints = buses
            .iter()
            .map(|_| {
                let line = lines.next().unwrap().unwrap();
                let event: serde_json::Value = serde_json::from_str(&line).unwrap();
                assert_eq!(event["event"], "serving", "{line}");
                event["text"].as_str().unwrap().split(' ').next().unwrap().to_owned()
            })
            .collect();
        Self { child, lines, endpoints }
    }

    pub(crate) fn client(&self, endpoint: usize) -> Client {
        let spec: BusSpec = self.endpoints[endpoint].parse().unwrap();
        let clock = Clock::start();
        Client { link: open(&spec, clock).unwrap(), clock }
    }

    pub(crate) fn say(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// The next event of this kind.
    pub(crate) fn event(&mut self, kind: &str) -> serde_json::Value {
        loop {
            let line = self.lines.next().expect("the simulator still speaks").unwrap();
            let event: serde_json::Value = serde_json::from_str(&line).unwrap();
            if event["event"] == kind {
                return event;
            }
        }
    }

    /// Ends the simulator and returns its report.
    pub(crate) fn finish(mut self) -> serde_json::Value {
        self.say("quit");
        let report = self.event("report");
        assert!(self.child.wait().unwrap().success());
        report
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// One participant behind an endpoint.
pub(crate) struct Client {
    pub(crate) link: Box<dyn CanLink + Send>,
    clock: Clock,
}

impl Client {
    pub(crate) fn send(&mut self, frame: Frame) {
        self.link.send(&frame).unwrap();
    }

    /// Next frame, or `None` after `patience`.
    pub(crate) fn hear(&mut self, patience: Duration) -> Option<Frame> {
        let until = self.clock.now() + patience;
        loop {
            match self.link.receive().unwrap() {
                Some(LinkEvent::Frame { frame, .. }) => return Some(frame),
                Some(LinkEvent::BusError { .. }) => {}
                None if self.clock.now() >= until => return None,
                None => wait(&[&*self.link], &self.clock, Some(until)).unwrap(),
            }
        }
    }

    /// Frames up to the one wanted, which is the last.
    pub(crate) fn hear_until(&mut self, wanted: impl Fn(&Frame) -> bool) -> Vec<Frame> {
        let mut heard = Vec::new();
        loop {
            let frame = self.hear(PATIENCE).unwrap_or_else(|| panic!("not heard; only {heard:?}"));
            heard.push(frame);
            if wanted(&frame) {
                return heard;
            }
        }
    }

    /// Asks a module for its version; true if it answers.
    pub(crate) fn asks_version(&mut self, module: u16) -> bool {
        self.send(version_request(module));
        let answer = self.hear_until(|frame| is_version(module, frame));
        !answer.is_empty()
    }
}

pub(crate) fn id(raw: u16) -> StandardId {
    StandardId::new(raw).unwrap()
}

pub(crate) fn version_request(module: u16) -> Frame {
    Frame::from_array(id(0x0C0 + module), [0x0A, 0x1D])
}

pub(crate) fn is_version(module: u16, frame: &Frame) -> bool {
    frame.id() == id(0x0A0 + module).into() && frame.data().starts_with(&[0x0A, 0x1D])
}
