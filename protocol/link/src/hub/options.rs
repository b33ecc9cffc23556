//! Settings of a server, and the events that it reports to its owner.

use protocol::{Duration, Frame, Instant};

/// Which side passes a peer's frame on to the other peers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Relay {
    /// The server, when its owner takes the frame: the server is the bus.
    #[default]
    AtOnce,
    /// The owner, with [`Hub::broadcast`](super::Hub::broadcast): the bus is a model that decides when, and whether, a
    /// frame gets through.
    ByOwner,
}

/// Settings of a [`Hub`](super::Hub).
#[derive(Clone, Copy, Debug)]
pub struct ServerOptions {
    /// Which side passes a peer's frame on to the other peers.
    pub relay: Relay,
    /// Connections beyond this number get a refusal and are closed.
    pub clients_max: usize,
    /// A peer that has not opened the bus this long after it connected is disconnected.
    pub handshake_max: Duration,
    /// A peer that reads nothing for this long while output waits for it is disconnected. By default 10 s: TCP
    /// repeats lost data after 0.2, 0.4, 0.8 s and so on, so this bridges a network failure of 6 s. It costs 64 KiB
    /// for each peer, and no other peer waits for it.
    pub stall_max: Duration,
}

impl Default for ServerOptions {
    fn default() -> Self {
        Self {
            relay: Relay::AtOnce,
            clients_max: 32,
            handshake_max: Duration::from_secs(5),
            stall_max: Duration::from_secs(10),
        }
    }
}

/// A peer for as long as it is connected; numbers are never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ClientId(pub(super) u64);

impl ClientId {
    /// An id for servers that are not a [`Hub`](super::Hub), such as those of tests.
    pub const fn from_number(number: u64) -> Self {
        Self(number)
    }
}

/// What happens at the port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ServerEvent {
    /// A peer has connected.
    Joined {
        client: ClientId,
        /// Its address, or the device it is at.
        peer: String,
    },
    /// A peer sent a frame.
    Frame {
        client: ClientId,
        /// Arrival by the server's clock.
        at: Instant,
        frame: Frame,
    },
    /// From now on virtual time waits for this peer; it is the peer's turn.
    InStep { client: ClientId },
    /// The turn of a peer is over.
    Waits {
        client: ClientId,
        /// When the peer needs its next turn, if no frame comes before.
        until: Instant,
        /// Frames that come before this time wait until then.
        frames_from: Instant,
    },
    /// A peer has left; all its frames were reported before.
    Left {
        client: ClientId,
        /// Why, for people.
        reason: &'static str,
    },
}
