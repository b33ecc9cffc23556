//! Host with node-ID 42 at the other end of the controller's Cyphal link, controlled by a test.

use std::collections::VecDeque;

use firmware::authority::Seed;
use firmware::groups::powercube::PowerCubes;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use firmware::{Controller, ControllerNode};
use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::cubecell::command::{self, ArmConfirm, ArmOffer, ArmPrepare, Trajectory};
use protocol::cyphal::cubecell::target::{self, TargetJoint, TargetState};
use protocol::cyphal::cubecell::{group_state, joint_state};
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::command::{CommandRequest, CommandResponse, Status};
use protocol::cyphal::uavcan::file::{WriteRequest, WriteResponse};
use protocol::cyphal::uavcan::heartbeat::{Health, Heartbeat, Mode};
use protocol::cyphal::uavcan::{command as commands, diagnostic, file, heartbeat, register};
use protocol::{Duration, Frame, Instant, Node};

use super::*;

/// One call of the node contract and what came out of it.
#[derive(Clone, Debug)]
pub(crate) struct Call {
    pub at: Instant,
    /// `None`: a deadline.
    pub input: Option<Frame>,
}

/// A node that records its calls and what it sends.
pub(crate) struct Recorder {
    pub node: ControllerNode<RamStorage, Spline, PowerCubes>,
    pub calls: Vec<Call>,
    pub frames: Vec<(Instant, Frame)>,
}

impl Node for Recorder {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.calls.push(Call { at: now, input: Some(*frame) });
        self.node.handle_frame(now, frame);
    }
    fn handle_timeout(&mut self, now: Instant) {
        self.calls.push(Call { at: now, input: None });
        self.node.handle_timeout(now);
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        let frame = self.node.poll_frame()?;
        let at = self.calls.last().map_or(Instant::ZERO, |call| call.at);
        self.frames.push((at, frame));
        Some(frame)
    }
    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }
}

impl Controlled for Recorder {
    fn core(&self) -> &Controller<RamStorage, Spline, PowerCubes> {
        self.node.controller()
    }
    fn core_mut(&mut self) -> &mut Controller<RamStorage, Spline, PowerCubes> {
        panic!("only the host link gives orders here")
    }
}

/// Host with node-ID 42, controlled by the test.
pub(crate) struct Host<C = Recorder> {
    pub bench: Bench<C>,
    pub rx: Receiver<8, 4, 600>,
    pub tx: TxQueue<4, 600>,
    pub transfer: TransferId,
    pub address: NodeId,
    pub seen: usize,
    pub group: Option<group_state::GroupState>,
    pub joints: usize,
    pub beat_due: u64,
    /// Time between two heartbeats, µs.
    pub beat_us: u64,
    /// Texts of the diagnostic records that the controller sent.
    pub records: Vec<String>,
    pub beating: bool,
    /// Time between two frames of a transfer of the lowest priority, µs.
    pub gap_us: u64,
    slow: VecDeque<Frame>,
    slow_due: u64,
    /// Uptime in the heartbeats, s.
    pub uptime_s: u32,
}

pub(crate) const SERVER: NodeId = NodeId::from_low_bits(10);
pub(crate) const PORTS: [Port; 8] = [
    Port::response(commands::SERVICE, commands::RESPONSE_EXTENT),
    Port::response(file::WRITE, file::WRITE_RESPONSE_EXTENT),
    Port::response(file::READ, file::READ_RESPONSE_EXTENT),
    Port::response(file::LIST, file::LIST_RESPONSE_EXTENT),
    Port::message(diagnostic::SUBJECT, diagnostic::EXTENT),
    Port::response(register::ACCESS, register::ACCESS_RESPONSE_EXTENT),
    Port::message(group_state::SUBJECT, group_state::EXTENT),
    Port::message(joint_state::SUBJECT, joint_state::EXTENT),
];

