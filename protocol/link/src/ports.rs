//! One bus behind several ports, whatever each of them speaks.

use protocol::{Frame, Instant};

use crate::error::{LinkError, SendError};
use crate::hub::{ClientId, ServerEvent};
use crate::link::{Event, Link, LinkStats, PollSet};
use crate::open::BusServer;

/// Several servers of the same bus as one: a socketcand port for programs and an SLCAN port for a board, say.
///
/// Clients keep their identity across the ports: no two of them share a [`ClientId`]. The owner passes frames on
/// ([`Relay::ByOwner`](crate::Relay::ByOwner) at every port), or clients of one port would not see the others'.
pub struct Ports {
    name: String,
    ports: Vec<Box<dyn BusServer + Send>>,
    /// Port that is asked first, so that a busy one does not starve the others.
    turn: usize,
}

impl Ports {
    /// These ports; their names joined with ", ".
    pub fn new(ports: Vec<Box<dyn BusServer + Send>>) -> Self {
        let names: Vec<&str> = ports.iter().map(Link::name).collect();
        Self { name: names.join(", "), ports, turn: 0 }
    }

    /// A client's identity at its port, as one at all of them.
    fn outer(&self, port: usize, ClientId(inner): ClientId) -> ClientId {
        ClientId(inner * self.ports.len() as u64 + port as u64)
    }

    /// The inverse of [`Self::outer`].
    fn inner(&self, ClientId(outer): ClientId) -> (usize, ClientId) {
        let count = self.ports.len().max(1) as u64;
        ((outer % count) as usize, ClientId(outer / count))
    }
}

impl BusServer for Ports {
    fn next_event(&mut self) -> Option<ServerEvent> {
        for _ in 0..self.ports.len() {
            let port = self.turn;
            let event = self.ports.get_mut(port)?.next_event();
            self.turn = (port + 1) % self.ports.len();
            if let Some(event) = event {
                return Some(match event {
                    ServerEvent::Joined { client, peer } => {
                        ServerEvent::Joined { client: self.outer(port, client), peer }
                    }
                    ServerEvent::Frame { client, at, frame } => {
                        ServerEvent::Frame { client: self.outer(port, client), at, frame }
                    }
                    ServerEvent::Left { client, reason } => {
                        ServerEvent::Left { client: self.outer(port, client), reason }
                    }
                });
            }
        }
        None
    }

    fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        let except = except.map(|client| self.inner(client));
        for (index, port) in self.ports.iter_mut().enumerate() {
            let except = except.filter(|(at_port, _)| *at_port == index).map(|(_, client)| client);
            port.broadcast(at, frame, except);
        }
    }

    fn broadcast_bus_error(&mut self, at: Instant, class: u32) {
        for port in &mut self.ports {
            port.broadcast_bus_error(at, class);
        }
    }

    fn client_count(&self) -> usize {
        self.ports.iter().map(|port| port.client_count()).sum()
    }
}

impl Link for Ports {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.ports.iter_mut().try_for_each(|port| port.send(frame))
    }

    /// # Errors
    ///
    /// A port without a listener, at a serial line, is gone.
    fn receive(&mut self) -> Result<Option<Event>, LinkError> {
        for port in &mut self.ports {
            if let Some(event) = port.receive()? {
                return Ok(Some(event));
            }
        }
        Ok(None)
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        for port in &self.ports {
            port.register(set);
        }
    }

    fn deadline(&self) -> Option<Instant> {
        self.ports.iter().filter_map(Link::deadline).min()
    }

    fn stats(&self) -> LinkStats {
        self.ports.iter().map(Link::stats).fold(LinkStats::default(), |sum, one| LinkStats {
            frames_in: sum.frames_in + one.frames_in,
            frames_out: sum.frames_out + one.frames_out,
            dropped_out: sum.dropped_out + one.dropped_out,
            refused_out: sum.refused_out + one.refused_out,
            dropped_in: sum.dropped_in + one.dropped_in,
            malformed_in: sum.malformed_in + one.malformed_in,
        })
    }
}
