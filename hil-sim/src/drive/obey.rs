//! Requests and broadcasts: what each does, and what it answers.

use protocol::powercube::{
    ACCEPTED, Broadcast, Config, CubeState, FirmwareVersion, MotionAck, MotionCommand, MotionPosition,
    MotionRequest, Parameter, Reply, Request, SimpleCommand, Value,
};
use protocol::{Duration, Instant};

use super::options::{
    BeyondMaximum, BeyondSoftLimit, HomeWhenHalted, InternalCommand, Persistence, RefusedReply,
    UnknownRequest,
};
use super::program::{LoopShape, Program};
use super::ramp::Ramp;
use super::state::PowerCubeDrive;
use super::store::SetOutcome;

/// Result of a motion request. A motion that the state forbids is accepted and not executed: the answer says
/// accepted, and hosts see NOT_OK in its short state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Taken {
    Yes,
    /// The numbers are not allowed, and the options require to refuse them.
    No,
}

impl PowerCubeDrive {
    /// Executes one request at `now`; `None`: no answer.
    pub(super) fn obey(&mut self, now: Instant, request: Request) -> Option<Reply> {
        let reply = match request {
            Request::Get(parameter) => return self.get(now, parameter),
            Request::Set(parameter, value) => self.set(now, parameter, value),
            Request::Simple(simple) => self.simple(now, simple),
            Request::Move(motion) => self.motion(now, motion),
            Request::SetStepInc { target_ticks, time_ms } => {
                let command = MotionCommand::StepInc { target_ticks, time_ms };
                self.order(now, command);
                Some(Reply::SetStepInc)
            }
            Request::Internal(bytes) => match self.options.internal {
                InternalCommand::Echo => Some(Reply::Internal(bytes)),
                InternalCommand::Silence => None,
            },
        };
        // Checked after the request has acted: the SET that switches answers off is not answered either.
        reply.filter(|_| !self.store.config().contains(Config::DISABLE_ACK))
    }

    /// Executes one broadcast at `now`, on reception.
    pub(super) fn obey_all(&mut self, now: Instant, broadcast: Broadcast) {
        match broadcast {
            Broadcast::Reset => self.reset(now),
            Broadcast::Home => self.home(now),
            Broadcast::Halt => self.stop(now, false),
            Broadcast::Watchdog => self.refresh_watchdog(now),
            Broadcast::Baud(rate) => {
                self.bit_rate = rate;
                self.store.set(Parameter::DefCanBaud, Value::U8(rate.code()), BeyondMaximum::Clip);
            }
            Broadcast::SavePosition => self.saved_rad = self.measured_rad(now),
            Broadcast::StartMotion => {
                if let Some(command) = self.waiting.take() {
                    self.execute(now, command);
                }
            }
        }
    }

    fn simple(&mut self, now: Instant, simple: SimpleCommand) -> Option<Reply> {
        match simple {
            SimpleCommand::Reset => self.reset(now),
            SimpleCommand::Home => self.home(now),
            SimpleCommand::Halt => self.stop(now, false),
            SimpleCommand::Recalc => self.recalc(),
            SimpleCommand::SaveParameters => self.store.save(),
            // The clock it resets is visible nowhere.
            SimpleCommand::ResetClock => {}
            // One host sends this to single modules and reads no answer: it would take an answer as the answer to its next
            // request.
            SimpleCommand::Watchdog => {
                self.refresh_watchdog(now);
                return None;
            }
            SimpleCommand::ToggleHome => {
                return (self.options.unknown == UnknownRequest::Echo).then_some(Reply::Simple(simple));
            }
        }
        Some(Reply::Simple(simple))
    }

    fn home(&mut self, now: Instant) {
        let halted_too_much = self.halted && self.options.home_when_halted == HomeWhenHalted::Refuse;
        if self.causes == CubeState::EMPTY && !halted_too_much {
            self.start_homing(now);
        }
    }

    // ---- Parameters ----

    fn version(&self) -> FirmwareVersion {
        FirmwareVersion(self.plate.firmware)
    }

