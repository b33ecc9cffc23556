//! What goes wrong with links: what happened, where, and what to do next.

use std::io;

/// A link could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// The host name has no address.
    #[error("no address for host '{host}': {source}\n  next: check the name, or give the address in numbers")]
    Resolve {
        /// As given.
        host: String,
        /// The resolver's answer.
        source: io::Error,
    },
    /// Nothing answers at the address.
    #[error(
        "cannot connect to {address}: {source}\n  next: check that the server runs and that host and port are \
         right (the simulated cell: `hil-sim serve --bus {spec}`)"
    )]
    Connect {
        /// Host and port.
        address: String,
        /// The bus as given.
        spec: String,
        /// The system's answer.
        source: io::Error,
    },
    /// Something answers, but it is not the expected protocol.
    #[error("{address} answers, but not as a {protocol} server: {found}\n  next: check the port")]
    Protocol {
        /// Host and port.
        address: String,
        /// The expected protocol.
        protocol: &'static str,
        /// What came instead.
        found: String,
    },
    /// The server does not give access to the bus.
    #[error("{address} refuses the bus '{bus}': {reason}\n  next: ask for a bus that this server has")]
    Refused {
        /// Host and port.
        address: String,
        /// The bus asked for.
        bus: String,
        /// The server's words.
        reason: String,
    },
    /// The server's port cannot be had.
    #[error("cannot listen at {address}: {source}\n  next: {}", listen_advice(.source))]
    Listen {
        /// Host and port.
        address: String,
        /// The system's answer.
        source: io::Error,
    },
    /// A system call that always works did not.
    #[error("cannot set up {what} for {address}: {source}")]
    Setup {
        /// The operation.
        what: &'static str,
        /// Host and port, device or interface.
        address: String,
        /// The system's answer.
        source: io::Error,
    },
}

fn listen_advice(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::AddrInUse => {
            "another program serves this port: stop it (`ss -ltnp` names it) or take another port"
        }
        io::ErrorKind::AddrNotAvailable => "this machine does not have that address; 127.0.0.1 always works",
        io::ErrorKind::PermissionDenied => "ports below 1024 belong to root: take a higher one",
        _ => "take another address or port",
    }
}

/// A link that was open is gone.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// The far side closed the connection.
    #[error("{link}: the other side closed the connection\n  next: see why it stopped, then connect again")]
    Closed {
        /// Name of the link.
        link: String,
    },
    /// The system reports an error on an open link.
    #[error(
        "{link}: {reason}\n  next: check the cable, the adapter and the interface, then open the link again"
    )]
    Io {
        /// Name of the link.
        link: String,
        /// The kind, for programs.
        kind: io::ErrorKind,
        /// The system's words, for people.
        reason: String,
    },
}

impl LinkError {
    pub(crate) fn io(link: &str, error: &io::Error) -> Self {
        Self::Io { link: link.to_owned(), kind: error.kind(), reason: error.to_string() }
    }

    pub(crate) fn closed(link: &str) -> Self {
        Self::Closed { link: link.to_owned() }
    }
}

/// A frame was not sent.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SendError {
    /// The output queue was full; this frame is dropped and counted, earlier ones stay in order.
    #[error("{link}: the output queue is full, the frame was dropped; the other side reads too slowly")]
    QueueFull {
        /// Name of the link.
        link: String,
    },
    /// The link is gone.
    #[error(transparent)]
    Link(#[from] LinkError),
}
