//! Settings in RAM and flash.

use protocol::mit::{Ranges, Register, RegisterValue};

use super::options::MitOptions;

/// Registers that can be written, as one set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Registers {
    pub(super) acceleration_rad_s2: f32,
    pub(super) deceleration_rad_s2: f32,
    pub(super) speed_max_rad_s: f32,
    pub(super) master: u32,
    pub(super) id: u32,
    /// In 50 µs.
    pub(super) time_out: u32,
    pub(super) mode: u32,
    pub(super) ranges: Ranges,
    pub(super) bit_rate: u32,
}

impl Registers {
    pub(super) fn delivered(options: &MitOptions) -> Self {
        let ranges = options.motor.ranges;
        Self {
            acceleration_rad_s2: 50.0,
            deceleration_rad_s2: -50.0,
            speed_max_rad_s: ranges.v_max_rad_s(),
            master: u32::from(options.master.get()),
            id: u32::from(options.id.get()),
            time_out: options.time_out,
            mode: options.mode,
            ranges,
            bit_rate: options.bit_rate,
        }
    }

    /// Takes a value; an invalid one leaves the old one.
    pub(super) fn write(&mut self, register: Register, value: RegisterValue) {
        let (p, v, t) = (self.ranges.p_max_rad(), self.ranges.v_max_rad_s(), self.ranges.t_max_nm());
        let ranges = |p, v, t| Ranges::new(p, v, t).unwrap_or(self.ranges);
        match (register, value) {
            (Register::Acceleration, RegisterValue::Float(x)) if x > 0.0 => self.acceleration_rad_s2 = x,
            (Register::Deceleration, RegisterValue::Float(x)) if x < 0.0 => self.deceleration_rad_s2 = x,
            (Register::SpeedMax, RegisterValue::Float(x)) if x > 0.0 => self.speed_max_rad_s = x,
            (Register::PositionMax, RegisterValue::Float(x)) => self.ranges = ranges(x, v, t),
            (Register::VelocityMax, RegisterValue::Float(x)) => self.ranges = ranges(p, x, t),
            (Register::TorqueMax, RegisterValue::Float(x)) => self.ranges = ranges(p, v, x),
            (Register::MasterId, RegisterValue::Whole(x @ 0..=0x7FF)) => self.master = x,
            (Register::MotorId, RegisterValue::Whole(x @ 1..=0x7F)) => self.id = x,
            (Register::TimeOut, RegisterValue::Whole(x)) => self.time_out = x,
            (Register::Mode, RegisterValue::Whole(x @ 1..=4)) => self.mode = x,
            (Register::BitRate, RegisterValue::Whole(x @ 0..=11)) => self.bit_rate = x,
            _ => {}
        }
    }

    pub(super) fn read(&self, register: Register, options: &MitOptions, shaft_rad: f64) -> RegisterValue {
        let gear = options.motor.gear.unwrap_or(1.0);
        match register {
            Register::Acceleration => RegisterValue::Float(self.acceleration_rad_s2),
            Register::Deceleration => RegisterValue::Float(self.deceleration_rad_s2),
            Register::SpeedMax => RegisterValue::Float(self.speed_max_rad_s),
            Register::MasterId => RegisterValue::Whole(self.master),
            Register::MotorId => RegisterValue::Whole(self.id),
            Register::TimeOut => RegisterValue::Whole(self.time_out),
            Register::Mode => RegisterValue::Whole(self.mode),
            Register::HardwareVersion => RegisterValue::Whole(1),
            Register::FirmwareVersion => RegisterValue::Whole(5013),
            Register::SerialNumber => RegisterValue::Whole(1000 + self.id),
            Register::PolePairs => RegisterValue::Whole(14),
            Register::Gear => RegisterValue::Float(gear),
            Register::PositionMax => RegisterValue::Float(self.ranges.p_max_rad()),
            Register::VelocityMax => RegisterValue::Float(self.ranges.v_max_rad_s()),
            Register::TorqueMax => RegisterValue::Float(self.ranges.t_max_nm()),
            Register::BitRate => RegisterValue::Whole(self.bit_rate),
            Register::MotorAngle => RegisterValue::Float(shaft_rad as f32 * gear),
            Register::ShaftAngle => RegisterValue::Float(shaft_rad as f32),
        }
    }
}
