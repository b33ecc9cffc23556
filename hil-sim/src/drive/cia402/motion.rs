//! State machine, modes, position loop.

use protocol::canopen::cia402::{self, Control, Mode, State, Status};
use protocol::{Duration, Instant};

use super::dictionary::{COMMUTATION, CYCLES_WITHOUT_DATA, SPEED_MAX};
use super::options::{MissingTarget, ServoOptions};
use super::path::Path;
use super::servo::CanopenServo;
use crate::mechanics::AxisInput;

/// Bit 8 of the control word.
const HALT: u16 = 1 << 8;
/// Bit 4 of the control word: homing or interpolation runs.
const MODE_BIT: u16 = 1 << 4;
/// A drive takes no order of a host that shows nothing: bit 9, remote, and bit 4, voltage.
const STANDING_BITS: u16 = 1 << 9 | 1 << 4;
const WINDOW_OFF: i64 = u32::MAX as i64;
/// Speed below which a shaft stands, rad/s.
const STANDS_RAD_S: f64 = 1e-3;

impl CanopenServo {
    fn mode(&self) -> Option<Mode> {
        Mode::of(self.dictionary.get(cia402::MODE_DISPLAY, 0) as i8)
    }

    fn counts(&self, rad: f64) -> i64 {
        (rad * self.options.counts_per_rad()).round() as i64
    }

    fn rad(&self, counts: i64) -> f64 {
        counts as f64 / self.options.counts_per_rad()
    }

    /// Brakes from the position and the speed of the shaft. After lost targets the line may be far away from the shaft, and faster.
    fn brake(&mut self, now: Instant) {
        let (from_rad, v_rad_s) = (self.now_rad(now), self.axis.v_rad_s);
        let a_rad_s2 = self.rad(self.dictionary.get(0x6085, 0)).max(1e-3);
        self.path = Path::Brake { from_rad, v_rad_s, a_rad_s2, since: now };
    }

    fn has_torque(&self) -> bool {
        matches!(self.state, State::OperationEnabled | State::QuickStopActive | State::FaultReaction)
    }

    /// Where the shaft is now: the mechanics know it at their last step.
    fn now_rad(&self, now: Instant) -> f64 {
        let since_s = now.as_secs_f64() - self.grid.as_secs_f64();
        self.axis.q_rad + self.axis.v_rad_s * since_s
    }

    /// Limit of the speed of the shaft.
    fn speed_max_rad_s(&self) -> f64 {
        if self.options.interpolating.is_some() {
            return f64::INFINITY;
        }
        let turns_per_minute = self.dictionary.get(SPEED_MAX, 0) as f64;
        turns_per_minute / f64::from(self.options.gear) * std::f64::consts::TAU / 60.0
    }

    /// What the power stage does around `middle`, the middle of a step.
    pub fn input_at(&self, middle: Instant) -> AxisInput {
        if !self.has_torque() {
            return AxisInput { brake: true, ..AxisInput::default() };
        }
        let (reference_rad, v_rad_s) = self.path.at(middle);
        let offset = self.dictionary.get(cia402::TORQUE_OFFSET, 0) as f64 * 1e-3 * self.options.rated_nm;
        let speed_share = self.axis.v_rad_s.abs() / self.options.no_load_rad_s;
        let ServoOptions { stiffness_nm_rad, damping_nms_rad, .. } = self.options;
        // The position loop asks the velocity loop for a speed, at most the limit of object 6080.
        let away_rad = reference_rad - self.now_rad(middle);
        let demand_rad_s = v_rad_s + stiffness_nm_rad / damping_nms_rad * away_rad;
        let most_rad_s = self.speed_max_rad_s();
        let is_limited = demand_rad_s.abs() > most_rad_s;
        let (stiffness_nm_rad, v_rad_s) =
            if is_limited { (0.0, most_rad_s.copysign(demand_rad_s)) } else { (stiffness_nm_rad, v_rad_s) };
        AxisInput {
            reference_rad,
            stiffness_nm_rad,
            damping_nms_rad,
            torque_nm: offset + damping_nms_rad * v_rad_s,
            torque_max_nm: self.options.peak_nm * (1.0 - speed_share).clamp(0.0, 1.0),
            braking_more_nm: self.options.peak_nm * speed_share.clamp(0.0, 1.0),
            brake: false,
        }
    }

    /// Writes what is measured into its objects.
    pub(super) fn measure(&mut self, now: Instant) {
        let q_rad = self.now_rad(now);
        let lag_rad = if self.has_torque() { self.path.at(now).0 - q_rad } else { 0.0 };
        let position = self.counts(q_rad - self.origin_rad);
        let velocity = self.counts(self.axis.v_rad_s);
        let torque = (self.axis.drive_torque_nm / self.options.rated_nm * 1e3).round() as i64;
        let status = self.status_word();
        for (index, value) in [
            (cia402::POSITION, position),
            (0x606C, velocity),
            (0x6077, torque),
            (0x60F4, self.counts(lag_rad)),
            (cia402::STATUS, i64::from(status)),
        ] {
            self.dictionary.set(index, 0, value);
        }
    }

