//! What a shell offers for the values of options: robots, buses of this machine, fault numbers.

use std::ffi::OsStr;
use std::path::Path;

use clap::{Arg, Command, CommandFactory};
use clap_complete::CompletionCandidate;
use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter, PathCompleter, ValueCompleter as _};
use firmware::fault::Cause;
use protocol::powercube::CubeState;

use crate::cli::with_short_names;

/// `ARPHRD_CAN`: what `/sys/class/net/NAME/type` says of a CAN interface.
const CAN_INTERFACE: &str = "280";

/// The command line of a program, with what its values can be.
#[must_use]
pub fn command<C: CommandFactory>() -> Command {
    with_values(with_short_names(crate::program::command::<C>()))
}

fn with_values(command: Command) -> Command {
    command.mut_args(with_value).mut_subcommands(with_values)
}

fn with_value(arg: Arg) -> Arg {
    match arg.get_id().as_str() {
        "robot" => arg.add(ArgValueCompleter::new(robots)),
        "bus" => arg.add(ArgValueCandidates::new(buses)),
        "rsi" => {
            arg.add(ArgValueCandidates::new(|| candidates(["kr-c2", "kr-c2-tcp", "kr-c4", "kr-c4-12ms"])))
        }
        "code" => arg.add(ArgValueCandidates::new(codes)),
        _ => arg,
    }
}

fn candidates<T: Into<std::ffi::OsString>>(values: impl IntoIterator<Item = T>) -> Vec<CompletionCandidate> {
    values.into_iter().map(CompletionCandidate::new).collect()
}

/// The built-in robots that begin so, then robot files.
fn robots(current: &OsStr) -> Vec<CompletionCandidate> {
    let begin = current.to_string_lossy();
    let built_in = robot_model::built_in_robots().into_iter().filter(|name| name.starts_with(&*begin));
    let mut found = candidates(built_in);
    let described = |path: &Path| path.extension().is_some_and(|end| end == "toml" || end == "urdf");
    found.extend(PathCompleter::any().filter(described).complete(current));
    found
}

fn buses() -> Vec<CompletionCandidate> {
    let mut found = vec![CompletionCandidate::new("sim").help(Some("the cell inside this program".into()))];
    found.extend(candidates(interfaces(Path::new("/sys/class/net"))));
    found
        .extend(candidates(adapters(Path::new("/dev")).into_iter().map(|name| format!("slcan:/dev/{name}"))));
    let served = CompletionCandidate::new("socketcand://127.0.0.1:29536/can0");
    found.push(served.help(Some("what `cubectl sim` serves".into())));
    found
}

/// Names of the CAN interfaces below `folder`, sorted.
fn interfaces(folder: &Path) -> Vec<String> {
    let is_can = |name: &String| {
        let kind = std::fs::read_to_string(folder.join(name).join("type"));
        kind.is_ok_and(|kind| kind.trim() == CAN_INTERFACE)
    };
    names(folder).into_iter().filter(is_can).collect()
}

/// Names of the serial adapters below `folder`, sorted.
fn adapters(folder: &Path) -> Vec<String> {
    let serial = |name: &String| name.starts_with("ttyACM") || name.starts_with("ttyUSB");
    names(folder).into_iter().filter(serial).collect()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

/// Fault numbers with their names, words of a module's state, and the lists.
fn codes() -> Vec<CompletionCandidate> {
    let mut found = candidates(["all", "exit", "faults"]);
    found.extend(
        Cause::TABLE
            .iter()
            .map(|info| CompletionCandidate::new(info.code.to_string()).help(Some(info.name.into()))),
    );
    found.extend(candidates(CubeState::BITS.iter().map(|info| info.name)));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a shell is offered for the last of `words`.
    fn offered(words: &[&str]) -> Vec<String> {
        let words: Vec<_> = std::iter::once("cubectl").chain(words.iter().copied()).map(Into::into).collect();
        let at = words.len() - 1;
        let found =
            clap_complete::engine::complete(&mut command::<crate::cli::Cli>(), words, at, None).unwrap();
        found.iter().map(|candidate| candidate.get_value().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn robots_buses_codes_and_choices_are_offered() {
        let table: [(&[&str], &str); 8] = [
            (&["plan", "throw", "--robot", "kr"], "kr16_2"),
            (&["status", "--robot", ""], "powercube6"),
            (&["status", "--bus", ""], "sim"),
            (&["throw", "--bus", "sock"], "socketcand://127.0.0.1:29536/can0"),
            (&["throw", "--rsi", "kr-c4-"], "kr-c4-12ms"),
            (&["explain", "50"], "502"),
            (&["explain", "COMM"], "COMM_ERROR"),
            (&["plan", "throw", "--form", ""], "paper"),
        ];
        for (words, want) in table {
            let found = offered(words);
            assert!(found.iter().any(|value| value == want), "{words:?}: {found:?}");
        }
        assert!(!offered(&["plan", "throw", "--robot", "kr"]).contains(&"powercube6".to_owned()));
    }

    #[test]
    fn can_interfaces_and_serial_adapters_are_found() {
        let folder = std::env::temp_dir().join(format!("cubectl-complete-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for (name, kind) in [("vcan0", "280\n"), ("eth0", "1\n"), ("can1", "280\n")] {
            std::fs::create_dir(folder.join(name)).unwrap();
            std::fs::write(folder.join(name).join("type"), kind).unwrap();
        }
        assert_eq!(interfaces(&folder), ["can1", "vcan0"]);
        for name in ["ttyS0", "ttyUSB3", "ttyACM0"] {
            std::fs::write(folder.join(name), "").unwrap();
        }
        assert_eq!(adapters(&folder), ["ttyACM0", "ttyUSB3"]);
        assert!(interfaces(&folder.join("nowhere")).is_empty());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
