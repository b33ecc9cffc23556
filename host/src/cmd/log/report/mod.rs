//! `cubectl log report`

pub(in crate::cmd) mod program;

use std::io::Read;
use std::path::{Path, PathBuf};

use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Instant};
use serde_json::Value;

use crate::cmd::folder::Folder;
use crate::cmd::{print_json, rsi};
use crate::error::ExpectedError;
use crate::report::industrial::RobotRun;
use crate::report::motion;
use crate::report::run::{EarlyReport, Ran, RunReport};
use operator::analysis::events::{self, RunEvent};
use operator::analysis::{AnalysisError, PlanClock, Run, RunAnalysis, analyse, drives_of};
use operator::bus::BIT_RATE_BIT_S;
use operator::log::candump::{self, Recording, Tear};
use operator::log::text_in;
use operator::samples::Samples;
use planner::follow::limits::Limits;
use planner::plan::file::{Kind, PlanFileError, require_robot};
use planner::record::PlanRecord;
use planner::throw::Arm;

/// What an industrial robot did, in the folder of a run.
pub(in crate::cmd) const MOTION: &str = "motion.csv";
/// Longest `summary.json` that is read, bytes.
const SUMMARY_MAX_BYTES: u64 = 64 << 20;

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl log report throw1                       # the folder of a `cubectl throw`\n  cubectl log report throw1 --json | jq .joints   # the same in numbers\n  cubectl log report --plan plan.json --log throw1.log --out throw1.html\n\nThe file opens offline in any browser."
)]
pub struct Args {
    /// Folder of a run: plan.json (program.json of a program), bus.log (log.rsi of an industrial robot) and, if it is there, summary.json.
    /// The report goes there too.
    #[arg(required_unless_present_all = ["plan", "log"])]
    pub folder: Option<PathBuf>,
    /// Plan file, if it is not in the folder.
    #[arg(long, value_name = "FILE")]
    pub plan: Option<PathBuf>,
    /// Candump log, if it is not in the folder.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Where to write the report. Default: report.html in the folder.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Robot the run was made with: a built-in name or a file. Default: what the plan names.
    #[arg(long)]
    pub robot: Option<String>,
    /// Bit rate of the bus, for times on it, bit/s. Default: that of summary.json, or 1000000.
    #[arg(long, value_name = "BIT/S", value_parser = clap::value_parser!(u32).range(10_000..=1_000_000))]
    pub bit_rate: Option<u32>,
    /// Print the analysis as JSON instead of writing a report.
    #[arg(long)]
    pub json: bool,
}

/// A run read from its files.
pub struct Recorded {
    /// The robot.
    pub arm: Arm,
    /// What was run.
    pub ran: Ran,
    /// What the log says, or why it does not suffice.
    pub analysis: Result<RunAnalysis, AnalysisError>,
    /// What happened, in time of the log; empty if there is an analysis, which has them in time of the plan.
    pub events: Vec<RunEvent>,
    /// Where the log was cut off.
    pub torn: Option<Tear>,
    /// `summary.json`.
    pub summary: Option<Value>,
    /// Files: name, bytes, checksum.
    pub files: Vec<(String, u64, String)>,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if let Some(path) = args.folder.as_ref().filter(|path| path.is_file()) {
        let refused =
            ExpectedError::bad_input(&format!("{}: a file, not the folder of a run", path.display()));
        return Err(refused
            .next("name the folder, or the files: `cubectl log report --plan PLAN --log LOG --out REPORT`"));
    }
    let of_program = |folder: &PathBuf| folder.join(program::DONE).is_file();
    if let Some(folder) =
        args.folder.as_ref().filter(|folder| rsi::is_recording(folder) || of_program(folder))
    {
        let out = args.out.clone().unwrap_or_else(|| folder.join("report.html"));
        if args.json {
            print_json(&summary_of(&folder.join("summary.json"))?);
            return Ok(());
        }
        if of_program(folder) { program::write(folder, &out) } else { write_robot(folder, &out) }?;
        console::line!("{}", out.display());
        return Ok(());
    }
    let place = |given: &Option<PathBuf>, name: &str| -> Option<PathBuf> {
        given.clone().or_else(|| Some(args.folder.as_ref()?.join(name)))
    };
    let needed = |path: Option<PathBuf>, option: &str| {
        path.ok_or_else(|| ExpectedError::bad_input(&format!("name a folder, or the file with {option}")))
    };
    let plan = needed(place(&args.plan, "plan.json"), "--plan")?;
    let log = needed(args.log.clone().or_else(|| args.folder.as_deref().map(text_in)), "--log")?;
    let summary = place(&None, "summary.json").filter(|path| path.exists());
    let recorded = read(&plan, &log, summary.as_deref(), args.robot.as_deref(), args.bit_rate)?;
    if let Some(tear) = &recorded.torn {
        console::note!("{}: {tear}", log.display());
    }
    if args.json {
        let analysis = recorded.analysis.map_err(|why| not_analysed(&log, &why))?;
        print_json(&serde_json::to_value(&analysis).unwrap_or_default());
        return Ok(());
    }
    let out = needed(place(&args.out, "report.html"), "--out")?;
    write(&recorded, &out)?;
    console::line!("{}", out.display());
    Ok(())
}

