//! From which starts a disc is caught: by the rule of paper 001 without joint limits, and by the planner within the
//! limits of the robot file, only at the places of its grid. The observer (`witness`) judges every catch.
//!
//!     cargo run -p planner --release --example disc_map [FILE.csv]
//!
//! Prints figures and writes a table (default `disc_map.csv`): a row for each start.

use std::fmt::Write as _;
use std::process::ExitCode;

use nalgebra::Vector3;
use planner::disc::arm::{DiscArm, READY_RAD};
use planner::disc::flight::Path;
use planner::disc::intercept::local::Effort;
use planner::disc::intercept::{self, Decline, Settings};
use planner::disc::paper::{self, Reading, Throw};
use planner::disc::witness::{self, Gripper, Rule, Verdict, judge};
use planner::motion_law::State;
use rayon::prelude::*;
use robot_model::RobotModel;

/// Horizontal grid of starts, m.
const X_M: (i32, i32) = (-12, 12);
const Y_M: (i32, i32) = (-24, 4);
const STEP_M: f64 = 0.1;

/// What came of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Caught,
    /// The rule says captured, but the observer sees that the gripper is not there or that the disc was hit.
    Refuted,
    /// The rule never comes to its end.
    Never,
    OutOfReach,
    TooFast,
    TooLate,
    Touches,
}

impl Outcome {
    const fn name(self) -> &'static str {
        match self {
            Self::Caught => "caught, the observer agrees",
            Self::Refuted => "captured by the rule, refuted by the observer",
            Self::Never => "never in reach",
            Self::OutOfReach => "declined: out of reach or range",
            Self::TooFast => "declined: too fast to follow",
            Self::TooLate => "declined: too late",
            Self::Touches => "declined: would touch the disc",
        }
    }
}

/// One start.
struct Judged {
    rule: (Outcome, bool),
    fast: Outcome,
    plan: Outcome,
}

/// The paper demands up to 40 rad/s of joints that turn at 6.18 rad/s.
const FAST: f64 = 6.0;

fn arm() -> Result<DiscArm, String> {
    let model = RobotModel::load("pincher4").map_err(|e| e.to_string())?;
    DiscArm::new(model).map_err(|e| e.to_string())
}

/// By the rule of the paper, one second at most; the second value: no joint faster than its limit.
fn by_rule(arm: &DiscArm, throw: &Throw) -> (Outcome, bool) {
    let run = paper::run(arm, throw, &Reading { steps: 100, ..Reading::default() });
    if run.captured.is_none() {
        return (Outcome::Never, false);
    }
    let verdict = judge(arm, &Gripper::default(), &Rule::of_paper(arm), &run.moments());
    let outcome = if verdict.caught.is_some() { Outcome::Caught } else { Outcome::Refuted };
    (outcome, verdict.within_limits(arm))
}

fn witnessed(arm: &DiscArm, plan: &intercept::Plan, path: &Path) -> Verdict {
    let moments = witness::moments(|t_s| plan.motion.q(t_s), path, plan.motion.end_s());
    judge(arm, &Gripper::default(), &Rule::default(), &moments)
}

/// By the planner, judged by the observer; limits of the robot file times `limit_scale`.
fn planned(arm: &DiscArm, throw: &Throw, limit_scale: f64) -> Outcome {
    let path = Path::parabola(throw, 1.5);
    let rest = READY_RAD.map(State::rest);
    match intercept::plan(
        arm,
        &path,
        &rest,
        &Settings { limit_scale, between: Effort::NOT_AT_ALL, ..Settings::default() },
    ) {
        Ok(plan) => {
            let verdict = witnessed(arm, &plan, &path);
            let limits = limit_scale > 1.0 || verdict.within_limits(arm);
            let good = verdict.caught.is_some() && limits && verdict.clearance_m > 0.0;
            if good { Outcome::Caught } else { Outcome::Refuted }
        }
        Err(Decline::OutOfReach | Decline::Range) => Outcome::OutOfReach,
        Err(Decline::TooFast(_)) => Outcome::TooFast,
        Err(Decline::TooLate(_) | Decline::Limits(_)) => Outcome::TooLate,
        Err(Decline::Touches | Decline::NoWayIn) => Outcome::Touches,
    }
}

