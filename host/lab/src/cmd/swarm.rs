//! `cubelab swarm`

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hil_sim::scenario::{Scenario, write};
use host::cmd::print_json;
use host::error::ExpectedError;
use host::exit;
use indicatif::{ProgressBar, ProgressDrawTarget};
use operator::interrupt::interrupt;
use serde_json::json;

use crate::trust::shrink::shrink;
use crate::trust::{Swarm, Verdict};

/// Runs that one finding may take to become smaller.
const SHRINK_RUNS_MAX: usize = 150;
/// Findings that are made smaller and written; more are only counted.
const FINDINGS_MAX: usize = 50;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubelab swarm --seeds 200\n  cubelab swarm --for 10m --out found\n  cubelab swarm --scenario found/speed-17.toml         # one run, judged again\n\nEach seed draws a cell with faults, an arm that is not the model, and sometimes another host on the bus. The throw, the\ncontroller and the host job are the real ones, in virtual time. The run is judged from the simulated plant: limits, distance\nfrom the path, rest at the end, no release after a stop, and whether the reported outcome is the outcome seen. A run that breaks\na rule is made smaller and written as a scenario file.\n\nExit codes: 0 no rule was broken; 9 a rule was broken (also after Ctrl-C); 6 Ctrl-C, and nothing was found; 10 a file could\nnot be written."
)]
pub struct Args {
    /// Number of seeds [default: 100, or without bound with --for].
    #[arg(long)]
    seeds: Option<u64>,
    /// First seed.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Begin no new seed after this time: 90s, 10m, 1h.
    #[arg(long = "for", value_name = "TIME", value_parser = span)]
    time: Option<Duration>,
    /// Folder for the scenarios that break a rule; it is made when the first one is found.
    #[arg(long, default_value = "swarm-found", value_name = "DIR")]
    out: PathBuf,
    /// Run and judge this scenario only.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["seeds", "first", "time"])]
    scenario: Option<PathBuf>,
    /// Write what was found as it was drawn.
    #[arg(long)]
    no_shrink: bool,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// `90s`, `10m`, `1h`, or seconds.
fn span(text: &str) -> Result<Duration, String> {
    let unit = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(unit);
    let factor_s = match unit {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3_600.0,
        _ => return Err(format!("'{unit}' is no unit of time; write 90s, 10m or 1h")),
    };
    let count: f64 = number.parse().map_err(|_| format!("'{text}' is no time; write 90s, 10m or 1h"))?;
    let seconds = count * factor_s;
    if (1e-3..=1e7).contains(&seconds) {
        Ok(Duration::from_secs_f64(seconds))
    } else {
        Err("must be from 1 ms to 100 days".to_owned())
    }
}

/// A run that broke a rule.
struct Found {
    seed: u64,
    file: Option<PathBuf>,
    verdict: Verdict,
}

/// What all threads share.
struct Work<'a> {
    args: &'a Args,
    swarm: Swarm,
    next: AtomicU64,
    end: u64,
    until: Option<Instant>,
    stop: &'a AtomicBool,
    bar: ProgressBar,
    result: Mutex<Result<Vec<Found>, ExpectedError>>,
    judged: AtomicU64,
    broken: AtomicU64,
    silent: AtomicU64,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let stop = interrupt();
    let swarm = Swarm::new().map_err(|error| ExpectedError::new(exit::BUG, error))?;
    if let Some(path) = &args.scenario {
        return one(&swarm, path, args.json);
    }
    let begun = Instant::now();
    let seeds = args.seeds.unwrap_or(if args.time.is_some() { u64::MAX - args.first } else { 100 });
    let end = args.first.checked_add(seeds).ok_or_else(|| {
        ExpectedError::bad_input(&format!(
            "--first {} leaves no room for {seeds} seeds below {}",
            args.first,
            u64::MAX
        ))
        .next("a smaller --first")
    })?;
    let work = Work {
        args,
        swarm,
        next: AtomicU64::new(args.first),
        end,
        until: args.time.map(|time| begun + time),
        stop: &stop,
        bar: progress(args),
        result: Mutex::new(Ok(Vec::new())),
        judged: AtomicU64::new(0),
        broken: AtomicU64::new(0),
        silent: AtomicU64::new(0),
    };
    rayon::broadcast(|_| while work.step() {});
    work.bar.finish_and_clear();
    let (judged, broken) = (work.judged.into_inner(), work.broken.into_inner());
    let silent = work.silent.into_inner();
    let mut found = work.result.into_inner().unwrap_or_else(PoisonError::into_inner)?;
    found.sort_by_key(|found| found.seed);
    let took_s = begun.elapsed().as_secs_f64();
    if args.json {
        let list: Vec<_> = found.iter().map(in_json).collect();
        print_json(&json!({
            "first_seed": args.first, "seeds": judged, "wrong": broken, "silent": silent, "time_s": took_s, "found": list,
        }));
    } else {
        console::line!(
            "{judged} seeds from {}; {broken} broke a rule, {silent} of them silently",
            args.first
        );
        console::line!("{took_s:.1} s in all");
    }
    let interrupted = stop.load(Ordering::Relaxed);
    if broken > 0 {
        let place = args.out.display();
        return Err(ExpectedError::new(exit::FINDINGS, format!("{broken} of {judged} runs broke a rule"))
            .next(format!("`cubelab swarm --scenario FILE` with one of the files in {place}")));
    }
    if interrupted {
        return Err(ExpectedError::new(
            exit::INTERRUPTED,
            format!("interrupted after {judged} seeds; nothing was found"),
        ));
    }
    Ok(())
}

