//! The program under test, run with words; and folders for its results.

use std::path::PathBuf;
use std::process::{Command, Output};

pub(crate) fn cubectl(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cubectl")).args(words).output().expect("runs")
}

/// Runs `cubectl` with the words of a line, and then with `more`.
pub(crate) fn cubectl_line(line: &str, more: &[&str]) -> Output {
    cubectl(&line.split_whitespace().chain(more.iter().copied()).collect::<Vec<_>>())
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Path of a folder that does not exist.
pub(crate) fn folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    path
}

pub(crate) fn empty_folder(name: &str) -> PathBuf {
    let path = folder(name);
    std::fs::create_dir_all(&path).expect("writable");
    path
}
