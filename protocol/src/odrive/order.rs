//! What a host sends to an axis.

use core::fmt;

use crate::Frame;

use super::{NodeId, Version, bytes, f32_at, frame, joined, parts, u32_at};

/// State of an axis, reported or ordered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AxisState {
    /// No torque: 1.
    Idle,
    /// What is configured for power-on: 2.
    Startup,
    /// Motor and encoder are measured, the shaft turns: 3.
    FullCalibration,
    /// The motor is measured: 4.
    MotorCalibration,
    /// The shaft turns to the index of the encoder: 6.
    IndexSearch,
    /// Offset of the encoder: 7.
    EncoderOffset,
    /// The loop is closed: 8.
    ClosedLoop,
    /// Turns without an encoder: 9.
    Lockin,
    /// The axis turns to its end stop: 11.
    Homing,
    /// Another number.
    Other(u8),
}

impl AxisState {
    /// The state with this number.
    #[must_use]
    pub const fn of(number: u8) -> Self {
        match number {
            1 => Self::Idle,
            2 => Self::Startup,
            3 => Self::FullCalibration,
            4 => Self::MotorCalibration,
            6 => Self::IndexSearch,
            7 => Self::EncoderOffset,
            8 => Self::ClosedLoop,
            9 => Self::Lockin,
            11 => Self::Homing,
            other => Self::Other(other),
        }
    }

    /// Its number.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Idle => 1,
            Self::Startup => 2,
            Self::FullCalibration => 3,
            Self::MotorCalibration => 4,
            Self::IndexSearch => 6,
            Self::EncoderOffset => 7,
            Self::ClosedLoop => 8,
            Self::Lockin => 9,
            Self::Homing => 11,
            Self::Other(other) => other,
        }
    }
}

/// What the loop controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ControlMode {
    /// 0.
    Voltage,
    /// 1.
    Torque,
    /// 2.
    Velocity,
    /// 3.
    Position,
}

/// How set points become what is controlled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InputMode {
    /// 0: not at all.
    Inactive,
    /// 1: as they come.
    Direct,
    /// 2: velocities by a ramp.
    VelocityRamp,
    /// 3: positions by a filter of second order.
    PositionFilter,
    /// 5: positions by a trapezoid of velocity.
    Trapezoid,
    /// 6: torques by a ramp.
    TorqueRamp,
}

impl ControlMode {
    const fn of(number: u32) -> Option<Self> {
        Some(match number {
            0 => Self::Voltage,
            1 => Self::Torque,
            2 => Self::Velocity,
            3 => Self::Position,
            _ => return None,
        })
    }
}

impl InputMode {
    const ALL: [(Self, u32); 6] = [
        (Self::Inactive, 0),
        (Self::Direct, 1),
        (Self::VelocityRamp, 2),
        (Self::PositionFilter, 3),
        (Self::Trapezoid, 5),
        (Self::TorqueRamp, 6),
    ];

    fn number(self) -> u32 {
        Self::ALL.iter().find(|(mode, _)| *mode == self).map_or(0, |(_, number)| *number)
    }

    fn of(number: u32) -> Option<Self> {
        Self::ALL.iter().find(|(_, own)| *own == number).map(|(mode, _)| *mode)
    }
}

/// Access to a parameter of 0.6 by its endpoint; endpoints differ from firmware to firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sdo {
    /// Endpoint.
    pub endpoint: u16,
    /// Bytes to write; `None` reads.
    pub value: Option<[u8; 4]>,
}

/// Message of a host to an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Stops with an error at once; only [`Self::ClearErrors`] leads out.
    Estop,
    /// Another state.
    State(AxisState),
    /// How the loop works.
    Mode(ControlMode, InputMode),
    /// Position and feed forward. **The two feed-forward fields end at ± 32.767** (0.6: times a scale that can be set).
    Position {
        /// Turns.
        rev: f32,
        /// Turns per second.
        rev_s: f32,
        /// N·m at the motor.
        nm: f32,
    },
    /// Velocity, and torque that is fed forward.
    Velocity {
        /// Turns per second.
        rev_s: f32,
        /// N·m at the motor.
        nm: f32,
    },
    /// Torque.
    Torque {
        /// N·m at the motor.
        nm: f32,
    },
    /// Limits of velocity and current.
    Limits {
        /// Turns per second.
        rev_s: f32,
        /// Amperes.
        current_a: f32,
    },
    /// Velocity of the trapezoid, turns per second.
    TrapezoidVelocity(f32),
    /// Acceleration and deceleration of the trapezoid, turns per second squared.
    TrapezoidAcceleration(f32, f32),
    /// Gain of the position loop, 1/s.
    PositionGain(f32),
    /// Gains of the velocity loop: N·m·s per turn, N·m per turn.
    VelocityGains(f32, f32),
    /// Starts the controller again.
    Reboot,
    /// Clears errors: of this axis, in 0.5 of both axes.
    ClearErrors,
    /// 0.5: sets the present position to this many counts of the encoder.
    CountHere(i32),
    /// 0.6: the position is this, turns.
    PositionHere(f32),
    /// 0.6: a parameter.
    Sdo(Sdo),
}

/// Fields of [`Order::Position`] that end at their range on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clipped {
    /// Velocity.
    pub velocity: bool,
    /// Torque.
    pub torque: bool,
}

/// A number of the order is not finite. Such a number is never sent to a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotFinite;

impl fmt::Display for NotFinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number of the order is not finite")
    }
}

impl core::error::Error for NotFinite {}

