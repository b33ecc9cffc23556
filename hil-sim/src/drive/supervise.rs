//! Supervision by the module itself, step by step: brake, limits, following error, overload, supply, homing.

use protocol::powercube::{Config, CubeState, Parameter};
use protocol::{Duration, Instant};

use super::homing::{Homing, HomingEvent, HomingPhase};
use super::program::Program;
use super::ramp::{Ramp, RampPhase, Setpoint};
use super::servo::{Servo, torque_max_nm};
use super::state::{Brake, Power, PowerCubeDrive, Timers};
use crate::mechanics::{AxisInput, AxisState};

/// Below this speed an axis counts as standing, rad/s: a fifth of the position resolution of the paper per millisecond.
const STANDING_RAD_S: f64 = 0.02;
/// A limit is passed when the axis is this far beyond it, rad: more than a settling position loop overshoots.
const LIMIT_SLACK_RAD: f64 = 2e-3;
/// Speed with which lost encoder counts add up, rad/s; slow enough not to look like a following error.
pub const COUNT_LOSS_RAD_S: f64 = 0.5;

/// Time constant of the motor's winding, s, and its rise at nominal current, °C. Chosen: small geared servo motors.
const THERMAL_TIME_S: f64 = 300.0;
const RISE_AT_NOMINAL_C: f64 = 45.0;
/// Power stage and motor trip here, °C.
const STAGE_TRIP_C: f64 = 90.0;
const MOTOR_TRIP_C: f64 = 110.0;

impl PowerCubeDrive {
    /// Most that the power stage gives, A.
    fn current_limit_a(&self) -> f64 {
        self.store.number(Parameter::MaxCur).min(self.store.number(Parameter::CurrentLimit))
    }

    /// Output of the power stage in the step whose middle is `middle`.
    pub fn input(&self, middle: Instant) -> AxisInput {
        let brake = self.has_brake_fitted() && !matches!(self.brake, Brake::Open);
        if self.power != Power::Up || self.is_stage_off() {
            return AxisInput { brake, ..AxisInput::default() };
        }
        let limit_a = self.current_limit_a();
        let torque_max_nm =
            torque_max_nm(&self.plate, limit_a, self.axis.v_rad_s, self.motor_v / self.plate.supply_v);
        match self.generator.program() {
            Program::Open => AxisInput { brake, ..AxisInput::default() },
            Program::Current(current_a) => AxisInput {
                // The running current K_B q̇ is lost for torque, so the speed settles at I / K_B.
                torque_nm: current_a / self.plate.k_m_a_nm,
                damping_nms_rad: self.plate.k_b_a_s_rad / self.plate.k_m_a_nm,
                torque_max_nm,
                brake,
                ..AxisInput::default()
            },
            Program::Hold(_) | Program::Ramp(_) | Program::Step(_) | Program::Loop { .. } => AxisInput {
                reference_rad: self.generator.at(middle).q_rad - self.shift(),
                stiffness_nm_rad: self.servo.stiffness_nm_rad,
                damping_nms_rad: self.servo.damping_nms_rad,
                torque_max_nm,
                brake,
                ..AxisInput::default()
            },
        }
    }

    /// Takes the axis after a step that ended at `now`, and the supply voltages; does everything that a module does without an
    /// order.
    pub fn tick(&mut self, now: Instant, axis: AxisState, motor_v: f64, logic_v: f64) {
        let dt_s = now.saturating_since(self.axis_at).as_secs_f64();
        self.previous_rad = self.axis.q_rad + self.shift();
        (self.axis, self.axis_at, self.motor_v, self.logic_v) = (axis, now, motor_v, logic_v);
        if self.power != Power::Up {
            self.current_a = 0.0;
            return;
        }
        self.generator.roll(now);
        self.measure_current(dt_s);
        self.lose_counts(dt_s);
        self.move_brake(now);
        self.watch_supplies(now, dt_s);
        self.watch_load(now, dt_s);
        self.continue_homing(now);
        self.watch_limits(now);
        self.watch_following_error(now);
    }

    // ---- State transitions: the only places that stop, halt or close the loop ----

    /// An error: latches its causes and stops.
    pub(super) fn raise(&mut self, now: Instant, causes: CubeState) {
        if self.power != Power::Up || self.causes.contains(causes) {
            return;
        }
        let stage = causes.intersects(POWER_STAGE);
        self.causes = self.causes.union(causes).with(CubeState::POWERFAULT, stage || self.is_stage_off());
        // Pulling on from a set-point that the axis cannot reach would only wind the loop up.
        let from_axis = causes.contains(CubeState::TOW_ERROR);
        self.stop(now, from_axis);
    }