    fn get(&mut self, now: Instant, parameter: Parameter) -> Option<Reply> {
        if !parameter.info().readable(self.version()) {
            return None;
        }
        let value = match (parameter, self.read(now, parameter)?) {
            (Parameter::Cur | Parameter::MotorCurrent, Value::F32(current_a)) => {
                Value::F32(current_a + self.current_noise_a() as f32)
            }
            (_, value) => value,
        };
        assert_eq!(value.kind(), parameter.kind(), "{parameter}");
        Some(Reply::Value(parameter, value))
    }

    /// Normal noise; draws no random number if there is no noise, so that such runs do not change.
    fn current_noise_a(&mut self) -> f64 {
        if self.options.current_noise_a <= 0.0 {
            return 0.0;
        }
        self.options.current_noise_a * self.rng.normal()
    }

    fn set(&mut self, now: Instant, parameter: Parameter, value: Value) -> Option<Reply> {
        let outcome = if parameter.info().writable(self.version()) {
            self.write(now, parameter, value)
        } else {
            SetOutcome::Refused
        };
        if outcome != SetOutcome::Refused && self.options.persistence == Persistence::AtOnce {
            self.store.save();
        }
        match (outcome, self.options.refusal) {
            (SetOutcome::Taken | SetOutcome::Clipped, _) => {
                Some(Reply::SetAck { parameter, code: Some(ACCEPTED) })
            }
            (SetOutcome::Refused, RefusedReply::Silence) => None,
            (SetOutcome::Refused, RefusedReply::Code(code)) => {
                Some(Reply::SetAck { parameter, code: Some(code) })
            }
        }
    }

    fn write(&mut self, now: Instant, parameter: Parameter, value: Value) -> SetOutcome {
        match (parameter, value) {
            (Parameter::DioData, Value::U32(bits)) => {
                self.set_outputs(now, (bits >> 4 & 0x0F) as u8);
                SetOutcome::Taken
            }
            // Sets the target that is read back; no source states that it moves anything.
            (Parameter::TargetPosInc, Value::I32(ticks)) => {
                self.target_rad = f64::from(ticks) / self.plate.ticks_per_rad();
                SetOutcome::Taken
            }
            // One host writes the commanded current here: the same as a current motion in digits.
            (Parameter::CurInc, Value::I16(digits)) => {
                match self.order(now, MotionCommand::CurrentInc { digits }) {
                    Taken::Yes => SetOutcome::Taken,
                    Taken::No => SetOutcome::Refused,
                }
            }
            (Parameter::Config, Value::U32(bits)) => {
                let outcome = self.store.set(parameter, value, self.options.beyond_maximum);
                if !Config::from_bits(bits).contains(Config::WATCHDOG_ENABLE) {
                    self.watchdog = None;
                }
                if !Config::from_bits(bits).contains(Config::SYNC_MOTION) {
                    self.waiting = None;
                }
                outcome
            }
            _ => self.store.set(parameter, value, self.options.beyond_maximum),
        }
    }

    // ---- Motions ----

    fn motion(&mut self, now: Instant, motion: MotionRequest) -> Option<Reply> {
        let kind = motion.command().kind();
        // The position in the answer is that before the motion.
        let position = if kind.in_ticks() {
            MotionPosition::Ticks(self.shown_ticks(now))
        } else {
            MotionPosition::Radians(protocol::units::Radians::new(self.shown_q_rad(now) as f32))
        };
        let taken = self.order(now, motion.command());
        let code = match (taken, self.options.refusal) {
            (Taken::Yes, _) => ACCEPTED,
            (Taken::No, RefusedReply::Silence) => return None,
            (Taken::No, RefusedReply::Code(code)) => code,
        };
        Some(match motion.ack() {
            MotionAck::Simple => Reply::MotionAck { kind, code },
            MotionAck::Extended => {
                let (short_state, dio) = (self.shown_state(now).short(), self.shown_dio());
                Reply::MotionExtended { kind, position, short_state, dio }
            }
        })
    }

