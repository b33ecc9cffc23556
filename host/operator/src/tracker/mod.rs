//! Targets from an optical tracker: where a body is, how sure that is, and where the room is seen from the robot.
//!
//! ```text
//! client        sockets: DTrack data and commands, VRPN
//!    |     \
//!    v      v
//! frames   commands       datagrams and pieces of a stream to frames; start and stop of a measurement
//!    v
//! target   calibration    mean over frames with its scatter, or why there is none; room to robot from points
//! ```
//!
//! Only [`client`] does IO; the others take bytes, times and points as arguments.

pub mod calibration;
pub mod client;
pub mod commands;
pub mod frames;
pub mod target;
