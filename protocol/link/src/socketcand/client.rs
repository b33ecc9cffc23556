//! Client side: a bus behind a socketcand server.

use protocol::text::BusName;
use protocol::text::socketcand::{Assembled, Assembler, Command, Message};
use protocol::{Duration, Frame, Instant};

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::OpenError;
use crate::link::CanLink;
use crate::net::dial;
use crate::spec::host_port;
use crate::station::{Heard, Speech, Station};

/// For each answer of the handshake. If a server does not answer, it is another program, or hangs.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(10);

/// A connection in raw mode to one bus of a socketcand server; see [`Station`].
///
/// The time stamp of a received frame is the server's time, usually Unix time.
pub type Client = Station<Socketcand>;

/// Client side of the socketcand protocol.
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
    Turns,
}

impl Client {
    /// Connects, opens `bus` and switches to raw mode; takes at most some seconds.
    ///
    /// # Errors
    ///
    /// The host has no address, nothing listens there, it is not a socketcand server, or the server does not have
    /// the bus.
    pub fn connect(host: &str, port: u16, bus: BusName<'_>, clock: Clock) -> Result<Self, OpenError> {
        let address = host_port(host, port);
        let name = format!("socketcand://{address}/{bus}");
        let stream = dial(host, port, &name)?;
        let speech = Socketcand { assembler: Assembler::new(), step: Step::Start, refusal: None };
        let mut client = Self::new(name, stream, speech, clock);
        for (question, step, wanted) in [
            (None, Step::Greeted, "the greeting"),
            (Some(Command::Open(bus)), Step::Opened, "the answer to open"),
            (Some(Command::RawMode), Step::Raw, "the answer to rawmode"),
        ] {
            client.ask(question, step, wanted, &address, bus.as_str())?;
        }
        Ok(client)
    }

    /// Requests lock step from the server: from now on `clock`, which must be manual, shows the server's virtual
    /// time, and that time waits for this client.
    ///
    /// # Errors
    ///
    /// The server runs in real time.
    pub fn in_step(mut self) -> Result<Self, OpenError> {
        self.keep_in_step();
        let address = CanLink::name(&self).to_owned();
        self.ask(Some(Command::LockStep), Step::Turns, "the first turn", &address, "in lock step")?;
        Ok(self)
    }

    /// Sends `question` and waits until the handshake is at `step`.
    fn ask(
        &mut self,
        question: Option<Command<'_>>,
        step: Step,
        wanted: &str,
        address: &str,
        bus: &str,
    ) -> Result<(), OpenError> {
        if let Some(question) = question {
            self.say(question.encode().as_bytes());
        }
        let done = |speech: &Socketcand| speech.step >= step || speech.refusal.is_some();
        let in_time = self.work_for(HANDSHAKE_TIMEOUT, done).map_err(|source| OpenError::Setup {
            what: "waiting",
            address: address.to_owned(),
            source,
        })?;
        let address = address.to_owned();
        if let Some(reason) = self.speech().refusal.take() {
            return Err(OpenError::Refused { address, bus: bus.to_owned(), reason });
        }
        if !in_time {
            let found = match self.failure() {
                Some(error) => error.to_string(),
                None => format!("no answer within {HANDSHAKE_TIMEOUT} while waiting for {wanted}"),
            };
            return Err(OpenError::Protocol { address, protocol: "socketcand", found });
        }
        Ok(())
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
            (_, Ok(Message::BusError { at, class })) => {
                hear(Heard::BusError(BusError::from_class(class), Some(at)));
            }
            (_, Ok(Message::Refused { reason })) => {
                self.refusal = Some(reason.to_owned());
                hear(Heard::Refused);
            }
            (Step::Start, Ok(Message::Hi)) => self.step = Step::Greeted,
            (Step::Greeted, Ok(Message::Ok)) => self.step = Step::Opened,
            (Step::Opened, Ok(Message::Ok)) => self.step = Step::Raw,
            (_, Ok(Message::Time(now))) => {
                self.step = Step::Turns;
                hear(Heard::Turn(now));
            }
            (_, Ok(Message::Hi | Message::Ok | Message::Echo)) => {}
            (_, Err(_)) => hear(Heard::Malformed),
        }
    }

    fn render(&self, frame: &Frame, put: &mut dyn FnMut(&[u8])) {
        put(Command::Send(*frame).encode().as_bytes());
    }

    fn end_turn(&self, until: Instant, frames_from: Instant, put: &mut dyn FnMut(&[u8])) {
        put(Command::Wait { until, frames_from }.encode().as_bytes());
    }
}
