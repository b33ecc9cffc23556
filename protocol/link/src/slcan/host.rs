//! The host's side: a bus behind an SLCAN adapter.

use std::path::Path;

use protocol::text::slcan::{Assembled, Assembler, Bitrate, Command, Reply};
use protocol::{Duration, Frame};

use crate::clock::Clock;
use crate::error::OpenError;
use crate::net::dial;
use crate::serial::open_device;
use crate::spec::host_port;
use crate::station::{Heard, Speech, Station};
use crate::stream::Stream;

/// How long answers of an earlier session may straggle in before ours begins.
const SETTLE: Duration = Duration::from_millis(100);

/// For the answer to one command; adapters need some milliseconds, a busy machine more.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// A bus behind an SLCAN adapter; see [`Station`].
///
/// A BELL for a frame counts as [`crate::LinkStats::refused_out`]. Bus errors are not reported: the
/// protocol only lets a host ask for status flags. Dropping the link closes the channel.
pub type Host = Station<Slcan>;

/// Host side of the SLCAN protocol.
pub struct Slcan {
    assembler: Assembler,
    /// Commands carried out and commands refused, since the last question.
    done: u32,
    refused: u32,
}

impl Host {
    /// Opens the adapter at a serial device; `baud` is the speed of the line, `None` leaves it.
    ///
    /// # Errors
    ///
    /// The device cannot be opened, does not answer as an adapter, or refuses the bit rate.
    pub fn open_device(
        path: &Path,
        baud: Option<u32>,
        bitrate: Bitrate,
        clock: Clock,
    ) -> Result<Self, OpenError> {
        let place = path.display().to_string();
        Self::start(open_device(path, baud)?, format!("slcan:{place}"), place, bitrate, clock)
    }

    /// Opens the adapter behind a TCP port.
    ///
    /// # Errors
    ///
    /// Nothing listens there, it does not answer as an adapter, or it refuses the bit rate.
    pub fn connect(host: &str, port: u16, bitrate: Bitrate, clock: Clock) -> Result<Self, OpenError> {
        let place = host_port(host, port);
        let name = format!("slcan://{place}");
        Self::start(dial(host, port, &name)?, name, place, bitrate, clock)
    }

    fn start(
        stream: Stream,
        name: String,
        place: String,
        bitrate: Bitrate,
        clock: Clock,
    ) -> Result<Self, OpenError> {
        let setup = |source| OpenError::Setup { what: "waiting", address: place.clone(), source };
        let speech = Slcan { assembler: Assembler::new(), done: 0, refused: 0 };
        let mut host = Self::new(name, stream, speech, clock);
        // End any line that the adapter has half read, and close a channel that was left open.
        host.say(b"\r\r\rC\r");
        host.work_for(SETTLE, |_| false).map_err(setup)?;
        for command in [Command::SetBitrate(bitrate), Command::Open] {
            host.forget();
            let speech = host.speech();
            (speech.done, speech.refused) = (0, 0);
            host.say(command.encode().as_bytes());
            let answered = |speech: &Slcan| speech.done + speech.refused > 0;
            let in_time = host.work_for(ANSWER_TIMEOUT, answered).map_err(setup)?;
            let line = command.encode();
            let line = line.as_str().trim_end();
            if !in_time {
                let found = match host.failure() {
                    Some(error) => error.to_string(),
                    None => format!("no answer to '{line}' within {ANSWER_TIMEOUT}"),
                };
                return Err(OpenError::Protocol { address: place, protocol: "SLCAN", found });
            }
            if host.speech().refused > 0 {
                let bus = format!("{} bit/s", bitrate.bits_per_second());
                let reason = format!("'{line}' was answered with BELL");
                return Err(OpenError::Refused { address: place, bus, reason });
            }
        }
        Ok(host)
    }
}

impl Speech for Slcan {
    fn take(&mut self, byte: u8, hear: &mut dyn FnMut(Heard)) {
        let reply = match self.assembler.push(byte) {
            None => return,
            Some(Assembled::Overlong) => return hear(Heard::Malformed),
            Some(Assembled::Bell) => Ok(Reply::Refused),
            Some(Assembled::Line(line)) => Reply::parse(line),
        };
        match reply {
            Ok(Reply::Frame { frame, .. }) => hear(Heard::Frame(frame, None)),
            Ok(Reply::Done | Reply::Taken { .. }) => self.done = self.done.saturating_add(1),
            Ok(Reply::Refused) => {
                self.refused = self.refused.saturating_add(1);
                hear(Heard::Refused);
            }
            Ok(Reply::Status(_) | Reply::Version(_) | Reply::Serial(_)) => {}
            Err(_) => hear(Heard::Malformed),
        }
    }

    fn render(&self, frame: &Frame, put: &mut dyn FnMut(&[u8])) {
        put(Command::Send(*frame).encode().as_bytes());
    }

    fn farewell(&self) -> &'static [u8] {
        b"C\r"
    }
}
