//! Motions: byte 1 of SET MOTION and what follows it.

use core::fmt;

use super::bytes_at;
use crate::units::{Amperes, RadPerSec, Radians};

/// How the module answers a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MotionAck {
    /// Three bytes: command, motion, 0x64.
    Simple,
    /// Eight bytes: command, motion, actual position, short state, digital lines.
    Extended,
}

/// Kind of motion, without its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MotionKind {
    /// Ramp to a position (FRAMP).
    Ramp,
    /// Position in a given time (FSTEP).
    Step,
    /// Velocity (FVEL).
    Velocity,
    /// Current (FCUR).
    Current,
    /// Ramp to a position in ticks (IRAMP).
    RampInc,
    /// Position in ticks in a given time (ISTEP).
    StepInc,
    /// Velocity in ticks/s (IVEL).
    VelocityInc,
    /// Current in digits (ICUR).
    CurrentInc,
    /// Cosine loop (FCOSLOOP); named by one serial-line host.
    CosLoop,
    /// Ramp loop (FRAMPLOOP); named by one serial-line host.
    RampLoop,
}

impl MotionKind {
    /// All kinds.
    pub const ALL: &[Self] = &[
        Self::Ramp,
        Self::Step,
        Self::Velocity,
        Self::Current,
        Self::RampInc,
        Self::StepInc,
        Self::VelocityInc,
        Self::CurrentInc,
        Self::CosLoop,
        Self::RampLoop,
    ];

    /// The motion byte; `None` for the extended form of a loop, which does not exist.
    pub const fn code(self, ack: MotionAck) -> Option<u8> {
        let simple = match self {
            Self::Ramp => 0x04,
            Self::Step => 0x06,
            Self::Velocity => 0x07,
            Self::Current => 0x08,
            Self::RampInc => 0x09,
            Self::StepInc => 0x0B,
            Self::VelocityInc => 0x0C,
            Self::CurrentInc => 0x0D,
            Self::CosLoop => 0x18,
            Self::RampLoop => 0x19,
        };
        match (ack, self) {
            (MotionAck::Simple, _) => Some(simple),
            (MotionAck::Extended, Self::CosLoop | Self::RampLoop) => None,
            // Extended forms follow the simple ones ten numbers later (0x05, 0x0A, 0x0F, 0x14 are unused).
            (MotionAck::Extended, _) => Some(simple + 0x0A),
        }
    }

    /// Understands a motion byte.
    pub const fn from_code(code: u8) -> Option<(Self, MotionAck)> {
        let (simple, ack) = match code {
            0x0E..=0x17 => (code - 0x0A, MotionAck::Extended),
            _ => (code, MotionAck::Simple),
        };
        let kind = match simple {
            0x04 => Self::Ramp,
            0x06 => Self::Step,
            0x07 => Self::Velocity,
            0x08 => Self::Current,
            0x09 => Self::RampInc,
            0x0B => Self::StepInc,
            0x0C => Self::VelocityInc,
            0x0D => Self::CurrentInc,
            0x18 => Self::CosLoop,
            0x19 => Self::RampLoop,
            _ => return None,
        };
        Some((kind, ack))
    }

    /// Name as the sources write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ramp => "FRAMP",
            Self::Step => "FSTEP",
            Self::Velocity => "FVEL",
            Self::Current => "FCUR",
            Self::RampInc => "IRAMP",
            Self::StepInc => "ISTEP",
            Self::VelocityInc => "IVEL",
            Self::CurrentInc => "ICUR",
            Self::CosLoop => "FCOSLOOP",
            Self::RampLoop => "FRAMPLOOP",
        }
    }

    /// True if positions of this motion's answer are in ticks, not in rad.
    pub const fn in_ticks(self) -> bool {
        matches!(self, Self::RampInc | Self::StepInc | Self::VelocityInc | Self::CurrentInc)
    }
}

/// A motion with its values. Targets are absolute positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionCommand {
    /// Ramp to `target` with the stored target velocity and acceleration.
    Ramp {
        /// End of the ramp, absolute.
        target: Radians,
    },
    /// Reach `target` in `time_ms`.
    Step {
        /// Where to.
        target: Radians,
        /// In which time, ms.
        time_ms: u16,
    },
    /// Hold a velocity.
    Velocity(RadPerSec),
    /// Hold a current.
    Current(Amperes),
    /// As [`MotionCommand::Ramp`], ticks.
    RampInc {
        /// Where to, ticks.
        target_ticks: i32,
    },
    /// As [`MotionCommand::Step`], ticks.
    StepInc {
        /// Where to, ticks.
        target_ticks: i32,
        /// In which time, ms.
        time_ms: u16,
    },
    /// As [`MotionCommand::Velocity`], ticks/s.
    VelocityInc {
        /// Velocity, ticks/s.
        ticks_per_s: i32,
    },
    /// Current in digits as int16: three hosts send this.
    CurrentInc {
        /// Current, digits.
        digits: i16,
    },
    /// Current in digits as int32: the manufacturer's library sends this.
    CurrentIncWide {
        /// Current, digits.
        digits: i32,
    },
    /// Cosine loop around a position.
    CosLoop {
        /// Amplitude or position; not stated.
        position: Radians,
        /// Period, ms.
        period_ms: u16,
    },
    /// Ramp loop around a position.
    RampLoop {
        /// Amplitude or position; not stated.
        position: Radians,
        /// Period, ms.
        period_ms: u16,
    },
}

