//! A CSV table of results that is continued: whole lines, made by one set of words.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

use planner::store::file::write_whole;
use throw_tables::folder::claim_table;
use toml_reader::read_text;

use super::shards::table_error;
use crate::error::ExpectedError;

/// Longest table that is read, bytes: about a million rows.
const TABLE_MAX_BYTES: u64 = 256 << 20;

/// Opens a table to append to and returns its rows so far, without the header and without a torn last line.
///
/// The file is replaced only by one that is whole. `words` are everything that the rows follow from; they stand in a file beside it.
///
/// # Errors
/// The file is something else, its rows were made with other words, or it cannot be read or written.
pub(super) fn continued(
    path: &Path,
    header: &str,
    words: &BTreeMap<String, String>,
) -> Result<(File, Vec<String>), ExpectedError> {
    let text = match read_text(path, TABLE_MAX_BYTES) {
        Ok(text) => text,
        Err(e) if e.kind() == ErrorKind::NotFound => String::new(),
        Err(e) => return Err(ExpectedError::io(path, &e)),
    };
    let mut lines = text.split_inclusive('\n');
    let first = lines.next().unwrap_or_default();
    if first.trim_end() != header && !(header.starts_with(first) && text.len() == first.len()) {
        return Err(ExpectedError::bad_input(&format!(
            "{} exists and is another table\n  next: name another file with --out, or remove it",
            path.display()
        )));
    }
    let rows: Vec<String> =
        lines.filter(|line| line.ends_with('\n')).map(|l| l.trim_end().to_owned()).collect();
    claim_table(path, rows.is_empty(), words).map_err(table_error)?;
    if rows.is_empty() || !text.ends_with('\n') {
        write_rows(path, header, rows.iter().map(String::as_str))
            .map_err(|e| ExpectedError::output(path, &e))?;
    }
    let file = OpenOptions::new().append(true).open(path).map_err(|e| ExpectedError::output(path, &e))?;
    Ok((file, rows))
}

/// Replaces a table by a whole one.
///
/// # Errors
/// Writing fails; the earlier table stays then.
pub(super) fn write_rows<'a>(
    path: &Path,
    header: &'a str,
    rows: impl Iterator<Item = &'a str>,
) -> io::Result<()> {
    let mut text = String::new();
    for line in std::iter::once(header).chain(rows) {
        text.push_str(line);
        text.push('\n');
    }
    write_whole(path, text.as_bytes())
}

/// Appends a row.
///
/// # Errors
/// Writing fails.
pub(super) fn append(mut file: &File, row: &str) -> io::Result<()> {
    file.write_all(format!("{row}\n").as_bytes())
}
