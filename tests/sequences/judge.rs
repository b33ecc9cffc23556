//! The rules. They see frames with their times, and the drives and joints themselves; never the controller's inside.

mod plant;

use protocol::cyphal::bits::Decode;
use protocol::cyphal::cubecell::command;
use protocol::cyphal::cubecell::group_state::{self, GroupState, State};
use protocol::cyphal::id::{Route, ServiceId, Tail, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::uavcan::command::{self as commands, CommandResponse, Status};
use protocol::cyphal::uavcan::file::{self, WriteResponse};
use protocol::cyphal::uavcan::register::{self, AccessResponse};
use protocol::powercube::{AddressedRequest, Broadcast, MotionCommand, Parameter, Request, Value};
use protocol::{Duration, Frame, Instant};

use crate::families::Family;
use crate::lab::{CLIENTS, CONTROLLER, JOINTS, Lab, OPENING_MS};
use crate::rules::{Rule, Taken, Violation};
use crate::steps::{Hand, Register};

/// An order as it is on the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Order {
    Home(u8),
    Jog { joint: usize, v_rad_s: f64, hold: Duration },
    Stop,
    StopMessage,
    EmergencyStop,
    Disarm,
    Clear(u16),
    Write(Register),
    Piece,
    Commit,
    Prepare,
    Confirm,
    Run { start: Option<Instant>, hand: Hand },
    Other,
}

impl Order {
    const fn is_stop(self) -> bool {
        matches!(self, Self::Stop | Self::StopMessage | Self::EmergencyStop)
    }
}

#[derive(Debug)]
struct Sent {
    client: usize,
    transfer: TransferId,
    /// Service or subject of its frames.
    port: u16,
    order: Order,
    /// The controller has it: its last frame ended and the controller was called.
    done: Option<Instant>,
    answered: bool,
}

/// Leave to move.
#[derive(Clone, Copy, Debug)]
struct Permit {
    sent: usize,
    joints: u8,
    /// Speed of a jog, 0 for any.
    v_rad_s: f64,
    from: Instant,
    until: Instant,
    brake: Duration,
    /// Where the joints were at `until`, and how fast.
    let_go: Option<[(f64, f64); JOINTS]>,
}

/// Speed below which a joint stands, rad/s.
const STILL_RAD_S: f64 = 0.02;
const JOG_A_RAD_S2: f64 = 1.0;
/// Highest speed and acceleration that may be written to a drive.
const V_MAX_RAD_S: f64 = 2.6006;
const A_MAX_RAD_S2: f64 = 10.4001;
/// From the end of an order to the command that ends the motion: a period of the monitor, an answer, the drive's lag.
const SLACK: Duration = Duration::from_millis(60);
const BRAKE_OF_HALT: Duration = Duration::from_millis(400);
const BRAKE_OF_STOP: Duration = Duration::from_millis(700);
const BRAKE_OF_HOMING: Duration = Duration::from_millis(300);
/// A halt is on the bus so long after the stop.
const HALT_WITHIN: Duration = Duration::from_millis(3);
/// From the start of a run to the end of its first motion command.
const START_WITHIN: Duration = Duration::from_millis(8);
/// A start is ordered so long before it, or refused.
const START_LEAD: Duration = Duration::from_millis(6);
/// Armed for so long, the drives hold what they must.
const HELD_AFTER: Duration = Duration::from_millis(150);
/// Fault of a joint that moves although the group stands.
const MOVES_UNORDERED: u16 = 108;
/// Fault of a drive that reports an error or a halt.
const DRIVE_ERROR: u16 = 200;
const NEVER: Instant = Instant::FAR_FUTURE;

const PORTS: [Port; 4] = [
    Port::response(commands::SERVICE, commands::RESPONSE_EXTENT),
    Port::response(file::WRITE, file::WRITE_RESPONSE_EXTENT),
    Port::response(register::ACCESS, register::ACCESS_RESPONSE_EXTENT),
    Port::message(group_state::SUBJECT, group_state::EXTENT),
];

