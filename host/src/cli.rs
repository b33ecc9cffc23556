//! Command line of `cubectl`: which verb, with which arguments.

use std::ffi::OsString;

use clap::{Command, Parser};

use crate::cmd::Verb;
use crate::error::ExpectedError;
use crate::program;

/// Environment variable by which a completion script asks this program.
pub const COMPLETE_VARIABLE: &str = "CUBECTL_COMPLETE";

/// Plan, check and run throws with PowerCube arms.
#[derive(Debug, Parser)]
#[command(name = "cubectl", version, about, after_help = program::after_help(EXAMPLES))]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const EXAMPLES: &str = "Examples:
  cubectl plan throw --target 1.0,1.0,-1.0 --report plan.html
  cubectl doctor --bus can0                      # what is wrong, and what to do
  cubectl home --bus can0 && cubectl jog 6 --bus can0
  cubectl log report throw1                      # look at a recorded run

The bus is `sim` unless --bus says otherwise: a simulated cell inside this program, in virtual time.

Short names: doctor, home, jog, status and stop, without `arm`.";

/// Short names of verbs: a hand in a hurry types them.
pub(crate) const SHORT_NAMES: [(&str, &str); 5] = [
    ("doctor", "arm doctor"),
    ("home", "arm home"),
    ("jog", "arm jog"),
    ("status", "arm status"),
    ("stop", "arm stop"),
];

/// Names that verbs had in version 0.1.
const OLD_NAMES: [(&str, &str); 15] = [
    ("check", "plan check"),
    ("clear", "controller clear"),
    ("config", "modules"),
    ("export", "plan export"),
    ("identify", "arm identify"),
    ("key", "controller key"),
    ("monitor", "arm monitor"),
    ("pose", "arm pose"),
    ("record", "log record"),
    ("registers", "controller registers"),
    ("replay", "log replay"),
    ("report", "log report"),
    ("scan", "arm status"),
    ("unlock", "controller unlock"),
    ("upload", "controller upload"),
];

/// The command line with short names as verbs of their own: for completion, which sees no full names.
#[must_use]
pub fn with_short_names(command: Command) -> Command {
    let find = |(short, full): &(&'static str, &str)| {
        let verb = full.split(' ').try_fold(&command, |verb, word| verb.find_subcommand(word));
        verb.map(|verb| verb.clone().name(*short))
    };
    let short: Vec<Command> = SHORT_NAMES.iter().filter_map(find).collect();
    command.subcommands(short)
}

/// The words of a command line with the verb's full name; an old name is noted on standard error.
pub fn full_names(mut words: Vec<OsString>) -> Vec<OsString> {
    let at = if words.get(1).is_some_and(|word| word == "help") { 2 } else { 1 };
    let Some(name) = words.get(at).and_then(|word| word.to_str()) else { return words };
    let named = |names: &[(&str, &'static str)]| {
        names.iter().find(|(short, _)| *short == name).map(|(_, full)| *full)
    };
    // Version 0.1 had no verbs below it.
    let is_bare = (at, name) == (1, "controller")
        && words
            .get(2)
            .is_none_or(|word| word.to_str().is_some_and(|word| word.starts_with("--") && word != "--help"));
    let old = named(&OLD_NAMES).or(is_bare.then_some("controller run"));
    if let Some(full) = old {
        console::note!("`cubectl {name}` is `cubectl {full}` now");
    }
    if let Some(full) = old.or_else(|| named(&SHORT_NAMES)) {
        words.splice(at..=at, full.split(' ').map(OsString::from));
    }
    words
}

pub fn run(cli: Cli) -> Result<(), ExpectedError> {
    cli.verb.run()
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    fn named(line: &str) -> String {
        let words = full_names(line.split(' ').map(OsString::from).collect());
        words.iter().map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn short_and_old_names_lead_to_verbs_that_are_there() {
        for (name, full) in SHORT_NAMES.iter().chain(&OLD_NAMES) {
            assert_eq!(named(&format!("cubectl {name} --json")), format!("cubectl {full} --json"));
            assert_eq!(named(&format!("cubectl help {name}")), format!("cubectl help {full}"));
            let mut verb = &Cli::command();
            for word in full.split(' ') {
                verb = verb.find_subcommand(word).unwrap_or_else(|| panic!("{full}"));
            }
            assert!(Cli::command().find_subcommand(name).is_none(), "{name} is a verb");
        }
    }

    #[test]
    fn a_controller_without_a_verb_is_run_as_in_version_0_1() {
        assert_eq!(named("cubectl controller"), "cubectl controller run");
        assert_eq!(named("cubectl controller --bus can0"), "cubectl controller run --bus can0");
        for line in [
            "cubectl controller --help",
            "cubectl controller clear",
            "cubectl help controller",
            "cubectl throw --plan home",
            "cubectl",
            "cubectl help",
        ] {
            assert_eq!(named(line), line);
        }
    }
}
