//! Every command and option that a message, a help text or the README names exists.

use std::path::{Path, PathBuf};

use clap::{Command, CommandFactory};
use host::cli::Cli;

/// The command line as the program has it, with its verb `help`.
fn cli() -> Command {
    let mut cli = Cli::command();
    cli.build();
    cli
}

/// Sources under a folder, tests left out.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Text of the string literals of a Rust source, lines that are continued joined.
fn literals(source: &str) -> Vec<String> {
    let (mut found, mut rest) = (Vec::new(), source);
    while let Some(at) = rest.find(['"', '/', '\'']) {
        let (before, after) = rest.split_at(at);
        if after.starts_with("//") {
            rest = after.split_once('\n').map_or("", |(_, next)| next);
        } else if after.starts_with('"') && before.ends_with(['r', '#']) {
            let hashes = before.len() - before.trim_end_matches('#').len();
            let end = format!("\"{}", "#".repeat(hashes));
            let (text, next) = after[1..].split_once(&end).unwrap_or_default();
            found.push(text.to_owned());
            rest = next;
        } else if let Some(inside) = after.strip_prefix('"') {
            let mut text = String::new();
            let mut chars = inside.char_indices();
            let mut end = after.len();
            while let Some((i, c)) = chars.next() {
                match c {
                    '"' => {
                        end = i + 2;
                        break;
                    }
                    '\\' => match chars.next().map(|(_, c)| c) {
                        Some('\n') => {
                            let skipped = chars.as_str().len() - chars.as_str().trim_start().len();
                            for _ in 0..skipped {
                                chars.next();
                            }
                        }
                        Some('n') => text.push('\n'),
                        Some(other) => text.push(other),
                        None => {}
                    },
                    other => text.push(other),
                }
            }
            found.push(text);
            rest = &after[end..];
        } else if let Some(quoted) = after.strip_prefix("'\"'").or(after.strip_prefix("'\\\"'")) {
            rest = quoted;
        } else {
            rest = &after[1..];
        }
    }
    found
}

/// `--option` words of a text, without what follows them.
fn options(text: &str) -> impl Iterator<Item = &str> {
    text.match_indices("--").filter_map(|(at, _)| {
        let free = text[..at].chars().next_back().is_none_or(|c| !c.is_alphanumeric() && c != '-');
        let name = &text[at + 2..];
        let end = name
            .find(|c: char| !c.is_ascii_lowercase() && !c.is_ascii_digit() && c != '-')
            .unwrap_or(name.len());
        let name = name[..end].trim_end_matches('-');
        (free && name.len() > 1).then_some(name)
    })
}

fn has(command: &Command, option: &str) -> bool {
    matches!(option, "help" | "version") || command.get_arguments().any(|arg| arg.get_long() == Some(option))
}

/// The verb that the words of a command line name, as deep as they go; an error for one that does not exist.
fn verb<'a>(cli: &'a Command, words: &str) -> Result<&'a Command, String> {
    let mut command = cli;
    for word in words.split_whitespace() {
        let plain = !word.is_empty() && word.chars().all(|c| c.is_ascii_lowercase());
        if !plain || !command.has_subcommands() {
            break;
        }
        command = command.find_subcommand(word).ok_or_else(|| format!("no verb `{word}`"))?;
    }
    Ok(command)
}

/// Command lines in backticks, or behind `$`-less examples at the begin of a line.
fn command_lines(text: &str) -> Vec<&str> {
    let quoted = text.match_indices("`cubectl ").map(|(at, _)| {
        let rest = &text[at + 1..];
        &rest[..rest.find('`').unwrap_or(rest.len())]
    });
    let examples = text.lines().map(str::trim_start).filter(|line| line.starts_with("cubectl "));
    quoted.chain(examples).collect()
}

