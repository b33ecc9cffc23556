//! `cubectl throw`

mod drives;
pub mod led;

use std::path::{Path, PathBuf};
use std::time::Instant as WallTime;

use can_link::BusSpec;
use planner::follow::limits::AXES;
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use self::drives::Drives;
pub(super) use self::drives::period_request;
use self::led::Led;
use super::consent::Consent;
use super::ended::{Seen, command_line, off_target, outcome_last};
use super::folder::Folder;
use super::last_look::LastLook;
use super::log::report;
use super::meaning::{Deed, Given};
use super::plan::follow::is_industrial;
use super::print_json;
use super::progress::{ProgressView, Ui};
use super::request::{self, readers};
use super::rsi::write_description;
use super::tracker::{Measured, TargetArg, TrackerArgs};
use super::tune::InForce;
use super::values::{numbers, share};
use super::web::{WebArgs, show_end};
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::Controller;
use operator::bus::key_file::KeyArgs;
use operator::bus::period::{NoPeriod, PERIOD_MAX_US, PERIOD_MIN_US};
use operator::bus::soft::SoftReport;
use operator::job::summary::{Circumstances, summary};
use operator::job::{Order, Record};
use operator::live::LiveServer;
use operator::rsi::log::Line;
use tuner::gains::choose::GainsFrom;
use tuner::gains::gains_file::GainsFile;

