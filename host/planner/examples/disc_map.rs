//! From which starts a disc is caught: by the rule of paper 001 without joint limits, and by the planner within the
//! limits of the robot file, only at the places of its grid. The observer (`witness`) judges every catch.
//!
//!     cargo run -p planner --release --example disc_map [FILE.svg]
//!
//! Prints figures and writes an SVG (default `disc_map.svg`).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::ExitCode;

use nalgebra::Vector3;
use planner::disc::arm::{DiscArm, READY_RAD};
use planner::disc::flight::Path;
use planner::disc::intercept::local::Effort;
use planner::disc::intercept::{self, Decline, Settings};
use planner::disc::motion::At;
use planner::disc::paper::{self, Reading, Throw};
use planner::disc::witness::{self, Gripper, Rule, Verdict, judge};
use rayon::prelude::*;
use robot_model::RobotModel;

/// Horizontal grid of starts, m.
const X_M: (i32, i32) = (-12, 12);
const Y_M: (i32, i32) = (-24, 4);
const STEP_M: f64 = 0.1;

/// What came of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
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
    const fn colour(self) -> &'static str {
        match self {
            Self::Caught => "#2a9d5c",
            Self::Refuted => "#d1495b",
            Self::Never | Self::OutOfReach => "#e4e4e0",
            Self::TooFast => "#e9b44c",
            Self::TooLate => "#8ab0d9",
            Self::Touches => "#b48ac4",
        }
    }

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
    at: (i32, i32),
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
    let rest = READY_RAD.map(|q| At { q, ..At::default() });
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

/// A panel: one square per start.
fn panel(svg: &mut String, left: f64, top: f64, title: &str, cells: &[(i32, i32, Outcome)]) {
    const CELL: f64 = 12.0;
    let x = |i: f64| left + (i - f64::from(X_M.0)) * CELL;
    let y = |j: f64| top + (f64::from(Y_M.1) - j) * CELL;
    let _ = write!(svg, "<text x='{left}' y='{}' class='t'>{title}</text>", top - 10.0);
    for (i, j, outcome) in cells {
        let _ = write!(
            svg,
            "<rect x='{:.1}' y='{:.1}' width='{s}' height='{s}' fill='{}'/>",
            x(f64::from(*i)),
            y(f64::from(*j)),
            outcome.colour(),
            s = CELL - 1.0
        );
    }
    let middle = (x(0.5), y(-0.5));
    let _ = write!(
        svg,
        "<circle cx='{}' cy='{}' r='5' fill='#222'/><text x='{}' y='{}'>arm</text>",
        middle.0,
        middle.1,
        middle.0 + 8.0,
        middle.1 + 4.0
    );
    for i in (X_M.0..=X_M.1).filter(|i| i % 4 == 0) {
        let label = format!("{:.1}", f64::from(i) * STEP_M).replace('-', "−");
        let (at, under) = (x(f64::from(i) + 0.5), y(f64::from(Y_M.0) - 1.0) + 16.0);
        let _ = write!(svg, "<text x='{at}' y='{under}' text-anchor='middle'>{label}</text>");
    }
    for j in (Y_M.0..=Y_M.1).filter(|j| j % 4 == 0) {
        let label = format!("{:.1}", f64::from(j) * STEP_M).replace('-', "−");
        let _ = write!(
            svg,
            "<text x='{}' y='{}' text-anchor='end'>{label}</text>",
            left - 6.0,
            y(f64::from(j) - 0.8)
        );
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
    let file = std::env::args().nth(1).unwrap_or_else(|| "disc_map.svg".to_owned());
    let throws = [
        ("flat: start 1.2 m high, (0, 4, 0) m/s", 1.2, Vector3::new(0.0, 4.0, 0.0)),
        ("oblique: start 1.05 m high, (−2, 4, 1) m/s", 1.05, Vector3::new(-2.0, 4.0, 1.0)),
        ("lob: start 0.7 m high, (0, 3, 2) m/s", 0.7, Vector3::new(0.0, 3.0, 2.0)),
    ];
    let starts: Vec<(i32, i32)> =
        (Y_M.0..=Y_M.1).flat_map(|j| (X_M.0..=X_M.1).map(move |i| (i, j))).collect();
    let (panel_w, panel_h) = (370.0, 425.0);
    let mut svg = String::new();
    let mut legend: BTreeMap<Outcome, usize> = BTreeMap::new();
    for (row, (name, z_m, velocity_m_s)) in throws.into_iter().enumerate() {
        let throw = |i: i32, j: i32| Throw {
            start_m: Vector3::new(f64::from(i) * STEP_M, f64::from(j) * STEP_M, z_m),
            velocity_m_s,
        };
        let judged: Vec<Judged> = starts
            .par_iter()
            .map(|(i, j)| {
                let throw = throw(*i, *j);
                let plan = |limit_scale| planned(&arm, &throw, limit_scale);
                Judged { at: (*i, *j), rule: by_rule(&arm, &throw), fast: plan(FAST), plan: plan(1.0) }
            })
            .collect();
        let cells = |pick: fn(&Judged) -> Outcome| -> Vec<_> {
            judged.iter().map(|c| (c.at.0, c.at.1, pick(c))).collect()
        };
        let (before, fast, after) = (cells(|c| c.rule.0), cells(|c| c.fast), cells(|c| c.plan));
        let share = |of: usize| 100.0 * of as f64 / starts.len() as f64;
        let count = |cells: &[(i32, i32, Outcome)], o: Outcome| cells.iter().filter(|c| c.2 == o).count();
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
        for cell in before.iter().chain(&fast).chain(&after) {
            *legend.entry(cell.2).or_default() += 1;
        }
        let top = 70.0 + row as f64 * panel_h;
        let _ = write!(svg, "<text x='16' y='{}' class='h'>{name}</text>", top - 32.0);
        panel(&mut svg, 60.0, top, "rule of the paper, joints without limits", &before);
        panel(&mut svg, 60.0 + panel_w, top, "planner, joints six times as fast", &fast);
        panel(&mut svg, 60.0 + 2.0 * panel_w, top, "planner, joints within their limits", &after);
    }
    let mut y = 70.0 + 3.0 * panel_h;
    for outcome in legend.keys() {
        let _ = write!(
            svg,
            "<rect x='60' y='{y}' width='14' height='14' fill='{}'/><text x='82' y='{}'>{}</text>",
            outcome.colour(),
            y + 12.0,
            outcome.name()
        );
        y += 20.0;
    }
    let page = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' width='1170' height='{0}' viewBox='0 0 1170 {0}'><style>text{{font:11px sans-serif;fill:#222}}.t{{font-size:12px}}.h{{font:bold 14px sans-serif}}</style><rect width='100%' height='100%' fill='#fff'/>{svg}</svg>\n",
        y + 14.0
    );
    if let Err(error) = std::fs::write(&file, page) {
        eprintln!(
            "disc_map: cannot write {file}: {error}\n  next: give a place that can be written as the argument"
        );
        return ExitCode::FAILURE;
    }
    println!("map: {file}");
    ExitCode::SUCCESS
}
