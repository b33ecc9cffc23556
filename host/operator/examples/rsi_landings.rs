//! Where the ball lands over many seeds, with noise and a gripper that opens within ±10 ms: without following, in the paper form
//! and in the best form, with the lag of the robot file and with one that was measured first.
//!
//! `cargo run --release -p operator --example rsi_landings -- [SEEDS] [X,Y,Z | --check]`; with `--check` the target is 2.5 m away
//! and 0.6 m high, and a row outside of its bounds is an error.
//!
//! From a set point to the axes it takes 120 ms, as the description says; but of these 42 ms are the time constant, not 24, and the
//! gripper takes 27 ms, not 20.

use std::error::Error;

use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use operator::job::follow::error_m;
use operator::rsi::cell;
use operator::rsi::cycles::cycles;
use operator::rsi::identify::{gripper, lag, wiggle, with_measured};
use operator::rsi::program::{Lag, exploring, prepare, station};
use operator::rsi::station::{Stage, Station};
use planner::follow::best::BestOptions;
use planner::follow::limits::{Arm, Axes, LimitSource, Limits};
use planner::follow::paper::{Criterion, PaperOptions};
use planner::follow::plan::FollowPlan;
use planner::follow::search::Search;
use planner::follow::setting::Setting;
use planner::plan::file::RobotId;
use planner::store::fingerprint_of;
use protocol::{Duration, Instant};
use rayon::prelude::*;

/// Radius of a bottle, m.
const BOTTLE_M: f64 = 0.035;

/// What a row must show, from both sides.
struct Bounds {
    /// Median of the landing errors, mm.
    median_mm: [f64; 2],
    /// Share of bottles hit.
    hit: [f64; 2],
}

/// The aim for the best form is 99 % of the bottles and a median of 10 mm; identified, a third of that. Without following the gripper
/// alone misses (reference: 43 mm rms). The paper form is between: the lag has not come to rest in its short window, so the landing
/// still depends on the opening, which comes up to half a cycle beside the best instant. Lower bounds: noise and jitter cannot
/// give less.
const BOUNDS: [Bounds; 6] = [
    Bounds { median_mm: [35.0, 90.0], hit: [0.0, 0.05] },
    Bounds { median_mm: [10.0, 35.0], hit: [0.7, 0.95] },
    Bounds { median_mm: [1.0, 10.0], hit: [0.99, 1.0] },
    Bounds { median_mm: [35.0, 90.0], hit: [0.0, 0.05] },
    Bounds { median_mm: [10.0, 30.0], hit: [0.9, 1.0] },
    Bounds { median_mm: [0.05, 3.3], hit: [0.99, 1.0] },
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let seeds: u64 = args.next().map_or(Ok(200), |text| text.parse())?;
    let (mut checked, mut outside) = (false, 0);
    let target: Vec<f64> = match args.next() {
        Some(text) if text == "--check" => {
            checked = true;
            vec![2.5, 0.0, 0.6]
        }
        Some(text) => text.split(',').map(str::parse).collect::<Result<_, _>>()?,
        None => vec![2.5, 0.0, 0.6],
    };
    let target = Vector3::from_row_slice(&target);
    let arm = Arm::load("kr16_2")?;
    let described = KrcScenario::open("kr-c2")?;
    let mut truth = described.clone();
    truth.options.lag.dead_time = Duration::from_millis(78);
    truth.options.lag.time_constant = Duration::from_millis(42);
    truth.options.hand.gripper.delay = Duration::from_millis(27);
    let identified = identified(&truth, &described, &arm)?;
    println!("identified: {:?}, gripper {}", Lag::of(&identified), identified.options.hand.gripper.delay);
    let options = || Search::Best(BestOptions::default());
    let best = plan(&arm, target, described.options.lag.time_constant, &options())?;
    let best_identified = plan(&arm, target, identified.options.lag.time_constant, &options())?;
    let grid = PaperOptions {
        criterion: Criterion::Points,
        refinements: 5,
        ..PaperOptions::covering(1.8, 0.675, 0.0, 1.3)
    };
    let paper = plan(&arm, target, Duration::ZERO, &Search::Paper(grid))?;
    let ramps = paper.without_following(&Limits::of_paper(&arm));
    println!("{seeds} seeds, target ({}, {}, {}) m", target.x, target.y, target.z);
    println!("{:<26} points  median mm   95 % mm  largest mm    hit", "plan");
    let rows = [
        ("no following", &ramps, &described),
        ("paper form", &paper, &described),
        ("best form", &best, &described),
        ("no following, identified", &ramps, &identified),
        ("paper form, identified", &paper, &identified),
        ("best form, identified", &best_identified, &identified),
    ];
    for ((name, plan, belief), bounds) in rows.into_iter().zip(BOUNDS) {
        let krc = &belief.options;
        let (lag_s, jitter_s) = (krc.lag.time_constant.as_secs_f64(), krc.hand.gripper.jitter.as_secs_f64());
        let opened = plan.opened_for(&arm, lag_s, jitter_s);
        // As `cubectl throw` does it. Ramps through the release have no window to open in.
        let plan = if plan.followed_points > 1 { &opened } else { plan };
        let thrown: Vec<Result<f64, String>> =
            (1..=seeds).into_par_iter().map(|seed| landing(&truth, belief, &arm, plan, seed)).collect();
        let stopped: Vec<&String> = thrown.iter().filter_map(|thrown| thrown.as_ref().err()).collect();
        let mut errors: Vec<f64> =
            thrown.iter().map(|thrown| *thrown.as_ref().unwrap_or(&f64::INFINITY)).collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| 1e3 * errors[(share * (errors.len() - 1) as f64).round() as usize];
        let hits = errors.iter().filter(|error| **error <= BOTTLE_M).count();
        let hit = hits as f64 / errors.len() as f64;
        println!(
            "{name:<26} {:>6} {:>10.1} {:>9.1} {:>11.1} {:>5.1} %",
            plan.followed_points,
            at(0.5),
            at(0.95),
            at(1.0),
            100.0 * hit
        );
        let [least, most] = bounds.median_mm;
        let within = (least..=most).contains(&at(0.5)) && (bounds.hit[0]..=bounds.hit[1]).contains(&hit);
        if checked && !(within && stopped.is_empty()) {
            println!(
                "{name:<26} expected: median {least} to {most} mm, share {:?}, none stopped",
                bounds.hit
            );
            outside += 1;
        }
        if let Some(why) = stopped.first() {
            println!("{:<26} {} stopped, the first by: {why}", "", stopped.len());
        }
    }
    if outside > 0 {
        return Err(format!("{outside} rows are outside of their bounds").into());
    }
    Ok(())
}