/// What is wrong with the command lines in `text`.
fn wrong_lines(cli: &Command, text: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    for line in command_lines(text) {
        for part in line.split("&&").flat_map(|part| part.split('|')) {
            let Some(words) = part.trim().strip_prefix("cubectl ") else { continue };
            let words = words.split('#').next().unwrap_or_default();
            match verb(cli, words) {
                Err(why) => wrong.push(format!("{line}: {why}")),
                Ok(command) => wrong.extend(
                    options(words)
                        .filter(|option| !has(command, option))
                        .map(|option| format!("{line}: {} has no --{option}", command.get_name())),
                ),
            }
        }
    }
    wrong
}

/// Packages whose messages `cubectl` prints.
const SOURCES: [&str; 4] = ["src", "planner/src", "tuner/src", "operator/src"];

#[test]
fn every_command_line_that_is_printed_can_be_given() {
    let cli = cli();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut files, mut wrong, mut seen) = (Vec::new(), Vec::new(), 0);
    for folder in SOURCES {
        sources(&root.join(folder), &mut files);
    }
    files.push(root.join("../firmware/src/fault.rs"));
    for file in &files {
        for text in literals(&std::fs::read_to_string(file).unwrap()) {
            seen += command_lines(&text).len();
            wrong
                .extend(wrong_lines(&cli, &text).into_iter().map(|why| format!("{}: {why}", file.display())));
        }
    }
    let pages = std::fs::read_dir(root.join("../docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|page| page.extension().is_some_and(|kind| kind == "md"));
    for page in pages.chain([root.join("../README.md")]) {
        let text = std::fs::read_to_string(&page).unwrap();
        wrong.extend(wrong_lines(&cli, &text).into_iter().map(|why| format!("{}: {why}", page.display())));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    // The scan finds what is there.
    assert!(seen > 60, "{seen}");
}

#[test]
fn every_option_that_a_message_names_exists_in_the_verb_that_prints_it() {
    let cli = cli();
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = package.join("src");
    let (mut files, mut wrong, mut seen) = (Vec::new(), Vec::new(), 0);
    for folder in SOURCES {
        sources(&package.join(folder), &mut files);
    }
    let all: Vec<&Command> =
        cli.get_subcommands().flat_map(|verb| std::iter::once(verb).chain(verb.get_subcommands())).collect();
    for file in &files {
        let source = std::fs::read_to_string(file).unwrap();
        let source = source.split("#[cfg(test)]").next().unwrap();
        // `cmd/throw/mod.rs`, `cmd/throw.rs`: the verb `throw`.
        let inside = file.strip_prefix(root.join("cmd")).ok();
        let name = inside.map(|path| path.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs"));
        let own = name.and_then(|name| cli.find_subcommand(name));
        for text in literals(source) {
            for option in options(&text) {
                seen += 1;
                let named = command_lines(&text);
                let named = named.iter().filter_map(|line| verb(&cli, &line[8..]).ok());
                let within =
                    |verb: &Command| has(verb, option) || verb.get_subcommands().any(|v| has(v, option));
                // A message of a shared part may come from every verb that uses it.
                let known = own.map_or_else(|| all.iter().any(|v| within(v)), within)
                    || named.into_iter().any(|verb| has(verb, option));
                if !known && !text.contains("split -l") {
                    wrong.push(format!("{}: --{option} in {text:?}", file.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(seen > 100, "{seen}");
}

#[test]
fn every_scenario_that_an_example_names_is_in_the_source_folder() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut files, mut seen) = (Vec::new(), 0);
    sources(&root.join("src"), &mut files);
    for file in &files {
        for text in literals(&std::fs::read_to_string(file).unwrap()) {
            for line in text.lines().filter(|line| line.trim_start().starts_with("cubectl ")) {
                let named =
                    line.split_once("--scenario ").map(|(_, rest)| rest.split_whitespace().next().unwrap());
                // What an example before it writes is not there yet.
                let written = |name: &str| {
                    let folder = name.split_once('/').map_or(name, |(folder, _)| folder);
                    text.contains(&format!("--out {folder}"))
                };
                if let Some(name) = named.filter(|name| !written(name)) {
                    assert!(root.join("..").join(name).exists(), "{}: {name}", file.display());
                    seen += 1;
                }
            }
        }
    }
    assert!(seen > 0);
}
