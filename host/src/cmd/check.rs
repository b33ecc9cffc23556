//! `cubectl check PLAN`

use std::path::PathBuf;

use crate::error::ExpectedError;
use crate::exit;
use planner::plan::file::PlanFile;
use planner::verify;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl check plan.json && echo sound")]
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

/// Runs the verb.
///
/// # Errors
/// If the plan cannot be read, is for another robot, or does not hold what it claims.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let plan = PlanFile::read(&args.plan).map_err(|e| ExpectedError::bad_input(&e))?;
    let arm = super::arm(args.robot.as_deref().unwrap_or(&plan.robot.source))?;
    plan.require_robot(&args.plan, &arm).map_err(|e| ExpectedError::bad_input(&e))?;
    let report = verify::check(&arm, &plan);
    if args.json {
        say::line!("{}", serde_json::to_string_pretty(&report).unwrap_or_default());
    } else {
        for f in &report.findings {
            let mark = match (f.ok, f.enforced) {
                (true, _) => "ok  ",
                (false, true) => "FAIL",
                (false, false) => "note",
            };
            let when = f.at_s.map_or_else(String::new, |t| format!(" at {t:.3} s"));
            say::line!("{mark}  {}: {}{when}", f.what, f.worst);
        }
        say::line!("{} instants", report.samples);
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
