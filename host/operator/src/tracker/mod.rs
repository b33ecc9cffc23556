//! Targets from an optical tracker: position of a body, its uncertainty, and the place of the room relative to the robot.
//!
//! ```text
//! client        sockets: DTrack data and commands, VRPN
//!    |     \
//!    v      v
//! frames   commands       datagrams and pieces of a stream to frames; start and stop of a measurement
//!    v
//! target   calibration    mean over frames with its scatter, or the reason without one; room to robot from points
//! ```
//!
//! Only [`client`] does IO; the others take bytes, times and points as arguments.

pub mod calibration;
pub mod client;
pub mod commands;
pub mod frames;
pub mod target;
