//! The folder of a sweep: `study.json` says what it is of, each shard is a part file.
//!
//! A part is written under a temporary name and renamed when all of it is on the disk. The writer holds a lock on the temporary
//! file, so that what a killed process has left behind is distinguished from what a living one writes. Two processes that make the same
//! shard write the same bytes; whoever is later replaces the file by itself.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, ErrorKind, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::part::{self, Ending};
use super::shard::Shard;
use super::{reading, writing};
use crate::error::ExpectedError;

/// Name of the file that says what a folder is of.
const STUDY_FILE: &str = "study.json";
/// Longest such file that is read, bytes.
pub(super) const STUDY_MAX_BYTES: u64 = 1 << 20;
/// Rows that are made and written at once, and held in memory.
pub(crate) const BATCH_ROWS: u64 = 8192;

/// What a sweep is of: everything its results follow from, by name. Two sweeps are the same if all of it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Study {
    words: BTreeMap<String, String>,
    targets: u64,
    shards: u32,
}

impl Study {
    /// A sweep to so many targets in so many shards. `words` are the rest, by name.
    pub(crate) fn new(words: BTreeMap<String, String>, targets: u64, shards: u32) -> Self {
        let mut all = words;
        all.insert("targets".to_owned(), targets.to_string());
        all.insert("shards".to_owned(), shards.to_string());
        Self { words: all, targets, shards }
    }

    /// The text of the file: JSON, names in alphabetical order.
    fn to_json(&self) -> String {
        // Maps of texts can be written.
        serde_json::to_string_pretty(&self.words).unwrap_or_default() + "\n"
    }

    fn to_line(&self) -> String {
        serde_json::to_string(&self.words).unwrap_or_default()
    }

    /// From the text of the file; `None` if it is of something else.
    pub(crate) fn from_json(text: &str) -> Option<Self> {
        let words: BTreeMap<String, String> = serde_json::from_str(text).ok()?;
        let (targets, shards) = (words.get("targets")?.parse().ok()?, words.get("shards")?.parse().ok()?);
        Shard::new(1, shards)?;
        Some(Self { words, targets, shards })
    }

    pub(crate) fn targets(&self) -> u64 {
        self.targets
    }

    /// What it says of something, by name; nothing if it does not.
    pub(crate) fn word(&self, name: &str) -> &str {
        self.words.get(name).map_or("", String::as_str)
    }

    pub(crate) fn shards(&self) -> u32 {
        self.shards
    }

    /// What differs from what is asked for, a line for each name.
    fn differs(&self, asked: &Self) -> String {
        let names: BTreeSet<&String> = self.words.keys().chain(asked.words.keys()).collect();
        let nothing = "nothing".to_owned();
        let mut lines = String::new();
        for name in names {
            let (there, asked) = (self.words.get(name), asked.words.get(name));
            if there != asked {
                let (there, asked) = excerpts(there.unwrap_or(&nothing), asked.unwrap_or(&nothing));
                lines += &format!("\n  {name}: {there} there, {asked} asked for");
            }
        }
        lines
    }
}

/// The text of a study file; nothing for one that is too long.
fn study_text(file: &Path) -> io::Result<String> {
    if fs::metadata(file)?.len() > STUDY_MAX_BYTES { Ok(String::new()) } else { fs::read_to_string(file) }
}

/// Two texts for a message. Of long texts only the part that differs is kept, with some words around it.
fn excerpts(a: &str, b: &str) -> (String, String) {
    const SHORT: usize = 60;
    const BESIDE: usize = 30;
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    if a.len().max(b.len()) <= SHORT {
        return (a.iter().collect(), b.iter().collect());
    }
    let same = a.iter().zip(&b).take_while(|(a, b)| a == b).count();
    let shorter = a.len().min(b.len());
    let behind = a.iter().rev().zip(b.iter().rev()).take(shorter - same).take_while(|(a, b)| a == b).count();
    let excerpt = |all: &[char]| {
        let (from, to) = (same.saturating_sub(BESIDE), (all.len() - behind + BESIDE).min(all.len()));
        let begin = if from > 0 { "…" } else { "" };
        let end = if to < all.len() { "…" } else { "" };
        format!("{begin}{}{end}", all[from..to].iter().collect::<String>())
    };
    (excerpt(&a), excerpt(&b))
}

