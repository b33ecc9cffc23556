//! A log's requests against the drives of today: do they still answer the same?
//!
//! Everything in the log that a module did not send is put on the simulated bus again, each frame started so early
//! that it ends when the log says. What the modules answer is compared with what they answered then, module by
//! module in order.

use std::collections::VecDeque;
use std::fmt;
use std::path::Path;

use protocol::powercube::{Address, Channel};
use protocol::text::candump::{ParseError, Record};
use protocol::{Duration, Frame, Instant, ModuleId, Node, bits};

use crate::participants::Solo;
use crate::record::Trace;
use crate::scenario::{BuildError, Scenario};
use crate::world::RunError;

/// Unix times are beyond this, times of simulations before it.
const UNIX_FROM: Duration = Duration::from_secs(100_000_000);
/// A log of Unix times begins this long after time 0.
const LEAD_IN: Duration = Duration::from_millis(1);
/// Time for the last answers.
const LEAD_OUT: Duration = Duration::from_millis(500);
/// Frames kept for the comparison.
const TRACE_MAX: usize = 50_000_000;
/// Longest log that is read, bytes.
const LOG_MAX_BYTES: u64 = 1 << 30;

/// A log was refused.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file could not be read.
    #[error("{file}: cannot read the log: {error}")]
    Unreadable {
        /// Name of the file, as the caller gave it.
        file: String,
        /// The system's answer.
        error: std::io::Error,
    },
    /// A line is no candump record.
    #[error("{file}:{line}: {reason}; expected a line like (0000000001.000123) can0 0A5#084F64")]
    Line {
        /// Name of the file, as the caller gave it.
        file: String,
        /// From 1.
        line: usize,
        reason: String,
    },
    /// Nothing to replay.
    #[error("{file}: no request in the log; it needs frames to modules (ids 0C1 to 0DF, 0E1 to 0FF, 100)")]
    NoRequests {
        /// Name of the file, as the caller gave it.
        file: String,
    },
}

/// Frames of a log with their times, moved so that the log begins near time 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Log {
    /// In the order of the file.
    pub frames: Vec<(Instant, Frame)>,
    /// Error frames, CAN FD frames and a last line without its end, which were left out.
    pub left_out: usize,
}

impl Log {
    /// Reads a candump file.
    pub fn load(path: &Path) -> Result<Self, LogError> {
        let file = path.display().to_string();
        let text = toml_reader::read_bytes(path, LOG_MAX_BYTES)
            .map_err(|error| LogError::Unreadable { file: file.clone(), error })?;
        Self::parse(&file, &text)
    }

    /// Reads a candump text; empty lines and lines that begin with `#` are skipped.
    pub fn parse(file: &str, text: &[u8]) -> Result<Self, LogError> {
        let mut frames = Vec::new();
        let mut left_out = 0;
        let mut lines = text.split(|byte| *byte == b'\n').enumerate().peekable();
        while let Some((index, line)) = lines.next() {
            let line = line.trim_ascii();
            if line.is_empty() || line.starts_with(b"#") {
                continue;
            }
            match Record::parse(line) {
                Ok(record) => frames.push((record.at, record.frame)),
                Err(ParseError::NotADataFrame { .. } | ParseError::CanFd { .. }) => left_out += 1,
                // The last line of a log that was cut off.
                Err(_) if lines.peek().is_none() => left_out += 1,
                Err(error) => {
                    let reason = error.to_string();
                    return Err(LogError::Line { file: file.to_owned(), line: index + 1, reason });
                }
            }
        }
        if !frames.iter().any(|(_, frame)| is_request(frame)) {
            return Err(LogError::NoRequests { file: file.to_owned() });
        }
        let first = frames.first().map_or(Instant::ZERO, |(at, _)| *at);
        if first >= Instant::ZERO + UNIX_FROM {
            for (at, _) in &mut frames {
                *at = Instant::ZERO + LEAD_IN + at.saturating_since(first);
            }
        }
        Ok(Self { frames, left_out })
    }
}

fn is_request(frame: &Frame) -> bool {
    matches!(
        Address::of(frame.id()),
        Some(Address::Broadcast | Address::Module(Channel::Get | Channel::Put, _))
    )
}

/// The module that sent a frame, if one did.
fn answerer(frame: &Frame) -> Option<ModuleId> {
    match Address::of(frame.id()) {
        Some(Address::Module(Channel::Ack | Channel::State, module)) => Some(module),
        _ => None,
    }
}

/// Sends frames at given times.
#[derive(Clone, Debug)]
struct Player {
    frames: VecDeque<(Instant, Frame)>,
    out: VecDeque<Frame>,
}

impl Node for Player {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}

    fn handle_timeout(&mut self, now: Instant) {
        if self.frames.front().is_some_and(|(at, _)| *at <= now)
            && let Some((_, frame)) = self.frames.pop_front()
        {
            self.out.push_back(frame);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.frames.front().map(|(at, _)| *at)
    }
}

