//! Errors of links: what happened, where, and what to do next.

use std::io;
use std::path::PathBuf;

/// A link could not be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// An industrial robot behind its sensor interface: no CAN frames pass there.
    #[error("rsi:{spec} leads to an industrial robot, not to a CAN bus")]
    NoCan { spec: crate::spec::RsiSpec },
    /// The host name has no address.
    #[error("no address for host '{host}': {source}")]
    Resolve {
        /// Host, as written in the name of the bus.
        host: String,
        /// The resolver's answer.
        source: io::Error,
    },
    /// Nothing answers at the address.
    #[error("cannot connect to {address}: {source}")]
    Connect {
        address: String,
        /// The bus as given.
        spec: String,
        /// The system's answer.
        source: io::Error,
    },
    /// Something answers, but it is not the expected protocol.
    #[error("{address} answers, but not as a {protocol} server: {found}")]
    Protocol { address: String, protocol: &'static str, found: String },
    /// The server does not give access to the bus.
    #[error("{address} refuses the bus '{bus}': {reason}")]
    Refused {
        address: String,
        bus: String,
        /// The server's words.
        reason: String,
    },
    /// The server's port is not available.
    #[error("cannot listen at {address}: {source}")]
    Listen {
        address: String,
        /// The system's answer.
        source: io::Error,
    },
    /// `sim` is not a link of the operating system.
    #[error("'sim' is the cell inside this program, not a bus to connect to")]
    Embedded,
    /// An interface is joined, not served.
    #[error("the interface '{interface}' is a bus already; it is joined, not served")]
    NotServable {
        /// Interface, as written in the name of the bus.
        interface: String,
    },
    /// There is no such network interface.
    #[error("no interface '{interface}' (CAN interfaces of this machine: {present})")]
    NoInterface {
        /// Interface, as written in the name of the bus.
        interface: String,
        /// CAN interfaces that exist.
        present: String,
        /// What makes it appear.
        command: String,
    },
    /// The interface exists, but is of another kind.
    #[error("'{interface}' is not a CAN interface (CAN interfaces of this machine: {present})")]
    NotCan {
        /// Interface, as written in the name of the bus.
        interface: String,
        /// CAN interfaces that exist.
        present: String,
    },
    /// The interface is switched off.
    #[error("the interface '{interface}' is down")]
    InterfaceDown {
        /// Interface, as written in the name of the bus.
        interface: String,
        /// What brings it up.
        command: String,
    },
    /// The kernel does not know CAN sockets.
    #[error("cannot open '{interface}': the kernel has no CAN sockets")]
    NoCanInKernel {
        /// Interface, as written in the name of the bus.
        interface: String,
    },
    /// The right to open CAN sockets is missing.
    #[error("no permission to open '{interface}': {source}")]
    NoPermission {
        /// Interface, as written in the name of the bus.
        interface: String,
        /// The system's answer.
        source: io::Error,
    },
    /// The serial device cannot be opened or set up.
    #[error("cannot open {}: {source}", .path.display())]
    Device {
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    #[error("{} is not a serial device", .path.display())]
    NotSerial { path: PathBuf },
    /// A system call that always works did not.
    #[error("cannot set up {what} for {address}: {source}")]
    Setup {
        what: &'static str,
        /// Host and port, device or interface.
        address: String,
        /// The system's answer.
        source: io::Error,
    },
}

impl OpenError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NoCan { .. } => "give `--robot kr16_2` to a verb that knows such robots (throw, identify, doctor, status, record), or name a CAN bus".to_owned(),
            Self::Resolve { .. } => "check the name, or give the address in numbers".to_owned(),
            Self::Connect { spec, .. } => format!("check that the server runs and that host and port are \
         right (the simulated cell: `cubectl sim --bus {spec}`)"),
            Self::Protocol { .. } => "check the port".to_owned(),
            Self::Refused { reason, .. } => refusal_advice(reason).to_string(),
            Self::Listen { source, .. } => listen_advice(source).to_string(),
            Self::Embedded => "name an interface, a server or an adapter".to_owned(),
            Self::NotServable { interface, .. } => format!("join it, or serve socketcand://127.0.0.1:29536/{interface}"),
            Self::NoInterface { command, .. } => command.clone(),
            Self::NotCan { .. } => "name one of those, or `ip -details link show type can`".to_owned(),
            Self::InterfaceDown { command, .. } => command.clone(),
            Self::NoCanInKernel { .. } => "`sudo modprobe can_raw`; where the kernel has no such module (containers, some virtual machines), use socketcand:// or sim".to_owned(),
            Self::NoPermission { .. } => "in a container, run it with the capability NET_RAW; else check the seccomp or SELinux rules".to_owned(),
            Self::Device { source, .. } => device_advice(source).to_string(),
            Self::NotSerial { .. } => "`ls /dev/serial/by-id` shows those that are plugged in".to_owned(),
            _ => return None,
        })
    }
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

fn refusal_advice(reason: &str) -> &'static str {
    if reason.contains("too many clients") {
        "end a client that is not needed any more, then connect again"
    } else if reason.contains("real time") {
        "name the bus socketcand:// and not lockstep://, or serve it as lockstep://"
    } else {
        "ask for a bus that this server has"
    }
}

fn device_advice(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::NotFound => "plug the adapter in; `ls /dev/serial/by-id` shows those that are there",
        io::ErrorKind::PermissionDenied => {
            "join the group that owns the device (`sudo usermod -aG dialout $USER`, then log in again)"
        }
        io::ErrorKind::ResourceBusy => "another program uses it: `fuser -v` with the path names it",
        _ => "check the path and the adapter",
    }
}

/// A link that was open has failed.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// The far side closed the connection.
    #[error("{link}: the other side closed the connection")]
    Closed { link: String },
    /// The network interface was switched off.
    #[error("{link}: the interface went down")]
    InterfaceDown {
        link: String,
        /// What brings it up.
        command: String,
    },
    /// A CAN FD frame was to be sent where only classical CAN frames pass.
    #[error("{link}: carries classical CAN only, a CAN FD frame was not sent")]
    ClassicalOnly {
        link: String,
        /// What makes it carry CAN FD, or which link does.
        advice: String,
    },
    /// The system reports an error on an open link.
    #[error("{link}: {reason}")]
    Io {
        link: String,
        /// The kind, for programs.
        kind: io::ErrorKind,
        /// The system's words, for people.
        reason: String,
    },
}

impl LinkError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Closed { .. } => "see why it stopped, then connect again".to_owned(),
            Self::InterfaceDown { command, .. } => command.clone(),
            Self::ClassicalOnly { advice, .. } => advice.clone(),
            Self::Io { .. } => {
                "check the cable, the adapter and the interface, then open the link again".to_owned()
            }
        })
    }
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
    QueueFull { link: String },
    #[error(transparent)]
    Link(#[from] LinkError),
}

impl SendError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Link(error) => error.next(),
            Self::QueueFull { .. } => None,
        }
    }
}
