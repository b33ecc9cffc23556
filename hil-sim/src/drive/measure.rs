//! Readings of a module: state word, digital lines, and every parameter that is measured or computed.

use protocol::Instant;
use protocol::powercube::{
    Config, CubeState, Dio, MotionAck, MotionKind, Parameter, PosStateDio, Setup, Value,
};

use super::program::{LoopShape, Program};
use super::ramp::RampPhase;
use super::state::{PowerCubeDrive, Snapshot};

/// Full scale of the raw converter values: 12 bit. Not stated; chosen.
const RAW_PER_A: f64 = 50.0;
const RAW_PER_V: f64 = 64.0;
const RAW_PER_C: f64 = 10.0;

impl PowerCubeDrive {
    /// The state word, from latched causes and what happens at `now`.
    pub(super) fn state(&self, now: Instant) -> CubeState {
        let moving = self.generator.is_active(now) || !self.is_standing(now);
        let servo_open = matches!(self.generator.program(), Program::Open);
        let phase = if self.halted { None } else { self.ramp_phase(now) };
        let phase_bit = match phase {
            Some(RampPhase::Accelerating) => CubeState::RAMP_ACC,
            Some(RampPhase::Steady) => CubeState::RAMP_STEADY,
            Some(RampPhase::Decelerating) => CubeState::RAMP_DEC,
            // Finished and standing: the axis is some milliseconds behind its set-point.
            Some(RampPhase::Ended) if !moving => CubeState::RAMP_END,
            Some(RampPhase::Ended) | None => CubeState::EMPTY,
        };
        self.causes
            .union(self.switches())
            .union(phase_bit)
            .with(CubeState::ERROR, self.causes.intersects(CubeState::CAUSES))
            .with(CubeState::HOME_OK, self.home_ok)
            .with(CubeState::HALTED, self.halted)
            .with(CubeState::BRAKEACTIVE, servo_open && self.brake_is_on())
            .with(CubeState::CURLIMIT, self.current_limited)
            .with(CubeState::MOTION, moving)
            .with(CubeState::INPROGRESS, self.generator.in_progress(now))
            .with(CubeState::FULLBUFFER, self.generator.buffer_full())
    }

    /// Everything measured, now.
    pub(super) fn snapshot(&self, now: Instant) -> Snapshot {
        Snapshot {
            q_rad: self.measured_rad(now),
            v_rad_s: self.measured_rad_s(),
            current_a: self.current_a,
            state: self.state(now),
        }
    }

    /// What answers show: the present, or what a hung measurement task keeps.
    fn shown(&self, now: Instant) -> Snapshot {
        self.afflictions.frozen.unwrap_or_else(|| self.snapshot(now))
    }

    pub(super) fn shown_state(&self, now: Instant) -> CubeState {
        self.afflictions.frozen.map_or_else(|| self.state(now), |frozen| frozen.state)
    }

    /// Position as reported: whole encoder ticks, then the coarser resolution if there is one.
    fn resolve(&self, q_rad: f64) -> f64 {
        let ticks = self.plate.ticks_per_rad();
        let counted = (q_rad * ticks).round() / ticks;
        match self.options.position_resolution_rad.unwrap_or(self.plate.position_resolution_rad) {
            step if step > 0.0 => (counted / step).round() * step,
            _ => counted,
        }
    }

    pub(super) fn shown_q_rad(&self, now: Instant) -> f64 {
        let q_rad = match self.afflictions.frozen {
            Some(frozen) => frozen.q_rad,
            None => self.measured_rad(now),
        };
        self.resolve(q_rad)
    }

    pub(super) fn shown_ticks(&self, now: Instant) -> i32 {
        self.ticks(self.shown_q_rad(now))
    }

    fn ticks(&self, rad: f64) -> i32 {
        (rad * self.plate.ticks_per_rad()).round() as i32
    }

    /// Output lines; by set-up output 0 shows errors.
    pub(super) fn shown_outputs(&self) -> u8 {
        if self.store.setup().contains(Setup::ERROR_TO_OUT0) {
            let error = u8::from(self.causes.intersects(CubeState::CAUSES));
            self.outputs & 0x0E | error
        } else {
            self.outputs
        }
    }

    pub(super) fn shown_dio(&self) -> Dio {
        Dio::new(self.inputs, self.shown_outputs())
    }