/// How exactly answers must agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compare {
    /// Every byte.
    #[default]
    Bytes,
    /// Id, length, command and parameter; values may differ.
    Form,
}

/// Where log and replay part.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Difference {
    /// Module.
    pub module: u8,
    /// Number of the answer of this module, from 1.
    pub answer: usize,
    /// Time in the log, or in the replay if the log has no such answer; microseconds.
    pub at_us: u64,
    /// In the log.
    pub logged: Option<String>,
    pub replayed: Option<String>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "nothing".to_owned());
        write!(
            f,
            "module {}, answer {} at {} s: log has {}, replay {}",
            self.module,
            self.answer,
            Instant::from_micros(self.at_us),
            text(&self.logged),
            text(&self.replayed)
        )
    }
}

/// What a replay showed.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Outcome {
    /// Frames put on the bus again.
    pub sent: usize,
    /// Answers in the log.
    pub logged: usize,
    /// Answers in the replay.
    pub replayed: usize,
    /// Answers that agree.
    pub agreed: usize,
    /// Largest difference in time of answers that agree, microseconds.
    pub time_difference_max_us: u64,
    /// The earliest difference.
    pub first_difference: Option<Difference>,
}

/// Why a replay could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// No cell.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// A node broke its contract.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Plays a log against the cell of a scenario. Its actions are left out, its faults act.
pub fn replay(scenario: &Scenario, log: &Log, compare: Compare) -> Result<Outcome, ReplayError> {
    let bit_us = 1_000_000_f64 / f64::from(scenario.bus.bit_rate_bit_s);
    let frames: VecDeque<(Instant, Frame)> = log
        .frames
        .iter()
        .filter(|(_, frame)| answerer(frame).is_none())
        .map(|(at, frame)| {
            // Receivers have a frame one bit before its end; that is the time in a log.
            let took_us = f64::from(bits::length(frame).frame() - 1) * bit_us;
            (at.saturating_sub(Duration::from_micros(took_us.ceil() as u64)), *frame)
        })
        .collect();
    let sent = frames.len();
    let last = log.frames.iter().map(|(at, _)| *at).max().unwrap_or(Instant::ZERO);
    let player = Player { frames, out: VecDeque::new() };
    let mut world = scenario.world_with(Solo::new("log", player))?;
    // A dense log may want to start frames earlier than the bus allows: they wait here instead of being dropped.
    let player_index = crate::Participants::len(&world.participants().0);
    world.set_queue_depth(player_index, sent.max(1));
    let mut trace = Trace::new(TRACE_MAX);
    world.run_until(last + LEAD_OUT, &mut trace)?;

    let mut outcome = Outcome {
        sent,
        logged: 0,
        replayed: 0,
        agreed: 0,
        time_difference_max_us: 0,
        first_difference: None,
    };
    for module in ModuleId::all() {
        let logged = log.frames.iter().filter(|(_, frame)| answerer(frame) == Some(module));
        let replayed = trace
            .entries()
            .iter()
            .map(|entry| (entry.at, entry.frame))
            .filter(|(_, frame)| answerer(frame) == Some(module));
        compare_module(module, logged.copied(), replayed, last, compare, &mut outcome);
    }
    Ok(outcome)
}

fn compare_module(
    module: ModuleId,
    mut logged: impl Iterator<Item = (Instant, Frame)>,
    mut replayed: impl Iterator<Item = (Instant, Frame)>,
    last: Instant,
    compare: Compare,
    outcome: &mut Outcome,
) {
    let mut parted = false;
    for answer in 1.. {
        let (then, now) = (logged.next(), replayed.next());
        // What comes after the end of the log is no difference: the log may have been cut.
        if then.is_none() && now.is_none_or(|(at, _)| at > last) {
            return;
        }
        outcome.logged += usize::from(then.is_some());
        outcome.replayed += usize::from(now.is_some());
        if let (Some((then_at, then)), Some((now_at, now))) = (&then, &now)
            && agree(then, now, compare)
        {
            if !parted {
                outcome.agreed += 1;
                let difference = then_at.as_micros().abs_diff(now_at.as_micros());
                outcome.time_difference_max_us = outcome.time_difference_max_us.max(difference);
            }
            continue;
        }
        if parted {
            continue;
        }
        // After the first difference the two may be shifted against each other; counting on would mislead.
        parted = true;
        let at = then.or(now).map_or(0, |(at, _)| at.as_micros());
        if outcome.first_difference.as_ref().is_none_or(|first| at < first.at_us) {
            outcome.first_difference = Some(Difference {
                module: module.get(),
                answer,
                at_us: at,
                logged: then.map(|(_, frame)| frame.to_string()),
                replayed: now.map(|(_, frame)| frame.to_string()),
            });
        }
    }
}

fn agree(a: &Frame, b: &Frame, compare: Compare) -> bool {
    match compare {
        Compare::Bytes => a == b,
        Compare::Form => {
            a.id() == b.id()
                && a.dlc() == b.dlc()
                && a.data().iter().zip(b.data()).take(2).all(|(x, y)| x == y)
        }
    }
}
