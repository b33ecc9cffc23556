//! The adapter's side: a bus of ours behind a serial line or a TCP port.

use std::path::{Path, PathBuf};

use protocol::text::slcan::{Assembled, Assembler, Bitrate, Command, Reply, TIMESTAMP_PERIOD_MS};
use protocol::{Frame, Instant};

use crate::clock::Clock;
use crate::error::OpenError;
use crate::hub::{Action, Dialect, Hub, ServerOptions};
use crate::net::dial;
use crate::serial::{open_device, open_pty};
use crate::spec::host_port;

/// Version of hardware and software that `V` reports.
const VERSION: &str = "1013";
/// Serial number that `N` reports.
const SERIAL: &str = "SIM0";

/// Status flag: received frames were lost.
const FLAG_RX_FULL: u8 = 1 << 0;
/// Status flag: errors on the bus.
const FLAG_BUS_ERROR: u8 = 1 << 7;

/// An SLCAN adapter in front of a bus of this program; see [`Hub`]. Every peer has an adapter of its own, all of
/// them on the same bus.
///
/// The bus has one bit rate: `S` with another one is refused with BELL, as are timing registers (`s`)
/// and acceptance filters (`M`, `m`) other than "everything". A frame is acknowledged with `z` or `Z`
/// when it is taken, not when it was on the bus.
pub type Adapter = Hub<Slcan>;

/// Server side of the SLCAN protocol.
pub struct Slcan {
    bitrate: Bitrate,
    /// The far end of the pseudo-terminal, if there is one.
    pty: Option<PathBuf>,
}

pub struct Session {
    assembler: Assembler,
    channel: Channel,
    timestamps: bool,
    flags: u8,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Channel {
    Closed,
    Open,
    ListenOnly,
}

impl Adapter {
    /// Waits for hosts at `host:port` (port 0: any free one, see [`Hub`]'s name).
    ///
    /// # Errors
    ///
    /// The host has no address, or the port is not available.
    pub fn listen(
        host: &str,
        port: u16,
        bitrate: Bitrate,
        clock: Clock,
        options: ServerOptions,
    ) -> Result<Self, OpenError> {
        Self::at_port(host, port, clock, options, |address| {
            (format!("slcan://{address}"), Slcan { bitrate, pty: None })
        })
    }

    /// Connects to a host that listens, such as the UART of an emulated board.
    ///
    /// # Errors
    ///
    /// Nothing listens there.
    pub fn connect(host: &str, port: u16, bitrate: Bitrate, clock: Clock) -> Result<Self, OpenError> {
        let name = format!("slcan://{}", host_port(host, port));
        let stream = dial(host, port, &name)?;
        Ok(Self::at_stream(name, stream, Slcan { bitrate, pty: None }, clock))
    }

    /// Serves the host at the other end of a serial device; `baud` is the speed of the line.
    ///
    /// # Errors
    ///
    /// The device cannot be opened.
    pub fn at_device(
        path: &Path,
        baud: Option<u32>,
        bitrate: Bitrate,
        clock: Clock,
    ) -> Result<Self, OpenError> {
        let stream = open_device(path, baud)?;
        Ok(Self::at_stream(format!("slcan:{}", path.display()), stream, Slcan { bitrate, pty: None }, clock))
    }

    /// Makes a pseudo-terminal; hosts open its far end ([`Self::pty_path`]) like a serial device.
    ///
    /// # Errors
    ///
    /// The system has no free pseudo-terminal.
    pub fn at_pty(bitrate: Bitrate, clock: Clock) -> Result<Self, OpenError> {
        let (stream, path) = open_pty().map_err(|source| OpenError::Setup {
            what: "a pseudo-terminal",
            address: "slcan".to_owned(),
            source,
        })?;
        let name = format!("slcan:{}", path.display());
        Ok(Self::at_stream(name, stream, Slcan { bitrate, pty: Some(path) }, clock))
    }

    /// The far end of the pseudo-terminal of [`Self::at_pty`].
    pub fn pty_path(&self) -> Option<&Path> {
        self.dialect().pty.as_deref()
    }
}

impl Dialect for Slcan {
    type Session = Session;