    /// Emergency stop: brakes with the largest acceleration, or switches the motor off where it has to be.
    pub(super) fn stop(&mut self, now: Instant, from_axis: bool) {
        self.counters.stops += 1;
        self.halted = true;
        self.homing = None;
        self.waiting = None;
        if self.is_stage_off() || self.store.config().contains(Config::DISABLE_ON_HALT) {
            self.open_loop(now);
            return;
        }
        let start = if from_axis { self.axis_setpoint(now) } else { self.start_point(now) };
        if !matches!(self.generator.program(), Program::Open) {
            let ramp =
                Ramp::to_velocity(start.q_rad, start.v_rad_s, 0.0, self.store.number(Parameter::MaxAcc));
            self.generator.start(now, Program::Ramp(ramp));
        }
    }

    /// RESET: clears what can be cleared; the loop closes where the axis stands.
    pub(super) fn reset(&mut self, now: Instant) {
        let mut stays = CubeState::NEEDS_POWER_CYCLE;
        if self.motor_v_error() {
            stays = stays.union(CubeState::POW_VOLT_ERR);
        }
        let left = CubeState::from_bits(self.causes.bits() & stays.bits());
        self.causes = left.with(CubeState::POWERFAULT, left.intersects(POWER_STAGE));
        self.current_limited = false;
        if self.causes != CubeState::EMPTY {
            return;
        }
        self.halted = false;
        if matches!(self.generator.program(), Program::Open) {
            self.close_loop(now);
        }
    }

    /// Position loop closed at the present position, brake opening.
    pub(super) fn close_loop(&mut self, now: Instant) {
        self.generator.start(now, Program::Hold(self.measured_rad(now)));
        self.brake = if self.has_brake() {
            let ms = self.store.number(Parameter::DefBrakeTimeOut) as u64;
            Brake::Opening { at: now + Duration::from_millis(ms) }
        } else {
            Brake::Open
        };
    }

    fn open_loop(&mut self, now: Instant) {
        self.generator.start(now, Program::Open);
        self.brake = if self.has_brake() { Brake::Closed } else { Brake::Open };
    }

    /// RECALC: the loop takes over C0, Damp and A0.
    pub(super) fn recalc(&mut self) {
        let n = |p| self.store.number(p);
        self.servo = Servo::new(&self.plate, n(Parameter::ActC0), n(Parameter::ActDamp), n(Parameter::ActA0));
    }

    /// When a motion ordered at `now` can begin: not before the brake is open.
    pub(super) fn earliest_start(&self, now: Instant) -> Instant {
        match self.brake {
            Brake::Opening { at } => at.max(now),
            Brake::Open | Brake::Closed => now,
        }
    }

    /// Starts homing; see `homing`.
    pub(super) fn start_homing(&mut self, now: Instant) {
        self.halted = false;
        self.waiting = None;
        if matches!(self.generator.program(), Program::Open) {
            self.close_loop(now);
        }
        if self.store.setup().is_absolute() {
            // Nothing to search; the position is known.
            self.home_ok = true;
            return;
        }
        self.home_ok = false;
        let direction = 1.0_f64.copysign(self.store.number(Parameter::HomeVel));
        let active = self.switches().contains(CubeState::SWR);
        self.homing = Some(Homing::new(direction, active, self.store.config()));
        self.drive_homing(now);
    }

    fn drive_homing(&mut self, now: Instant) {
        let Some(homing) = self.homing else { return };
        let speed = self.store.number(Parameter::HomeVel).abs();
        let acc = self.store.number(Parameter::DefHomeAcc);
        let v = if homing.phase == HomingPhase::Stop { 0.0 } else { homing.travel() * speed };
        let (from, at) = (self.start_point(now), self.earliest_start(now));
        self.generator.start(at, Program::Ramp(Ramp::to_velocity(from.q_rad, from.v_rad_s, v, acc)));
    }

    // ---- Single checks ----

    fn measure_current(&mut self, dt_s: f64) {
        let driving = !self.is_stage_off() && !matches!(self.generator.program(), Program::Open);
        let braked = self.has_brake_fitted() && !matches!(self.brake, Brake::Open);
        self.current_a = match self.generator.program() {
            _ if !driving || braked => 0.0,
            // The controlled value is the measured one.
            Program::Current(current_a) => current_a.abs(),
            _ => {
                let (v, torque) = (self.axis.v_rad_s.abs(), self.axis.output_torque_nm.abs());
                // A blow from outside is taken by gear and rotor; the stage gives no more than its limit.
                (self.plate.k_b_a_s_rad * v + self.plate.k_m_a_nm * torque).min(self.current_limit_a())
            }
        };
        self.current_limited |= driving && self.axis.saturated;
        let nominal = self.store.number(Parameter::NominalMotorCurrent).max(1e-3);
        let rise = RISE_AT_NOMINAL_C * (self.current_a / nominal) * (self.current_a / nominal);
        self.temperature_c += dt_s / THERMAL_TIME_S * (self.options.ambient_c + rise - self.temperature_c);
    }

