//! Frames of a tracker from a socket: DTrack (data over UDP, commands over TCP) and VRPN (over TCP).

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::str::FromStr;
use std::time::Duration as WallSpan;

use can_link::Clock;
use tracker_protocol::vrpn::VrpnClient;

use super::commands::{CommandError, Tracking};
use super::frames::{DTrackFrames, FRAME_LIMIT, FrameError, VrpnFrames};
use super::target::{NoTarget, Target, TargetRequest};

/// Longest wait for a connection.
const CONNECT_LIMIT: WallSpan = WallSpan::from_secs(3);
/// Longest wait for the answer to a command.
const ANSWER_LIMIT: WallSpan = WallSpan::from_secs(10);
/// Longest sleep, so that an interrupt is seen.
const LOOK: WallSpan = WallSpan::from_millis(50);
/// Largest datagram that is read, bytes.
const MAX_BYTES: usize = 32_768;

/// Which tracker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Data datagrams come to this address of this machine.
    DTrack {
        /// Address of this machine, `HOST:PORT`.
        data: String,
        /// Command channel of the tracker, `HOST:PORT`; `None`: it measures and sends by itself.
        commands: Option<String>,
    },
    Vrpn {
        /// `HOST:PORT` of the server.
        server: String,
        tracker: String,
    },
}

impl FromStr for Place {
    type Err = String;

    /// `HOST:PORT` or `dtrack://HOST:PORT[?commands=HOST:PORT]`, or `vrpn://HOST[:PORT]/NAME`.
    fn from_str(text: &str) -> Result<Self, String> {
        let with_port = |place: &str, port: Option<u16>| match (place.rsplit_once(':'), port) {
            (Some((host, port)), _) if port.parse::<u16>().is_ok() => {
                Ok(format!("{}:{port}", if host.is_empty() { "127.0.0.1" } else { host }))
            }
            (None, Some(port)) if !place.is_empty() => Ok(format!("{place}:{port}")),
            _ => Err(format!(
                "'{place}' is no HOST:PORT; write 0.0.0.0:5000, dtrack://0.0.0.0:5000?commands=192.168.0.1:50105 or vrpn://HOST/NAME"
            )),
        };
        if let Some(rest) = text.strip_prefix("vrpn://") {
            let (server, tracker) = rest
                .split_once('/')
                .ok_or("the name of the tracker is missing, as in vrpn://HOST/Tracker0")?;
            return Ok(Self::Vrpn { server: with_port(server, Some(3883))?, tracker: tracker.to_owned() });
        }
        let (data, query) = text.strip_prefix("dtrack://").unwrap_or(text).split_once('?').map_or_else(
            || (text.strip_prefix("dtrack://").unwrap_or(text), None),
            |(data, query)| (data, Some(query)),
        );
        let commands = match query {
            None => None,
            Some(query) => {
                let place = query
                    .strip_prefix("commands=")
                    .ok_or_else(|| format!("'{query}' is no option (commands=HOST:PORT)"))?;
                Some(with_port(place, Some(50105))?)
            }
        };
        Ok(Self::DTrack { data: with_port(data, None)?, commands })
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DTrack { data, commands: None } => write!(f, "dtrack://{data}"),
            Self::DTrack { data, commands: Some(commands) } => {
                write!(f, "dtrack://{data}?commands={commands}")
            }
            Self::Vrpn { server, tracker } => write!(f, "vrpn://{server}/{tracker}"),
        }
    }
}

/// No target came of it.
#[derive(Debug, thiserror::Error)]
pub enum TrackerError {
    #[error("{place}: {error}")]
    Socket {
        place: String,
        error: io::Error,
        /// What to do.
        next: &'static str,
    },
    /// Nothing comes.
    #[error("{place}: no frame within {} s", FRAME_LIMIT.as_secs_f64())]
    Silent { place: String },
    /// A datagram or stream is not valid.
    #[error("{place}: {what}")]
    Unreadable {
        place: String,
        /// What is wrong.
        what: String,
    },
    #[error("{place}: the tracker answers \"{answer}\" to \"{command}\"")]
    Refused {
        place: String,
        /// Request.
        command: String,
        answer: String,
    },
    /// Frames come, but the target cannot be used.
    #[error(transparent)]
    NoTarget(#[from] NoTarget),
    /// The caller ended it.
    #[error("interrupted")]
    Interrupted,
}

impl TrackerError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::Socket { next, .. } => (*next).to_owned(),
            Self::Silent { .. } => "start the measurement of the tracker and let it send to this machine; with ?commands=HOST:PORT this program does both".to_owned(),
            Self::Unreadable { .. } => "check that a tracker of this kind sends there".to_owned(),
            Self::Refused { .. } => "end the other program that commands the tracker".to_owned(),
            Self::NoTarget(error) => return error.next(),
            _ => return None,
        })
    }
}

