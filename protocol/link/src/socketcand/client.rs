//! Client side: a bus behind a socketcand server.

use std::collections::VecDeque;
use std::net::TcpStream;
use std::time::Duration as StdDuration;

use protocol::text::BusName;
use protocol::text::socketcand::{Assembled, Assembler, Command, Message};
use protocol::{Duration, Frame};

use super::host_port;
use crate::clock::Clock;
use crate::error::{LinkError, OpenError, SendError};
use crate::link::{Event, Link, LinkStats, PollSet, wait};
use crate::stream::{Chunk, Stream};

/// For each address of the host.
const CONNECT_TIMEOUT: StdDuration = StdDuration::from_secs(3);

/// From the connection to the last `< ok >`.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(3);

const READ_CHUNK: usize = 4096;

/// A connection in raw mode to one bus of a socketcand server.
///
/// Output: 64 KiB wait for a slow server, further frames are refused
/// ([`SendError::QueueFull`]). Input is never dropped: what the owner does not take waits in the
/// server. [`Event::Frame::stamp`] is the server's time, usually Unix time.
pub struct Client {
    name: String,
    clock: Clock,
    stream: Stream,
    assembler: Assembler,
    step: Step,
    events: VecDeque<Event>,
    /// Set once, when the connection is gone.
    failure: Option<LinkError>,
    /// Words of the server's last refusal.
    refusal: Option<String>,
    stats: LinkStats,
}

/// What the client waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Greeting,
    Opened,
    RawMode,
    Done,
}

impl Client {
    /// Connects, opens `bus` and switches to raw mode; takes at most some seconds.
    ///
    /// # Errors
    ///
    /// The host has no address, nothing listens there, it is no socketcand server, or the server
    /// does not have the bus.
    pub fn connect(host: &str, port: u16, bus: BusName<'_>, clock: Clock) -> Result<Self, OpenError> {
        let address = host_port(host, port);
        let name = format!("socketcand://{address}/{bus}");
        let stream = dial(host, port, &name)?;
        let stream = Stream::tcp(stream).map_err(|source| OpenError::Setup {
            what: "the connection",
            address: address.clone(),
            source,
        })?;
        let mut client = Self {
            name,
            clock,
            stream,
            assembler: Assembler::new(),
            step: Step::Greeting,
            events: VecDeque::new(),
            failure: None,
            refusal: None,
            stats: LinkStats::default(),
        };
        client.shake_hands(&address, bus)?;
        Ok(client)
    }

    /// Words of the server's last refusal of something this client sent.
    pub fn last_refusal(&self) -> Option<&str> {
        self.refusal.as_deref()
    }

    fn shake_hands(&mut self, address: &str, bus: BusName<'_>) -> Result<(), OpenError> {
        let protocol = "socketcand";
        let until = self.clock.now() + HANDSHAKE_TIMEOUT;
        let mut asked = Step::Greeting;
        loop {
            self.service();
            if asked != self.step {
                asked = self.step;
                match self.step {
                    Step::Opened => self.ask(Command::Open(bus)),
                    Step::RawMode => self.ask(Command::RawMode),
                    Step::Greeting | Step::Done => {}
                }
            }
            if self.step == Step::Done {
                return Ok(());
            }
            let address = address.to_owned();
            if let Some(reason) = self.refusal.take() {
                return Err(OpenError::Refused { address, bus: bus.to_string(), reason });
            }
            if let Some(error) = &self.failure {
                let found = error.to_string();
                return Err(OpenError::Protocol { address, protocol, found });
            }
            if self.clock.now() >= until {
                let found = format!(
                    "no answer within {HANDSHAKE_TIMEOUT} while waiting for {}",
                    match self.step {
                        Step::Greeting => "the greeting",
                        Step::Opened => "the answer to open",
                        Step::RawMode | Step::Done => "the answer to rawmode",
                    }
                );
                return Err(OpenError::Protocol { address, protocol, found });
            }
            wait(&[&*self], &self.clock, Some(until)).map_err(|source| OpenError::Setup {
                what: "waiting",
                address,
                source,
            })?;
        }
    }

    fn ask(&mut self, command: Command<'_>) {
        self.stream.queue(command.encode().as_bytes());
        self.flush();
    }

    fn flush(&mut self) {
        if let Err(error) = self.stream.flush() {
            self.failure.get_or_insert_with(|| LinkError::io(&self.name, &error));
        }
    }

    fn service(&mut self) {
        self.flush();
        if self.failure.is_some() {
            return;
        }
        let mut chunk = [0; READ_CHUNK];
        let received = match self.stream.read(&mut chunk) {
            Ok(Chunk::Bytes(count)) => chunk.get(..count).unwrap_or(&[]),
            Ok(Chunk::Empty) => return,
            Ok(Chunk::Closed) => {
                self.failure = Some(LinkError::closed(&self.name));
                return;
            }
            Err(error) => {
                self.failure = Some(LinkError::io(&self.name, &error));
                return;
            }
        };
        let at = self.clock.now();
        for byte in received {
            let message = match self.assembler.push(*byte) {
                None => continue,
                Some(Assembled::Overlong) => {
                    self.stats.malformed_in += 1;
                    continue;
                }
                Some(Assembled::Message(text)) => Message::parse(text),
            };
            match message {
                Ok(Message::Frame { at: stamp, frame }) => {
                    self.events.push_back(Event::Frame { at, stamp: Some(stamp), frame });
                }
                Ok(Message::BusError { class, .. }) => self.events.push_back(Event::BusError { at, class }),
                Ok(Message::Refused { reason }) => {
                    self.stats.refused_out += 1;
                    self.refusal = Some(reason.to_owned());
                }
                Ok(Message::Hi) if self.step == Step::Greeting => self.step = Step::Opened,
                Ok(Message::Ok) if self.step == Step::Opened => self.step = Step::RawMode,
                Ok(Message::Ok) if self.step == Step::RawMode => self.step = Step::Done,
                Ok(Message::Hi | Message::Ok | Message::Echo) => {}
                Err(_) => self.stats.malformed_in += 1,
            }
        }
    }
}

/// The first address that answers.
fn dial(host: &str, port: u16, spec: &str) -> Result<TcpStream, OpenError> {
    let mut last = std::io::ErrorKind::NotFound.into();
    for address in super::resolve(host, port)? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(OpenError::Connect { address: host_port(host, port), spec: spec.to_owned(), source: last })
}

impl Link for Client {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if let Some(error) = &self.failure {
            return Err(error.clone().into());
        }
        if !self.stream.queue(Command::Send(*frame).encode().as_bytes()) {
            self.stats.dropped_out += 1;
            return Err(SendError::QueueFull { link: self.name.clone() });
        }
        self.stats.frames_out += 1;
        self.flush();
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<Event>, LinkError> {
        if self.events.is_empty() {
            self.service();
        }
        match self.events.pop_front() {
            Some(event) => {
                self.stats.frames_in += u64::from(matches!(event, Event::Frame { .. }));
                Ok(Some(event))
            }
            None => self.failure.clone().map_or(Ok(None), Err),
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        set.add(&self.stream, self.stream.pending() > 0);
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}
