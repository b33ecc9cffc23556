//! What can go wrong: on the wire, in a drive, at a supply, in the gripper.
//!
//! Wire faults act between the nodes and the bus and need nothing from a node. Physical faults
//! ([`physical`]) are handed to the cell, which knows what they mean for drive and arm.

pub mod physical;

pub use physical::{FaultTarget, NotApplicable, PhysicalFault, Place};
