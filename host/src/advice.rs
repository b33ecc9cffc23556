//! Command lines in messages, for the bus of the command that prints them: who copies one acts on that bus, and not on the
//! simulated cell inside the program.

use std::sync::LazyLock;

use can_link::BusSpec;
use clap::parser::ValueSource;
use clap::{ArgMatches, Command, CommandFactory};
use operator::bus::BusArgs;

use crate::cli::{Cli, with_short_names};

/// What a command line in a message begins with if it acts on a bus: without `--bus` it would mean the simulated cell.
static BUS_VERBS: LazyLock<Vec<String>> = LazyLock::new(|| {
    fn with_bus(verb: &Command, path: &str, found: &mut Vec<String>) {
        if verb.get_arguments().any(|arg| arg.get_long() == Some("bus")) {
            found.push(path.trim().to_owned());
        }
        for below in verb.get_subcommands() {
            with_bus(below, &format!("{path} {}", below.get_name()), found);
        }
    }
    let mut verbs = Vec::new();
    with_bus(&with_short_names(Cli::command()), "", &mut verbs);
    // `sim` serves a bus, `tune` designs gains without one, `explain` listens to one for what happened last.
    verbs.retain(|verb| !["explain", "sim", "tune"].contains(&verb.as_str()));
    verbs.push("explain --last".to_owned());
    verbs
});

/// Verbs whose effect, or what they read, is gone with the simulated cell inside the program.
const OF_A_STATE: [&str; 8] = [
    "arm home",
    "arm jog",
    "controller clear",
    "controller key",
    "controller registers",
    "controller unlock",
    "controller upload",
    "modules",
];

/// What is said on the bus `sim` by a verb that changes or reads what a bus keeps.
const ON_SIM: &str = "the bus is the simulated cell inside this program: it begins anew with each command and ends with it; \
     `cubectl sim` in another terminal serves one that stays";

/// That nothing lasts, for a verb on the simulated cell inside the program.
#[must_use]
pub fn on_simulated_cell(matches: &ArgMatches) -> Option<&'static str> {
    let (mut path, mut verb) = (String::new(), matches);
    while let Some((name, inner)) = verb.subcommand() {
        path += if path.is_empty() { "" } else { " " };
        path += name;
        verb = inner;
    }
    let bus = verb.try_get_one::<BusSpec>("bus").ok().flatten()?;
    let of_a_state = OF_A_STATE.iter().any(|verbs| begins_with(&path, verbs));
    (of_a_state && *bus == BusSpec::Sim).then_some(ON_SIM)
}

/// Before a command line in a message.
const BEGIN: &str = "`cubectl ";

/// Bus and robot of a command line, as options to put into others; empty if it names no bus.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place(String);

impl Place {
    /// As somebody typed them.
    #[must_use]
    pub fn of_matches(matches: &ArgMatches) -> Self {
        let mut verb = matches;
        let mut server = false;
        while let Some((name, inner)) = verb.subcommand() {
            (verb, server) = (inner, name == "sim");
        }
        // `sim` serves a bus; clients reach it by the same words, but a message of it is not about them.
        if server {
            return Self::default();
        }
        let given = |id: &str| {
            let typed = matches!(verb.try_contains_id(id), Ok(true))
                && verb.value_source(id) == Some(ValueSource::CommandLine);
            let raw = typed.then(|| verb.get_raw(id)?.next()).flatten()?;
            Some(raw.to_string_lossy().into_owned())
        };
        Self::new(given("bus").as_deref(), given("robot").as_deref())
    }

    /// As a verb has them.
    #[must_use]
    pub fn of_bus(args: &BusArgs) -> Self {
        Self::new(Some(&args.bus.to_string()), args.cell.robot.as_deref())
    }

    fn new(bus: Option<&str>, robot: Option<&str>) -> Self {
        let Some(bus) = bus.filter(|bus| *bus != "sim") else { return Self::default() };
        let mut options = format!(" --bus {}", quoted(bus));
        if let Some(robot) = robot {
            options += &format!(" --robot {}", quoted(robot));
        }
        Self(options)
    }