/// Reads and analyses a run. The bit rate that is not given is that of the summary, or 1 Mbit/s.
pub fn read(
    plan: &Path,
    log: &Path,
    summary: Option<&Path>,
    robot: Option<&str>,
    bit_rate_bit_s: Option<u32>,
) -> Result<Recorded, ExpectedError> {
    let of_robot = log.file_name().is_some_and(|name| name == MOTION);
    let recording = if of_robot { Recording::default() } else { candump::read_file(log)? };
    let mut files = vec![checksum(plan)?, checksum(log)?];
    let bad = |error: PlanFileError| ExpectedError::bad_input(&error);
    let ran = match PlanRecord::read(plan).map_err(bad)? {
        PlanRecord::Throw(plan) => Ran::from(*plan),
        PlanRecord::Move(plan) => Ran { motion: plan.motion.to_motion(), robot: plan.robot, throw: None },
        PlanRecord::Follow(_) => {
            let (found, wanted) = (Kind::Follow, Kind::Throw);
            return Err(bad(PlanFileError::OtherKind { path: plan.to_owned(), found, wanted }));
        }
    };
    let arm = crate::cmd::robot(robot.unwrap_or(&ran.robot.source))?;
    require_robot(plan, &ran.robot, ran.motion.start_rad().len(), &arm).map_err(bad)?;
    let summary = match summary {
        Some(path) => {
            files.push(checksum(path)?);
            Some(summary_of(path)?)
        }
        None => None,
    };
    let noted = |key: &str| summary.as_ref().and_then(|value: &Value| value.get(key)).cloned();
    let begun = recording.lines.first().map_or(Instant::ZERO, |line| line.at);
    let samples = if of_robot {
        motion::samples(&rows_of(log)?)
    } else {
        let drives = match noted("drives").and_then(|drives| serde_json::from_value(drives).ok()) {
            Some(drives) => drives,
            None => drives_of(&arm).map_err(|error| not_analysed(log, &error))?,
        };
        let of_summary = || summary.as_ref()?.pointer("/analysis/bus/bit_rate_bit_s")?.as_f64();
        let rate = bit_rate_bit_s.or_else(|| of_summary().map(|rate| rate.round() as u32));
        Samples::of_log(recording.lines, drives, &arm, rate.unwrap_or(BIT_RATE_BIT_S))
    };
    let run = Run {
        samples: &samples,
        motion: &ran.motion,
        throw: ran.throw.as_ref(),
        arm: &arm,
        start: samples.begun,
        gripper_opening: noted("gripper_opening_us").and_then(|us| us.as_u64()).map(Duration::from_micros),
        certified: noted("certified_timing").and_then(|timing| serde_json::from_value(timing).ok()),
    };
    let (analysis, events) = match analyse(&run) {
        Ok(analysis) => (Ok(analysis), Vec::new()),
        // A throw that ended early has a report all the same.
        Err(error) if summary.is_some() => (Err(error), events::events(&samples, PlanClock::starting(begun))),
        Err(error) => return Err(not_analysed(log, &error)),
    };
    let analysis = analysis.map(|analysis| RunAnalysis { torn: recording.tear, ..analysis });
    Ok(Recorded { arm, ran, analysis, events, torn: recording.tear, summary, files })
}

