//! One peer of a server: its connection, its queues, its deadlines.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};

use protocol::Instant;

use super::dialect::{Action, Dialect};
use super::options::{ClientId, ServerEvent, ServerOptions};
use crate::link::{LinkStats, PollSet};
use crate::stream::{Chunk, Stream};

/// Most bytes read from one peer in a turn.
const READ_CHUNK: usize = 4096;

/// Frames of one peer that wait for the owner. While there are this many, nothing more is read from the peer.
pub(super) const INBOX_MAX: usize = 64;

/// A peer and its state so far.
pub(super) struct Peer<S> {
    pub(super) session: S,
    pub(super) line: Line,
    /// Bytes that were read and not understood yet, in reverse order.
    unread: Vec<u8>,
}

/// The half of a peer that does not depend on the protocol.
pub(super) struct Line {
    pub(super) id: ClientId,
    pub(super) stream: Stream,
    pub(super) inbox: VecDeque<ServerEvent>,
    joined_at: Instant,
    /// The peer has opened the bus.
    open: bool,
    hold_until: Option<Instant>,
    /// Since when output waits without any of it being taken.
    stalled_since: Option<Instant>,
    /// Set when the connection is to be closed after this turn.
    pub(super) leaving: Option<&'static str>,
}

impl<S> Peer<S> {
    pub(super) const fn new(session: S, line: Line) -> Self {
        Self { session, line, unread: Vec::new() }
    }

    /// Writes what waits, looks at the deadlines, and reads once if there is room.
    pub(super) fn service<D: Dialect<Session = S>>(
        &mut self,
        dialect: &D,
        now: Instant,
        options: &ServerOptions,
        stats: &mut LinkStats,
    ) {
        self.line.flush(now, options);
        if self.line.handshake_ends(options).is_some_and(|end| end <= now) {
            self.line.leave("did not open the bus in time");
        }
        if self.reads() {
            let mut chunk = [0; READ_CHUNK];
            match self.line.stream.read(&mut chunk) {
                Ok(Chunk::Bytes(count)) => self.unread.extend(chunk.get(..count).unwrap_or(&[]).iter().rev()),
                Ok(Chunk::Empty) => {}
                Ok(Chunk::Closed) => self.line.leave("closed by the client"),
                Err(_) => self.line.leave("connection lost"),
            }
        }
        self.understand(dialect, now, options, stats);
    }

    /// Takes bytes that were read until the inbox is full.
    pub(super) fn understand<D: Dialect<Session = S>>(
        &mut self,
        dialect: &D,
        now: Instant,
        options: &ServerOptions,
        stats: &mut LinkStats,
    ) {
        while self.line.inbox.len() < INBOX_MAX
            && let Some(byte) = self.unread.pop()
        {
            let line = &mut self.line;
            dialect.take(&mut self.session, byte, &mut |action| line.act(&action, now, options, stats));
        }
        self.line.open |= dialect.is_open(&self.session);
    }

    /// True while bytes of the peer can be taken.
    fn reads(&self) -> bool {
        self.line.leaving.is_none() && self.unread.is_empty() && self.line.inbox.len() < INBOX_MAX
    }

    /// True when the owner has all frames of a peer that leaves.
    pub(super) fn is_gone(&self) -> bool {
        self.line.leaving.is_some() && self.unread.is_empty() && self.line.inbox.is_empty()
    }

    /// Registers only what can continue: a full inbox waits for the owner, not for the peer.
    pub(super) fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        let write =
            self.line.leaving.is_none() && self.line.stream.pending() > 0 && self.line.hold_until.is_none();
        if self.reads() {
            set.add(&self.line.stream, write);
        } else if write {
            set.add_for_writing(&self.line.stream);
        }
    }
}

impl Line {
    pub(super) const fn new(id: ClientId, stream: Stream, now: Instant) -> Self {
        Self {
            id,
            stream,
            inbox: VecDeque::new(),
            joined_at: now,
            open: false,
            hold_until: None,
            stalled_since: None,
            leaving: None,
        }
    }

    /// Deadline for a peer to open the bus; `None` after that, and at a serial line, which cannot be closed.
    fn handshake_ends(&self, options: &ServerOptions) -> Option<Instant> {
        (!self.open && self.leaving.is_none() && self.stream.can_hang_up())
            .then(|| self.joined_at + options.handshake_max)
    }

    /// Time of the next work for this peer, even if nothing arrives.
    pub(super) fn deadline(&self, options: &ServerOptions) -> Option<Instant> {
        let stall = self.stalled_since.map(|since| since + options.stall_max);
        [self.hold_until, stall, self.handshake_ends(options)].into_iter().flatten().min()
    }

    pub(super) fn act(
        &mut self,
        action: &Action<'_>,
        now: Instant,
        options: &ServerOptions,
        stats: &mut LinkStats,
    ) {
        match *action {
            Action::Answer(text) => self.answer(text, now, options),
            Action::Frame(frame) => {
                let client = self.id;
                self.report(ServerEvent::Frame { client, at: now, frame }, now, options);
            }
            Action::InStep => self.report(ServerEvent::InStep { client: self.id }, now, options),
            Action::Wait { until, frames_from } => {
                self.report(ServerEvent::Waits { client: self.id, until, frames_from }, now, options);
            }
            Action::Hold(span) => self.hold_until = Some(now + span),
            Action::Malformed => stats.malformed_in += 1,
            Action::Leave(reason) => self.leave(reason),
        }
    }

    /// Queues an event for the owner. A peer that sends has read the answer that a hold separates, so the hold ends.
    fn report(&mut self, event: ServerEvent, now: Instant, options: &ServerOptions) {
        self.open = true;
        self.inbox.push_back(event);
        if self.hold_until.take().is_some() {
            self.flush(now, options);
        }
    }

    /// Answers are never dropped: a peer that does not read them is disconnected instead.
    pub(super) fn answer(&mut self, text: &[u8], now: Instant, options: &ServerOptions) {
        if self.stream.queue(text) {
            self.flush(now, options);
        } else {
            self.leave("does not read its answers");
        }
    }

    pub(super) fn flush(&mut self, now: Instant, options: &ServerOptions) {
        if self.hold_until.is_some_and(|until| now < until) {
            return;
        }
        self.hold_until = None;
        match self.stream.flush() {
            Ok(progress) => self.watch_progress(progress, now, options),
            Err(error) => self.leave(loss(&error)),
        }
    }

    fn watch_progress(&mut self, progress: bool, now: Instant, options: &ServerOptions) {
        let over = self.stalled_since.is_some_and(|since| since + options.stall_max <= now);
        if self.stream.pending() == 0 {
            self.stalled_since = None;
        } else if progress || self.stalled_since.is_none() {
            self.stalled_since = Some(now);
        } else if over && self.stream.can_hang_up() {
            self.leave("reads nothing");
        } else if over {
            // No program is at the other end of the serial line yet: waiting output is stale.
            self.stream.discard_output();
            self.stalled_since = None;
        }
    }

    pub(super) fn leave(&mut self, reason: &'static str) {
        self.leaving.get_or_insert(reason);
    }
}

fn loss(error: &io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => "closed by the client",
        _ => "connection lost",
    }
}