    /// `text` with this bus in every command line that acts on one and names none.
    #[must_use]
    pub fn complete(&self, text: &str) -> String {
        let (mut text_with_bus, mut rest) = (String::with_capacity(text.len()), text);
        while let Some(at) = rest.find(BEGIN) {
            let (before, after) = rest.split_at(at + BEGIN.len());
            text_with_bus += before;
            let line = &after[..after.find('`').unwrap_or(after.len())];
            let verb = BUS_VERBS.iter().find(|verb| begins_with(line, verb));
            rest = after;
            if let Some(verb) = verb
                && !line.contains("--bus")
            {
                text_with_bus += verb;
                text_with_bus += &self.0;
                rest = &after[verb.len()..];
            }
        }
        text_with_bus + rest
    }
}

/// Whether a command line begins with the words of `verb`.
fn begins_with(line: &str, verb: &str) -> bool {
    line.strip_prefix(verb).is_some_and(|more| more.is_empty() || more.starts_with(' '))
}

pub(crate) fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-./:,@%+=".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::full_names;

    fn place(words: &[&str]) -> Place {
        Place::of_matches(&parsed(words))
    }

    fn parsed(words: &[&str]) -> ArgMatches {
        Cli::command().get_matches_from(full_names(words.iter().map(Into::into).collect()))
    }

    #[test]
    fn advice_names_the_bus_and_the_robot_of_the_command_that_gives_it() {
        let can = place(&["cubectl", "modules", "diff", "a.toml", "--bus", "can0"]);
        assert_eq!(
            can.complete(
                "`cubectl modules restore a.toml`, `cubectl home` and `cubectl throw --controller NODE-ID`"
            ),
            "`cubectl modules restore --bus can0 a.toml`, `cubectl home --bus can0` and `cubectl throw --bus can0 --controller \
             NODE-ID`"
        );
        let robot =
            place(&["cubectl", "status", "--bus", "rsi:udp://h:1?lockstep", "--robot", "my arm.toml"]);
        assert_eq!(
            robot.complete("`cubectl controller clear`"),
            "`cubectl controller clear --bus 'rsi:udp://h:1?lockstep' --robot 'my arm.toml'`"
        );
    }

    #[test]
    fn advice_about_no_bus_or_with_a_bus_stays_as_it_is() {
        let can = place(&["cubectl", "doctor", "--bus", "can0"]);
        for text in [
            "`cubectl explain 202`",
            "`cubectl controller clear --bus can1`",
            "`cubectl tune`",
            "`cubectl sim`",
            "cubectl home",
            "`cubectl ",
        ] {
            assert_eq!(can.complete(text), text);
        }
        assert_eq!(can.complete("`cubectl explain --last`"), "`cubectl explain --last --bus can0`");
        for words in [
            &["cubectl", "home"][..],
            &["cubectl", "home", "--bus", "sim"],
            &["cubectl", "plan", "check", "a.json"],
        ] {
            assert_eq!(place(words).complete("`cubectl home`"), "`cubectl home`");
        }
        let served = place(&["cubectl", "sim", "--bus", "socketcand://127.0.0.1:1/can0"]);
        assert_eq!(served.complete("`cubectl home`"), "`cubectl home`");
    }

    #[test]
    fn what_ends_with_the_command_says_so_on_the_simulated_cell_only() {
        let note = |words: &[&str]| on_simulated_cell(&parsed(words)).is_some();
        for words in [
            "home",
            "jog 3 --for-s 1",
            "controller clear",
            "controller registers set a=1",
            "controller registers export",
            "modules dump modules.toml",
            "controller unlock powercube6 --for-s 10",
        ] {
            let words: Vec<&str> = ["cubectl"].into_iter().chain(words.split(' ')).collect();
            assert!(note(&words), "{words:?}");
            assert!(!note(&[&words[..], &["--bus", "can0"]].concat()), "{words:?}");
        }
        // They name the cell in what they print.
        assert!(!note(&["cubectl", "status"]) && !note(&["cubectl", "explain", "101"]));
    }
}
