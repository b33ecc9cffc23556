//! Tables of throws that follow the flight: both forms over targets, and the paper form over resolutions.
//!
//! `cargo run -p planner --release --example follow_table -- [targets|led|best|resolution|arms|near] [RESOLUTION] [STARTS] [DISTANCE,HEIGHT]`
//!
//! With DISTANCE,HEIGHT there is only this target. `led` plans as `cubectl` does for a robot that it leads:
//! commands stay inside the ranges that the robot's program accepts, and the best form leaves a reserve for
//! commands at times between those of the plan. The verifier gets the limits themselves. `best` is `led` without
//! the rows of the paper form.

use std::time::Instant;

use nalgebra::Vector3;
use planner::follow::best::{BestOptions, HandFreedom};
use planner::follow::landing;
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::paper::{self, Criterion, GridAxis, PaperOptions};
use planner::follow::plan::FollowPlan;
use planner::follow::search::Search;
use planner::follow::setting::{CommandRange, Setting};
use planner::follow::verify::verify_commands;
use planner::plan::file::RobotId;

/// Targets ahead of the KR 16: distance from A1 and height, in m.
const TARGETS: [[f64; 2]; 12] = [
    [2.5, 0.6],
    [2.5, 1.0],
    [2.5, 1.17],
    [2.5, 1.53],
    [2.0, 0.6],
    [3.0, 0.6],
    [2.0, 1.0],
    [3.0, 1.0],
    [2.0, 1.17],
    [3.0, 1.17],
    [2.0, 1.53],
    [3.0, 1.53],
];
/// First-order lag that the last column plans for, in s.
const LAG_S: f64 = 0.024;
/// Halvings of the grid of the paper form around its best releases, where it is to follow the most points.
const REFINEMENTS: u32 = 5;
/// Programs of industrial robots accept commands up to 0.1 deg inside the ranges of the axes (`robots/kr16_2`).
const PROGRAM_INSIDE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Jitter of the gripper for the landing errors, in s.
const JITTER_S: f64 = 0.010;

fn main() {
    let mut args = std::env::args().skip(1);
    let table = args.next().unwrap_or_else(|| "targets".to_owned());
    let resolution: f64 = args.next().and_then(|a| a.parse().ok()).unwrap_or(1.3);
    let starts: usize = args.next().and_then(|a| a.parse().ok()).unwrap_or(32);
    let only = args.next().and_then(|text| {
        let (x, z) = text.split_once(',')?;
        Some([x.parse().ok()?, z.parse().ok()?])
    });
    let targets_shown = only.map_or(TARGETS.to_vec(), |target| vec![target]);
    match table.as_str() {
        "targets" => targets(&targets_shown, Led::No, &Forms::Both { resolution }, starts),
        "led" => targets(&targets_shown, Led::Yes, &Forms::Both { resolution }, starts),
        "best" => targets(&targets_shown, Led::Yes, &Forms::Best, starts),
        "resolution" => resolutions(),
        "arms" => arms(starts, only),
        "near" => near_the_reference(starts),
        other => eprintln!("no table \"{other}\": targets, led, best, resolution, arms or near"),
    }
}

/// Whether commands are those that `cubectl` sends to a robot.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Led {
    Yes,
    No,
}

/// Forms in a table over targets.
enum Forms {
    /// Both; the grid of the paper form has this resolution.
    Both { resolution: f64 },
    /// The best form alone.
    Best,
}

fn heading() {
    println!(
        "{:<24} {:<26} {:>6} {:>7} {:>9} {:>11} {:>6} {:>6} {:>7} {:>7}  verified; landing rms without and with following",
        "target m", "form", "points", "j1", "j2", "leap deg/s2", "m/s", "deg", "whole s", "search s"
    );
}

