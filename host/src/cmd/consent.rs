//! The question before metal moves, for every verb.
//!
//! | verb | question |
//! |---|---|
//! | `throw`, `run`, `identify`, `catch --bus`, `rally --bus-thrower` | before the first motion; `throw` asks once more before the ball is thrown |
//! | `move`, `servo`, `teach` | before the first motion |
//! | `home`, `jog` | no question: the order names this one motion, at reduced speed, and `jog` moves only while a key is held or for the time given |
//!
//! The cell inside this program moves no metal and is never asked for. On every other bus `--yes` takes the place of the answer,
//! and without `--yes` a terminal is required; `--json` changes neither.

use std::io::{BufRead, IsTerminal, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::BusSpec;
use operator::job::Answer;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::error::ExpectedError;
use crate::exit;

/// Longest answer that is read.
const ANSWER_MAX_BYTES: u64 = 256;
/// Time between two looks at a signal, ns.
const LOOK_NS: i64 = 100_000_000;

/// Whether and how a person is asked.
#[derive(Clone, Debug, Default)]
pub struct Consent {
    asks: bool,
    /// The question under way.
    asked: Option<&'static str>,
}

impl Consent {
    /// For motion on `bus`. `yes`: the person has agreed already.
    ///
    /// # Errors
    /// [`exit::USAGE`] where a person must be asked and there is no terminal.
    pub fn on(bus: &BusSpec, yes: bool) -> Result<Self, ExpectedError> {
        let asks = !yes && *bus != BusSpec::Sim;
        if asks && !std::io::stdin().is_terminal() {
            let what = format!(
                "{bus}: this moves a real arm, and there is no terminal to ask whether it may; nothing has moved"
            );
            let next = "run it in a terminal, or add --yes if nobody is near the arm";
            return Err(ExpectedError::new(exit::USAGE, what).next(next));
        }
        Ok(Self { asks, asked: None })
    }

    /// Shows `question` once, and looks for the answer without waiting. Only an empty line is a yes.
    pub fn look(&mut self, question: &'static str) -> Answer {
        self.wait(question, 0)
    }

    /// Asks and waits for the answer; a person who has agreed is not asked again.
    ///
    /// # Errors
    /// [`exit::INTERRUPTED`] for any answer but Enter, and for a signal: `stop` is set by then.
    pub fn require(&mut self, question: &'static str, stop: &AtomicBool) -> Result<(), ExpectedError> {
        loop {
            match self.wait(question, LOOK_NS) {
                Answer::Waiting if !stop.load(Ordering::Relaxed) => {}
                Answer::Yes => {
                    self.asks = false;
                    return Ok(());
                }
                Answer::No | Answer::Waiting => {
                    return Err(ExpectedError::new(exit::INTERRUPTED, "not confirmed; nothing has moved"));
                }
            }
        }
    }

    fn wait(&mut self, question: &'static str, wait_ns: i64) -> Answer {
        if !self.asks {
            return Answer::Yes;
        }
        if self.asked != Some(question) {
            console::note_text!("{question}: Enter goes on, anything else ends: ");
            // A terminal that is gone gives no answer either.
            let _ = std::io::stderr().flush();
            self.asked = Some(question);
        }
        let stdin = std::io::stdin();
        let mut looked_at = [PollFd::new(&stdin, PollFlags::IN)];
        match poll(&mut looked_at, Some(&Timespec { tv_sec: 0, tv_nsec: wait_ns })) {
            Ok(0) | Err(rustix::io::Errno::INTR) => Answer::Waiting,
            Ok(_) => {
                self.asked = None;
                let mut answer = String::new();
                let read = stdin.lock().take(ANSWER_MAX_BYTES).read_line(&mut answer);
                if matches!(read, Ok(n) if n > 0 && answer.trim().is_empty()) {
                    Answer::Yes
                } else {
                    Answer::No
                }
            }
            Err(_) => Answer::No,
        }
    }
}