#[derive(Debug, clap::Args, serde::Deserialize)]
#[command(
    after_help = "Examples:\n  cubectl throw --target 1.0,1.0,-1.0                      # in the simulated cell\n  cubectl throw --target 1.0,1.0,-1.0 --bus can0            # a controller that is heard there, else one in this program\n  cubectl throw --plan plan.json --bus can0 --controller 10\n  cubectl throw --robot kr16_2 --target 2.5,0,0.6           # an industrial robot, inside this program, over RSI\n  cubectl throw --robot kr16_2 --target tracker --bus rsi:udp://0.0.0.0:49152\n\nWrites plan.json, gains.toml, bus.log, bus.mcap, summary.json and report.html into a new folder. Ctrl-C, SIGTERM and\nSIGHUP stop the arm along its path, then end the program with code 6. On every bus but `sim` it asks before the arm moves and\nonce more before the ball is thrown; without a terminal it needs --yes.\n\nOutcomes and exit codes: landed 0, missed 11, not released 12, stopped 13. Only the bus `sim` sees the ball. On every\nother bus the outcome is \"thrown, not observed\" (0): the program then says when the release was ordered and where the\nmeasured motion sends the ball. A drive that has lost encoder counts reports a wrong position; nothing\nin its answers shows that.\n\n`cubectl plan throw` has all options of the search (form, limits, moving targets, openings, drag, regions);\n`--plan` throws its plan."
)]
pub struct Args {
    #[command(flatten)]
    #[serde(rename = "+given")]
    pub given: Given,
    /// Target in m, world frame (arm base, z up), or `tracker`: where an optical tracker sees it.
    #[arg(long, value_name = "X,Y,Z|tracker", allow_hyphen_values = true, required_unless_present = "plan")]
    #[serde(skip)]
    pub target: Option<TargetArg>,
    /// Throw this plan instead of making one.
    #[arg(long, value_name = "FILE", conflicts_with = "target")]
    #[serde(skip)]
    pub plan: Option<PathBuf>,
    #[arg(long, help = format!("Bus: sim (the cell inside this program, in virtual time), {}", can_link::LIVE_BUSES), value_parser = can_link::bus_of_option, default_value_t, value_name = "SPEC", help_heading = "Bus")]
    #[serde(skip)]
    pub bus: BusSpec,
    #[command(flatten)]
    #[serde(skip)]
    pub key: KeyArgs,
    /// `soft`: a controller in this program. A number: the one with this Cyphal node-ID. Default: the one that is
    /// heard, else a soft one.
    #[arg(long, value_name = "soft|NODE-ID", help_heading = "Controller")]
    #[serde(skip)]
    pub controller: Option<Controller>,
    /// Gains with their certificate, from `cubectl tune`; a controller in this program runs at their period. Default: for
    /// a controller in this program those that come with it for powercube6, and a design made on the way for any other
    /// robot; else those that the controller on the bus has.
    #[arg(long, value_name = "FILE", help_heading = "Controller")]
    #[serde(skip)]
    pub gains: Option<PathBuf>,
    /// Control period of a controller in this program, ms: 3, 5, 10, 17 or 30. Default: the shortest one that this machine
    /// and this bus hold, which is measured first.
    #[arg(long = "period-ms", alias = "period", id = "period_ms", value_name = "MS", conflicts_with = "gains", value_parser = period_us, help_heading = "Controller")]
    #[serde(skip)]
    pub period: Option<u32>,
    /// Seed of the planner and of the simulated cell [default: the scenario's, or 1].
    #[arg(long, help_heading = "Simulated cell")]
    pub seed: Option<u64>,
    /// Scenario of the simulated cell: its options, and what goes wrong (`cubectl explain faults` lists the kinds).
    #[arg(long, value_name = "FILE", help_heading = "Simulated cell")]
    pub scenario: Option<PathBuf>,
    /// Robot, by name or file.
    #[arg(long, default_value = "powercube6")]
    pub robot: String,
    /// A box in the way: centre and half edges in m; may be given several times.
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ", allow_hyphen_values = true, value_parser = numbers::<6>)]
    #[serde(skip)]
    pub obstacle: Vec<[f64; 6]>,
    /// Random starts of the search after the stored ones [default: as many as are likely to find a better throw]. With a seed the
    /// result is always the same.
    #[arg(long)]
    #[serde(skip)]
    pub starts: Option<usize>,
    /// Folder for the results [default: throw-DATE-TIME].
    #[arg(long, value_name = "DIR")]
    #[serde(skip)]
    pub out: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    #[serde(skip)]
    pub json: bool,
    /// Look for the cheapest throw with random starts too, for some seconds.
    #[arg(long)]
    #[serde(skip)]
    pub thorough: bool,
    /// Share of the robot's speeds and accelerations on the way to the start.
    #[arg(long = "speed-share", alias = "approach-share", id = "speed_share", default_value_t = 0.3, value_name = "SHARE", value_parser = share)]
    #[serde(rename = "speed_share", deserialize_with = "share_of")]
    pub approach_share: f64,
    /// A landing farther from the target than this is a miss, m [default: the distance within which 99 % of the landings
    /// of the plan lie, computed again, from 0.010 to 0.100].
    #[arg(long = "tolerance-m", alias = "tolerance", id = "tolerance_m", value_name = "M", value_parser = super::values::positive)]
    #[serde(rename = "tolerance_m", default, deserialize_with = "metres_of")]
    pub tolerance: Option<f64>,
    /// Afterwards go back to where the arm stood. Default: stay where the throw ends.
    #[arg(long)]
    #[serde(skip)]
    pub back: bool,
    /// Do not ask before the arm moves and before the ball is thrown.
    #[arg(long)]
    #[serde(skip)]
    pub yes: bool,
    /// Description of an industrial robot and its program: kr-c2, kr-c2-tcp, kr-c4, kr-c4-12ms, or a file as in robots/kr16_2
    /// [default: kr-c2; with --scenario its program].
    #[arg(long, value_name = "DESCRIPTION", help_heading = "Bus")]
    pub rsi: Option<String>,
    #[command(flatten)]
    #[serde(skip)]
    pub web: WebArgs,
    /// Where the target is measured with `--target tracker`.
    #[command(flatten)]
    #[serde(skip, default = "request::usual")]
    pub tracker: TrackerArgs,
}

readers! {
    share_of: share => f64;
    metres_of: super::values::positive => f64;
}

/// A throw that is ready to begin.
enum Prepared {
    /// With the drives of a controller of this project.
    Drives(Box<Drives>),
    /// With a robot that is led.
    Led(Box<Led>),
}

