//! From a [`BusSpec`] to a link: joining a bus that exists, or serving one.

use protocol::text::BusName;
use protocol::{Frame, Instant};

use crate::clock::Clock;
use crate::error::OpenError;
use crate::hub::{ClientId, Dialect, Hub, ServerEvent, ServerOptions};
use crate::link::CanLink;
use crate::slcan::{Adapter, Host};
use crate::socketcand::{Client, Server};
use crate::spec::{BusSpec, SlcanPort};

/// Joins the bus that `spec` names, as one participant. `clock` is of the kind that [`BusSpec::clock`] makes.
///
/// # Errors
///
/// The bus cannot be reached; or it is [`BusSpec::Sim`], which is no link of the operating system but
/// a cell inside the program.
pub fn open(spec: &BusSpec, clock: Clock) -> Result<Box<dyn CanLink + Send>, OpenError> {
    Ok(match spec {
        BusSpec::Sim => return Err(OpenError::Embedded),
        BusSpec::Rsi(spec) => return Err(OpenError::NoCan { spec: spec.clone() }),
        BusSpec::SocketCan { interface } => socket_can(interface, clock)?,
        BusSpec::Socketcand { host, port, bus } | BusSpec::Lockstep { host, port, bus, .. } => {
            let name = BusName::new(bus).map_err(|error| OpenError::Refused {
                address: host.clone(),
                bus: bus.clone(),
                reason: error.to_string(),
            })?;
            let client = Client::connect(host, *port, name, clock)?;
            match spec {
                BusSpec::Lockstep { .. } => Box::new(client.in_step()?),
                _ => Box::new(client),
            }
        }
        BusSpec::Slcan { port: SlcanPort::Device { path, baud }, bitrate } => {
            Box::new(Host::open_device(path, *baud, *bitrate, clock)?)
        }
        BusSpec::Slcan { port: SlcanPort::Tcp { host, port }, bitrate } => {
            Box::new(Host::connect(host, *port, *bitrate, clock)?)
        }
    })
}

/// A link with many peers, for the program that *is* the bus: what [`Hub`] provides, for every protocol.
pub trait BusServer: CanLink {
    /// As [`Hub::next_event`].
    fn next_event(&mut self) -> Option<ServerEvent>;
    /// As [`Hub::next_event_from`].
    fn next_event_from(&mut self, has_room: &mut dyn FnMut(ClientId) -> bool) -> Option<ServerEvent>;
    /// As [`Hub::broadcast`].
    fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>);
    /// As [`Hub::send_to`].
    fn send_to(&mut self, client: ClientId, at: Instant, frame: &Frame);
    /// As [`Hub::give_turn`].
    fn give_turn(&mut self, client: ClientId, now: Instant, frames: &[(Instant, Frame)]);
    /// As [`Hub::broadcast_bus_error`].
    fn broadcast_bus_error(&mut self, at: Instant, class: u32);
    /// As [`Hub::client_count`].
    fn client_count(&self) -> usize;
}

impl<D: Dialect> BusServer for Hub<D> {
    fn next_event(&mut self) -> Option<ServerEvent> {
        Self::next_event(self)
    }
    fn next_event_from(&mut self, has_room: &mut dyn FnMut(ClientId) -> bool) -> Option<ServerEvent> {
        Self::next_event_from(self, has_room)
    }
    fn broadcast(&mut self, at: Instant, frame: &Frame, except: Option<ClientId>) {
        Self::broadcast(self, at, frame, except);
    }
    fn send_to(&mut self, client: ClientId, at: Instant, frame: &Frame) {
        Self::send_to(self, client, at, frame);
    }
    fn give_turn(&mut self, client: ClientId, now: Instant, frames: &[(Instant, Frame)]) {
        Self::give_turn(self, client, now, frames);
    }
    fn broadcast_bus_error(&mut self, at: Instant, class: u32) {
        Self::broadcast_bus_error(self, at, class);
    }
    fn client_count(&self) -> usize {
        Self::client_count(self)
    }
}

/// Serves a bus at the place that `spec` names: a socketcand port, an SLCAN port, or an SLCAN adapter at a serial
/// device (the device `/dev/ptmx` makes a pseudo-terminal; the name of the link contains the path of its far end).
///
/// # Errors
///
/// The place is not available; or `spec` is an interface or [`BusSpec::Sim`], which a program joins and does not serve.
pub fn serve(
    spec: &BusSpec,
    clock: Clock,
    options: ServerOptions,
) -> Result<Box<dyn BusServer + Send>, OpenError> {
    Ok(match spec {
        BusSpec::Sim => return Err(OpenError::Embedded),
        BusSpec::Rsi(spec) => return Err(OpenError::NoCan { spec: spec.clone() }),
        BusSpec::SocketCan { interface } => {
            return Err(OpenError::NotServable { interface: interface.clone() });
        }
        BusSpec::Socketcand { host, port, bus } | BusSpec::Lockstep { host, port, bus, .. } => {
            Box::new(Server::listen(host, *port, bus, clock, options)?)
        }
        BusSpec::Slcan { port: SlcanPort::Tcp { host, port }, bitrate } => {
            Box::new(Adapter::listen(host, *port, *bitrate, clock, options)?)
        }
        BusSpec::Slcan { port: SlcanPort::Device { path, baud }, bitrate } => {
            if path.as_os_str() == "/dev/ptmx" {
                Box::new(Adapter::at_pty(*bitrate, clock)?)
            } else {
                Box::new(Adapter::at_device(path, *baud, *bitrate, clock)?)
            }
        }
    })
}

#[cfg(target_os = "linux")]
fn socket_can(interface: &str, clock: Clock) -> Result<Box<dyn CanLink + Send>, OpenError> {
    Ok(Box::new(crate::socket_can::SocketCan::open(interface, clock)?))
}

#[cfg(not(target_os = "linux"))]
fn socket_can(interface: &str, _: Clock) -> Result<Box<dyn CanLink + Send>, OpenError> {
    Err(OpenError::NoCanInKernel { interface: interface.to_owned() })
}
