//! Every option of every verb: it changes the result, or it is refused by name. The list of options is that of the program; one
//! without a row in [`ROWS`] fails.

use std::collections::BTreeMap;

use clap::{Command, CommandFactory};
use host::cli::Cli;

use crate::bus_common::{Folder, code, cubectl, err, out};

/// What a row shows.
#[derive(Clone, Copy, PartialEq)]
enum Shows {
    /// The words change exit code, output or files of the verb.
    Change,
    /// The words are refused; the message names the option.
    Refusal,
    /// The option is the same as that of another verb, which has a row: same id, same help.
    SameAs(&'static str),
    /// No effect can be seen here; the words say why, or which test sees it.
    Elsewhere,
}
use Shows::{Change, Elsewhere, Refusal, SameAs};

/// What the verbs are run with besides the words of a row. `{d}` is an empty folder, `{plan}` a plan.
const BASE: &[(&str, &str)] = &[
    ("throw", "--plan {plan} --out {d}/out"),
    ("plan throw", "--target 1.0,1.0,-1.0 --fast"),
    ("plan sweep", "--x 1,1,1 --z=-1,-1,1 --fast --out {d}/out"),
    ("check", "{plan}"),
    ("export", "{plan} --csv"),
    ("run", "{plan} --home"),
    ("upload", "{plan}"),
    ("jog", "3 --for 0.05"),
    ("move", "--joints 0,-60deg,-80deg,0,30deg,0 --home"),
    ("pose save", "ready --poses {d}/poses.toml"),
    ("pose remove", "ready"),
    ("unlock", "--for 5 powercube6"),
    ("record", "{d}/rec --for 0.05"),
    ("registers get", "cycle.period_us"),
    ("registers set", "joint.home_v_rad_s=0.1"),
    ("config dump", "{d}/modules.toml"),
    ("monitor", "--for 0.5"),
    ("explain", "401"),
    ("robot check", "powercube6"),
    ("robot show", "powercube6 --out {d}/arm.svg"),
    ("tune", "--joint 1 --period 3 --no-trial"),
];

/// Verbs (`*`: every one that has the option; the first row counts), option, what the words show, words.
const ROWS: &[(&str, &str, Shows, &str)] = &[
    // Plans.
    ("throw", "target", Change, "--target 1,1,-1"),
    ("throw", "plan", Change, "--plan {d}/none.json"),
    ("throw", "out", Change, "--out {d}/other"),
    ("throw", "bus", Change, "--bus can77"),
    ("throw", "approach-share", Change, "--approach-share 0.1"),
    ("throw", "tolerance", Change, "--tolerance 0.00001"),
    ("throw", "back", Change, "--back"),
    ("throw", "gains", Change, "--gains {d}/none.toml"),
    ("throw", "period", Change, "--period 10"),
    ("throw", "controller", Refusal, "--controller 10"),
    ("throw", "seed", Change, "--seed 7"),
    ("throw", "scenario", Change, "--scenario {d}/none.toml"),
    ("throw", "key-file", Change, "--key-file {d}/none.key"),
    ("throw", "robot", Change, "--robot pincher4"),
    ("throw", "rsi", Refusal, "--rsi kr-c4"),
    ("throw", "yes", Elsewhere, "nobody is asked on the bus sim; tests/throw_failures.rs"),
    ("throw", "tracker", Refusal, "--tracker 127.0.0.1:5001"),
    ("throw", "tracker-body", Refusal, "--tracker-body 1"),
    ("throw", "tracker-offset", Refusal, "--tracker-offset 0,0,1"),
    ("throw", "tracker-frames", Refusal, "--tracker-frames 10"),
    ("throw", "calibration", Refusal, "--calibration {d}/none.toml"),
    ("throw", "json", Change, "--json"),
    ("throw", "thorough", Refusal, "--thorough"),
    ("throw", "form", Refusal, "--form best"),
    ("*", "web", Elsewhere, "tests/live.rs of the operator"),
    ("*", "web-origin", Elsewhere, "tests/live.rs of the operator"),
    ("plan throw", "target", Change, "--target 1.01,1,-1"),
    ("plan throw", "form", Change, "--form paper --starts 1"),
    ("plan throw", "robot", Change, "--robot pincher4"),
    ("plan throw", "out", Change, "--out {d}/p.json"),
    ("plan throw", "report", Change, "--report {d}/p.html"),
    ("plan throw", "seed", Change, "--json --seed 9"),
    ("plan throw", "fast", Elsewhere, "stands in the common words of this table"),
    ("plan throw", "speed-use", Change, "--json --speed-use 0.97"),
    ("plan throw", "acceleration-use", Change, "--json --acceleration-use 0.79"),
    ("plan throw", "free-spin", Change, "--json --form paper --free-spin true"),
    ("plan throw", "null-delay", Change, "--json --null-delay false --starts 1"),
    ("plan throw", "delay-window", Change, "--json --delay-window 10,3"),
    ("plan throw", "clean-release", Change, "--json --clean-release false"),
    ("plan throw", "clearance-m", Change, "--json --clearance-m 0.006"),
    ("plan throw", "range-margin-rad", Change, "--json --range-margin-rad 0.021"),
    ("plan throw", "obstacle", Change, "--json --obstacle 0.3,0,0.6,0.05,0.05,0.05"),
    ("plan throw", "arrival-speed", Change, "--json --arrival-speed 6,5"),
    ("plan throw", "arrival-descent-deg", Change, "--json --arrival-descent-deg 89,80"),
    ("plan throw", "hit-radius-m", Change, "--json --hit-radius-m 0.1"),
    ("plan throw", "hit-box", Change, "--json --hit-box 0.1,0.1"),
    ("plan throw", "drag-per-m", Change, "--json --drag-per-m 0.01"),
    ("plan throw", "magnus-rad-s", Change, "--json --magnus-rad-s 0,0.1,0"),
    ("plan throw", "finger-release", Change, "--json --finger-release"),
    ("plan throw", "jitter-s", Change, "--json --jitter-s 0.004"),
    ("plan throw", "release-delays", Change, "--release-delays {d}/none.txt"),
    ("plan throw", "weights", Change, "--json --weights 1,1,1"),
    (
        "plan throw",
        "starts",
        Elsewhere,
        "with --fast only a first try that fails searches; tests/plan_lists.rs",
    ),
    ("plan throw", "time-budget", Change, "--time-budget=-1"),
    ("plan throw", "objective", Change, "--json --objective time"),
    ("plan throw", "opening-normal", Change, "--json --opening-normal=0,0,1 --opening-radius-m 0.01"),
    ("plan throw", "opening-radius-m", Change, "--json --opening-normal=0,0,1 --opening-radius-m 0.01"),
    ("plan throw", "incidence-max-deg", Refusal, "--incidence-max-deg 50"),
    ("plan throw", "target-velocity", Change, "--json --target-velocity 0.01,0,0"),
    ("plan throw", "target-course", Change, "--json --target-course 0.01,0,0"),
    ("plan throw", "radius-m", Change, "--json --radius-m 0.6,0.4"),
    ("plan throw", "elevation-deg", Change, "--json --elevation-deg 1,0"),
    ("plan throw", "flight-s", Change, "--json --flight-s 0,0"),
    ("plan throw", "duration-s", Change, "--json --duration-s=-1,9"),
    ("plan throw", "braking-ratio", Change, "--json --braking-ratio 0.31,0.3"),
    ("plan throw", "follow", Change, "--follow --form best --starts 1"),
    ("plan throw", "no-follow", Elsewhere, "says what holds for a robot with drives; tests/plan_follow.rs"),
    ("plan throw", "lag-ms", Refusal, "--lag-ms 10"),
    ("plan throw", "period", Refusal, "--period 10"),
    ("plan throw", "tilt-max-deg", Refusal, "--tilt-max-deg 3"),
    ("plan throw", "ramps-deg-s2", Refusal, "--ramps-deg-s2 100"),
    ("plan throw", "limits", Refusal, "--limits controller"),
    ("plan throw", "resolution", Refusal, "--resolution 1"),
    ("plan throw", "refine", Refusal, "--refine 1"),
    ("plan throw", "ramps", Refusal, "--ramps own"),
    ("plan throw", "criterion", Refusal, "--criterion j2"),
    ("plan throw", "weights-w", Refusal, "--weights-w 1,1,1,1,1,1"),
    ("plan throw", "weights-g", Refusal, "--weights-g 1,1"),
    ("plan sweep", "x", Change, "--x 1,1.1,0.1"),
    ("plan sweep", "y", Change, "--y 1.1,1.1,1"),
    ("plan sweep", "z", Change, "--z=-1,-0.9,0.1"),
    ("plan sweep", "targets", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "out", Change, "--out {d}/other"),
    ("plan sweep", "picture", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "shard", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "shards", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "draws", Refusal, "--draws 1000001"),
    ("plan sweep", "fast", Elsewhere, "stands in the common words of this table"),
    ("plan sweep", "summary", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "json", Elsewhere, "tests/plan_shards.rs"),
    ("plan sweep", "seed", Elsewhere, "another draw of the same search may find the same throw"),
    ("plan sweep,throw", "*", SameAs("plan throw"), ""),
    // Tables and robots.
    ("export", "csv", Elsewhere, "stands in the common words of this table"),
    ("export", "step-s", Change, "--step-s 0.1"),
    ("export", "out", Change, "--out {d}/motion.csv"),
    ("robot show", "pose-deg", Change, "--pose-deg 1,2,3,4,5,6"),
    ("robot show", "out", Change, "--out {d}/other.svg"),
    ("robot show,robot import", "force", Elsewhere, "tests/robot_verbs.rs"),
    ("robot import", "*", Elsewhere, "tests/robot_verbs.rs"),
    // Verbs of a bus.
    ("doctor", "modules", Change, "--modules 9"),
    ("doctor", "probe-29-bit", Change, "--probe-29-bit"),
    ("monitor", "listen", Change, "--listen"),
    ("monitor", "for", Change, "--for 0.9"),
    ("monitor", "period", Change, "--for 0.5 --period 0.1"),
    ("home", "*", Elsewhere, "tests/bus_verbs.rs, tests/home_verify.rs"),
    ("jog", "speed", Elsewhere, "tests/bus_verbs.rs"),
    ("jog", "for", Change, "--for 0.3"),
    ("move", "joints", Change, "--joints 0,-70deg,-80deg,0,30deg,0"),
    ("move", "by", Elsewhere, "instead of --joints; tests/move_verb.rs"),
    ("move", "to", Elsewhere, "instead of --joints; tests/move_verb.rs"),
    ("move", "pose", Elsewhere, "instead of --joints; tests/move_verb.rs"),
    ("move", "straight", Elsewhere, "with --to; tests/move_verb.rs"),
    ("move", "calibration", Elsewhere, "with --to; tests/move_verb.rs"),
    ("move", "speed-share", Change, "--speed-share 0.1"),
    ("move", "obstacle", Change, "--obstacle 0,0,1,9,9,0.5"),
    ("move", "ball", Elsewhere, "a body of the scene: tests/way.rs of the planner"),
    ("move", "way-seed", Elsewhere, "changes a way around something; tests/way.rs of the planner"),
    ("move", "dry-run", Change, "--dry-run"),
    ("move", "out", Change, "--out {d}/move.json"),
    ("move", "poses", Refusal, "--poses {d}/poses.toml"),
    ("move", "home", Elsewhere, "stands in the common words of this table"),
    ("move", "yes", Elsewhere, "nobody is asked on the bus sim; tests/job_rules.rs"),
    ("pose list", "poses", Change, "--poses {d}/other.toml"),
    ("pose remove", "poses", Elsewhere, "tests/move_verb.rs"),
    ("pose save", "poses", Elsewhere, "stands in the common words of this table"),
    ("pose save", "joints", Change, "--joints 0,-1,-1,0,0,0"),
    ("run,upload", "retime", Refusal, "--retime"),
    ("run,upload", "blend-rad", Refusal, "--blend-rad 0.1"),
    ("run,upload", "speed-share", Refusal, "--speed-share 0.1"),
    ("run", "home", Elsewhere, "stands in the common words of this table"),
    ("run", "yes", Elsewhere, "nobody is asked on the bus sim; tests/job_rules.rs"),
    ("run", "json", Elsewhere, "the arm must stand at the start of a plan; tests/throw_job.rs"),
    ("run", "start-in", Elsewhere, "tests/throw_job.rs"),
    ("run", "timeout", Elsewhere, "the arm must stand at the start of a plan"),
    ("record", "for", Change, "--for 0.2"),
    ("registers set", "file", Change, "--file {d}/none.toml"),
    ("registers set", "save", Change, "--save"),
    ("registers export", "out", Change, "--out {d}/registers.toml"),
    ("unlock", "for", Change, "--for 9"),
    ("unlock", "set", Change, "--set joint.v_max_rad_s=1"),
    ("explain", "last", Change, "--last"),
    ("config diff,config restore,config dump", "*", Elsewhere, "tests/bus_verbs.rs"),
    (
        "registers set,registers export,registers list,registers get,key set,key remove,unlock,clear,stop,explain",
        "json",
        Change,
        "--json",
    ),
    ("*", "bus", Change, "--bus can77"),
    ("*", "seed", Refusal, "--bus can77 --seed 7"),
    ("*", "scenario", Refusal, "--bus can77 --scenario {d}/none.toml"),
    ("*", "rsi", Refusal, "--rsi kr-c4"),
    ("*", "record", Change, "--record {d}/recorded"),
    ("*", "beside", Elsewhere, "alone on a bus it changes nothing; tests/bus_live.rs"),
    ("*", "key-file", Change, "--key-file {d}/none.key"),
    ("*", "controller", Change, "--controller 77"),
    ("*", "modules", Change, "--modules 2"),
    ("*", "robot", Change, "--robot {d}/none.toml"),
    ("*", "json", Change, "--json"),
];

/// Verbs whose options other tests see: they serve, listen, or run for long.
const ELSEWHERE: &[(&str, &str)] = &[
    ("catch", "tests/rally_verbs.rs, host/planner/tests/catch_rates.rs"),
    ("rally", "tests/rally_verbs.rs"),
    ("controller", "tests/bus_live.rs"),
    ("sim", "tests/bus_live.rs, tests/robot_link.rs"),
    ("swarm", "tests/swarm.rs"),
    ("tracker show", "tests of operator::tracker"),
    ("tracker calibrate", "tests of operator::tracker"),
    ("replay", "tests/throw_job.rs, tests/recordings.rs"),
    ("report", "tests/recordings.rs"),
    ("identify", "tests/identify_report.rs"),
    ("tune", "tests/robots_and_gains.rs"),
    ("man", "tests/output.rs"),
    ("explain", "tests/advice.rs"),
    ("registers set", "tests/registers.rs"),
    ("key set", "tests/registers.rs"),
    ("key remove", "tests/registers.rs"),
];

/// Every verb without subcommands, with its options.
fn verbs(command: &Command, name: &str, found: &mut BTreeMap<String, Command>) {
    if !command.has_subcommands() {
        found.insert(name.to_owned(), command.clone());
    }
    for verb in command.get_subcommands().filter(|verb| verb.get_name() != "help") {
        let below =
            if name.is_empty() { verb.get_name().to_owned() } else { format!("{name} {}", verb.get_name()) };
        verbs(verb, &below, found);
    }
}

/// The row for an option of a verb.
fn row(verb: &str, option: &str) -> Option<(Shows, &'static str)> {
    let fits = |(verbs, named, ..): &&(&str, &str, Shows, &str)| {
        (*verbs == "*" || verbs.split(',').any(|known| known == verb)) && (*named == "*" || *named == option)
    };
    ROWS.iter().find(fits).map(|(.., shows, words)| (*shows, *words))
}

fn options(verb: &Command) -> impl Iterator<Item = &clap::Arg> {
    verb.get_arguments().filter(|arg| arg.get_long().is_some_and(|long| !matches!(long, "help" | "version")))
}

/// What a verb does: exit code, output, names of files and what pictures and tables show; and what it says beside it.
fn run(verb: &str, folder: &str, plan: &str, words: &str) -> (i32, String, String) {
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir_all(folder).unwrap();
    // A later value of an option that takes one replaces that of the common words.
    let base = BASE.iter().find(|(known, _)| *known == verb).map_or("", |(_, base)| base);
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
    let all: Vec<String> = all.iter().map(|w| w.replace("{d}", folder).replace("{plan}", plan)).collect();
    let output = cubectl(&all.iter().map(String::as_str).collect::<Vec<_>>());
    let mut files = Vec::new();
    let mut left = vec![std::path::PathBuf::from(folder)];
    while let Some(path) = left.pop() {
        for entry in std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()) {
            let is_read = entry.extension().is_some_and(|ext| ext == "svg" || ext == "csv");
            let content = if is_read { std::fs::read_to_string(&entry).unwrap() } else { String::new() };
            files.push(format!("{} {content}", entry.display()));
            left.extend(entry.is_dir().then_some(entry));
        }
    }
    files.sort();
    // Times by the wall are of no account.
    let shown = out(&output);
    let shown: Vec<&str> =
        shown.lines().filter(|line| !line.contains(" s in all") && !line.contains(" s of search")).collect();
    // In what is said beside it, numbers may be times.
    let said: String = err(&output).chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
    (code(&output), format!("{}\n{said}\n{files:?}", shown.join("\n")), err(&output))
}

