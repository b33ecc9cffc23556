//! Host and demo node on one simulated bus in virtual time, with latency and seeded frame loss.

use std::collections::VecDeque;

use protocol::cyphal::bits::{Decode, Encode};
use protocol::cyphal::client::{NoAnswer, Policy, Ticket};
use protocol::cyphal::cubecell::TRAJECTORY_PATH;
use protocol::cyphal::host::{CyphalHost, Listener, RESPONSES};
use protocol::cyphal::id::{NodeId, Route, ServiceId, SubjectId, TransferId};
use protocol::cyphal::rx::{Port, Transfer};
use protocol::cyphal::server::{ControllerServer, NodeCore, Server};
use protocol::cyphal::uavcan::command::{self, CommandRequest, CommandResponse, Status};
use protocol::cyphal::uavcan::file::{self, WriteResponse};
use protocol::cyphal::uavcan::heartbeat;
use protocol::cyphal::uavcan::info::NodeInfo;
use protocol::cyphal::uavcan::port_list;
use protocol::cyphal::uavcan::register::{self, AccessRequest, AccessResponse};
use protocol::cyphal::uavcan::value::{Value, ValueBuf};
use protocol::cyphal::upload::Upload;
use protocol::{Duration, Frame, Instant, Node};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::cyphal_app::DemoApp;

pub(crate) const HOST: u8 = 100;
pub(crate) const SERVER: u8 = 42;
/// A long frame at 1 Mbit/s.
const FRAME_TIME: Duration = Duration::from_micros(140);

pub(crate) fn node(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

/// What a host received: payloads of answers with the zeros behind them, of messages without.
#[derive(Default)]
pub(crate) struct Heard {
    pub(crate) answers: Vec<(Ticket, Result<Vec<u8>, NoAnswer>)>,
    pub(crate) messages: Vec<(Instant, SubjectId, TransferId, Vec<u8>)>,
}

impl Listener for Heard {
    fn info(&self) -> NodeInfo<'_> {
        NodeInfo { name: b"org.cubecell.test", ..NodeInfo::default() }
    }

    fn ports(&self) -> &[Port] {
        const PORTS: [Port; 9] = [
            RESPONSES[0],
            RESPONSES[1],
            RESPONSES[2],
            RESPONSES[3],
            RESPONSES[4],
            RESPONSES[5],
            RESPONSES[6],
            heartbeat::PORT,
            Port::message(port_list::SUBJECT, port_list::EXTENT),
        ];
        &PORTS
    }

    fn message(&mut self, now: Instant, transfer: &Transfer<'_>) {
        if let Route::Message { subject, .. } = transfer.route {
            let payload = transfer.payload[..transfer.len].to_vec();
            self.messages.push((now, subject, transfer.transfer_id, payload));
        }
    }

    fn answer(&mut self, _: Instant, ticket: Ticket, answer: Result<&Transfer<'_>, NoAnswer>) {
        self.answers.push((ticket, answer.map(|transfer| transfer.payload.to_vec())));
    }
}

/// Chooses which frames are lost.
pub(crate) struct Dice(SplitMix64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0.next_u64() % n
    }
}

/// Two nodes and the bus between them.
pub(crate) struct Rig {
    pub(crate) host: CyphalHost<Heard>,
    pub(crate) server: ControllerServer<DemoApp>,
    pub(crate) now: Instant,
    /// Frames under way: arrival, to the server or to the host.
    pub(crate) bus: VecDeque<(Instant, bool, Frame)>,
    pub(crate) bus_free: Instant,
    /// Time from the end of a frame on the bus to its arrival.
    pub(crate) latency: Duration,
    /// One in this many frames is lost; 0 = none.
    pub(crate) loss: u64,
    pub(crate) dice: Dice,
    /// Everything that was on the bus.
    pub(crate) log: Vec<Frame>,
}

impl Rig {
    pub(crate) fn new(seed: u64) -> Self {
        let now = Instant::ZERO;
        Self {
            host: CyphalHost::new(now, node(HOST), Heard::default()),
            server: Server { core: NodeCore::new(now, node(SERVER)), app: DemoApp::new() },
            now,
            bus: VecDeque::new(),
            bus_free: now,
            latency: Duration::ZERO,
            loss: 0,
            dice: Dice::new(seed),
            log: Vec::new(),
        }
    }

