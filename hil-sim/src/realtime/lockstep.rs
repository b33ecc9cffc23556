//! Virtual time that programs share over sockets: it passes only when each of them has stated when it needs its next turn.
//!
//! ```text
//!   client ── send… wait T ──▶ gateway ──▶ world ── runs to the next frame or the earliest T
//!          ◀── frames, time T ──
//! ```
//!
//! Frames that the clients send during their turns reach the simulated bus in the order in which the clients
//! joined, whichever was faster. A delay of a program by the machine changes nothing: a run depends only on the
//! programs and on the seed. The messages are described at [`protocol::text::socketcand`].
//!
//! A client that did not request lock step gets the frames at once, and time does not wait for it. Its own frames
//! come at arbitrary times, so a run with it repeats only if it stays silent.

use can_link::{BusSpec, CanLink, ClientId, Clock, ServerEvent};
use protocol::{Duration, Frame, Instant};

use super::endpoint::{Endpoint, Visit};
use super::{NAP_MAX, Realtime, RealtimeError};
use crate::participants::Participants;
use crate::world::Observer;

/// The time that the servers at `specs` share: their clock, and for lock step the fewest clients; `None` in real time.
///
/// # Errors
///
/// Some are in lock step and others not.
pub fn shared_time(specs: &[BusSpec]) -> Result<(Clock, Option<usize>), MixedTime> {
    let clients = |spec: &BusSpec| match spec {
        BusSpec::Lockstep { clients, .. } => Some(*clients),
        _ => None,
    };
    let least: Vec<usize> = specs.iter().filter_map(clients).collect();
    match least.iter().max() {
        None => Ok((Clock::start(), None)),
        Some(clients) if least.len() == specs.len() => Ok((Clock::manual(), Some(*clients))),
        Some(_) => Err(MixedTime),
    }
}

/// Real and virtual time on one bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a bus has one time: lock step or the machine's, not both")]
pub struct MixedTime;

impl MixedTime {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some("give --bus lockstep:// for all places or for none".to_owned())
    }
}

/// Drives answer within a few milliseconds, and the queue of a gateway is empty after that time too.
const QUIET: Duration = Duration::from_millis(20);

pub(super) struct LockStep {
    /// Time stands while fewer take part.
    clients_min: usize,
    /// In the order in which they joined.
    members: Vec<Member>,
    others: Vec<(usize, ClientId)>,
    /// The last member has left: time passes until then, so that the next member does not get the answers to its requests.
    quiet_until: Option<Instant>,
}

struct Member {
    port: usize,
    client: ClientId,
    /// What it sent during its turn.
    said: Vec<Frame>,
    /// Frames that it has not received.
    unheard: Vec<(Instant, Frame)>,
    /// `None` during its turn.
    waits: Option<Wait>,
}

#[derive(Clone, Copy)]
struct Wait {
    until: Instant,
    frames_from: Instant,
}

impl Member {
    /// When its next turn is due; `None` during a turn.
    fn due(&self) -> Option<Instant> {
        let wait = self.waits?;
        Some(match self.unheard.first() {
            Some((at, _)) => wait.until.min(wait.frames_from.max(*at)),
            None => wait.until,
        })
    }
}

impl LockStep {
    pub(super) const fn new(clients_min: usize) -> Self {
        Self { clients_min, members: Vec::new(), others: Vec::new(), quiet_until: None }
    }

    fn member(&mut self, port: usize, client: ClientId) -> Option<&mut Member> {
        self.members.iter_mut().find(|member| (member.port, member.client) == (port, client))
    }

    /// A client must send before time may pass.
    fn waits_for_clients(&self) -> bool {
        self.members.len() < self.clients_min || self.members.iter().any(|member| member.waits.is_none())
    }
}

impl<A: Participants> Realtime<A> {
    /// Accepts the members of a lock step, before its time begins: true when as many have joined as it waits for.
    /// From then on it does not wait for members that leave.
    pub fn is_gathered(&mut self) -> bool {
        let Some(mut step) = self.lock_step.take() else { return true };
        self.hear(&mut step);
        let all = step.members.len() >= step.clients_min;
        step.clients_min = if all { 0 } else { step.clients_min };
        self.lock_step = Some(step);
        all
    }

    /// Clients in lock step.
    pub fn members(&self) -> usize {
        self.lock_step.as_ref().map_or(0, |step| step.members.len())
    }

    /// In lock step: it is `time` or later, and no client has a turn before the time continues.
    pub fn has_reached(&self, time: Instant) -> bool {
        let now = self.world.now();
        let mut members = self.lock_step.iter().flat_map(|step| &step.members);
        now >= time && members.all(|member| member.due().is_some_and(|due| due > now))
    }

