//! `cubectl throw` with an industrial robot: the robot inside this program, over RSI, in virtual time.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant as WallTime;

use hil_sim::krc::KrcScenario;
use nalgebra::Vector3;
use planner::follow::best::{self, BestOptions, HandFreedom};
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::follow::verify::verify;
use planner::plan::file::RobotId;
use planner::store::robot_fingerprint;

use super::Args;
use super::folder::Folder;
use crate::cmd::print_json;
use crate::error::ExpectedError;
use crate::exit;
use operator::rsi::cell::{self, Seen};
use operator::rsi::outcome::{error_m, judge};
use operator::rsi::program::{Lag, NoStation, prepare, station};
use operator::rsi::station::{Stage, Station};
use operator::throw::{Outcome, Verdict};

/// Radius of a bottle, m.
const BOTTLE_M: f64 = 0.035;
/// Starts of the search if no number is asked for.
const STARTS: usize = 64;

/// Throws, and writes plan.json, motion.csv and summary.json.
///
/// # Errors
/// Options that have no meaning here, no plan, a scenario that cannot be served, or the outcome of the throw.
pub(super) fn run(args: &Args, arm: &Arm) -> Result<(), ExpectedError> {
    refuse_options_of_a_bus(args)?;
    let mut scenario = match &args.scenario {
        Some(path) => KrcScenario::load(path).map_err(|error| ExpectedError::bad_input(&error))?,
        None => KrcScenario::kr_c2().map_err(|error| ExpectedError::bad_input(&error))?,
    };
    scenario.robot = args.search.options.robot.clone();
    scenario.seed = args.seed.unwrap_or(scenario.seed);
    let lag = &scenario.options.lag;
    let lag = Lag { dead_time: lag.dead_time, time_constant: lag.time_constant };
    let begun = WallTime::now();
    let plan = plan(args, arm, &scenario, lag)?;
    let plan_s = begun.elapsed().as_secs_f64();
    prepare(&mut scenario, arm, &plan);
    let mut station = station(&scenario, arm, &plan, lag).map_err(|error| no_station(&error))?;
    let folder = Folder::create(args.out.as_deref())?;
    if !args.json {
        say::line!(
            "plan: {} points of the flight followed, release after {:.3} s ({plan_s:.1} s of search)",
            plan.followed_points,
            plan.release_time_s
        );
    }
    let seen = cell::run(&scenario, &mut station).map_err(|error| ExpectedError::bad_input(&error))?;
    let tolerance_m = args.tolerance.unwrap_or(BOTTLE_M);
    let verdict = judge(&seen, station.stage(), &plan.target_m, tolerance_m);
    let code = exit::of_outcome(verdict.outcome).unwrap_or(exit::DRIVE);
    let summary = summary(
        &Results { plan: &plan, scenario: &scenario, seen: &seen, station: &station },
        &verdict,
        code,
    );
    folder.write("plan.json", &plan.to_json())?;
    folder.write("motion.csv", &motion_csv(&seen, station.stage()))?;
    folder.write("summary.json", &format!("{summary:#}\n"))?;
    if args.json {
        print_json(&summary);
    }
    if code == exit::OK {
        if !args.json {
            say::line!("{}", verdict.text);
            say::line!("results in {}", folder.path.display());
        }
        return Ok(());
    }
    let next = match verdict.outcome {
        Outcome::Missed => {
            "compare `path_delay_s` in summary.json with the lag: identify it anew if it is not near zero"
        }
        Outcome::NotReleased => "take the ball out; check output and supply of the gripper",
        _ => "`cubectl explain CODE` tells what to do; motion.csv shows where the arm was",
    };
    let folder = folder.path.display();
    Err(ExpectedError::new(code, format!("{}\n  next: {next}\n  results in {folder}", verdict.text)))
}

/// Options that only a CAN bus gives a meaning.
fn refuse_options_of_a_bus(args: &Args) -> Result<(), ExpectedError> {
    let given = [
        (args.bus.to_string() != "sim", "--bus"),
        (args.controller.is_some(), "--controller"),
        (args.gains.is_some(), "--gains"),
        (args.period.is_some(), "--period"),
        (args.back, "--back"),
    ];
    match given.into_iter().find(|(given, _)| *given) {
        Some((_, option)) => Err(ExpectedError::bad_input(&format!(
            "{option} has no meaning for a robot with a controller of its own; it is led over RSI by the robot inside this \
             program\n  next: leave {option} out"
        ))),
        None => Ok(()),
    }
}

fn no_station(error: &NoStation) -> ExpectedError {
    ExpectedError::bad_input(error)
}