#[allow(clippy::too_many_arguments, reason = "the columns of a table, used here only")]
fn row(arm: &Arm, source: LimitSource, target: [f64; 3], name: &str, kind: &Search, lag_s: f64, led: Led) {
    let limits = Limits::of(arm, source);
    let commands = match led {
        Led::Yes => CommandRange::inside(&limits, PROGRAM_INSIDE_RAD),
        Led::No => CommandRange::default(),
    };
    let setting = Setting { commands, lag_s, ..Setting::new(arm, Vector3::from(target), limits) };
    let searched = match kind {
        Search::Best(_) if led == Led::Yes => Setting { limits: limits.with_spare_for_commands(), ..setting },
        _ => setting,
    };
    let began = Instant::now();
    let outcome = kind.plan(&searched);
    let took = began.elapsed().as_secs_f64();
    let place = format!("{:.2}, {:.2}, {:.2}", target[0], target[1], target[2]);
    let found = match outcome {
        Ok(found) => found,
        Err(none) => {
            println!("{place:<24} {name:<26} {none} ({took:.1} s)");
            if let Some(p) = none.nearest {
                println!("{:<51} nearest with a plan: {:.2}, {:.2}, {:.2}", "", p.x, p.y, p.z);
            }
            return;
        }
    };
    let id = RobotId { name: arm.name().into(), source: arm.name().into(), fingerprint: String::new() };
    let plan = FollowPlan::new(&setting, source, id, kind.form(), &found, took);
    let report = verify_commands(arm, &limits, &commands, &plan);
    let middle_s = 0.5 * (found.motion.last - found.motion.first) as f64 * setting.period_s;
    let with = landing::sensitivity(arm, &found.motion, &setting.target, middle_s, JITTER_S);
    let through = landing::without_following(&found.motion, &limits);
    let without = landing::sensitivity(arm, &through, &setting.target, 0.0, JITTER_S);
    println!(
        "{place:<24} {name:<26} {:>6} {:>7.2} {:>9.2} {:>11.0} {:>6.2} {:>6.1} {:>7.2} {:>7.1}  {}; {:.1} and {:.2} mm",
        plan.followed_points,
        plan.j1,
        plan.j2,
        plan.leap.size_deg_s2,
        plan.flight.speed_release_m_s,
        plan.flight.beta_release_deg,
        plan.steps.len() as f64 * plan.period_s,
        took,
        if report.is_good() { "good".to_owned() } else { format!("REFUSED {:?}", report.findings) },
        without.rms_m * 1e3,
        with.rms_m * 1e3,
    );
    if lag_s > 0.0 {
        println!(
            "{:<51} executed through the lag: landing within {:.1} mm",
            "",
            report.executed_landing_m * 1e3
        );
    }
}

fn targets(shown: &[[f64; 2]], led: Led, forms: &Forms, starts: usize) {
    let arm = Arm::load("kr16_2").expect("built in");
    let source = LimitSource::ControllerModel;
    let best = BestOptions { starts, ..BestOptions::default() };
    heading();
    for [x, z] in shown {
        let target = [*x, 0.0, *z];
        if let Forms::Both { resolution } = forms {
            let paper = PaperOptions::covering(1.8, 0.675, 0.0, *resolution);
            let points =
                PaperOptions { criterion: Criterion::Points, refinements: REFINEMENTS, ..paper.clone() };
            row(&arm, source, target, "paper", &Search::Paper(paper), 0.0, led);
            row(&arm, source, target, "paper, most points", &Search::Paper(points), 0.0, led);
        }
        row(&arm, source, target, "best", &Search::Best(best.clone()), 0.0, led);
        row(&arm, source, target, "best, lag 24 ms", &Search::Best(best.clone()), LAG_S, led);
    }
}