#[derive(Debug, Clone)]
pub(crate) struct Folder {
    path: PathBuf,
    study: Study,
}

impl Folder {
    /// The folder for a sweep; it is made if it is not there.
    ///
    /// # Errors
    /// It belongs to another sweep, or cannot be read or written.
    pub(crate) fn for_study(path: &Path, study: Study) -> Result<Self, ExpectedError> {
        fs::create_dir_all(path).map_err(writing(path))?;
        let file = path.join(STUDY_FILE);
        let folder = Self { path: path.to_owned(), study };
        if !file.exists() {
            folder.claim(&file).map_err(writing(&file))?;
        }
        let there = Self::open(path)?;
        if there.study != folder.study {
            return Err(ExpectedError::bad_input(&format!(
                "{} has the parts of another sweep:{}",
                path.display(),
                there.study.differs(&folder.study)
            ))
            .next("name another folder with --out, or remove this one"));
        }
        Ok(folder)
    }

    /// The folder of a sweep that is there.
    ///
    /// # Errors
    /// There is none, or its [`STUDY_FILE`] cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, ExpectedError> {
        let file = path.join(STUDY_FILE);
        let refuse = |why: &str| {
            ExpectedError::bad_input(&format!("{}: {why}", file.display()))
                .next("name the folder that `cubectl plan sweep --out FOLDER` has made")
        };
        let text = match study_text(&file) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Err(refuse("there is no sweep here"));
            }
            Err(error) => return Err(reading(&file)(error)),
        };
        let study = Study::from_json(&text).ok_or_else(|| refuse("does not say what the sweep is of"))?;
        Ok(Self { path: path.to_owned(), study })
    }

    /// Puts the study file in place, whole; a file that another process has put there first stays.
    fn claim(&self, file: &Path) -> io::Result<()> {
        let temporary = self.path.join(format!(".{STUDY_FILE}.{:016x}.tmp", unique()));
        let claimed = fs::write(&temporary, self.study.to_json()).and_then(|()| {
            match fs::hard_link(&temporary, file) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
                // A file system without links: the first of several at the same moment may lose, and is then refused.
                Err(_) => fs::rename(&temporary, file),
                Ok(()) => Ok(()),
            }
        });
        // After a rename there is nothing to remove.
        let _ = fs::remove_file(&temporary);
        claimed
    }

    pub(crate) fn study(&self) -> &Study {
        &self.study
    }

    pub(crate) fn part(&self, shard: Shard) -> PathBuf {
        self.path.join(shard.file_name())
    }

    /// Whether a shard is there, whole. A file that is not is made again.
    ///
    /// # Errors
    /// The part is of another sweep, or cannot be opened.
    pub(crate) fn has(&self, shard: Shard) -> Result<bool, ExpectedError> {
        let path = self.part(shard);
        let rows = shard.rows(self.study.targets);
        let Some(Ending { study, rows: found }) = part::ending(&path)? else { return Ok(false) };
        let there = Study::from_json(&study);
        if there.as_ref() == Some(&self.study) && found == rows.end - rows.start {
            return Ok(true);
        }
        let differs = there.map_or_else(String::new, |there| there.differs(&self.study));
        Err(ExpectedError::bad_input(&format!("{} is a part of another sweep:{differs}", path.display()))
            .next("remove it, or name another folder with --out"))
    }

    /// Goes through the rows of a part that is there, one in memory at a time; each gives the text of a column by its name, nothing for
    /// a column that is not there.
    pub(crate) fn read(
        &self,
        shard: Shard,
        mut see: impl for<'r> FnMut(&dyn Fn(&str) -> &'r str),
    ) -> Result<(), ExpectedError> {
        let path = self.part(shard);
        let damaged = |error: csv::Error| {
            ExpectedError::bad_input(&format!("{}: {error}", path.display()))
                .next("remove it, and run the command of the sweep again")
        };
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_path(&path).map_err(damaged)?;
        let names = reader.headers().map_err(damaged)?.clone();
        let mut row = csv::StringRecord::new();
        while reader.read_record(&mut row).map_err(damaged)? {
            let of = |name: &str| names.iter().position(|known| known == name).and_then(|at| row.get(at));
            see(&|name| of(name).unwrap_or_default());
        }
        Ok(())
    }

    /// Makes a shard from its rows, in order; they are taken [`BATCH_ROWS`] at a time. Returns `false` if `rows` ends early with
    /// `None`: nothing is kept then.
    pub(crate) fn make(
        &self,
        shard: Shard,
        columns: &[String],
        mut rows: impl FnMut(Range<u64>) -> Result<Option<Vec<Vec<String>>>, ExpectedError>,
    ) -> Result<bool, ExpectedError> {
        let path = self.part(shard);
        let fail = &writing(&path);
        self.remove_left_behind(shard).map_err(fail)?;
        let mut temporary = Temporary::new(&self.path, shard).map_err(fail)?;
        let mut length = 0;
        let mut write = |bytes: io::Result<Vec<u8>>| {
            let bytes = bytes?;
            length += bytes.len() as u64;
            temporary.file.write_all(&bytes).map(|()| length)
        };
        let mut written = write(part::begin(&self.study.to_line(), columns)).map_err(fail)?;
        let all = shard.rows(self.study.targets);
        let mut next = all.start;
        while next < all.end {
            let end = all.end.min(next + BATCH_ROWS);
            let Some(made) = rows(next..end)? else { return Ok(false) };
            written = write(part::lines(made.iter().map(Vec::as_slice))).map_err(fail)?;
            next = end;
        }
        write(Ok(part::end(all.end - all.start, written).into_bytes())).map_err(fail)?;
        temporary.file.sync_all().and_then(|()| fs::rename(&temporary.path, &path)).map_err(fail)?;
        Ok(true)
    }

    /// Removes what killed processes have left of a shard.
    fn remove_left_behind(&self, shard: Shard) -> io::Result<()> {
        let begin = temporary_begin(shard);
        for entry in fs::read_dir(&self.path)? {
            let entry = entry?;
            let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(&begin));
            if !ours {
                continue;
            }
            // Without a lock to be had, or on a file system without locks, it may be in use: it stays.
            let dead =
                OpenOptions::new().write(true).open(entry.path()).is_ok_and(|file| file.try_lock().is_ok());
            if dead {
                // Another process may have been faster.
                let _ = fs::remove_file(entry.path());
            }
        }
        Ok(())
    }
}

