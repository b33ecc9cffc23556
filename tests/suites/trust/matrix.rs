//! The matrix: kinds of faults x phases x joints, lasting and short.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Instant as WallTime;

use cell_tests::page;
use hil_sim::rng::Rng;
use hil_sim::scenario::Scenario;
use hil_sim::scenario::write::fault_lines;
use lab::trust::judge::Judge;
use lab::trust::matrix::{Entry, entries};
use lab::trust::phases::{Phase, Phases};
use lab::trust::{Bench, Evidence, Family, ReportedOutcome, Verdict};
use rayon::prelude::*;

/// Cell and nominal run of one kind of start.
struct Start {
    scenario: Scenario,
    nominal: Evidence,
    phases: Phases,
}

impl Start {
    fn new(bench: &Bench, scenario: Scenario) -> Self {
        let nominal = bench.throw(&scenario);
        let phases = Phases::of(&nominal, &bench.plan).unwrap();
        Self { scenario, nominal, phases }
    }
}

struct Matrix {
    bench: Bench,
    homed: Start,
    unhomed: Start,
}

impl Matrix {
    fn new() -> Self {
        Self::of(Family::PowerCube)
    }

    fn of(family: Family) -> Self {
        let bench = Bench::of(family).unwrap();
        let homed = Start::new(&bench, bench.scenario(1));
        let unhomed = Start::new(&bench, bench.scenario_without_zeros(1));
        Self { bench, homed, unhomed }
    }

    fn start(&self, phase: Phase) -> &Start {
        if phase.needs_homing() { &self.unhomed } else { &self.homed }
    }

    fn entries(&self) -> Vec<Entry> {
        entries(&self.bench, |phase| self.start(phase).phases.at(phase))
    }

    fn run(&self, entry: &Entry) -> (Verdict, ReportedOutcome) {
        self.run_with(self.start(entry.phase), &[entry])
    }

    fn run_with(&self, start: &Start, entries: &[&Entry]) -> (Verdict, ReportedOutcome) {
        let mut scenario = start.scenario.clone();
        scenario.faults.extend(entries.iter().map(|entry| entry.fault.clone()));
        let run = self.bench.throw(&scenario);
        let judge = Judge { arm: &self.bench.arm, nominal: &start.nominal };
        (judge.judge(&scenario, &run), run.reported)
    }
}

/// Name of the row of all runs; after every other one in the table.
const ALL: &str = "~ all";

/// Runs by outcome.
#[derive(Default)]
struct Row {
    runs: usize,
    landed: usize,
    missed: usize,
    stopped: usize,
    failed: usize,
    wrong: usize,
    silent: usize,
    excursion_rad: f64,
}

fn rows<'a, 'b>(
    results: impl Iterator<Item = (&'a str, &'b (Verdict, ReportedOutcome))>,
) -> BTreeMap<&'a str, Row> {
    let mut rows: BTreeMap<&str, Row> = BTreeMap::new();
    for (name, (verdict, reported)) in results {
        for name in [name, ALL] {
            let row = rows.entry(name).or_default();
            row.runs += 1;
            row.excursion_rad = row.excursion_rad.max(verdict.excursion_rad);
            row.silent += usize::from(verdict.silent);
            if !verdict.ok() {
                row.wrong += 1;
                continue;
            }
            match reported {
                ReportedOutcome::Landed => row.landed += 1,
                ReportedOutcome::Missed | ReportedOutcome::NotReleased => row.missed += 1,
                ReportedOutcome::Cause { .. } => row.stopped += 1,
                ReportedOutcome::Failed(_) | ReportedOutcome::Panicked(_) => row.failed += 1,
            }
        }
    }
    rows
}

