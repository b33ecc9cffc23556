//! `cubectl catch --disc`

use nalgebra::Vector3;
use operator::disc::Judged;
use planner::disc::aero::Body;
use planner::disc::arm::{DiscArm, READY_RAD};
use planner::disc::flight::{Air, DiscState, Path};
use planner::disc::intercept::{self, Decline, Plan, Settings};
use planner::disc::paper::{self, Reading, Run, Throw};
use planner::disc::witness::{self, Gripper, Rule, Verdict};
use planner::motion_law::State;
use robot_model::RobotModel;
use serde_json::{Value, json};

use super::super::print_json;
use super::witness_words::{list, seen_json};
use super::{Args, on_controller, record};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::catch::{self as report, Caught};

/// Longest flight that is looked at, s.
const HORIZON_S: f64 = 3.0;

/// Throws of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DiscName {
    /// (0.5, -1, 1.2) m with (0, 4, 0) m/s.
    Flat,
    /// (0.5, -1, 1.05) m with (-2, 4, 1) m/s.
    Oblique,
}

/// Runs the verb.
///
/// # Errors
/// The robot is refused, a value makes no sense, no catch is possible, or the report cannot be written.
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let looked = look(args)?;
    let Looked { arm, throw, path, rule, plan, executed } = &looked;
    if let Some(file) = &args.report {
        let page = report::html(
            arm,
            path,
            rule.as_ref().map(|(run, verdict)| (run, verdict)),
            plan.as_ref().and_then(|p| p.as_ref().ok()).map(|(plan, verdict)| Caught {
                plan,
                verdict,
                executed: executed.as_ref(),
            }),
            plan.as_ref().and_then(|p| p.as_ref().err()).map(ToString::to_string),
        );
        std::fs::write(file, page).map_err(|e| ExpectedError::output(file, &e))?;
    }
    let recorded = match (&args.over_bus.record, executed) {
        (Some(to), Some(run)) => {
            let file = record::file_of(to);
            record::disc(&file, &arm.model, path, arm.size.disc_radius_m, &run.executed)?;
            Some(file)
        }
        (Some(_), None) if !args.on_controller => {
            return Err(ExpectedError::new(exit::USAGE, "--record needs joints that a controller has moved")
                .next("add --on-controller"));
        }
        _ => None,
    };
    if args.json {
        print_json(&looked.as_json());
    } else {
        console::text!("{}", as_text(arm, throw, rule.as_ref(), plan.as_ref()));
        if let (Some(run), Some(Ok((_, planned)))) = (executed, plan) {
            console::text!("{}", on_controller::as_text(arm, run, planned));
        }
        if let Some(file) = &args.report {
            console::line!("report: {}", file.display());
        }
        if let Some(file) = &recorded {
            console::line!("recorded: {}", file.display());
        }
    }
    looked.ended(args.air)
}

/// A throw, and what the rule of the paper and the plan within the limits make of it; each only if it was asked for.
pub(super) struct Looked {
    arm: DiscArm,
    throw: Throw,
    /// The flight of the disc.
    pub(super) path: Path,
    rule: Option<(Run, Verdict)>,
    pub(super) plan: Option<Planned>,
    /// The plan as a controller ran it.
    executed: Option<Judged>,
}