/// What a finer grid costs and gives.
fn resolutions() {
    let arm = Arm::load("kr16_2").expect("built in");
    let limits = Limits::of(&arm, LimitSource::ControllerModel);
    let setting = Setting::new(&arm, Vector3::new(2.5, 0.0, 0.6), limits);
    println!("resolution  refinements  releases   postures  points      j1  search s");
    for (resolution, refinements) in
        [0.6, 0.8, 1.0, 1.25, 1.6, 2.0].into_iter().flat_map(|r| [(r, 0), (r, REFINEMENTS)])
    {
        let options = PaperOptions {
            criterion: Criterion::Points,
            refinements,
            ..PaperOptions::covering(1.8, 0.675, 0.0, resolution)
        };
        let began = Instant::now();
        let outcome = paper::plan(&setting, &options);
        let took = began.elapsed().as_secs_f64();
        match outcome {
            Ok(f) => println!(
                "{resolution:>10.2} {refinements:>12} {:>9} {:>10} {:>7} {:>7.2} {took:>9.1}",
                f.size.releases,
                f.size.counts.total(),
                f.motion.last - f.motion.first + 1,
                f.j1,
            ),
            Err(e) => println!(
                "{resolution:>10.2} {refinements:>12} {:>9} {:>10} {e} ({took:.1} s)",
                e.size.releases,
                e.size.counts.total()
            ),
        }
    }
}

/// A finer grid about the reference throw with eight points at 2.5 m and 0.6 m height (ball at 1.57 m from A1 and
/// 1.53 m above the floor, 13 degrees), and the same hand without a grid: the loss of points by the resolution, and
/// by the checks of arm, floor and ball.
fn near_the_reference(starts: usize) {
    let arm = Arm::load("kr16_2").expect("built in");
    let source = LimitSource::ControllerModel;
    let target = [2.5, 0.0, 0.6];
    let best = BestOptions { hand: HandFreedom::Constant, starts, kicks: 18, ..BestOptions::default() };
    heading();
    for [places, fine, rolls] in [[72, 5, 36], [120, 7, 72], [180, 9, 96]] {
        let grid = PaperOptions {
            radius_m: GridAxis { from: 1.50, to: 1.66, count: fine },
            height_m: GridAxis { from: 1.44, to: 1.62, count: fine },
            beta_deg: GridAxis { from: 8.0, to: 22.0, count: fine },
            places,
            rolls,
            criterion: Criterion::Points,
            refinements: REFINEMENTS,
            ..PaperOptions::covering(1.8, 0.675, 0.0, 1.0)
        };
        let name = format!("paper, {} releases, refined", grid.size());
        row(&arm, source, target, &name, &Search::Paper(grid), 0.0, Led::No);
    }
    row(&arm, source, target, "constant hand, no grid", &Search::Best(best), 0.0, Led::No);
}

/// Both forms on the arms that are no KR 16; with `only` for the targets at this x and z.
fn arms(starts: usize, only: Option<[f64; 2]>) {
    let ur5 = include_str!("../../../robots/model/tests/data/ur5.toml");
    let arms = [
        (Arm::load("powercube6").expect("built in"), 1.05, [[1.0, 1.0, -1.0], [1.5, 0.0, -0.5]]),
        (Arm::from_toml("ur5.toml", ur5).expect("fixture"), 1.0, [[1.5, 0.0, -0.3], [2.0, 0.0, 0.0]]),
    ];
    heading();
    for (arm, reach_m, targets) in arms {
        println!("{}", arm.name());
        let base_z_m = arm.fk(&planner::follow::limits::Axes::zeros(6)).origin(0).z;
        // Postures by iteration take about a thousand times as long, so the grid is coarser.
        let resolution = if arm.name() == "ur5" { 0.45 } else { 1.0 };
        let paper = PaperOptions::covering(reach_m, base_z_m, arm.world().floor_z_m, resolution);
        // Numerical inverse kinematics: a refinement would take many times as long as the grid.
        let refinements = if arm.name() == "ur5" { 0 } else { REFINEMENTS };
        let paper = PaperOptions { criterion: Criterion::Points, refinements, ..paper };
        let paper = Search::Paper(paper);
        let best = Search::Best(BestOptions { starts, kicks: 6, ..BestOptions::default() });
        for target in targets.into_iter().filter(|[x, _, z]| only.is_none_or(|only| only == [*x, *z])) {
            // The ramps of the paper start and end with a leap, which the jerk of a robot file forbids.
            row(&arm, LimitSource::ControllerModel, target, "paper, most points", &paper, 0.0, Led::No);
            row(&arm, LimitSource::RobotFile, target, "best", &best, 0.0, Led::No);
        }
    }
}
