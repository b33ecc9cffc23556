//! Standard messages and services, both directions, one type group per file.
//!
//! Source of every layout and port number: the public regulated data types (namespace `uavcan`),
//! checked against `pycyphal` by the vectors in `protocol/tests/cyphal_vectors.txt`.
//!
//! `EXTENT` constants are the bytes a receiver keeps: all the fields known here. Later minor versions may append
//! fields; those are cut off, as the specification requires.

pub mod command;
pub mod diagnostic;
pub mod file;
pub mod heartbeat;
pub mod info;
pub mod port_list;
pub mod register;
pub mod value;
