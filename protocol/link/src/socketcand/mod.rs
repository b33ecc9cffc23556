//! CAN over TCP in the socketcand protocol: a server that is a bus of its own, and a client.
//!
//! The text itself is [`protocol::text::socketcand`]; here is who says what when.

mod client;
mod server;

pub use crate::hub::{ClientId, Relay, ServerEvent, ServerOptions};
pub use client::Client;
pub use server::Server;
