//! Exit codes and what leads to them.

use std::process::ExitCode;

/// Shown at the end of `--help`.
pub(super) const HELP: &str = "Exit codes:
  0  done, everything as expected
  2  the command line is wrong
  3  a check of the scenario did not end as expected, a seed of a swarm failed, or a served robot
     stopped with a fault
  4  a file is wrong or cannot be read: scenario, robot
  5  the bus cannot be had, or was lost; the client of a served robot cannot be reached or does not answer
  6  a simulated node broke its contract (a defect of the simulator)
  7  a result could not be written";

/// Why the program ends with something else than 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Code {
    NotAsExpected = 3,
    BadFile = 4,
    Bus = 5,
    Defect = 6,
    Output = 7,
}

impl From<Code> for ExitCode {
    fn from(code: Code) -> Self {
        Self::from(code as u8)
    }
}

/// A verb failed; `text` is for standard error, `None` if all was said already.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) code: Code,
    text: Option<String>,
    /// What to do.
    next: Option<String>,
}

impl Failure {
    pub(super) fn new(code: Code, text: &impl ToString) -> Self {
        Self { code, text: Some(text.to_string()), next: None }
    }

    /// With what to do.
    pub(super) fn next(self, next: impl Into<Option<String>>) -> Self {
        Self { next: next.into(), ..self }
    }

    pub(super) fn print(&self) {
        if let Some(text) = &self.text {
            let next = self.next.as_ref().map_or_else(String::new, |next| format!("\n  next: {next}"));
            console::note!("error: {text}{next}");
        }
    }

    pub(super) fn silent(code: Code) -> Self {
        Self { code, text: None, next: None }
    }
}

impl From<hil_sim::scenario::ScenarioError> for Failure {
    fn from(error: hil_sim::scenario::ScenarioError) -> Self {
        Self::new(Code::BadFile, &error)
    }
}

impl From<hil_sim::scenario::BuildError> for Failure {
    fn from(error: hil_sim::scenario::BuildError) -> Self {
        Self::new(Code::BadFile, &error).next(error.next())
    }
}

impl From<hil_sim::world::RunError> for Failure {
    fn from(error: hil_sim::world::RunError) -> Self {
        let code = match error {
            // The plan names something that the robot does not have.
            hil_sim::world::RunError::Fault { .. } => Code::BadFile,
            _ => Code::Defect,
        };
        Self::new(code, &error)
    }
}
