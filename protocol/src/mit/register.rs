//! Settings of a motor: requests on id 0x7FF, answers on its master id.
//!
//! ```text
//! request   n & 0xFF | n >> 8 | 33 | register | 0 x 4         read
//!           n & 0xFF | n >> 8 | 55 | register | value 4       write to RAM
//!           n & 0xFF | n >> 8 | AA | 01 | 0 x 4               store all in flash
//!           n & 0xFF | n >> 8 | CC | 0 x 5                    answer with a state
//! answer    n & 0xFF | n >> 8 | 33 or 55 | register | value 4
//! ```
//!
//! The flash lasts about ten thousand writes: a program writes to RAM at each start and stores nothing.

use crate::{Frame, StandardId};

use super::{MotorId, REGISTER_ID, frame, parts};

const READ: u8 = 0x33;
const WRITE: u8 = 0x55;
const STORE: u8 = 0xAA;
const STATE: u8 = 0xCC;

/// Values of [`Register::BitRate`] for CAN FD at 1 Mbit/s, and the data rate of each, bits per second.
pub const DATA_RATES: [(u32, u32); 7] = [
    (5, 2_000_000),
    (6, 2_500_000),
    (7, 3_200_000),
    (8, 4_000_000),
    (9, 5_000_000),
    (10, 8_000_000),
    (11, 10_000_000),
];

/// A setting or a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Register {
    /// 4: acceleration of modes 2 and 3, rad/s².
    Acceleration,
    /// 5: deceleration of modes 2 and 3, rad/s²; negative.
    Deceleration,
    /// 6: largest speed, rad/s.
    SpeedMax,
    /// 7: id on which the motor answers.
    MasterId,
    /// 8: id to which it listens.
    MotorId,
    /// 9: time without a command after which it gives no torque, in 50 µs; **0: never, it keeps the last command**.
    TimeOut,
    /// 10: mode. 1 MIT, 2 position and velocity, 3 velocity, 4 position and force.
    Mode,
    /// 13: version of the hardware.
    HardwareVersion,
    /// 14: version of the firmware.
    FirmwareVersion,
    /// 15: serial number.
    SerialNumber,
    /// 16: pole pairs.
    PolePairs,
    /// 20: gear ratio.
    Gear,
    /// 21: position at the end of its field, rad.
    PositionMax,
    /// 22: velocity at the end of its field, rad/s.
    VelocityMax,
    /// 23: torque at the end of its field, N·m.
    TorqueMax,
    /// 35: rate of the bus. 4 is 1 Mbit/s; from 5 on CAN FD.
    BitRate,
    /// 80: angle of the motor, rad.
    MotorAngle,
    /// 81: angle of the shaft, rad.
    ShaftAngle,
}

impl Register {
    /// All known registers, by number.
    pub const ALL: [Self; 18] = [
        Self::Acceleration,
        Self::Deceleration,
        Self::SpeedMax,
        Self::MasterId,
        Self::MotorId,
        Self::TimeOut,
        Self::Mode,
        Self::HardwareVersion,
        Self::FirmwareVersion,
        Self::SerialNumber,
        Self::PolePairs,
        Self::Gear,
        Self::PositionMax,
        Self::VelocityMax,
        Self::TorqueMax,
        Self::BitRate,
        Self::MotorAngle,
        Self::ShaftAngle,
    ];

    /// Its number.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Acceleration => 4,
            Self::Deceleration => 5,
            Self::SpeedMax => 6,
            Self::MasterId => 7,
            Self::MotorId => 8,
            Self::TimeOut => 9,
            Self::Mode => 10,
            Self::HardwareVersion => 13,
            Self::FirmwareVersion => 14,
            Self::SerialNumber => 15,
            Self::PolePairs => 16,
            Self::Gear => 20,
            Self::PositionMax => 21,
            Self::VelocityMax => 22,
            Self::TorqueMax => 23,
            Self::BitRate => 35,
            Self::MotorAngle => 80,
            Self::ShaftAngle => 81,
        }
    }

    /// The register with this number, if it is known.
    #[must_use]
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|register| register.number() == number)
    }

    /// True if it holds a whole number, false if it holds a float.
    #[must_use]
    pub const fn is_whole(self) -> bool {
        matches!(self.number(), 7..=10 | 13..=16 | 35 | 36)
    }

    /// Whether it can be written.
    #[must_use]
    pub const fn is_writable(self) -> bool {
        !matches!(self.number(), 13..=16 | 20 | 80 | 81)
    }

    const fn value(self, bytes: [u8; 4]) -> RegisterValue {
        if self.is_whole() {
            RegisterValue::Whole(u32::from_le_bytes(bytes))
        } else {
            RegisterValue::Float(f32::from_le_bytes(bytes))
        }
    }
}

