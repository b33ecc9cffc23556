//! Power, frames, torque.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use protocol::odrive::{
    AxisState as State, ControlMode, Errors, Heartbeat, InputMode, NodeId, Order, Report, Request, Sdo,
    Version,
};
use protocol::{Duration, Frame, Instant, Node};

use super::input::{SetPoint, Trapezoid};
use super::options::{OdriveFaults, OdriveOptions, OdriveParameter};
use crate::drive::bench::ShaftMotor;
use crate::mechanics::{AxisInput, AxisState};

/// Bus voltage, V, and temperature, °C.
const SUPPLY_V: f32 = 24.0;
const ROOM_C: f32 = 25.0;
/// Counts of a turn in 0.5.
const COUNTS_PER_REV: f64 = 8192.0;
/// Speed of the index search, turns/s.
const SEARCH_REV_S: f64 = 0.5;
/// Answers that wait at most; a host that asks faster than the bus carries loses the rest.
const ANSWERS_MAX: usize = 16;
/// Results of a state that was asked for (0.6).
const SUCCESS: u8 = 0;
const BUSY: u8 = 1;
const DISARMED: u8 = 3;
const INVALID_STATE: u8 = 13;
const NOT_CALIBRATED: u8 = 14;

/// An error, as its bit in each version.
#[derive(Clone, Copy)]
enum Error {
    InvalidState,
    Watchdog,
    Estop,
}

impl Error {
    const fn bit(self, version: Version) -> u32 {
        match (self, version) {
            (Self::InvalidState, Version::V05) => 0x1,
            // 0.6 says it in the result of the procedure.
            (Self::InvalidState, Version::V06) => 0,
            (Self::Watchdog, Version::V05) => 0x800,
            (Self::Watchdog, Version::V06) => 0x100_0000,
            (Self::Estop, Version::V05) => 0x4000,
            (Self::Estop, Version::V06) => 0x200_0000,
        }
    }
}

#[derive(Clone, Debug)]
pub struct OdriveAxis {
    options: OdriveOptions,
    faults: OdriveFaults,
    powered: bool,
    state: State,
    errors: u32,
    disarm_reason: u32,
    procedure: u8,
    control: ControlMode,
    input: InputMode,
    wanted: SetPoint,
    set: SetPoint,
    trajectory_done: bool,
    limits: Limits,
    integral_nm: f64,
    is_indexed: bool,
    /// Turns of the motor at which it reports 0.
    origin_rev: f64,
    fed_at: Instant,
    heartbeat_at: Instant,
    estimates_at: Option<Instant>,
    axis: AxisState,
    last_estimates: Report,
    /// Steps of the velocity and torque fields in a unit.
    scales: [u32; 2],
    watchdog_s: f32,
    requests: u32,
    answers: VecDeque<(Instant, Frame)>,
    ready: VecDeque<Frame>,
}

/// What a host may change until the next reboot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Limits {
    velocity_rev_s: f64,
    current_a: f64,
    trapezoid: Trapezoid,
    position_gain: f64,
    velocity_gain: f64,
    integral_gain: f64,
}

impl Limits {
    fn of(options: &OdriveOptions) -> Self {
        Self {
            velocity_rev_s: options.velocity_max_rev_s,
            current_a: options.current_max_a,
            trapezoid: Trapezoid::default(),
            position_gain: options.position_gain,
            velocity_gain: options.velocity_gain,
            integral_gain: options.integral_gain,
        }
    }
}

impl OdriveAxis {
    /// An axis with power whose joint stands at `q_rad`.
    pub fn new(options: OdriveOptions, q_rad: f64) -> Self {
        let mut axis = Self {
            limits: Limits::of(&options),
            options,
            faults: OdriveFaults::default(),
            powered: false,
            state: State::Idle,
            errors: 0,
            disarm_reason: 0,
            procedure: SUCCESS,
            control: ControlMode::Position,
            input: InputMode::Direct,
            wanted: SetPoint::default(),
            set: SetPoint::default(),
            trajectory_done: true,
            integral_nm: 0.0,
            is_indexed: false,
            origin_rev: 0.0,
            fed_at: Instant::ZERO,
            heartbeat_at: Instant::ZERO,
            estimates_at: None,
            axis: AxisState { q_rad, ..AxisState::default() },
            last_estimates: Report::Estimates { rev: 0.0, rev_s: 0.0 },
            scales: [1_000; 2],
            watchdog_s: options.watchdog.map_or(0.0, |after| after.as_secs_f64() as f32),
            requests: 0,
            answers: VecDeque::new(),
            ready: VecDeque::new(),
        };
        axis.set_power(Instant::ZERO, true);
        axis
    }