impl Host {
    pub(crate) fn node(
        storage: RamStorage,
        options: &Options,
    ) -> ControllerNode<RamStorage, Spline, PowerCubes> {
        let (identity, seed) = (Default::default(), Seed::FORESEEABLE);
        ControllerNode::new(Instant::ZERO, storage, &options.settings, identity, seed)
    }

    pub(crate) fn new() -> Self {
        let options = Options::default();
        let node = Self::node(RamStorage::new(), &options);
        Self::over(Recorder { node, calls: Vec::new(), frames: Vec::new() }, options)
    }

    /// A stop by the program that runs the node, not over the link.
    pub(crate) fn stop_node(&mut self) {
        let at = self.bench.instant();
        self.bench.controller.node.stop_now(at);
        self.bench.drain();
    }
}

impl<C: Controlled> Host<C> {
    /// Host of `controlled`, whose drives stand where the throw begins.
    pub(crate) fn over(controlled: C, options: Options) -> Self {
        let mut bench = Bench::with(controlled, options);
        bench.heartbeat = false;
        for (drive, q) in bench.drives.iter_mut().zip(throw_start()) {
            drive.place(q);
        }
        Self {
            bench,
            rx: Receiver::new(),
            tx: TxQueue::new(),
            transfer: TransferId::ZERO,
            address: NodeId::from_low_bits(42),
            seen: 0,
            group: None,
            joints: 0,
            beat_due: 0,
            beat_us: 30_000,
            records: Vec::new(),
            beating: true,
            gap_us: 0,
            slow: VecDeque::new(),
            slow_due: 0,
            uptime_s: 7,
        }
    }

    pub(crate) fn send(&mut self, route: Route, priority: Priority, message: &dyn Encode) {
        let deadline = self.bench.instant() + Duration::from_secs(1);
        self.transfer = self.transfer.next();
        self.tx.push(&TxMeta { route, priority, transfer_id: self.transfer, deadline }, message).unwrap();
        while let Some(frame) = self.tx.pop() {
            // Only frames of the long transfers wait; others go at once.
            if self.gap_us > 0 && priority == Priority::Optional {
                self.slow.push_back(frame);
            } else {
                self.bench.foreign(frame);
            }
        }
    }

    /// Lets `us` pass, with heartbeats; the first response goes to `take`.
    pub(crate) fn run(&mut self, us: u64, mut take: impl FnMut(ServiceId, &[u8])) {
        let end = self.bench.now + us;
        while self.bench.now < end {
            if self.beating && self.bench.now >= self.beat_due {
                self.beat_due = self.bench.now + self.beat_us;
                let beat = Heartbeat {
                    uptime_s: self.uptime_s,
                    health: Health::Nominal,
                    mode: Mode::OPERATIONAL,
                    vendor_status: 0,
                };
                let route = Route::Message { subject: heartbeat::SUBJECT, source: self.address };
                self.send(route, Priority::Nominal, &beat);
            }
            if self.bench.now >= self.slow_due
                && let Some(frame) = self.slow.pop_front()
            {
                self.slow_due = self.bench.now + self.gap_us;
                self.bench.foreign(frame);
            }
            self.bench.run_for(1_000.min(end - self.bench.now));
            let frames: Vec<(Instant, Frame)> = self.bench.log[self.seen..]
                .iter()
                .filter(|l| l.by_controller)
                .map(|l| (l.at, l.frame))
                .collect();
            self.seen = self.bench.log.len();
            for (at, frame) in frames.iter().filter(|(_, frame)| frame.is_extended()) {
                let Some(transfer) = self.rx.accept(*at, Some(self.address), frame, &[&PORTS]) else {
                    continue;
                };
                match transfer.route {
                    Route::Response { service, .. } => take(service, transfer.payload),
                    Route::Message { subject, .. } if subject == group_state::SUBJECT => {
                        self.group = Some(group_state::GroupState::from_bytes(transfer.payload).unwrap());
                    }
                    Route::Message { subject, .. } if subject == joint_state::SUBJECT => {
                        assert_eq!(
                            joint_state::JointState::from_bytes(transfer.payload).unwrap().joints().len(),
                            6
                        );
                        self.joints += 1;
                    }
                    Route::Message { subject, .. } if subject == diagnostic::SUBJECT => {
                        let record = diagnostic::Record::from_bytes(transfer.payload).unwrap();
                        self.records.push(String::from_utf8(record.text.to_vec()).unwrap());
                    }
                    _ => {}
                }
            }
        }
    }

