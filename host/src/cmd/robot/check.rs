//! `cubectl robot check ROBOT`

use operator::bus::period::{PeriodRequest, choose, usual_us};
use operator::bus::settings::settings_of;
use operator::bus::sim::SimSetup;
use robot_model::survey::{Weight, survey};
use robot_model::uses::{Missing, Use, missing};
use robot_model::{RobotModel, text_of};

use crate::cmd::plan::follow::is_industrial;
use crate::error::ExpectedError;
use crate::exit;

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl robot check arm.toml

At the end stands what the file can be used for: to plan, to simulate, on a real bus; before it all that is missing for each use,
with the lines to add. Exit code 4 if the file cannot be used, 9 if a value is implausible or assumed.")]
pub struct Args {
    /// Robot, by name or file.
    pub robot: String,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let (file, text) = text_of(&args.robot).map_err(|e| ExpectedError::bad_input(&e))?;
    let findings = survey(&file, &text).map_err(|e| ExpectedError::bad_input(&e))?;
    let (lacking, uses) = uses(&file, &text)?;
    if args.json {
        let found = findings.iter().map(|f| {
            let weight = word(f.weight);
            serde_json::json!({ "file": file, "line": f.line, "key": f.key, "weight": weight, "what": f.what, "next": f.next })
        });
        let lacking = lacking.iter().map(|m| {
            let purpose = purpose(m.purpose);
            serde_json::json!({ "file": file, "key": m.key, "weight": "missing", "use": purpose, "what": m.what, "next": m.lines })
        });
        super::super::print_json(&found.chain(lacking).collect());
    } else {
        for f in &findings {
            let line = f.line.map_or_else(String::new, |line| format!(":{line}"));
            console::line!("{file}{line}: {}: {}: {}", word(f.weight), f.key, f.what);
            console::line!("  next: {}", f.next);
        }
        for name in [Use::Simulate, Use::RealBus] {
            let of_it: Vec<&Missing> = lacking.iter().filter(|m| m.purpose == name).collect();
            if !of_it.is_empty() {
                console::line!("to {} is missing:", purpose(name));
            }
            for m in of_it {
                console::line!("  {}: {}\n    {}", m.key, m.what, m.lines.replace('\n', "\n    "));
            }
        }
    }
    let count = |weight| findings.iter().filter(|f| f.weight == weight).count();
    let (errors, implausible, assumed) =
        (count(Weight::Error), count(Weight::Implausible), count(Weight::Assumed));
    if errors > 0 {
        return Err(ExpectedError::new(exit::BAD_INPUT, format!("{file} cannot be used: {errors} errors")));
    }
    if implausible + assumed > 0 {
        let what =
            format!("{file} can be used {uses}; {implausible} values are implausible, {assumed} are assumed");
        return Err(ExpectedError::new(exit::FINDINGS, what));
    }
    if !args.json {
        console::line!("{file} can be used {uses}; nothing is assumed or implausible");
    }
    Ok(())
}

/// What the file lacks for each use, and what it can be used for. Nothing of a file that cannot be loaded.
fn uses(file: &str, text: &str) -> Result<(Vec<Missing>, String), ExpectedError> {
    let Ok(robot) = RobotModel::from_toml(file, text) else { return Ok((Vec::new(), String::new())) };
    if is_industrial(&robot) {
        return Ok((Vec::new(), "to plan, simulate and lead over RSI".to_owned()));
    }
    let mut lacking = missing(&robot, file, text).map_err(|e| ExpectedError::bad_input(&e))?;
    if robot.drives().is_some() && robot.drive_loop().is_some() {
        // What a throw does before anything moves.
        let refused = settings_of(&robot).map_err(|e| ExpectedError::bad_input(&e)).and_then(|settings| {
            let usual_us = usual_us(&robot, &SimSetup::default(), &settings);
            choose(PeriodRequest::Any, None, &robot, usual_us)
                .map(drop)
                .map_err(|e| ExpectedError::bad_input(&e))
        });
        lacking.extend(refused.err().map(|refused| Missing {
            purpose: Use::Simulate,
            key: "joint".to_owned(),
            what: refused.what,
            lines: refused.next.join("\n")
                + "\n(another value; `cubectl controller registers list` shows the limits of a controller)",
        }));
    }
    let works = |name: Use| lacking.iter().all(|m| m.purpose != name);
    let uses = match (works(Use::Simulate), works(Use::RealBus)) {
        (true, true) => "to plan, to simulate and on a real bus",
        (true, false) => "to plan and to simulate",
        (false, _) => "to plan",
    };
    Ok((lacking, uses.to_owned()))
}

fn purpose(name: Use) -> &'static str {
    match name {
        Use::Simulate => "simulate",
        Use::RealBus => "move drives on a real bus",
    }
}

fn word(weight: Weight) -> &'static str {
    match weight {
        Weight::Error => "error",
        Weight::Implausible => "implausible",
        Weight::Assumed => "assumed",
    }
}