    /// What is wrong with it, from now on.
    pub fn faults_mut(&mut self) -> &mut OdriveFaults {
        &mut self.faults
    }

    /// It falls to idle and reports no error.
    pub fn fall_idle(&mut self) {
        self.state = State::Idle;
    }

    /// What it is configured to.
    pub fn options(&self) -> &OdriveOptions {
        &self.options
    }

    /// An error with these bits, as its version counts them: no torque.
    pub fn fail(&mut self, error: u32) {
        (self.state, self.errors, self.disarm_reason) = (State::Idle, self.errors | error, error);
    }

    /// Where the shaft of the joint stands, rad.
    pub fn shaft_rad(&self) -> f64 {
        self.axis.q_rad
    }

    /// What it does.
    pub fn state(&self) -> State {
        self.state
    }

    /// Position as the axis reports it, turns.
    pub fn rev(&self) -> f64 {
        self.turns() - self.origin_rev
    }

    fn turns(&self) -> f64 {
        self.axis.q_rad / TAU * self.options.counted
    }

    fn rev_s(&self) -> f64 {
        self.axis.v_rad_s / TAU * self.options.counted
    }

    /// Switches the power off or on. What was not configured is lost, and whole turns, and without an absolute encoder the place in a turn.
    pub fn set_power(&mut self, now: Instant, on: bool) {
        let (options, axis) = (self.options, self.axis);
        self.limits = Limits::of(&options);
        self.powered = on;
        (self.state, self.errors, self.disarm_reason, self.procedure) = (State::Idle, 0, 0, SUCCESS);
        (self.control, self.input) = (ControlMode::Position, InputMode::Direct);
        self.trajectory_done = true;
        self.is_indexed = options.absolute;
        let turns = axis.q_rad / TAU * options.counted;
        self.origin_rev = if options.absolute { turns.round() } else { turns };
        self.answers.clear();
        self.ready.clear();
        (self.fed_at, self.heartbeat_at) = (now, now + options.heartbeat);
        self.estimates_at = options.estimates.map(|every| now + every);
        self.stand_here();
    }

    fn stand_here(&mut self) {
        self.set = SetPoint { rev: self.rev(), ..SetPoint::default() };
        (self.wanted, self.integral_nm, self.trajectory_done) = (self.set, 0.0, true);
    }

    fn disarm(&mut self, error: Error) {
        self.state = State::Idle;
        self.errors |= error.bit(self.options.version);
        self.disarm_reason = error.bit(self.options.version);
        self.procedure = DISARMED;
    }

    /// A state that cannot be.
    fn refuse(&mut self, why: u8) {
        self.procedure = why;
        self.errors |= Error::InvalidState.bit(self.options.version);
    }

    fn go_to(&mut self, state: State) {
        match state {
            State::Idle => (self.state, self.procedure) = (State::Idle, SUCCESS),
            _ if self.errors != 0 => self.refuse(DISARMED),
            State::ClosedLoop if !self.is_indexed => self.refuse(NOT_CALIBRATED),
            State::ClosedLoop => {
                (self.state, self.procedure) = (state, BUSY);
                self.stand_here();
            }
            State::IndexSearch if self.state == State::Idle && !self.options.absolute => {
                (self.state, self.procedure) = (state, BUSY);
                self.stand_here();
            }
            _ => self.refuse(INVALID_STATE),
        }
    }

