//! Power, frames, torque.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use protocol::mit::{
    Command, DATA_RATES, Mit, MotorId, Ranges, RegisterAnswer, RegisterRequest, State, Status,
};
use protocol::{Duration, FdFlags, Frame, Instant, Node, StandardId};

use super::options::{MitFaults, MitOptions};
use super::registers::Registers;
use crate::drive::bench::ShaftMotor;
use crate::mechanics::{AxisInput, AxisState};
use crate::participants::BusConnection;

/// Bits per second by register 35; with CAN FD, from 5 on, arbitration has 1 Mbit/s.
const RATES_BIT_S: [u32; 5] = [125_000, 200_000, 250_000, 500_000, 1_000_000];

/// Unit of the time-out register.
const TIME_OUT_UNIT_US: u64 = 50;
/// Position loop of modes 2 to 4, rad/s.
const LOOP_RAD_S: f64 = 30.0;
/// Temperature of the room, and at which a motor stops, °C.
const ROOM_C: f64 = 25.0;
const ROTOR_MAX_C: f64 = 100.0;
/// Final rise of the rotor at rated torque, K, and its time constant, s.
const RISE_K: f64 = 55.0;
const RISE_S: f64 = 300.0;
/// Rise of the transistors beside it.
const TRANSISTORS_SHARE: f64 = 0.6;
/// Most answers that wait; if a host requests faster than the bus carries, further answers are lost.
const ANSWERS_MAX: usize = 16;

#[derive(Clone, Debug)]
pub struct MitMotor {
    options: MitOptions,
    faults: MitFaults,
    flash: Registers,
    ram: Registers,
    powered: bool,
    /// Register 35 at power-on.
    bit_rate: u32,
    status: Status,
    /// Last set point, of any mode.
    wanted: Option<Command>,
    /// Reference of modes 2 to 4, rad of the shaft as the motor counts.
    reference_rad: f64,
    commanded_at: Instant,
    /// True angle of the shaft at which the motor reports 0, rad.
    origin_rad: f64,
    zero_rad: f64,
    axis: AxisState,
    rotor_c: f64,
    answers: VecDeque<(Instant, Frame)>,
    ready: VecDeque<Frame>,
    answered: u32,
    first: Option<State>,
}

impl MitMotor {
    /// A motor with power whose shaft stands at `q_rad`.
    pub fn new(options: MitOptions, q_rad: f64) -> Self {
        let registers = Registers::delivered(&options);
        let mut motor = Self {
            options,
            faults: MitFaults::default(),
            flash: registers,
            ram: registers,
            powered: true,
            bit_rate: options.bit_rate,
            status: Status::Disabled,
            wanted: None,
            reference_rad: 0.0,
            commanded_at: Instant::ZERO,
            origin_rad: 0.0,
            zero_rad: options.zero_rad,
            axis: AxisState { q_rad, ..AxisState::default() },
            rotor_c: ROOM_C,
            answers: VecDeque::new(),
            ready: VecDeque::new(),
            answered: 0,
            first: None,
        };
        motor.set_power(true);
        motor
    }

    /// What is wrong with it, from now on.
    pub fn faults_mut(&mut self) -> &mut MitFaults {
        &mut self.faults
    }

    /// Status that the motor reports.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Position as the motor reports it, rad of the shaft.
    pub fn shaft_rad(&self) -> f64 {
        self.axis.q_rad - self.origin_rad
    }

    /// A fault with this status: no torque until it is cleared.
    pub fn fail(&mut self, status: Status) {
        (self.status, self.wanted) = (status, None);
    }

    /// Switches the power off or on. Registers that were not stored and the count of whole turns are lost.
    pub fn set_power(&mut self, on: bool) {
        self.powered = on;
        self.status = Status::Disabled;
        self.wanted = None;
        self.answers.clear();
        self.ready.clear();
        self.ram = self.flash;
        self.bit_rate = self.ram.bit_rate;
        // The encoder at the shaft knows its place within one turn.
        let within = (self.axis.q_rad - self.zero_rad + PI).rem_euclid(TAU) - PI;
        self.origin_rad = self.axis.q_rad - within;
    }

