//! A simulated lab: six PowerCube drives, the arm they move and the CAN bus they share.
//!
//! Written from the drive's protocol, never from this project's controller: this package does not depend on
//! `firmware`.
//!
//! # Map
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | medium | [`bus`] | classical CAN 2.0: bit time, stuffing, arbitration, acknowledge, error counters, bus-off, transmit queues, figures per id | know the meaning of a frame |
//! | participants | [`participants`] | the nodes on the bus, and the physical process behind them | know the scheduler |
//! | drives | [`drive`] | one PowerCube or one Damiao motor behind the wire, a [`protocol::Node`] | know the arm's other joints |
//! | physics | [`mechanics`] | rigid bodies, friction, supplies, gripper and ball | know CAN |
//! | faults | [`fault`] | possible faults, with time, place and probability; one random stream each | depend on the order in which faults are listed |
//! | virtual time | [`world`] | event queue that joins bus, participants and faults; same seed, same log | read a clock |
//! | real time | [`realtime`] | the same world behind a link of the operating system | change the behaviour of the world |
//! | seen from the bus | [`record`], [`checker`] | candump log, trace, invariants that only use frames | look into a node |
//! | industrial robot | [`krc`] | a robot controller behind Ethernet RSI, in virtual time, lock step or real time | know its client |
//! | tracker | [`tracker`] | an optical tracker: DTrack data and commands | know its client |
//! | two-arm cell | [`two_arms`] | two arms, a ball that bounces, cups as hands, the tracker that measures | move an arm; know its controller |
//! | results | [`report`] | a run in numbers, as table and JSON | judge |
//! | situations | [`scenario`], [`swarm`] | TOML and seeds to options; printed before a run | act on their own |
//!
//! # The interface between bus and drives
//!
//! A drive ([`drive::PowerCubeDrive`]) implements [`protocol::Node`]; the arm is one physical process that all drives act
//! on. Both belong to one *cell* ([`Cell`]), which implements [`participants::Participants`]:
//!
//! ```text
//! struct Cell { drives: Vec<PowerCubeDrive>, plant: Plant, .. }
//!
//! impl Participants for Cell {
//!     fn len(&self) -> usize                    // one node per drive
//!     fn node(&mut self, i) -> &mut dyn Node    // &mut self.drives[i]
//!     fn advance(&mut self, to: Instant)        // drives' torques into the arm, arm's state back
//!     fn connection(&self, i) -> BusConnection  // unpowered, or at another bit rate
//!     fn physics(&mut self) -> Option<&mut dyn FaultTarget>
//! }
//! ```
//!
//! * The world calls `advance(t)` before it hands any event of time `t` to any node, so a drive finds
//!   its own measured state current when it answers.
//! * Torques and positions cross inside `advance` only, in joint order: all drives compute their
//!   torque from the state at the start of a step, the arm takes the step, all drives read back.
//!   No drive sees another drive's half-finished step, so the order of joints cannot matter.
//! * `advance` is called at bus events, so how often depends on the traffic. The cell therefore keeps its
//!   own time grid (1 ms by default): it takes every whole step up to `to` and leaves the rest for the
//!   next call. Then one more listener on the bus cannot change the physics.
//! * Set-points that change inside a step act from the next grid point on; a drive that wants its
//!   answer finer than the grid extrapolates with its own velocity.
//! * Faults of drive, supply or gripper reach the cell through [`fault::FaultTarget`].
//!
//! # Invariants
//!
//! 1. Time is an integer and an argument. Below the real-time runner nothing reads a clock.
//! 2. Randomness comes from [`rng::Rng`] streams derived from the run's seed and a label; nothing
//!    else decides by chance, no map with random iteration order decides anything.
//! 3. Queues and loops are bounded; what does not fit is counted and reported.

#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod bus;
pub mod cell;
pub mod checker;
pub mod drive;
pub mod fault;
pub mod krc;
pub mod mechanics;
pub mod participants;
pub mod realtime;
pub mod record;
pub mod report;
pub mod rng;
pub mod scenario;
pub mod swarm;
pub mod tracker;
pub mod two_arms;
pub mod witness;
pub mod world;

pub use cell::{Cell, CellOptions};
pub use participants::{BusConnection, Participants};
pub use world::{Observer, World};
