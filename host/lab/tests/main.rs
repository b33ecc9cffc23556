//! The tests of this package as one program: it is linked once.

mod advice;
mod catch_bounce;
mod catch_degradation;
mod catch_truth;
#[path = "../../tests/command_lines/mod.rs"]
mod command_lines;
mod every_option;
#[path = "../../tests/option_walk/mod.rs"]
mod option_walk;
mod placing;
mod rally;
mod rally_verbs;
mod swarm;

use std::path::PathBuf;
use std::process::{Command, Output};

/// Runs `cubelab` with the words of a text.
fn cubelab(words: &str) -> Output {
    run(&words.split_whitespace().collect::<Vec<_>>())
}

fn run(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cubelab")).args(words).output().unwrap()
}

/// Path of an empty folder.
fn empty_folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}