    fn obey(&mut self, now: Instant, order: Order) {
        self.fed_at = now;
        match order {
            Order::Estop => self.disarm(Error::Estop),
            Order::State(state) => self.go_to(state),
            Order::Mode(control, input) => {
                (self.control, self.input) = (control, input);
                self.stand_here();
            }
            Order::Position { rev, rev_s, nm } => {
                let [rev_s, nm] = [(rev_s, self.scales[0]), (nm, self.scales[1])]
                    .map(|(field, scale)| f64::from(field) * 1_000.0 / f64::from(scale));
                self.wanted = SetPoint { rev: rev.into(), rev_s, nm };
                self.trajectory_done &= self.input != InputMode::Trapezoid;
            }
            Order::Velocity { rev_s, nm } => (self.wanted.rev_s, self.wanted.nm) = (rev_s.into(), nm.into()),
            Order::Torque { nm } => self.wanted.nm = nm.into(),
            Order::Limits { rev_s, current_a } => {
                (self.limits.velocity_rev_s, self.limits.current_a) = (rev_s.into(), current_a.into());
            }
            Order::TrapezoidVelocity(rev_s) => self.limits.trapezoid.velocity = rev_s.into(),
            Order::TrapezoidAcceleration(up, down) => {
                let trapezoid = &mut self.limits.trapezoid;
                (trapezoid.acceleration, trapezoid.deceleration) = (up.into(), down.into());
            }
            Order::PositionGain(gain) => self.limits.position_gain = gain.into(),
            Order::VelocityGains(gain, integral) => {
                (self.limits.velocity_gain, self.limits.integral_gain) = (gain.into(), integral.into());
            }
            Order::Reboot => self.set_power(now, true),
            Order::ClearErrors => (self.errors, self.disarm_reason) = (0, 0),
            Order::CountHere(counts) => self.count_from(f64::from(counts) / COUNTS_PER_REV),
            Order::PositionHere(rev) => self.count_from(rev.into()),
            Order::Sdo(sdo) => self.exchange(now, sdo),
        }
    }

    /// Reads or writes a parameter. One that is read is answered, one without a number is not.
    fn exchange(&mut self, now: Instant, Sdo { endpoint, value }: Sdo) {
        let mut known = self.options.endpoints.into_iter().flatten().zip(OdriveParameter::ALL);
        let Some((_, parameter)) = known.find(|(number, _)| *number == endpoint) else { return };
        let Some(bytes) = value else {
            let report = Report::Sdo { endpoint, value: self.parameter(parameter) };
            let answer = report.encode(self.options.node, self.options.version);
            self.answers.push_back((now + self.options.answer_after, answer));
            return;
        };
        if self.faults.parameters_are_fixed {
            return;
        }
        let whole = u32::from_le_bytes(bytes);
        match parameter {
            OdriveParameter::EstimatesPeriod => {
                self.options.estimates = (whole > 0).then(|| Duration::from_millis(whole.into()));
                self.estimates_at = self.options.estimates.map(|every| now + every);
            }
            OdriveParameter::VelocityScale => self.scales[0] = whole,
            OdriveParameter::TorqueScale => self.scales[1] = whole,
            OdriveParameter::WatchdogTime => self.watchdog_s = f32::from_le_bytes(bytes),
            OdriveParameter::WatchdogOn => {
                let after = Duration::from_secs_f64(self.watchdog_s.into());
                self.options.watchdog = (bytes[0] != 0).then_some(after);
            }
            OdriveParameter::ControlMode | OdriveParameter::InputMode => {}
        }
    }

    fn parameter(&self, parameter: OdriveParameter) -> [u8; 4] {
        let whole = match parameter {
            OdriveParameter::EstimatesPeriod => {
                self.options.estimates.map_or(0, |every| (every.as_micros() / 1_000) as u32)
            }
            OdriveParameter::VelocityScale => self.scales[0],
            OdriveParameter::TorqueScale => self.scales[1],
            OdriveParameter::WatchdogTime => return self.watchdog_s.to_le_bytes(),
            OdriveParameter::WatchdogOn => self.options.watchdog.is_some().into(),
            OdriveParameter::ControlMode => self.control as u32,
            OdriveParameter::InputMode => u32::from(self.input == InputMode::Direct),
        };
        whole.to_le_bytes()
    }

