//! The answer of a motor to every command: status, position, velocity, torque, two temperatures.
//!
//! ```text
//! status << 4 | id & 0xF   p 16 | v 12 | t 12   T of the transistors   T of the rotor
//! ```

use crate::{Frame, StandardId};

use super::range::Ranges;
use super::{MotorId, frame, parts};

/// Status that a motor reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Status {
    /// Without torque.
    Disabled,
    /// With torque.
    Enabled,
    /// Supply above its limit; without torque until it is cleared, as every fault.
    OverVoltage,
    /// Supply below its limit.
    UnderVoltage,
    /// Current above its limit.
    OverCurrent,
    /// Transistors too hot.
    TransistorsHot,
    /// Winding too hot.
    RotorHot,
    /// No command for longer than register 9 allows.
    LinkLost,
    /// Load above its limit.
    Overload,
    /// A number that the sources do not name: 2 to 7, 15.
    Unknown(u8),
}

impl Status {
    const fn of(code: u8) -> Self {
        match code {
            0 => Self::Disabled,
            1 => Self::Enabled,
            8 => Self::OverVoltage,
            9 => Self::UnderVoltage,
            0xA => Self::OverCurrent,
            0xB => Self::TransistorsHot,
            0xC => Self::RotorHot,
            0xD => Self::LinkLost,
            0xE => Self::Overload,
            other => Self::Unknown(other),
        }
    }

    /// The number on the wire, 0 to 15.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Disabled => 0,
            Self::Enabled => 1,
            Self::OverVoltage => 8,
            Self::UnderVoltage => 9,
            Self::OverCurrent => 0xA,
            Self::TransistorsHot => 0xB,
            Self::RotorHot => 0xC,
            Self::LinkLost => 0xD,
            Self::Overload => 0xE,
            Self::Unknown(other) => other & 0xF,
        }
    }

    /// True for every status but disabled and enabled.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        !matches!(self, Self::Disabled | Self::Enabled)
    }
}

/// State of a motor when it took the command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Low four bits of the id of the motor.
    pub nibble: u8,
    /// Status that the motor reports.
    pub status: Status,
    /// Position of the shaft, rad.
    pub p_rad: f32,
    /// Velocity of the shaft, rad/s.
    pub v_rad_s: f32,
    /// Torque at the shaft, N·m.
    pub t_nm: f32,
    /// Temperature of the transistors, °C.
    pub transistors_c: u8,
    /// Temperature of the rotor, °C.
    pub rotor_c: u8,
}

impl State {
    /// The frame on the master id of the motor.
    #[must_use]
    pub fn encode(&self, master: StandardId, ranges: &Ranges) -> Frame {
        let [p_high, p_low] = ranges.p().raw(self.p_rad).0.to_be_bytes();
        let (v, t) = (ranges.v().raw(self.v_rad_s).0, ranges.t().raw(self.t_nm).0);
        frame(
            master.get(),
            [
                self.status.code() << 4 | self.nibble & 0xF,
                p_high,
                p_low,
                (v >> 4) as u8,
                ((v & 0xF) << 4 | t >> 8) as u8,
                t as u8,
                self.transistors_c,
                self.rotor_c,
            ],
        )
    }

    /// The state that motor `of` sends on `master`; `None` for another frame or another motor.
    ///
    /// An answer of a register also decodes as a state of a disabled motor near its lowest position: while an
    /// answer is expected, try [`super::RegisterAnswer::decode`] first.
    #[must_use]
    pub fn decode(from: &Frame, of: MotorId, master: StandardId, ranges: &Ranges) -> Option<Self> {
        let (id, [head, p_high, p_low, v, v_t, t, transistors_c, rotor_c]) = parts(from)?;
        if id != master.get() || head & 0xF != of.nibble() {
            return None;
        }
        Some(Self {
            nibble: head & 0xF,
            status: Status::of(head >> 4),
            p_rad: ranges.p().value(u16::from_be_bytes([p_high, p_low])),
            v_rad_s: ranges.v().value(u16::from(v) << 4 | u16::from(v_t >> 4)),
            t_nm: ranges.t().value(u16::from(v_t & 0xF) << 8 | u16::from(t)),
            transistors_c,
            rotor_c,
        })
    }
}
