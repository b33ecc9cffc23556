//! Errors that are expected: the user, a file or the outside world, not a bug.

use std::fmt;
use std::io;
use std::path::Path;

use crate::advice::Place;
use crate::exit;

/// What happened, where, and what to do next; ends the program with a documented exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExpectedError {
    /// Exit code, one of [`crate::exit`].
    pub code: u8,
    /// What happened and where.
    pub what: String,
    /// What to do next, one step each.
    pub next: Vec<String>,
    /// What else is wrong or must be known, printed below; the codes of these count for nothing.
    pub also: Vec<Self>,
}

/// The text for people: each step and each further error on a line of its own.
impl fmt::Display for ExpectedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)?;
        self.next.iter().try_for_each(|step| write!(f, "\n  next: {step}"))?;
        self.also.iter().try_for_each(|other| write!(f, "\n{other}"))
    }
}

impl std::error::Error for ExpectedError {}

impl ExpectedError {
    /// With an exit code and no next step.
    #[must_use]
    pub fn new(code: u8, what: impl Into<String>) -> Self {
        Self { code, what: what.into(), next: Vec::new(), also: Vec::new() }
    }

    #[must_use]
    pub fn next(mut self, step: impl Into<String>) -> Self {
        self.next.push(step.into());
        self
    }

    /// Adds the step that an error below knows.
    #[must_use]
    pub fn next_of(mut self, cause: &(impl Cause + ?Sized)) -> Self {
        self.next.extend(cause.next());
        self
    }

    /// Adds an error that is printed below.
    #[must_use]
    pub fn also(mut self, other: Self) -> Self {
        self.also.push(other);
        self
    }

    /// With the place where it happened before it.
    #[must_use]
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        self.what = format!("{place}: {}", self.what);
        self
    }

    /// With the bus and the robot of the command line in the commands that it names.
    #[must_use]
    pub fn on(self, place: &Place) -> Self {
        Self {
            code: self.code,
            what: place.complete(&self.what),
            next: self.next.iter().map(|step| place.complete(step)).collect(),
            also: self.also.into_iter().map(|other| other.on(place)).collect(),
        }
    }

    /// The one object of a failure with `--json`: exit code, what happened, and the next steps.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!({ "code": self.code, "what": self.all_that_happened(), "next": self.all_steps() })
    }

    /// A line for this and each of what is printed below it, without the steps.
    #[must_use]
    pub fn all_that_happened(&self) -> String {
        self.also.iter().fold(self.what.clone(), |text, other| text + "\n" + &other.all_that_happened())
    }

    /// The steps of this and of what is printed below it.
    #[must_use]
    pub fn all_steps(&self) -> Vec<String> {
        self.next.iter().cloned().chain(self.also.iter().flat_map(Self::all_steps)).collect()
    }

    /// Refused input.
    #[must_use]
    pub fn bad_input(cause: &(impl Cause + ?Sized)) -> Self {
        Self::of(exit::BAD_INPUT, cause)
    }

    /// An error of a part below, with the step that it knows.
    #[must_use]
    pub fn of(code: u8, cause: &(impl Cause + ?Sized)) -> Self {
        Self::new(code, cause.to_string()).next_of(cause)
    }

    /// A result that cannot be written.
    #[must_use]
    pub fn output(path: &Path, cause: &io::Error) -> Self {
        Self::of(exit::OUTPUT, cause).at(path.display())
    }

    /// A file that cannot be read.
    #[must_use]
    pub fn io(path: &Path, cause: &io::Error) -> Self {
        Self::bad_input(cause).at(path.display())
    }
}

/// An error of a part below this program.
pub trait Cause: fmt::Display {
    /// What to do, where the error knows it.
    fn next(&self) -> Option<String> {
        None
    }
}

impl Cause for str {}
impl Cause for String {}

impl<T: Cause + ?Sized> Cause for &T {
    fn next(&self) -> Option<String> {
        (*self).next()
    }
}

/// What the system refuses: whoever reads a file need not think of a next step.
impl Cause for io::Error {
    fn next(&self) -> Option<String> {
        toml_reader::next_of_file(self).map(str::to_owned)
    }
}

