//! What a host sends to one motor.
//!
//! ```text
//! mode 1   id n          p 16 | v 12 | kp 12 | kd 12 | t 12      big-endian, highest bit first
//! mode 2   id n + 0x100  f32 p | f32 largest v                   little-endian
//! mode 3   id n + 0x200  f32 v
//! mode 4   id n + 0x300  f32 p | u16 largest v · 100 | u16 current, 1/10000 of full
//!          id n          FF x 7, then FB clear fault, FC enable, FD disable, FE zero here
//! ```
//!
//! The frames of the last line are also set points of mode 1 with all fields at their ends. The encoder never
//! produces one of them from a set point.

use core::fmt;

use crate::Frame;

use super::range::{KD, KP, Ranges};
use super::{MotorId, frame, parts, short_velocity};

/// Set point of mode 1: the motor gives `kp (p - q) + kd (v - q̇) + t` and holds it until the next command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mit {
    /// Position of the shaft, rad.
    pub p_rad: f32,
    /// Velocity of the shaft, rad/s.
    pub v_rad_s: f32,
    /// Position gain, 0 to 500 N·m/rad.
    pub kp_nm_rad: f32,
    /// Velocity gain, 0 to 5 N·m·s/rad.
    pub kd_nm_s_rad: f32,
    /// Torque beside the gains, N·m.
    pub t_nm: f32,
}

/// A command to one motor. Set points count only in their mode (register 10); in another mode the motor does not answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Mode 1.
    Mit(Mit),
    /// Mode 2: to a position, at most at a velocity.
    PositionVelocity {
        /// Position, rad.
        p_rad: f32,
        /// Largest velocity, rad/s.
        v_max_rad_s: f32,
    },
    /// Mode 3.
    Velocity {
        /// Velocity, rad/s.
        v_rad_s: f32,
    },
    /// Mode 4: to a position, at most at a velocity and with a current.
    PositionForce {
        /// Position, rad.
        p_rad: f32,
        /// Largest velocity, 1/100 rad/s.
        v_max_centirad_s: u16,
        /// Largest current, 1/10000 of full; 0 to 10000.
        current_share: u16,
    },
    /// Switches torque on, by the last set point.
    Enable,
    /// Switches torque off: an arm without brakes falls.
    Disable,
    /// Sets position 0 at the present angle of the shaft. Only while disabled: otherwise the present set point would pull the
    /// shaft away.
    ZeroHere,
    /// Clears the fault that is latched.
    ClearFault,
}

/// Fields of [`Mit`] that were outside their range and stand at its end on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clipped {
    /// Position.
    pub p: bool,
    /// Velocity.
    pub v: bool,
    /// Position gain.
    pub kp: bool,
    /// Velocity gain.
    pub kd: bool,
    /// Torque.
    pub t: bool,
}

/// Why a command has no frame, or a frame is not a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandError {
    /// A number is not finite, or a current share above 10000.
    NotANumber,
    /// Not a data frame with eight bytes (four are enough for a velocity) and the 11-bit id of a motor.
    NotForAMotor,
}

impl fmt::Display for CommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotANumber => "a value of the command is not finite, or a current above full",
            Self::NotForAMotor => "not eight data bytes with the 11-bit id of a motor",
        })
    }
}

impl core::error::Error for CommandError {}

/// Largest current share of mode 4.
const CURRENT_FULL: u16 = 10_000;
const CLEAR: u8 = 0xFB;
const ENABLE: u8 = 0xFC;
const DISABLE: u8 = 0xFD;
const ZERO: u8 = 0xFE;