fn table(rows: &BTreeMap<&str, Row>) -> String {
    let mut text = format!(
        "{:<20} {:>6} {:>7} {:>7} {:>8} {:>7} {:>6} {:>7} {:>10}\n",
        "", "runs", "landed", "missed", "stopped", "failed", "wrong", "silent", "excursion"
    );
    for (name, row) in rows {
        let _ = writeln!(
            text,
            "{name:<20} {:>6} {:>7} {:>7} {:>8} {:>7} {:>6} {:>7} {:>6.3} rad",
            row.runs,
            row.landed,
            row.missed,
            row.stopped,
            row.failed,
            row.wrong,
            row.silent,
            row.excursion_rad
        );
    }
    text
}

/// The same as a table of `docs/trust.md`.
fn page_table(rows: &BTreeMap<&str, Row>) -> String {
    let mut text =
        "| fault | runs | landed | missed | stopped | failed |\n|---|---|---|---|---|---|\n".to_owned();
    for (name, row) in rows {
        let name = name.trim_start_matches("~ ");
        let Row { runs, landed, missed, stopped, failed, .. } = row;
        let _ = writeln!(text, "| {name} | {runs} | {landed} | {missed} | {stopped} | {failed} |");
    }
    text
}

/// Rows of `docs/trust.md` that say something else than what was found.
fn stale(rows: &BTreeMap<&str, Row>) -> Vec<String> {
    let listed = page::table("The matrix");
    let is_true = |cells: &[String]| {
        rows.iter().any(|(name, row)| {
            let found = [row.landed, row.missed, row.stopped, row.failed];
            name.trim_start_matches("~ ") == cells[0]
                && cells[2..]
                    .iter()
                    .zip(found)
                    .all(|(cell, n)| page::agrees(cell, n as f64, row.runs as f64, 2.0))
        })
    };
    listed.iter().filter(|cells| !is_true(cells)).map(|cells| cells.join(" | ")).collect()
}

/// Runs the entries, prints the tables and returns the lines of the runs that went wrong, and the rows by kind.
fn run<'a>(matrix: &Matrix, entries: &'a [Entry]) -> (Vec<String>, BTreeMap<&'a str, Row>) {
    let begun = WallTime::now();
    let results: Vec<(Verdict, ReportedOutcome)> =
        entries.par_iter().map(|entry| matrix.run(entry)).collect();
    let took_s = begun.elapsed().as_secs_f64();
    let by_kind = rows(entries.iter().map(|entry| entry.variant).zip(&results));
    println!("{}", table(&by_kind));
    println!("{}", table(&rows(entries.iter().map(|entry| entry.phase.name()).zip(&results))));
    let mut failures: BTreeMap<&str, usize> = BTreeMap::new();
    for (_, reported) in &results {
        if let ReportedOutcome::Failed(why) = reported {
            *failures.entry(why).or_default() += 1;
        }
    }
    for (why, number) in failures {
        println!("failed {number} times: {why}");
    }
    let mut wrong = Vec::new();
    for (entry, (verdict, _)) in entries.iter().zip(&results) {
        if verdict.ok() {
            continue;
        }
        let rules: Vec<String> =
            verdict.findings.iter().map(|finding| format!("{:?}: {}", finding.rule, finding.what)).collect();
        wrong.push(format!(
            "{}{} | {} | reported {} | {}",
            if verdict.silent { "SILENT " } else { "" },
            entry.phase.name(),
            fault_lines(&entry.fault).join(", "),
            verdict.reported,
            rules.join("; ")
        ));
    }
    let silent = results.iter().filter(|(verdict, _)| verdict.silent).count();
    println!("{} runs in {took_s:.1} s; {} wrong, {silent} of them silent", entries.len(), wrong.len());
    (wrong, by_kind)
}

/// Every this many runs of the matrix.
fn sample(all: Vec<Entry>, step: usize) -> Vec<Entry> {
    all.into_iter().step_by(step).collect()
}

