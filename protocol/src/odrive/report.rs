//! Messages of an axis, by itself or on request.

use crate::Frame;

use super::order::AxisState;
use super::{NodeId, Version, bytes, f32_at, frame, joined, parts, u32_at};

/// Sent every 100 ms unless it is set otherwise. **Watch the state**: an axis may fall to idle without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Error bits of the axis; 0 means no error. The watchdog is 0x800 in 0.5, and 0x1000000 in 0.6 as in [`Errors::active`].
    pub error: u32,
    /// State of the axis.
    pub state: AxisState,
    /// The trapezoid has arrived.
    pub trajectory_done: bool,
    /// 0.5: which of motor, encoder and controller have errors, from the lowest bit. 0.6: result of the last procedure; 0 done,
    /// 1 runs.
    pub detail: u8,
}

/// Answer to [`Request::Errors`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Errors {
    /// 0.5: errors of the motor. 0.6: errors that are there.
    pub active: u32,
    /// 0.6: why the loop was opened last.
    pub disarm_reason: Option<u32>,
}

/// Message of an axis. Numbers are not checked: an estimate that an axis does not make is always NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Report {
    /// See [`Heartbeat`].
    Heartbeat(Heartbeat),
    /// See [`Errors`].
    Errors(Errors),
    /// Position and velocity of the encoder's shaft.
    Estimates {
        /// Turns.
        rev: f32,
        /// Turns per second.
        rev_s: f32,
    },
    /// Currents that make torque.
    Iq {
        /// Wanted, A.
        wanted_a: f32,
        /// Measured, A.
        measured_a: f32,
    },
    /// Supply.
    Supply {
        /// Volts.
        volts: f32,
        /// Amperes.
        amperes: f32,
    },
    /// 0.6: temperatures, °C.
    Temperature {
        /// Of the transistors.
        transistors_c: f32,
        /// Of the motor.
        motor_c: f32,
    },
    /// 0.6: torques, N·m.
    Torques {
        /// Wanted.
        wanted_nm: f32,
        /// Estimated.
        estimated_nm: f32,
    },
    /// 0.6: version of the protocol, of the hardware (three numbers) and of the firmware (three numbers, and 1 if it is not released).
    Version {
        /// Protocol.
        protocol: u8,
        /// Hardware: major, minor, variant.
        hardware: [u8; 3],
        /// Firmware: major, minor, revision, not released.
        firmware: [u8; 4],
    },
    /// 0.6: value of a parameter, as its bytes.
    Sdo {
        /// Endpoint.
        endpoint: u16,
        /// Bytes.
        value: [u8; 4],
    },
    /// 0.6: the number of a controller and its serial number. Two controllers with the same number both answer.
    Address {
        /// 48 bits.
        serial: u64,
    },
}

/// Request to an axis: a remote frame, or a data frame without data, on the id of the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Request {
    /// 0.6: [`Report::Version`].
    Version,
    /// [`Report::Errors`].
    Errors,
    /// 0.6: [`Report::Address`].
    Address,
    /// [`Report::Estimates`].
    Estimates,
    /// [`Report::Iq`].
    Iq,
    /// 0.6: [`Report::Temperature`].
    Temperature,
    /// [`Report::Supply`].
    Supply,
    /// 0.6: [`Report::Torques`].
    Torques,
}

/// Command, and whether 0.6 alone knows it.
const REQUESTS: [(Request, u8, bool); 8] = [
    (Request::Version, 0x00, true),
    (Request::Errors, 0x03, false),
    (Request::Address, 0x06, true),
    (Request::Estimates, 0x09, false),
    (Request::Iq, 0x14, false),
    (Request::Temperature, 0x15, true),
    (Request::Supply, 0x17, false),
    (Request::Torques, 0x1C, true),
];

impl Request {
    /// The request as a data frame without data. Programs that cannot send remote frames send this.
    #[must_use]
    pub fn encode(self, node: NodeId) -> Frame {
        let command = REQUESTS.iter().find(|(own, ..)| *own == self).map_or(0, |(_, command, _)| *command);
        frame(node, command, [])
    }

    /// The request in a frame, for an axis of `version`, and the axis.
    #[must_use]
    pub fn decode(from: &Frame, version: Version) -> Option<(NodeId, Self)> {
        let (node, command) = parts(from)?;
        let asks = from.is_remote() || from.data().is_empty();
        let known = |new: bool| !new || version == Version::V06;
        let found = REQUESTS.iter().find(|(_, own, new)| *own == command && known(*new));
        found.filter(|_| asks).map(|(request, ..)| (node, *request))
    }
}

