//! `cubectl plan check PLAN`

use std::path::PathBuf;

use crate::error::ExpectedError;
use crate::exit;
use planner::follow;
use planner::follow::limits::{Arm, Limits};
use planner::follow::plan::FollowPlan;
use planner::record::PlanRecord;
use planner::verify;

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl plan check plan.json && echo sound")]
pub struct Args {
    /// Plan file.
    pub plan: PathBuf,
    /// Robot, by name or file; by default the one the plan was made with.
    #[arg(long)]
    pub robot: Option<String>,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let plan = match PlanRecord::read(&args.plan).map_err(|e| ExpectedError::bad_input(&e))? {
        PlanRecord::Throw(plan) => plan,
        PlanRecord::Follow(plan) => return check_follow(args, &plan),
        PlanRecord::Move(_) => {
            return Err(ExpectedError::bad_input(&format!(
                "{}: a plan of kind \"move\" has no target and no release to check",
                args.plan.display()
            ))
            .next("run `cubectl controller upload`; the controller checks its limits"));
        }
    };
    let robot = crate::cmd::robot(args.robot.as_deref().unwrap_or(&plan.robot.source))?;
    plan.require_robot(&args.plan, &robot).map_err(|e| ExpectedError::bad_input(&e))?;
    let report = verify::check(&robot, &plan);
    if args.json {
        console::line!("{}", serde_json::to_string_pretty(&report).unwrap_or_default());
    } else {
        for f in &report.findings {
            let mark = match (f.ok, f.enforced) {
                (true, _) => "ok  ",
                (false, true) => "FAIL",
                (false, false) => "note",
            };
            let when = f.at_s.map_or_else(String::new, |t| format!(" at {t:.3} s"));
            console::line!("{mark}  {}: {}{when}", f.what, f.worst);
        }
        console::line!("{} instants", report.samples);
    }
    if report.ok() {
        return Ok(());
    }
    let failed: Vec<&str> =
        report.findings.iter().filter(|f| !f.ok && f.enforced).map(|f| f.what.as_str()).collect();
    Err(ExpectedError::new(
        exit::CHECK_FAILED,
        format!("plan {} does not hold what it claims: {}", args.plan.display(), failed.join("; ")),
    ))
}

/// What the check of a throw that follows the flight measured and found wrong.
#[must_use]
pub fn follow_findings(arm: &Arm, plan: &FollowPlan) -> (follow::verify::Report, Vec<String>) {
    let report = follow::verify::verify(arm, &Limits::of(arm, plan.limits), plan);
    let findings = report.findings.iter().map(ToString::to_string).chain(plan.false_claim(arm)).collect();
    (report, findings)
}

/// The same, as `cubectl plan check --json` prints it.
#[must_use]
pub fn follow_json((report, findings): &(follow::verify::Report, Vec<String>)) -> serde_json::Value {
    serde_json::json!({
        "good": findings.is_empty(),
        "findings": findings,
        "off_parabola_m": report.off_parabola_m,
        "landing_m": report.landing_m,
        "executed_landing_m": report.executed_landing_m,
        "nearest_m": report.nearest_m,
        "ball_m": report.ball_m,
    })
}

/// Checks a throw that follows the flight, from its set points.
fn check_follow(args: &Args, plan: &FollowPlan) -> Result<(), ExpectedError> {
    let arm = crate::cmd::six_axes(args.robot.as_deref().unwrap_or(&plan.robot.source))?;
    plan.require_robot(&args.plan, &arm).map_err(|e| ExpectedError::bad_input(&e))?;
    let checked = follow_findings(&arm, plan);
    let (report, findings) = &checked;
    if args.json {
        crate::cmd::print_json(&follow_json(&checked));
    } else {
        for finding in findings {
            console::line!("FAIL  {finding}");
        }
        console::line!(
            "{} steps, {} on the parabola: ball off it by {:.3} mm, landing off by {:.2} mm, nearest bodies {:.1} mm, ball {:.1} mm",
            plan.steps.len(),
            plan.followed_points,
            report.off_parabola_m * 1e3,
            report.landing_m * 1e3,
            report.nearest_m * 1e3,
            report.ball_m * 1e3
        );
    }
    if findings.is_empty() {
        return Ok(());
    }
    Err(ExpectedError::new(
        exit::CHECK_FAILED,
        format!("plan {} does not hold what it claims: {}", args.plan.display(), findings.join("; ")),
    ))
}
