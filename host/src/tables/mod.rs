//! Tables of many throws: lists of targets, and results as CSV part files.
//!
//! A sweep over many targets is cut into shards by row number. Each shard is made by any process on any machine and becomes one
//! file of a folder. The file appears complete or not at all, and its bytes follow from the sweep and the shard alone: not from
//! who made it, with how many threads, or after how many attempts. This module knows nothing of how a throw is planned.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`shard`] | which rows a shard has |
//! | [`targets`] | lists of targets in CSV, read row by row |
//! | [`part`] | one part file: what stands before and behind its rows |
//! | [`folder`] | the folder of a sweep: what it is of, which parts it has, making one |
//! | [`summary`] | what all parts say together |

pub(crate) mod folder;
mod part;
pub(crate) mod shard;
pub(crate) mod summary;
pub(crate) mod targets;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// A table that is refused, or cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    /// What was given cannot be used: what, where, and what to do instead.
    #[error("{0}")]
    Refused(String),
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: io::Error },
    #[error("{path}: {source}")]
    Write { path: PathBuf, source: io::Error },
}

impl TableError {
    /// For `map_err` of what reads `path`.
    fn reading(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Read { path: path.to_owned(), source }
    }

    /// For `map_err` of what writes `path`.
    fn writing(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Write { path: path.to_owned(), source }
    }
}

/// Adds the bytes of a file to a CRC-32.
fn add_bytes(path: &Path, crc: &mut crc32fast::Hasher) -> Result<(), TableError> {
    let mut file = File::open(path).map_err(TableError::reading(path))?;
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes).map_err(TableError::reading(path))? {
            0 => return Ok(()),
            count => crc.update(&bytes[..count]),
        }
    }
}
