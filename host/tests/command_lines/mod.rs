//! Command lines and options that messages, help texts and pages name, against the command line of a program.

use std::path::{Path, PathBuf};

use clap::Command;

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

fn is_below(command: &Command, option: &str) -> bool {
    has(command, option) || command.get_subcommands().any(|verb| is_below(verb, option))
}

/// The verb that the words of a command line name, as deep as they go; an error for one that does not exist.
fn verb<'a>(cli: &'a Command, words: &str) -> Result<&'a Command, String> {
    let mut command = cli;
    for word in words.split_whitespace() {
        let plain = !word.is_empty() && word.chars().all(|c| c.is_ascii_lowercase());
        if !plain || !command.has_subcommands() {
            break;
        }
        let known = command.find_subcommand(word).filter(|verb| !verb.is_hide_set());
        command = known.ok_or_else(|| format!("no verb `{word}`"))?;
    }
    Ok(command)
}

/// Command lines of `program` in backticks, or behind `$`-less examples at the begin of a line: the words after its name.
fn command_lines<'a>(program: &str, text: &'a str) -> Vec<&'a str> {
    let quoted = format!("`{program} ");
    let quoted = text.match_indices(&quoted).map(|(at, begin)| {
        let rest = &text[at + begin.len()..];
        &rest[..rest.find('`').unwrap_or(rest.len())]
    });
    let examples = text.lines().filter_map(|line| line.trim_start().strip_prefix(program)?.strip_prefix(' '));
    quoted.chain(examples).collect()
}

fn wrong_lines(cli: &Command, text: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    let program = cli.get_name();
    for line in command_lines(program, text) {
        let next = line.split("&&").flat_map(|part| part.split('|')).skip(1);
        let next = next.filter_map(|part| part.trim().strip_prefix(program)?.strip_prefix(' '));
        let first = line.split("&&").flat_map(|part| part.split('|')).next();
        for words in first.into_iter().chain(next) {
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

/// The folder of all packages.
pub(crate) fn root() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.ancestors().find(|folder| folder.join("Cargo.lock").exists()).unwrap().to_owned()
}

/// The files below these folders of the repository, and the string literals of each.
pub(crate) fn literals_of(folders: &[&str]) -> Vec<(PathBuf, Vec<String>)> {
    let mut files = Vec::new();
    for folder in folders {
        sources(&root().join(folder), &mut files);
    }
    let literals = |file: PathBuf| {
        let source = std::fs::read_to_string(&file).unwrap();
        let own = source.split("#[cfg(test)]").next().unwrap();
        (file, literals(own))
    };
    files.into_iter().map(literals).collect()
}

/// Every command line of the program that the sources print, or that the pages show, can be given; how many the sources print.
pub(crate) fn require_verbs(cli: &Command, folders: &[&str]) -> usize {
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for (file, texts) in literals_of(folders) {
        for text in texts {
            seen += command_lines(cli.get_name(), &text).len();
            wrong.extend(wrong_lines(cli, &text).into_iter().map(|why| format!("{}: {why}", file.display())));
        }
    }
    let pages = std::fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.filter(|page| page.extension().is_some_and(|kind| kind == "md"));
    for page in pages.chain([root().join("README.md")]) {
        let text = std::fs::read_to_string(&page).unwrap();
        wrong.extend(wrong_lines(cli, &text).into_iter().map(|why| format!("{}: {why}", page.display())));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    seen
}

/// Every option that a message names exists in the verb of `cli` that prints it, whose file is in `cmd`, or in a command line of the
/// message, which may be of one of `others`; how many there are.
pub(crate) fn require_options(cli: &Command, others: &[Command], cmd: &str, folders: &[&str]) -> usize {
    let cmd = root().join(cmd);
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for (file, texts) in literals_of(folders) {
        // `cmd/throw/mod.rs`, `cmd/throw.rs`: the verb `throw`.
        let inside = file.strip_prefix(&cmd).ok();
        let name = inside.map(|path| path.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs"));
        let own = name.and_then(|name| cli.find_subcommand(name));
        for text in texts {
            for option in options(&text) {
                seen += 1;
                let mut named = others.iter().chain([cli]).flat_map(|cli| {
                    let lines = command_lines(cli.get_name(), &text).into_iter();
                    lines.filter_map(|words| verb(cli, words).ok())
                });
                // A message of a shared part may come from every verb that uses it.
                let known = is_below(own.unwrap_or(cli), option) || named.any(|verb| has(verb, option));
                if !known && !["split -l", "cargo run"].iter().any(|other| text.contains(other)) {
                    wrong.push(format!("{}: --{option} in {text:?}", file.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    seen
}
