//! One or more drives on a bench or an arm, a clock, and frames without a bus.

use hil_sim::drive::PowerCubeDrive;
use hil_sim::participants::Participants;
use hil_sim::{Cell, CellOptions};
use protocol::powercube::{
    Broadcast, Channel, Config, CubeState, MotionCommand, MotionRequest, Parameter, Reply, Request,
    SimpleCommand, Value,
};
use protocol::units::{RadPerSec, Radians};
use protocol::{Duration, Frame, Instant, ModuleId, StandardId};

pub(crate) const MS: Duration = Duration::from_millis(1);

pub(crate) const GET: u16 = 0x0C1;
pub(crate) const PUT: u16 = 0x0E1;

/// A data frame on an 11-bit id.
pub(crate) fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(StandardId::new(id).unwrap(), data).unwrap()
}

/// Frames as candump writes them.
pub(crate) fn text(frames: &[Frame]) -> Vec<String> {
    frames.iter().map(ToString::to_string).collect()
}

pub(crate) struct Rig {
    pub(crate) cell: Cell,
    pub(crate) now: Instant,
    pub(crate) frames: Vec<(Instant, Frame)>,
}

pub(crate) fn id(address: u8) -> ModuleId {
    ModuleId::new(address).unwrap()
}

impl Rig {
    pub(crate) fn of(cell: Cell) -> Self {
        Self { cell, now: Instant::ZERO, frames: Vec::new() }
    }

    /// One PR-090 with firmware 4614 on the bench, homed at 0.1 rad, option changes by `change`.
    pub(crate) fn homed(change: impl FnOnce(&mut CellOptions)) -> Self {
        Self::bench(0x4614, |options| {
            options.drive.starts_homed = true;
            change(options);
        })
    }

    pub(crate) fn bench(firmware: u16, change: impl FnOnce(&mut CellOptions)) -> Self {
        let mut options = CellOptions::default();
        change(&mut options);
        let mut rig = Self::of(Cell::bench(1, firmware, &options, 1).unwrap());
        // The brake opens within its time-out.
        rig.run_ms(150);
        rig
    }

    pub(crate) fn drive(&self) -> &PowerCubeDrive {
        &self.cell.drives()[0]
    }

    pub(crate) fn drive_mut(&mut self) -> &mut PowerCubeDrive {
        self.cell.drive_mut(0).unwrap()
    }

    fn drain(&mut self) {
        for index in 0..self.cell.len() {
            while let Some(frame) = self.cell.node(index).poll_frame() {
                self.frames.push((self.now, frame));
            }
        }
    }

    /// Serves every deadline up to `until`.
    pub(crate) fn run_until(&mut self, until: Instant) {
        loop {
            let next = (0..self.cell.len())
                .filter_map(|index| self.cell.node(index).poll_timeout().map(|at| (at, index)))
                .filter(|(at, _)| *at <= until)
                .min();
            let Some((at, index)) = next else { break };
            self.now = self.now.max(at);
            self.cell.advance(self.now);
            let now = self.now;
            self.cell.node(index).handle_timeout(now);
            let after = self.cell.node(index).poll_timeout();
            assert!(after.is_none_or(|after| after > now), "a served deadline stays at {after:?}");
            self.drain();
        }
        self.now = until;
        self.cell.advance(until);
    }

    pub(crate) fn run_ms(&mut self, ms: u64) {
        self.run_until(self.now + Duration::from_millis(ms));
    }

    /// Offers a frame to all drives now.
    pub(crate) fn offer(&mut self, frame: &Frame) {
        self.cell.advance(self.now);
        for index in 0..self.cell.len() {
            let now = self.now;
            self.cell.node(index).handle_frame(now, frame);
        }
        self.drain();
    }

    /// Sends a frame and gives what comes back within 2 ms.
    pub(crate) fn exchange(&mut self, frame: &Frame) -> Vec<Frame> {
        self.frames.clear();
        self.offer(frame);
        self.run_ms(2);
        self.frames.iter().map(|(_, frame)| *frame).collect()
    }

    /// The one answer to a request, decoded; `None` for silence.
    pub(crate) fn ask(&mut self, request: Request) -> Option<Reply> {
        self.ask_module(id(1), request)
    }

    pub(crate) fn ask_module(&mut self, module: ModuleId, request: Request) -> Option<Reply> {
        let mut answers = self.exchange(&request.encode(module));
        answers.retain(|frame| frame.id() != Channel::State.id(module));
        assert!(answers.len() <= 1, "{} answers to {request:?}", answers.len());
        let frame = answers.first()?;
        let (from, reply) = Reply::decode(frame).unwrap();
        assert_eq!(from, module);
        assert!(reply.answers(&request), "{reply:?} to {request:?}");
        Some(reply)
    }

    pub(crate) fn simple(&mut self, command: SimpleCommand) -> Option<Reply> {
        self.ask(Request::Simple(command))
    }

    pub(crate) fn get(&mut self, parameter: Parameter) -> f64 {
        match self.ask(Request::Get(parameter)) {
            Some(Reply::Value(_, value)) => value.as_f64().unwrap(),
            other => panic!("{parameter}: {other:?}"),
        }
    }

    pub(crate) fn set(&mut self, parameter: Parameter, value: Value) -> Option<u8> {
        match self.ask(Request::set(parameter, value).unwrap()) {
            Some(Reply::SetAck { code, .. }) => code,
            None => None,
            other => panic!("{parameter}: {other:?}"),
        }
    }

    pub(crate) fn set_f(&mut self, parameter: Parameter, value: f64) {
        assert_eq!(self.set(parameter, Value::F32(value as f32)), Some(0x64), "{parameter}");
    }

    pub(crate) fn add_config(&mut self, bits: Config) {
        let config = Config::from_bits(self.get(Parameter::Config) as u32).union(bits);
        self.set(Parameter::Config, Value::U32(config.bits()));
    }

    pub(crate) fn all(&mut self, broadcast: Broadcast) {
        assert_eq!(self.exchange(&broadcast.encode()), [], "a broadcast is not answered");
    }

    pub(crate) fn state(&mut self) -> CubeState {
        CubeState::from_bits(self.get(Parameter::CubeState) as u32)
    }

    pub(crate) fn move_to(&mut self, target: f64) -> Option<Reply> {
        self.ask(Request::Move(MotionRequest::extended(MotionCommand::Ramp {
            target: Radians::new(target as f32),
        })))
    }

    pub(crate) fn velocity(&mut self, v: f64) -> Option<Reply> {
        self.ask(Request::Move(MotionRequest::extended(MotionCommand::Velocity(RadPerSec::new(v as f32)))))
    }

    /// True joint angle.
    pub(crate) fn q(&self, index: usize) -> f64 {
        self.cell.plant().link_q_rad(index)
    }
}
