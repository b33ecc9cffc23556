//! The server side of a text protocol: many peers, one bus. What they say to each other is the
//! [`Dialect`]'s business; sockets, queues and fairness are the same for all.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpListener};

use protocol::{Duration, Frame, Instant};

use crate::clock::Clock;
use crate::error::{LinkError, OpenError, SendError};
use crate::link::{Event, Link, LinkStats, PollSet};
use crate::net::{host_port, resolve};
use crate::stream::{Chunk, Stream};

/// A peer that reads nothing for this long while output waits for it is disconnected.
const STALL_MAX: Duration = Duration::from_secs(10);

/// Pause before accepting again when the process has no descriptor left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Bytes taken from one peer per round, so that no peer starves the others.
const READ_CHUNK: usize = 4096;

/// Who passes a peer's frame on to the other peers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Relay {
    /// The server, as soon as it reads the frame: the server is the bus.
    #[default]
    AtOnce,
    /// The owner, with [`Hub::broadcast`]: the bus is a model that decides when, and whether, a
    /// frame gets through.
    ByOwner,
}

/// Settings of a [`Hub`].
#[derive(Clone, Copy, Debug)]
pub struct ServerOptions {
    /// Who passes a peer's frame on to the other peers.
    pub relay: Relay,
    /// Connections beyond this number are refused.
    pub clients_max: usize,
}

impl Default for ServerOptions {
    fn default() -> Self {
        Self { relay: Relay::AtOnce, clients_max: 32 }
    }
}

/// A peer for as long as it is connected; numbers are never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ClientId(u64);

/// What happens at the port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ServerEvent {
    /// A peer has connected.
    Joined {
        /// The new peer.
        client: ClientId,
        /// Its address, or the device it is at.
        peer: String,
    },
    /// A peer sent a frame.
    Frame {
        /// The sender.
        client: ClientId,
        /// Arrival by the server's clock.
        at: Instant,
        /// The frame.
        frame: Frame,
    },
    /// A peer is gone.
    Left {
        /// The former peer.
        client: ClientId,
        /// Why, for people.
        reason: &'static str,
    },
}

