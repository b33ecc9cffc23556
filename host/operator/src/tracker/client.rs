//! Frames of a tracker from a socket: DTrack (data over UDP, commands over TCP) and VRPN (over TCP).

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::str::FromStr;
use std::time::{Duration as WallSpan, Instant as WallTime};

use tracker_protocol::dtrack::{Answer, Command, DataFrame, DayClock, FrameGate, Messages, Verdict};
use tracker_protocol::vrpn::{VrpnClient, VrpnError, VrpnItem};

use super::target::{Estimator, Frame, NoTarget, Target, TargetRequest};

/// Longest wait for the first and for the next frame.
const FRAME_LIMIT: WallSpan = WallSpan::from_secs(3);
/// Longest wait for the answer to a command.
const ANSWER_LIMIT: WallSpan = WallSpan::from_secs(10);
/// Longest sleep, so that an interrupt is seen.
const LOOK: WallSpan = WallSpan::from_millis(50);
/// Largest datagram that is read, bytes.
const MAX_BYTES: usize = 32_768;
/// A frame counter that falls by more than this says that the tracker was started again.
const RESTART_AFTER: u64 = 1_000;

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
    /// A VRPN server.
    Vrpn {
        /// `HOST:PORT` of the server.
        server: String,
        /// Name of the tracker at it.
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
    #[error("{place}: {error}\n  next: {next}")]
    Socket {
        place: String,
        /// What the system says.
        error: io::Error,
        /// What to do.
        next: &'static str,
    },
    /// Nothing comes.
    #[error(
        "{place}: no frame within {} s\n  next: start the measurement of the tracker and let it send to this machine; with ?commands=HOST:PORT this program does both",
        FRAME_LIMIT.as_secs()
    )]
    Silent { place: String },
    /// A datagram or stream is none.
    #[error("{place}: {what}\n  next: check that a tracker of this kind sends there")]
    Unreadable {
        place: String,
        /// What is wrong.
        what: String,
    },
    /// The tracker refuses a command.
    #[error(
        "{place}: the tracker answers \"{answer}\" to \"{command}\"\n  next: end the other program that commands the tracker"
    )]
    Refused {
        place: String,
        /// What was asked.
        command: String,
        /// What it said.
        answer: String,
    },
    /// Frames come, and the target is none.
    #[error(transparent)]
    NoTarget(#[from] NoTarget),
    /// The caller ended it.
    #[error("interrupted")]
    Interrupted,
}

