//! `cubectl plan export PLAN --csv`

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

use crate::error::ExpectedError;
use planner::motion::Motion;
use planner::plan::file::PlanFile;

#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  cubectl plan export plan.json --csv --step-s 0.001 --out plan.csv")]
pub struct Args {
    /// Plan file.
    pub plan: PathBuf,
    /// Write comma-separated values: time, then position, speed and acceleration of every joint. The one format there is.
    #[arg(long)]
    pub csv: bool,
    /// Distance of rows in s.
    #[arg(long, default_value_t = 0.005)]
    pub step_s: f64,
    /// File to write; by default the terminal.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let fine = args.step_s >= 1e-5 && args.step_s <= 10.0;
    if !fine {
        return Err(ExpectedError::bad_input(&format!(
            "step of {} s is outside 0.00001 to 10 s",
            args.step_s
        )));
    }
    let plan = PlanFile::read(&args.plan).map_err(|e| ExpectedError::bad_input(&e))?;
    let text = table(&plan, args.step_s);
    match &args.out {
        Some(path) => std::fs::write(path, text).map_err(|e| ExpectedError::output(path, &e)),
        None => {
            // A reader that has seen enough (`| head`) is not an error.
            match std::io::stdout().write_all(text.as_bytes()) {
                Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
                    Err(ExpectedError::new(crate::exit::OUTPUT, format!("terminal: {e}")))
                }
                _ => Ok(()),
            }
        }
    }
}

/// The table; the release and the end have rows of their own.
#[must_use]
pub fn table(plan: &PlanFile, step_s: f64) -> String {
    let mut out = String::from("t_s");
    for (quantity, unit) in [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2")] {
        for joint in &plan.motion.joints {
            let _ = write!(out, ",{quantity}_{joint}_{unit}");
        }
    }
    out.push('\n');
    let mut times: Vec<f64> =
        (0..).map(|i| f64::from(i) * step_s).take_while(|t| *t < plan.end_time_s).collect();
    times.extend([plan.release_time_s, plan.end_time_s]);
    times.sort_by(f64::total_cmp);
    times.dedup();
    let motion: Motion = plan.motion.to_motion();
    for t in times {
        let s = motion.at(t);
        let _ = write!(out, "{t}");
        for value in s.q.iter().chain(s.qd.iter()).chain(s.qdd.iter()) {
            let _ = write!(out, ",{value}");
        }
        out.push('\n');
    }
    out
}
