//! From what goes wrong on a bus to exit codes.

use hil_sim::world::BuildError;

use crate::error::ExpectedError;
use crate::exit;
use operator::bus::BusFailure;
use operator::bus::entropy::NoEntropy;
use operator::bus::key_file::KeyFileError;
use operator::dialogue::ask::AskError;
use operator::dialogue::operator::OperatorError;
use operator::log::candump::UnreadableFile;

impl From<BusFailure> for ExpectedError {
    fn from(failure: BusFailure) -> Self {
        (&failure).into()
    }
}

impl From<&BusFailure> for ExpectedError {
    fn from(failure: &BusFailure) -> Self {
        let code = match failure {
            BusFailure::World(BuildError::NoSuchModule { .. } | BuildError::NoSuchPlace { .. })
            | BusFailure::Robot(_)
            | BusFailure::Cell(_)
            | BusFailure::Scenario(_)
            | BusFailure::Key(_)
            | BusFailure::AssumedDrives { .. }
            | BusFailure::Settings(_) => exit::BAD_INPUT,
            BusFailure::Recording { .. } => exit::OUTPUT,
            BusFailure::StoppedByOther(_) => exit::STOPPED,
            BusFailure::Sim(_)
            | BusFailure::Runner(
                can_link::RunError::StuckDeadline { .. } | can_link::RunError::Babble { .. },
            ) => exit::BUG,
            BusFailure::Open(_)
            | BusFailure::Link(_)
            | BusFailure::Wait(_)
            | BusFailure::Entropy(_)
            | BusFailure::Runner(_)
            | BusFailure::World(_) => exit::BUS,
        };
        Self::of(code, failure)
    }
}

impl From<KeyFileError> for ExpectedError {
    fn from(error: KeyFileError) -> Self {
        BusFailure::from(error).into()
    }
}

impl From<NoEntropy> for ExpectedError {
    fn from(error: NoEntropy) -> Self {
        BusFailure::from(error).into()
    }
}

impl From<UnreadableFile> for ExpectedError {
    fn from(error: UnreadableFile) -> Self {
        Self { next: error.next.clone().into_iter().collect(), ..Self::bad_input(&error.to_string()) }
    }
}

impl From<AskError> for ExpectedError {
    fn from(error: AskError) -> Self {
        match error {
            AskError::Bus(failure) => failure.into(),
            AskError::Request(_) => Self::of(exit::DRIVE, &error),
            AskError::Interrupted => Self::new(exit::INTERRUPTED, "interrupted"),
        }
    }
}

impl From<OperatorError> for ExpectedError {
    fn from(error: OperatorError) -> Self {
        (&error).into()
    }
}

impl From<&OperatorError> for ExpectedError {
    fn from(error: &OperatorError) -> Self {
        match error {
            OperatorError::Bus(failure) => failure.into(),
            OperatorError::Interrupted => Self::new(exit::INTERRUPTED, "interrupted; what moved was stopped"),
            OperatorError::TooLong(_) => Self::bad_input(error),
            OperatorError::RobotNotReady { .. } | OperatorError::Socket(_) => Self::of(exit::BUS, error),
            error if error.is_stop_by_other() => Self::of(exit::STOPPED, error),
            other => Self::of(exit::DRIVE, other),
        }
    }
}