    /// The motor is at `rev` from now on; the shaft does not move by it.
    fn count_from(&mut self, rev: f64) {
        let by = rev - self.rev();
        self.origin_rev -= by;
        self.set.rev += by;
        self.wanted.rev += by;
    }

    fn wanted_rev_s(&self) -> f64 {
        let limits = &self.limits;
        let rev_s = match self.control {
            ControlMode::Position => self.set.rev_s + limits.position_gain * (self.set.rev - self.rev()),
            _ => self.set.rev_s,
        };
        rev_s.clamp(-limits.velocity_rev_s, limits.velocity_rev_s)
    }

    fn amperes(&self) -> f32 {
        (self.axis.drive_torque_nm / self.options.gear / self.options.torque_nm_a) as f32
    }

    fn estimates(&mut self) -> Report {
        let now = Report::Estimates { rev: self.rev() as f32, rev_s: self.rev_s() as f32 };
        if self.faults.torn_estimates > 0 {
            self.faults.torn_estimates -= 1;
            let rev = self.rev() + 0.5 * self.options.counted;
            return Report::Estimates { rev: rev as f32, rev_s: self.rev_s() as f32 };
        }
        if !self.faults.estimates_are_stale {
            self.last_estimates = now;
        }
        let nan = Report::Estimates { rev: f32::NAN, rev_s: f32::NAN };
        if self.faults.estimates_are_nan { nan } else { self.last_estimates }
    }

    fn answer_to(&mut self, request: Request) -> Report {
        let (wanted_nm, estimated_nm) = (self.set.nm as f32, self.axis.drive_torque_nm as f32);
        match request {
            Request::Version => {
                let [major, minor, revision] = self.options.firmware;
                let firmware = [major, minor, revision, 0];
                Report::Version { protocol: 2, hardware: [4, 4, 58], firmware }
            }
            Request::Errors => {
                let disarm_reason = (self.options.version == Version::V06).then_some(self.disarm_reason);
                Report::Errors(Errors { active: self.errors, disarm_reason })
            }
            Request::Address => Report::Address { serial: 0x3860_0000 + u64::from(self.options.node.get()) },
            Request::Estimates => self.estimates(),
            Request::Iq => Report::Iq { wanted_a: self.amperes(), measured_a: self.amperes() },
            Request::Temperature => Report::Temperature { transistors_c: ROOM_C, motor_c: ROOM_C },
            Request::Supply => Report::Supply { volts: SUPPLY_V, amperes: self.amperes().abs() },
            Request::Torques => Report::Torques { wanted_nm, estimated_nm },
        }
    }

    fn heartbeat(&self) -> Report {
        let (error, state, trajectory_done) = (self.errors, self.state, self.trajectory_done);
        let detail = match self.options.version {
            Version::V05 => 0,
            Version::V06 => self.procedure,
        };
        Report::Heartbeat(Heartbeat { error, state, trajectory_done, detail })
    }

    fn send(&mut self, report: Report) {
        if self.faults.is_silent {
            return;
        }
        self.ready.push_back(report.encode(self.options.node, self.options.version));
    }

    /// When it gives no torque any more unless an order comes.
    fn starves_at(&self) -> Option<Instant> {
        let armed = self.state == State::ClosedLoop && !self.faults.watchdog_is_dead;
        self.options.watchdog.filter(|_| armed).map(|after| self.fed_at + after)
    }

    fn node(&self) -> NodeId {
        self.options.node
    }
}

impl ShaftMotor for OdriveAxis {
    fn name(&self) -> String {
        format!("ODrive axis {}", self.node())
    }

    fn q_rad(&self) -> f64 {
        self.axis.q_rad
    }