impl Command {
    /// The frame to motor `to`, and which fields were clipped to `ranges` (in mode 1 only).
    ///
    /// # Errors
    /// [`CommandError::NotANumber`]: a value that is not a number is never sent to a motor.
    pub fn encode(&self, to: MotorId, ranges: &Ranges) -> Result<(Frame, Clipped), CommandError> {
        let n = u16::from(to.get());
        let whole = |id, data| Ok((frame(id, data), Clipped::default()));
        let special = |last| whole(n, [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, last]);
        let finite = |all: &[f32]| {
            if all.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(CommandError::NotANumber) }
        };
        match *self {
            Self::Mit(mit) => {
                let Mit { p_rad, v_rad_s, kp_nm_rad, kd_nm_s_rad, t_nm } = mit;
                finite(&[p_rad, v_rad_s, kp_nm_rad, kd_nm_s_rad, t_nm])?;
                let (data, clipped) = mit.pack(ranges);
                Ok((frame(n, data), clipped))
            }
            Self::PositionVelocity { p_rad, v_max_rad_s } => {
                finite(&[p_rad, v_max_rad_s])?;
                whole(n + 0x100, joined(p_rad.to_le_bytes(), v_max_rad_s.to_le_bytes()))
            }
            Self::Velocity { v_rad_s } => {
                finite(&[v_rad_s])?;
                whole(n + 0x200, joined(v_rad_s.to_le_bytes(), [0; 4]))
            }
            Self::PositionForce { p_rad, v_max_centirad_s, current_share } => {
                finite(&[p_rad])?;
                if current_share > CURRENT_FULL {
                    return Err(CommandError::NotANumber);
                }
                let ([a, b], [c, d]) = (v_max_centirad_s.to_le_bytes(), current_share.to_le_bytes());
                whole(n + 0x300, joined(p_rad.to_le_bytes(), [a, b, c, d]))
            }
            Self::Enable => special(ENABLE),
            Self::Disable => special(DISABLE),
            Self::ZeroHere => special(ZERO),
            Self::ClearFault => special(CLEAR),
        }
    }

    /// The command in a frame, for a motor with `ranges`, and the motor.
    ///
    /// # Errors
    /// The frame is not for a motor, or a number in it is not finite.
    pub fn decode(from: &Frame, ranges: &Ranges) -> Result<(MotorId, Self), CommandError> {
        let (id, data) = parts(from).or_else(|| short_velocity(from)).ok_or(CommandError::NotForAMotor)?;
        let to = MotorId::new((id & 0xFF) as u8).ok_or(CommandError::NotForAMotor)?;
        let [a, b, c, d, e, f, g, h] = data;
        let (first, second) = (f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]));
        let command = match id >> 8 {
            0 => match data {
                [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, ENABLE] => Self::Enable,
                [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, DISABLE] => Self::Disable,
                [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, ZERO] => Self::ZeroHere,
                [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, CLEAR] => Self::ClearFault,
                _ => Self::Mit(Mit::unpack(data, ranges)),
            },
            1 if first.is_finite() && second.is_finite() => {
                Self::PositionVelocity { p_rad: first, v_max_rad_s: second }
            }
            2 if first.is_finite() => Self::Velocity { v_rad_s: first },
            3 if first.is_finite() => {
                let (v_max_centirad_s, current_share) =
                    (u16::from_le_bytes([e, f]), u16::from_le_bytes([g, h]));
                if current_share > CURRENT_FULL {
                    return Err(CommandError::NotANumber);
                }
                Self::PositionForce { p_rad: first, v_max_centirad_s, current_share }
            }
            1..=3 => return Err(CommandError::NotANumber),
            _ => return Err(CommandError::NotForAMotor),
        };
        Ok((to, command))
    }
}

impl Mit {
    fn pack(&self, ranges: &Ranges) -> ([u8; 8], Clipped) {
        let (p, p_clipped) = ranges.p().raw(self.p_rad);
        let (v, v_clipped) = ranges.v().raw(self.v_rad_s);
        let (kp, kp_clipped) = KP.raw(self.kp_nm_rad);
        let (kd, kd_clipped) = KD.raw(self.kd_nm_s_rad);
        let (t, t_clipped) = ranges.t().raw(self.t_nm);
        let [p_high, p_low] = p.to_be_bytes();
        let mut data = [
            p_high,
            p_low,
            (v >> 4) as u8,
            ((v & 0xF) << 4 | kp >> 8) as u8,
            kp as u8,
            (kd >> 4) as u8,
            ((kd & 0xF) << 4 | t >> 8) as u8,
            t as u8,
        ];
        if let [0xFF, low, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, CLEAR..=ZERO] = &mut data
            && *low == 0xFF
        {
            // One step of position: 0.4 mrad. Unchanged, the frame would mean clear, enable, disable or set zero.
            *low = 0xFE;
        }
        let clipped = Clipped { p: p_clipped, v: v_clipped, kp: kp_clipped, kd: kd_clipped, t: t_clipped };
        (data, clipped)
    }

    fn unpack([p_high, p_low, v, v_kp, kp, kd, kd_t, t]: [u8; 8], ranges: &Ranges) -> Self {
        let twelve = |high: u8, low: u8| u16::from(high) << 4 | u16::from(low >> 4);
        let (kp_high, t_high) = (u16::from(v_kp & 0xF), u16::from(kd_t & 0xF));
        Self {
            p_rad: ranges.p().value(u16::from_be_bytes([p_high, p_low])),
            v_rad_s: ranges.v().value(twelve(v, v_kp)),
            kp_nm_rad: KP.value(kp_high << 8 | u16::from(kp)),
            kd_nm_s_rad: KD.value(twelve(kd, kd_t)),
            t_nm: ranges.t().value(t_high << 8 | u16::from(t)),
        }
    }
}

const fn joined([a, b, c, d]: [u8; 4], [e, f, g, h]: [u8; 4]) -> [u8; 8] {
    [a, b, c, d, e, f, g, h]
}
