//! Requests in flight: deadlines, repetition, and answers matched to their own request.
//!
//! [`Client`] keeps a table of requests. Each is sent as a transfer with a number of its own. If no answer comes
//! within the time-out it is sent again *under a new number*, because a server drops a repetition under the old one
//! as a duplicate. An answer counts only if server, service and number are those of the attempt in flight, so a
//! late or repeated answer never counts for another request: numbers run modulo 32, and a number is used again only
//! after 31 further requests to the same server and service.
//!
//! Numbers begin at 0 in each process. By chance this may be the last number of a process that ended less than two
//! seconds ago. The server then drops the first attempt and accepts the second.
//!
//! Because the answer, and not the request, may have been lost, every request must be harmless when it is executed
//! twice; the services of this project are.
//!
//! Must not: know the meaning of a request, read a clock, or send by itself ([`Client::poll`] gets the sender).

use core::fmt;

use super::bits::{BufferTooSmall, Encode, Writer, to_bytes};
use super::id::{NodeId, Priority, Route, ServiceId, TransferId};
use super::rx::Transfer;
use super::tx::{SendError, TxMeta};
use crate::time::{Duration, Instant};

/// Number of different services one client can use.
pub const SERVICES_MAX: usize = 8;
/// Pause before a request is offered again to a full transmit queue.
const QUEUE_PAUSE: Duration = Duration::from_millis(2);

/// How long to wait, how often to try, how urgent it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Policy {
    /// Time from sending until an attempt counts as lost.
    pub timeout: Duration,
    /// Attempts in all, at least 1.
    pub attempts: u8,
    /// Urgency of request and answer; [`Priority::Exceptional`] is raised to the next level.
    pub priority: Priority,
}

impl Policy {
    /// For the pieces of a file: below normal traffic, with many attempts. A piece is 40 frames, so at one lost
    /// frame in 60 every other attempt fails; thirty in a row do not.
    pub const FILE: Self =
        Self { timeout: Duration::from_millis(100), attempts: 30, priority: Priority::Low };
}

impl Default for Policy {
    /// Five attempts of 200 ms: a file.Write request of 40 frames takes 6 ms on an idle bus.
    fn default() -> Self {
        Self { timeout: Duration::from_millis(200), attempts: 5, priority: Priority::Nominal }
    }
}

/// Names one request of a client; never reused within 2^32 requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Ticket(u32);

/// Why a request could not begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError {
    /// All places are taken; wait for an answer or cancel one.
    TooManyRequests {
        /// Places of the table.
        capacity: usize,
    },
    /// The client already uses [`SERVICES_MAX`] other services.
    TooManyServices {
        /// The service that has no place.
        service: ServiceId,
    },
    /// The request is longer than a place of the table.
    TooLong(BufferTooSmall),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooManyRequests { capacity } => write!(f, "{capacity} requests are waiting already"),
            Self::TooManyServices { service } => {
                write!(f, "no place for service {service}: {SERVICES_MAX} others are in use")
            }
            Self::TooLong(e) => write!(f, "request too long: {e}"),
        }
    }
}

impl core::error::Error for StartError {}

/// No attempt of a request was answered in its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoAnswer {
    /// Server of the request.
    pub server: NodeId,
    /// Service of the request.
    pub service: ServiceId,
    /// Requests that were sent, the first one included.
    pub attempts: u8,
}

impl fmt::Display for NoAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { server, service, attempts } = self;
        write!(f, "node {server} did not answer service {service} in {attempts} attempts")
    }
}

impl core::error::Error for NoAnswer {}

#[derive(Clone, Copy, Debug)]
struct Slot<const BYTES: usize> {
    /// `None` = free.
    ticket: Option<Ticket>,
    server: NodeId,
    service: ServiceId,
    policy: Policy,
    /// Number of the attempt in flight; `None` before the first one.
    transfer_id: Option<TransferId>,
    /// When the attempt in flight is lost, or the next one may be sent.
    due: Instant,
    sent: u8,
    len: usize,
    payload: [u8; BYTES],
}

