//! The server side of a text protocol: many peers, one bus. The [`Dialect`] knows the texts; sockets, queues,
//! deadlines and fairness are the same for all.
//!
//! # Fairness
//!
//! * Each peer has a queue of its own for what it sends and one for what it gets, both bounded.
//! * In a turn (the calls of [`Hub::next_event`] up to the one that returns `None`) each peer is read once, 4 KiB at
//!   most. The frames of all peers are handed out in rotation, one of each.
//! * The server waits for a peer's data only while there is room for them. A peer that floods is slowed down by its own
//!   connection, and neither wakes the server nor delays the others.

mod dialect;
mod options;
mod peer;

use std::collections::VecDeque;
use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener};

use protocol::{Duration, Frame, Instant};

use crate::clock::Clock;
use crate::error::{LinkError, OpenError, SendError};
use crate::link::{CanLink, LinkEvent, LinkStats, PollSet};
use crate::net::resolve;
use crate::spec::host_port;
use crate::stream::{OUTPUT_QUEUE_BYTES, Stream};
use peer::{Line, Peer};

pub(crate) use dialect::{Action, Dialect};
pub use options::{ClientId, Relay, ServerEvent, ServerOptions};

/// Pause before accepting again when the process has no descriptor left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// A bus behind a port, for any number of peers up to [`ServerOptions::clients_max`].
///
/// Every peer receives every frame except its own. Each peer has an output queue of 64 KiB (more than
/// 1 000 frames); while it is full, new frames for *this* peer are dropped and counted in
/// [`LinkStats::dropped_out`], the others are not affected. Frames from peers are never dropped: no
/// more is read than the owner takes, and the medium slows the sender down.
pub struct Hub<D: Dialect> {
    name: String,
    dialect: D,
    /// `None` at a serial line.
    listener: Option<TcpListener>,
    clock: Clock,
    options: ServerOptions,
    peers: Vec<Peer<D::Session>>,
    /// Peer at which the rotation continues.
    next_peer: usize,
    /// The peers were read in this turn.
    served: bool,
    next_id: u64,
    accept_paused_until: Option<Instant>,
    events: VecDeque<ServerEvent>,
    stats: LinkStats,
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
            next_peer: 0,
            served: false,
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

    /// Next thing that happened at the port, or `None` at the end of a turn; reads, writes, accepts and closes as
    /// needed.
    ///
    /// An owner uses either this or [`CanLink::receive`], which does not report peers that join or leave.
    pub fn next_event(&mut self) -> Option<ServerEvent> {
        self.next_event_from(&mut |_| true)
    }

    /// As [`Self::next_event`], but only with frames of peers for which the owner `has_room`; frames of the others wait.
    pub fn next_event_from(&mut self, has_room: &mut dyn FnMut(ClientId) -> bool) -> Option<ServerEvent> {
        if !self.served {
            self.service();
            self.served = true;
        }
        let event = self.events.pop_front().or_else(|| self.next_said(has_room));
        self.served = event.is_some();
        event
    }

    fn next_said(&mut self, has_room: &mut dyn FnMut(ClientId) -> bool) -> Option<ServerEvent> {
        let count = self.peers.len();
        let index = (0..count).map(|step| (self.next_peer + step) % count).find(|index| {
            self.peers.get(*index).is_some_and(|peer| !peer.line.inbox.is_empty() && has_room(peer.line.id))
        })?;
        self.next_peer = index + 1;
        let peer = self.peers.get_mut(index)?;
        let event = peer.line.inbox.pop_front()?;
        peer.understand(&self.dialect, self.clock.now(), &self.options, &mut self.stats);
        if let ServerEvent::Frame { client, at, frame } = &event {
            self.stats.frames_in += 1;
            if self.options.relay == Relay::AtOnce {
                self.deliver(*at, frame, true, |peer| peer != *client);
            }
        }
        self.dismiss();
        Some(event)
    }