    fn lose_counts(&mut self, dt_s: f64) {
        let a = &mut self.afflictions;
        let rest = a.encoder_offset_target_rad - a.encoder_offset_rad;
        let lost = rest.clamp(-COUNT_LOSS_RAD_S * dt_s, COUNT_LOSS_RAD_S * dt_s);
        a.encoder_offset_rad += lost;
        a.count_loss_rad_s = if dt_s > 0.0 { lost / dt_s } else { 0.0 };
    }

    fn move_brake(&mut self, now: Instant) {
        match self.brake {
            Brake::Opening { at } if at <= now => self.brake = Brake::Open,
            // After an emergency stop the brake takes over from the motor.
            Brake::Open if self.halted && self.has_brake() && self.is_standing(now) => self.open_loop(now),
            _ => {}
        }
    }

    fn watch_supplies(&mut self, now: Instant, dt_s: f64) {
        let n = |p| self.store.number(p);
        let ms = |p| n(p) * 1e-3;
        let over = |time: f64, outside: bool| if outside { time + dt_s } else { 0.0 };
        let t = &self.timers;
        let next = Timers {
            motor_low_s: over(t.motor_low_s, self.motor_v < n(Parameter::MinMotorVoltage)),
            motor_high_s: over(t.motor_high_s, self.motor_v > n(Parameter::MaxMotorVoltage)),
            logic_low_s: over(t.logic_low_s, self.logic_v < n(Parameter::MinLogicVoltage)),
            logic_high_s: over(t.logic_high_s, self.logic_v > n(Parameter::MaxLogicVoltage)),
            ..*t
        };
        let motor = next.motor_low_s > ms(Parameter::MotorUndershootTime)
            || next.motor_high_s > ms(Parameter::MotorOvershootTime);
        let logic = next.logic_low_s > ms(Parameter::LogicUndershootTime)
            || next.logic_high_s > ms(Parameter::LogicOvershootTime);
        self.timers = next;
        if motor {
            self.raise(now, CubeState::POW_VOLT_ERR);
        }
        if logic {
            self.raise(now, CubeState::SETUP_OR_LOGIC_VOLT);
        }
    }

    fn watch_load(&mut self, now: Instant, dt_s: f64) {
        let n = |p| self.store.number(p);
        let grow = |time: f64, over: bool| if over { time + dt_s } else { (time - dt_s).max(0.0) };
        self.timers.above_nominal_s =
            grow(self.timers.above_nominal_s, self.current_a > n(Parameter::NominalMotorCurrent));
        self.timers.at_maximum_s =
            grow(self.timers.at_maximum_s, self.current_a >= n(Parameter::MaximumMotorCurrent));
        if self.timers.above_nominal_s * 1e3 > n(Parameter::NominalCurrentTime)
            || self.timers.at_maximum_s * 1e3 > n(Parameter::MaximumCurrentTime)
        {
            self.raise(now, CubeState::POW_INTEGRALERR);
        }
        // The stage sits on the housing: half of the motor's rise.
        let stage_c = self.options.ambient_c + 0.5 * (self.temperature_c - self.options.ambient_c);
        if stage_c > STAGE_TRIP_C {
            self.raise(now, CubeState::POW_FET_TEMP);
        }
        if self.temperature_c > MOTOR_TRIP_C {
            self.raise(now, CubeState::POW_WDG_TEMP);
        }
    }

    fn continue_homing(&mut self, now: Instant) {
        let switches = self.switches();
        let Some(homing) = &mut self.homing else { return };
        let ahead = if homing.travel() < 0.0 { CubeState::SW1 } else { CubeState::SW2 };
        match homing.read_switch(switches.contains(CubeState::SWR), switches.contains(ahead)) {
            HomingEvent::Continue => {
                if homing.phase == HomingPhase::Stop && self.is_standing(now) {
                    self.finish_homing(now);
                }
            }
            HomingEvent::Turn => self.drive_homing(now),
            HomingEvent::Edge => {
                self.latch_zero();
                self.drive_homing(now);
            }
            // Not stated what a module shows here: halted without a home position, no error bit.
            HomingEvent::Failed => self.stop(now, false),
        }
    }