/// Flies the disc and looks for catches; nothing is written or printed.
///
/// # Errors
/// The robot is refused, or a value makes no sense. No catch is no error.
pub(super) fn look(args: &Args) -> Result<Looked, ExpectedError> {
    let robot = RobotModel::load(args.robot.as_deref().unwrap_or("pincher4"))
        .map_err(|e| ExpectedError::bad_input(&e))?;
    let arm = arm(&robot)?;
    let throw = throw(args)?;
    let air = if args.air { Air::still() } else { Air::vacuum() };
    let air = Air { wind_m_s: args.wind.map_or_else(Vector3::zeros, Vector3::from), ..air };
    let body = Body::of_paper();
    let spin_rad_s = if args.air { args.spin_rad_s } else { 0.0 };
    let path =
        Path::flown(&body, &air, &DiscState::released(&throw, Vector3::z(), spin_rad_s, &body), HORIZON_S);
    let rule = (!args.air).then(|| by_rule(&arm, &throw));
    let plan = (!args.no_limits).then(|| within_limits(&arm, &path, args.catching.jerk));
    let executed = match &plan {
        Some(Ok((plan, _))) if args.on_controller => {
            Some(on_controller::run(&robot, &arm, &path, plan, &args.catching.faults)?)
        }
        _ => None,
    };
    Ok(Looked { arm, throw, path, rule, plan, executed })
}

impl Looked {
    pub(super) fn as_json(&self) -> Value {
        let mut json = as_json(&self.arm, &self.throw, self.rule.as_ref(), self.plan.as_ref());
        json["executed"] =
            self.executed.as_ref().map_or(Value::Null, |run| on_controller::as_json(&self.path, run));
        json
    }

    /// How the program ends; `air`: lift and drag were asked for.
    ///
    /// # Errors
    /// There is no catch within the limits, the witness refutes it, or the run of the controller did not catch.
    pub(super) fn ended(&self, air: bool) -> Result<(), ExpectedError> {
        match &self.plan {
            Some(Err(why)) => {
                Err(ExpectedError::new(exit::NO_THROW, format!("no catch within the joint limits: {why}"))
                    .next(format!(
                        "throw slower or from farther away{}",
                        if air { "" } else { "; `--no-limits` shows the rule of the paper alone" }
                    )))
            }
            Some(Ok((_, verdict))) if verdict.caught.is_none() || !verdict.within_limits(&self.arm) => Err(
                ExpectedError::new(exit::BUG, format!("the plan is refuted by the observer: {verdict:?}"))
                    .next("report it with the command line"),
            ),
            _ => self.executed.as_ref().map_or(Ok(()), on_controller::ended),
        }
    }
}

fn arm(robot: &RobotModel) -> Result<DiscArm, ExpectedError> {
    let refused = |why: String| {
        ExpectedError::bad_input(&format!("robot \"{}\" cannot catch discs: {why}", robot.name()))
            .next("`--robot pincher4`, or a file like it")
    };
    match robot.n() {
        4 => DiscArm::new(robot.clone()).map_err(|e| refused(e.to_string())),
        n => Err(refused(format!("it has {n} joints instead of four"))),
    }
}

fn throw(args: &Args) -> Result<Throw, ExpectedError> {
    let named = args.disc.map(|disc| match disc {
        DiscName::Flat => Throw::flat(),
        DiscName::Oblique => Throw::oblique(),
    });
    let start_m = args.start.map(Vector3::from).or(named.map(|t| t.start_m));
    let velocity_m_s = args.velocity.map(Vector3::from).or(named.map(|t| t.velocity_m_s));
    let (Some(start_m), Some(velocity_m_s)) = (start_m, velocity_m_s) else {
        return Err(
            ExpectedError::new(exit::USAGE, "no throw").next("`--disc flat`, or `--start` and `--velocity`")
        );
    };
    let wind = args.wind.map_or(0.0, |w| Vector3::from(w).norm());
    for (what, value, most) in [
        ("start", start_m.norm(), 20.0),
        ("velocity", velocity_m_s.norm(), 30.0),
        ("wind", wind, 30.0),
        ("spin", args.spin_rad_s.abs(), 300.0),
    ] {
        if value.is_nan() || value > most {
            return Err(ExpectedError::bad_input(&format!("--{what}: {value} is beyond {most}"))
                .next("lengths are m, speeds m/s, spin rad/s"));
        }
    }
    if start_m.z <= 0.0 {
        return Err(ExpectedError::bad_input(&format!(
            "--start: the disc starts at a height of {} m, in the floor",
            start_m.z
        ))
        .next("give a height above 0"));
    }
    Ok(Throw { start_m, velocity_m_s })
}

