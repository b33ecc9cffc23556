//! Server side: a TCP port that behaves like socketcand in front of a bus.

use std::collections::VecDeque;
use std::io::ErrorKind;
use std::net::{SocketAddr, TcpListener, TcpStream};

use protocol::text::socketcand::{Assembled, Assembler, Command, CommandError, MESSAGE_MAX, Message};
use protocol::{Duration, Frame, Instant};

use super::host_port;
use crate::clock::Clock;
use crate::error::{LinkError, OpenError, SendError};
use crate::link::{Event, Link, LinkStats, PollSet};
use crate::stream::{Chunk, Stream};

/// How long frames wait after the answer to `rawmode`.
///
/// python-can compares everything one `recv()` returns with `< ok >`, so a frame that arrives in the
/// same read ends its handshake with an error. Waiting lets the client pick up the answer alone.
const RAWMODE_HOLD: Duration = Duration::from_millis(50);

/// A client that reads nothing for this long while output waits for it is disconnected.
const STALL_MAX: Duration = Duration::from_secs(10);

/// Bytes outside of messages after which a connection that never opened a bus is taken for another
/// protocol and closed.
const FOREIGN_BYTES_MAX: u64 = 1024;

/// Pause before accepting again when the process has no descriptor left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Bytes taken from one client per round, so that no client starves the others.
const READ_CHUNK: usize = 4096;

/// Who passes a client's frame on to the other clients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Relay {
    /// The server, as soon as it reads the frame: the server is the bus.
    #[default]
    AtOnce,
    /// The owner, with [`Server::broadcast`]: the bus is a model that decides when, and whether, a
    /// frame gets through.
    ByOwner,
}

/// Settings of a [`Server`].
#[derive(Clone, Copy, Debug)]
pub struct ServerOptions {
    /// Who passes a client's frame on to the other clients.
    pub relay: Relay,
    /// Connections beyond this number are refused with a message.
    pub clients_max: usize,
}

impl Default for ServerOptions {
    fn default() -> Self {
        Self { relay: Relay::AtOnce, clients_max: 32 }
    }
}

/// A client for as long as it is connected; numbers are never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ClientId(u64);

/// What happens at the port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ServerEvent {
    /// A client has connected.
    Joined {
        /// The new client.
        client: ClientId,
        /// Its address.
        peer: SocketAddr,
    },
    /// A client sent a frame.
    Frame {
        /// The sender.
        client: ClientId,
        /// Arrival by the server's clock.
        at: Instant,
        /// The frame.
        frame: Frame,
    },
    /// A client is gone.
    Left {
        /// The former client.
        client: ClientId,
        /// Why, for people.
        reason: &'static str,
    },
}

/// A bus behind a TCP port, for any number of clients up to [`ServerOptions::clients_max`].
///
/// Every client receives every frame except its own. Each client has an output queue of 64 KiB (about
/// 1 100 frames); while it is full, new frames for *this* client are dropped and counted in
/// [`LinkStats::dropped_out`], the others are not affected. Frames from clients are never dropped:
/// the server reads no more than its owner takes, and TCP slows the sender down.
///
/// Time stamps in the text are Unix time, as those of the reference server.
pub struct Server {
    name: String,
    bus: String,
    listener: TcpListener,
    address: SocketAddr,
    clock: Clock,
    options: ServerOptions,
    clients: Vec<Client>,
    next_id: u64,
    accept_paused_until: Option<Instant>,
    events: VecDeque<ServerEvent>,
    stats: LinkStats,
}

struct Client {
    id: ClientId,
    stream: Stream,
    assembler: Assembler,
    mode: Mode,
    hold_until: Option<Instant>,
    /// Since when output waits without any of it being taken.
    stalled_since: Option<Instant>,
    /// Set when the connection is to be closed after this round.
    leaving: Option<&'static str>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// Connected, no bus opened yet.
    NoBus,
    /// Bus opened: may send, receives nothing (broadcast-manager mode without subscriptions).
    Silent,
    /// Receives every frame.
    Raw,
}

