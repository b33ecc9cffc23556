//! Why a bus cannot be opened, or a session on it ended.

use std::io;

use crate::node::stop_watch::StopSeen;

/// Why a session ended although no end was ordered.
#[derive(Debug, thiserror::Error)]
pub enum BusFailure {
    /// The bus cannot be reached.
    #[error(transparent)]
    Open(#[from] can_link::OpenError),
    #[error(transparent)]
    Link(#[from] can_link::LinkError),
    #[error("cannot wait for the bus: {0}")]
    Wait(#[source] io::Error),
    /// The runner of a node ended.
    #[error(transparent)]
    Runner(#[from] can_link::RunError),
    /// The robot of the simulated cell cannot be loaded.
    #[error(transparent)]
    Robot(#[from] robot_model::LoadError),
    /// The scenario of the simulated cell cannot be used.
    #[error(transparent)]
    Scenario(Box<hil_sim::scenario::ScenarioError>),
    /// A controller for drives that are not described, on a bus with real drives.
    #[error("the drives of {robot} are assumed ([generic_drives]), and {bus} has real ones")]
    AssumedDrives { robot: String, bus: can_link::BusSpec },
    /// No controller can be made for the robot.
    #[error(transparent)]
    Settings(#[from] super::settings::NoSettings),
    /// The key file cannot be used.
    #[error(transparent)]
    Key(#[from] super::key_file::KeyFileError),
    /// The operating system gives no random bytes.
    #[error(transparent)]
    Entropy(#[from] super::entropy::NoEntropy),
    /// The simulated cell cannot be built.
    #[error(transparent)]
    Cell(#[from] hil_sim::cell::CellError),
    /// The simulated world cannot be built.
    #[error(transparent)]
    World(#[from] hil_sim::world::BuildError),
    /// A node of the simulated world broke its contract.
    #[error("simulated bus: {0}")]
    Sim(#[from] hil_sim::world::RunError),
    /// Another node or a person stopped the arm.
    #[error("stopped from outside: {0}; what this program moved was stopped too")]
    StoppedByOther(StopSeen),
    /// The recording cannot be written; the arm was stopped first where this session moved it.
    #[error("the recording cannot be written: {source}{}", if *.halted { " (the arm was halted first)" } else { "" })]
    Recording {
        source: io::Error,
        /// A halt was sent before the session ended.
        halted: bool,
    },
}

impl BusFailure {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::AssumedDrives { .. } => "`cubectl robot check FILE` lists the \
         lines that describe real drives; the simulated cell (without --bus) takes assumed ones"
                .to_owned(),
            Self::StoppedByOther(..) => "find out who stopped it and why before the next order".to_owned(),
            Self::Recording { source, .. } => disk_advice(source).to_string(),
            Self::Open(error) => return error.next(),
            Self::Link(error) => return error.next(),
            Self::Runner(error) => return error.next(),
            Self::Robot(error) => return error.problem.next(),
            Self::Scenario(error) => return error.problem.next(),
            Self::Settings(error) => return error.next(),
            Self::Key(error) => return error.next(),
            Self::Entropy(error) => return error.next(),
            _ => return None,
        })
    }
}

fn disk_advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free space on that disk, or record to another one"
        }
        io::ErrorKind::PermissionDenied => "record to a folder that may be written",
        _ => "check the disk, or record to another place",
    }
}
