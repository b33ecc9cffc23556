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

/// The command line of a program; every verb has `--json`, and a help for one screen.
#[must_use]
pub fn command<C: CommandFactory>() -> Command {
    let command = with_json(C::command());
    let help = format!("Print this; `{} help`, with the verb behind it, says everything", command.get_name());
    with_short_help(command, &help)
}

/// `-h` and `--help` have the first sentence of each option, and the examples. The verb `help` and the manual pages have everything.
fn with_short_help(mut command: Command, help: &str) -> Command {
    if let Some(full) = command.get_after_help().map(ToString::to_string)
        && let Some((examples, _)) = full.split_once("\n\n")
    {
        command = command.after_help(examples.to_owned()).after_long_help(full);
    }
    if !command.is_disable_help_flag_set() {
        let flag = Arg::new("help").short('h').long("help").action(ArgAction::HelpShort);
        command = command.disable_help_flag(true).arg(flag.help(help.to_owned()).help_heading(None));
    }
    let command = command.mut_args(|arg| match arg.get_help().map(ToString::to_string) {
        Some(full) if arg.get_long_help().is_none() => {
            let short = first_sentence(&full).to_owned();
            arg.help(short).long_help(full)
        }
        _ => arg,
    });
    command.mut_subcommands(|verb| with_short_help(verb, help))
}

/// Up to the first full stop that ends a sentence.
fn first_sentence(text: &str) -> &str {
    let next_is_capital =
        |end: usize| text[end + 2..].starts_with(|next: char| next.is_uppercase() || next == '`');
    text.match_indices(". ").find(|(end, _)| next_is_capital(*end)).map_or(text, |(end, _)| &text[..end])
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;

    #[test]
    fn the_short_help_of_a_throw_fits_on_a_screen_and_the_long_one_has_every_sentence() {
        let mut command = command::<Cli>();
        let throw = command.find_subcommand_mut("throw").unwrap();
        let (short, long) = (throw.render_help().to_string(), throw.render_long_help().to_string());
        assert!((30..=50).contains(&short.lines().count()), "{short}");
        assert!(short.contains("cubectl throw --plan plan.json") && !short.contains("Outcomes"), "{short}");
        assert!(long.contains("Outcomes and exit codes") && long.contains("With a seed the"), "{long}");
        let mut shown = throw.get_arguments().filter(|arg| !arg.is_hide_set());
        assert!(shown.all(|arg| short.contains(arg.get_long().unwrap_or("help"))), "{short}");
    }

    #[test]
    fn a_sentence_ends_at_a_full_stop_before_another_one() {
        assert_eq!(first_sentence("Seed, e.g. 5. Default: 1"), "Seed, e.g. 5");
        assert_eq!(first_sentence("At 0.5 m. `sim` has none"), "At 0.5 m");
        assert_eq!(first_sentence("A port, or 127.0.0.1:PORT"), "A port, or 127.0.0.1:PORT");
    }
}