/// The plan of a file, or a new one for the lag of the robot; verified either way.
fn plan(args: &Args, arm: &Arm, scenario: &KrcScenario, lag: Lag) -> Result<FollowPlan, ExpectedError> {
    let source = LimitSource::ControllerModel;
    let limits = Limits::of(arm, source);
    let fingerprint = format!("{:016x}", robot_fingerprint(arm));
    let plan = match (&args.plan, args.target) {
        (Some(path), _) => {
            let plan = FollowPlan::read(path).map_err(|error| refused_plan(path, &error))?;
            if plan.robot.fingerprint != fingerprint {
                return Err(refused_plan(
                    path,
                    &"it is for another robot, or for an earlier file of this one",
                ));
            }
            plan
        }
        (None, Some(target_m)) => {
            if !target_m.iter().all(|x| x.is_finite()) {
                return Err(ExpectedError::bad_input(&"the target needs three finite numbers"));
            }
            let setting = Setting {
                lag_s: lag.time_constant.as_secs_f64(),
                period_s: scenario.options.cycle.as_secs_f64(),
                ..Setting::new(arm, Vector3::from(target_m), limits)
            };
            let options = BestOptions {
                starts: args.search.starts.unwrap_or(STARTS),
                seed: args.seed.unwrap_or(1),
                ..BestOptions::default()
            };
            let found = best::plan(&setting, &options).map_err(|none| {
                ExpectedError::new(
                    exit::NO_THROW,
                    format!("{none}\n  next: `cubectl plan throw --robot {}` names the nearest target with a plan", arm.name()),
                )
            })?;
            let robot = RobotId {
                name: arm.name().to_owned(),
                source: args.search.options.robot.clone(),
                fingerprint,
            };
            FollowPlan::new(&setting, source, robot, Form::Best(HandFreedom::TangentAndRoll), &found, 0.0)
        }
        (None, None) => return Err(ExpectedError::bad_input(&"give --target or --plan")),
    };
    match verify(arm, &limits, &plan).findings.first() {
        None => Ok(plan),
        Some(finding) => Err(ExpectedError::new(
            exit::CHECK_FAILED,
            format!(
                "the plan does not hold what it claims: {finding}\n  next: plan again; nothing has moved"
            ),
        )),
    }
}

fn refused_plan(path: &Path, error: &impl std::fmt::Display) -> ExpectedError {
    ExpectedError::bad_input(&format!(
        "{}: {error}\n  next: make one with `cubectl plan throw --robot ... --out {}`",
        path.display(),
        path.display()
    ))
}

struct Results<'a> {
    plan: &'a FollowPlan,
    scenario: &'a KrcScenario,
    seen: &'a Seen,
    station: &'a Station,
}

fn summary(results: &Results<'_>, verdict: &Verdict, exit_code: u8) -> serde_json::Value {
    let Results { plan, scenario, seen, station } = results;
    let lag = &scenario.options.lag;
    let released = seen.released.as_ref().map(|(at, hand)| {
        let planned = match station.stage() {
            Stage::Finished { started_at } => Some(started_at.as_secs_f64() + plan.release_time_s),
            _ => None,
        };
        serde_json::json!({
            "late_s": planned.map(|planned_s| at.as_secs_f64() - planned_s),
            "position_m": [hand.p_m.x, hand.p_m.y, hand.p_m.z],
            "velocity_m_s": [hand.v_m_s.x, hand.v_m_s.y, hand.v_m_s.z],
        })
    });
    serde_json::json!({
        "format": "cubectl-robot-throw",
        "version": 1,
        "outcome": verdict.outcome.json_name(),
        "text": verdict.text,
        "exit_code": exit_code,
        "robot": plan.robot.name,
        "link": "RSI",
        "time": "virtual time",
        "seed": scenario.seed,
        "target_m": plan.target_m,
        "tolerance_m": verdict.tolerance_m,
        "landing": seen.landing.as_ref().map(|landing| serde_json::json!({
            "source": "simulated ball",
            "position_m": [landing.p_m.x, landing.p_m.y, landing.p_m.z],
            "error_m": error_m(seen, &plan.target_m),
        })),
        "release": released,
        "followed_points": plan.followed_points,
        "lag": { "dead_time_s": lag.dead_time.as_secs_f64(), "time_constant_s": lag.time_constant.as_secs_f64() },
        "path_delay_s": station.path_delay_s(),
        "answers": station.counts().answers,
        "late_answers": seen.late,
        "refused_answers": seen.refused,
        "robot_fault": seen.fault.as_ref().map(ToString::to_string),
        "command_line": std::env::args().collect::<Vec<_>>().join(" "),
    })
}

/// Set and actual axes of every cycle; time from the start of the plan.
fn motion_csv(seen: &Seen, stage: &Stage) -> String {
    let start_s = match stage {
        Stage::Finished { started_at } | Stage::Running { starts_at: started_at } => started_at.as_secs_f64(),
        _ => 0.0,
    };
    let mut text = String::from("t_s,ipoc");
    for kind in ["set", "actual"] {
        for axis in 1..=6 {
            let _ = write!(text, ",{kind}_a{axis}_deg");
        }
    }
    text.push_str(",outputs,late\n");
    for cycle in &seen.cycles {
        let _ = write!(text, "{:.6},{}", cycle.at.as_secs_f64() - start_s, cycle.ipoc);
        for q_deg in cycle.set_deg.iter().chain(&cycle.actual_deg) {
            let _ = write!(text, ",{q_deg:.6}");
        }
        let _ = writeln!(text, ",{},{}", cycle.outputs, cycle.late);
    }
    text
}
