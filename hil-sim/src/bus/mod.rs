//! Classical CAN 2.0 as a shared medium: who may send, how long it takes, what happens on errors.
//!
//! Sources: CAN Specification 2.0 (Robert Bosch GmbH, 1991), part A sections 3 to 8 and part B for
//! 29-bit ids; ISO 11898-1 where it is more exact (overload at the last bit of a delimiter). Rule numbers in
//! comments ("rule 3, exception 1") are those of part A section 8, "Fault Confinement".
//!
//! # Two gears, one meaning
//!
//! * **Frame by frame**: while nothing is wrong, a frame is one event. It takes as many bits as its stuffed
//!   length says, and arbitration is a comparison of keys.
//! * **Bit by bit**: as soon as anything is out of the ordinary (an injected disturbance, two nodes
//!   with the same id, nobody to acknowledge, a line held dominant), every controller is run as the
//!   state machine it is, one bit at a time, until all of them are idle again. No case of the error
//!   rules is special: error flags overlap because the bits do.
//!
//! The second gear alone is a complete CAN; the first one exists for speed. A property test runs the same
//! traffic through both and demands the same events at the same nanosecond.
//!
//! | file | holds |
//! |---|---|
//! | [`encode`] | frame to bits: fields, checksum, stuffing |
//! | [`parse`] | bits to frame, one bit at a time, as a receiver does it |
//! | [`counters`] | TEC, REC, error-active, error-passive, bus-off |
//! | [`controller`] | one node's protocol machine, bit by bit; error signalling in a file of its own |
//! | [`queue`] | frames waiting in a node |
//! | [`config`], [`event`] | options of a bus; what it tells, what disturbs it |
//! | [`medium`] | the bus; each gear in a file of its own |
//! | [`stats`], [`report`] | figures per id and per node, as table and JSON |
//!
//! # What is not modelled
//!
//! Sub-bit timing: propagation, sample point and clock tolerance are taken as good. Bit rates other
//! than the bus's own: see [`crate::BusConnection::OtherRate`]. CAN FD.

pub mod config;
pub mod controller;
pub mod counters;
pub mod encode;
pub mod event;
pub mod medium;
pub mod parse;
pub mod queue;
pub mod report;
pub mod stats;

pub use config::{BitRateError, BusConfig, Recovery};
pub use counters::{Confinement, Counters};
pub use event::{BusEvent, Disturbance, QuietWire, Wire};
pub use medium::Bus;
pub use queue::{TxOrder, TxQueue};
pub use stats::{ErrorKind, IdStats, PortStats};