    /// The edge was passed in the last step: the counter latched there reads HomeOffset from now on.
    fn latch_zero(&mut self) {
        let config = self.store.config();
        let q = self.axis.q_rad;
        let edge = if config.contains(Config::SWR_USE_EXTERNAL) { q } else { self.nearest_cam_edge(q) };
        let per_turn = std::f64::consts::TAU / self.plate.gear_ratio;
        let noise = if config.contains(Config::SWR_WITH_ENCODERZERO) {
            // The distance from edge to index is known from the factory, so the index makes the switch exact.
            let index =
                if self.axis.v_rad_s < 0.0 { (edge / per_turn).floor() } else { (edge / per_turn).ceil() };
            self.home_to_index_rad = index * per_turn - edge;
            0.0
        } else {
            self.home_to_index_rad = 0.0;
            // Sum of four uniform numbers: near enough to normal, bounded. Variance 1/3.
            let sum: f64 = (0..4).map(|_| self.rng.unit()).sum();
            (sum - 2.0) * 3.0_f64.sqrt() * self.options.home_switch_noise_rad
        };
        let before = self.shift();
        self.shift_rad = self.store.number(Parameter::HomeOffset) - edge + noise;
        // Coordinates jump; the set-point jumps along so that the axis does not.
        self.afflictions.encoder_offset_rad = 0.0;
        self.afflictions.encoder_offset_target_rad = 0.0;
        self.home_counter_rad = edge - self.counter_zero_rad;
        let jump = self.shift() - before;
        let at = self.generator.at(self.axis_at);
        let moved = Ramp::to_velocity(at.q_rad + jump, at.v_rad_s, at.v_rad_s, 1.0);
        self.generator.start(self.axis_at, Program::Ramp(moved));
    }

    fn finish_homing(&mut self, now: Instant) {
        self.homing = None;
        self.home_ok = true;
        self.target_rad = self.generator.at(now).q_rad;
        if self.store.config().contains(Config::ZERO_MOVE_AFTER_HOK) {
            let zero =
                0.0_f64.max(self.store.number(Parameter::MinPos)).min(self.store.number(Parameter::MaxPos));
            let speed = self.store.number(Parameter::HomeVel).abs();
            let acc = self.store.number(Parameter::DefHomeAcc);
            let from = self.start_point(now);
            self.target_rad = zero;
            let ramp = Ramp::to_position(from.q_rad, from.v_rad_s, zero, speed, acc);
            self.generator.start(now, Program::Ramp(ramp));
        }
    }

    fn watch_limits(&mut self, now: Instant) {
        if self.halted || self.homing.is_some() || matches!(self.generator.program(), Program::Open) {
            return;
        }
        let (q, v) = (self.measured_rad(now), self.heading(now));
        let switches = self.switches();
        let onto_home = self.home_ok
            && self.store.config().contains(Config::CHANGE_SWR_TO_LIMIT)
            && switches.contains(CubeState::SWR)
            && v != 0.0;
        let onto_low = switches.contains(CubeState::SW1) && v < 0.0;
        let onto_high = switches.contains(CubeState::SW2) && v > 0.0;
        if onto_low || onto_high || onto_home {
            self.raise(now, CubeState::BEYOND_HARD);
        }
        // Without a home position the soft limits mean nothing.
        let low = self.store.number(Parameter::MinPos) - LIMIT_SLACK_RAD;
        let high = self.store.number(Parameter::MaxPos) + LIMIT_SLACK_RAD;
        if self.home_ok && ((q < low && v < 0.0) || (q > high && v > 0.0)) {
            self.raise(now, CubeState::BEYOND_SOFT);
        }
    }

    /// Direction of motion, as a sign: that of the set point, or of the axis if there is no set point; zero at rest.
    fn heading(&self, now: Instant) -> f64 {
        match self.generator.program() {
            Program::Current(_) if self.axis.v_rad_s.abs() > STANDING_RAD_S => self.axis.v_rad_s,
            Program::Current(current_a) => *current_a,
            _ => self.generator.at(now).v_rad_s,
        }
    }

    fn watch_following_error(&mut self, now: Instant) {
        let (error, limit) = (self.following_error_rad(now), self.store.number(Parameter::MaxDeltaPos));
        if error.abs() > limit {
            self.raise(now, CubeState::TOW_ERROR);
        }
    }

    // ---- Derived facts ----

    /// Measured minus true position, lost counts included, rad.
    pub(super) fn shift(&self) -> f64 {
        self.shift_rad + self.afflictions.encoder_offset_rad
    }

    /// True position at `now`, extrapolated from the last step.
    pub(super) fn true_q_rad(&self, now: Instant) -> f64 {
        self.axis.q_rad + self.axis.v_rad_s * super::program::seconds(self.axis_at, now)
    }

