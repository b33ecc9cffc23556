//! CAN over TCP in the socketcand protocol: a server that is a bus of its own, and a client.
//!
//! The text itself is [`protocol::text::socketcand`]; here are sockets, queues and the handshake.

mod client;
mod server;

pub use client::Client;
pub use server::{ClientId, Relay, Server, ServerEvent, ServerOptions};

use std::net::{SocketAddr, ToSocketAddrs};

use crate::error::OpenError;

/// All addresses of `host:port`, at least one.
pub(crate) fn resolve(host: &str, port: u16) -> Result<Vec<SocketAddr>, OpenError> {
    let error = |source| OpenError::Resolve { host: host.to_owned(), source };
    let addresses: Vec<_> = (host, port).to_socket_addrs().map_err(error)?.collect();
    if addresses.is_empty() {
        return Err(error(std::io::ErrorKind::NotFound.into()));
    }
    Ok(addresses)
}

/// `host:port`, with brackets around an IPv6 address.
pub(crate) fn host_port(host: &str, port: u16) -> String {
    if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
}