fn progress(args: &Args) -> ProgressBar {
    let hidden = args.json || !std::io::stderr().is_terminal();
    let bar = args.seeds.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
    if hidden {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    bar
}

/// One file, with every finding as text.
fn one(swarm: &Swarm, path: &std::path::Path, as_json: bool) -> Result<(), ExpectedError> {
    let scenario = Scenario::load(path).map_err(|error| ExpectedError::bad_input(&error))?;
    let verdict = swarm.run(&scenario);
    if as_json {
        print_json(&in_json(&Found {
            seed: scenario.seed,
            file: Some(path.to_owned()),
            verdict: verdict.clone(),
        }));
    } else {
        console::line!(
            "reported: {}; largest distance from the path {:.3} rad",
            verdict.reported,
            verdict.excursion_rad
        );
        for finding in &verdict.findings {
            console::line!("{:?}: {}", finding.rule, finding.what);
        }
    }
    if verdict.ok() {
        return Ok(());
    }
    let rules = verdict.findings.len();
    Err(ExpectedError::new(exit::FINDINGS, format!("{}: {rules} rules broken", path.display())))
}

fn in_json(found: &Found) -> serde_json::Value {
    let findings: Vec<_> = found
        .verdict
        .findings
        .iter()
        .map(|finding| json!({ "rule": format!("{:?}", finding.rule), "what": finding.what }))
        .collect();
    json!({
        "seed": found.seed, "file": found.file, "reported": found.verdict.reported, "silent": found.verdict.silent,
        "excursion_rad": found.verdict.excursion_rad, "findings": findings,
    })
}

impl Work<'_> {
    fn result(&self) -> MutexGuard<'_, Result<Vec<Found>, ExpectedError>> {
        self.result.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_over(&self) -> bool {
        self.result().is_err()
            || self.stop.load(Ordering::Relaxed)
            || self.until.is_some_and(|until| Instant::now() >= until)
    }

    /// Takes a seed; false if there is none left.
    fn step(&self) -> bool {
        if self.is_over() {
            return false;
        }
        let free = |seed: u64| (seed < self.end).then(|| seed + 1);
        let Ok(seed) = self.next.fetch_update(Ordering::Relaxed, Ordering::Relaxed, free) else {
            return false;
        };
        let scenario = match self.swarm.draw(seed) {
            Ok(scenario) => scenario,
            Err(error) => {
                self.fail(ExpectedError::new(exit::BUG, format!("seed {seed}: {error}")));
                return false;
            }
        };
        let verdict = self.swarm.run(&scenario);
        if self.stop.load(Ordering::Relaxed) {
            // The run was cut short and shows nothing.
            return false;
        }
        self.judged.fetch_add(1, Ordering::Relaxed);
        self.bar.inc(1);
        if !verdict.ok() {
            self.broken.fetch_add(1, Ordering::Relaxed);
            self.silent.fetch_add(u64::from(verdict.silent), Ordering::Relaxed);
            self.keep(seed, &scenario, verdict);
        }
        true
    }

    fn fail(&self, error: ExpectedError) {
        *self.result() = Err(error);
    }

    /// Makes the scenario smaller, writes it and says so.
    fn keep(&self, seed: u64, scenario: &Scenario, verdict: Verdict) {
        if self.result().as_ref().map_or(true, |found| found.len() >= FINDINGS_MAX) {
            return;
        }
        let Some(rule) = verdict.findings.first().map(|finding| finding.rule) else { return };
        let mut smallest = scenario.clone();
        let mut last = verdict;
        if !self.args.no_shrink {
            self.bar.set_message(format!("seed {seed} broke a rule; looking for the smallest scenario"));
            smallest = shrink(scenario, SHRINK_RUNS_MAX, &mut |candidate| {
                let verdict = self.swarm.run(candidate);
                // A run that Ctrl-C cut short shows nothing.
                let fails = !self.stop.load(Ordering::Relaxed)
                    && verdict.findings.iter().any(|finding| finding.rule == rule);
                if fails {
                    last = verdict;
                }
                fails
            });
        }
        let name = format!("{rule:?}-{seed}").to_lowercase();
        smallest.name.clone_from(&name);
        let mut comments =
            vec![format!("Found by `cubelab swarm`, seed {seed}. Reported: {}", last.reported)];
        comments.extend(last.findings.iter().map(|finding| format!("{:?}: {}", finding.rule, finding.what)));
        let file = self.args.out.join(format!("{name}.toml"));
        let written = std::fs::create_dir_all(&self.args.out)
            .and_then(|()| std::fs::write(&file, write::scenario(&smallest, &comments)));
        if let Err(error) = written {
            return self.fail(ExpectedError::output(&file, &error));
        }
        if !self.args.json {
            let what = last.findings.iter().find(|finding| finding.rule == rule).map_or("", |f| &f.what);
            self.bar.suspend(|| {
                console::line!(
                    "seed {seed}: {rule:?}: {what}; reported {}; {}",
                    last.reported,
                    file.display()
                );
            });
        }
        if let Ok(found) = &mut *self.result() {
            found.push(Found { seed, file: Some(file), verdict: last });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_their_units() {
        assert_eq!(span("10m"), Ok(Duration::from_secs(600)));
        assert_eq!(span("90s"), Ok(Duration::from_secs(90)));
        assert_eq!(span("1.5h"), Ok(Duration::from_secs(5_400)));
        assert_eq!(span("3"), Ok(Duration::from_secs(3)));
        for bad in ["", "m", "10x", "-1s", "nan", "1e9h"] {
            assert!(span(bad).is_err(), "{bad}");
        }
    }
}
