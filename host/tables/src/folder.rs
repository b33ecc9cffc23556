//! The folder of a sweep: `study.json` says what it is of, each shard is a part file.
//!
//! A part is written under a temporary name and renamed when all of it is on the disk. The writer holds a lock on the temporary
//! file, so that what a killed process has left behind is told from what a living one writes. Two processes that make the same
//! shard write the same bytes; whoever is later replaces the file by itself.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::TableError;
use crate::part::{self, Ending, GROUP_ROWS, PartWriter};
use crate::row::Row;
use crate::shard::Shard;

/// Name of the file that says what a folder is of.
pub const STUDY_FILE: &str = "study.json";
/// Longest such file that is read, bytes.
const STUDY_MAX_BYTES: u64 = 1 << 20;

/// What a sweep is of: everything its results follow from, by name. Two sweeps are the same if all of it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Study {
    words: BTreeMap<String, String>,
    targets: u64,
    shards: u32,
    joints: usize,
}

impl Study {
    /// A sweep to so many targets in so many shards, with an arm of `joints` joints. `words` are the rest, by name.
    #[must_use]
    pub fn new(words: BTreeMap<String, String>, targets: u64, shards: u32, joints: usize) -> Self {
        let mut all = words;
        all.insert("targets".to_owned(), targets.to_string());
        all.insert("shards".to_owned(), shards.to_string());
        all.insert("joints".to_owned(), joints.to_string());
        Self { words: all, targets, shards, joints }
    }

    /// The text of the file: JSON, names in alphabetical order.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Maps of texts can be written.
        serde_json::to_string_pretty(&self.words).unwrap_or_default() + "\n"
    }

    /// From the text of the file; `None` if it is of something else.
    #[must_use]
    pub fn from_json(text: &str) -> Option<Self> {
        let words: BTreeMap<String, String> = serde_json::from_str(text).ok()?;
        let (targets, shards) = (words.get("targets")?.parse().ok()?, words.get("shards")?.parse().ok()?);
        let joints = words.get("joints")?.parse().ok()?;
        Shard::new(1, shards)?;
        Some(Self { words, targets, shards, joints })
    }

    /// Its targets.
    #[must_use]
    pub fn targets(&self) -> u64 {
        self.targets
    }

    /// Its shards.
    #[must_use]
    pub fn shards(&self) -> u32 {
        self.shards
    }

    fn differs(&self, asked: &Self) -> String {
        differs(&self.words, &asked.words)
    }
}

/// What differs between what made the rows and what is asked for, a line for each name.
fn differs(there: &BTreeMap<String, String>, asked: &BTreeMap<String, String>) -> String {
    let names: BTreeSet<&String> = there.keys().chain(asked.keys()).collect();
    let nothing = "nothing".to_owned();
    let mut lines = String::new();
    for name in names {
        let (there, asked) = (there.get(name), asked.get(name));
        if there != asked {
            let (there, asked) = excerpts(there.unwrap_or(&nothing), asked.unwrap_or(&nothing));
            lines += &format!("\n  {name}: {there} there, {asked} asked for");
        }
    }
    lines
}

/// Refuses to continue a table with rows that were made with other words; `words` are everything that rows follow from, by name. They
/// stand in `TABLE.study.json` beside the table; for one without rows they are written.
///
/// # Errors
/// The rows were made with other words or nobody says with which, or the file cannot be read or written.
pub fn claim_table(table: &Path, empty: bool, words: &BTreeMap<String, String>) -> Result<(), TableError> {
    let file = table.with_extension(STUDY_FILE);
    if empty {
        let text = serde_json::to_string_pretty(words).unwrap_or_default() + "\n";
        return replace(&file, &text).map_err(TableError::writing(&file));
    }
    let text = match study_text(&file) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
        Err(error) => return Err(TableError::reading(&file)(error)),
    };
    let there: BTreeMap<String, String> = serde_json::from_str(&text).unwrap_or_default();
    if there == *words {
        return Ok(());
    }
    let why = if there.is_empty() {
        format!("\n  {} does not say what made them", file.display())
    } else {
        differs(&there, words)
    };
    Err(TableError::Refused(format!(
        "{} has rows that were made otherwise:{why}\n  next: name another file with --out, or remove this one",
        table.display()
    )))
}

/// The text of a study file; nothing for one that is too long.
fn study_text(file: &Path) -> io::Result<String> {
    if fs::metadata(file)?.len() > STUDY_MAX_BYTES { Ok(String::new()) } else { fs::read_to_string(file) }
}

