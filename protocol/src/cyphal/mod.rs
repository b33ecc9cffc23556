//! Cyphal/CAN v1.0: the link between the controller and its hosts, on 29-bit ids.
//!
//! A standard instead of something home-made, so that unmodified public tools (`yakut`, `pycyphal`)
//! can look into the controller, and so that nobody has to learn another protocol. Written from the
//! *Cyphal Specification v1.0* for classical CAN (8-byte frames).
//!
//! # Layers (arrows go up the table)
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | serialisation | [`bits`], [`crc`] | DSDL bit fields, checksums | know a message |
//! | transport | [`id`], [`tx`], [`rx`] | frames to transfers and back | know what bytes mean, read a clock |
//! | messages | [`uavcan`], [`cubecell`] | standard types; our own types (`protocol/dsdl/cubecell`) | know who sends them when |
//! | node | [`server`], [`client`], [`upload`], [`host`] | what every node does; requests in flight; file transfer; a host | do IO, know the controller |
//!
//! # Shared bus
//!
//! The drives speak on 11-bit ids 0x061..=0x100. A Cyphal message of priority 0 wins against all of
//! them and everything of another priority loses; only *stop* may use priority 0 (tested in
//! [`id`]). UAVCAN v0 frames, 11-bit frames and remote frames are counted and ignored.

pub mod bits;
pub mod client;
pub mod crc;
pub mod cubecell;
pub mod host;
pub mod id;
pub mod rx;
pub mod server;
pub mod tx;
pub mod uavcan;
pub mod upload;