/// What a register holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RegisterValue {
    /// A whole number.
    Whole(u32),
    /// A number in the unit of the register.
    Float(f32),
}

impl RegisterValue {
    const fn bytes(self) -> [u8; 4] {
        match self {
            Self::Whole(value) => value.to_le_bytes(),
            Self::Float(value) => value.to_le_bytes(),
        }
    }
}

/// Request of a host to one motor on id 0x7FF.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RegisterRequest {
    /// The value of a register.
    Read(Register),
    /// Sets a register in RAM; the answer repeats it. The four bytes of the value are sent, whatever its kind.
    Write(Register, RegisterValue),
    /// Stores all registers in flash.
    Store,
    /// A [`super::State`] without a command.
    State,
}

impl RegisterRequest {
    /// The frame to motor `to`.
    #[must_use]
    pub fn encode(&self, to: MotorId) -> Frame {
        let (code, register, [a, b, c, d]) = match *self {
            Self::Read(register) => (READ, register.number(), [0; 4]),
            Self::Write(register, value) => (WRITE, register.number(), value.bytes()),
            Self::Store => (STORE, 1, [0; 4]),
            Self::State => (STATE, 0, [0; 4]),
        };
        frame(REGISTER_ID, [to.get(), 0, code, register, a, b, c, d])
    }

    /// The request of a frame, and its motor. `None` for another frame, an unknown register or an unknown code: a
    /// motor does not answer these.
    #[must_use]
    pub fn decode(from: &Frame) -> Option<(MotorId, Self)> {
        let (id, [low, high, code, register, a, b, c, d]) = parts(from)?;
        if id != REGISTER_ID || high != 0 {
            return None;
        }
        let request = match code {
            READ => Self::Read(Register::of(register)?),
            WRITE => {
                let register = Register::of(register)?;
                Self::Write(register, register.value([a, b, c, d]))
            }
            STORE if register == 1 => Self::Store,
            STATE => Self::State,
            _ => return None,
        };
        Some((MotorId::new(low)?, request))
    }
}

/// Answer to [`RegisterRequest::Read`] or [`RegisterRequest::Write`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegisterAnswer {
    /// The register.
    pub register: Register,
    /// It was written, not read.
    pub written: bool,
    /// Present value.
    pub value: RegisterValue,
}

impl RegisterAnswer {
    /// The frame of motor `of` on its master id.
    #[must_use]
    pub fn encode(&self, of: MotorId, master: StandardId) -> Frame {
        let [a, b, c, d] = self.value.bytes();
        let code = if self.written { WRITE } else { READ };
        frame(master.get(), [of.get(), 0, code, self.register.number(), a, b, c, d])
    }

    /// The answer of motor `of` on `master` to the request `asked`; `None` for any other frame. A state has the
    /// same id and length; only the request distinguishes them. The one state that looks like the answer is that of
    /// a disabled motor within 0.1 rad of its lowest position.
    #[must_use]
    pub fn decode(from: &Frame, of: MotorId, master: StandardId, asked: &RegisterRequest) -> Option<Self> {
        let (id, [low, high, code, number, a, b, c, d]) = parts(from)?;
        let (register, written) = match *asked {
            RegisterRequest::Read(register) => (register, false),
            RegisterRequest::Write(register, _) => (register, true),
            RegisterRequest::Store | RegisterRequest::State => return None,
        };
        let own = id == master.get() && (low, high) == (of.get(), 0);
        let wanted = if written { WRITE } else { READ };
        (own && code == wanted && number == register.number()).then(|| Self {
            register,
            written,
            value: register.value([a, b, c, d]),
        })
    }
}
