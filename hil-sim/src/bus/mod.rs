//! CAN 2.0 and CAN FD as a shared medium: arbitration, duration of frames, errors.
//!
//! Sources: CAN Specification 2.0 (Robert Bosch GmbH, 1991), part A sections 3 to 8 and part B for
//! 29-bit ids. Rule numbers in comments ("rule 3, exception 1") are those of part A section 8, "Fault Confinement".
//!
//! CAN FD: length of frames by ISO 11898-1:2015, the data phase at a rate of its own if the frame switches. A controller that does not
//! know CAN FD answers such a frame with an error flag.
//!
//! A frame is one event. It takes exactly the bits of its stuffed length, and arbitration is a comparison of keys.
//! A frame that fails ends in error flags; `errors` in [`medium`] has the times and the cost for each node.
//!
//! | file | holds |
//! |---|---|
//! | [`counters`] | TEC, REC, error-active, error-passive, bus-off |
//! | [`controller`] | one node: on the bus, bus-off, waiting to join |
//! | [`queue`] | frames waiting in a node |
//! | [`config`], [`event`] | options of a bus; events that it reports, disturbances |
//! | [`medium`] | the bus; attempts to send and their errors in a file each |
//! | [`stats`], [`report`] | figures per id and per node, as table and JSON |
//!
//! # What is not modelled
//!
//! Levels within a frame, overload frames, and a stuff bit of the own id that is overwritten (rule 3, exception 2).
//! Propagation, sample point and clock tolerance are assumed correct. Bit rates other than the bus's own: see
//! [`crate::BusConnection::OtherRate`].

pub mod config;
pub mod controller;
pub mod counters;
pub mod event;
pub mod medium;
pub mod queue;
pub mod report;
pub mod stats;

pub use config::{BitRateError, BusConfig, Recovery};
pub use counters::{Confinement, Counters};
pub use event::{BusEvent, Disturbance, QuietWire, Wire};
pub use medium::Bus;
pub use queue::{TxOrder, TxQueue};
pub use stats::{ErrorKind, IdStats, PortStats};