    /// Data rate that it was set to when it got power, bits per second; `None`: classical CAN.
    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        DATA_RATES.iter().find(|(code, _)| *code == self.bit_rate).map(|(_, bit_s)| *bit_s)
    }

    /// How it is connected to a bus with this bit rate and data rate, bits per second. On classical CAN any data rate will do: its
    /// controller follows that of the bus.
    pub fn link(&self, bit_rate_bit_s: u32, data_bit_rate_bit_s: Option<u32>) -> BusConnection {
        let own = RATES_BIT_S.get(self.bit_rate as usize).copied().unwrap_or(1_000_000);
        let fits =
            self.data_bit_rate_bit_s().is_none_or(|own| data_bit_rate_bit_s.is_none_or(|bus| own == bus));
        match (self.powered, own == bit_rate_bit_s && fits) {
            (false, _) => BusConnection::Off,
            (true, true) => BusConnection::On,
            (true, false) => BusConnection::OtherRate,
        }
    }

    fn lead(&mut self, p_rad: f32, v_max_rad_s: f64, dt_s: f64) {
        let most = v_max_rad_s * dt_s;
        self.reference_rad += (f64::from(p_rad) - self.reference_rad).clamp(-most, most);
    }

    fn id(&self) -> Option<MotorId> {
        u8::try_from(self.ram.id).ok().and_then(MotorId::new)
    }

    fn master(&self) -> StandardId {
        StandardId::from_low_bits(self.ram.master as u16)
    }

    /// Ranges with which it reads and writes frames.
    fn ranges(&self) -> Ranges {
        let own = self.ram.ranges;
        let factor = self.faults.velocity_range_factor;
        let other = Ranges::new(own.p_max_rad(), own.v_max_rad_s() * factor, own.t_max_nm());
        other.unwrap_or(own)
    }

    fn obey(&mut self, now: Instant, command: Command) {
        let mode = match command {
            Command::Mit(_) => 1,
            Command::PositionVelocity { .. } => 2,
            Command::Velocity { .. } => 3,
            Command::PositionForce { .. } => 4,
            Command::Enable | Command::Disable | Command::ZeroHere | Command::ClearFault => self.ram.mode,
        };
        if mode != self.ram.mode {
            return;
        }
        self.commanded_at = now;
        match command {
            Command::Enable if !self.status.is_fault() => {
                self.status = Status::Enabled;
                self.reference_rad = self.shaft_rad();
            }
            Command::Disable if !self.status.is_fault() => self.status = Status::Disabled,
            Command::ClearFault if self.status.is_fault() => self.status = Status::Disabled,
            Command::Enable | Command::Disable | Command::ClearFault => {}
            Command::ZeroHere => {
                (self.zero_rad, self.origin_rad) = (self.axis.q_rad, self.axis.q_rad);
            }
            set_point => self.wanted = Some(set_point),
        }
        self.answer_state(now);
    }

    fn answer_state(&mut self, now: Instant) {
        let Some(id) = self.id() else { return };
        let state = State {
            nibble: id.nibble(),
            status: self.status,
            p_rad: self.shaft_rad() as f32,
            v_rad_s: self.axis.v_rad_s as f32,
            t_nm: self.axis.drive_torque_nm as f32,
            transistors_c: (ROOM_C + (self.rotor_c - ROOM_C) * TRANSISTORS_SHARE) as u8,
            rotor_c: self.rotor_c as u8,
        };
        self.first = self.first.filter(|_| self.faults.answers_are_stale);
        let first = *self.first.get_or_insert(state);
        let state = if self.faults.answers_are_stale { first } else { state };
        self.answer(now, state.encode(self.master(), &self.ranges()));
    }

    fn answer(&mut self, now: Instant, frame: Frame) {
        self.answered = self.answered.wrapping_add(1);
        let lost = self.faults.answer_lost_every;
        if (lost > 0 && self.answered.is_multiple_of(lost)) || self.answers.len() >= ANSWERS_MAX {
            return;
        }
        let is_fd = self.data_bit_rate_bit_s().is_some();
        let frame = if is_fd { frame.with_fd(FdFlags::BRS) } else { frame };
        self.answers.push_back((now + self.options.answer_after, frame));
    }

    fn asked(&mut self, now: Instant, id: MotorId, request: RegisterRequest) {
        match request {
            RegisterRequest::Read(register) => {
                let value = self.ram.read(register, &self.options, self.shaft_rad());
                self.answer(
                    now,
                    RegisterAnswer { register, written: false, value }.encode(id, self.master()),
                );
            }
            RegisterRequest::Write(register, value) => {
                let (master, mode) = (self.master(), self.ram.mode);
                self.ram.write(register, value);
                if self.ram.mode != mode {
                    self.wanted = None;
                }
                let value = self.ram.read(register, &self.options, self.shaft_rad());
                self.answer(now, RegisterAnswer { register, written: true, value }.encode(id, master));
            }
            RegisterRequest::Store if self.status == Status::Disabled => self.flash = self.ram,
            RegisterRequest::Store => {}
            RegisterRequest::State => self.answer_state(now),
        }
    }

    /// When it gives no torque any more unless a command comes.
    fn times_out_at(&self) -> Option<Instant> {
        let armed = self.status == Status::Enabled && self.ram.time_out > 0 && !self.faults.time_out_is_dead;
        let after = Duration::from_micros(u64::from(self.ram.time_out) * TIME_OUT_UNIT_US);
        armed.then(|| self.commanded_at + after)
    }
}