    /// It takes positions: in mode 7 while bit 4 of the control word is set.
    fn follows(&self) -> bool {
        let is_on = self.state == State::OperationEnabled && self.control.0 & HALT == 0;
        match self.mode() {
            Some(Mode::CyclicPosition) => is_on,
            Some(Mode::InterpolatedPosition) => {
                is_on && self.control.0 & MODE_BIT != 0 && !self.faults.interpolation_is_off
            }
            _ => false,
        }
    }

    fn status_word(&self) -> u16 {
        let mut word = Status::of(self.state).0 | STANDING_BITS;
        match self.mode() {
            Some(Mode::Homing) => {
                let (done, failed) = (self.homing_done == Some(true), self.homing_done == Some(false));
                word |= u16::from(done) << 10 | u16::from(done) << 12 | u16::from(failed) << 13;
            }
            Some(Mode::CyclicPosition | Mode::InterpolatedPosition) => {
                let follows = self.follows();
                word |= u16::from(follows) << 12 | u16::from(self.away_since.is_some()) << 13;
            }
            _ => {}
        }
        word
    }

    pub(super) fn take_mode(&mut self, now: Instant) {
        let wanted = self.dictionary.get(cia402::MODE, 0);
        let is_there = Mode::of(wanted as i8).is_some_and(|mode| mode.is_in(self.options.modes));
        if is_there && !self.faults.mode_is_never_shown {
            self.dictionary.set(cia402::MODE_DISPLAY, 0, wanted);
            (self.path, self.homing_done) = (Path::Hold(self.path.at(now).0), None);
        }
    }

    pub(super) fn take_control(&mut self, now: Instant) {
        let (before, word) = (self.control, Control(self.dictionary.get(cia402::CONTROL, 0) as u16));
        self.control = word;
        let (from, to) = (self.state, word.takes(self.state, before));
        if to == State::OperationEnabled && self.looks_for_commutation(now) {
            return;
        }
        if to != from {
            match to {
                State::QuickStopActive => self.quick_stop(now),
                _ => self.go_to(now, to),
            }
            if from == State::Fault {
                self.cleared(now);
            }
        }
        if self.state != State::OperationEnabled {
            return;
        }
        let halts = |control: Control| control.0 & HALT != 0;
        if halts(word) && !halts(before) {
            self.brake(now);
        }
        let starts = |control: Control| control.0 & MODE_BIT != 0;
        if self.mode() == Some(Mode::InterpolatedPosition) && starts(before) && !starts(word) {
            self.brake(now);
        }
        if self.mode() == Some(Mode::Homing) && starts(word) && !starts(before) {
            self.start_homing(now);
        }
    }

    /// A module without commutation: it takes no torque until it has found it. The search runs in mode 7 while SYNC comes.
    fn looks_for_commutation(&mut self, now: Instant) -> bool {
        let Some(own) = self.options.interpolating else { return false };
        if self.dictionary.get(COMMUTATION, 0) != 0 {
            return false;
        }
        let runs = self.mode() == Some(Mode::InterpolatedPosition) && self.is_synchronized;
        let since = *self.commutation_since.get_or_insert(now);
        if !runs {
            self.commutation_since = None;
        } else if now.saturating_since(since) >= own.commutation {
            self.dictionary.set(COMMUTATION, 0, 0b11);
            return false;
        }
        true
    }

    fn go_to(&mut self, now: Instant, state: State) {
        if state == State::OperationEnabled {
            self.path = Path::Hold(self.now_rad(now));
            self.homing_done = None;
        }
        self.state = state;
        self.away_since = None;
    }

    pub(super) fn power_off(&mut self) {
        if !matches!(self.state, State::NotReady | State::Fault) {
            self.state = State::SwitchOnDisabled;
        }
    }

    /// Brakes as object 605A requires.
    pub(super) fn quick_stop(&mut self, now: Instant) {
        if self.state != State::OperationEnabled {
            return;
        }
        if self.dictionary.get(0x605A, 0) == 0 {
            self.state = State::SwitchOnDisabled;
            return;
        }
        self.brake(now);
        self.state = State::QuickStopActive;
    }

    /// An error: it is reported, then the drive reacts as object 605E requires.
    pub fn fail(&mut self, now: Instant, code: u16) {
        self.emergency(now, code);
        self.fail_silently(now, code);
    }

    pub(super) fn fail_silently(&mut self, now: Instant, code: u16) {
        if matches!(self.state, State::NotReady | State::Fault | State::FaultReaction) {
            return;
        }
        self.dictionary.set(0x603F, 0, code.into());
        let brakes = self.has_torque() && self.dictionary.get(0x605E, 0) != 0;
        if brakes {
            self.brake(now);
        }
        self.state = if brakes { State::FaultReaction } else { State::Fault };
    }