    /// Takes what the nodes want to send onto the bus, one frame of each in turn.
    pub(crate) fn collect(&mut self) {
        loop {
            let frames = [(true, self.host.poll_frame()), (false, self.server.poll_frame())];
            if frames.iter().all(|(_, frame)| frame.is_none()) {
                return;
            }
            for (to_server, frame) in frames {
                if let Some(frame) = frame {
                    self.put(to_server, frame);
                }
            }
        }
    }

    pub(crate) fn put(&mut self, to_server: bool, frame: Frame) {
        self.bus_free = self.bus_free.max(self.now) + FRAME_TIME;
        self.log.push(frame);
        if self.loss == 0 || self.dice.below(self.loss) != 0 {
            self.bus.push_back((self.bus_free + self.latency, to_server, frame));
        }
    }

    /// Next event: a frame or a deadline; false if it is after `until`.
    pub(crate) fn step(&mut self, until: Instant) -> bool {
        self.collect();
        let timers = [self.host.poll_timeout(), self.server.poll_timeout()];
        let timer = timers.into_iter().flatten().min().unwrap_or(Instant::FAR_FUTURE);
        let arrival = self.bus.front().map_or(Instant::FAR_FUTURE, |(at, ..)| *at);
        let next = timer.min(arrival);
        if next > until {
            self.now = until;
            return false;
        }
        self.now = next;
        if arrival <= timer {
            if let Some((_, to_server, frame)) = self.bus.pop_front() {
                let receiver: &mut dyn Node = if to_server { &mut self.server } else { &mut self.host };
                receiver.handle_frame(self.now, &frame);
            }
        } else {
            self.host.handle_timeout(self.now);
            self.server.handle_timeout(self.now);
            let after = [self.host.poll_timeout(), self.server.poll_timeout()];
            assert!(after.into_iter().flatten().all(|due| due > self.now), "deadlines move on");
        }
        true
    }

    pub(crate) fn run(&mut self, span: Duration) {
        let until = self.now + span;
        while self.step(until) {}
    }

    pub(crate) fn start(&mut self, service: ServiceId, request: &dyn Encode) -> Ticket {
        self.start_with(Policy::default(), service, request)
    }

    fn start_with(&mut self, policy: Policy, service: ServiceId, request: &dyn Encode) -> Ticket {
        self.host.request(self.now, node(SERVER), service, policy, request).unwrap()
    }

    /// Asks and waits: payload with zeros behind it, as decoders expect it.
    pub(crate) fn ask(&mut self, service: ServiceId, request: &dyn Encode) -> Result<Vec<u8>, NoAnswer> {
        self.ask_with(Policy::default(), service, request)
    }

    fn ask_with(
        &mut self,
        policy: Policy,
        service: ServiceId,
        request: &dyn Encode,
    ) -> Result<Vec<u8>, NoAnswer> {
        let ticket = self.start_with(policy, service, request);
        let until = self.now + Duration::from_secs(60);
        while self.step(until) {
            let answers = &mut self.host.listener.answers;
            if let Some(index) = answers.iter().position(|(answered, _)| *answered == ticket) {
                return answers.remove(index).1;
            }
        }
        panic!("neither answer nor failure within a minute");
    }

    pub(crate) fn access(&mut self, name: &str, value: Value<'_>) -> (bool, bool, ValueBuf) {
        let request = AccessRequest { name: name.as_bytes(), value };
        let bytes = self.ask(register::ACCESS, &request).unwrap();
        let response = AccessResponse::from_bytes(&bytes).unwrap();
        (response.mutable, response.persistent, response.value.into())
    }

    pub(crate) fn command(&mut self, command: u16, parameter: &[u8]) -> (Status, Vec<u8>) {
        let bytes = self.ask(command::SERVICE, &CommandRequest { command, parameter }).unwrap();
        let response = CommandResponse::from_bytes(&bytes).unwrap();
        (response.status, response.output.to_vec())
    }

    /// Uploads a file piece by piece; the number of requests that were given up and begun again.
    pub(crate) fn upload(&mut self, data: &[u8]) -> usize {
        let mut upload = Upload::new(TRAJECTORY_PATH, data);
        let mut failures = 0;
        while let Some(request) = upload.request() {
            match self.ask_with(Policy::FILE, file::WRITE, &request) {
                Ok(bytes) => {
                    upload.answered(WriteResponse::from_bytes(&bytes).unwrap().result).unwrap();
                }
                Err(NoAnswer { .. }) => failures += 1,
            }
            assert!(failures < 100);
        }
        failures
    }
}