fn by_rule(arm: &DiscArm, throw: &Throw) -> (Run, Verdict) {
    let run = paper::run(arm, throw, &Reading::default());
    let verdict = witness::judge(arm, &Gripper::default(), &Rule::of_paper(arm), &run.moments());
    (run, verdict)
}

fn within_limits(arm: &DiscArm, path: &Path, jerk: bool) -> Result<(Plan, Verdict), Decline> {
    let rest = READY_RAD.map(State::rest);
    let plan = intercept::plan(arm, path, &rest, &Settings { jerk, ..Settings::default() })?;
    let moments = witness::moments(|t_s| plan.motion.q(t_s), path, plan.motion.end_s());
    let verdict = witness::judge(arm, &Gripper::default(), &Rule::default(), &moments);
    Ok((plan, verdict))
}

pub(super) type Planned = Result<(Plan, Verdict), Decline>;

fn as_text(arm: &DiscArm, throw: &Throw, rule: Option<&(Run, Verdict)>, plan: Option<&Planned>) -> String {
    let allowed = arm.model.limit(|l| l.v_max_rad_s);
    let mut out = format!(
        "disc from ({}) m with ({}) m/s\n",
        list(throw.start_m.iter().copied(), 3),
        list(throw.velocity_m_s.iter().copied(), 3)
    );
    if let Some((run, verdict)) = rule {
        out += "rule of the paper, no joint limits:\n";
        out += &match (run.in_reach, run.captured) {
            (Some(first), Some(last)) => {
                let t_s = f64::from(last) * 0.01;
                format!("  in reach at step {first}, captured at step {last} ({t_s:.2} s)\n")
            }
            (Some(first), None) => format!("  in reach at step {first}, not closed within 50 steps\n"),
            (None, _) => "  never in reach within 50 steps\n".to_owned(),
        };
        out += &format!("  observer: {}\n", report::witness_of_rule(run, verdict));
        out += &format!(
            "  joint speeds demanded {} rad/s, allowed {}\n",
            list(run.speed_demanded_rad_s().iter().copied(), 1),
            list(allowed.iter().copied(), 2)
        );
    }
    match plan {
        Some(Ok((plan, verdict))) => {
            out += "plan within the joint limits:\n";
            if let Some((_, seen)) = verdict.caught {
                out += &format!(
                    "  caught at {:.3} s, tip {:.1} cm inside the rim, {:.1} mm off the middle of the gap\n",
                    seen.t_s,
                    seen.depth_m * 100.0,
                    seen.height_m * 1e3
                );
            }
            let (from, to) = plan.motion.waits_s;
            if to > from {
                out += &format!("  waits from {from:.3} s to {to:.3} s\n");
            }
            out += &format!(
                "  joint speeds {} rad/s, allowed {}; largest use {:.0} % of speed, {:.0} % of acceleration\n",
                list(verdict.speed_rad_s.iter().copied(), 2),
                list(allowed.iter().copied(), 2),
                plan.used.0 * 100.0,
                plan.used.1 * 100.0
            );
            out += &format!(
                "  disc relative to the hand: {} m/s (along, up, across)\n",
                list(plan.relative_m_s.iter().copied(), 2)
            );
        }
        Some(Err(why)) => out += &format!("plan within the joint limits: none, {why}\n"),
        None => {}
    }
    out
}

