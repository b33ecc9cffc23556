//! A table that is on the disk row by row while an arm moves. A disk that is full is reported at the end; it stops no motion.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::ExpectedError;

pub(super) struct Rows {
    path: PathBuf,
    out: File,
    failed: Option<std::io::Error>,
}

impl Rows {
    pub(super) fn create(path: &Path) -> Result<Self, ExpectedError> {
        let out = File::create(path).map_err(|error| ExpectedError::output(path, &error))?;
        Ok(Self { path: path.to_owned(), out, failed: None })
    }

    /// Writes a line, unless an earlier one could not be written.
    pub(super) fn line(&mut self, text: &str) {
        if self.failed.is_none() {
            self.failed = self.out.write_all(text.as_bytes()).err();
        }
    }

    pub(super) fn finish(self) -> Result<(), ExpectedError> {
        self.failed.map_or(Ok(()), |error| Err(ExpectedError::output(&self.path, &error)))
    }
}