/// Runs the verb.
///
/// # Errors
/// No throw, a plan that does not fit, the bus, the controller, the disk, or Ctrl-C. Each has its exit code.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let arm = super::robot(&args.robot)?;
    let led = (arm.n() == AXES && is_industrial(&arm)).then_some(arm);
    match &led {
        Some(_) => led::require_meaning(args)?,
        None => args.given.require_meaning(&args.deeds(&[Deed::OnCan]))?,
    }
    let consent = Consent::on(&args.bus, args.yes)?;
    let begun = WallTime::now();
    let prepared = match led {
        Some(arm) => Prepared::Led(Box::new(led::prepare(args, arm)?)),
        None => Prepared::Drives(Box::new(drives::prepare(args)?)),
    };
    let folder = Folder::create(args.out.as_deref())?;
    let mut progress = ProgressView::new(args.json);
    let (plan, tracked) = match &prepared {
        Prepared::Drives(drives) => (drives.plan.to_json(), drives.tracked.as_ref()),
        Prepared::Led(led) => {
            write_description(&folder.path, &led.believed.described)?;
            (led.plan.to_json(), led.tracked.as_ref())
        }
    };
    folder.write("plan.json", &plan)?;
    prepared.show(&mut progress);
    let in_step = matches!(&args.bus, BusSpec::Rsi(spec) if spec.lockstep);
    let look = tracked.map(|before| LastLook::new(&args.tracker, before, in_step));
    let words = [
        "The arm homes if it must and goes to the start. Nobody near?",
        "The arm stands at the start. Ball in the hand, nobody near?",
    ];
    let mut ui = Ui { progress, consent, words, look, agreed: false };
    let order = prepared.order(args);
    let mut done = match &prepared {
        Prepared::Drives(drives) => drives.throw(args, &order, &folder, &mut ui)?,
        Prepared::Led(led) => led.throw(args, &order, &folder, &mut ui)?,
    };
    let Ui { mut progress, look, .. } = ui;
    progress.quiet();
    let off = || off_target(&done.record, &order.judge);
    let wrong = look.and_then(|look| look.refused).or(done.wrong.take()).or_else(off);
    let written = prepared.write(args, &order, &folder, &done, (&mut progress, wrong.as_ref(), tracked));
    let said = wrong.is_none().then_some(&done.record.verdict);
    progress.closing(&done.record, said, &folder.path, begun);
    if let Some(page) = done.page.take() {
        let text = format!("ended: {}; results in {}", done.record.verdict.text, folder.path.display());
        show_end(&page, text, &folder.file("report.html"));
    }
    outcome_last(wrong, written, Some(&folder.path))
}

/// What a throw left behind.
#[derive(Default)]
struct Done {
    record: Record,
    /// What went wrong first.
    wrong: Option<ExpectedError>,
    /// Why the recording is not whole.
    lost: Option<ExpectedError>,
    seen: Seen,
    soft: Option<SoftReport>,
    /// What went into the station of a robot that is led, and came out.
    lines: Vec<Line>,
    /// The live view.
    page: Option<LiveServer>,
}