/// Measures a target.
///
/// # Errors
/// [`TrackerError`].
pub fn measure(
    place: &Place,
    wish: &TargetRequest,
    goes_on: &dyn Fn() -> bool,
) -> Result<Target, TrackerError> {
    match place {
        Place::DTrack { data, commands } => {
            let socket = socket_error(
                place,
                "name an address of this machine and a free port",
                UdpSocket::bind(data),
            )?;
            let tracking = match commands {
                Some(commands) => Some(Tracking::start(place, commands, &socket)?),
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

fn dtrack(
    place: &Place,
    socket: &UdpSocket,
    wish: &TargetRequest,
    goes_on: &dyn Fn() -> bool,
) -> Result<Target, TrackerError> {
    let next = "check the network interface";
    socket_error(place, next, socket.set_read_timeout(Some(LOOK)))?;
    let (mut gate, mut clock, mut estimator) =
        (FrameGate::new(RESTART_AFTER), DayClock::new(), Estimator::new(*wish));
    let mut heard = WallTime::now();
    let mut buffer = vec![0; MAX_BYTES];
    loop {
        if !goes_on() {
            return Err(TrackerError::Interrupted);
        }
        let length = match socket.recv(&mut buffer) {
            Ok(length) => length,
            Err(error) if would_block(&error) => {
                if heard.elapsed() >= FRAME_LIMIT {
                    return Err(TrackerError::Silent { place: place.to_string() });
                }
                continue;
            }
            Err(error) => return socket_error(place, next, Err(error)),
        };
        let unreadable = |what: String| TrackerError::Unreadable { place: place.to_string(), what };
        let frame = DataFrame::parse(buffer.get(..length).unwrap_or_default())
            .map_err(|error| unreadable(error.to_string()))?;
        heard = WallTime::now();
        match gate.judge(frame.frame) {
            Verdict::Old => continue,
            Verdict::Restart => {
                estimator.restart();
                clock = DayClock::new();
            }
            Verdict::First | Verdict::New { .. } => {}
        }
        let stamp = frame.stamp(&mut clock);
        if stamp.is_none() {
            return Err(unreadable("frames have no time; switch `ts` on in the output settings".to_owned()));
        }
        let pose = frame
            .pose(wish.body, &mut clock)
            .map_err(|error| NoTarget::NotAPose { body: wish.body, what: error.to_string() })?;
        if let Some(target) = estimator.push(&Frame { stamp, pose })? {
            return Ok(target);
        }
    }
}

/// The command channel, with a measurement that this program started.
struct Tracking {
    place: String,
    stream: TcpStream,
    messages: Messages,
    waiting: Vec<String>,
    started: bool,
}

impl Tracking {
    fn start(place: &Place, commands: &str, data: &UdpSocket) -> Result<Self, TrackerError> {
        let next = "check the address of the tracker's controller; its command port is 50105";
        let stream = socket_error(place, next, connect(commands))?;
        socket_error(place, next, stream.set_read_timeout(Some(ANSWER_LIMIT)))?;
        let mut this = Self {
            place: place.to_string(),
            stream,
            messages: Messages::default(),
            waiting: Vec::new(),
            started: false,
        };
        let port = socket_error(place, next, data.local_addr())?.port();
        if this.ask(&Command::GetAccess.to_string())?.value_of("system access") != Some("full") {
            return Err(TrackerError::Refused {
                place: this.place.clone(),
                command: Command::GetAccess.to_string(),
                answer: "no access".to_owned(),
            });
        }
        this.order(&format!("dtrack2 set output net ch01 udp my_ip {port}"))?;
        this.order("dtrack2 set output active ch01 all yes")?;
        // A tracker that measures already is left at it.
        if this.ask(&Command::GetStatus.to_string())?.value_of("status active") != Some("mea") {
            this.order("dtrack2 tracking start")?;
            this.started = true;
        }
        Ok(this)
    }

    fn order(&mut self, command: &str) -> Result<(), TrackerError> {
        match self.ask(command)? {
            Answer::Ok => Ok(()),
            answer => Err(TrackerError::Refused {
                place: self.place.clone(),
                command: command.to_owned(),
                answer: answer.to_string(),
            }),
        }
    }

    fn ask(&mut self, command: &str) -> Result<Answer, TrackerError> {
        let failed = |error| TrackerError::Socket {
            place: self.place.clone(),
            error,
            next: "check the network to the tracker's controller",
        };
        self.stream.write_all(&Messages::frame(&command)).map_err(failed)?;
        let mut buffer = [0; 1024];
        loop {
            if let Some(text) = (!self.waiting.is_empty()).then(|| self.waiting.remove(0)) {
                return Answer::parse(&text).ok_or_else(|| TrackerError::Unreadable {
                    place: self.place.clone(),
                    what: format!("\"{text}\" is no answer"),
                });
            }
            let count = self.stream.read(&mut buffer).map_err(failed)?;
            if count == 0 {
                return Err(failed(io::Error::from(ErrorKind::UnexpectedEof)));
            }
            let read = self.messages.push(buffer.get(..count).unwrap_or_default());
            self.waiting.extend(read.into_iter().flatten());
        }
    }

    /// Ends the measurement if it is ours. Nothing depends on the answer.
    fn stop(mut self) {
        if self.started {
            let _ = self.ask("dtrack2 tracking stop");
        }
    }
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, FRAME_LIMIT) {
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
    let next = "check the address of the VRPN server; its port is 3883 unless it was told otherwise";
    let mut stream = socket_error(place, next, connect(server))?;
    socket_error(place, next, stream.set_read_timeout(Some(LOOK)))?;
    socket_error(place, next, stream.write_all(&VrpnClient::greeting()))?;
    let (mut client, mut estimator) = (VrpnClient::new(tracker), Estimator::new(*wish));
    let mut heard = WallTime::now();
    let mut buffer = vec![0; MAX_BYTES];
    loop {
        if !goes_on() {
            return Err(TrackerError::Interrupted);
        }
        match stream.read(&mut buffer) {
            Ok(0) => return socket_error(place, next, Err(io::Error::from(ErrorKind::UnexpectedEof))),
            Ok(count) => {
                let items =
                    client.push(buffer.get(..count).unwrap_or_default()).map_err(|error: VrpnError| {
                        TrackerError::Unreadable { place: place.to_string(), what: error.to_string() }
                    })?;
                for item in items {
                    let pose = match item {
                        VrpnItem::Pose(pose) if pose.body == wish.body => pose,
                        VrpnItem::NotAPose { sensor } if u32::try_from(sensor) == Ok(wish.body) => {
                            let what = "its pose has NaN".to_owned();
                            return Err(NoTarget::NotAPose { body: wish.body, what }.into());
                        }
                        _ => continue,
                    };
                    heard = WallTime::now();
                    if let Some(target) =
                        estimator.push(&Frame { stamp: Some(pose.stamp), pose: Some(pose) })?
                    {
                        return Ok(target);
                    }
                }
            }
            Err(error) if would_block(&error) => {}
            Err(error) => return socket_error(place, next, Err(error)),
        }
        // A lost body just stops reporting.
        if heard.elapsed() >= FRAME_LIMIT {
            return Err(match estimator.frames() {
                0 => TrackerError::Silent { place: place.to_string() },
                seen => NoTarget::Lost { body: wish.body, seen, missing: 0 }.into(),
            });
        }
    }
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
