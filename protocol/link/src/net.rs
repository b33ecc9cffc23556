//! Host names and TCP connections.

use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::Duration;

use crate::error::OpenError;
use crate::spec::host_port;
use crate::stream::Stream;

/// For each address of the host.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// All addresses of `host:port`, at least one.
pub(crate) fn resolve(host: &str, port: u16) -> Result<Vec<SocketAddr>, OpenError> {
    let error = |source| OpenError::Resolve { host: host.to_owned(), source };
    let addresses: Vec<_> = (host, port).to_socket_addrs().map_err(error)?.collect();
    if addresses.is_empty() {
        return Err(error(std::io::ErrorKind::NotFound.into()));
    }
    Ok(addresses)
}

/// Connects to the first address that answers; `spec` is for the error.
pub(crate) fn dial(host: &str, port: u16, spec: &str) -> Result<Stream, OpenError> {
    let place = host_port(host, port);
    let mut last = std::io::ErrorKind::NotFound.into();
    for address in resolve(host, port)? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                let setup = |source| OpenError::Setup { what: "the connection", address: place, source };
                return Stream::tcp(stream).map_err(setup);
            }
            Err(error) => last = error,
        }
    }
    Err(OpenError::Connect { address: place, spec: spec.to_owned(), source: last })
}
