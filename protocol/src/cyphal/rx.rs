//! Receiver: frames in, whole transfers out, everything else counted by cause.
//!
//! One [`Receiver`] serves all ports of a node. A *session* is a port and the node that speaks on it;
//! sessions live in a table of fixed size, and a session that is in the middle of a multi-frame
//! transfer holds one of a few reassembly buffers.
//!
//! # Rules (Cyphal specification v1.0, section 4.1.4)
//!
//! | stimulus | answer |
//! |---|---|
//! | start of a transfer, other number than the last complete one | begins it; an unfinished one is given up |
//! | start with the number of the last complete transfer, within the timeout | duplicate, dropped |
//! | the same after the timeout (2 s) | a new transfer: the sender may have restarted |
//! | frame with the wrong toggle, same bytes as the frame before | duplicate frame, dropped |
//! | frame with the wrong toggle or number or priority | frames were lost: transfer given up |
//! | end of transfer with wrong CRC | transfer given up, its number is *not* remembered, so that a repetition is accepted |
//! | longer than the extent of the port | cut after the CRC is checked |
//! | shorter than the extent | zeros appended up to the extent |
//!
//! *Limits.* When all sessions are in use, the one that has been quiet longest is replaced, unless it is in the
//! middle of a transfer; a session that has been stuck in a transfer for [`STALL`] is replaced too. When all
//! buffers are in use, only a stuck one is replaced. Otherwise the new transfer is refused.
//!
//! *Ports without sessions* ([`Port::idempotent`]) accept each valid single frame with any number, also from a node
//! without address. They are for *stop* and the heartbeat: losing one is worse than seeing one twice, and a flood
//! on other ports must not use up their place.
//!
//! Must not: know what the bytes mean, send anything, or read a clock.

use super::crc::Crc16;
use super::id::{NodeId, Priority, Route, ServiceId, SubjectId, Tail, TransferId};
use super::tx::FRAME_PAYLOAD;
use crate::frame::Frame;
use crate::id::Id;
use crate::time::{Duration, Instant};

/// Default transfer-ID timeout, the most that the specification recommends (section 4.1.4.1).
pub const TRANSFER_ID_TIMEOUT: Duration = Duration::from_secs(2);
/// A multi-frame transfer without a frame for this long may lose its place to another one. The
/// slowest sender we serve (a 1/20 share of a 125 kbit/s bus) puts its frames 25 ms apart.
pub const STALL: Duration = Duration::from_millis(500);
/// Longest transfer that is followed to its end; regulated types need at most 4 KiB.
pub const TRANSFER_LEN_MAX: usize = 8192;

/// Direction and kind of a transfer, as seen by the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PortKind {
    /// Message to everybody.
    Message,
    /// Request to this node as a server.
    Request,
    /// Response to this node as a client.
    Response,
}

/// Something a node listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Port {
    /// Kind of transfer.
    pub kind: PortKind,
    /// Subject-ID or service-ID.
    pub id: u16,
    /// Bytes kept of a transfer; more are cut off, fewer are filled with zeros.
    pub extent: u16,
    /// Single frames are accepted without a session.
    pub idempotent: bool,
    /// Single frames with the number of the last transfer are passed on, marked as repeated.
    pub repeats: bool,
}

impl Port {
    /// Subscription to messages of at most `extent` bytes.
    pub const fn message(subject: SubjectId, extent: u16) -> Self {
        Self { kind: PortKind::Message, id: subject.get(), extent, idempotent: false, repeats: false }
    }

    /// Service that this node provides.
    pub const fn request(service: ServiceId, extent: u16) -> Self {
        Self { kind: PortKind::Request, id: service.get(), extent, idempotent: false, repeats: false }
    }

    /// Service that this node uses.
    pub const fn response(service: ServiceId, extent: u16) -> Self {
        Self { kind: PortKind::Response, id: service.get(), extent, idempotent: false, repeats: false }
    }

    /// Accepts each single frame at once and keeps no session; multi-frame transfers are refused.
    #[must_use]
    pub const fn idempotent(self) -> Self {
        Self { idempotent: true, ..self }
    }