    pub(crate) fn ask(&mut self, service: ServiceId, request: &dyn Encode) -> Vec<u8> {
        let route = Route::Request { service, source: self.address, destination: SERVER };
        let priority = if self.gap_us > 0 { Priority::Optional } else { Priority::Nominal };
        self.send(route, priority, request);
        let mut answer = None;
        for _ in 0..100 {
            self.run(2_000, |from, payload| {
                if from == service {
                    answer = Some(payload.to_vec());
                }
            });
            if let Some(answer) = answer {
                return answer;
            }
        }
        panic!("no answer")
    }

    pub(crate) fn command(&mut self, number: u16, parameter: &dyn Encode) -> (Status, Vec<u8>) {
        let mut bytes = [0; 255];
        let mut writer = Writer::new(&mut bytes);
        parameter.encode(&mut writer);
        let len = writer.finish().unwrap();
        let answer =
            self.ask(commands::SERVICE, &CommandRequest { command: number, parameter: &bytes[..len] });
        let response = CommandResponse::from_bytes(&answer).unwrap();
        (response.status, response.output.to_vec())
    }

    pub(crate) fn upload(&mut self, bytes: &[u8]) {
        for (i, data) in bytes.chunks(256).chain([&[][..]]).enumerate() {
            let offset = if data.is_empty() { bytes.len() } else { 256 * i } as u64;
            let request = WriteRequest { offset, path: b"trajectory", data };
            let answer = self.ask(file::WRITE, &request);
            assert_eq!(WriteResponse::from_bytes(&answer).unwrap().result, Ok(()));
        }
    }

    /// A new end state of all joints at `arrive_us`.
    pub(crate) fn send_target(&mut self, sequence: u8, arrive_us: u64, state: [(f64, f64); 6]) {
        let joints = state.map(|(q, qd)| TargetJoint { q_urad: (q * 1e6) as i32, qd_rad_s: qd as f32 });
        let route = Route::Message { subject: target::SUBJECT, source: self.address };
        self.send(route, Priority::Fast, &TargetState::new(arrive_us, sequence, &joints, &[]));
    }

    pub(crate) fn armed(&mut self) -> Trajectory {
        self.run(800_000, |_, _| {});
        assert_eq!(self.bench.kind(), StateKind::Ready);
        self.arm(&throw_file(3_000, false))
    }

    /// Uploads, commits and arms.
    pub(crate) fn arm(&mut self, bytes: &[u8]) -> Trajectory {
        self.upload(bytes);
        let name = Trajectory { trajectory_crc64: Crc64::of(bytes), length_bytes: bytes.len() as u32 };
        assert_eq!(self.command(command::COMMIT_TRAJECTORY, &name).0, Status::SUCCESS);
        let prepare = ArmPrepare { trajectory_crc64: name.trajectory_crc64, valid_ms: 5_000 };
        let (status, output) = self.command(command::ARM_PREPARE, &prepare);
        assert_eq!(status, Status::SUCCESS);
        let offer = ArmOffer::from_bytes(&output).unwrap();
        assert_eq!(offer.valid_ms, 5_000);
        let confirm = ArmConfirm { token: offer.token, valid_ms: 5_000 };
        assert_eq!(self.command(command::ARM_CONFIRM, &confirm).0, Status::SUCCESS);
        self.run(60_000, |_, _| {});
        name
    }
}