    /// Position as the module knows it, before rounding to its resolution.
    pub(super) fn measured_rad(&self, now: Instant) -> f64 {
        self.true_q_rad(now) + self.shift()
    }

    pub(super) fn axis_setpoint(&self, now: Instant) -> Setpoint {
        Setpoint { q_rad: self.measured_rad(now), v_rad_s: self.measured_rad_s(), a_rad_s2: 0.0 }
    }

    /// Start of the next motion: the set-point, or the axis if there is no set-point.
    pub(super) fn start_point(&self, now: Instant) -> Setpoint {
        match self.generator.program() {
            Program::Open | Program::Current(_) => self.axis_setpoint(now),
            _ => self.generator.at(now),
        }
    }

    /// Set-point minus measured position; zero without set-point.
    pub(super) fn following_error_rad(&self, now: Instant) -> f64 {
        match self.generator.program() {
            Program::Open | Program::Current(_) => 0.0,
            _ => self.generator.at(now).q_rad - self.measured_rad(now),
        }
    }

    /// Speed as the module knows it: an encoder that loses counts hides part of the motion.
    pub(super) fn measured_rad_s(&self) -> f64 {
        self.axis.v_rad_s + self.afflictions.count_loss_rad_s
    }

    /// The set-point has ended and the axis no longer follows, as far as the module can measure.
    pub(super) fn is_standing(&self, now: Instant) -> bool {
        !self.generator.is_active(now) && self.measured_rad_s().abs() < STANDING_RAD_S
    }

    pub(super) fn ramp_phase(&self, now: Instant) -> Option<RampPhase> {
        self.generator.ramp_phase(now)
    }

    pub(super) fn brake_is_on(&self) -> bool {
        self.has_brake_fitted() && matches!(self.brake, Brake::Closed)
    }

    fn has_brake_fitted(&self) -> bool {
        self.options.brake
    }

    /// Fitted and configured.
    pub(super) fn has_brake(&self) -> bool {
        self.options.brake && self.store.config().contains(Config::BRAKE_PRESENT)
    }

    fn is_stage_off(&self) -> bool {
        self.causes.contains(CubeState::POWERFAULT)
    }

    fn motor_v_error(&self) -> bool {
        let n = |p| self.store.number(p);
        self.motor_v < n(Parameter::MinMotorVoltage) || self.motor_v > n(Parameter::MaxMotorVoltage)
    }

    /// SWR, SW1 and SW2 as the module sees them.
    pub(super) fn switches(&self) -> CubeState {
        let config = self.store.config();
        let q = self.axis.q_rad;
        let plate = &self.plate;
        let edge = plate.home_edge_rad + plate.home_error_rad;
        let cam = q <= edge && q >= edge - plate.home_cam_rad;
        let input = |line: u8| self.inputs >> line & 1 != 0;
        let level = |own: bool, line: u8, external: Config, low: Config| {
            (if config.contains(external) { input(line) } else { own }) ^ config.contains(low)
        };
        let (low_end, high_end) =
            (q < plate.q_min_rad - plate.hard_margin_rad, q > plate.q_max_rad + plate.hard_margin_rad);
        let swr = config.contains(Config::SWR_ENABLED)
            && level(cam, 0, Config::SWR_USE_EXTERNAL, Config::SWR_LOW_ACTIVE);
        let sw1 = config.contains(Config::SW1_ENABLED)
            && level(low_end, 1, Config::SW1_USE_EXTERNAL, Config::SW1_LOW_ACTIVE);
        let sw2 = config.contains(Config::SW2_ENABLED)
            && level(high_end, 2, Config::SW2_USE_EXTERNAL, Config::SW2_LOW_ACTIVE);
        CubeState::EMPTY.with(CubeState::SWR, swr).with(CubeState::SW1, sw1).with(CubeState::SW2, sw2)
    }

    fn nearest_cam_edge(&self, q_rad: f64) -> f64 {
        let high = self.plate.home_edge_rad + self.plate.home_error_rad;
        let low = high - self.plate.home_cam_rad;
        if (q_rad - high).abs() <= (q_rad - low).abs() { high } else { low }
    }
}

/// Bits that POWERFAULT summarises.
pub(super) const POWER_STAGE: CubeState = CubeState::POW_VOLT_ERR
    .union(CubeState::POW_FET_TEMP)
    .union(CubeState::POW_WDG_TEMP)
    .union(CubeState::POW_SHORTCUR)
    .union(CubeState::POW_HALLERR)
    .union(CubeState::POW_INTEGRALERR);