    /// Passes on repeated single frames too, for a service with requests that a restarted sender must not wait for.
    #[must_use]
    pub const fn with_repeats(self) -> Self {
        Self { repeats: true, ..self }
    }
}

/// A received transfer; the payload is borrowed from the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer<'a> {
    /// Arrival of the first frame.
    pub at: Instant,
    /// Urgency; a response copies it.
    pub priority: Priority,
    /// Who spoke to whom about what.
    pub route: Route,
    /// Number within the session; a response copies it.
    pub transfer_id: TransferId,
    /// Payload, followed by zeros up to the extent of the port.
    pub payload: &'a [u8],
    /// Payload bytes that came from the bus, at most the extent.
    pub len: usize,
    /// Same number as the transfer before it: a repetition, or the first one of a sender that has restarted.
    pub repeated: bool,
}

/// Why a frame had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Dropped {
    /// 11-bit id or remote frame: another protocol shares the bus.
    OtherProtocol,
    /// First frame with a zero toggle: UAVCAN v0.
    OldProtocol,
    /// Not a frame of the specification: reserved bit set, no data, short middle frame.
    Malformed,
    /// For another node, or on a port that this node does not listen to.
    NotForUs,
    /// Another node uses the address of this node: a wiring or configuration error that a person must fix.
    OurAddress,
    /// Repetition of an accepted frame.
    DuplicateFrame,
    /// Repetition of an accepted transfer.
    DuplicateTransfer,
    /// In the middle of a transfer whose beginning was not seen.
    MissedStart,
    /// Frames in between were lost; the transfer was given up.
    LostFrame,
    /// Whole transfer with a wrong CRC.
    BadCrc,
    /// Longer than [`TRANSFER_LEN_MAX`], or several frames on a port for single ones.
    TooLong,
    /// All sessions or all buffers were busy.
    NoRoom,
}

impl Dropped {
    /// All causes, in the order of their numbers.
    pub const ALL: [Self; 12] = [
        Self::OtherProtocol,
        Self::OldProtocol,
        Self::Malformed,
        Self::NotForUs,
        Self::OurAddress,
        Self::DuplicateFrame,
        Self::DuplicateTransfer,
        Self::MissedStart,
        Self::LostFrame,
        Self::BadCrc,
        Self::TooLong,
        Self::NoRoom,
    ];
}

/// How many frames had no effect, by cause; how many transfers arrived or were given up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RxCounters {
    dropped: [u32; Dropped::ALL.len()],
    /// Transfers handed on.
    pub transfers: u32,
    /// Unfinished transfers given up because the sender began another one or fell silent.
    pub abandoned: u32,
}

impl RxCounters {
    /// Frames dropped for this cause; stays at the largest number.
    pub fn dropped(&self, cause: Dropped) -> u32 {
        self.dropped.get(cause as usize).copied().unwrap_or(0)
    }

    fn abandon(&mut self) {
        self.abandoned = self.abandoned.saturating_add(1);
    }

    fn count(&mut self, cause: Dropped) {
        if let Some(n) = self.dropped.get_mut(cause as usize) {
            *n = n.saturating_add(1);
        }
    }
}

/// Multi-frame transfer in the making.
#[derive(Clone, Copy, Debug)]
struct Active {
    transfer_id: TransferId,
    priority: Priority,
    /// Toggle of the frame to come.
    toggle: bool,
    crc: Crc16,
    /// Bytes received, CRC included.
    total: usize,
    /// Payload of the last frame, to know a repetition of it.
    last: [u8; FRAME_PAYLOAD],
    started: Instant,
    buffer: usize,
}

#[derive(Clone, Copy, Debug)]
struct Session {
    /// Port kind, port number and source in one number; `None` = free.
    key: Option<u32>,
    /// Last frame that had an effect.
    heard: Instant,
    /// Number of the last complete transfer.
    complete: Option<TransferId>,
    active: Option<Active>,
}

impl Session {
    const FREE: Self = Self { key: None, heard: Instant::ZERO, complete: None, active: None };
}

impl Session {
    /// In the middle of a transfer, and silent for [`STALL`].
    fn is_stuck(&self, now: Instant) -> bool {
        self.active.is_some() && now.saturating_since(self.heard) >= STALL
    }

