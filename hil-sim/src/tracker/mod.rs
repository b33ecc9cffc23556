//! A simulated optical tracker: DTrack data over UDP, commands over TCP.
//!
//! | module | holds |
//! |---|---|
//! | [`options`] | rate, latency, noise, bodies and how they move, faults |
//! | [`scene`] | true poses, and their measurement by the cameras |
//! | [`server`] | [`Tracker`]: measurement, outputs and command channel; sans-IO, time as an argument |
//! | [`scenario`] | TOML to options |
//! | [`serve`] | the same tracker behind sockets, in real time |

pub mod options;
pub mod scenario;
pub mod scene;
pub mod serve;
pub mod server;

pub use options::{BodyMotion, BodyOptions, TrackerFault, TrackerFaultKind, TrackerOptions};
pub use scenario::TrackerScenario;
pub use server::{Connection, Tracker};
