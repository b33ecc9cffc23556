//! Joint-group controller: leads up to eight joints along an uploaded spline with saturated state feedback, and stops
//! them when anything is wrong. One core for a PC, an emulated Cortex-M and a board.
//!
//! # Map
//!
//! Each layer uses only those above it.
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | base | [`joints`], [`span`], `root`, [`crc`], [`credentials`] | one value per joint, time as f32, square root, checksums, names and keys of nodes | know anything else |
//! | maths | [`spline`], [`retarget`], [`feedback`], [`path`] | reference, new end states in flight, control law, slowing down along the path | keep state of a bus; time is an argument |
//! | data | [`fault`], [`reach`], [`settings`], [`registers`], [`envelope`], [`events`], [`trajectory_format`], [`segment`] | numbered causes, where a joint may be led, what can be set, limits of new end states, outputs along a plan, the file that a host uploads, and how a longer plan goes on | act |
//! | interface | [`group`] | calls and events between the controller and a group of drives | know a family of drives |
//! | drives | [`groups`] | one module per family: packets, parameters, state words, how a drive moves | know orders or states of the controller |
//! | parts | [`state`], [`orders`], [`supervisor`], [`rest`], [`gripper`], [`store`], [`authority`] | states, what is legal when, what must hold, the release, power-proof storage, who may order | send packets |
//! | view | [`telemetry`], [`trace`], [`freeze`] | what people see during a run and afterwards | influence anything |
//! | whole | [`controller`] | state machine, path, law; all control flow | know a frame, a parameter, Cyphal, a board or a clock |
//! | host link | [`host_link`] | the controller as a Cyphal node: orders, registers, upload, samples translated | decide anything |
//! | board | [`runner`] | the loop of a board over `embedded-can`, `embedded-hal` and a clock | know a chip, or wait |
//!
//! A cycle, from left to right: packet → [`groups`] → [`group::GroupEvent`] → [`controller`] (with [`spline`], [`feedback`],
//! [`supervisor`]) → [`group::SetPoint`] → [`groups`] → packets.
//!
//! # Invariants
//!
//! 1. `no_std`, no heap, no `unsafe`, no path that panics; every loop is bounded by a constant or by the joints.
//! 2. Time and frames are arguments. Floats are f32, functions come from `libm`: the same calls give the same
//!    frames, byte for byte, on a PC and on a Cortex-M.
//! 3. Motion commands are sent in Homing, Jogging, Running and Stopping only, and never beyond the limits in [`settings`].
//!    A group sends no motion after [`group::Command::Stand`], [`group::Command::Halt`] or [`group::Command::Find`].
//! 4. The first cause is latched; after a stop nothing moves until an operator arms again.
//! 5. A reply is never matched to another request ([`groups::powercube::drives`] explains why).
//! 6. A trajectory runs only after all checks of [`trajectory_format`], from where the joints are, under the
//!    name the host gave it.

#![warn(missing_docs)]
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing
    )
)]

pub mod authority;
pub mod controller;
pub mod crc;
pub mod credentials;
pub mod envelope;
pub mod events;
pub mod fault;
pub mod feedback;
pub mod freeze;
pub mod gripper;
pub mod group;
pub mod groups;
pub mod host_link;
pub mod joints;
pub mod orders;
pub mod path;
pub mod reach;
pub mod registers;
pub mod rest;
pub mod retarget;
mod root;
pub mod runner;
pub mod segment;
pub mod settings;
pub mod span;
pub mod spline;
pub mod state;
pub mod store;
pub mod supervisor;
pub mod telemetry;
pub mod trace;
pub mod trajectory_format;

pub use controller::Controller;
pub use host_link::ControllerNode;
pub use runner::Runner;