    /// Order in which sessions are replaced, lowest first: free, quiet, stuck; within each group the one with the
    /// oldest frame. `None` if it must not be replaced. (Times stay below 2^62 µs, 146 000 years.)
    fn rank(&self, now: Instant) -> Option<u64> {
        if self.active.is_some() && !self.is_stuck(now) {
            return None;
        }
        let (used, stuck) = (u64::from(self.key.is_some()), u64::from(self.active.is_some()));
        Some((used + stuck) << 62 | self.heard.as_micros() >> 2)
    }
}

/// A frame that may have an effect: its parts, and the port it is for.
struct Incoming<'f> {
    priority: Priority,
    route: Route,
    tail: Tail,
    payload: &'f [u8],
    extent: usize,
    /// Port kind, port number and source; `None` = taken without a session.
    key: Option<u32>,
    repeats: bool,
}

/// Checks everything that needs no memory of earlier frames.
fn parse<'f>(local: Option<NodeId>, frame: &'f Frame, ports: &[&[Port]]) -> Result<Incoming<'f>, Dropped> {
    let Id::Extended(id) = frame.id() else { return Err(Dropped::OtherProtocol) };
    if frame.is_remote() {
        return Err(Dropped::OtherProtocol);
    }
    let (tail, payload) = frame.data().split_last().ok_or(Dropped::Malformed)?;
    let tail = Tail::parse(*tail);
    // Section 4.2.2.2: the toggle of a first frame distinguishes the two protocol versions.
    if tail.start && !tail.toggle {
        return Err(Dropped::OldProtocol);
    }
    let (priority, route) = Route::parse(id).map_err(|_| Dropped::Malformed)?;
    let source = route.source();
    if source.is_some() && source == local {
        return Err(Dropped::OurAddress);
    }
    let (kind, number, destination) = match route {
        Route::Message { subject, .. } | Route::Anonymous { subject, .. } => {
            (PortKind::Message, subject.get(), local)
        }
        Route::Request { service, destination, .. } => (PortKind::Request, service.get(), Some(destination)),
        Route::Response { service, destination, .. } => {
            (PortKind::Response, service.get(), Some(destination))
        }
    };
    let mut known = ports.iter().flat_map(|list| list.iter());
    let port = known.find(|port| port.kind == kind && port.id == number);
    let port = port.filter(|_| destination == local).ok_or(Dropped::NotForUs)?;

    let session = source.filter(|_| !port.idempotent);
    if !(tail.start && tail.end) {
        // Every frame but the last is full; an anonymous transfer has one frame (section 4.1.1.4).
        let short = payload.is_empty() || !tail.end && payload.len() != FRAME_PAYLOAD;
        if short || source.is_none() {
            return Err(Dropped::Malformed);
        }
        if session.is_none() {
            return Err(Dropped::TooLong);
        }
    }
    let key = session.map(|source| (kind as u32) << 24 | u32::from(number) << 8 | u32::from(source.get()));
    let (extent, repeats) = (usize::from(port.extent), port.repeats);
    Ok(Incoming { priority, route, tail, payload, extent, key, repeats })
}

/// A finished payload: where it lies, its length, and when it began.
struct Done {
    /// Reassembly buffer; `None` = scratch.
    buffer: Option<usize>,
    len: usize,
    at: Instant,
    repeated: bool,
}

/// Receiver with `SESSIONS` sessions and `BUFFERS` reassembly buffers of `BYTES` bytes.
#[derive(Clone, Debug)]
pub struct Receiver<const SESSIONS: usize, const BUFFERS: usize, const BYTES: usize> {
    timeout: Duration,
    sessions: [Session; SESSIONS],
    buffers: [[u8; BYTES]; BUFFERS],
    /// Payload of the last single-frame transfer.
    scratch: [u8; BYTES],
    counters: RxCounters,
}

impl<const SESSIONS: usize, const BUFFERS: usize, const BYTES: usize> Default
    for Receiver<SESSIONS, BUFFERS, BYTES>
{
    fn default() -> Self {
        Self::new()
    }
}

