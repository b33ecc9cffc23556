//! Every command and option that a message, a help text or the README names exists.

use clap::{Command, CommandFactory};
use host::cli::{Cli, with_short_names};

use crate::command_lines::{literals_of, require_options, require_verbs, root};

/// The command line as the program has it, with its verb `help`.
fn cli() -> Command {
    let mut cli = with_short_names(Cli::command());
    cli.build();
    cli
}

/// Packages whose messages `cubectl` prints.
const SOURCES: [&str; 4] = ["host/src", "host/planner/src", "host/tuner/src", "host/operator/src"];

#[test]
fn every_command_line_that_is_printed_can_be_given() {
    let folders = [&SOURCES[..], &["firmware/src"]].concat();
    let seen = require_verbs(&cli(), &folders);
    assert!(seen > 60, "{seen}");
}

#[test]
fn every_option_that_a_message_names_exists_in_the_verb_that_prints_it() {
    let seen = require_options(&cli(), &[], "host/src/cmd", &SOURCES);
    assert!(seen > 100, "{seen}");
}

#[test]
fn every_scenario_that_an_example_names_is_in_the_source_folder() {
    let mut seen = 0;
    for (file, texts) in literals_of(&["host/src"]) {
        for text in texts {
            for line in text.lines().filter(|line| line.trim_start().starts_with("cubectl ")) {
                let named =
                    line.split_once("--scenario ").map(|(_, rest)| rest.split_whitespace().next().unwrap());
                // What an example before it writes is not there yet.
                let written = |name: &str| {
                    let folder = name.split_once('/').map_or(name, |(folder, _)| folder);
                    text.contains(&format!("--out {folder}"))
                };
                if let Some(name) = named.filter(|name| !written(name)) {
                    assert!(root().join(name).exists(), "{}: {name}", file.display());
                    seen += 1;
                }
            }
        }
    }
    assert!(seen > 0);
}
