//! Targets from an optical tracker: where a body is, how sure that is, and where the room is seen from the robot.
//!
//! ```text
//! client        frames from a socket: DTrack data and commands, VRPN
//!    |     \
//!    v      v
//! target   calibration    mean over frames with its scatter, or why there is none; room to robot from points
//! ```
//!
//! [`target`] and [`calibration`] take frames and points as arguments and do no IO.

pub mod calibration;
pub mod client;
pub mod target;