/// Bits of 0.5's heartbeat: errors of motor, encoder and controller; after the last one, trajectory done.
const DONE_05: u8 = 0x80;

impl Report {
    /// The frame of `node`. If the version does not know the report, it has the form of the other version.
    #[must_use]
    pub fn encode(&self, node: NodeId, version: Version) -> Frame {
        let two = |command, a: f32, b: f32| frame(node, command, joined(a.to_le_bytes(), b.to_le_bytes()));
        match *self {
            Self::Heartbeat(Heartbeat { error, state, trajectory_done, detail }) => {
                let done = u8::from(trajectory_done);
                let rest = match version {
                    Version::V05 => {
                        [state.number(), detail & 1, detail >> 1 & 1, (detail >> 2 & 1) | (done * DONE_05)]
                    }
                    Version::V06 => [state.number(), detail, done, 0],
                };
                frame(node, 0x01, joined(error.to_le_bytes(), rest))
            }
            Self::Errors(Errors { active, disarm_reason }) => {
                let reason = disarm_reason.unwrap_or_default();
                frame(node, 0x03, joined(active.to_le_bytes(), reason.to_le_bytes()))
            }
            Self::Estimates { rev, rev_s } => two(0x09, rev, rev_s),
            Self::Iq { wanted_a, measured_a } => two(0x14, wanted_a, measured_a),
            Self::Supply { volts, amperes } => two(0x17, volts, amperes),
            Self::Temperature { transistors_c, motor_c } => two(0x15, transistors_c, motor_c),
            Self::Torques { wanted_nm, estimated_nm } => two(0x1C, wanted_nm, estimated_nm),
            Self::Version { protocol, hardware: [a, b, c], firmware } => {
                frame(node, 0x00, joined([protocol, a, b, c], firmware))
            }
            Self::Sdo { endpoint, value } => {
                let [low, high] = endpoint.to_le_bytes();
                frame(node, 0x05, joined([0, low, high, 0], value))
            }
            Self::Address { serial } => {
                let [a, b, c, d, e, f, ..] = serial.to_le_bytes();
                frame(node, 0x06, [node.get(), a, b, c, d, e, f, 0])
            }
        }
    }

    /// The report in a frame, of an axis of `version`, and the axis. `None`: not a report.
    ///
    /// Orders have other ids; a frame with data on the id of a request is the answer.
    #[must_use]
    pub fn decode(from: &Frame, version: Version) -> Option<(NodeId, Self)> {
        let (node, command) = parts(from)?;
        if from.is_remote() {
            return None;
        }
        let data = from.data();
        let two = || Some((f32_at(data, 0)?, f32_at(data, 4)?));
        let new = version == Version::V06;
        let report = match command {
            0x01 => {
                let [state, a, b, c] = bytes(data, 4)?;
                let (detail, trajectory_done) = if new {
                    (a, b & 1 != 0)
                } else {
                    (a & 1 | (b & 1) << 1 | (c & 1) << 2, c & DONE_05 != 0)
                };
                let error = u32_at(data, 0)?;
                Self::Heartbeat(Heartbeat { error, state: AxisState::of(state), trajectory_done, detail })
            }
            0x03 => {
                let disarm_reason = if new { Some(u32_at(data, 4)?) } else { None };
                Self::Errors(Errors { active: u32_at(data, 0)?, disarm_reason })
            }
            0x09 => two().map(|(rev, rev_s)| Self::Estimates { rev, rev_s })?,
            0x14 => two().map(|(wanted_a, measured_a)| Self::Iq { wanted_a, measured_a })?,
            0x17 => two().map(|(volts, amperes)| Self::Supply { volts, amperes })?,
            0x15 if new => {
                two().map(|(transistors_c, motor_c)| Self::Temperature { transistors_c, motor_c })?
            }
            0x1C if new => {
                two().map(|(wanted_nm, estimated_nm)| Self::Torques { wanted_nm, estimated_nm })?
            }
            0x00 if new => {
                let [protocol, a, b, c] = bytes(data, 0)?;
                Self::Version { protocol, hardware: [a, b, c], firmware: bytes(data, 4)? }
            }
            0x05 if new => {
                let [_, low, high, _] = bytes(data, 0)?;
                Self::Sdo { endpoint: u16::from_le_bytes([low, high]), value: bytes(data, 4)? }
            }
            0x06 if new => {
                let [_, a, b, c, d, e, f] = bytes(data, 0)?;
                Self::Address { serial: u64::from_le_bytes([a, b, c, d, e, f, 0, 0]) }
            }
            _ => return None,
        };
        Some((node, report))
    }
}