impl<const BYTES: usize> Slot<BYTES> {
    const FREE: Self = Self {
        ticket: None,
        server: NodeId::MAX,
        service: ServiceId::MAX,
        policy: Policy { timeout: Duration::ZERO, attempts: 0, priority: Priority::Nominal },
        transfer_id: None,
        due: Instant::ZERO,
        sent: 0,
        len: 0,
        payload: [0; BYTES],
    };
}

/// Counter of transfers per service and server, kept for ever (section 4.1.1.7).
#[derive(Clone, Debug)]
struct TransferIds {
    services: [Option<ServiceId>; SERVICES_MAX],
    next: [[TransferId; 128]; SERVICES_MAX],
}

impl TransferIds {
    /// Makes sure that the service has a place.
    fn admit(&mut self, service: ServiceId) -> bool {
        if self.services.contains(&Some(service)) {
            return true;
        }
        match self.services.iter_mut().find(|place| place.is_none()) {
            Some(place) => *place = Some(service),
            None => return false,
        }
        true
    }

    fn take(&mut self, service: ServiceId, server: NodeId) -> Option<TransferId> {
        let place = self.services.iter().position(|known| *known == Some(service))?;
        let next = self.next.get_mut(place)?.get_mut(usize::from(server.get()))?;
        let id = *next;
        *next = id.next();
        Some(id)
    }
}

/// Raw bytes as an outgoing payload.
struct Raw<'a>(&'a [u8]);

impl Encode for Raw<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(self.0);
    }
}

/// Table of `PENDING` requests of at most `BYTES` bytes.
#[derive(Clone, Debug)]
pub struct Client<const PENDING: usize, const BYTES: usize> {
    address: NodeId,
    slots: [Slot<BYTES>; PENDING],
    ids: TransferIds,
    next_ticket: u32,
    repeated: u32,
    unmatched: u32,
}

impl<const PENDING: usize, const BYTES: usize> Client<PENDING, BYTES> {
    /// No requests yet; `address` is this node's.
    pub const fn new(address: NodeId) -> Self {
        const { assert!(PENDING < 32, "fewer requests than transfer numbers") };
        Self {
            address,
            slots: [Slot::FREE; PENDING],
            ids: TransferIds {
                services: [None; SERVICES_MAX],
                next: [[TransferId::ZERO; 128]; SERVICES_MAX],
            },
            next_ticket: 0,
            repeated: 0,
            unmatched: 0,
        }
    }

    /// Gives the node another address. Call it before the first request.
    pub const fn set_address(&mut self, address: NodeId) {
        self.address = address;
    }

    /// Attempts sent after a first one was not answered.
    pub const fn repeated(&self) -> u32 {
        self.repeated
    }

    /// Answers that belong to no attempt in flight.
    pub const fn unmatched(&self) -> u32 {
        self.unmatched
    }

    /// True while no request is in the table.
    pub fn is_idle(&self) -> bool {
        self.slots.iter().all(|slot| slot.ticket.is_none())
    }

    /// Begins a request; the next [`Self::poll`] sends it.
    pub fn start(
        &mut self,
        now: Instant,
        server: NodeId,
        service: ServiceId,
        policy: Policy,
        request: &dyn Encode,
    ) -> Result<Ticket, StartError> {
        let full = StartError::TooManyRequests { capacity: PENDING };
        let slot = self.slots.iter_mut().find(|slot| slot.ticket.is_none()).ok_or(full)?;
        slot.len = to_bytes(request, &mut slot.payload).map_err(StartError::TooLong)?;
        if !self.ids.admit(service) {
            return Err(StartError::TooManyServices { service });
        }
        let ticket = Ticket(self.next_ticket);
        self.next_ticket = self.next_ticket.wrapping_add(1);
        slot.ticket = Some(ticket);
        slot.server = server;
        slot.service = service;
        slot.policy = Policy { attempts: policy.attempts.max(1), ..policy };
        slot.transfer_id = None;
        slot.due = now;
        slot.sent = 0;
        Ok(ticket)
    }

