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
    /// A start while the set points still move or the exchange runs.
    #[error("the program cannot start: {0}")]
    NotReady(&'static str),
}
