//! The whole controller under a script: time passes, drives answer correctly, late, twice, wrongly or not at all,
//! frames of any id and content arrive, and a host gives any order. In every case:
//!
//! * only requests and broadcasts are sent, at most a full queue per call, and every deadline moves on;
//! * no motion is sent in a state that must not move, and no target, speed or acceleration is beyond the limits;
//! * a frame of one drive changes only what is known of that drive.
#![no_main]

use firmware::Controller;
use firmware::authority::{Peer, Seed, sha256};
use firmware::envelope::Envelope;
use firmware::events::{Action, PlanEvents};
use firmware::groups::powercube::PowerCubes;
use firmware::groups::powercube::transmit::QUEUE_LEN;
use firmware::joints::PerJoint;
use firmware::orders::{Done, Order, Target};
use firmware::retarget::EndState;
use firmware::segment;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use firmware::trajectory_format::{self, Header};
use libfuzzer_sys::fuzz_target;
use protocol::cyphal::crc::Crc64;
use protocol::powercube::{
    Address, AddressedRequest, Broadcast, CubeState, Dio, MotionCommand, MotionKind, MotionPosition,
    Parameter, PosStateDio, Reply, Request, ShortState, SimpleCommand, Value,
};
use protocol::units::Radians;
use protocol::{Duration, Frame, Instant, JointIndex, Node};
use protocol_fuzz::Input;

/// The node that gives the orders.
const HOST: Peer = Peer::new(42);

struct Bench {
    controller: Box<Controller<RamStorage, Spline, PowerCubes>>,
    now: Instant,
    /// Requests without an answer so far.
    open: Vec<AddressedRequest>,
    last_reply: Option<Frame>,
    /// Current limits that the drives hold, A, by address.
    max_cur_a: [f32; 32],
    token: u32,
    name: FileName,
    /// Next segment of the plan; empty for a plan that accepts new end states.
    segment: Vec<u8>,
}

impl Bench {
    fn new(segment: Vec<u8>) -> Self {
        let mut settings = Settings::powercube6();
        settings.watchdog_prove = false;
        let controller = Box::new(Controller::new(RamStorage::new(), &settings, Seed::FORESEEABLE));
        let name = FileName { crc64: 0, len: 0 };
        let mut bench =
            Self { controller, now: Instant::ZERO, open: Vec::new(), last_reply: None, max_cur_a: [0.0; 32], token: 0, name, segment };
        bench.pass(2_000_000, true, StateKind::Ready);
        let events = PlanEvents::release(Some(400_000));
        let next = (!bench.segment.is_empty()).then(|| sha256(&bench.segment));
        let envelope = next.is_none().then(|| Envelope::widest(&settings));
        let header = Header { joints: 6, period_us: 3_000, events, envelope, next, ..Header::default() };
        let duration_us = if next.is_some() { 1_300_000 } else { 800_000 };
        let knots = trajectory_format::rest(PerJoint::splat(0.0), duration_us);
        let mut file = [0; 300];
        let len = trajectory_format::encode(&header, &knots, &mut file).unwrap();
        let file = &file[..len];
        bench.controller.upload(bench.now, HOST, 0, file).unwrap();
        bench.name = FileName { crc64: Crc64::of(file), len: len as u32 };
        bench.controller.order(bench.now, HOST, Order::Commit(bench.name)).unwrap();
        bench
    }

    /// Lets time pass; with `answer` the drives answer as they should.
    fn pass(&mut self, us: u64, answer: bool, until: StateKind) {
        let end = self.now + Duration::from_micros(us);
        while self.now < end && self.kind() != until {
            let due = self.controller.poll_timeout().unwrap_or(end).max(self.now);
            self.now = due.min(end);
            if due <= end {
                self.controller.handle_timeout(self.now);
                let next = self.controller.poll_timeout();
                assert!(next.is_none_or(|next| next > self.now), "a deadline stands still");
            }
            self.drain();
            while answer && !self.open.is_empty() {
                self.now += Duration::from_micros(60);
                self.answer(0, 0);
            }
        }
    }

    fn kind(&self) -> StateKind {
        self.controller.state().kind()
    }

    fn drain(&mut self) {
        for count in 0.. {
            let Some(frame) = self.controller.poll_frame() else { return };
            assert!(count <= QUEUE_LEN, "more than a queue full");
            let Ok(asked) = AddressedRequest::decode(&frame) else {
                assert!(Broadcast::decode(&frame).is_ok(), "neither request nor broadcast: {frame}");
                continue;
            };
            self.check(&asked);
            self.open.push(asked);
        }
    }

    fn check(&self, asked: &AddressedRequest) {
        let settings = self.controller.settings();
        let limits = settings.joint.at(settings.joint_of(asked.module).expect("a drive of the group"));
        match asked.request {
            Request::Move(motion) => {
                assert!(self.kind().may_move(), "motion in {:?}", self.kind());
                let MotionCommand::Ramp { target } = motion.command() else { panic!("only ramps") };
                let q = limits.to_joint_rad(target.get());
                let inside = q >= limits.q_min_rad - 1e-5 && q <= limits.q_max_rad + 1e-5;
                // A joint outside its limits is jogged from its position, and stopped there.
                let jogs = matches!(self.kind(), StateKind::Jogging | StateKind::Stopping);
                assert!(inside || jogs, "target {q}");
            }
            Request::Set(Parameter::TargetVel, Value::F32(v)) => {
                assert!((0.0..=limits.v_max_rad_s).contains(&v))
            }
            Request::Set(Parameter::TargetAcc, Value::F32(a)) => {
                assert!((0.0..=limits.a_max_rad_s2).contains(&a))
            }
            Request::Simple(SimpleCommand::Home) => assert_eq!(self.kind(), StateKind::Homing),
            _ => {}
        }
    }