    fn greet(&self, _: &mut dyn FnMut(Action<'_>)) -> Session {
        Session { assembler: Assembler::new(), channel: Channel::Closed, timestamps: false, flags: 0 }
    }

    fn crowded(&self, _: usize) -> Vec<u8> {
        Reply::Refused.encode().as_bytes().to_vec()
    }

    fn is_open(&self, session: &Session) -> bool {
        session.channel != Channel::Closed
    }

    fn take(&self, session: &mut Session, byte: u8, act: &mut dyn FnMut(Action<'_>)) {
        let command = match session.assembler.push(byte) {
            None | Some(Assembled::Bell) => return,
            Some(Assembled::Overlong) => None,
            Some(Assembled::Line(line)) => Command::parse(line).ok(),
        };
        let reply = match command {
            Some(command) => self.obey(session, command, act),
            None => {
                act(Action::Malformed);
                Reply::Refused
            }
        };
        act(Action::Answer(reply.encode().as_bytes()));
    }

    fn render(&self, session: &Session, at: Instant, _: Instant, frame: &Frame, put: &mut dyn FnMut(&[u8])) {
        if session.channel != Channel::Closed {
            let ms = at.as_micros() / 1000 % u64::from(TIMESTAMP_PERIOD_MS);
            let timestamp_ms = session.timestamps.then_some(ms as u16);
            put(Reply::Frame { frame: *frame, timestamp_ms }.encode().as_bytes());
        }
    }

    fn render_bus_error(&self, session: &mut Session, _: Instant, _: u32, _: &mut dyn FnMut(&[u8])) {
        session.flags |= FLAG_BUS_ERROR;
    }

    fn note_loss(&self, session: &mut Session) {
        session.flags |= FLAG_RX_FULL;
    }
}

impl Slcan {
    fn obey(
        &self,
        session: &mut Session,
        command: Command,
        act: &mut dyn FnMut(Action<'_>),
    ) -> Reply<'static> {
        let done = |allowed: bool| if allowed { Reply::Done } else { Reply::Refused };
        match (session.channel, command) {
            (_, Command::Nothing) => Reply::Done,
            (_, Command::ReadVersion) => Reply::Version(VERSION),
            (_, Command::ReadSerial) => Reply::Serial(SERIAL),
            (Channel::Closed, Command::SetBitrate(bitrate)) => done(bitrate == self.bitrate),
            (Channel::Closed, Command::Open) => {
                session.channel = Channel::Open;
                Reply::Done
            }
            (Channel::Closed, Command::OpenListenOnly) => {
                session.channel = Channel::ListenOnly;
                Reply::Done
            }
            (Channel::Closed, Command::Timestamps(on)) => {
                session.timestamps = on;
                Reply::Done
            }
            (Channel::Closed, Command::AcceptanceCode(code)) => done(code == 0),
            (Channel::Closed, Command::AcceptanceMask(mask)) => done(mask == u32::MAX),
            (Channel::Open | Channel::ListenOnly, Command::Close) => {
                session.channel = Channel::Closed;
                Reply::Done
            }
            (Channel::Open | Channel::ListenOnly, Command::ReadStatus) => {
                Reply::Status(std::mem::take(&mut session.flags))
            }
            (Channel::Open, Command::Send(frame)) => {
                act(Action::Frame(frame));
                Reply::Taken { extended: frame.is_extended() }
            }
            (
                Channel::Closed,
                Command::Close | Command::ReadStatus | Command::Send(_) | Command::SetTiming(_),
            )
            | (
                Channel::Open | Channel::ListenOnly,
                Command::SetBitrate(_)
                | Command::SetTiming(_)
                | Command::Open
                | Command::OpenListenOnly
                | Command::Timestamps(_)
                | Command::AcceptanceCode(_)
                | Command::AcceptanceMask(_),
            )
            | (Channel::ListenOnly, Command::Send(_)) => Reply::Refused,
        }
    }
}
