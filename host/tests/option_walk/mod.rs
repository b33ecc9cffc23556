//! A walk over every option of every verb of a program: each changes the result, or is refused by name. The list of options is that of
//! the program; one without a row fails.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Output;

use clap::{Arg, Command};

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Shows {
    /// The words change exit code, output or files of the verb.
    Change,
    /// The words are refused; the message names the option.
    Refusal,
    /// The option is the same as that of another verb, which has a row: same id, same help. `cubelab` has no such option.
    #[allow(dead_code)]
    SameAs(&'static str),
    /// No effect can be seen here; the words say why, or which test sees it.
    Elsewhere,
}
use Shows::{Change, Elsewhere, Refusal, SameAs};

/// Verbs (`*`: every one that has the option; the first row counts), option, what the words show, words.
pub(crate) type Row = (&'static str, &'static str, Shows, &'static str);

pub(crate) struct Walk {
    pub(crate) program: fn(&[&str]) -> Output,
    /// What the verbs are run with besides the words of a row.
    pub(crate) base: &'static [(&'static str, &'static str)],
    pub(crate) rows: &'static [Row],
    /// Verbs whose options other tests see, and which.
    pub(crate) elsewhere: &'static [(&'static str, &'static str)],
}

/// Every verb without subcommands, with its options.
fn verbs(command: &Command, name: &str, found: &mut BTreeMap<String, Command>) {
    if !command.has_subcommands() {
        found.insert(name.to_owned(), command.clone());
    }
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set() && verb.get_name() != "help") {
        let below =
            if name.is_empty() { verb.get_name().to_owned() } else { format!("{name} {}", verb.get_name()) };
        verbs(verb, &below, found);
    }
}

fn options(verb: &Command) -> impl Iterator<Item = &Arg> {
    verb.get_arguments().filter(|arg| arg.get_long().is_some_and(|long| !matches!(long, "help" | "version")))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

impl Walk {
    fn row(&self, verb: &str, option: &str) -> Option<(Shows, &'static str)> {
        let fits = |(verbs, named, ..): &&Row| {
            (*verbs == "*" || verbs.split(',').any(|known| known == verb))
                && (*named == "*" || *named == option)
        };
        self.rows.iter().find(fits).map(|(.., shows, words)| (*shows, *words))
    }

    /// What a verb does: exit code, output, names of files and what pictures and tables show; and what it says beside it.
    fn run(&self, verb: &str, places: &[(&str, &str)], words: &str) -> (i32, String, String) {
        let folder = places[0].1;
        let _ = std::fs::remove_dir_all(folder);
        std::fs::create_dir_all(folder).unwrap();
        // A later value of an option that takes one replaces that of the common words.
        let base = self.base.iter().find(|(known, _)| *known == verb).map_or("", |(_, base)| base);
        let given: Vec<&str> = words.split_whitespace().collect();
        let mut all: Vec<String> = verb.split(' ').map(str::to_owned).collect();
        let mut common = base.split_whitespace().peekable();
        while let Some(word) = common.next() {
            let name = word.split('=').next().unwrap_or(word);
            let replaced = name.starts_with("--") && given.iter().any(|g| g.split('=').next() == Some(name));
            let has_value = !word.contains('=') && common.peek().is_some_and(|next| !next.starts_with("--"));
            let value = if name.starts_with("--") && has_value { common.next() } else { None };
            if !replaced {
                all.extend([Some(word), value].into_iter().flatten().map(str::to_owned));
            }
        }
        all.extend(given.iter().map(|word| (*word).to_owned()));
        let placed =
            |word: &String| places.iter().fold(word.clone(), |word, (name, place)| word.replace(name, place));
        let all: Vec<String> = all.iter().map(placed).collect();
        let output = (self.program)(&all.iter().map(String::as_str).collect::<Vec<_>>());
        let mut files = Vec::new();
        let mut left = vec![PathBuf::from(folder)];
        while let Some(path) = left.pop() {
            for entry in std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()) {
                let is_read = entry.extension().is_some_and(|ext| ext == "csv");
                let content = if is_read { std::fs::read_to_string(&entry).unwrap() } else { String::new() };
                files.push(format!("{} {content}", entry.display()));
                left.extend(entry.is_dir().then_some(entry));
            }
        }
        files.sort();
        // Times by the wall are of no account.
        let shown = text(&output.stdout);
        let shown: Vec<&str> = shown
            .lines()
            .filter(|line| !line.contains(" s in all") && !line.contains(" s of search"))
            .collect();
        // In what is said beside it, numbers may be times.
        let said: String =
            text(&output.stderr).chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
        (
            output.status.code().unwrap(),
            format!("{}\n{said}\n{files:?}", shown.join("\n")),
            text(&output.stderr),
        )
    }

    /// Every option of every verb of `program`. `places` stand for names in words; the first is an empty folder, made anew for each run.
    pub(crate) fn require_effects(&self, program: &Command, places: &[(&str, &str)]) {
        let mut all = BTreeMap::new();
        verbs(program, "", &mut all);
        let mut plain = BTreeMap::new();
        let mut wrong = Vec::new();
        for (name, verb) in &all {
            if !verb.get_after_help().is_some_and(|help| help.to_string().contains("Example")) {
                wrong.push(format!("{name}: no example in its help"));
            }
            for option in options(verb) {
                let long = option.get_long().unwrap();
                let place = format!("{name} --{long}");
                let known = self.row(name, long);
                let elsewhere = self.elsewhere.iter().any(|(known, _)| known == name);
                match known.filter(|_| !elsewhere) {
                    None if elsewhere => {}
                    None => wrong.push(format!("{place}: no row")),
                    Some((Elsewhere, why)) => assert!(!why.is_empty(), "{place}"),
                    Some((SameAs(other), _)) => {
                        let same = options(&all[other])
                            .any(|o| o.get_id() == option.get_id() && o.get_help() == option.get_help());
                        if !same {
                            wrong.push(format!("{place}: not that of {other}, and no row"));
                        }
                    }
                    Some((Refusal, words)) => {
                        let (code, _, reported) = self.run(name, places, words);
                        if !matches!(code, 2 | 4) || !reported.contains(&format!("--{long}")) {
                            wrong.push(format!("{place}: {code} {reported}"));
                        }
                    }
                    Some((Change, words)) => {
                        let base = words.contains("--json") && long != "json";
                        let plain = plain
                            .entry((name.clone(), base))
                            .or_insert_with(|| self.run(name, places, if base { "--json" } else { "" }));
                        let (code, shown, reported) = self.run(name, places, words);
                        if (code, &shown) == (plain.0, &plain.1) {
                            wrong.push(format!("{place}: no change, {code} {reported}"));
                        }
                    }
                }
            }
        }
        assert!(wrong.is_empty(), "{} of the options:\n{}", wrong.len(), wrong.join("\n"));
    }
}