impl MotionCommand {
    /// Kind of the motion.
    pub const fn kind(self) -> MotionKind {
        match self {
            Self::Ramp { .. } => MotionKind::Ramp,
            Self::Step { .. } => MotionKind::Step,
            Self::Velocity(_) => MotionKind::Velocity,
            Self::Current(_) => MotionKind::Current,
            Self::RampInc { .. } => MotionKind::RampInc,
            Self::StepInc { .. } => MotionKind::StepInc,
            Self::VelocityInc { .. } => MotionKind::VelocityInc,
            Self::CurrentInc { .. } | Self::CurrentIncWide { .. } => MotionKind::CurrentInc,
            Self::CosLoop { .. } => MotionKind::CosLoop,
            Self::RampLoop { .. } => MotionKind::RampLoop,
        }
    }
}

/// A motion and the form of its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionRequest {
    command: MotionCommand,
    ack: MotionAck,
}

/// Body of a motion frame: bytes after the command byte, of which `len` count.
pub(super) struct MotionBytes {
    pub(super) bytes: [u8; 7],
    pub(super) len: usize,
}

impl MotionRequest {
    /// Motion with the three-byte answer.
    pub const fn simple(command: MotionCommand) -> Self {
        Self { command, ack: MotionAck::Simple }
    }

    /// Motion with position and state in the answer. Loops have no such form and stay simple.
    pub const fn extended(command: MotionCommand) -> Self {
        match command {
            MotionCommand::CosLoop { .. } | MotionCommand::RampLoop { .. } => Self::simple(command),
            _ => Self { command, ack: MotionAck::Extended },
        }
    }

    /// The motion.
    pub const fn command(self) -> MotionCommand {
        self.command
    }

    /// Form of the answer.
    pub const fn ack(self) -> MotionAck {
        self.ack
    }

    /// The motion byte.
    pub const fn code(self) -> u8 {
        match self.command.kind().code(self.ack) {
            Some(code) => code,
            // The constructors never make an extended loop.
            None => 0,
        }
    }

    pub(super) fn to_wire(self) -> MotionBytes {
        let code = self.code();
        let four = |[a, b, c, d]: [u8; 4]| MotionBytes { bytes: [code, a, b, c, d, 0, 0], len: 5 };
        let timed = |[a, b, c, d]: [u8; 4], ms: u16| {
            let [e, f] = ms.to_le_bytes();
            MotionBytes { bytes: [code, a, b, c, d, e, f], len: 7 }
        };
        match self.command {
            MotionCommand::Ramp { target } => four(target.get().to_le_bytes()),
            MotionCommand::Velocity(velocity) => four(velocity.get().to_le_bytes()),
            MotionCommand::Current(current) => four(current.get().to_le_bytes()),
            MotionCommand::RampInc { target_ticks: v }
            | MotionCommand::VelocityInc { ticks_per_s: v }
            | MotionCommand::CurrentIncWide { digits: v } => four(v.to_le_bytes()),
            MotionCommand::CurrentInc { digits } => {
                let [a, b] = digits.to_le_bytes();
                MotionBytes { bytes: [code, a, b, 0, 0, 0, 0], len: 3 }
            }
            MotionCommand::Step { target, time_ms: ms }
            | MotionCommand::CosLoop { position: target, period_ms: ms }
            | MotionCommand::RampLoop { position: target, period_ms: ms } => {
                timed(target.get().to_le_bytes(), ms)
            }
            MotionCommand::StepInc { target_ticks, time_ms } => timed(target_ticks.to_le_bytes(), time_ms),
        }
    }

