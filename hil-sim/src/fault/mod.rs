//! Possible faults: on the wire, in a drive, at a supply, in the gripper.
//!
//! | file | holds |
//! |---|---|
//! | [`plan`] | the entries: what, where, when, how likely |
//! | [`engine`] | carries a plan out, one random stream per entry |
//! | [`physical`] | faults behind the wire, and the contract of a cell that can have them |
//!
//! Wire faults act between the nodes and the bus and need nothing from a node. Physical faults are passed to the
//! cell, which applies them to drive and arm.

pub mod engine;
pub mod physical;
pub mod plan;

pub use engine::{Action, Delivery, Engine, FaultCount};
pub use physical::{FaultTarget, NotApplicable, PhysicalFault, Place};
pub use plan::{Fault, FaultKind, IdFilter, Moment, Target, ThrowTime, WireFault, WrongPart};
