//! Every option of every verb of `cubelab`: it changes the result, or it is refused by name.

use clap::CommandFactory;
use lab::cli::Cli;

use crate::option_walk::Shows::{Change, Elsewhere, Refusal};
use crate::option_walk::{Row, Walk};

const BASE: &[(&str, &str)] = &[
    ("rally", "--throws 1 --json"),
    ("place", "--throws 2 --tries 1 --json"),
    ("swarm", "--seeds 1 --out {d}/found"),
    ("completions", "bash"),
];

const ROWS: &[Row] = &[
    ("rally", "throws", Change, "--throws 2"),
    ("rally", "eyes-only", Change, "--eyes-only"),
    ("rally", "cell", Change, "--cell {d}/none.toml"),
    ("rally", "hand", Change, "--hand matched"),
    ("rally", "jerk", Change, "--jerk"),
    ("rally", "restitution", Change, "--restitution 0.95"),
    ("rally", "fault", Change, "--fault not-released"),
    ("rally", "seed", Change, "--seed 2"),
    ("rally", "study", Refusal, "--study 1"),
    ("rally", "only", Refusal, "--only degraded"),
    ("rally", "bus-thrower", Refusal, "--bus-thrower can77"),
    ("rally", "bus-catcher", Refusal, "--bus-catcher can77"),
    ("rally", "tracker", Refusal, "--tracker 127.0.0.1:5001"),
    ("rally", "yes", Refusal, "--yes"),
    ("rally", "period", Refusal, "--period 10"),
    ("rally", "record", Change, "--record {d}/recorded"),
    ("rally", "calibration-thrower", Refusal, "--calibration-thrower {d}/none.toml"),
    ("rally", "calibration-catcher", Refusal, "--calibration-catcher {d}/none.toml"),
    ("rally", "report", Change, "--report {d}/rally.html"),
    ("rally", "json", Elsewhere, "stands in the common words of this table"),
    ("place", "cell", Change, "--cell {d}/none.toml"),
    ("place", "hand", Change, "--hand matched"),
    ("place", "jerk", Change, "--jerk"),
    ("place", "restitution", Change, "--restitution 0.95"),
    ("place", "fault", Change, "--fault not-released"),
    ("place", "seed", Change, "--seed 2"),
    ("place", "distance-m", Change, "--distance-m 2.2"),
    ("place", "yaw-deg", Refusal, "--yaw-deg 400"),
    ("place", "height-m", Refusal, "--height-m 4"),
    ("place", "one-way", Change, "--one-way"),
    ("place", "throws", Change, "--throws 3"),
    ("place", "tries", Refusal, "--tries 20000"),
    ("place", "out", Change, "--out {d}/placed.toml"),
    ("place", "json", Elsewhere, "stands in the common words of this table"),
    ("swarm", "seeds", Change, "--seeds 2"),
    ("swarm", "first", Change, "--first 1"),
    ("swarm", "for", Refusal, "--for 10x"),
    ("swarm", "out", Elsewhere, "only a finding is written"),
    ("swarm", "scenario", Refusal, "--scenario {d}/none.toml"),
    ("swarm", "no-shrink", Elsewhere, "only a finding is made smaller"),
    ("swarm", "json", Change, "--json"),
];

#[test]
fn every_option_of_every_verb_changes_the_result_or_is_refused_by_name() {
    let work = crate::empty_folder("every-option");
    let walk = Walk { program: crate::run, base: BASE, rows: ROWS, elsewhere: &[] };
    walk.require_effects(&Cli::command(), &[("{d}", work.to_str().unwrap())]);
}