/// Landing error, m, infinite without a landing; or why the throw was stopped.
fn landing(
    truth: &KrcScenario,
    belief: &KrcScenario,
    arm: &Arm,
    plan: &FollowPlan,
    seed: u64,
) -> Result<f64, String> {
    let (mut robot, mut described) = (truth.clone(), belief.clone());
    prepare(&mut robot, arm, plan);
    prepare(&mut described, arm, plan);
    robot.seed = seed;
    let lag = Lag::of(&described).for_plan(plan);
    let mut station = station(&described, arm, plan, lag, &[]).map_err(|none| none.to_string())?;
    let seen = cell::run(&robot, &mut station).map_err(|error| error.to_string())?;
    if let Some(fault) = seen.fault {
        return Err(fault.to_string());
    }
    match station.stage() {
        Stage::Finished { .. } => {
            let landing = seen.landing.as_ref();
            Ok(landing.map_or(f64::INFINITY, |landing| error_m(&landing.p_m, &plan.target_m)))
        }
        stage => Err(format!("{stage:?}")),
    }
}

fn plan(
    arm: &Arm,
    target: Vector3<f64>,
    lag: Duration,
    search: &Search,
) -> Result<FollowPlan, Box<dyn Error>> {
    let source = LimitSource::ControllerModel;
    let setting = Setting { lag_s: lag.as_secs_f64(), ..Setting::new(arm, target, Limits::of(arm, source)) };
    // As `cubectl throw` does it, but for the limits of the paper in its own form.
    let setting = match search {
        Search::Paper(_) => Setting { limits: Limits::of_paper(arm), ..setting },
        Search::Best(_) => setting,
    };
    let searching = match search {
        Search::Paper(_) => setting,
        Search::Best(_) => Setting { limits: setting.limits.with_spare_for_commands(), ..setting },
    };
    let found = search.plan(&searching).map_err(|none| none.to_string())?;
    let fingerprint = fingerprint_of(arm);
    let robot = RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint };
    Ok(FollowPlan::new(&setting, source, robot, search.form(), &found, 0.0))
}

/// The description after `cubectl arm identify`.
fn identified(
    truth: &KrcScenario,
    described: &KrcScenario,
    arm: &Arm,
) -> Result<KrcScenario, Box<dyn Error>> {
    let start = Axes::from(described.options.start_deg.map(f64::to_radians));
    let mut station = exploring(described, arm, &[wiggle(&start, 6.0_f64.to_radians())])?;
    let (mut next, mut orders) = (None::<Instant>, 0_u32);
    let mut each = |now: Instant, station: &mut Station| {
        if !matches!(station.stage(), Stage::Finished { .. }) {
            return !station.stage().is_end();
        }
        if next.is_none_or(|next| next <= now) && station.set_gripper(now, orders.is_multiple_of(2)).is_ok() {
            next = Some(now + Duration::from_micros(250_000 + u64::from(orders) * 7_331 % 40_000));
            orders += 1;
        }
        orders < 80
    };
    cell::run_with(truth, &mut station, &mut each)?;
    let table = cycles(&station.take_log(), &described.config, "DiO", Some("GripOpen"));
    let period_s = described.options.cycle.as_secs_f64();
    let fingers = gripper(&table, period_s, 0)?;
    Ok(with_measured(described, &lag(&table, period_s)?, Some(&fingers)))
}