/// Errors that know their next step.
macro_rules! with_next {
    ($($error:ty),* $(,)?) => {
        $(impl Cause for $error {
            fn next(&self) -> Option<String> {
                self.next()
            }
        })*
    };
}

with_next!(
    can_link::OpenError,
    can_link::LinkError,
    can_link::RunError,
    can_link::SpecError,
    hil_sim::krc::KrcError,
    hil_sim::krc::serve::ServeError,
    hil_sim::realtime::MixedTime,
    hil_sim::realtime::RealtimeError,
    hil_sim::scenario::BuildError,
    hil_sim::tracker::serve::ServeError,
    operator::analysis::AnalysisError,
    operator::ball_catch::wire::WireError,
    operator::bus::BusFailure,
    operator::bus::period::NoPeriod,
    operator::bus::settings::NoSettings,
    operator::dialogue::ask::AskError,
    operator::dialogue::operator::OperatorError,
    operator::identify::experiment::ExperimentError,
    operator::identify::joint::JointError,
    operator::job::JobError,
    operator::job::target::TargetError,
    operator::live::serve::ServeError,
    operator::rsi::identify::Unclear,
    operator::rsi::program::NoStation,
    operator::tracker::calibration::Unsolved,
    operator::tracker::client::TrackerError,
    operator::trajectory::TrajectoryError,
    planner::plan::file::PlanFileError,
    planner::waypoints::WaypointError,
    tuner::gains::choose::NoGains,
);

impl Cause for toml_reader::DocumentError {
    fn next(&self) -> Option<String> {
        self.problem.next()
    }
}

impl Cause for robot_model::LoadError {
    fn next(&self) -> Option<String> {
        self.problem.next()
    }
}

/// Errors without one.
macro_rules! without_next {
    ($($error:ty),* $(,)?) => { $(impl Cause for $error {})* };
}

without_next!(
    hil_sim::world::BuildError,
    planner::catch::arm::NotACatcher,
    planner::flight::model::FlightModelError,
    planner::follow::plan::OtherLag,
    planner::request::Refusal,
    planner::timing::GivenError,
    planner::timing::PathError,
    toml::ser::Error,
    tuner::gains::gains_file::GainsFileError,
    tuner::gains::machine::MachineError,
);

impl Cause for robot_model::urdf::UrdfError {
    fn next(&self) -> Option<String> {
        self.problem.next()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_missing_gets_one_next_step() {
        let folder = std::env::temp_dir();
        for (path, next) in [(folder.join("no-such-file.toml"), "check the name"), (folder, "in that folder")]
        {
            let cause = std::fs::read(&path).unwrap_err();
            let error = ExpectedError::io(&path, &cause);
            assert!(error.next.len() == 1 && error.next[0].contains(next), "{error}");
        }
        // The text of the system alone is none of its errors.
        let said = io::Error::other(io::Error::from_raw_os_error(2).to_string());
        assert!(ExpectedError::io(Path::new("x"), &said).next.is_empty());
        assert!(ExpectedError::bad_input("two numbers").next.is_empty());
    }

    #[test]
    fn steps_and_further_errors_are_printed_on_lines_of_their_own() {
        let error =
            ExpectedError::new(exit::DRIVE, "no answer").next("check the cable").next("`cubectl doctor`");
        let other = ExpectedError::new(exit::OUTPUT, "page.html: full").next("free space");
        let both = error.clone().also(other).at("arm");
        assert_eq!(
            both.to_string(),
            "arm: no answer\n  next: check the cable\n  next: `cubectl doctor`\npage.html: full\n  next: free space"
        );
        let wanted = serde_json::json!({
            "code": exit::DRIVE,
            "what": "arm: no answer\npage.html: full",
            "next": ["check the cable", "`cubectl doctor`", "free space"],
        });
        assert_eq!(both.json(), wanted);
        let completed = error.on(&Place::of_matches(&place("can0")));
        assert_eq!(completed.next, ["check the cable", "`cubectl doctor --bus can0`"]);
    }

    fn place(bus: &str) -> clap::ArgMatches {
        use clap::CommandFactory;
        crate::cli::Cli::command().get_matches_from(["cubectl", "arm", "status", "--bus", bus])
    }
}
