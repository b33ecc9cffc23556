//! From the record of a job to what people read and the exit code: for every verb and link.

use std::path::Path;

use operator::bus::Session;
use operator::dialogue::operator::OperatorError;
use operator::job::summary::{Circumstances, summary};
use operator::job::{JobError, Judge, Order, Outcome, Record};

use serde_json::Value;

use crate::error::ExpectedError;
use crate::exit;

/// What ended a job early: the step, what happened, what to do.
pub fn failure(record: &Record) -> Option<ExpectedError> {
    let error = record.ended.as_ref()?;
    let step = record.at_work.map_or("start", |(step, _)| step.name());
    let expected =
        match error {
            JobError::Operator(
                error @ (OperatorError::Stopped { .. } | OperatorError::RobotStopped { .. }),
            ) if record.verdict.outcome == Outcome::Stopped => ExpectedError::of(exit::STOPPED, error),
            JobError::Operator(error) => error.into(),
            JobError::Way(_) | JobError::Double { .. } | JobError::NotHomed => {
                ExpectedError::of(exit::DRIVE, error)
            }
            JobError::Declined { .. } => ExpectedError::of(exit::INTERRUPTED, error),
            other => ExpectedError::bad_input(other),
        };
    Some(expected.at(step))
}

/// The error that a verdict makes; `None` if ball or arm are where they should be, as far as is known.
pub fn off_target(record: &Record, judge: &Judge<'_>) -> Option<ExpectedError> {
    let verdict = &record.verdict;
    let next = match (verdict.outcome, judge) {
        (Outcome::Missed, Judge::Follow { .. }) => {
            "compare `path_delay_s` in summary.json with the lag: `cubectl arm identify` measures it again"
        }
        (Outcome::Missed, _) => {
            "`cubectl log report` on the folder shows tracking and release; `cubectl home --verify` shows whether a drive \
             has lost encoder counts"
        }
        (Outcome::NotReleased, _) => {
            "take the ball out of the hand before anything moves; check the gripper, its supply and its output"
        }
        (Outcome::NotReached, _) => {
            "look what holds the arm; `cubectl home --verify` shows whether a drive has lost encoder counts"
        }
        (Outcome::Stopped, _) => {
            "look at the pendant why the robot's program ended; motion.csv shows where the arm was"
        }
        _ => return None,
    };
    let code = exit::of_outcome(verdict.outcome)?;
    Some(ExpectedError::new(code, verdict.text.clone()).next(next))
}

/// What a session says of its bus, for the summary; read before the session ends.
#[derive(Default)]
pub(super) struct Seen {
    bus: String,
    time: &'static str,
    pub(super) controller: &'static str,
    bus_errors: usize,
    /// Rights of the thread that answered a robot.
    answering: Option<String>,
}

impl Seen {
    pub(super) fn of(session: &Session) -> Self {
        let time = if session.is_simulated() { "virtual time" } else { "real time" };
        let (bus, bus_errors) = (session.name().to_owned(), session.bus_errors().len());
        Self { bus, time, controller: "node", bus_errors, answering: None }
    }

    pub(super) const fn of_robot(bus: String, time: &'static str, answering: Option<String>) -> Self {
        Self { bus, time, controller: "led", bus_errors: 0, answering }
    }

    /// What all summaries say of the session.
    pub(super) fn enter(&self, summary: &mut Value) {
        summary["bus"] = self.bus.as_str().into();
        summary["time"] = self.time.into();
        summary["command_line"] = command_line().into();
    }

    /// The summary of a job on this session.
    pub(super) fn summary(
        &self,
        order: &Order<'_>,
        record: &Record,
        wrong: Option<&ExpectedError>,
        wall_s: &[f64],
    ) -> Value {
        summary(order, record, &Circumstances { wall_s, ..self.circumstances(wrong) })
    }

    /// What the summary says beside the record.
    pub(super) fn circumstances(&self, wrong: Option<&ExpectedError>) -> Circumstances<'_> {
        Circumstances {
            bus: &self.bus,
            time: self.time,
            controller: self.controller,
            answering: self.answering.clone(),
            exit_code: wrong.map_or(exit::OK, |error| error.code),
            cause: wrong.map(ExpectedError::all_that_happened),
            next: wrong.map_or_else(Vec::new, ExpectedError::all_steps),
            bus_errors: self.bus_errors,
            ..Circumstances::default()
        }
    }
}

/// The words of this program's call.
pub(super) fn command_line() -> String {
    std::env::args().collect::<Vec<_>>().join(" ")
}

/// How a job ends: a result that could not be written never hides the outcome.
pub(super) fn outcome_last(
    wrong: Option<ExpectedError>,
    written: Result<(), ExpectedError>,
    folder: Option<&Path>,
) -> Result<(), ExpectedError> {
    let Some(error) = wrong else { return written };
    let place = folder.map(|folder| format!("  results in {}", folder.display()));
    Err(match (place, written) {
        (None, Ok(())) => error,
        (Some(place), Ok(())) => error.also(ExpectedError::new(exit::OUTPUT, place)),
        (place, Err(lost)) => error
            .also(lost.at(place.map_or("  not all results".to_owned(), |place| place + "; not all of them"))),
    })
}
