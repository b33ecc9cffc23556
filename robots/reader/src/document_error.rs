//! Where a document is wrong, and why.

use std::fmt;
use std::io;

use crate::bounded::next_of_file;

/// A document was refused: where, and why.
///
/// The text reads `file:line: key: reason`, so that an editor can jump to it.
#[derive(Clone, Debug, PartialEq)]
pub struct DocumentError<P = Problem> {
    /// File name as given by the caller.
    pub file: String,
    /// Line (from 1) the reason refers to; `None` if the file could not be read at all.
    pub line: Option<usize>,
    /// Key path, for example `joint[2].range_deg`; empty for the file as a whole.
    pub key: String,
    /// The reason, and what would be right.
    pub problem: P,
}

impl<P> DocumentError<P> {
    /// The file as a whole is refused.
    pub fn of_file(file: &str, problem: impl Into<P>) -> Self {
        Self { file: file.to_owned(), line: None, key: String::new(), problem: problem.into() }
    }
}

impl<P: fmt::Display> fmt::Display for DocumentError<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.key.is_empty() {
            write!(f, ": {}", self.key)?;
        }
        write!(f, ": {}", self.problem)
    }
}

impl<P: fmt::Debug + fmt::Display> std::error::Error for DocumentError<P> {}

/// What can be wrong with any document.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// The file could not be read.
    #[error("cannot read the file: {text}")]
    Unreadable {
        /// Error text of the system.
        text: String,
        /// Next step, if it is known for the system's code.
        next: Option<&'static str>,
    },
    /// Not TOML.
    #[error("not valid TOML: {0}")]
    Syntax(String),
    /// Written for another version of the schema.
    #[error("schema version {found} is not supported (this program reads version {supported})")]
    Schema {
        /// Version in the file.
        found: i64,
        /// Version this program reads.
        supported: i64,
    },
    /// The key is not part of the schema here.
    #[error("unknown key{}", hint(.same_quantity, .known))]
    UnknownKey {
        /// A known key for the same quantity in another unit.
        same_quantity: Option<&'static str>,
        /// All keys known here.
        known: Vec<&'static str>,
    },
    /// The key must be there.
    #[error("missing")]
    Missing,
    /// The value has another type.
    #[error("expected {expected}, found {found}")]
    WrongType {
        /// Type or value that the schema requires.
        expected: &'static str,
        /// What the file has.
        found: &'static str,
    },
    /// A list has another length.
    #[error("expected {expected} values, found {found}")]
    WrongLength {
        /// Number of values that the schema requires.
        expected: usize,
        /// Number of values in the file.
        found: usize,
    },
    /// NaN or infinite.
    #[error("{0} is not a finite number")]
    NotFinite(f64),
    /// Must be greater than zero.
    #[error("{0} must be greater than zero")]
    NotPositive(f64),
    /// Must not be negative.
    #[error("{0} must not be negative")]
    Negative(f64),
    /// Outside the range that makes sense for this quantity.
    #[error("{value} is outside {min} to {max}")]
    OutOfRange {
        /// Value in the file.
        value: f64,
        /// Smallest value accepted.
        min: f64,
        /// Largest value accepted.
        max: f64,
    },
    /// The word is not one of the known words.
    #[error("unknown value `{found}` (known: {})", .known.join(", "))]
    UnknownWord {
        /// Text in the file.
        found: String,
        /// Accepted texts.
        known: Vec<&'static str>,
    },
    /// Another document that this one names is refused.
    #[error("{what}")]
    Named {
        /// Where and why.
        what: String,
        /// What to do.
        next: Option<String>,
    },
    /// Any other problem; the text names the right form.
    #[error("{0}")]
    Invalid(String),
}

impl Problem {
    /// The file could not be read.
    #[must_use]
    pub fn unreadable(error: &io::Error) -> Self {
        Self::Unreadable { text: error.to_string(), next: next_of_file(error) }
    }

    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Unreadable { next, .. } => next.map(str::to_owned),
            Self::Named { next, .. } => next.clone(),
            _ => None,
        }
    }
}

fn hint(same_quantity: &Option<&'static str>, known: &[&'static str]) -> String {
    match same_quantity {
        Some(key) => format!("; this file gives that quantity as `{key}` (mind the unit)"),
        None => format!(" (known here: {})", known.join(", ")),
    }
}