    fn input(&self) -> AxisInput {
        let (options, limits) = (&self.options, &self.limits);
        // N·m at the joint per counted turn/s, per rad/s of the joint.
        let damping_nms_rad = options.gear * limits.velocity_gain * options.counted / TAU;
        let torque_max_nm = options.gear * options.torque_nm_a * limits.current_a;
        let at_speed = |rev_s: f64, nm: f64| AxisInput {
            damping_nms_rad,
            torque_nm: options.gear * (nm + limits.velocity_gain * rev_s),
            torque_max_nm,
            ..AxisInput::default()
        };
        match self.state {
            State::IndexSearch if self.powered => at_speed(SEARCH_REV_S, 0.0),
            State::ClosedLoop if self.powered => match self.control {
                ControlMode::Voltage => AxisInput::default(),
                ControlMode::Torque => {
                    AxisInput { torque_nm: options.gear * self.set.nm, torque_max_nm, ..AxisInput::default() }
                }
                ControlMode::Velocity => at_speed(self.wanted_rev_s(), self.set.nm + self.integral_nm),
                ControlMode::Position => {
                    let free = self.set.rev_s + limits.position_gain * (self.set.rev - self.rev());
                    let wanted = self.wanted_rev_s();
                    if wanted != free {
                        return at_speed(wanted, self.set.nm + self.integral_nm);
                    }
                    AxisInput {
                        reference_rad: (self.set.rev + self.origin_rev) * TAU / options.counted,
                        stiffness_nm_rad: damping_nms_rad * limits.position_gain,
                        ..at_speed(self.set.rev_s, self.set.nm + self.integral_nm)
                    }
                }
            },
            _ => AxisInput { brake: self.options.brakes, ..AxisInput::default() },
        }
    }

    fn tick(&mut self, axis: AxisState, dt_s: f64) {
        let before = self.turns();
        self.axis = axis;
        if !self.powered {
            return;
        }
        match self.state {
            State::ClosedLoop => {
                let limits = self.limits;
                self.trajectory_done = self.set.follow(self.input, &self.wanted, &limits.trapezoid, dt_s);
                if !axis.saturated && matches!(self.control, ControlMode::Position | ControlMode::Velocity) {
                    self.integral_nm += limits.integral_gain * (self.wanted_rev_s() - self.rev_s()) * dt_s;
                }
            }
            State::IndexSearch if before.floor() != self.turns().floor() => {
                // The index is where the motor stands at a whole turn.
                (self.is_indexed, self.origin_rev) = (true, self.turns().round());
                (self.state, self.procedure) = (State::Idle, SUCCESS);
            }
            _ => {}
        }
    }
}

impl Node for OdriveAxis {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if !self.powered {
            return;
        }
        self.handle_timeout(now);
        let (own, version) = (self.options.node, self.options.version);
        if let Some((node, request)) = Request::decode(frame, version) {
            if node != own {
                return;
            }
            if self.options.requests_feed {
                self.fed_at = now;
            }
            self.requests = self.requests.wrapping_add(1);
            let is_lost = self.requests.checked_rem(self.faults.answer_lost_every) == Some(0);
            if !is_lost && self.answers.len() < ANSWERS_MAX {
                let answer = self.answer_to(request).encode(own, version);
                self.answers.push_back((now + self.options.answer_after, answer));
            }
        } else if let Some((node, order)) = Order::decode(frame, version)
            && node == own
        {
            self.obey(now, order);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if !self.powered {
            return;
        }
        if self.starves_at().is_some_and(|at| at <= now) {
            self.disarm(Error::Watchdog);
        }
        while let Some((at, frame)) = self.answers.front().copied()
            && at <= now
        {
            self.answers.pop_front();
            if !self.faults.is_silent {
                self.ready.push_back(frame);
            }
        }
        if self.heartbeat_at <= now {
            self.heartbeat_at = next(self.heartbeat_at, self.options.heartbeat, now);
            self.send(self.heartbeat());
        }
        if let (Some(at), Some(every)) = (self.estimates_at, self.options.estimates)
            && at <= now
        {
            self.estimates_at = Some(next(at, every, now));
            let estimates = self.estimates();
            self.send(estimates);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.ready.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        if !self.powered {
            return None;
        }
        let answer = self.answers.front().map(|(at, _)| *at);
        self.starves_at().into_iter().chain(answer).chain(self.estimates_at).chain([self.heartbeat_at]).min()
    }
}

/// The next time of a cyclic message after `now`; what was missed is not made up for.
fn next(at: Instant, every: Duration, now: Instant) -> Instant {
    let next = at + every;
    if next > now { next } else { now + every }
}