/// Steps of a field that is fed forward in a unit of it.
const STEPS: f32 = 1000.0;

/// Nearest field, and whether the value lies outside.
fn fed_forward(value: f32) -> ([u8; 2], bool) {
    let steps = value * STEPS;
    let rounded = if steps < 0.0 { steps - 0.5 } else { steps + 0.5 };
    // A cast from float to integer saturates.
    let clipped = !(f32::from(i16::MIN)..=f32::from(i16::MAX)).contains(&steps);
    ((rounded as i16).to_le_bytes(), clipped)
}

impl Order {
    /// The frame to `node`, and what was clipped.
    ///
    /// # Errors
    /// [`NotFinite`].
    pub fn encode(&self, node: NodeId, version: Version) -> Result<(Frame, Clipped), NotFinite> {
        let zero = [0; 4];
        let two = |command, a: f32, b: f32| {
            let finite = a.is_finite() && b.is_finite();
            finite.then(|| frame(node, command, joined(a.to_le_bytes(), b.to_le_bytes()))).ok_or(NotFinite)
        };
        let one = |command, a: f32| two(command, a, 0.0);
        let plain = match *self {
            Self::Estop => frame(node, 0x02, []),
            Self::State(state) => frame(node, 0x07, joined(u32::from(state.number()).to_le_bytes(), zero)),
            Self::Mode(control, input) => {
                frame(node, 0x0B, joined((control as u32).to_le_bytes(), input.number().to_le_bytes()))
            }
            Self::Position { rev, rev_s, nm } => {
                if !(rev.is_finite() && rev_s.is_finite() && nm.is_finite()) {
                    return Err(NotFinite);
                }
                let (([a, b], velocity), ([c, d], torque)) = (fed_forward(rev_s), fed_forward(nm));
                let data = joined(rev.to_le_bytes(), [a, b, c, d]);
                return Ok((frame(node, 0x0C, data), Clipped { velocity, torque }));
            }
            Self::Velocity { rev_s, nm } => two(0x0D, rev_s, nm)?,
            Self::Torque { nm } => one(0x0E, nm)?,
            Self::Limits { rev_s, current_a } => two(0x0F, rev_s, current_a)?,
            Self::TrapezoidVelocity(rev_s) => one(0x11, rev_s)?,
            Self::TrapezoidAcceleration(up, down) => two(0x12, up, down)?,
            Self::PositionGain(gain) => one(0x1A, gain)?,
            Self::VelocityGains(proportional, integral) => two(0x1B, proportional, integral)?,
            // In 0.6 a byte selects the action; zero is the action of 0.5.
            Self::Reboot if version == Version::V05 => frame(node, 0x16, []),
            Self::Reboot => frame(node, 0x16, [0]),
            Self::ClearErrors if version == Version::V05 => frame(node, 0x18, []),
            Self::ClearErrors => frame(node, 0x18, [0]),
            Self::CountHere(counts) => frame(node, 0x19, joined(counts.to_le_bytes(), zero)),
            Self::PositionHere(rev) => one(0x19, rev)?,
            Self::Sdo(Sdo { endpoint, value }) => {
                let ([low, high], opcode) = (endpoint.to_le_bytes(), u8::from(value.is_some()));
                frame(node, 0x04, joined([opcode, low, high, 0], value.unwrap_or_default()))
            }
        };
        Ok((plain, Clipped::default()))
    }

    /// The order in a frame, for an axis of `version`, and the axis. `None`: not an order, or one that this version
    /// does not know; an axis ignores these.
    #[must_use]
    pub fn decode(from: &Frame, version: Version) -> Option<(NodeId, Self)> {
        let (node, command) = parts(from)?;
        if from.is_remote() {
            return None;
        }
        let data = from.data();
        let finite = |at| f32_at(data, at).filter(|x| x.is_finite());
        let order = match command {
            0x02 => Self::Estop,
            0x07 => Self::State(AxisState::of(u8::try_from(u32_at(data, 0)?).ok()?)),
            0x0B => Self::Mode(ControlMode::of(u32_at(data, 0)?)?, InputMode::of(u32_at(data, 4)?)?),
            0x0C => {
                let steps = |at| bytes(data, at).map(|two| f32::from(i16::from_le_bytes(two)) / STEPS);
                Self::Position { rev: finite(0)?, rev_s: steps(4)?, nm: steps(6)? }
            }
            0x0D => Self::Velocity { rev_s: finite(0)?, nm: finite(4)? },
            0x0E => Self::Torque { nm: finite(0)? },
            0x0F => Self::Limits { rev_s: finite(0)?, current_a: finite(4)? },
            0x11 => Self::TrapezoidVelocity(finite(0)?),
            0x12 => Self::TrapezoidAcceleration(finite(0)?, finite(4)?),
            0x16 => Self::Reboot,
            0x18 => Self::ClearErrors,
            0x19 if version == Version::V05 => Self::CountHere(i32::from_le_bytes(bytes(data, 0)?)),
            0x19 => Self::PositionHere(finite(0)?),
            0x1A => Self::PositionGain(finite(0)?),
            0x1B => Self::VelocityGains(finite(0)?, finite(4)?),
            0x04 if version == Version::V06 => {
                let [opcode, low, high, _] = bytes(data, 0)?;
                let value = match opcode {
                    0 => None,
                    1 => Some(bytes(data, 4)?),
                    _ => return None,
                };
                Self::Sdo(Sdo { endpoint: u16::from_le_bytes([low, high]), value })
            }
            _ => return None,
        };
        Some((node, order))
    }
}