#[test]
fn every_option_of_every_verb_changes_the_result_or_is_refused_by_name() {
    let folder = Folder::new("every-option");
    let (work, plan) = (folder.file("work"), folder.file("plan.json"));
    let made = cubectl(&["plan", "throw", "--target", "1.0,1.0,-1.0", "--fast", "--out", &plan]);
    assert_eq!(code(&made), 0, "{}", err(&made));
    let mut all = BTreeMap::new();
    verbs(&Cli::command(), "", &mut all);
    let mut plain = BTreeMap::new();
    let mut wrong = Vec::new();
    for (name, verb) in &all {
        for option in options(verb) {
            let long = option.get_long().unwrap();
            let place = format!("{name} --{long}");
            let known = row(name, long);
            let elsewhere = ELSEWHERE.iter().any(|(known, _)| known == name);
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
                    let (code, _, told) = run(name, &work, &plan, words);
                    if !matches!(code, 2 | 4) || !told.contains(&format!("--{long}")) {
                        wrong.push(format!("{place}: {code} {told}"));
                    }
                }
                Some((Change, words)) => {
                    let base = words.contains("--json") && long != "json";
                    let plain = plain
                        .entry((name.clone(), base))
                        .or_insert_with(|| run(name, &work, &plan, if base { "--json" } else { "" }));
                    let (code, shown, told) = run(name, &work, &plan, words);
                    if (code, &shown) == (plain.0, &plain.1) {
                        wrong.push(format!("{place}: no change, {code} {told}"));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} of the options:\n{}", wrong.len(), wrong.join("\n"));
}
