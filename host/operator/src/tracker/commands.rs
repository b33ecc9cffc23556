//! The command channel of DTrack: a measurement that this program starts and stops.

use std::io::{self, ErrorKind, Read, Write};

use tracker_protocol::dtrack::{Answer, Command, Messages};

#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// The stream failed, or an answer did not come in time.
    #[error(transparent)]
    Stream(#[from] io::Error),
    /// An answer is not valid.
    #[error("\"{0}\" is not an answer to a command")]
    Unreadable(String),
    #[error("the tracker answers \"{answer}\" to \"{command}\"")]
    Refused {
        /// Request.
        command: String,
        answer: String,
    },
}

/// A measurement that sends its data to this machine.
#[derive(Debug)]
pub struct Tracking<S> {
    stream: S,
    messages: Messages,
    waiting: Vec<String>,
    started: bool,
}

impl<S: Read + Write> Tracking<S> {
    /// Orders the tracker to measure, and to send channel 1 to port `data_port` of this machine.
    ///
    /// # Errors
    /// [`CommandError`], for example when another program uses the tracker.
    pub fn start(stream: S, data_port: u16) -> Result<Self, CommandError> {
        let mut this = Self { stream, messages: Messages::default(), waiting: Vec::new(), started: false };
        let access = Command::GetAccess.to_string();
        let answer = this.ask(&access)?;
        if answer.value_of("system access") != Some("full") {
            return Err(CommandError::Refused { command: access, answer: answer.to_string() });
        }
        this.order(&format!("dtrack2 set output net ch01 udp my_ip {data_port}"))?;
        this.order("dtrack2 set output active ch01 all yes")?;
        // A tracker that measures already is left at it.
        if this.ask(&Command::GetStatus.to_string())?.value_of("status active") != Some("mea") {
            this.order("dtrack2 tracking start")?;
            this.started = true;
        }
        Ok(this)
    }

    /// Ends the measurement if it is ours. Nothing depends on the answer.
    pub fn stop(mut self) {
        if self.started {
            let _ = self.ask("dtrack2 tracking stop");
        }
    }

    fn order(&mut self, command: &str) -> Result<(), CommandError> {
        match self.ask(command)? {
            Answer::Ok => Ok(()),
            answer => Err(CommandError::Refused { command: command.to_owned(), answer: answer.to_string() }),
        }
    }

    fn ask(&mut self, command: &str) -> Result<Answer, CommandError> {
        self.stream.write_all(&Messages::frame(&command))?;
        let mut buffer = [0; 1024];
        loop {
            if let Some(text) = (!self.waiting.is_empty()).then(|| self.waiting.remove(0)) {
                return Answer::parse(&text).ok_or(CommandError::Unreadable(text));
            }
            let count = self.stream.read(&mut buffer)?;
            if count == 0 {
                return Err(io::Error::from(ErrorKind::UnexpectedEof).into());
            }
            let read = self.messages.push(buffer.get(..count).unwrap_or_default());
            self.waiting.extend(read.into_iter().flatten());
        }
    }
}
