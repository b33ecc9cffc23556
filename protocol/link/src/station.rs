//! The client side of a text protocol: one connection to one bus. What is said is the [`Speech`]'s
//! business; socket, queues and counters are the same for all.

use std::collections::VecDeque;

use protocol::{Frame, Instant};

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::{LinkError, SendError};
use crate::link::{Event, Link, LinkStats, PollSet, wait};
use crate::stream::{Chunk, Stream};

const READ_CHUNK: usize = 4096;

/// What a [`Speech`] understood from the far side.
pub enum Heard {
    /// A frame, with the far side's time stamp if it has one.
    Frame(Frame, Option<Instant>),
    /// An error of the bus.
    BusError(BusError),
    /// The far side refused something.
    Refused,
    /// Something that could not be read.
    Malformed,
}

/// What is said on the client side of a protocol. Implementations keep no clock and no socket.
pub trait Speech {
    /// The next byte from the far side.
    fn take(&mut self, byte: u8, hear: &mut dyn FnMut(Heard));

    /// Text that puts `frame` on the bus, given to `put`.
    fn render(&self, frame: &Frame, put: &mut dyn FnMut(&[u8]));

    /// Last words before the connection is closed.
    fn farewell(&self) -> &'static [u8] {
        b""
    }
}

/// One connection to a bus.
///
/// Output: 64 KiB wait for a slow far side, further frames are refused ([`SendError::QueueFull`]).
/// Input is never dropped: what the owner does not take waits in the operating system.
pub struct Station<S: Speech> {
    name: String,
    clock: Clock,
    stream: Stream,
    speech: S,
    events: VecDeque<Event>,
    /// Set once, when the connection is gone.
    failure: Option<LinkError>,
    stats: LinkStats,
}

impl<S: Speech> Station<S> {
    pub(crate) fn new(name: String, stream: Stream, speech: S, clock: Clock) -> Self {
        let (events, stats) = (VecDeque::new(), LinkStats::default());
        Self { name, clock, stream, speech, events, failure: None, stats }
    }

    pub(crate) fn speech(&mut self) -> &mut S {
        &mut self.speech
    }

    pub(crate) const fn failure(&self) -> Option<&LinkError> {
        self.failure.as_ref()
    }

    pub(crate) fn say(&mut self, text: &[u8]) {
        self.stream.queue(text);
        self.flush();
    }

    /// Works until `done` is true (returns true), the link is gone or the time is `until`.
    pub(crate) fn work_until(&mut self, until: Instant, done: impl Fn(&S) -> bool) -> std::io::Result<bool> {
        loop {
            self.service();
            if done(&self.speech) {
                return Ok(true);
            }
            if self.failure.is_some() || self.clock.now() >= until {
                return Ok(false);
            }
            wait(&[&*self], &self.clock, Some(until))?;
        }
    }

    /// Forgets frames received so far, and complaints: what came before the handshake means nothing.
    pub(crate) fn forget(&mut self) {
        self.events.clear();
        self.stats = LinkStats::default();
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
        let (events, stats) = (&mut self.events, &mut self.stats);
        for byte in received {
            self.speech.take(*byte, &mut |heard| match heard {
                Heard::Frame(frame, stamp) => events.push_back(Event::Frame { at, stamp, frame }),
                Heard::BusError(error) => events.push_back(Event::BusError { at, error }),
                Heard::Refused => stats.refused_out += 1,
                Heard::Malformed => stats.malformed_in += 1,
            });
        }
    }
}

impl<S: Speech> Link for Station<S> {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if let Some(error) = &self.failure {
            return Err(error.clone().into());
        }
        let (stream, mut queued) = (&mut self.stream, false);
        self.speech.render(frame, &mut |text| queued = stream.queue(text));
        if !queued {
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

impl<S: Speech> Drop for Station<S> {
    fn drop(&mut self) {
        if self.failure.is_none() {
            // As much as goes without blocking; nobody is left to hear of an error.
            self.stream.queue(self.speech.farewell());
            let _ = self.stream.flush();
        }
    }
}