/// What a [`Dialect`] wants done with a peer.
pub enum Action<'a> {
    /// Send these bytes in a write of their own; never dropped.
    Answer(&'a [u8]),
    /// The peer puts this frame on the bus.
    Frame(Frame),
    /// Queue all output to this peer for a while, or until it puts a frame on the bus.
    Hold(Duration),
    /// Count something that could not be read.
    Malformed,
    /// Disconnect; the first reason counts.
    Leave(&'static str),
}

/// What is said on the server side of a protocol. Implementations keep no clock and no socket.
pub trait Dialect {
    /// State of one peer.
    type Session;

    /// A peer has connected.
    fn greet(&self, act: &mut dyn FnMut(Action<'_>)) -> Self::Session;

    /// What a peer beyond the limit is told.
    fn crowded(&self) -> &'static [u8];

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

    /// A frame for this peer was dropped because its output queue was full.
    fn note_loss(&self, session: &mut Self::Session);
}

/// A bus behind a port, for any number of peers up to [`ServerOptions::clients_max`].
///
/// Every peer receives every frame except its own. Each peer has an output queue of 64 KiB (more than
/// 1 000 frames); while it is full, new frames for *this* peer are dropped and counted in
/// [`LinkStats::dropped_out`], the others are not affected. Frames from peers are never dropped: no
/// more is read than the owner takes, and the medium slows the sender down.
pub struct Hub<D: Dialect> {
    name: String,
    dialect: D,
    /// None at a serial line.
    listener: Option<TcpListener>,
    clock: Clock,
    options: ServerOptions,
    peers: Vec<Peer<D::Session>>,
    next_id: u64,
    accept_paused_until: Option<Instant>,
    events: VecDeque<ServerEvent>,
    stats: LinkStats,
}

struct Peer<S> {
    session: S,
    line: Line,
}

/// The dialect-independent half of a peer.
struct Line {
    id: ClientId,
    stream: Stream,
    hold_until: Option<Instant>,
    /// Since when output waits without any of it being taken.
    stalled_since: Option<Instant>,
    /// Set when the connection is to be closed after this round.
    leaving: Option<&'static str>,
}

impl<D: Dialect> Hub<D> {
    /// Listens at `host:port` (port 0: any free one); `name_it` gets the address with the real port.
    pub(crate) fn at_port(
        host: &str,
        port: u16,
        clock: Clock,
        options: ServerOptions,
        name_it: impl FnOnce(SocketAddr) -> (String, D),
    ) -> Result<Self, OpenError> {
        let error = |source| OpenError::Listen { address: host_port(host, port), source };
        let addresses = resolve(host, port)?;
        let listener = TcpListener::bind(addresses.as_slice()).map_err(error)?;
        listener.set_nonblocking(true).map_err(error)?;
        let address = listener.local_addr().map_err(error)?;
        let (name, dialect) = name_it(address);
        let mut hub = Self::without_listener(name, dialect, clock, options);
        hub.listener = Some(listener);
        Ok(hub)
    }

    /// One peer at the other end of `stream`, from the start.
    pub(crate) fn at_stream(name: String, stream: Stream, dialect: D, clock: Clock) -> Self {
        let peer = name.clone();
        let mut hub = Self::without_listener(name, dialect, clock, ServerOptions::default());
        hub.greet(stream, peer, clock.now());
        hub
    }

    fn without_listener(name: String, dialect: D, clock: Clock, options: ServerOptions) -> Self {
        Self {
            name,
            dialect,
            listener: None,
            clock,
            options,
            peers: Vec::new(),
            next_id: 0,
            accept_paused_until: None,
            events: VecDeque::new(),
            stats: LinkStats::default(),
        }
    }

    pub(crate) const fn dialect(&self) -> &D {
        &self.dialect
    }

    /// Connected peers, whether they receive already or not.
    pub fn client_count(&self) -> usize {
        self.peers.len()
    }

    /// Next thing that happened at the port; reads, writes, accepts and closes as needed.
    ///
    /// An owner uses either this or [`Link::receive`], which leaves out comings and goings.
    pub fn next_event(&mut self) -> Option<ServerEvent> {
        if self.events.is_empty() {
            self.service();
        }
        let event = self.events.pop_front();
        if matches!(event, Some(ServerEvent::Frame { .. })) {
            self.stats.frames_in += 1;
        }
        event
    }

    /// Sends a frame that was on the bus at `at` to all receiving peers but `except`, its sender.
    pub fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        self.stats.frames_out += 1;
        self.deliver(at, frame, except);
    }

    /// Reports an error of the bus (class bits of Linux `can/error.h`) to all receiving peers.
    pub fn broadcast_bus_error(&mut self, at: Instant, class: u32) {
        let (now, unix) = (self.clock.now(), self.clock.to_unix(at));
        for Peer { session, line } in &mut self.peers {
            self.dialect.render_bus_error(session, unix, class, &mut |text| {
                line.stream.queue(text);
            });
            line.flush(now);
        }
    }

    fn deliver(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        let (now, unix) = (self.clock.now(), self.clock.to_unix(at));
        for Peer { session, line } in &mut self.peers {
            if Some(line.id) == except || line.leaving.is_some() {
                continue;
            }
            let mut lost = false;
            self.dialect.render(session, at, unix, frame, &mut |text| lost = !line.stream.queue(text));
            if lost {
                self.stats.dropped_out += 1;
                self.dialect.note_loss(session);
            }
            line.flush(now);
        }
    }

    fn service(&mut self) {
        let now = self.clock.now();
        self.accept(now);
        for peer in &mut self.peers {
            peer.service(&self.dialect, now, &mut self.events, &mut self.stats);
        }
        if self.options.relay == Relay::AtOnce {
            for index in 0..self.events.len() {
                if let Some(ServerEvent::Frame { client, at, frame }) = self.events.get(index) {
                    let (client, at, frame) = (*client, *at, *frame);
                    self.deliver(at, &frame, Some(client));
                }
            }
        }
        self.peers.retain(|peer| match peer.line.leaving {
            Some(reason) => {
                self.events.push_back(ServerEvent::Left { client: peer.line.id, reason });
                false
            }
            None => true,
        });
    }

    fn accept(&mut self, now: Instant) {
        if self.accept_paused_until.is_some_and(|until| now < until) {
            return;
        }
        self.accept_paused_until = None;
        // One more than can be connected, so that those beyond are refused in this round too.
        for _ in 0..=self.options.clients_max {
            let Some(listener) = &self.listener else { return };
            match listener.accept() {
                Ok((stream, peer)) => {
                    if let Ok(stream) = Stream::tcp(stream) {
                        self.greet(stream, peer.to_string(), now);
                    }
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // The connection was given up before it was accepted, or a signal came in between.
                Err(error)
                    if matches!(error.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) => {}
                Err(_) => {
                    self.accept_paused_until = Some(now + ACCEPT_PAUSE);
                    return;
                }
            }
        }
    }

    fn greet(&mut self, stream: Stream, peer: String, now: Instant) {
        let id = ClientId(self.next_id);
        let mut line = Line { id, stream, hold_until: None, stalled_since: None, leaving: None };
        if self.peers.len() >= self.options.clients_max {
            line.answer(self.dialect.crowded(), now);
            return;
        }
        self.next_id += 1;
        self.events.push_back(ServerEvent::Joined { client: id, peer });
        let session =
            self.dialect.greet(&mut |action| line.act(&action, now, &mut self.events, &mut self.stats));
        self.peers.push(Peer { session, line });
    }
}

impl<D: Dialect> Link for Hub<D> {
    fn name(&self) -> &str {
        &self.name
    }

    /// To all receiving peers; never fails, a full queue only shows in the counters.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.broadcast(self.clock.now(), frame, None);
        Ok(())
    }

    /// # Errors
    ///
    /// Only a server without a port, at a serial line, can lose its link.
    fn receive(&mut self) -> Result<Option<Event>, LinkError> {
        loop {
            match self.next_event() {
                Some(ServerEvent::Frame { at, frame, .. }) => {
                    return Ok(Some(Event::Frame { at, stamp: None, frame }));
                }
                Some(ServerEvent::Joined { .. } | ServerEvent::Left { .. }) => {}
                None if self.listener.is_none() && self.peers.is_empty() => {
                    return Err(LinkError::closed(&self.name));
                }
                None => return Ok(None),
            }
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        if let (Some(listener), None) = (&self.listener, self.accept_paused_until) {
            set.add(listener, false);
        }
        for Peer { line, .. } in &self.peers {
            set.add(&line.stream, line.stream.pending() > 0 && line.hold_until.is_none());
        }
    }

    fn deadline(&self) -> Option<Instant> {
        let lines = self.peers.iter().map(|peer| &peer.line);
        let holds = lines.clone().filter_map(|line| line.hold_until);
        let stalls = lines.filter_map(|line| line.stalled_since.map(|since| since + STALL_MAX));
        holds.chain(stalls).chain(self.accept_paused_until).min()
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}

impl<S> Peer<S> {
    fn service<D: Dialect<Session = S>>(
        &mut self,
        dialect: &D,
        now: Instant,
        events: &mut VecDeque<ServerEvent>,
        stats: &mut LinkStats,
    ) {
        self.line.flush(now);
        let mut chunk = [0; READ_CHUNK];
        let received = match self.line.stream.read(&mut chunk) {
            Ok(Chunk::Bytes(count)) => chunk.get(..count).unwrap_or(&[]),
            Ok(Chunk::Empty) => return,
            Ok(Chunk::Closed) => return self.line.leave("closed by the client"),
            Err(_) => return self.line.leave("connection lost"),
        };
        for byte in received {
            let line = &mut self.line;
            dialect.take(&mut self.session, *byte, &mut |action| line.act(&action, now, events, stats));
        }
    }
}

impl Line {
    fn act(
        &mut self,
        action: &Action<'_>,
        now: Instant,
        events: &mut VecDeque<ServerEvent>,
        stats: &mut LinkStats,
    ) {
        match *action {
            Action::Answer(text) => self.answer(text, now),
            Action::Frame(frame) => {
                events.push_back(ServerEvent::Frame { client: self.id, at: now, frame });
                // Whoever speaks has read the answer that the hold keeps apart, and waits for the next one.
                if self.hold_until.take().is_some() {
                    self.flush(now);
                }
            }
            Action::Hold(span) => self.hold_until = Some(now + span),
            Action::Malformed => stats.malformed_in += 1,
            Action::Leave(reason) => self.leave(reason),
        }
    }

    /// Answers are never dropped: a peer that does not read them is disconnected instead.
    fn answer(&mut self, text: &[u8], now: Instant) {
        if self.stream.queue(text) {
            self.flush(now);
        } else {
            self.leave("does not read its answers");
        }
    }

    fn flush(&mut self, now: Instant) {
        if self.hold_until.is_some_and(|until| now < until) {
            return;
        }
        self.hold_until = None;
        match self.stream.flush() {
            Ok(progress) => self.watch_progress(progress, now),
            Err(error) => self.leave(loss(&error)),
        }
    }

    fn watch_progress(&mut self, progress: bool, now: Instant) {
        if self.stream.pending() == 0 {
            self.stalled_since = None;
        } else if progress || self.stalled_since.is_none() {
            self.stalled_since = Some(now);
        } else if self.stream.can_hang_up()
            && self.stalled_since.is_some_and(|since| since + STALL_MAX <= now)
        {
            self.leave("reads nothing");
        } else if self.stalled_since.is_some_and(|since| since + STALL_MAX <= now) {
            // Nobody is at the other end of the serial line yet: what waits is stale.
            self.stream.discard_output();
            self.stalled_since = None;
        }
    }

    fn leave(&mut self, reason: &'static str) {
        self.leaving.get_or_insert(reason);
    }
}

fn loss(error: &io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => "closed by the client",
        _ => "connection lost",
    }
}
