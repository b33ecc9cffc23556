//! Joint-group controller: tracks uploaded splines with saturated state feedback and speaks ramp-extended
//! commands to up to eight PowerCube drives. One core for a PC, an emulated Cortex-M and a board.
//!
//! # Map
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | ground | [`joints`], [`span`], [`crc`] | one value per joint, time as f32, checksums | know anything else |
//! | maths | [`spline`], [`feedback`], [`ramp`](groups::powercube::ramp), [`path`], [`drive_model`](groups::powercube::drive_model) | reference, control law, acceleration in the words of a ramp drive, slowing down along the path, what a drive should do; a host simulates with the same code | keep bus or state, know time but as an argument |
//! | facts | [`fault`], [`settings`], [`registers`], [`trajectory_format`] | numbered causes, what can be set, the file a host uploads | act |
//! | bus | [`drives`](groups::powercube::drives), [`rest`], [`schedule`](groups::powercube::schedule), [`pace`](groups::powercube::pace), [`transmit`](groups::powercube::transmit) | which reply belongs to which request, whether a joint stands, who is asked next, how long a cycle takes, frames out | decide about motion |
//! | group | [`state`], [`orders`], [`supervisor`], [`gripper`], [`store`] | states, what is legal when, what must hold, the release, power-proof storage | send frames |
//! | view | [`telemetry`], [`trace`], [`freeze`] | what people see, now and afterwards | influence anything |
//! | whole | [`controller`] | the [`protocol::Node`]; all control flow | know Cyphal, a board or a clock |
//! | host link | [`host_link`] | the controller as a Cyphal node: orders, registers, upload, samples translated | decide anything |
//!
//! A cycle, from left to right: reply → [`drives`](groups::powercube::drives) → [`feedback`] (with [`spline`]) → [`ramp`](groups::powercube::ramp) → [`schedule`](groups::powercube::schedule) → frames,
//! with [`supervisor`] looking on.
//!
//! # Invariants
//!
//! 1. `no_std`, no heap, no `unsafe`, no path that panics; every loop is bounded by a constant or by the joints.
//! 2. Time and frames are arguments. Floats are f32, functions come from `libm`: the same calls give the same
//!    frames, byte for byte, on a PC and on a Cortex-M.
//! 3. A motion command leaves in Homing, Jogging, Running and Stopping only, through one function
//!    (`Controller::ask`), and never beyond the limits in [`settings`].
//! 4. The first cause is latched; after a stop nothing moves until somebody arms anew.
//! 5. A reply is never taken for another ([`drives`](groups::powercube::drives) says why).
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
pub mod fault;
pub mod feedback;
pub mod freeze;
pub mod gripper;
pub mod groups;
pub mod host_link;
pub mod joints;
pub mod orders;
pub mod path;
pub mod registers;
pub mod rest;
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