    /// Takes a motion: now, or at the start broadcast with SYNC_MOTION.
    fn order(&mut self, now: Instant, command: MotionCommand) -> Taken {
        if !numbers(command).iter().all(|n| n.is_finite()) || self.refuses(command) {
            return Taken::No;
        }
        if self.store.config().contains(Config::SYNC_MOTION) {
            if self.may_move() {
                self.waiting = Some(command);
            }
        } else {
            self.execute(now, command);
        }
        Taken::Yes
    }

    /// Motion is executed in this state.
    fn may_move(&self) -> bool {
        let unhomed_m3 = self.store.config().contains(Config::M3_COMPATIBLE) && !self.home_ok;
        !self.halted
            && self.causes == CubeState::EMPTY
            && self.homing.is_none()
            && !unhomed_m3
            && !matches!(self.generator.program(), Program::Open)
    }

    /// True if numbers are beyond limits and the options require to refuse them.
    fn refuses(&self, command: MotionCommand) -> bool {
        let ticks = self.plate.ticks_per_rad();
        let n = |p| self.store.number(p);
        let too_far = |q: f64| {
            self.home_ok
                && self.options.beyond_soft_limit == BeyondSoftLimit::Refuse
                && !(n(Parameter::MinPos) - 1e-6..=n(Parameter::MaxPos) + 1e-6).contains(&q)
        };
        let too_much = |value: f64, max: f64| {
            self.options.beyond_maximum == BeyondMaximum::Refuse && value.abs() > max * (1.0 + 1e-6)
        };
        match command {
            MotionCommand::Ramp { target } | MotionCommand::Step { target, .. } => {
                too_far(target.get().into())
            }
            MotionCommand::RampInc { target_ticks } | MotionCommand::StepInc { target_ticks, .. } => {
                too_far(f64::from(target_ticks) / ticks)
            }
            MotionCommand::CosLoop { position, .. } | MotionCommand::RampLoop { position, .. } => {
                too_far(position.get().into())
            }
            MotionCommand::Velocity(v) => too_much(v.get().into(), n(Parameter::MaxVel)),
            MotionCommand::VelocityInc { ticks_per_s } => {
                too_much(f64::from(ticks_per_s) / ticks, n(Parameter::MaxVel))
            }
            MotionCommand::Current(current) => too_much(current.get().into(), self.motion_current_max_a()),
            MotionCommand::CurrentInc { digits } => {
                too_much(self.digits_to_a(digits.into()), self.motion_current_max_a())
            }
            MotionCommand::CurrentIncWide { digits } => {
                too_much(self.digits_to_a(digits), self.motion_current_max_a())
            }
        }
    }

    /// Current motion stays at the nominal current unless the configuration allows the full one.
    fn motion_current_max_a(&self) -> f64 {
        let max = self.store.number(Parameter::MaxCur);
        if self.store.config().contains(Config::ALLOW_FULL_CUR) {
            max
        } else {
            max.min(self.store.number(Parameter::NominalMotorCurrent))
        }
    }

    /// Commanded current in digits: -500..=500 for the largest current.
    fn digits_to_a(&self, digits: i32) -> f64 {
        f64::from(digits) * self.store.number(Parameter::DefCurRatio)
    }

    fn within_soft_limits(&self, q_rad: f64) -> f64 {
        if self.home_ok && self.options.beyond_soft_limit == BeyondSoftLimit::Clip {
            q_rad.min(self.store.number(Parameter::MaxPos)).max(self.store.number(Parameter::MinPos))
        } else {
            q_rad
        }
    }