impl ShaftMotor for MitMotor {
    fn name(&self) -> String {
        format!("{} at {}", self.options.motor.name, self.options.id)
    }

    fn q_rad(&self) -> f64 {
        self.axis.q_rad
    }

    fn input(&self) -> AxisInput {
        let off = AxisInput::default();
        if !self.powered || self.status != Status::Enabled {
            return off;
        }
        let limit = f64::from(self.ram.ranges.t_max_nm()).min(self.options.peak_nm);
        // Torque along the motion falls linearly from its largest value at rest to zero at the idle speed. Braking torque does not fall.
        let torque_max_nm =
            limit * (1.0 - self.axis.v_rad_s.abs() / self.options.no_load_rad_s).clamp(0.0, 1.0);
        match self.wanted {
            Some(Command::Mit(Mit { p_rad, v_rad_s, kp_nm_rad, kd_nm_s_rad, t_nm }))
                if self.ram.mode == 1 =>
            {
                AxisInput {
                    reference_rad: self.origin_rad + f64::from(p_rad),
                    stiffness_nm_rad: f64::from(kp_nm_rad),
                    damping_nms_rad: f64::from(kd_nm_s_rad),
                    torque_nm: f64::from(t_nm) + f64::from(kd_nm_s_rad) * f64::from(v_rad_s),
                    torque_max_nm,
                    braking_more_nm: limit - torque_max_nm,
                    brake: false,
                }
            }
            Some(_) if self.ram.mode != 1 => {
                let share = match self.wanted {
                    Some(Command::PositionForce { current_share, .. }) => f64::from(current_share) * 1e-4,
                    _ => 1.0,
                };
                let inertia = self.options.rotor_kg_m2;
                AxisInput {
                    reference_rad: self.origin_rad + self.reference_rad,
                    stiffness_nm_rad: inertia * LOOP_RAD_S * LOOP_RAD_S,
                    damping_nms_rad: 2.0 * inertia * LOOP_RAD_S,
                    torque_max_nm: torque_max_nm * share,
                    braking_more_nm: (limit - torque_max_nm) * share,
                    ..off
                }
            }
            _ => off,
        }
    }

    fn tick(&mut self, axis: AxisState, dt_s: f64) {
        self.axis = axis;
        if !self.powered {
            return;
        }
        let load = axis.drive_torque_nm / self.options.rated_nm;
        self.rotor_c += (ROOM_C + RISE_K * load * load - self.rotor_c) * dt_s / RISE_S;
        if self.rotor_c > ROTOR_MAX_C && self.status == Status::Enabled {
            self.status = Status::RotorHot;
        }
        let speed = |v: f32| f64::from(v.abs().min(self.ram.speed_max_rad_s));
        match self.wanted {
            Some(Command::PositionVelocity { p_rad, v_max_rad_s }) => {
                self.lead(p_rad, speed(v_max_rad_s), dt_s);
            }
            Some(Command::PositionForce { p_rad, v_max_centirad_s, .. }) => {
                self.lead(p_rad, speed(f32::from(v_max_centirad_s) * 0.01), dt_s);
            }
            Some(Command::Velocity { v_rad_s }) => {
                self.reference_rad += speed(v_rad_s).copysign(f64::from(v_rad_s)) * dt_s;
            }
            // The first set point of another mode begins where the shaft is.
            _ => self.reference_rad = self.shaft_rad(),
        }
    }
}

impl Node for MitMotor {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if !self.powered {
            return;
        }
        self.handle_timeout(now);
        let switches = frame.fd().is_some_and(|flags| flags.brs);
        if self.data_bit_rate_bit_s().is_some() && !switches {
            return;
        }
        let id = self.id();
        if let Some((to, request)) = RegisterRequest::decode(frame) {
            if Some(to) == id {
                self.asked(now, to, request);
            }
        } else if let Ok((to, command)) = Command::decode(frame, &self.ranges())
            && Some(to) == id
        {
            self.obey(now, command);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if self.times_out_at().is_some_and(|at| at <= now) {
            self.status = Status::LinkLost;
        }
        while let Some((at, frame)) = self.answers.front().copied()
            && at <= now
        {
            self.answers.pop_front();
            self.ready.push_back(frame);
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
        self.times_out_at().into_iter().chain(answer).min()
    }
}
