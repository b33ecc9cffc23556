//! Client side: a bus behind a socketcand server.

use protocol::text::BusName;
use protocol::text::socketcand::{Assembled, Assembler, Command, Message};
use protocol::{Duration, Frame};

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::OpenError;
use crate::net::{dial, host_port};
use crate::station::{Heard, Speech, Station};
use crate::stream::Stream;

/// From the connection to the last `< ok >`.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(3);

/// A connection in raw mode to one bus of a socketcand server; see [`Station`].
///
/// The time stamp of a received frame is the server's time, usually Unix time.
pub type Client = Station<Socketcand>;

/// What a socketcand client says.
pub struct Socketcand {
    assembler: Assembler,
    step: Step,
    /// Words of the server's last refusal.
    refusal: Option<String>,
}

/// How far the handshake is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    Start,
    Greeted,
    Opened,
    Raw,
}

impl Client {
    /// Connects, opens `bus` and switches to raw mode; takes at most some seconds.
    ///
    /// # Errors
    ///
    /// The host has no address, nothing listens there, it is no socketcand server, or the server
    /// does not have the bus.
    pub fn connect(host: &str, port: u16, bus: BusName<'_>, clock: Clock) -> Result<Self, OpenError> {
        let address = host_port(host, port);
        let name = format!("socketcand://{address}/{bus}");
        let setup = |what| {
            let address = address.clone();
            move |source| OpenError::Setup { what, address, source }
        };
        let stream = Stream::tcp(dial(host, port, &name)?).map_err(setup("the connection"))?;
        let speech = Socketcand { assembler: Assembler::new(), step: Step::Start, refusal: None };
        let mut client = Self::new(name, stream, speech, clock);
        let until = clock.now() + HANDSHAKE_TIMEOUT;
        for (question, step, wanted) in [
            (None, Step::Greeted, "the greeting"),
            (Some(Command::Open(bus)), Step::Opened, "the answer to open"),
            (Some(Command::RawMode), Step::Raw, "the answer to rawmode"),
        ] {
            if let Some(question) = question {
                client.say(question.encode().as_bytes());
            }
            let done = |speech: &Socketcand| speech.step >= step || speech.refusal.is_some();
            let in_time = client.work_until(until, done).map_err(setup("waiting"))?;
            let address = address.clone();
            if let Some(reason) = client.speech().refusal.take() {
                return Err(OpenError::Refused { address, bus: bus.to_string(), reason });
            }
            if !in_time {
                let found = match client.failure() {
                    Some(error) => error.to_string(),
                    None => format!("no answer within {HANDSHAKE_TIMEOUT} while waiting for {wanted}"),
                };
                return Err(OpenError::Protocol { address, protocol: "socketcand", found });
            }
        }
        Ok(client)
    }

    /// Words of the server's last refusal of something this client sent.
    pub fn last_refusal(&mut self) -> Option<&str> {
        self.speech().refusal.as_deref()
    }
}

impl Speech for Socketcand {
    fn take(&mut self, byte: u8, hear: &mut dyn FnMut(Heard)) {
        let message = match self.assembler.push(byte) {
            None => return,
            Some(Assembled::Overlong) => return hear(Heard::Malformed),
            Some(Assembled::Message(text)) => Message::parse(text),
        };
        match (self.step, message) {
            (_, Ok(Message::Frame { at, frame })) => hear(Heard::Frame(frame, Some(at))),
            (_, Ok(Message::BusError { class, .. })) => hear(Heard::BusError(BusError::from_class(class))),
            (_, Ok(Message::Refused { reason })) => {
                self.refusal = Some(reason.to_owned());
                hear(Heard::Refused);
            }
            (Step::Start, Ok(Message::Hi)) => self.step = Step::Greeted,
            (Step::Greeted, Ok(Message::Ok)) => self.step = Step::Opened,
            (Step::Opened, Ok(Message::Ok)) => self.step = Step::Raw,
            (_, Ok(Message::Hi | Message::Ok | Message::Echo)) => {}
            (_, Err(_)) => hear(Heard::Malformed),
        }
    }

    fn render(&self, frame: &Frame, put: &mut dyn FnMut(&[u8])) {
        put(Command::Send(*frame).encode().as_bytes());
    }
}
