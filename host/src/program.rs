//! What surrounds the verbs of a program, `cubectl` and `cubelab`: completions, the command line, and how it ends.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Arg, ArgAction, ArgMatches, Command, CommandFactory, FromArgMatches};
use clap_complete::CompleteEnv;

use crate::advice::{self, Place};
use crate::cmd::{meaning, print_json};
use crate::error::ExpectedError;
use crate::{complete, exit};

/// Runs the program with the command line `C` and its `words`. `complete_variable` is the environment variable by which its completion script asks it.
pub fn run<C: CommandFactory + FromArgMatches>(
    words: Vec<OsString>,
    complete_variable: &'static str,
    verb: fn(C) -> Result<(), ExpectedError>,
) -> ExitCode {
    // Ends the program if a shell asks for completions.
    CompleteEnv::with_factory(complete::command::<C>).var(complete_variable).complete();
    let mut command = command::<C>();
    let parsed = command.try_get_matches_from_mut(words);
    let (matches, cli) = match parsed.and_then(|matches| Ok((C::from_arg_matches(&matches)?, matches))) {
        Ok((cli, matches)) => (matches, cli),
        Err(error) => return not_understood(&error),
    };
    let ended = meaning::require_on_bus(&command, &matches).and_then(|()| {
        if let Some(note) = advice::on_simulated_cell(&matches) {
            console::note!("{note}");
        }
        verb(cli)
    });
    match ended.and_then(|()| output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let error = error.on(&Place::of_matches(&matches));
            if is_json(&matches) && !console::has_begun() {
                print_json(&error.json());
            }
            console::note!("{}: {}", command.get_name(), error);
            ExitCode::from(error.code)
        }
    }
}

/// The command line of a program; every verb has `--json`.
#[must_use]
pub fn command<C: CommandFactory>() -> Command {
    with_json(C::command())
}

fn with_json(command: Command) -> Command {
    if command.has_subcommands() {
        return command.mut_subcommands(with_json);
    }
    if command.is_disable_help_flag_set() || command.get_arguments().any(|arg| arg.get_id() == JSON) {
        return command;
    }
    let help = "Write a failure to standard output as a JSON object: code, what, next";
    command.arg(Arg::new(JSON).long(JSON).action(ArgAction::SetTrue).help(help))
}

/// Id and name of the option.
const JSON: &str = "json";

fn is_json(matches: &ArgMatches) -> bool {
    let mut verb = matches;
    while let Some((_, inner)) = verb.subcommand() {
        verb = inner;
    }
    verb.try_get_one::<bool>(JSON).ok().flatten().copied().unwrap_or_default()
}

/// Ends a command line that is wrong, or that asks for help.
fn not_understood(error: &clap::Error) -> ExitCode {
    if error.use_stderr() && std::env::args_os().any(|word| word == "--json") {
        let text = error.render().to_string();
        let what = text.split("\n\n").next().unwrap_or_default().trim_start_matches("error: ");
        let next = "`--help` behind the verb lists its options";
        let code = error.exit_code();
        print_json(&serde_json::json!({ "code": code, "what": what, "next": [next] }));
    }
    // A reader that left is no error.
    let _ = error.print();
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(exit::BUG))
}

/// Whether everything that was written to standard output is there.
///
/// # Errors
/// Part of it could not be written, as to a full disk. A closed reader is no error.
fn output_is_whole() -> Result<(), ExpectedError> {
    console::lost().map_or(Ok(()), |error| {
        Err(ExpectedError::new(exit::OUTPUT, format!("standard output is not whole: {error}"))
            .next("free space where it goes to, and run again"))
    })
}

/// What stands below the list of verbs: examples and exit codes.
pub fn after_help(examples: &str) -> String {
    let mut text = format!("{examples}\n\nExit codes:\n");
    for (code, meaning, _) in exit::TABLE {
        text += &format!("  {code:2}  {meaning}\n");
    }
    text + "`cubectl explain exit` says what to do next."
}
