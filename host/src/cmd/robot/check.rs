//! `cubectl robot check ROBOT`

use robot_model::survey::{Weight, survey};
use robot_model::text_of;

use crate::error::ExpectedError;
use crate::exit;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl robot check arm.toml

Exit code 4 if the file cannot be used, 9 if a value is implausible or assumed.")]
pub struct Args {
    /// Robot, by name or file.
    pub robot: String,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Runs the verb.
///
/// # Errors
/// If the file cannot be read or used, or if there is something to look at.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let (file, text) = text_of(&args.robot).map_err(|e| ExpectedError::bad_input(&e))?;
    let findings = survey(&file, &text).map_err(|e| ExpectedError::bad_input(&e))?;
    if args.json {
        let rows = findings.iter().map(|f| {
            let weight = word(f.weight);
            serde_json::json!({ "file": file, "line": f.line, "key": f.key, "weight": weight, "what": f.what, "next": f.next })
        });
        super::super::print_json(&rows.collect());
    } else {
        for f in &findings {
            let line = f.line.map_or_else(String::new, |line| format!(":{line}"));
            console::line!("{file}{line}: {}: {}: {}", word(f.weight), f.key, f.what);
            console::line!("  next: {}", f.next);
        }
    }
    let count = |weight| findings.iter().filter(|f| f.weight == weight).count();
    let (errors, implausible, assumed) =
        (count(Weight::Error), count(Weight::Implausible), count(Weight::Assumed));
    if errors > 0 {
        return Err(ExpectedError::new(exit::BAD_INPUT, format!("{file} cannot be used: {errors} errors")));
    }
    if implausible + assumed > 0 {
        let what = format!("{file} can be used; {implausible} values are implausible, {assumed} are assumed");
        return Err(ExpectedError::new(exit::FINDINGS, what));
    }
    if !args.json {
        console::line!("{file}: nothing is missing, assumed or implausible");
    }
    Ok(())
}

fn word(weight: Weight) -> &'static str {
    match weight {
        Weight::Error => "error",
        Weight::Implausible => "implausible",
        Weight::Assumed => "assumed",
    }
}