impl Prepared {
    fn order(&self, args: &Args) -> Order<'_> {
        match self {
            Self::Drives(drives) => drives.order(args),
            Self::Led(led) => led.order(args),
        }
    }

    fn show(&self, progress: &mut ProgressView) {
        match self {
            Self::Drives(drives) => drives.show(progress),
            Self::Led(led) => progress.following(&led.plan, led.plan_s),
        }
    }

    /// Writes what the record says: each file is tried, and the first that fails is reported.
    fn write(
        &self,
        args: &Args,
        order: &Order<'_>,
        folder: &Folder,
        done: &Done,
        (progress, wrong, tracked): (&mut ProgressView, Option<&ExpectedError>, Option<&Measured>),
    ) -> Result<(), ExpectedError> {
        let gains = match self {
            Self::Drives(drives) => gains_toml(&done.record, drives.gains.as_ref()),
            Self::Led(_) => None,
        };
        let about = match self {
            Self::Drives(drives) => Circumstances {
                seed: Some(drives.cell.seed),
                soft: done.soft.as_ref(),
                wall_s: &progress.wall_s,
                plan_s: drives.plan_s,
                gains_from: match (&drives.choice, args.gains.is_some()) {
                    (Some(choice), _) => choice.gains_from,
                    (None, true) => GainsFrom::Given,
                    (None, false) => GainsFrom::Controller,
                },
                gains_crc32: gains.as_ref().map(|text| firmware::crc::Crc32::of(text.as_bytes())),
                period_why: drives.choice.as_ref().map_or("the controller's", |choice| choice.why),
                timing: drives.timing.as_ref(),
                ..done.seen.circumstances(wrong)
            },
            Self::Led(_) => {
                Circumstances { seed: Some(args.seed.unwrap_or(1)), ..done.seen.circumstances(wrong) }
            }
        };
        let mut value = summary(order, &done.record, &about);
        value["command_line"] = command_line().into();
        if let Some(before) = tracked {
            value["target"] = before.json();
            let moved_m = args.tracker.moved(before);
            value["target"]["moved_during_throw_m"] = serde_json::json!(moved_m.as_ref().ok());
            match moved_m {
                Ok(by_m) if by_m > 1e-3 => {
                    console::note!("the target moved by {:.1} mm during the throw", 1e3 * by_m);
                }
                Ok(_) => {}
                Err(error) => console::note!("the target could not be looked at after the throw: {error}"),
            }
        }
        let mut results = vec![
            done.lost.clone().map_or(Ok(()), Err),
            gains.map_or(Ok(()), |gains| folder.write("gains.toml", &gains)),
            folder.write("summary.json", &format!("{value:#}\n")),
        ];
        match self {
            Self::Drives(_) => results.push(report::write_into(folder, &args.robot)),
            Self::Led(led) => {
                results.push(folder.write("motion.csv", &led.motion_csv(done)));
                results.push(report::write_robot(&folder.path, &folder.file("report.html")));
            }
        }
        let written: Result<(), ExpectedError> = results.into_iter().collect();
        if let (Err(lost), None) = (&written, wrong) {
            (value["exit_code"], value["cause"]) = (lost.code.into(), lost.all_that_happened().into());
            value["next"] = lost.all_steps().into();
        }
        if args.json {
            print_json(&value);
        }
        written
    }
}

impl Args {
    /// What is asked here, besides `asked`.
    fn deeds(&self, asked: &[Deed]) -> Vec<Deed> {
        let mut deeds = asked.to_vec();
        deeds.extend(self.plan.is_some().then_some(Deed::PlanOfFile));
        deeds.extend((!matches!(self.target, Some(TargetArg::Tracker))).then_some(Deed::TargetGiven));
        deeds.extend((self.bus != BusSpec::Sim).then_some(Deed::Live));
        deeds
    }
}

pub(super) fn read_gains(path: &Path, robot: &str) -> Result<GainsFile, ExpectedError> {
    let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
    GainsFile::from_toml(&text, robot)
        .map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", path.display())))
}

/// `3`, `5`, … as µs.
pub(super) fn period_us(text: &str) -> Result<u32, String> {
    let ms = super::values::positive(text)?;
    let us = (1e3 * ms).round();
    if (f64::from(PERIOD_MIN_US)..=f64::from(PERIOD_MAX_US)).contains(&us) {
        Ok(us as u32)
    } else {
        Err(format!("must be from {} to {} ms", PERIOD_MIN_US / 1_000, PERIOD_MAX_US / 1_000))
    }
}

impl From<NoPeriod> for ExpectedError {
    fn from(error: NoPeriod) -> Self {
        match error {
            NoPeriod::NoGains(_) => Self::bad_input(&error),
            NoPeriod::TooShort { .. } | NoPeriod::None { .. } => Self::of(exit::BUS, &error),
        }
    }
}

/// The gains in force: the file that was given, or what the controller's registers held, in the form that
/// `cubectl tune --rollback` and `cubectl log replay` read; `None` if they were not read.
fn gains_toml(record: &Record, gains: Option<&GainsFile>) -> Option<String> {
    if let Some(gains) = gains {
        return Some(gains.to_toml());
    }
    record.held.as_ref().map(|held| InForce::of(held).to_toml())
}