    fn start_homing(&mut self, now: Instant) {
        self.homing_done = None;
        match self.dictionary.get(0x6098, 0) {
            // Here.
            35 | 37 => self.found_zero(self.now_rad(now)),
            // The next index pulse, downwards or upwards.
            method @ (33 | 34) => {
                let speed = self.rad(self.dictionary.get(0x6099, 2));
                let v_rad_s = if method == 33 { -speed } else { speed };
                self.path = Path::Search { from_rad: self.path.at(now).0, v_rad_s, since: now };
            }
            _ => self.homing_done = Some(false),
        }
    }

    /// The shaft counts object 607C at this angle.
    fn found_zero(&mut self, q_rad: f64) {
        self.origin_rad = q_rad - self.rad(self.dictionary.get(0x607C, 0));
        self.homing_done = Some(true);
    }

    /// Ordered position of the mode, counts.
    fn target(&self) -> i64 {
        match self.mode() {
            Some(Mode::InterpolatedPosition) => self.dictionary.get(cia402::INTERPOLATION_DATA, 1),
            _ => self.dictionary.get(cia402::TARGET_POSITION, 0),
        }
    }

    /// Set points of the SYNC.
    pub(super) fn at_sync(&mut self, now: Instant) {
        let is_new = std::mem::take(&mut self.target_is_new);
        self.is_synchronized = true;
        if !self.follows() {
            self.cycles_without_data = 0;
            return;
        }
        if self.options.interpolating.is_some() {
            self.cycles_without_data = if is_new { 0 } else { self.cycles_without_data + 1 };
            let most = self.dictionary.get(CYCLES_WITHOUT_DATA, 0);
            if most > 0 && i64::from(self.cycles_without_data) > most {
                return self.quick_stop(now);
            }
        }
        let (from_rad, _) = self.path.at(now);
        let target_rad = self.origin_rad + self.rad(self.target());
        let to_rad = match (is_new, self.path) {
            (true, _) => target_rad,
            // One more period only: the line of that period is already past its own target.
            (false, Path::Line { from_rad: first, to_rad, .. })
                if self.options.missing == MissingTarget::Extrapolate && to_rad == target_rad =>
            {
                to_rad + (to_rad - first)
            }
            (false, _) => from_rad,
        };
        let exponent = self.dictionary.get(cia402::INTERPOLATION_TIME, 2) as i32;
        let period_s = self.dictionary.get(cia402::INTERPOLATION_TIME, 1) as f64 * 10_f64.powi(exponent);
        let period = Duration::from_secs_f64(period_s);
        // The limit holds for the line too. Otherwise the shaft falls behind the line, and a quick stop ends where the line is.
        let way_max_rad = self.speed_max_rad_s() * period_s;
        let to_rad = from_rad + (to_rad - from_rad).clamp(-way_max_rad, way_max_rad);
        self.path = Path::Line { from_rad, to_rad, since: now, period };
    }

    /// After each step of the mechanics.
    pub(super) fn supervise(&mut self, now: Instant) {
        if !self.has_torque() {
            return;
        }
        let (reference_rad, v_rad_s) = self.path.at(now);
        let stands = v_rad_s.abs() < STANDS_RAD_S && self.axis.v_rad_s.abs() < STANDS_RAD_S * 10.0;
        match self.state {
            State::FaultReaction if stands => self.state = State::Fault,
            State::QuickStopActive if stands && self.dictionary.get(0x605A, 0) < 5 => {
                self.state = State::SwitchOnDisabled;
            }
            State::OperationEnabled => {
                self.search(now);
                self.watch_following(now, reference_rad);
            }
            _ => {}
        }
    }

    /// The encoder has one index pulse in each turn of the motor.
    fn search(&mut self, now: Instant) {
        if !matches!(self.path, Path::Search { .. }) {
            return;
        }
        let turn_rad = std::f64::consts::TAU / f64::from(self.options.gear);
        let index = |q_rad: f64| (q_rad / turn_rad).floor();
        let before_rad = self.axis.q_rad - self.axis.v_rad_s * self.step.as_secs_f64();
        if index(before_rad) != index(self.axis.q_rad) {
            self.found_zero(index(self.axis.q_rad.max(before_rad)) * turn_rad);
            self.brake(now);
        }
    }

    fn watch_following(&mut self, now: Instant, reference_rad: f64) {
        let window = self.dictionary.get(0x6065, 0);
        let is_away = window != WINDOW_OFF && self.counts(reference_rad - self.axis.q_rad).abs() > window;
        if !is_away {
            self.away_since = None;
            return;
        }
        let since = *self.away_since.get_or_insert(now);
        let most = Duration::from_millis(self.dictionary.get(0x6066, 0) as u64);
        if now.saturating_since(since) >= most {
            self.fail(now, 0x8611);
        }
    }
}
