//! States of the simulated controller, and why it cannot start.

/// Where the controller is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    Off,
    /// The program runs and waits for its connection.
    Open,
    Run,
    /// Stopped by a fault; only a new start leaves it.
    Fault,
}

/// The controller cannot be built or started.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KrcError {
    /// Options that contradict each other or the configuration file.
    #[error("{0}")]
    Options(String),
    /// The robot file is refused.
    #[error("{text}")]
    Robot {
        /// Where and why.
        text: String,
        /// What to do.
        next: Option<String>,
    },
    /// A start while the set points still move or the exchange runs.
    #[error("the program cannot start: {0}")]
    NotReady(&'static str),
}

impl KrcError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Robot { next, .. } => next.clone(),
            Self::Options(_) | Self::NotReady(_) => None,
        }
    }
}