/// Sees all and decides.
pub(crate) struct Judge {
    /// A halt is a frame that it reads.
    sees_halts: bool,
    rx: [Receiver<8, 4, 600>; 2],
    sent: Vec<Sent>,
    permits: Vec<Permit>,
    /// Beginnings, ends of what disturbs bus or controller, and whether a drive misses commands by it.
    disturbed: Vec<(Instant, Instant)>,
    deaf_until: Instant,
    restarted_at: Option<Instant>,
    pub(crate) state: Option<GroupState>,
    state_since: Instant,
    /// Last offer.
    pub(crate) token: u32,
    last_stop: Option<Instant>,
    last_prepare: Option<Instant>,
    last_confirm: Option<Instant>,
    last_commit: Option<Instant>,
    last_limit: Option<Instant>,
    /// A clear of this fault is given, and not refused.
    cleared: Option<u16>,
    cleared_at_rest: bool,
    halt_due: Option<(Instant, Instant)>,
    start: Option<Instant>,
    hand_due: Option<(Instant, usize)>,
    q_max: f64,
    current_a: f64,
    watchdog: bool,
    plant: [(f64, f64); JOINTS],
    homed: [bool; JOINTS],
    pub(crate) violations: Vec<Violation>,
    /// Orders that were taken, by kind, and stops while a joint moved.
    pub(crate) taken: Taken,
}

impl Judge {
    pub(crate) fn new<F: Family>() -> Self {
        Self {
            sees_halts: F::IS_POWERCUBE,
            rx: [Receiver::new(), Receiver::new()],
            sent: Vec::new(),
            permits: Vec::new(),
            disturbed: Vec::new(),
            deaf_until: Instant::ZERO,
            restarted_at: None,
            state: None,
            state_since: Instant::ZERO,
            token: 0,
            last_stop: None,
            last_prepare: None,
            last_confirm: None,
            last_commit: None,
            last_limit: None,
            cleared: None,
            cleared_at_rest: true,
            halt_due: None,
            start: None,
            hand_due: None,
            q_max: 1.0,
            current_a: 30.0,
            watchdog: true,
            plant: [(0.0, 0.0); JOINTS],
            homed: [true; JOINTS],
            violations: Vec::new(),
            taken: Taken::default(),
        }
    }

    fn kind(&self) -> Option<State> {
        self.state.map(|state| state.state)
    }

    fn broken(&mut self, rule: Rule, at: Instant, what: String) {
        self.violations.push(Violation { rule, at, what });
    }

    /// A client has begun to send an order.
    pub(crate) fn sends(&mut self, client: usize, transfer: TransferId, port: u16, order: Order) {
        self.sent.push(Sent { client, transfer, port, order, done: None, answered: false });
    }

    /// Something delays what the controller does, or the drives.
    pub(crate) fn disturb(&mut self, from: Instant, ms: u16) {
        self.disturbed.push((from, from + Duration::from_millis(ms.into())));
    }

    pub(crate) fn deafen(&mut self, from: Instant, ms: u16) {
        self.disturb(from, ms);
        self.deaf_until = self.deaf_until.max(from + Duration::from_millis(ms.into()));
    }

    pub(crate) fn restart(&mut self, at: Instant) {
        self.restarted_at = Some(at);
        self.disturb(at, 600);
    }

    /// What disturbances of the time before `at` may have cost.
    fn excuse(&self, at: Instant) -> Duration {
        let since = at.saturating_sub(Duration::from_millis(1_000));
        let overlaps = self.disturbed.iter().filter(|(_, end)| *end > since);
        overlaps.fold(Duration::ZERO, |sum, (from, end)| sum + end.saturating_since(*from))
    }

    /// A frame ended on the bus.
    pub(crate) fn frame<F: Family>(&mut self, lab: &Lab<F>, at: Instant, from: Option<usize>, frame: &Frame) {
        match from {
            Some(CONTROLLER) if frame.is_extended() => self.message(at, frame),
            Some(CONTROLLER) if F::IS_POWERCUBE => self.request(at, frame),
            Some(port) if port > CONTROLLER => self.client_frame(lab, at, port - CONTROLLER - 1, frame),
            _ => {}
        }
    }

    /// A frame of a client: the last one of an order gives the order to the controller.
    fn client_frame<F: Family>(&mut self, lab: &Lab<F>, at: Instant, client: usize, frame: &Frame) {
        let Some(tail) = frame.data().last().map(|byte| Tail::parse(*byte)).filter(|tail| tail.end) else {
            return;
        };
        let protocol::Id::Extended(id) = frame.id() else { return };
        let Ok((_, route)) = Route::parse(id) else { return };
        let port = match route {
            Route::Message { subject, .. } | Route::Anonymous { subject, .. } => subject.get(),
            Route::Request { service, .. } | Route::Response { service, .. } => service.get(),
        };
        let mine = |sent: &Sent| {
            sent.done.is_none()
                && sent.client == client
                && sent.transfer == tail.transfer_id
                && sent.port == port
        };
        let Some(index) = self.sent.iter().position(mine) else { return };
        let done = at.max(lab.held_until());
        self.sent[index].done = Some(done);
        self.given(done, index);
    }