fn as_json(arm: &DiscArm, throw: &Throw, rule: Option<&(Run, Verdict)>, plan: Option<&Planned>) -> Value {
    json!({
        "throw": {"start_m": throw.start_m.as_slice(), "velocity_m_s": throw.velocity_m_s.as_slice()},
        "speed_allowed_rad_s": arm.model.limit(|l| l.v_max_rad_s)[..],
        "rule": rule.map(|(run, verdict)| json!({
            "in_reach_step": run.in_reach, "captured_step": run.captured,
            "speed_demanded_rad_s": run.speed_demanded_rad_s().as_slice(),
            "short_m": run.steps.last().map(paper::Step::short_m),
            "witness": seen_json(verdict),
        })),
        "plan": plan.map(|planned| match planned {
            Ok((plan, verdict)) => json!({
                "t_s": plan.choice.t_s, "depth_m": plan.choice.depth_m, "waits_s": [plan.motion.waits_s.0, plan.motion.waits_s.1],
                "q_rad": plan.reach.q.as_slice(), "qd_rad_s": plan.reach.v.as_slice(),
                "relative_m_s": plan.relative_m_s.as_slice(),
                "speed_use": plan.used.0, "acceleration_use": plan.used.1,
                "witness": seen_json(verdict),
            }),
            Err(why) => json!({"declined": why.to_string()}),
        }),
    })
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::cli::Cli;
    use crate::cmd::Verb;

    fn ended(words: &str) -> Result<(), ExpectedError> {
        let words = std::iter::once("cubectl").chain(words.split_whitespace());
        match Cli::try_parse_from(words).map_err(|e| ExpectedError::new(exit::USAGE, e.to_string()))?.verb {
            Verb::Catch(args) => super::super::run(&args),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn discs_of_the_paper_are_caught_and_a_fast_one_is_declined_with_its_own_code() {
        ended("catch --robot pincher4 --disc flat").unwrap();
        ended("catch --robot pincher4 --disc oblique").unwrap();
        let error = ended("catch --robot pincher4 --start 0.5,-2.6,0.7 --velocity 0,12,1").unwrap_err();
        assert_eq!(error.code, exit::NO_THROW);
        assert!(error.what.contains("times its joint speeds") && !error.next.is_empty(), "{error}");
        ended("catch --disc oblique --no-limits").unwrap();
    }

    #[test]
    fn on_the_controller_a_catch_is_a_catch_and_a_lost_drive_is_reported() {
        ended("catch --disc flat --on-controller").unwrap();
        let code = |words| ended(words).unwrap_err().code;
        assert_eq!(code("catch --disc flat --on-controller --fault drive-lost:0.2"), exit::STOPPED);
        assert_eq!(code("catch --disc flat --on-controller --fault bias:2"), exit::USAGE);
        // Declined before anything runs.
        assert_eq!(code("catch --start 0.5,-2.6,0.7 --velocity 0,12,1 --on-controller"), exit::NO_THROW);
    }

    #[test]
    fn wrong_input_names_the_next_step() {
        for (words, code) in [
            ("catch --robot powercube6 --disc flat", exit::BAD_INPUT),
            ("catch --start 0.5,-1,-1 --velocity 0,4,0", exit::BAD_INPUT),
            ("catch --disc flat --velocity 0,400,0", exit::BAD_INPUT),
            ("catch --disc flat --air --spin-rad-s nan", exit::BAD_INPUT),
            ("catch --start 0.5,-1,1", exit::USAGE),
        ] {
            let error = ended(words).unwrap_err();
            assert_eq!(error.code, code, "{words}: {error}");
            assert!(code == exit::USAGE || !error.next.is_empty(), "{words}: {error}");
        }
    }

    #[test]
    fn the_text_tells_the_steps_of_the_paper_and_what_the_gripper_has() {
        let arm = arm(&RobotModel::load("pincher4").unwrap()).unwrap();
        let rule = by_rule(&arm, &Throw::flat());
        let text = as_text(&arm, &Throw::flat(), Some(&rule), None);
        assert!(text.contains("captured at step 35"), "{text}");
        let rule = by_rule(&arm, &Throw::oblique());
        let text = as_text(&arm, &Throw::oblique(), Some(&rule), None);
        assert!(text.contains("captured at step 42") && text.contains("2.8 cm short"), "{text}");
    }
}
