//! Wire formats of optical trackers, and the one pose that the rest of the project sees.
//!
//! The package reads and writes bytes. It holds no socket and reads no clock.
//!
//! ```
//! use tracker_protocol::dtrack::{DataFrame, DayClock};
//!
//! let datagram = b"fr 120\r\nts 44597.741924\r\n6dcal 1\r\n\
//!     6d 1 [0 1.000][2500.000 50.000 1000.000 0.0000 0.0000 90.0000]\
//!     [0.000000 1.000000 0.000000 -1.000000 0.000000 0.000000 0.000000 0.000000 1.000000]\r\n3d 0\r\n";
//! let frame = DataFrame::parse(datagram).unwrap();
//! let pose = frame.pose(0, &mut DayClock::new()).unwrap().unwrap();
//! assert_eq!(pose.position_m, [2.5, 0.05, 1.0]);
//! ```
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | [`pose`] | [`TrackedPose`]: m, unit quaternion, time stamp |
//! | [`dtrack`] | A.R.T. DTrack: datagrams with data, commands over TCP |
//! | [`vrpn`] | VRPN, for every other tracker: poses over TCP, as a client |

pub mod dtrack;
pub mod pose;
pub mod vrpn;

pub use pose::{NotARotation, TrackedPose};