    /// The controller has an order.
    fn given(&mut self, at: Instant, index: usize) {
        let mut permit = Permit {
            sent: index,
            joints: 0,
            v_rad_s: 0.0,
            from: at,
            until: NEVER,
            brake: BRAKE_OF_STOP,
            let_go: None,
        };
        match self.sent[index].order {
            Order::Clear(number) => {
                let fault = self.state.filter(|state| state.state == State::Fault);
                if fault.is_some_and(|fault| fault.fault_cause == number) {
                    self.cleared = Some(number);
                    self.cleared_at_rest = self.plant.iter().all(|(_, v)| v.abs() < 0.05);
                }
                return;
            }
            order if order.is_stop() => {
                let moves = self.plant.iter().any(|(_, v)| v.abs() > STILL_RAD_S);
                self.taken.stops_in_motion += u32::from(moves);
                let halts = order != Order::Stop;
                let brake = if halts { BRAKE_OF_HALT } else { BRAKE_OF_STOP };
                self.end_permits(at, brake);
                self.last_stop = Some(at);
                (self.start, self.hand_due) = (None, None);
                if halts && self.sees_halts {
                    self.halt_due = self.halt_due.or(Some((at, at + HALT_WITHIN)));
                }
                return;
            }
            Order::Disarm => {
                // Ends an arming, not a run.
                let waits = self.start.is_some_and(|start| start > at + SLACK);
                if waits {
                    self.end_permits(at, Duration::ZERO);
                    self.start = None;
                }
                self.last_stop = if self.kind() == Some(State::Running) { self.last_stop } else { Some(at) };
                return;
            }
            Order::Jog { joint, v_rad_s, hold } if v_rad_s != 0.0 => {
                permit.joints = 1 << joint;
                permit.v_rad_s = v_rad_s;
                permit.until = at + hold;
                permit.brake = Duration::from_secs_f64(v_rad_s.abs() / JOG_A_RAD_S2) + SLACK;
            }
            Order::Home(mask) => (permit.joints, permit.brake) = (mask, BRAKE_OF_HOMING),
            // Refused: an earlier order may run still.
            Order::Run { start: Some(start), .. } if start < at + START_LEAD => return,
            Order::Run { start, hand } => {
                permit.joints = 0xFF;
                permit.from = start.map_or(at, |start| start.saturating_sub(SLACK).max(at));
                // One that begins at once replaces one that is due.
                self.start = start;
                let switches = match hand {
                    Hand::Open(ms) => Some(ms),
                    Hand::CloseAndOpen(ms) => Some(ms + OPENING_MS),
                    Hand::Nothing => None,
                };
                if let (Some(start), Some(ms)) = (start, switches) {
                    let left = Duration::from_millis(ms.saturating_sub(OPENING_MS).into());
                    self.hand_due = Some((start + left + Duration::from_millis(15), index));
                }
            }
            _ => return,
        }
        self.permits.push(permit);
    }

    /// Every leave to move ends at `at`.
    fn end_permits(&mut self, at: Instant, brake: Duration) {
        self.permits.retain(|permit| permit.from <= at);
        for permit in self.permits.iter_mut().filter(|permit| permit.until > at) {
            (permit.until, permit.brake) = (at, brake);
        }
    }