    /// Value of any readable parameter; `None` only for numbers outside the table's rows.
    pub(super) fn read(&self, now: Instant, parameter: Parameter) -> Option<Value> {
        use Parameter as P;
        let f = |v: f64| Value::F32(v as f32);
        let i = |v: f64| Value::I32(self.ticks(v));
        let set_point = self.start_point(now);
        let raw = |v: f64| Value::I16(v.round() as i16);
        Some(match parameter {
            P::PosCount => i(self.true_q_rad(now) - self.counter_zero_rad),
            P::RefPosCount => i(self.home_counter_rad),
            P::HomeToZeroInc => i(self.home_to_index_rad),
            P::DioData => {
                let state = self.switches();
                let bit = |mask, to: u32| u32::from(state.contains(mask)) << to;
                let switches = bit(CubeState::SWR, 8) | bit(CubeState::SW1, 9) | bit(CubeState::SW2, 10);
                Value::U32(u32::from(self.shown_dio().0) | switches)
            }
            P::CubeState => Value::U32(self.shown_state(now).bits()),
            P::TargetPosInc => i(self.target_rad),
            P::TargetPos => f(self.target_rad),
            P::StepInc => Value::U32(self.ticks(self.target_rad - set_point.q_rad).unsigned_abs()),
            P::CurInc => {
                let digits = self.store.number(P::DefCurRatio);
                let commanded = match self.generator.program() {
                    Program::Current(current_a) => *current_a,
                    _ => 0.0,
                };
                raw(commanded / digits)
            }
            P::MoveMode => Value::U8(mode_number(self.generator.program())),
            P::IncRatio => f(self.plate.ticks_per_rad()),
            P::ActPos => f(self.shown_q_rad(now)),
            P::PosInc => Value::I32(self.shown_ticks(now)),
            P::PrevPos => f(self.resolve(self.previous_rad)),
            P::IPolPos => f(set_point.q_rad),
            P::IPolVel => f(set_point.v_rad_s),
            P::DeltaPos => f(self.following_error_rad(now)),
            P::DeltaPosInc => i(self.following_error_rad(now)),
            P::ActVel => f(self.shown(now).v_rad_s),
            P::VelInc => i(self.shown(now).v_rad_s),
            P::Cur | P::MotorCurrent => f(self.shown(now).current_a),
            P::DefBurnCount => Value::U8(self.store.burn_count()),
            P::PosStateDio => Value::PosStateDio(PosStateDio {
                position_rad: self.shown_q_rad(now) as f32,
                short_state: self.shown_state(now).short(),
                dio: self.shown_dio(),
            }),
            P::SavePos => f(self.resolve(self.saved_rad)),
            P::MotorSupply => f(self.motor_v),
            P::LogicSupply => f(self.logic_v),
            P::Temperature => f(self.temperature_c),
            P::RawMotorCurrent => raw(self.shown(now).current_a * RAW_PER_A),
            P::RawMotorSupply => raw(self.motor_v * RAW_PER_V),
            P::RawTemperature => raw(self.temperature_c * RAW_PER_C),
            P::RawLogicSupply => raw(self.logic_v * RAW_PER_V),
            stored => return self.store.get(stored),
        })
    }

    /// The state word that a read would give at `now`; for reports and checks.
    pub fn state_word(&self, now: Instant) -> CubeState {
        self.shown_state(now)
    }

    /// Present number of a parameter, 0 if it is not stored as a number; for reports and checks.
    pub fn held(&self, parameter: Parameter) -> f64 {
        self.store.number(parameter)
    }

    /// Configuration word that the module holds now; for reports and checks.
    pub fn held_config(&self) -> Config {
        self.store.config()
    }

    /// Current that the module measures and its supply has to give, A: eq. (9) of the throwing paper.
    pub fn current_a(&self) -> f64 {
        self.current_a
    }

    /// Position that the module believes, before rounding, rad.
    pub fn believed_q_rad(&self, now: Instant) -> f64 {
        self.measured_rad(now)
    }

    /// Set-point, rad and rad/s; the axis itself while no position is controlled.
    pub fn set_point(&self, now: Instant) -> super::ramp::Setpoint {
        self.start_point(now)
    }
}

/// Number of the motion mode in parameter 0x3A: the simple motion byte of the running motion (not stated by any source).
fn mode_number(program: &Program) -> u8 {
    let kind = match program {
        Program::Open => return 0,
        Program::Hold(_) | Program::Ramp(_) => MotionKind::Ramp,
        Program::Step(_) => MotionKind::Step,
        Program::Current(_) => MotionKind::Current,
        Program::Loop { shape: LoopShape::Cosine, .. } => MotionKind::CosLoop,
        Program::Loop { shape: LoopShape::Ramp, .. } => MotionKind::RampLoop,
    };
    kind.code(MotionAck::Simple).unwrap_or(0)
}
