//! Errors that are expected: the user, a file or the outside world, not a bug.

use std::fmt;

use crate::exit;

/// What happened, where, and what to do next; ends the program with a documented exit code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExpectedError {
    /// Exit code, one of [`crate::exit`].
    pub code: u8,
    /// Text for people.
    pub message: String,
}

impl fmt::Display for ExpectedError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for ExpectedError {}

impl ExpectedError {
    /// With an exit code.
    #[must_use]
    pub fn new(code: u8, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }

    /// Refused input.
    #[must_use]
    pub fn bad_input(cause: &impl fmt::Display) -> Self {
        Self::new(exit::BAD_INPUT, cause.to_string())
    }

    /// A result that cannot be written.
    #[must_use]
    pub fn output(path: &std::path::Path, cause: &std::io::Error) -> Self {
        Self::new(exit::OUTPUT, format!("{}: {cause}", path.display()))
    }

    /// A file that cannot be read.
    #[must_use]
    pub fn io(path: &std::path::Path, cause: &std::io::Error) -> Self {
        Self::new(exit::BAD_INPUT, format!("{}: {cause}", path.display()))
    }
}