    /// A request or broadcast to the drives.
    fn request(&mut self, at: Instant, frame: &Frame) {
        if let Ok(broadcast) = Broadcast::decode(frame) {
            if broadcast == Broadcast::Halt {
                self.halt_due = None;
            }
            return;
        }
        let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) else {
            self.broken(Rule::Contract, at, format!("neither request nor broadcast: {frame}"));
            return;
        };
        let joint = usize::from(module.get() - 1);
        match request {
            Request::Move(motion) => {
                let MotionCommand::Ramp { target } = motion.command() else {
                    self.broken(Rule::Limits, at, format!("a motion that is not a ramp: {frame}"));
                    return;
                };
                self.target(at, joint, target.get().into());
                // Of an order that is not answered yet: it is taken where the start was missed.
                let other = self.sent.iter().any(|sent| {
                    matches!(sent.order, Order::Home(_) | Order::Jog { .. })
                        && sent.done.is_some()
                        && !sent.answered
                });
                if let Some(start) = self.start.take()
                    && at > start + START_WITHIN
                    && !other
                {
                    let late = at.saturating_since(start);
                    self.broken(Rule::Start, at, format!("the run of {start} s begins {late} s late"));
                }
                self.in_fault(at, frame);
            }
            Request::Simple(protocol::powercube::SimpleCommand::Home) => self.in_fault(at, frame),
            Request::Set(Parameter::TargetVel, Value::F32(v)) if f64::from(v) > V_MAX_RAD_S => {
                self.broken(Rule::Limits, at, format!("speed {v} rad/s to joint {joint}"));
            }
            Request::Set(Parameter::TargetAcc, Value::F32(a)) if f64::from(a) > A_MAX_RAD_S2 => {
                self.broken(Rule::Limits, at, format!("acceleration {a} rad/s2 to joint {joint}"));
            }
            _ => {}
        }
    }

    fn in_fault(&mut self, at: Instant, frame: &Frame) {
        if self.kind() == Some(State::Fault) && self.cleared.is_none() {
            self.broken(Rule::Fault, at, format!("motion in a fault: {frame}"));
        }
    }

    fn target(&mut self, at: Instant, joint: usize, target_rad: f64) {
        let (q, v) = self.plant[joint];
        // A stop at speed ends ahead of the joint.
        let stop = 0.5 * v * v / JOG_A_RAD_S2 + 5e-3;
        let inside = target_rad <= (q + stop).max(self.q_max + 1e-3) && target_rad >= (q - stop).min(-0.601);
        if self.homed[joint] && !inside {
            let what = format!("target {target_rad} rad of joint {joint} at {q} rad, limit {}", self.q_max);
            self.broken(Rule::Limits, at, what);
        }
    }

    /// A message or an answer of the controller.
    fn message(&mut self, at: Instant, frame: &Frame) {
        for (client, node) in CLIENTS.into_iter().enumerate() {
            let Some(transfer) = self.rx[client].accept(at, Some(node), frame, &[&PORTS]) else {
                continue;
            };
            let (id, payload) = (transfer.transfer_id, transfer.payload.to_vec());
            match transfer.route {
                Route::Response { service, .. } => self.answer(at, client, service, id, &payload),
                Route::Message { subject, .. } if subject == group_state::SUBJECT && client == 0 => {
                    if let Ok(state) = GroupState::from_bytes(&payload) {
                        self.published(at, state);
                    }
                }
                _ => {}
            }
        }
    }

    fn published(&mut self, at: Instant, state: GroupState) {
        use State::{Armed, Fault, Homing, Running, Stopping};
        let before = self.kind();
        if let Some(old) = self.state.filter(|old| old.state == Fault)
            && (state.state != Fault || state.fault_cause != old.fault_cause)
            && self.cleared.is_none()
        {
            let what = format!("fault {} is left to {} without a clear", old.fault_cause, state.state);
            self.broken(Rule::Fault, at, what);
        }
        if state.state == Fault && before != Some(Fault) {
            self.cleared = None;
            let second = Duration::from_millis(1_000);
            let drives_hear = self.restarted_at.is_none_or(|restart| restart + second * 2 < at)
                && self.deaf_until + second < at;
            if state.fault_cause == MOVES_UNORDERED && drives_hear {
                let what = format!("a joint is said to move without an order: {:?}", self.plant);
                self.broken(Rule::Motion, at, what);
            }
            if state.fault_cause == DRIVE_ERROR && drives_hear && self.excuse(at).is_zero() {
                let what = format!(
                    "joint {} is said to be in error, and nothing has happened to it",
                    state.fault_joint
                );
                self.broken(Rule::Fault, at, what);
            }
        }
        if before != Some(state.state) {
            self.state_since = at;
        }
        self.state = Some(state);
        // Orders that end by themselves. An order on its way may be younger than this message.
        let old = |permit: &Permit| permit.from + SLACK < at && permit.until == NEVER;
        for permit in self.permits.iter_mut().filter(|permit| old(permit)) {
            let goes_on = match self.sent[permit.sent].order {
                Order::Home(_) => state.state == Homing,
                _ => matches!(state.state, Armed | Running | Stopping),
            };
            if !goes_on {
                permit.until = at;
            }
        }
        if !matches!(state.state, Armed | Running) && self.start.is_some_and(|start| start + SLACK < at) {
            self.start = None;
        }
    }

    fn answer(&mut self, at: Instant, client: usize, service: ServiceId, id: TransferId, payload: &[u8]) {
        let mine = |sent: &Sent| {
            !sent.answered
                && sent.done.is_some()
                && sent.client == client
                && sent.transfer == id
                && sent.port == service.get()
        };
        let Some(index) = self.sent.iter().rposition(mine) else { return };
        self.sent[index].answered = true;
        let (order, done) = (self.sent[index].order, self.sent[index].done.unwrap_or(at));
        if service == register::ACCESS {
            if let (Order::Write(written), Ok(answer)) = (order, AccessResponse::from_bytes(payload)) {
                self.written(at, done, written, &answer);
            }
        } else if service == file::WRITE {
            let _ = WriteResponse::from_bytes(payload);
        } else if let Ok(answer) = CommandResponse::from_bytes(payload) {
            let output = answer.output.to_vec();
            self.outcome(at, done, index, answer.status == Status::SUCCESS, &output);
        }
    }

    /// What became of a command that the controller got at `done`.
    fn outcome(&mut self, at: Instant, done: Instant, index: usize, taken: bool, output: &[u8]) {
        let order = self.sent[index].order;
        if !taken {
            if let Order::Clear(number) = order
                && self.cleared == Some(number)
            {
                self.cleared = None;
            }
            if !order.is_stop() {
                self.permits.retain(|permit| permit.sent != index);
            }
            if let Order::Run { start: Some(start), .. } = order
                && self.start == Some(start)
            {
                self.start = None;
            }
            self.hand_due = self.hand_due.filter(|(_, run)| *run != index);
            return;
        }
        match order {
            Order::Home(_) => self.taken.homings += 1,
            Order::Jog { .. } => self.taken.jogs += 1,
            Order::Commit => self.taken.commits += 1,
            Order::Confirm => self.taken.armings += 1,
            Order::Run { .. } => self.taken.runs += 1,
            Order::Clear(_) => self.taken.clears += 1,
            _ => {}
        }
        if matches!(order, Order::Home(_) | Order::Jog { .. }) {
            // Taken only where no run is due any more: one whose start was missed may not have been reported yet.
            self.start = None;
        }
        match order {
            Order::Jog { joint, .. } => {
                // It replaces the jog before it.
                let older = |permit: &&mut Permit| permit.sent < index && permit.joints == 1 << joint;
                for permit in self.permits.iter_mut().filter(older).filter(|permit| permit.until > done) {
                    if permit.v_rad_s != 0.0 {
                        permit.until = done;
                    }
                }
            }
            Order::Prepare => {
                if self.last_commit.is_none() || self.last_limit > self.last_commit {
                    self.broken(
                        Rule::Settings,
                        at,
                        "an offer although a limit changed after the commit".to_owned(),
                    );
                }
                if let Ok(offer) = command::ArmOffer::from_bytes(output) {
                    self.token = offer.token;
                }
                self.last_prepare = Some(done);
            }
            Order::Confirm => {
                if !self.is_since_stop(self.last_prepare, done) {
                    self.broken(Rule::Stop, at, "armed by an offer from before the last stop".to_owned());
                }
                self.last_confirm = Some(done);
            }
            Order::Run { .. } if !self.is_since_stop(self.last_confirm, done) => {
                self.broken(Rule::Stop, at, "a run without an arming since the last stop".to_owned());
            }
            Order::Commit => self.last_commit = Some(done),
            Order::Clear(_) if self.cleared.is_some() && !self.cleared_at_rest => {
                self.broken(Rule::Fault, at, format!("cleared in motion: {:?}", self.plant));
            }
            _ => {}
        }
    }

    /// True if `step` was taken, and no stop came between it and an order given at `done`.
    fn is_since_stop(&self, step: Option<Instant>, done: Instant) -> bool {
        step.is_some() && self.last_stop.is_none_or(|stop| Some(stop) <= step || stop >= done)
    }

    fn written(&mut self, at: Instant, done: Instant, written: Register, answer: &AccessResponse<'_>) {
        let real = answer.value.f32(0).map(f64::from);
        let limit = |judge: &mut Self, name: &str, old: Option<f64>, ceiling: f64, asked: f32| {
            let Some(now) = real else { return 0.0 };
            if now > ceiling + 1e-6 {
                judge.broken(
                    Rule::Settings,
                    at,
                    format!("{name} is {now}, more than {ceiling}, without an unlock"),
                );
            }
            let changed = old.map_or((now - f64::from(asked)).abs() < 1e-6, |old| (old - now).abs() > 1e-6);
            if changed && old.is_some() {
                judge.last_limit = Some(done);
            }
            now
        };
        match written {
            Register::Watchdog(_) => self.watchdog = answer.value.bool(0).unwrap_or(self.watchdog),
            Register::QMax(asked) => {
                let old = self.q_max;
                self.q_max = limit(self, "q_max", Some(old), 1.0, asked);
            }
            Register::Current(asked) => {
                let old = self.current_a;
                self.current_a = limit(self, "current_max", Some(old), 30.0, asked);
            }
            Register::VMax(asked) => {
                limit(self, "v_max", None, 2.6006, asked);
            }
            _ => {}
        }
    }
}
