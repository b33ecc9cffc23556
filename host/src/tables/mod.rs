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
use std::path::Path;

use crate::error::ExpectedError;

/// For `map_err` of what reads `path`.
fn reading(path: &Path) -> impl Fn(io::Error) -> ExpectedError + '_ {
    |error| ExpectedError::io(path, &error)
}

/// For `map_err` of what writes `path`.
fn writing(path: &Path) -> impl Fn(io::Error) -> ExpectedError + '_ {
    |error| ExpectedError::output(path, &error)
}

/// Adds the bytes of a file to a CRC-32.
fn add_bytes(path: &Path, crc: &mut crc32fast::Hasher) -> Result<(), ExpectedError> {
    let mut file = File::open(path).map_err(reading(path))?;
    let mut bytes = vec![0; 1 << 16];
    loop {
        match file.read(&mut bytes).map_err(reading(path))? {
            0 => return Ok(()),
            count => crc.update(&bytes[..count]),
        }
    }
}