impl Server {
    /// Listens at `host:port` (port 0: any free one) as the bus `bus`.
    ///
    /// # Errors
    ///
    /// The host has no address, or the port cannot be had.
    pub fn listen(
        host: &str,
        port: u16,
        bus: &str,
        clock: Clock,
        options: ServerOptions,
    ) -> Result<Self, OpenError> {
        let error = |source| OpenError::Listen { address: host_port(host, port), source };
        let addresses = super::resolve(host, port)?;
        let listener = TcpListener::bind(addresses.as_slice()).map_err(error)?;
        listener.set_nonblocking(true).map_err(error)?;
        let address = listener.local_addr().map_err(error)?;
        Ok(Self {
            name: format!("socketcand://{address}/{bus}"),
            bus: bus.to_owned(),
            listener,
            address,
            clock,
            options,
            clients: Vec::new(),
            next_id: 0,
            accept_paused_until: None,
            events: VecDeque::new(),
            stats: LinkStats::default(),
        })
    }

    /// The address clients connect to, with the real port.
    pub const fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// Connected clients, whether they receive already or not.
    pub fn client_count(&self) -> usize {
        self.clients.len()
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

    /// Sends a frame that was on the bus at `at` to all receiving clients but `except`, its sender.
    pub fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        self.stats.frames_out += 1;
        let text = Message::Frame { at: self.clock.to_unix(at), frame: *frame }.encode();
        self.deliver(text.as_bytes(), except);
    }

    /// Reports an error of the bus (class bits of Linux `can/error.h`) to all receiving clients.
    pub fn broadcast_bus_error(&mut self, at: Instant, class: u32) {
        let text = Message::BusError { at: self.clock.to_unix(at), class }.encode();
        self.deliver(text.as_bytes(), None);
    }

    fn deliver(&mut self, text: &[u8], except: Option<ClientId>) {
        let now = self.clock.now();
        for client in &mut self.clients {
            if client.mode == Mode::Raw && Some(client.id) != except && client.leaving.is_none() {
                if !client.stream.queue(text) {
                    self.stats.dropped_out += 1;
                }
                client.flush(now);
            }
        }
    }