impl<const SESSIONS: usize, const BUFFERS: usize, const BYTES: usize> Receiver<SESSIONS, BUFFERS, BYTES> {
    /// No sessions yet; transfer-ID timeout [`TRANSFER_ID_TIMEOUT`].
    pub const fn new() -> Self {
        const { assert!(SESSIONS > 0 && BUFFERS > 0 && BUFFERS <= 32 && BYTES > FRAME_PAYLOAD) };
        Self {
            timeout: TRANSFER_ID_TIMEOUT,
            sessions: [Session::FREE; SESSIONS],
            buffers: [[0; BYTES]; BUFFERS],
            scratch: [0; BYTES],
            counters: RxCounters { dropped: [0; Dropped::ALL.len()], transfers: 0, abandoned: 0 },
        }
    }

    /// What was dropped, and why.
    pub const fn counters(&self) -> &RxCounters {
        &self.counters
    }

    /// Takes one frame of the bus and returns the transfer that it completes.
    ///
    /// `local` is this node's address; without an address, services are ignored. The first matching port in `ports`
    /// sets the extent, which is cut to the size of the buffers.
    pub fn accept(
        &mut self,
        now: Instant,
        local: Option<NodeId>,
        frame: &Frame,
        ports: &[&[Port]],
    ) -> Option<Transfer<'_>> {
        let parsed = parse(local, frame, ports);
        let taken = parsed.and_then(|mut incoming| {
            incoming.extent = incoming.extent.min(BYTES);
            self.take(now, &incoming).map(|done| done.map(|done| (incoming, done)))
        });
        let (incoming, done) = match taken {
            Ok(finished) => finished?,
            Err(cause) => {
                self.counters.count(cause);
                return None;
            }
        };
        self.counters.transfers = self.counters.transfers.saturating_add(1);
        let buffer = match done.buffer {
            None => &mut self.scratch,
            Some(index) => self.buffers.get_mut(index)?,
        };
        let payload = buffer.get_mut(..incoming.extent)?;
        payload.get_mut(done.len..)?.fill(0);
        Some(Transfer {
            at: done.at,
            priority: incoming.priority,
            route: incoming.route,
            transfer_id: incoming.tail.transfer_id,
            payload,
            len: done.len,
            repeated: done.repeated,
        })
    }

    /// Applies the rules of sessions; `Ok(None)` while the transfer goes on.
    fn take(&mut self, now: Instant, frame: &Incoming<'_>) -> Result<Option<Done>, Dropped> {
        let mut repeated = false;
        if let Some(key) = frame.key {
            let index = self.session(now, key, frame.tail.start)?;
            if !(frame.tail.start && frame.tail.end) {
                return self.fragment(now, index, frame);
            }
            repeated = match self.whole(now, index, frame.tail.transfer_id) {
                Err(Dropped::DuplicateTransfer) if frame.repeats => true,
                booked => booked.map(|()| false)?,
            };
        }
        let len = copy(&mut self.scratch, 0, frame.extent, frame.payload);
        Ok(Some(Done { buffer: None, len, at: now, repeated }))
    }

    /// Index of the session of `key`, forgetting what is too old; a start may open a session.
    fn session(&mut self, now: Instant, key: u32, start: bool) -> Result<usize, Dropped> {
        let mut place = None;
        let mut best = u64::MAX;
        for (index, session) in self.sessions.iter().enumerate() {
            if session.key == Some(key) {
                place = Some(index);
                break;
            }
            if let Some(rank) = session.rank(now)
                && start
                && rank < best
            {
                (place, best) = (Some(index), rank);
            }
        }
        let index = place.ok_or(if start { Dropped::NoRoom } else { Dropped::MissedStart })?;
        let session = self.sessions.get_mut(index).ok_or(Dropped::NoRoom)?;
        if session.key != Some(key) || now.saturating_since(session.heard) > self.timeout {
            if session.active.is_some() {
                self.counters.abandon();
            }
            *session = Session { key: Some(key), heard: now, ..Session::FREE };
        }
        Ok(index)
    }

    /// Books a single-frame transfer; refuses a repetition.
    fn whole(&mut self, now: Instant, index: usize, transfer_id: TransferId) -> Result<(), Dropped> {
        let session = self.sessions.get_mut(index).ok_or(Dropped::NoRoom)?;
        if session.complete == Some(transfer_id) {
            return Err(Dropped::DuplicateTransfer);
        }
        if session.active.take().is_some() {
            self.counters.abandon();
        }
        session.complete = Some(transfer_id);
        session.heard = now;
        Ok(())
    }

    /// Takes a frame of a multi-frame transfer.
    fn fragment(
        &mut self,
        now: Instant,
        index: usize,
        frame: &Incoming<'_>,
    ) -> Result<Option<Done>, Dropped> {
        let Incoming { priority, tail, payload, extent, .. } = *frame;
        if tail.start {
            let session = self.sessions.get_mut(index).ok_or(Dropped::NoRoom)?;
            if session.complete == Some(tail.transfer_id) {
                return Err(Dropped::DuplicateTransfer);
            }
            if let Some(active) = &session.active {
                let again = active.transfer_id == tail.transfer_id
                    && active.total == FRAME_PAYLOAD
                    && active.last == payload;
                if again {
                    return Err(Dropped::DuplicateFrame);
                }
                session.active = None;
                self.counters.abandon();
            }
            let buffer = self.buffer(now)?;
            if let Some(session) = self.sessions.get_mut(index) {
                session.active = Some(Active {
                    transfer_id: tail.transfer_id,
                    priority,
                    toggle: true,
                    crc: Crc16::INITIAL,
                    total: 0,
                    last: [0; FRAME_PAYLOAD],
                    started: now,
                    buffer,
                });
            }
        }
        let session = self.sessions.get_mut(index).ok_or(Dropped::NoRoom)?;
        let Some(active) = &mut session.active else {
            let known = session.complete == Some(tail.transfer_id);
            return Err(if known { Dropped::DuplicateFrame } else { Dropped::MissedStart });
        };
        let same = active.transfer_id == tail.transfer_id && active.priority == priority;
        if !same || active.toggle != tail.toggle {
            if same && active.last == payload {
                return Err(Dropped::DuplicateFrame);
            }
            session.active = None;
            return Err(Dropped::LostFrame);
        }

        session.heard = now;
        active.crc.update(payload);
        let buffer = self.buffers.get_mut(active.buffer).ok_or(Dropped::NoRoom)?;
        copy(buffer, active.total, extent, payload);
        active.total += payload.len();
        active.toggle = !active.toggle;
        copy(&mut active.last, 0, FRAME_PAYLOAD, payload);
        if active.total > TRANSFER_LEN_MAX {
            session.active = None;
            return Err(Dropped::TooLong);
        }
        if !tail.end {
            return Ok(None);
        }
        let Active { crc, total, started: at, buffer, .. } = *active;
        session.active = None;
        if !crc.is_residue() {
            return Err(Dropped::BadCrc);
        }
        session.complete = Some(tail.transfer_id);
        // The first frame was full, so there are at least eight bytes, two of them the CRC.
        Ok(Some(Done { buffer: Some(buffer), len: total.saturating_sub(2).min(extent), at, repeated: false }))
    }

    /// Index of a buffer that no transfer needs; one that is stuck loses its own.
    fn buffer(&mut self, now: Instant) -> Result<usize, Dropped> {
        let mut used = 0_u32;
        let mut stuck: Option<&mut Session> = None;
        for session in &mut self.sessions {
            if let Some(active) = &session.active {
                used |= 1_u32.wrapping_shl(active.buffer as u32);
            }
            if session.is_stuck(now) && stuck.as_ref().is_none_or(|other| session.heard < other.heard) {
                stuck = Some(session);
            }
        }
        if let Some(free) = (0..BUFFERS).find(|index| used >> index & 1 == 0) {
            return Ok(free);
        }
        let lost = stuck.and_then(|session| session.active.take()).ok_or(Dropped::NoRoom)?;
        self.counters.abandon();
        Ok(lost.buffer)
    }
}

/// Copies what of `data` fits into `buffer[at..extent]`; returns the number of bytes.
fn copy(buffer: &mut [u8], at: usize, extent: usize, data: &[u8]) -> usize {
    let room = buffer.get_mut(at..extent).unwrap_or(&mut []);
    for (to, from) in room.iter_mut().zip(data) {
        *to = *from;
    }
    room.len().min(data.len())
}