pub fn measure(
    place: &Place,
    wish: &TargetRequest,
    goes_on: &dyn Fn() -> bool,
) -> Result<Target, TrackerError> {
    match place {
        Place::DTrack { data, commands } => {
            let next = "name an address of this machine and a free port";
            let socket = socket_error(place, next, UdpSocket::bind(data))?;
            let tracking = match commands {
                Some(commands) => Some(tracking(place, commands, &socket)?),
                None => None,
            };
            let target = dtrack(place, &socket, wish, goes_on);
            if let Some(tracking) = tracking {
                tracking.stop();
            }
            target
        }
        Place::Vrpn { server, tracker } => vrpn(place, server, tracker, wish, goes_on),
    }
}

fn socket_error<T>(place: &Place, next: &'static str, result: io::Result<T>) -> Result<T, TrackerError> {
    result.map_err(|error| TrackerError::Socket { place: place.to_string(), error, next })
}

fn no_target(place: &Place, error: FrameError) -> TrackerError {
    let place = place.to_string();
    match error {
        FrameError::Silent => TrackerError::Silent { place },
        FrameError::Unreadable(what) => TrackerError::Unreadable { place, what },
        FrameError::NoTarget(none) => TrackerError::NoTarget(none),
    }
}

fn tracking(place: &Place, commands: &str, data: &UdpSocket) -> Result<Tracking<TcpStream>, TrackerError> {
    let next = "check the address of the tracker's controller; its command port is 50105";
    let stream = socket_error(place, next, connect(commands))?;
    socket_error(place, next, stream.set_read_timeout(Some(ANSWER_LIMIT)))?;
    let port = socket_error(place, next, data.local_addr())?.port();
    Tracking::start(stream, port).map_err(|error| {
        let place = place.to_string();
        match error {
            CommandError::Stream(error) => {
                TrackerError::Socket { place, error, next: "check the network to the tracker's controller" }
            }
            CommandError::Unreadable(text) => {
                TrackerError::Unreadable { place, what: format!("\"{text}\" is not an answer to a command") }
            }
            CommandError::Refused { command, answer } => TrackerError::Refused { place, command, answer },
        }
    })
}

fn dtrack(
    place: &Place,
    socket: &UdpSocket,
    wish: &TargetRequest,
    goes_on: &dyn Fn() -> bool,
) -> Result<Target, TrackerError> {
    let next = "check the network interface";
    socket_error(place, next, socket.set_read_timeout(Some(LOOK)))?;
    let clock = Clock::start();
    let mut frames = DTrackFrames::new(*wish, clock.now());
    let mut buffer = vec![0; MAX_BYTES];
    while goes_on() {
        let step = match socket.recv(&mut buffer) {
            Ok(length) => frames.push(clock.now(), buffer.get(..length).unwrap_or_default()),
            Err(error) if would_block(&error) => frames.wait(clock.now()).map(|()| None),
            Err(error) => return socket_error(place, next, Err(error)),
        };
        if let Some(target) = step.map_err(|error| no_target(place, error))? {
            return Ok(target);
        }
    }
    Err(TrackerError::Interrupted)
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_LIMIT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn vrpn(
    place: &Place,
    server: &str,
    tracker: &str,
    wish: &TargetRequest,
    goes_on: &dyn Fn() -> bool,
) -> Result<Target, TrackerError> {
    let next = "check the address of the VRPN server; its port is 3883 unless it was set otherwise";
    let mut stream = socket_error(place, next, connect(server))?;
    socket_error(place, next, stream.set_read_timeout(Some(LOOK)))?;
    socket_error(place, next, stream.write_all(&VrpnClient::greeting()))?;
    let clock = Clock::start();
    let mut frames = VrpnFrames::new(*wish, tracker, clock.now());
    let mut buffer = vec![0; MAX_BYTES];
    while goes_on() {
        let step = match stream.read(&mut buffer) {
            Ok(0) => return socket_error(place, next, Err(io::Error::from(ErrorKind::UnexpectedEof))),
            Ok(count) => frames.push(clock.now(), buffer.get(..count).unwrap_or_default()),
            Err(error) if would_block(&error) => frames.wait(clock.now()).map(|()| None),
            Err(error) => return socket_error(place, next, Err(error)),
        };
        if let Some(target) = step.map_err(|error| no_target(place, error))? {
            return Ok(target);
        }
    }
    Err(TrackerError::Interrupted)
}

fn would_block(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_of_a_tracker_is_read_and_printed() {
        for (text, printed) in [
            ("127.0.0.1:5000", "dtrack://127.0.0.1:5000"),
            (":5000", "dtrack://127.0.0.1:5000"),
            ("dtrack://0.0.0.0:5000?commands=lab", "dtrack://0.0.0.0:5000?commands=lab:50105"),
            ("vrpn://lab/Tracker0", "vrpn://lab:3883/Tracker0"),
            ("vrpn://lab:3884/T", "vrpn://lab:3884/T"),
        ] {
            let place: Place = text.parse().unwrap();
            assert_eq!(place.to_string(), printed);
            assert_eq!(printed.parse(), Ok(place));
        }
        for wrong in ["", "5000", "dtrack://a:b", "vrpn://lab", "0.0.0.0:5000?x=1"] {
            assert!(wrong.parse::<Place>().is_err(), "{wrong}");
        }
    }
}