    fn service(&mut self) {
        let now = self.clock.now();
        self.accept(now);
        let first_new = self.events.len();
        for client in &mut self.clients {
            client.service(now, &self.bus, &mut self.events, &mut self.stats);
        }
        if self.options.relay == Relay::AtOnce {
            for index in first_new..self.events.len() {
                if let Some(ServerEvent::Frame { client, at, frame }) = self.events.get(index) {
                    let (client, at, frame) = (*client, *at, *frame);
                    let text = Message::Frame { at: self.clock.to_unix(at), frame }.encode();
                    self.deliver(text.as_bytes(), Some(client));
                }
            }
        }
        self.clients.retain(|client| match client.leaving {
            Some(reason) => {
                self.events.push_back(ServerEvent::Left { client: client.id, reason });
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
            match self.listener.accept() {
                Ok((stream, peer)) => self.greet(stream, peer, now),
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

    fn greet(&mut self, stream: TcpStream, peer: SocketAddr, now: Instant) {
        let Ok(stream) = Stream::tcp(stream) else { return };
        let mut client = Client {
            id: ClientId(self.next_id),
            stream,
            assembler: Assembler::new(),
            mode: Mode::NoBus,
            hold_until: None,
            stalled_since: None,
            leaving: None,
        };
        if self.clients.len() >= self.options.clients_max {
            client.answer(Message::Refused { reason: "too many clients" }, now);
            return;
        }
        client.answer(Message::Hi, now);
        self.next_id += 1;
        self.events.push_back(ServerEvent::Joined { client: client.id, peer });
        self.clients.push(client);
    }
}

impl Link for Server {
    fn name(&self) -> &str {
        &self.name
    }

    /// To all receiving clients; never fails, a full queue only shows in the counters.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.broadcast(self.clock.now(), frame, None);
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<Event>, LinkError> {
        loop {
            match self.next_event() {
                Some(ServerEvent::Frame { at, frame, .. }) => {
                    return Ok(Some(Event::Frame { at, stamp: None, frame }));
                }
                Some(ServerEvent::Joined { .. } | ServerEvent::Left { .. }) => {}
                None => return Ok(None),
            }
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        if self.accept_paused_until.is_none() {
            set.add(&self.listener, false);
        }
        for client in &self.clients {
            set.add(&client.stream, client.stream.pending() > 0 && client.hold_until.is_none());
        }
    }

    fn deadline(&self) -> Option<Instant> {
        let clients = self.clients.iter();
        let holds = clients.clone().filter_map(|client| client.hold_until);
        let stalls = clients.filter_map(|client| client.stalled_since.map(|since| since + STALL_MAX));
        holds.chain(stalls).chain(self.accept_paused_until).min()
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}

impl Client {
    fn service(
        &mut self,
        now: Instant,
        bus: &str,
        events: &mut VecDeque<ServerEvent>,
        stats: &mut LinkStats,
    ) {
        self.flush(now);
        let mut chunk = [0; READ_CHUNK];
        let received = match self.stream.read(&mut chunk) {
            Ok(Chunk::Bytes(count)) => chunk.get(..count).unwrap_or(&[]),
            Ok(Chunk::Empty) => &[],
            Ok(Chunk::Closed) => return self.leave("closed by the client"),
            Err(_) => return self.leave("connection lost"),
        };
        for byte in received {
            // The answer needs the client, the message borrows its assembler: 128 bytes are copied.
            let mut copy = [0; MESSAGE_MAX];
            let outcome = match self.assembler.push(*byte) {
                None => continue,
                Some(Assembled::Overlong) => Err("message too long"),
                Some(Assembled::Message(text)) => match copy.get_mut(..text.len()) {
                    Some(head) => {
                        head.copy_from_slice(text);
                        Ok(&*head)
                    }
                    None => Err("message too long"),
                },
            };
            match outcome.map(Command::parse) {
                Ok(Ok(command)) => self.handle(command, now, bus, events),
                Ok(Err(error)) => {
                    stats.malformed_in += 1;
                    self.refuse(&error, now);
                }
                Err(reason) => {
                    stats.malformed_in += 1;
                    self.answer(Message::Refused { reason }, now);
                }
            }
        }
        if self.mode == Mode::NoBus && self.assembler.garbage_bytes() > FOREIGN_BYTES_MAX {
            self.leave("does not speak socketcand");
        }
    }

    fn handle(&mut self, command: Command<'_>, now: Instant, bus: &str, events: &mut VecDeque<ServerEvent>) {
        match (self.mode, command) {
            (_, Command::Echo) => self.answer(Message::Echo, now),
            (Mode::NoBus, Command::Open(name)) if name.as_str() == bus => {
                self.mode = Mode::Silent;
                self.answer(Message::Ok, now);
            }
            (Mode::NoBus, Command::Open(name)) => {
                let reason = format!("could not open bus {name}, this server has {bus}");
                self.answer(Message::Refused { reason: &reason }, now);
                self.leave("asked for another bus");
            }
            (Mode::NoBus, Command::RawMode | Command::BcmMode | Command::Send(_)) => {
                self.answer(Message::Refused { reason: "open a bus first" }, now);
            }
            (Mode::Silent | Mode::Raw, Command::Open(_)) => {
                self.answer(Message::Refused { reason: "a bus is open already" }, now);
            }
            (Mode::Silent | Mode::Raw, Command::RawMode) => {
                self.answer(Message::Ok, now);
                self.mode = Mode::Raw;
                self.hold_until = Some(now + RAWMODE_HOLD);
            }
            (Mode::Silent | Mode::Raw, Command::BcmMode) => {
                self.mode = Mode::Silent;
                self.answer(Message::Ok, now);
            }
            (Mode::Silent | Mode::Raw, Command::Send(frame)) => {
                events.push_back(ServerEvent::Frame { client: self.id, at: now, frame });
            }
        }
    }

    fn refuse(&mut self, error: &CommandError<'_>, now: Instant) {
        let reason = error.to_string();
        self.answer(Message::Refused { reason: &reason }, now);
    }

    /// Answers are never dropped: a client that does not read them is disconnected instead.
    fn answer(&mut self, message: Message<'_>, now: Instant) {
        if self.stream.queue(message.encode().as_bytes()) {
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
            Ok(progress) => {
                if self.stream.pending() == 0 {
                    self.stalled_since = None;
                } else if progress || self.stalled_since.is_none() {
                    self.stalled_since = Some(now);
                } else if self.stalled_since.is_some_and(|since| since + STALL_MAX <= now) {
                    self.leave("reads nothing");
                }
            }
            Err(_) => self.leave("connection lost"),
        }
    }

    /// The first reason counts.
    fn leave(&mut self, reason: &'static str) {
        self.leaving.get_or_insert(reason);
    }
}
