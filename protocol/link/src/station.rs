//! The client side of a text protocol: one connection to one bus. The [`Speech`] knows the texts; socket, queues
//! and counters are the same for all.

use std::cell::Cell;
use std::collections::VecDeque;

use protocol::{Duration, Frame, Instant};

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::{LinkError, SendError};
use crate::link::{CanLink, LinkEvent, LinkStats, PollSet, wait};
use crate::stream::{Chunk, OUTPUT_QUEUE_BYTES, Stream};

const READ_CHUNK: usize = 4096;

/// What a [`Speech`] understood from the far side.
pub enum Heard {
    /// A frame, with the far side's time stamp if it has one.
    Frame(Frame, Option<Instant>),
    /// An error of the bus, with the far side's time stamp if it has one.
    BusError(BusError, Option<Instant>),
    /// The far side refused something.
    Refused,
    /// It is this virtual time, and this side's turn.
    Turn(Instant),
    /// Something that could not be read.
    Malformed,
}

/// The client side of a text protocol, without clock and socket.
pub trait Speech {
    /// The next byte from the far side.
    fn take(&mut self, byte: u8, hear: &mut dyn FnMut(Heard));

    /// Text that puts `frame` on the bus, given to `put`.
    fn render(&self, frame: &Frame, put: &mut dyn FnMut(&[u8]));

    /// Text that ends a turn in lock step until `until` or the first frame from `frames_from` on, given to `put`.
    fn end_turn(&self, until: Instant, frames_from: Instant, put: &mut dyn FnMut(&[u8])) {
        let _ = (until, frames_from, put);
    }

    /// Last words before the connection is closed.
    fn farewell(&self) -> &'static [u8] {
        b""
    }
}

/// One connection to a bus.
///
/// Output: 64 KiB wait for a slow far side, further frames are refused ([`SendError::QueueFull`]). CAN FD frames have no text in these
/// protocols and are refused ([`LinkError::ClassicalOnly`]).
/// Input is never dropped: what the owner does not take waits in the operating system.
pub struct Station<S: Speech> {
    name: String,
    clock: Clock,
    stream: Stream,
    speech: S,
    events: VecDeque<LinkEvent>,
    /// In lock step; else always this side's turn.
    in_step: bool,
    has_turn: Cell<bool>,
    frame_delay: Duration,
    /// Set once, when the connection is gone.
    failure: Option<LinkError>,
    stats: LinkStats,
}

impl<S: Speech> Station<S> {
    pub(crate) fn new(name: String, stream: Stream, speech: S, clock: Clock) -> Self {
        let (events, stats) = (VecDeque::new(), LinkStats::default());
        Self {
            name,
            clock,
            stream,
            speech,
            events,
            in_step: false,
            has_turn: Cell::new(true),
            frame_delay: Duration::ZERO,
            failure: None,
            stats,
        }
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

    /// From now on time is virtual and comes from the far side.
    pub(crate) const fn keep_in_step(&mut self) {
        self.in_step = true;
    }

    /// Works until `done` is true (returns true), the link has failed or `span` of real time has passed.
    pub(crate) fn work_for(&mut self, span: Duration, done: impl Fn(&S) -> bool) -> std::io::Result<bool> {
        let clock = Clock::start();
        let until = clock.now() + span;
        loop {
            self.service();
            if done(&self.speech) {
                return Ok(true);
            }
            if self.failure.is_some() || clock.now() >= until {
                return Ok(false);
            }
            wait(&[&*self], &clock, Some(until))?;
        }
    }

    /// Forgets the frames and error reports so far: they came before the handshake.
    pub(crate) fn forget(&mut self) {
        self.events.clear();
        self.stats = LinkStats::default();
    }

    /// True during a turn in lock step. Its frames are written together with its end: the far side acts only then.
    fn is_in_turn(&self) -> bool {
        self.in_step && self.has_turn.get()
    }

    fn flush(&mut self) {
        let flushed = if self.in_step { self.stream.flush_all() } else { self.stream.flush().map(|_| ()) };
        if let Err(error) = flushed {
            self.failure.get_or_insert_with(|| LinkError::io(&self.name, &error));
        }
    }

    fn service(&mut self) {
        if !self.is_in_turn() {
            self.flush();
        }
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
        let (clock, has_turn) = (self.clock, &self.has_turn);
        let (in_step, now) = (self.in_step, clock.now());
        // In lock step the frames of a time come before the report of that time.
        let arrival = |stamp: Option<Instant>| stamp.filter(|_| in_step).unwrap_or(now);
        let (events, stats) = (&mut self.events, &mut self.stats);
        for byte in received {
            self.speech.take(*byte, &mut |heard| match heard {
                Heard::Frame(frame, stamp) => {
                    events.push_back(LinkEvent::Frame { at: arrival(stamp), stamp, frame });
                }
                Heard::BusError(error, stamp) => {
                    events.push_back(LinkEvent::BusError { at: arrival(stamp), error });
                }
                Heard::Turn(now) => {
                    clock.set(now);
                    has_turn.set(true);
                }
                Heard::Refused => stats.refused_out += 1,
                Heard::Malformed => stats.malformed_in += 1,
            });
        }
    }
}

impl<S: Speech> CanLink for Station<S> {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if let Some(error) = &self.failure {
            return Err(error.clone().into());
        }
        if frame.fd().is_some() {
            self.takes_fd()?;
        }
        let (stream, mut queued) = (&mut self.stream, false);
        self.speech.render(frame, &mut |text| queued = stream.queue(text));
        if !queued {
            self.stats.dropped_out += 1;
            return Err(SendError::QueueFull { link: self.name.clone() });
        }
        self.stats.frames_out += 1;
        if !self.is_in_turn() || self.stream.pending() > OUTPUT_QUEUE_BYTES / 2 {
            self.flush();
        }
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        if self.events.is_empty() || !self.has_turn.get() {
            self.service();
        }
        if !self.has_turn.get() {
            return self.failure.clone().map_or(Ok(None), Err);
        }
        match self.events.pop_front() {
            Some(event) => {
                self.stats.frames_in += u64::from(matches!(event, LinkEvent::Frame { .. }));
                Ok(Some(event))
            }
            None => self.failure.clone().map_or(Ok(None), Err),
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        set.add(&self.stream, self.stream.pending() > 0 && !self.is_in_turn());
    }

    fn end_turn(&self, until: Instant) -> bool {
        if self.is_in_turn() && self.failure.is_none() {
            // A failed connection is noticed at the next read.
            let frames_from = self.clock.now() + self.frame_delay;
            self.speech.end_turn(until, frames_from, &mut |text| {
                self.has_turn.set(self.stream.write_now(text).is_err());
            });
        }
        self.in_step
    }

    fn bear_late_frames(&mut self, delay: Duration) {
        self.frame_delay = delay;
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}

impl<S: Speech> Drop for Station<S> {
    fn drop(&mut self) {
        if self.failure.is_none() {
            // Sends what can be sent without blocking; an error here is no longer reported.
            self.stream.queue(self.speech.farewell());
            let _ = self.stream.flush();
        }
    }
}