fn temporary_begin(shard: Shard) -> String {
    format!(".{}.", shard.file_name())
}

/// A number that no other process has, on any machine.
fn unique() -> u64 {
    RandomState::new().hash_one(std::process::id())
}

/// The file of a part under way; it is removed unless it has been renamed.
struct Temporary {
    path: PathBuf,
    file: File,
}

impl Temporary {
    fn new(folder: &Path, shard: Shard) -> io::Result<Self> {
        let path = folder.join(format!("{}{:016x}.tmp", temporary_begin(shard), unique()));
        let file = OpenOptions::new().write(true).create_new(true).open(&path)?;
        // Held while the file is open. A file system without locks is as good as before there were any.
        let _ = file.try_lock();
        Ok(Self { path, file })
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // After a rename there is nothing to remove.
        let _ = fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_reported_where_they_differ_only() {
        let long = |middle: &str| format!("{}{middle}{}", "a".repeat(100), "z".repeat(100));
        let (a, b) = excerpts(&long("1"), &long("22"));
        let (before, behind) = ("a".repeat(30), "z".repeat(30));
        assert_eq!((a, b), (format!("…{before}1{behind}…"), format!("…{before}22{behind}…")));
        assert_eq!(excerpts("1", "2"), ("1".to_owned(), "2".to_owned()));
        // One is the beginning of the other.
        let (a, b) = excerpts(&"ab".repeat(40), &"ab".repeat(41));
        assert!(a.len() < b.len(), "{a} {b}");
    }
}
