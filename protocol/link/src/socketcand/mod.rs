//! CAN over TCP in the socketcand protocol: a server that is a bus of its own, and a client.
//!
//! [`protocol::text::socketcand`] has the texts; this module has their sequence.

mod client;
mod server;

pub use crate::hub::{ClientId, Relay, ServerEvent, ServerOptions};
pub use client::Client;
pub use server::Server;
