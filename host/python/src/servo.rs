//! A stream of commands to a connected arm.
//!
//! The thread of the arm follows it. On a real bus time passes by itself. A simulated cell waits for what comes next: its time passes
//! while [`Stream::wait`] is called.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration as WallTime;

use host::cmd::servo::{found, limit_text, parse};
use host::error::ExpectedError;
use operator::servo::{Keeps, Next, Stream as Commands, follow};
use planner::servo::{Command, Limited, Refused, Servo};
use protocol::Duration;
use pyo3::prelude::*;
use serde_json::json;

use crate::arm::{Arm, Connected, How, LOOK, lost};
use crate::errors::{bad, refused};

/// What a program says to a stream.
enum Said {
    Command(Command),
    /// Time may pass, s; the answer comes when it has.
    Pass(f64, SyncSender<()>),
    End,
}

/// A stream under way, from `Arm.servo`.
#[pyclass]
pub(crate) struct Stream {
    said: Option<Sender<Said>>,
    ended: Mutex<Option<Receiver<Result<String, ExpectedError>>>>,
    newest: Arc<Mutex<String>>,
    is_simulated: bool,
}

/// The same, as the thread of the arm sees it.
struct Heard {
    said: Receiver<Said>,
    newest: Arc<Mutex<String>>,
    is_simulated: bool,
    /// Until when time may pass in a simulated cell, s, and who waits for it.
    until_s: f64,
    waiting: Option<SyncSender<()>>,
    refused: u64,
    last: Option<String>,
    ends: bool,
}

impl Commands for Heard {
    fn next(&mut self, t_s: f64) -> Next {
        loop {
            if self.ends {
                return Next::End;
            }
            let is_due = self.is_simulated && t_s >= self.until_s;
            if is_due && let Some(waiting) = self.waiting.take() {
                // Who waited may be gone.
                let _ = waiting.send(());
            }
            let said = if is_due { self.said.recv().ok() } else { self.said.try_recv().ok() };
            match said {
                Some(Said::Command(command)) => return Next::Command(command),
                Some(Said::Pass(span_s, waiting)) => {
                    (self.until_s, self.waiting) = (t_s.max(self.until_s) + span_s, Some(waiting));
                }
                Some(Said::End) => self.ends = true,
                // The program has ended and sends no more points.
                None if is_due => self.ends = true,
                None => return Next::Nothing,
            }
        }
    }

    fn refused(&mut self, _t_s: f64, why: Refused) {
        self.refused += 1;
        self.last = Some(why.to_string());
    }

    fn ticked(&mut self, t_s: f64, servo: &Servo<'_>, limited: Option<&Limited>) {
        let state = servo.state();
        let text = json!({
            "t_s": t_s,
            "q_rad": state.iter().map(|joint| joint.q_rad).collect::<Vec<_>>(),
            "qd_rad_s": state.iter().map(|joint| joint.qd_rad_s).collect::<Vec<_>>(),
            "limited": limited.map(limit_text),
            "refused": self.refused,
            "last_refused": self.last,
        });
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = text.to_string();
    }
}

impl Connected<'_> {
    fn stream(&mut self, how: &How, hold_s: f64, heard: &mut Heard) -> Result<String, ExpectedError> {
        self.ready(false)?;
        self.arm.forget_end();
        let (robot, keeps) = (
            self.arm.robot,
            Keeps {
                share: how.speed_share(),
                v_max_rad_s: f64::INFINITY,
                hold: Duration::from_secs_f64(hold_s),
                scene: how.scene(),
            },
        );
        let streamed =
            follow(self.arm.operator, robot, &keeps, heard).map_err(|error| ExpectedError::from(&error))?;
        if streamed.interrupted {
            return Err(ExpectedError::new(host::exit::INTERRUPTED, "stopped; the arm stands"));
        }
        Ok(found(&streamed, heard.refused).to_string())
    }
}

/// An arm follows a stream of commands from now on.
#[pyfunction]
pub(crate) fn servo(arm: &Arm, how: How, hold_s: f64) -> PyResult<Stream> {
    let (said, heard) = channel();
    let (answer, ended) = sync_channel(1);
    let newest = Arc::new(Mutex::new(String::new()));
    let is_simulated = arm.is_simulated();
    let mut heard = Heard {
        said: heard,
        newest: Arc::clone(&newest),
        is_simulated,
        until_s: 0.0,
        waiting: None,
        refused: 0,
        last: None,
        ends: false,
    };
    arm.begin(Box::new(move |arm| arm.stream(&how, hold_s, &mut heard)), answer)?;
    Ok(Stream { said: Some(said), ended: Mutex::new(Some(ended)), newest, is_simulated })
}

#[pymethods]
impl Stream {
    /// A line as `cubectl servo` takes it, without a time.
    fn send(&self, line: &str) -> PyResult<()> {
        match parse(line) {
            Ok((None, command)) => self.say(Said::Command(command)),
            Ok((Some(_), _)) => Err(bad(&"a command of a connected arm is for now, and has no time")),
            Err(what) => Err(bad(&what)),
        }
    }

    /// Lets time pass, s.
    fn wait(&self, py: Python<'_>, span_s: f64) -> PyResult<()> {
        let span = WallTime::try_from_secs_f64(span_s).map_err(|error| bad(&error.to_string()))?;
        if !self.is_simulated {
            py.detach(|| std::thread::sleep(span));
            return py.check_signals();
        }
        let (waiting, mut passed) = sync_channel(1);
        self.say(Said::Pass(span_s, waiting))?;
        loop {
            let passing = &mut passed;
            match py.detach(move || passing.recv_timeout(LOOK)) {
                // A stream that has ended says so at its end.
                Ok(()) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            }
        }
    }

    /// The newest state as JSON; empty before the first.
    fn state(&self) -> String {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Ends the stream, waits until the arm stands, and gives what became of it.
    fn end(&mut self, py: Python<'_>) -> PyResult<String> {
        if let Some(said) = self.said.take() {
            // A stream that has ended by itself hears nothing.
            let _ = said.send(Said::End);
        }
        let ended = self.ended.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        let mut ended = ended.ok_or_else(|| bad(&"the stream has ended"))?;
        let waiting = &mut ended;
        let outcome = py.detach(move || waiting.recv());
        outcome.unwrap_or_else(|_| Err(lost())).map_err(|error| refused(&error))
    }
}

impl Stream {
    fn say(&self, said: Said) -> PyResult<()> {
        let sender = self.said.as_ref().ok_or_else(|| bad(&"the stream has ended"))?;
        sender.send(said).map_err(|_| bad(&"the stream has ended; its end says why"))
    }
}