/// Puts a file in place, whole.
fn replace(file: &Path, text: &str) -> io::Result<()> {
    let temporary = file.with_extension(format!("{:016x}.tmp", unique()));
    let written = fs::write(&temporary, text).and_then(|()| fs::rename(&temporary, file));
    if written.is_err() {
        // That it cannot be removed either would change nothing.
        let _ = fs::remove_file(&temporary);
    }
    written
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

/// The folder of a sweep.
#[derive(Debug, Clone)]
pub struct Folder {
    path: PathBuf,
    study: Study,
    text: String,
}

impl Folder {
    /// The folder for a sweep; it is made if it is not there.
    ///
    /// # Errors
    /// It belongs to another sweep, or cannot be read or written.
    pub fn for_study(path: &Path, study: Study) -> Result<Self, TableError> {
        fs::create_dir_all(path).map_err(TableError::writing(path))?;
        let (file, text) = (path.join(STUDY_FILE), study.to_json());
        let folder = Self { path: path.to_owned(), study, text };
        if !file.exists() {
            folder.claim(&file).map_err(TableError::writing(&file))?;
        }
        let there = Self::open(path)?;
        if there.study != folder.study {
            return Err(TableError::Refused(format!(
                "{} has the parts of another sweep:{}\n  next: name another folder with --out, or remove this one",
                path.display(),
                there.study.differs(&folder.study)
            )));
        }
        Ok(folder)
    }

    /// The folder of a sweep that is there.
    ///
    /// # Errors
    /// There is none, or its [`STUDY_FILE`] cannot be read.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let file = path.join(STUDY_FILE);
        let refuse = |why: &str| {
            TableError::Refused(format!(
                "{}: {why}\n  next: name the folder that `cubectl plan sweep --shards N --out FOLDER` has made",
                file.display()
            ))
        };
        let text = match study_text(&file) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Err(refuse("there is no sweep here"));
            }
            Err(error) => return Err(TableError::reading(&file)(error)),
        };
        let study = Study::from_json(&text).ok_or_else(|| refuse("does not say what the sweep is of"))?;
        Ok(Self { path: path.to_owned(), study, text })
    }

    /// Puts the study file in place, whole; a file that another process has put there first stays.
    fn claim(&self, file: &Path) -> io::Result<()> {
        let temporary = self.path.join(format!(".{STUDY_FILE}.{:016x}.tmp", unique()));
        let claimed =
            fs::write(&temporary, &self.text).and_then(|()| match fs::hard_link(&temporary, file) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(()),
                // A file system without links: the first of several at the same moment may lose, and is then refused.
                Err(_) => fs::rename(&temporary, file),
                Ok(()) => Ok(()),
            });
        // After a rename there is nothing to remove.
        let _ = fs::remove_file(&temporary);
        claimed
    }

    /// What it is of.
    #[must_use]
    pub fn study(&self) -> &Study {
        &self.study
    }

    /// The file of a shard.
    #[must_use]
    pub fn part(&self, shard: Shard) -> PathBuf {
        self.path.join(shard.file_name())
    }

    /// Whether a shard is there, whole. A file that is not is made again.
    ///
    /// # Errors
    /// The part is of another sweep, or cannot be opened.
    pub fn has(&self, shard: Shard) -> Result<bool, TableError> {
        let path = self.part(shard);
        let rows = shard.rows(self.study.targets);
        match part::ending(&path)? {
            None => Ok(false),
            Some(Ending { study, rows: found }) if study == self.text && found == rows.end - rows.start => {
                Ok(true)
            }
            Some(Ending { study, .. }) => {
                let differs =
                    Study::from_json(&study).map_or_else(String::new, |study| study.differs(&self.study));
                Err(TableError::Refused(format!(
                    "{} is a part of another sweep:{differs}\n  next: remove it, or name another folder with --out",
                    path.display()
                )))
            }
        }
    }

    /// Makes a shard from its rows, in order; they are taken [`GROUP_ROWS`] at a time. Returns `false` if `rows` ends early with
    /// `None`: nothing is kept then.
    ///
    /// # Errors
    /// Writing fails, or making the rows does.
    pub fn make<E: From<TableError>>(
        &self,
        shard: Shard,
        mut rows: impl FnMut(std::ops::Range<u64>) -> Result<Option<Vec<Row>>, E>,
    ) -> Result<bool, E> {
        let path = self.part(shard);
        let fail = |error| E::from(TableError::writing(&path)(error));
        self.remove_left_behind(shard).map_err(fail)?;
        let mut temporary = Temporary::new(&self.path, shard).map_err(fail)?;
        let file =
            temporary.file.take().ok_or_else(|| fail(io::Error::other("the file was taken already")))?;
        let mut writer =
            PartWriter::new(BufWriter::new(file), self.study.joints, &self.text).map_err(fail)?;
        let all = shard.rows(self.study.targets);
        let mut next = all.start;
        while next < all.end {
            let end = all.end.min(next + GROUP_ROWS as u64);
            let Some(made) = rows(next..end)? else { return Ok(false) };
            writer.write(&made).map_err(fail)?;
            next = end;
        }
        let file =
            writer.finish().and_then(|buffer| buffer.into_inner().map_err(Into::into)).map_err(fail)?;
        file.sync_all().and_then(|()| fs::rename(&temporary.path, &path)).map_err(fail)?;
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
    file: Option<File>,
}

impl Temporary {
    fn new(folder: &Path, shard: Shard) -> io::Result<Self> {
        let path = folder.join(format!("{}{:016x}.tmp", temporary_begin(shard), unique()));
        let mut file = OpenOptions::new().write(true).create_new(true).open(&path)?;
        // Held while the file is open. A file system without locks is as good as before there were any.
        let _ = file.try_lock();
        file.flush()?;
        Ok(Self { path, file: Some(file) })
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
    fn long_texts_are_told_where_they_differ_only() {
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
