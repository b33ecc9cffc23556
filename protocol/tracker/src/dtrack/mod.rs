//! A.R.T. DTrack2 and DTRACK3: one ASCII datagram per frame, commands over TCP.
//!
//! | module | holds |
//! |---|---|
//! | `data` | [`DataFrame`]: one datagram, read and written |
//! | `clock` | [`DayClock`]: time stamps that go on after midnight; [`FrameGate`]: which frames are new |
//! | `command` | [`Command`], [`Answer`], [`Messages`]: the command channel |

mod clock;
mod command;
mod data;

pub use clock::{DayClock, FrameGate, Verdict};
pub use command::{Answer, Command, MAX_MESSAGE_BYTES, Messages, Output};
pub use data::{
    Body, DataError, DataFrame, DataProblem, Hybrid, HybridState, MAX_DATAGRAM_BYTES, Marker, UnixStamp,
};
