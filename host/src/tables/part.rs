//! One part file: the rows of a shard as CSV. The first line says what they are of, the last line that all of them are there.
//!
//! Both lines begin with `#`, which readers of CSV can be set to take for a comment.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use super::folder::STUDY_MAX_BYTES;
use super::reading;
use crate::error::ExpectedError;

/// Begin of the last line.
const END: &str = "# end: ";
/// Longest last line, bytes.
const END_MAX_BYTES: u64 = 80;

/// What stands before the rows: the study as one line of JSON, and the names of the columns.
pub(super) fn begin(study: &str, columns: &[String]) -> io::Result<Vec<u8>> {
    let mut bytes = format!("# {study}\n").into_bytes();
    bytes.extend(lines(std::iter::once(columns))?);
    Ok(bytes)
}

/// Rows as text.
pub(super) fn lines<'a>(rows: impl Iterator<Item = &'a [String]>) -> io::Result<Vec<u8>> {
    // A field with the mark of a comment is quoted.
    let mut writer = csv::WriterBuilder::new().comment(Some(b'#')).from_writer(Vec::new());
    for row in rows {
        writer.write_record(row)?;
    }
    writer.into_inner().map_err(|error| io::Error::other(error.to_string()))
}

/// The last line, after so many rows and bytes.
pub(super) fn end(rows: u64, bytes: u64) -> String {
    format!("{END}{rows} rows, {bytes} bytes before this line\n")
}

/// What a whole part says of itself.
pub(super) struct Ending {
    /// The study as JSON.
    pub(super) study: String,
    pub(super) rows: u64,
}

/// What a part says of itself; `None` for a file that is not there or not whole.
pub(super) fn ending(path: &Path) -> Result<Option<Ending>, ExpectedError> {
    match File::open(path).and_then(read_ending) {
        Ok(ending) => Ok(ending),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(reading(path)(error)),
    }
}

fn read_ending(mut file: File) -> io::Result<Option<Ending>> {
    let length = file.metadata()?.len();
    let from = length.saturating_sub(END_MAX_BYTES);
    file.seek(SeekFrom::Start(from))?;
    let mut tail = Vec::new();
    file.by_ref().take(END_MAX_BYTES).read_to_end(&mut tail)?;
    let tail = String::from_utf8_lossy(&tail);
    let Some(rows) = tail.rfind(END).and_then(|at| rows_of(&tail[at..], length)) else { return Ok(None) };
    file.rewind()?;
    let mut first = String::new();
    if BufReader::new(file.take(STUDY_MAX_BYTES)).read_line(&mut first).is_err() {
        return Ok(None);
    }
    let study = first.strip_prefix("# ").unwrap_or_default().trim_end().to_owned();
    Ok(Some(Ending { study, rows }))
}

/// The rows that a last line counts, if it is the one of a file of so many bytes.
fn rows_of(line: &str, length: u64) -> Option<u64> {
    let (rows, rest) = line.strip_prefix(END)?.split_once(" rows, ")?;
    let (rows, bytes) = (rows.parse().ok()?, rest.split_once(' ')?.0.parse().ok()?);
    (line == end(rows, bytes) && length == bytes + line.len() as u64).then_some(rows)
}