fn not_analysed(log: &Path, why: &AnalysisError) -> ExpectedError {
    ExpectedError::bad_input(why).at(log.display())
}

/// Writes the report of a job into its folder, from the files there.
pub(in crate::cmd) fn write_into(folder: &Folder, robot: &str) -> Result<(), ExpectedError> {
    let is_led = rsi::is_recording(&folder.path);
    let log = if is_led { MOTION } else { "bus.log" };
    let [plan, log, summary] = ["plan.json", log, "summary.json"].map(|name| folder.file(name));
    let recorded = read(&plan, &log, Some(&summary), Some(robot), None)?;
    write(&recorded, &folder.file("report.html"))
}

pub fn write(recorded: &Recorded, out: &Path) -> Result<(), ExpectedError> {
    let Recorded { arm, ran, analysis, events, torn, summary, files } = recorded;
    let html = match (analysis, summary) {
        (Ok(analysis), summary) => RunReport { arm, ran, analysis, summary: summary.as_ref(), files }.html(),
        (Err(why), Some(summary)) => {
            let why = &why.to_string();
            EarlyReport { ran, summary, why, events, torn: *torn, files }.html()
        }
        (Err(why), None) => return Err(ExpectedError::bad_input(why)),
    };
    std::fs::write(out, html).map_err(|error| ExpectedError::output(out, &error))
}

/// What a job left in `summary.json`.
fn summary_of(file: &Path) -> Result<Value, ExpectedError> {
    let text =
        toml_reader::read_text(file, SUMMARY_MAX_BYTES).map_err(|error| ExpectedError::io(file, &error))?;
    serde_json::from_str(&text)
        .map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", file.display())))
}

/// What an industrial robot did.
fn rows_of(file: &Path) -> Result<Vec<motion::Row>, ExpectedError> {
    let text =
        toml_reader::read_text(file, SUMMARY_MAX_BYTES).map_err(|error| ExpectedError::io(file, &error))?;
    motion::read(file, &text)
}

/// Writes the report of a throw or a motion with an industrial robot from the files of its folder.
pub fn write_robot(folder: &Path, out: &Path) -> Result<(), ExpectedError> {
    let [plan_file, table, summary] = ["plan.json", MOTION, "summary.json"].map(|name| folder.join(name));
    let plan = match PlanRecord::read(&plan_file).map_err(|error| ExpectedError::bad_input(&error))? {
        PlanRecord::Follow(plan) => *plan,
        _ => return write(&read(&plan_file, &table, Some(&summary), None, None)?, out),
    };
    let arm = crate::cmd::six_axes(&plan.robot.source)?;
    let (rows, summary) = (rows_of(&table)?, summary_of(&summary)?);
    let limits = Limits::of(&arm, plan.limits);
    let files = ["plan.json", rsi::LOG, MOTION, "summary.json"].map(|name| folder.join(name));
    let files: Vec<_> =
        files.iter().filter(|file| file.is_file()).map(|file| checksum(file)).collect::<Result<_, _>>()?;
    let (arm, plan, limits, rows, summary) = (&arm, &plan, &limits, &rows, &summary);
    let html = RobotRun { arm, plan, limits, rows, summary, files: &files }.html();
    std::fs::write(out, html).map_err(|error| ExpectedError::output(out, &error))
}

/// Name, length and CRC-64 of a file.
pub(in crate::cmd) fn checksum(path: &Path) -> Result<(String, u64, String), ExpectedError> {
    let failed = |error| ExpectedError::io(path, &error);
    let mut file = std::fs::File::open(path).map_err(failed)?;
    let (mut crc, mut bytes, mut piece) = (Crc64::new(), 0, vec![0; 1 << 16]);
    loop {
        match file.read(&mut piece).map_err(failed)? {
            0 => break,
            n => {
                crc.update(&piece[..n]);
                bytes += n as u64;
            }
        }
    }
    let name =
        path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
    Ok((name, bytes, format!("{:016x}", crc.get())))
}