    /// Sends a frame that was on the bus at `at` to all receiving peers but `except`, its sender.
    pub fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        self.stats.frames_out += 1;
        self.deliver(at, frame, true, |peer| Some(peer) != except);
    }

    /// Sends a frame that was on the bus at `at` to one peer, if it receives.
    pub fn send_to(&mut self, client: ClientId, at: Instant, frame: &Frame) {
        self.stats.frames_out += 1;
        self.deliver(at, frame, true, |peer| peer == client);
    }

    /// Gives a peer in lock step its turn: sends `frames` and the time `now` together.
    pub fn give_turn(&mut self, client: ClientId, now: Instant, frames: &[(Instant, Frame)]) {
        for (at, frame) in frames {
            self.stats.frames_out += 1;
            self.deliver(*at, frame, false, |peer| peer == client);
        }
        for Peer { line, .. } in self.peers.iter_mut().filter(|peer| peer.line.id == client) {
            self.dialect.render_turn(now, &mut |text| line.answer(text, now, &self.options));
        }
    }

    /// Reports an error of the bus (class bits of Linux `can/error.h`) to all receiving peers.
    pub fn broadcast_bus_error(&mut self, at: Instant, class: u32) {
        let (now, unix) = (self.clock.now(), self.clock.to_unix(at));
        for Peer { session, line, .. } in &mut self.peers {
            self.dialect.render_bus_error(session, unix, class, &mut |text| {
                line.stream.queue(text);
            });
            line.flush(now, &self.options);
        }
    }

    /// With `at_once` the frame is written now. Without, it stays in the queue until something else is written.
    fn deliver(&mut self, at: Instant, frame: &Frame, at_once: bool, to: impl Fn(ClientId) -> bool) {
        let (now, unix) = (self.clock.now(), self.clock.to_unix(at));
        // The protocols have no text for CAN FD: as with a real server, such a frame does not get to a peer.
        let is_lost = frame.fd().is_some();
        for Peer { session, line, .. } in &mut self.peers {
            if !to(line.id) || line.leaving.is_some() {
                continue;
            }
            let mut lost = is_lost;
            if !is_lost {
                self.dialect.render(session, at, unix, frame, &mut |text| lost = !line.stream.queue(text));
            }
            if lost {
                self.stats.dropped_out += 1;
                self.dialect.note_loss(session);
            }
            if at_once || line.stream.pending() > OUTPUT_QUEUE_BYTES / 2 {
                line.flush(now, &self.options);
            }
        }
    }

    fn service(&mut self) {
        let now = self.clock.now();
        self.accept(now);
        for peer in &mut self.peers {
            peer.service(&self.dialect, now, &self.options, &mut self.stats);
        }
        self.dismiss();
    }

    /// Closes the connections that are over.
    fn dismiss(&mut self) {
        let events = &mut self.events;
        self.peers.retain(|peer| match peer.line.leaving {
            Some(reason) if peer.is_gone() => {
                events.push_back(ServerEvent::Left { client: peer.line.id, reason });
                false
            }
            _ => true,
        });
    }

    fn accept(&mut self, now: Instant) {
        if self.accept_paused_until.is_some_and(|until| now < until) {
            return;
        }
        self.accept_paused_until = None;
        // One more than the number of peers, so that those beyond the limit are refused in this round too.
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
        let mut line = Line::new(id, stream, now);
        if self.peers.len() >= self.options.clients_max {
            line.answer(&self.dialect.crowded(self.options.clients_max), now, &self.options);
            return;
        }
        self.next_id += 1;
        self.events.push_back(ServerEvent::Joined { client: id, peer });
        let (options, stats) = (&self.options, &mut self.stats);
        let session = self.dialect.greet(&mut |action| line.act(&action, now, options, stats));
        self.peers.push(Peer::new(session, line));
    }
}

impl<D: Dialect> CanLink for Hub<D> {
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
    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        loop {
            match self.next_event() {
                Some(ServerEvent::Frame { at, frame, .. }) => {
                    return Ok(Some(LinkEvent::Frame { at, stamp: None, frame }));
                }
                Some(_) => {}
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
        self.peers.iter().for_each(|peer| peer.register(set));
    }

    fn deadline(&self) -> Option<Instant> {
        let peers = self.peers.iter().filter_map(|peer| peer.line.deadline(&self.options));
        peers.chain(self.accept_paused_until).min()
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}
