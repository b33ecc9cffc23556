//! What a text protocol adds to a server: the words.

use protocol::{Duration, Frame, Instant};

/// What a [`Dialect`] orders the hub to do with a peer.
pub enum Action<'a> {
    /// Send these bytes in a write of their own; never dropped.
    Answer(&'a [u8]),
    /// The peer puts this frame on the bus.
    Frame(Frame),
    /// Queue all output to this peer for a while, or until it puts a frame on the bus.
    Hold(Duration),
    /// Virtual time waits for the peer from now on.
    InStep,
    /// The peer's turn is over.
    Wait {
        /// As of [`ServerEvent::Waits`](super::ServerEvent::Waits).
        until: Instant,
        /// As of [`ServerEvent::Waits`](super::ServerEvent::Waits).
        frames_from: Instant,
    },
    /// Count something that could not be read.
    Malformed,
    /// Disconnect; the first reason counts.
    Leave(&'static str),
}

/// The server side of a text protocol, without clock and socket.
pub trait Dialect {
    /// State of one peer.
    type Session;

    /// A peer has connected.
    fn greet(&self, act: &mut dyn FnMut(Action<'_>)) -> Self::Session;

    /// What a peer beyond the limit of `clients_max` gets before it is disconnected.
    fn crowded(&self, clients_max: usize) -> Vec<u8>;

    /// True once the peer has opened the bus: its handshake is over.
    fn is_open(&self, session: &Self::Session) -> bool;

    /// The next byte from the peer.
    fn take(&self, session: &mut Self::Session, byte: u8, act: &mut dyn FnMut(Action<'_>));

    /// Text of a frame for this peer, given to `put`, if it listens; `unix` and `at` are the time of
    /// the frame.
    fn render(
        &self,
        session: &Self::Session,
        at: Instant,
        unix: Instant,
        frame: &Frame,
        put: &mut dyn FnMut(&[u8]),
    );

    /// Text of a bus error for this peer, given to `put`, if it listens.
    fn render_bus_error(
        &self,
        session: &mut Self::Session,
        unix: Instant,
        class: u32,
        put: &mut dyn FnMut(&[u8]),
    );

    /// Text that gives this peer its turn at the virtual time `now`; empty in a protocol without lock step.
    fn render_turn(&self, now: Instant, put: &mut dyn FnMut(&[u8])) {
        let _ = (now, put);
    }

    /// A frame for this peer was dropped because its output queue was full.
    fn note_loss(&self, session: &mut Self::Session);
}