    /// Reads a motion of known kind from a whole SET MOTION frame; `None` if the length is not one
    /// of the kind's.
    pub(super) fn from_wire(kind: MotionKind, ack: MotionAck, data: &[u8]) -> Option<Self> {
        let float = |at| bytes_at(data, at).map(f32::from_le_bytes);
        let ticks = |at| bytes_at(data, at).map(i32::from_le_bytes);
        let millis = |at| bytes_at(data, at).map(u16::from_le_bytes);
        let command = match (kind, data.len()) {
            (MotionKind::Ramp, 6) => MotionCommand::Ramp { target: Radians::new(float(2)?) },
            (MotionKind::Velocity, 6) => MotionCommand::Velocity(RadPerSec::new(float(2)?)),
            (MotionKind::Current, 6) => MotionCommand::Current(Amperes::new(float(2)?)),
            (MotionKind::RampInc, 6) => MotionCommand::RampInc { target_ticks: ticks(2)? },
            (MotionKind::VelocityInc, 6) => MotionCommand::VelocityInc { ticks_per_s: ticks(2)? },
            (MotionKind::CurrentInc, 6) => MotionCommand::CurrentIncWide { digits: ticks(2)? },
            (MotionKind::CurrentInc, 4) => {
                MotionCommand::CurrentInc { digits: bytes_at(data, 2).map(i16::from_le_bytes)? }
            }
            (MotionKind::Step, 8) => {
                MotionCommand::Step { target: Radians::new(float(2)?), time_ms: millis(6)? }
            }
            (MotionKind::StepInc, 8) => {
                MotionCommand::StepInc { target_ticks: ticks(2)?, time_ms: millis(6)? }
            }
            (MotionKind::CosLoop, 8) => {
                MotionCommand::CosLoop { position: Radians::new(float(2)?), period_ms: millis(6)? }
            }
            (MotionKind::RampLoop, 8) => {
                MotionCommand::RampLoop { position: Radians::new(float(2)?), period_ms: millis(6)? }
            }
            _ => return None,
        };
        Some(Self { command, ack })
    }
}

impl fmt::Display for MotionRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.command.kind().name();
        match self.command {
            MotionCommand::Ramp { target } => write!(f, "{kind} {target}")?,
            MotionCommand::Velocity(velocity) => write!(f, "{kind} {velocity}")?,
            MotionCommand::Current(current) => write!(f, "{kind} {current}")?,
            MotionCommand::RampInc { target_ticks } => write!(f, "{kind} {target_ticks} ticks")?,
            MotionCommand::VelocityInc { ticks_per_s } => write!(f, "{kind} {ticks_per_s} ticks/s")?,
            MotionCommand::CurrentInc { digits } => write!(f, "{kind} {digits} digits")?,
            MotionCommand::CurrentIncWide { digits } => write!(f, "{kind} {digits} digits (int32)")?,
            MotionCommand::Step { target, time_ms } => write!(f, "{kind} {target} in {time_ms} ms")?,
            MotionCommand::StepInc { target_ticks, time_ms } => {
                write!(f, "{kind} {target_ticks} ticks in {time_ms} ms")?;
            }
            MotionCommand::CosLoop { position, period_ms }
            | MotionCommand::RampLoop { position, period_ms } => {
                write!(f, "{kind} {position} period {period_ms} ms")?;
            }
        }
        match self.ack {
            MotionAck::Simple => Ok(()),
            MotionAck::Extended => f.write_str(", answer with position"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_bytes_are_those_of_the_reference() {
        let table = [
            (MotionKind::Ramp, 0x04, Some(0x0E)),
            (MotionKind::Step, 0x06, Some(0x10)),
            (MotionKind::Velocity, 0x07, Some(0x11)),
            (MotionKind::Current, 0x08, Some(0x12)),
            (MotionKind::RampInc, 0x09, Some(0x13)),
            (MotionKind::StepInc, 0x0B, Some(0x15)),
            (MotionKind::VelocityInc, 0x0C, Some(0x16)),
            (MotionKind::CurrentInc, 0x0D, Some(0x17)),
            (MotionKind::CosLoop, 0x18, None),
            (MotionKind::RampLoop, 0x19, None),
        ];
        assert_eq!(table.len(), MotionKind::ALL.len());
        for (kind, simple, extended) in table {
            assert_eq!(kind.code(MotionAck::Simple), Some(simple));
            assert_eq!(kind.code(MotionAck::Extended), extended);
        }
    }

    #[test]
    fn unused_motion_bytes_are_unknown() {
        for code in [0x00, 0x03, 0x05, 0x0A, 0x0F, 0x14, 0x1A, 0xFF] {
            assert_eq!(MotionKind::from_code(code), None, "{code:#04X}");
        }
        for code in 0..=255 {
            if let Some((kind, ack)) = MotionKind::from_code(code) {
                assert_eq!(kind.code(ack), Some(code));
            }
        }
    }

    #[test]
    fn a_loop_has_no_extended_form() {
        let command = MotionCommand::CosLoop { position: Radians::new(0.1), period_ms: 500 };
        assert_eq!(MotionRequest::extended(command), MotionRequest::simple(command));
        assert_eq!(MotionRequest::extended(command).code(), 0x18);
    }
}