fn main() -> ExitCode {
    let arm = match arm() {
        Ok(arm) => arm,
        Err(error) => {
            eprintln!("disc_map: {error}");
            return ExitCode::FAILURE;
        }
    };
    let file = std::env::args().nth(1).unwrap_or_else(|| "disc_map.csv".to_owned());
    let throws = [
        ("flat: start 1.2 m high, (0, 4, 0) m/s", 1.2, Vector3::new(0.0, 4.0, 0.0)),
        ("oblique: start 1.05 m high, (−2, 4, 1) m/s", 1.05, Vector3::new(-2.0, 4.0, 1.0)),
        ("lob: start 0.7 m high, (0, 3, 2) m/s", 0.7, Vector3::new(0.0, 3.0, 2.0)),
    ];
    let starts: Vec<(i32, i32)> =
        (Y_M.0..=Y_M.1).flat_map(|j| (X_M.0..=X_M.1).map(move |i| (i, j))).collect();
    let mut table =
        "disc,x_m,y_m,rule_without_limits,joints_six_times_as_fast,joint_limits_kept\n".to_owned();
    for (name, z_m, velocity_m_s) in throws {
        let throw = |i: i32, j: i32| Throw {
            start_m: Vector3::new(f64::from(i) * STEP_M, f64::from(j) * STEP_M, z_m),
            velocity_m_s,
        };
        let judged: Vec<Judged> = starts
            .par_iter()
            .map(|(i, j)| {
                let throw = throw(*i, *j);
                let plan = |limit_scale| planned(&arm, &throw, limit_scale);
                Judged { rule: by_rule(&arm, &throw), fast: plan(FAST), plan: plan(1.0) }
            })
            .collect();
        let cells = |pick: fn(&Judged) -> Outcome| -> Vec<Outcome> { judged.iter().map(pick).collect() };
        let (before, fast, after) = (cells(|c| c.rule.0), cells(|c| c.fast), cells(|c| c.plan));
        let share = |of: usize| 100.0 * of as f64 / starts.len() as f64;
        let count = |cells: &[Outcome], o: Outcome| cells.iter().filter(|c| **c == o).count();
        let kept = judged.iter().filter(|c| c.rule == (Outcome::Caught, true)).count();
        println!("{name}; {} starts", starts.len());
        println!(
            "  rule of the paper, no joint limits: {} captured, of these {} seen by the observer ({:.1} %); {kept} within the joint limits",
            count(&before, Outcome::Caught) + count(&before, Outcome::Refuted),
            count(&before, Outcome::Caught),
            share(count(&before, Outcome::Caught)),
        );
        let caught = count(&fast, Outcome::Caught);
        println!(
            "  planner, joints {FAST} times as fast as the servos: {caught} caught ({:.1} %)",
            share(caught)
        );
        assert_eq!(count(&fast, Outcome::Refuted) + count(&after, Outcome::Refuted), 0, "a plan is refuted");
        let caught = count(&after, Outcome::Caught);
        println!("  planner, joint limits kept: {caught} caught ({:.1} %)", share(caught));
        for o in [Outcome::Refuted, Outcome::OutOfReach, Outcome::TooFast, Outcome::TooLate, Outcome::Touches]
        {
            println!("    {:>4}  {}", count(&after, o), o.name());
        }
        for (start, outcomes) in starts.iter().zip(before.iter().zip(&fast).zip(&after)) {
            let (x_m, y_m) = (f64::from(start.0) * STEP_M, f64::from(start.1) * STEP_M);
            let ((rule, fast), plan) = outcomes;
            let _ = writeln!(
                table,
                "\"{name}\",{x_m:.1},{y_m:.1},\"{}\",\"{}\",\"{}\"",
                rule.name(),
                fast.name(),
                plan.name()
            );
        }
    }
    if let Err(error) = std::fs::write(&file, table) {
        eprintln!(
            "disc_map: cannot write {file}: {error}\n  next: give a place that can be written as the argument"
        );
        return ExitCode::FAILURE;
    }
    println!("table: {file}");
    ExitCode::SUCCESS
}