    /// The oldest open request is answered; `bend` and `with` spoil a byte.
    fn answer(&mut self, bend: u8, with: u8) {
        if self.open.is_empty() {
            return;
        }
        let AddressedRequest { module, request, .. } = self.open.remove(0);
        let state = CubeState::HOME_OK.union(CubeState::RAMP_END);
        let short = ShortState::EMPTY;
        let held_a = &mut self.max_cur_a[usize::from(module.get())];
        if let Request::Set(Parameter::MaxCur, Value::F32(written_a)) = request {
            *held_a = written_a;
        }
        let reply = match request {
            Request::Simple(simple) => Reply::Simple(simple),
            Request::Set(parameter, _) => Reply::SetAck { parameter, code: Some(0x64) },
            Request::Get(parameter) => {
                let value = match parameter {
                    Parameter::DefVersion => Value::U16(0x4614),
                    Parameter::Config => Value::U32(1 << 24),
                    Parameter::CubeState => Value::U32(state.bits()),
                    Parameter::MaxCur => Value::F32(*held_a),
                    Parameter::PosStateDio => {
                        Value::PosStateDio(PosStateDio { position_rad: 0.0, short_state: short, dio: Dio(0) })
                    }
                    _ => Value::F32(0.0),
                };
                Reply::Value(parameter, value)
            }
            Request::Move(_) => Reply::MotionExtended {
                kind: MotionKind::Ramp,
                position: MotionPosition::Radians(Radians::new(0.0)),
                short_state: short,
                dio: Dio(0),
            },
            _ => return,
        };
        let mut frame = reply.encode(module);
        if with != 0 {
            let mut data = [0; 8];
            let len = frame.data().len();
            data[..len].copy_from_slice(frame.data());
            data[usize::from(bend) % len.max(1)] ^= with;
            frame = Frame::new(frame.id(), &data[..len]).unwrap();
        }
        self.last_reply = Some(frame);
        self.give(&frame);
    }

    fn give(&mut self, frame: &Frame) {
        let known = |bench: &Self| -> Vec<_> {
            JointIndex::first(6).map(|joint| bench.controller.group().drive(joint).position).collect()
        };
        let before = known(self);
        self.controller.handle_frame(self.now, frame);
        let of = match Address::of(frame.id()) {
            Some(Address::Module(_, module)) => self.controller.settings().joint_of(module),
            _ => None,
        };
        for (joint, (before, after)) in JointIndex::first(6).zip(before.into_iter().zip(known(self))) {
            assert!(Some(joint) == of || before == after, "a frame of another drive moved joint {joint}");
        }
        self.drain();
    }

    fn order(&mut self, order: Order) {
        if let Ok(Done::Offer { token, .. }) = self.controller.order(self.now, HOST, order) {
            self.token = token;
        }
        self.drain();
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut input = Input(bytes);
    // Its content is arbitrary; the digest is right, so that the controller reads it.
    let is_long = bytes.first().is_some_and(|first| first & 1 == 1);
    let segment = if is_long { &bytes[bytes.len() - bytes.len().min(segment::LEN_MAX)..] } else { &[] };
    let mut bench = Bench::new(segment.to_vec());
    while !input.is_empty() {
        let (what, a, b) = (input.byte() % 20, input.byte(), input.byte());
        let valid = Duration::from_secs(5);
        match what {
            0..=4 => bench.pass(40 * u64::from(a), false, StateKind::Boot),
            5..=8 => {
                bench.controller.host_heartbeat(bench.now, HOST);
                bench.pass(1_000 * u64::from(a), true, StateKind::Boot);
            }
            9 => bench.answer(0, 0),
            10 => bench.answer(a, b),
            11 => {
                if let Some(frame) = bench.last_reply {
                    bench.give(&frame);
                }
            }
            12 => {
                let frame = input.frame();
                bench.give(&frame);
            }
            13 => bench.controller.host_heartbeat(bench.now, HOST),
            14 => bench.order(Order::ArmPrepare { crc64: bench.name.crc64, valid }),
            15 => bench.order(Order::ArmConfirm { token: bench.token, valid }),
            16 => bench.order(Order::Run(bench.name)),
            17 => bench.order(Order::Home { mask: a }),
            18 => {
                let Ok(joint) = JointIndex::new(usize::from(a) % 8) else { continue };
                let qd_rad_s = f32::from_bits(u32::from(b) << 24 | input.u32() >> 8);
                bench.order(Order::Jog { joint, qd_rad_s, hold: Duration::from_millis(u64::from(a)) });
            }
            _ => match a % 8 {
                0 => bench.order(Order::Stop),
                1 => bench.order(Order::Disarm),
                2 => bench.order(Order::Gripper { open: b & 1 == 1 }),
                3 => {
                    let start = bench.now + Duration::from_millis(u64::from(b));
                    bench.order(Order::RunAt { name: bench.name, start });
                }
                4 => {
                    let mut state = || f32::from_bits(input.u32());
                    let end = EndState { q_rad: state(), qd_rad_s: state() };
                    let at = bench.now + Duration::from_millis(4 * u64::from(b));
                    let events = [Some((at, Action::Close)).filter(|_| b & 1 == 1), None];
                    bench.order(Order::Retarget(Target {
                        at,
                        joints: 6,
                        state: PerJoint::splat(end),
                        events,
                    }));
                }
                5 => {
                    bench.controller.stop_now(bench.now);
                    bench.drain();
                }
                6 => {
                    let segment = bench.segment.clone();
                    let _ = bench.controller.extend(bench.now, HOST, &segment);
                }
                _ => {
                    let code = bench.controller.state().fault().map_or(0, |fault| fault.cause.code());
                    bench.order(Order::ClearFault { code });
                }
            },
        }
    }
});