    /// As [`Realtime::turn`]: lets the clients and the world take turns until `until`, or for 50 ms of real time.
    pub(super) fn take_turns(
        &mut self,
        step: &mut LockStep,
        until: Instant,
        observer: &mut impl Observer,
    ) -> Result<(), RealtimeError> {
        let real = Clock::start();
        let end = real.now() + NAP_MAX;
        loop {
            self.hear(step);
            if let Some(quiet) = step.quiet_until.take() {
                self.world.run_until(quiet, &mut (&mut self.seen, &mut *observer))?;
                self.clock.set(quiet);
            } else if step.waits_for_clients() {
                let links: Vec<&dyn CanLink> = self.ports.iter().map(|port| port.endpoint.link()).collect();
                can_link::wait(&links, &real, Some(end))?;
            } else {
                self.send_said(step)?;
                let now = self.world.now();
                if let Some(member) =
                    step.members.iter_mut().find(|member| member.due().is_some_and(|due| due <= now))
                {
                    self.give_turn(member, now);
                } else if now >= until {
                    return Ok(());
                } else {
                    let turns = step.members.iter().filter_map(Member::due);
                    let next = turns.chain(self.world.next_wake()).chain([until]).min().unwrap_or(until);
                    // What was due at this time has been done.
                    let next = next.max(Instant::from_micros(now.as_micros() + 1)).min(until);
                    self.world.run_until(next, &mut (&mut self.seen, &mut *observer))?;
                    self.clock.set(next);
                    self.hand_to(step)?;
                }
            }
            if real.now() >= end {
                return Ok(());
            }
        }
    }

    /// Reads the messages of the clients, up to the leave of the last member.
    fn hear(&mut self, step: &mut LockStep) {
        let now = self.world.now();
        for (index, port) in self.ports.iter_mut().enumerate() {
            let Endpoint::Server(server) = &mut port.endpoint else { continue };
            while let Some(event) = server.next_event() {
                match event {
                    ServerEvent::Joined { client, peer } => {
                        step.others.push((index, client));
                        port.visits.push(Visit::Joined(peer));
                    }
                    ServerEvent::Left { client, reason } => {
                        step.others.retain(|other| *other != (index, client));
                        let members = step.members.len();
                        step.members.retain(|member| (member.port, member.client) != (index, client));
                        port.visits.push(Visit::Left(reason));
                        if members > 0 && step.members.is_empty() {
                            step.quiet_until = Some(now + QUIET);
                            return;
                        }
                    }
                    ServerEvent::InStep { client } if step.member(index, client).is_none() => {
                        step.others.retain(|other| *other != (index, client));
                        let (said, unheard) = (Vec::new(), Vec::new());
                        step.members.push(Member { port: index, client, said, unheard, waits: None });
                        port.visits.push(Visit::InStep(step.members.len()));
                        server.give_turn(client, now, &[]);
                    }
                    ServerEvent::InStep { .. } => {}
                    ServerEvent::Waits { client, until, frames_from } => {
                        if let Some(member) = step.member(index, client) {
                            member.waits = Some(Wait { until, frames_from });
                        }
                    }
                    ServerEvent::Frame { client, frame, .. } => match step.member(index, client) {
                        Some(member) => member.said.push(frame),
                        None => port.unasked.push((client, frame)),
                    },
                }
            }
        }
    }

    /// Puts the frames of the turns into the gateways, in the order of the clients.
    fn send_said(&mut self, step: &mut LockStep) -> Result<(), RealtimeError> {
        let mut said: Vec<(usize, ClientId, Frame)> = Vec::new();
        for member in &mut step.members {
            said.extend(member.said.drain(..).map(|frame| (member.port, member.client, frame)));
        }
        for (index, port) in self.ports.iter_mut().enumerate() {
            said.extend(port.unasked.drain(..).map(|(client, frame)| (index, client, frame)));
        }
        if !said.is_empty() {
            self.world.with_participants(|participants, _| {
                for (port, client, frame) in said {
                    participants.1[port].node.take(Some(client), frame);
                }
            })?;
        }
        Ok(())
    }

    /// The member gets its frames, and may send.
    fn give_turn(&mut self, member: &mut Member, now: Instant) {
        if let Endpoint::Server(server) = &mut self.ports[member.port].endpoint {
            server.give_turn(member.client, now, &member.unheard);
            member.unheard.clear();
        }
        member.waits = None;
        self.turns += 1;
    }

    /// Passes on what happened on the simulated bus.
    fn hand_to(&mut self, step: &mut LockStep) -> Result<(), RealtimeError> {
        let own = &mut self.seen.own;
        let ports = self.ports.len();
        // For each endpoint: time, frame, and the client that sent it.
        let heard = self.world.with_participants(|participants, _| {
            let mut heard = vec![Vec::new(); ports];
            for (port, at, frame) in own.drain(..) {
                let sender = participants.1[port].node.sender_of(&frame);
                heard[port].push((at, frame, sender));
            }
            for (port, gateway) in participants.1.iter_mut().enumerate() {
                heard[port].extend(gateway.node.received.drain(..).map(|(at, frame)| (at, frame, None)));
                heard[port].sort_by_key(|(at, ..)| *at);
            }
            heard
        })?;
        for (index, heard) in heard.into_iter().enumerate() {
            for (at, frame, sender) in heard {
                for member in step.members.iter_mut().filter(|member| member.port == index) {
                    if sender != Some(member.client) {
                        member.unheard.push((at, frame));
                    }
                }
                let Endpoint::Server(server) = &mut self.ports[index].endpoint else { continue };
                for (_, client) in step.others.iter().filter(|(port, _)| *port == index) {
                    if sender != Some(*client) {
                        server.send_to(*client, at, &frame);
                    }
                }
            }
        }
        for (at, class) in self.seen.errors.drain(..) {
            self.ports.iter_mut().for_each(|port| port.put_error(at, class));
        }
        self.forget_lost()
    }
}
