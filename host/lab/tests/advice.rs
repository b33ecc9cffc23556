//! Every command and option that a message or a help text of the lab names exists.

use clap::{Command, CommandFactory};
use host::cli::with_short_names;

use crate::command_lines::{require_options, require_verbs};

/// Command line of `cubectl`, with its short names and its verb `help`.
fn cubectl() -> Command {
    let mut cli = with_short_names(host::cli::Cli::command());
    cli.build();
    cli
}

const SOURCES: [&str; 1] = ["host/lab/src"];

#[test]
fn every_command_line_that_is_printed_can_be_given() {
    let seen = [lab::cli::Cli::command(), cubectl()].map(|cli| require_verbs(&cli, &SOURCES));
    assert!(seen[0] > 8, "{seen:?}");
}

#[test]
fn every_option_that_a_message_names_exists_in_the_verb_that_prints_it() {
    let seen = require_options(&lab::cli::Cli::command(), &[cubectl()], "host/lab/src/cmd", &SOURCES);
    assert!(seen > 20, "{seen}");
}
