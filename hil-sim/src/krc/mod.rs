//! A simulated robot controller (KR C) behind KUKA.Ethernet RSI XML: it sends one telegram per cycle and follows the
//! corrections of the answers.
//!
//! Written from the description of the interface and from published measurements, never from the client of this project.
//!
//! # One cycle
//!
//! ```text
//! (1) set point = start pose + accepted correction, clamped to the limits of the correction object
//! (2) overall limit, axis range, velocity, acceleration, jerk          -> FAULT
//! (3) the actual axes follow with dead time and a first-order lag
//! (4) send <Rob>
//! (5) until the window ends: take the first answer with the right Type and IPOC, drop all others
//! (6) no answer: count it as late, hold or zero each value; over the limit  -> FAULT
//! ```
//!
//! # States
//!
//! ```text
//! Off --start--> Open --connected--> Run --Stop = 1--> Off
//!  ^              |                   |
//!  |<--refused----+                   +--step 2 or 6, connection lost--> Fault --start--> Open
//! ```
//!
//! In `Fault` the arm brakes and nothing more is sent: the client gets no reason. A new start takes the present
//! pose of the arm as its start pose.
//!
//! # Map
//!
//! | module | holds |
//! |---|---|
//! | [`options`] | parameters; generation defaults |
//! | `state` | states of the controller, and why it cannot start |
//! | [`controller`] | [`Krc`]: the state machine, sans-IO, time as an argument |
//! | `check` | whether options, configuration file and robot fit together |
//! | [`correction`] | values of an answer to a set point |
//! | [`monitor`] | limits that stop the robot |
//! | [`late`] | the counter of late answers |
//! | [`drives`] | from set points to actual axes: dead time, lag, smoothing |
//! | [`hand`] | gripper and ball at the actual tool |
//! | [`link`] | telegrams lost, late, doubled, reordered, torn, or with a wrong IPOC |
//! | [`mod@bench`] | controller, link and a client in virtual time: same seed, same log |
//! | [`scenario`] | TOML to options and faults |
//! | [`serve`], `port` | the same controller behind a UDP or TCP socket, in real time or in lock step |

pub mod bench;
mod check;
pub mod controller;
pub mod correction;
pub mod drives;
pub mod event;
pub mod hand;
pub mod late;
pub mod link;
pub mod monitor;
pub mod options;
mod port;
pub mod scenario;
pub mod serve;
mod state;

pub use bench::{Bench, Client, Reply, RobotFault};
pub use controller::Krc;
pub use event::{CycleRecord, FaultCause, KrcEvent, Refused};
pub use link::{DatagramLink, Direction, LinkFault, LinkFaultKind, LinkOptions};
pub use options::{KrcOptions, Space};
pub use scenario::KrcScenario;
pub use state::{KrcError, State};