/// The two faults of each seed: of phases that one throw passes, at any joint, lasting and short.
fn pairs(matrix: &Matrix, seeds: std::ops::Range<u64>) -> Vec<String> {
    let (unhomed, homed): (Vec<Entry>, Vec<Entry>) =
        matrix.entries().into_iter().partition(|entry| entry.phase.needs_homing());
    let judged = seeds.into_par_iter().map(|seed| {
        let mut rng = Rng::stream(seed, "pair");
        let (start, entries) =
            if rng.chance(0.1) { (&matrix.unhomed, &unhomed) } else { (&matrix.homed, &homed) };
        let [first, second] = std::array::from_fn(|_| &entries[rng.below(entries.len() as u64) as usize]);
        let (verdict, _) = matrix.run_with(start, &[first, second]);
        let faults = [first, second].map(|entry| fault_lines(&entry.fault).join(", ")).join(" and ");
        (!verdict.ok()).then(|| format!("seed {seed}: {faults} | {:?}", verdict.findings))
    });
    judged.flatten().collect()
}

#[test]
fn a_sample_of_pairs_of_faults_is_reported_as_it_is_seen() {
    let wrong = pairs(&Matrix::new(), 0..20);
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
#[ignore = "minutes: run by its CI stage"]
fn two_thousand_pairs_of_faults_are_reported_as_they_are_seen() {
    let count = std::env::var("PAIRS").map_or(2_000, |text| text.parse().expect("PAIRS is a number"));
    let wrong = pairs(&Matrix::new(), 0..count);
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_sample_of_the_matrix_is_reported_as_it_is_seen() {
    let matrix = Matrix::new();
    let (wrong, _) = run(&matrix, &sample(matrix.entries(), 41));
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_sample_of_the_matrix_of_drives_that_follow_positions_is_reported_as_it_is_seen() {
    for family in Family::FOLLOWING {
        let matrix = Matrix::of(family);
        let (wrong, _) = run(&matrix, &sample(matrix.entries(), 97));
        assert!(wrong.is_empty(), "{family:?}: {wrong:#?}");
    }
}

/// The entries that `KIND`, `PHASE` and `STEP` of the environment choose. The flag is true if these are all entries.
fn chosen(matrix: &Matrix) -> (Vec<Entry>, bool) {
    let mut entries = matrix.entries();
    let number = entries.len();
    if let Ok(part) = std::env::var("KIND") {
        entries.retain(|entry| entry.variant.contains(&part));
    }
    if let Ok(part) = std::env::var("PHASE") {
        entries.retain(|entry| entry.phase.name() == part);
    }
    let step = std::env::var("STEP").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    let entries = sample(entries, step);
    let whole = entries.len() == number;
    (entries, whole)
}

#[test]
#[ignore = "long: run by hand, not by CI"]
fn every_fault_of_drives_that_follow_positions_is_reported_as_it_is_seen() {
    let mut all = Vec::new();
    let named = std::env::var("FAMILY").unwrap_or_default();
    for family in
        Family::FOLLOWING.into_iter().filter(|family| named.is_empty() || format!("{family:?}") == named)
    {
        let matrix = Matrix::of(family);
        println!("{family:?}");
        let (wrong, _) = run(&matrix, &chosen(&matrix).0);
        println!("{}", wrong.join("\n"));
        all.extend(wrong.into_iter().map(|line| format!("{family:?}: {line}")));
    }
    assert!(all.is_empty(), "{}: {all:#?}", all.len());
}

#[test]
#[ignore = "minutes: run by its CI stage"]
fn every_fault_in_every_phase_is_reported_as_it_is_seen() {
    let matrix = Matrix::new();
    let (entries, whole) = chosen(&matrix);
    let (wrong, by_kind) = run(&matrix, &entries);
    let file = concat!(env!("CARGO_TARGET_TMPDIR"), "/trust-wrong.txt");
    std::fs::write(file, wrong.join("\n") + "\n").unwrap();
    assert!(wrong.is_empty(), "{} runs went wrong, all of them are in {file}: {wrong:#?}", wrong.len());
    if whole {
        let stale = stale(&by_kind);
        assert!(
            stale.is_empty(),
            "docs/trust.md says {stale:#?}; its table is now\n{}",
            page_table(&by_kind)
        );
    }
}
