//! What can go wrong with tables.

use std::io;
use std::path::{Path, PathBuf};

use parquet::errors::ParquetError;

/// A table that is refused, or cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// What was given cannot be used: what, where, and what to do instead.
    #[error("{0}")]
    Refused(String),
    /// Reading failed.
    #[error("{path}: {source}")]
    Read {
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Writing failed.
    #[error("{path}: {source}")]
    Write {
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl TableError {
    /// For `map_err` of what reads `path`.
    pub(crate) fn reading(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Read { path: path.to_owned(), source }
    }

    /// For `map_err` of what writes `path`.
    pub(crate) fn writing(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Write { path: path.to_owned(), source }
    }
}

/// As an error of the system: that is what a failed write is.
pub(crate) fn system(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(cause) => match cause.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(cause) => io::Error::other(cause),
        },
        other => io::Error::other(other),
    }
}