    fn execute(&mut self, now: Instant, command: MotionCommand) {
        if !self.may_move() {
            return;
        }
        let ticks = self.plate.ticks_per_rad();
        let ms = |ms: u16| Duration::from_millis(ms.into());
        match command {
            MotionCommand::Ramp { target } => self.ramp_to(now, target.get().into()),
            MotionCommand::RampInc { target_ticks } => self.ramp_to(now, f64::from(target_ticks) / ticks),
            MotionCommand::Step { target, time_ms } => self.step_to(now, target.get().into(), ms(time_ms)),
            MotionCommand::StepInc { target_ticks, time_ms } => {
                self.step_to(now, f64::from(target_ticks) / ticks, ms(time_ms));
            }
            MotionCommand::Velocity(v) => self.run_at(now, v.get().into()),
            MotionCommand::VelocityInc { ticks_per_s } => self.run_at(now, f64::from(ticks_per_s) / ticks),
            MotionCommand::Current(current) => self.push_with(now, current.get().into()),
            MotionCommand::CurrentInc { digits } => self.push_with(now, self.digits_to_a(digits.into())),
            MotionCommand::CurrentIncWide { digits } => self.push_with(now, self.digits_to_a(digits)),
            MotionCommand::CosLoop { position, period_ms } => {
                self.swing_to(now, LoopShape::Cosine, position.get().into(), ms(period_ms));
            }
            MotionCommand::RampLoop { position, period_ms } => {
                self.swing_to(now, LoopShape::Ramp, position.get().into(), ms(period_ms));
            }
        }
    }

    fn ramp_to(&mut self, now: Instant, target_rad: f64) {
        let target = self.within_soft_limits(target_rad);
        let (from, at) = (self.start_point(now), self.earliest_start(now));
        let (v, a) = (self.store.number(Parameter::TargetVel), self.store.number(Parameter::TargetAcc));
        self.target_rad = target;
        self.generator.start(at, Program::Ramp(Ramp::to_position(from.q_rad, from.v_rad_s, target, v, a)));
    }

    fn run_at(&mut self, now: Instant, v_rad_s: f64) {
        let max = self.store.number(Parameter::MaxVel);
        let v = v_rad_s.clamp(-max, max);
        let (from, at) = (self.start_point(now), self.earliest_start(now));
        let a = self.store.number(Parameter::TargetAcc);
        self.generator.start(at, Program::Ramp(Ramp::to_velocity(from.q_rad, from.v_rad_s, v, a)));
    }

    fn step_to(&mut self, now: Instant, target_rad: f64, time: Duration) {
        let target = self.within_soft_limits(target_rad);
        self.target_rad = target;
        if matches!(self.generator.program(), Program::Current(_)) {
            // A step leaves from a set-point; take the axis for it.
            let from = self.start_point(now);
            self.generator.start(now, Program::Hold(from.q_rad));
        }
        let at = self.earliest_start(now);
        self.generator.step(at, target, time, self.store.number(Parameter::MaxVel));
    }

    fn push_with(&mut self, now: Instant, current_a: f64) {
        let max = self.motion_current_max_a();
        self.generator.start(self.earliest_start(now), Program::Current(current_a.clamp(-max, max)));
    }

    fn swing_to(&mut self, now: Instant, shape: LoopShape, position_rad: f64, period: Duration) {
        let from = self.start_point(now).q_rad;
        let to = self.within_soft_limits(position_rad);
        let amplitude_rad = 0.5 * (to - from);
        // Peak speed: 2π A / T of the cosine, 4 A / T of the triangle.
        let factor = if shape == LoopShape::Cosine { std::f64::consts::TAU } else { 4.0 };
        let fastest_s = factor * amplitude_rad.abs() / self.store.number(Parameter::MaxVel).max(1e-9);
        let period_s = period.as_secs_f64().max(fastest_s).max(1e-3);
        self.target_rad = to;
        let program = Program::Loop { shape, center_rad: from + amplitude_rad, amplitude_rad, period_s };
        self.generator.start(self.earliest_start(now), program);
    }
}

/// The floating-point numbers of a motion: NaN and infinities never act.
fn numbers(command: MotionCommand) -> [f32; 1] {
    match command {
        MotionCommand::Ramp { target } | MotionCommand::Step { target, .. } => [target.get()],
        MotionCommand::CosLoop { position, .. } | MotionCommand::RampLoop { position, .. } => {
            [position.get()]
        }
        MotionCommand::Velocity(v) => [v.get()],
        MotionCommand::Current(current) => [current.get()],
        MotionCommand::RampInc { .. }
        | MotionCommand::StepInc { .. }
        | MotionCommand::VelocityInc { .. }
        | MotionCommand::CurrentInc { .. }
        | MotionCommand::CurrentIncWide { .. } => [0.0],
    }
}
