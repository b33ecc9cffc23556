//! Server side: a TCP port that behaves like socketcand in front of a bus.

use std::net::SocketAddr;

use protocol::text::socketcand::{Assembled, Assembler, Command, MESSAGE_MAX, Message};
use protocol::{Duration, Frame, Instant};

use crate::clock::Clock;
use crate::error::OpenError;
use crate::hub::{Action, Dialect, Hub, ServerOptions};

/// How long frames wait after the answer to `rawmode`.
///
/// python-can compares everything one `recv()` returns with `< ok >`, so a frame that arrives in the same read ends
/// its handshake with an error. Waiting lets the client read the answer alone; its first frame shows that it has
/// read it.
const RAWMODE_HOLD: Duration = Duration::from_millis(50);

/// Bytes outside of messages after which a connection that never opened a bus counts as another protocol and is
/// closed.
const FOREIGN_BYTES_MAX: u64 = 1024;

/// A socketcand server in front of a bus; see [`Hub`].
///
/// Time stamps in the text are Unix time, as with the reference server.
pub type Server = Hub<Socketcand>;

impl Server {
    /// Listens at `host:port` (port 0: any free one) as the bus `bus`. With a manual clock clients may ask for lock step.
    ///
    /// # Errors
    ///
    /// The host has no address, or the port is not available.
    pub fn listen(
        host: &str,
        port: u16,
        bus: &str,
        clock: Clock,
        options: ServerOptions,
    ) -> Result<Self, OpenError> {
        Self::at_port(host, port, clock, options, |address| {
            let in_step = clock.is_manual();
            let scheme = if in_step { "lockstep" } else { "socketcand" };
            (format!("{scheme}://{address}/{bus}"), Socketcand { bus: bus.to_owned(), address, in_step })
        })
    }

    /// The address clients connect to, with the real port.
    pub const fn local_addr(&self) -> SocketAddr {
        self.dialect().address
    }
}

/// Server side of the socketcand protocol.
pub struct Socketcand {
    bus: String,
    address: SocketAddr,
    /// Clients may request lock step: the owner moves the server's clock.
    in_step: bool,
}

pub struct Session {
    assembler: Assembler,
    mode: Mode,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// Connected, no bus opened yet.
    NoBus,
    /// Bus opened: may send, receives nothing (broadcast-manager mode without subscriptions).
    Silent,
    Raw,
}

impl Dialect for Socketcand {
    type Session = Session;

    fn greet(&self, act: &mut dyn FnMut(Action<'_>)) -> Session {
        answer(Message::Hi, act);
        Session { assembler: Assembler::new(), mode: Mode::NoBus }
    }

    fn crowded(&self, clients_max: usize) -> Vec<u8> {
        let reason = format!("too many clients, this server takes {clients_max}; end one and connect again");
        Message::Refused { reason: &reason }.encode().as_bytes().to_vec()
    }

    fn is_open(&self, session: &Session) -> bool {
        session.mode == Mode::Raw
    }

    fn take(&self, session: &mut Session, byte: u8, act: &mut dyn FnMut(Action<'_>)) {
        let Session { assembler, mode } = session;
        match assembler.push(byte) {
            Some(Assembled::Message(text)) => match Command::parse(text) {
                Ok(command) => self.obey(mode, command, act),
                Err(error) => {
                    act(Action::Malformed);
                    answer(Message::Refused { reason: &error.to_string() }, act);
                }
            },
            Some(Assembled::Overlong) => {
                act(Action::Malformed);
                let reason = format!("message longer than {MESSAGE_MAX} bytes");
                answer(Message::Refused { reason: &reason }, act);
            }
            None => {}
        }
        if *mode == Mode::NoBus && assembler.garbage_bytes() > FOREIGN_BYTES_MAX {
            act(Action::Leave("does not speak socketcand"));
        }
    }

    fn render(
        &self,
        session: &Session,
        _: Instant,
        unix: Instant,
        frame: &Frame,
        put: &mut dyn FnMut(&[u8]),
    ) {
        if session.mode == Mode::Raw {
            put(Message::Frame { at: unix, frame: *frame }.encode().as_bytes());
        }
    }

    fn render_bus_error(&self, session: &mut Session, unix: Instant, class: u32, put: &mut dyn FnMut(&[u8])) {
        if session.mode == Mode::Raw {
            put(Message::BusError { at: unix, class }.encode().as_bytes());
        }
    }

    fn render_turn(&self, now: Instant, put: &mut dyn FnMut(&[u8])) {
        put(Message::Time(now).encode().as_bytes());
    }

    fn note_loss(&self, _: &mut Session) {}
}

impl Socketcand {
    fn obey(&self, mode: &mut Mode, command: Command<'_>, act: &mut dyn FnMut(Action<'_>)) {
        match (*mode, command) {
            (_, Command::Echo) => answer(Message::Echo, act),
            (Mode::NoBus, Command::Open(name)) if name.as_str() == self.bus => {
                *mode = Mode::Silent;
                answer(Message::Ok, act);
            }
            (Mode::NoBus, Command::Open(name)) => {
                let reason = format!("could not open bus {name}, this server has {}", self.bus);
                answer(Message::Refused { reason: &reason }, act);
                act(Action::Leave("asked for another bus"));
            }
            (Mode::NoBus, Command::RawMode | Command::BcmMode | Command::Send(_)) => {
                answer(Message::Refused { reason: "open a bus first" }, act);
            }
            (Mode::Silent | Mode::Raw, Command::Open(_)) => {
                answer(Message::Refused { reason: "a bus is open already" }, act);
            }
            (Mode::Silent | Mode::Raw, Command::RawMode) => {
                answer(Message::Ok, act);
                *mode = Mode::Raw;
                act(Action::Hold(RAWMODE_HOLD));
            }
            (Mode::Raw, Command::LockStep) if self.in_step => act(Action::InStep),
            (Mode::Raw, Command::Wait { until, frames_from }) if self.in_step => {
                act(Action::Wait { until, frames_from });
            }
            (_, Command::LockStep | Command::Wait { .. }) => {
                let reason =
                    if self.in_step { "rawmode comes first" } else { "this server runs in real time" };
                answer(Message::Refused { reason }, act);
            }
            (Mode::Silent | Mode::Raw, Command::BcmMode) => {
                *mode = Mode::Silent;
                answer(Message::Ok, act);
            }
            (Mode::Silent | Mode::Raw, Command::Send(frame)) => act(Action::Frame(frame)),
        }
    }
}

fn answer(message: Message<'_>, act: &mut dyn FnMut(Action<'_>)) {
    act(Action::Answer(message.encode().as_bytes()));
}