    /// Forgets a request; an answer that still comes is unmatched.
    pub fn cancel(&mut self, ticket: Ticket) {
        for slot in &mut self.slots {
            if slot.ticket == Some(ticket) {
                slot.ticket = None;
            }
        }
    }

    /// The request that a response answers, which is then done.
    pub fn answered(&mut self, response: &Transfer<'_>) -> Option<Ticket> {
        let Route::Response { service, source, .. } = response.route else { return None };
        let slot = self.slots.iter_mut().find(|slot| {
            slot.ticket.is_some()
                && slot.server == source
                && slot.service == service
                && slot.transfer_id == Some(response.transfer_id)
        });
        let ticket = slot.and_then(|slot| slot.ticket.take());
        if ticket.is_none() {
            self.unmatched = self.unmatched.saturating_add(1);
        }
        ticket
    }

    /// Does one thing that is due: sends one attempt through `send`, or gives up one request and
    /// returns it. Call until it returns [`Polled::Idle`].
    pub fn poll(
        &mut self,
        now: Instant,
        send: &mut dyn FnMut(&TxMeta, &dyn Encode) -> Result<(), SendError>,
    ) -> Polled {
        let waiting = self.slots.iter().enumerate().filter(|(_, slot)| slot.ticket.is_some());
        let next = waiting.filter(|(_, slot)| slot.due <= now).min_by_key(|(_, slot)| slot.due);
        let Some((index, &Slot { server, service, sent: attempts, policy, .. })) = next else {
            return Polled::Idle;
        };
        let transfer_id = if attempts < policy.attempts { self.free_id(service, server) } else { None };
        let Some(slot) = self.slots.get_mut(index) else { return Polled::Idle };
        let Some(transfer_id) = transfer_id else {
            let failed = NoAnswer { server, service, attempts };
            return match slot.ticket.take() {
                Some(ticket) => Polled::GaveUp(ticket, failed),
                None => Polled::Idle,
            };
        };
        let meta = TxMeta {
            route: Route::Request { service: slot.service, source: self.address, destination: slot.server },
            priority: slot.policy.priority.max(Priority::Immediate),
            transfer_id,
            // Not zero, so that even a time-out of zero sends something.
            deadline: now + policy.timeout + Duration::from_micros(1),
        };
        let payload = slot.payload.get(..slot.len).unwrap_or(&[]);
        match send(&meta, &Raw(payload)) {
            Ok(()) => {
                self.repeated = self.repeated.saturating_add(u32::from(slot.sent > 0));
                slot.transfer_id = Some(transfer_id);
                slot.sent = slot.sent.saturating_add(1);
                slot.due = meta.deadline;
            }
            // Not an attempt: the bus has not seen it.
            Err(SendError::QueueFull { .. }) => slot.due = now + QUEUE_PAUSE,
            // It will never fit: give up at once.
            Err(SendError::TooLong(_)) => slot.policy.attempts = slot.sent,
        }
        Polled::Sent
    }

    /// The next number for a server and service that no request in flight uses (section 4.1.3.2);
    /// there is one, because the table is smaller than the modulus.
    fn free_id(&mut self, service: ServiceId, server: NodeId) -> Option<TransferId> {
        for _ in 0..=TransferId::MAX.get() {
            let id = self.ids.take(service, server)?;
            let taken = self.slots.iter().any(|slot| {
                slot.ticket.is_some()
                    && slot.server == server
                    && slot.service == service
                    && slot.transfer_id == Some(id)
            });
            if !taken {
                return Some(id);
            }
        }
        None
    }

    /// When [`Self::poll`] has something to do.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.slots.iter().filter(|slot| slot.ticket.is_some()).map(|slot| slot.due).min()
    }
}

/// What [`Client::poll`] did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Polled {
    /// Nothing is due.
    Idle,
    /// An attempt was handed to the sender, or postponed because its queue is full.
    Sent,
    /// All attempts of a request are lost; the request is removed.
    GaveUp(Ticket, NoAnswer),
}
