//! `cubectl rally`

use std::path::{Path, PathBuf};

use hil_sim::court::CourtOptions;
use operator::rally::exchange::{Partners, Rally, RallyEnd};
use operator::rally::study::{self, Row, StudyOptions};
use operator::rally::thrower::{Scatter, ThrowFault};
use operator::rally::trial::{CatchOutcome, Outcome, TrialOptions, Trouble, WAIT_HOLD_DEG, WAIT_MATCHED_DEG};
use planner::catch::Joints;
use planner::catch::online::Decision;
use planner::catch::task::{Allowed, Mode, Settings};
use serde_json::{Value, json};

use super::print_json;
use super::rally_on_wire::{self, Wire};
use crate::error::ExpectedError;
use crate::exit;
use crate::report::rally as report;

/// Arguments.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl rally --throws 20 --report rally.html\n  cubectl rally --throws 4 --trouble frames-lost:0.1 --trouble bias:2\n  cubectl rally --study 500 --json > study.json          # the tables of shares; some minutes\n  cubectl rally --bus-thrower socketcand://127.0.0.1:29536/can0 --bus-catcher socketcand://127.0.0.1:29537/can0 \\\n      --tracker 127.0.0.1:5000                           # one throw in real time, with `hil-sim serve-court` or with arms\n\nTwo arms of the court throw a ball to each other and catch it with open cups, in virtual time. The partners cooperate: the\ncatcher knows the plan of the throw, and the thrower takes the throw that is most surely caught. Whether a ball is caught\nis decided by the simulated contact of ball and cup; what the catcher tells comes from what its tracker saw."
)]
pub struct Args {
    /// Throws at most; the rally ends with the first ball that is not caught.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub throws: u32,
    /// Without the thrower's plan: the catcher has its tracker only.
    #[arg(long)]
    pub eyes_only: bool,
    /// How the ball is caught.
    #[command(flatten)]
    pub catching: Catching,
    /// Keep the jerk limits as well.
    #[arg(long)]
    pub jerk: bool,
    /// Instead of a rally: shares of caught balls over this many throws each, by setting, flight time and fault.
    #[arg(long, value_name = "THROWS", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub study: Option<u32>,
    /// Of the study only settings whose name has this in it.
    #[arg(long, value_name = "TEXT", requires = "study")]
    pub only: Option<String>,
    /// One throw over the wire.
    #[command(flatten)]
    pub wire: Wire,
    /// Write a report of the last exchange: both arms, predicted and actual miss, probability over time, decisions.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// How a ball is caught: the same for `catch --ball` and `rally`.
#[derive(Debug, clap::Args)]
pub struct Catching {
    /// A court file: places of the arms, ball, cup, tracker; the built-in one otherwise.
    #[arg(long, value_name = "FILE")]
    pub court: Option<PathBuf>,
    /// Which catches are allowed.
    #[arg(long, default_value = "either", value_name = "KIND")]
    pub hand: Hand,
    /// The catcher knows beforehand where the ball starts and how fast (always in a rally, unless `--eyes-only`).
    #[arg(long)]
    pub cooperative: bool,
    /// Something that goes wrong; may be given several times.
    #[arg(long, value_name = "KIND[:VALUE]", value_parser = trouble,
        help = "Something that goes wrong; may be given several times: tracker-dead:S, frames-lost:SHARE, bias:MM, false-markers:N, drive-lost:S, thrower-stops:S, not-released (times in s after the release, thrower-stops before it)")]
    pub trouble: Vec<Trouble>,
    /// Seed of all chance.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Kinds of catches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Hand {
    /// The hand moves with the ball: at most 2 m/s between them.
    Matched,
    /// The hand stands still.
    Hold,
    /// Both; matched is preferred.
    Either,
}

fn trouble(text: &str) -> Result<Trouble, String> {
    let (kind, value) = text.split_once(':').map_or((text, None), |(kind, value)| (kind, Some(value)));
    let number = |low: f64, high: f64| {
        let value: f64 =
            value.unwrap_or("").parse().map_err(|_| format!("{kind} needs a number: {kind}:VALUE"))?;
        if (low..=high).contains(&value) { Ok(value) } else { Err(format!("{kind}: from {low} to {high}")) }
    };
    match kind {
        "tracker-dead" => Ok(Trouble::TrackerDead { at_s: number(-5.0, 5.0)? }),
        "frames-lost" => Ok(Trouble::FramesLost { probability: number(0.0, 1.0)? }),
        "bias" => Ok(Trouble::Bias { by_mm: number(-1000.0, 1000.0)? }),
        "false-markers" => Ok(Trouble::FalseMarkers { count: number(0.0, 20.0)? as u32 }),
        "drive-lost" => Ok(Trouble::DriveLost { at_s: number(-5.0, 5.0)? }),
        "thrower-stops" => Ok(Trouble::Throw(ThrowFault::Stops { before_s: number(0.01, 1.0)? })),
        "not-released" => Ok(Trouble::Throw(ThrowFault::NotReleased)),
        _ => Err(format!(
            "'{kind}' is none of tracker-dead, frames-lost, bias, false-markers, drive-lost, thrower-stops, not-released"
        )),
    }
}

impl Catching {
    /// Options of a trial.
    pub(super) fn trial(&self) -> Result<TrialOptions, ExpectedError> {
        let (allowed, wait) = match self.hand {
            Hand::Matched => (Allowed::Matched, WAIT_MATCHED_DEG),
            Hand::Hold => (Allowed::Hold, WAIT_HOLD_DEG),
            Hand::Either => (Allowed::Either, WAIT_HOLD_DEG),
        };
        Ok(TrialOptions {
            settings: Settings { allowed, ..Settings::default() },
            cooperative: self.cooperative,
            scatter: Scatter::default(),
            wait: Joints::from(wait.map(f64::to_radians)),
            trouble: self.trouble.clone(),
            ..TrialOptions::default()
        })
    }
}

/// The court of a file, or the built-in one.
pub(super) fn court(file: Option<&Path>) -> Result<CourtOptions, ExpectedError> {
    let court = match file {
        Some(file) => CourtOptions::load(file),
        None => CourtOptions::two_arms(),
    };
    court.map_err(|why| ExpectedError::bad_input(&why))
}

/// Runs the verb.
///
/// # Errors
/// The court is refused, the rally ends before its throws are made, or the report cannot be written.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let court = court(args.catching.court.as_deref())?;
    if let Some(throws) = args.study {
        return study_of(args, &court, throws);
    }
    let mut options = args.catching.trial()?;
    options.jerk = args.jerk;
    options.cooperative = !args.eyes_only;
    if args.wire.is_meant() {
        return on_wire(args, court, &options);
    }
    let refused = |why: &dyn std::fmt::Display| {
        ExpectedError::bad_input(&format!(
            "an arm of the court cannot catch balls: {why}\n  next: `robot = \"powercube6\"`"
        ))
    };
    let partners = Partners::new(court).map_err(|why| refused(&why))?;
    let rally = partners.play(args.throws as usize, &options, args.catching.seed);
    if let (Some(file), Some(last)) = (&args.report, rally.exchanges.last()) {
        let page = report::rally(&rally, partners.pair(last.thrower), last, options.jerk);
        std::fs::write(file, page).map_err(|e| ExpectedError::output(file, &e))?;
    }
    if args.json {
        print_json(&rally_json(&rally));
    } else {
        console::text!("{}", rally_text(&rally));
        if let (Some(file), true) = (&args.report, !rally.exchanges.is_empty()) {
            console::line!("report: {}", file.display());
        }
    }
    match (rally.end, rally.exchanges.last()) {
        (RallyEnd::Complete, _) => Ok(()),
        (RallyEnd::NotCaught, Some(last)) => ended(&last.outcome),
        (RallyEnd::NoThrow, _) => Err(ExpectedError::new(
            exit::NO_THROW,
            "no throw was found that the other arm catches\n  next: set the arms of the court 2 to 3 m apart, or another --seed",
        )),
        (RallyEnd::NoTransit | RallyEnd::NotCaught, _) => Err(ExpectedError::new(
            exit::NO_THROW,
            "an arm found no way to its next pose without contact\n  next: another --seed",
        )),
    }
}

/// One throw over two buses in real time.
fn on_wire(args: &Args, court: CourtOptions, options: &TrialOptions) -> Result<(), ExpectedError> {
    let outcome = args.wire.run(court, options, args.catching.seed)?;
    if args.json {
        print_json(&rally_on_wire::as_json(&outcome, &told_word(outcome.told)));
    } else {
        console::text!("{}", rally_on_wire::as_text(&outcome, &told_word(outcome.told)));
    }
    if let Some(why) = rally_on_wire::not_thrown(outcome.thrown) {
        return Err(why);
    }
    match outcome.told {
        CatchOutcome::Caught => Ok(()),
        told => Err(declined_or(told)),
    }
}

/// How a trial in the simulated court ends: its ball decides, not what the catcher reports of it.
///
/// # Errors
/// The ball is not in the cup, or the arm was stopped by a fault.
pub(super) fn ended(outcome: &Outcome) -> Result<(), ExpectedError> {
    match outcome.told {
        told @ CatchOutcome::Halted => Err(declined_or(told)),
        _ if outcome.caught => Ok(()),
        told => Err(declined_or(told)),
    }
}

/// Why a ball was not caught, with the exit code.
fn declined_or(told: CatchOutcome) -> ExpectedError {
    let (code, what) = match told {
        CatchOutcome::Caught => (exit::MISSED, "the ball was not caught, although the catcher reports a catch\n  next: `--report` shows where it passed".to_owned()),
        CatchOutcome::Declined(why) => (exit::NO_THROW, format!("declined: {why}\n  next: throw slower, higher or nearer to the arm")),
        CatchOutcome::Missed => (exit::MISSED, "the ball was not caught\n  next: `--report` shows where it passed".to_owned()),
        CatchOutcome::Unknown => (
            exit::MISSED,
            "whether the ball was caught is not known: the tracker saw nothing after the catch, or the ball still moved in the cup\n  next: look at the tracker and at the cup".to_owned(),
        ),
        CatchOutcome::NothingThrown => (
            exit::NOT_RELEASED,
            "no ball was seen in flight; the arm stayed where it was\n  next: look at the thrower and the tracker".to_owned(),
        ),
        CatchOutcome::Halted => (exit::STOPPED, "the catcher's arm stopped because of a fault\n  next: `cubectl doctor`".to_owned()),
    };
    ExpectedError::new(code, what)
}

fn told_word(told: CatchOutcome) -> String {
    match told {
        CatchOutcome::Caught => "caught".to_owned(),
        CatchOutcome::Missed => "missed".to_owned(),
        CatchOutcome::Unknown => "not known".to_owned(),
        CatchOutcome::Declined(why) => format!("declined: {why}"),
        CatchOutcome::NothingThrown => "nothing thrown".to_owned(),
        CatchOutcome::Halted => "stopped by a fault".to_owned(),
    }
}

fn mode_word(mode: Mode) -> &'static str {
    match mode {
        Mode::Matched => "matched",
        Mode::Hold => "hold",
    }
}

/// One outcome as text.
pub(super) fn as_text(outcome: &Outcome) -> String {
    let mut out = format!(
        "told: {}; the simulated ball is {}the cup\n",
        told_word(outcome.told),
        if outcome.caught { "in " } else { "not in " }
    );
    if let Some(choice) = &outcome.choice {
        out += &format!(
            "  {} catch {:.3} s after the release, predicted probability {:.2}, motion uses {:.0} % of the acceleration\n",
            mode_word(choice.mode),
            choice.t_s - outcome.planned_s.0,
            choice.probability,
            choice.used * 100.0
        );
    }
    if let Some(crossing) = outcome.crossing {
        out += &format!(
            "  at the mouth of the cup: {:.1} mm off its axis, {:.0} deg, {:.2} m/s\n",
            crossing.miss_m * 1e3,
            crossing.angle_rad.to_degrees(),
            crossing.speed_m_s
        );
    }
    let corrected = outcome.log.iter().filter(|l| l.decision == Decision::Corrected).count();
    let judged: usize = outcome.log.iter().map(|l| l.count.judged).sum();
    out += &format!(
        "  {} forecasts, {corrected} corrections, {judged} candidates judged; catcher: largest speed {:.0} %, acceleration {:.0} % of its limit\n",
        outcome.log.len(),
        outcome.executed[1].speed * 100.0,
        outcome.executed[1].acceleration * 100.0
    );
    out
}

/// One outcome as JSON.
pub(super) fn as_json(outcome: &Outcome) -> Value {
    json!({
        "caught": outcome.caught,
        "told": told_word(outcome.told),
        "crossing": outcome.crossing.map(|c| json!({"miss_m": c.miss_m, "angle_rad": c.angle_rad, "speed_m_s": c.speed_m_s})),
        "choice": outcome.choice.as_ref().map(|c| json!({
            "mode": mode_word(c.mode), "after_release_s": c.t_s - outcome.planned_s.0, "p_m": c.p_m.as_slice(),
            "axis": c.axis.as_slice(), "q_rad": c.q[..], "qd_rad_s": c.qd[..],
            "probability": c.probability, "used": c.used, "relative_m_s": c.relative_m_s,
        })),
        "decisions": outcome.log.iter().map(|l| json!({
            "after_release_s": l.at_s - outcome.planned_s.0, "decision": report::decision_word(&l.decision),
            "probability": l.probability, "sigma_m": l.sigma_m, "off_m": l.off_m, "judged": l.count.judged,
        })).collect::<Vec<_>>(),
        "limits": {
            "thrower": outcome.executed[0], "catcher": outcome.executed[1], "arms_touched": outcome.arms_touched,
            "planned": {"speed": outcome.used[0], "acceleration": outcome.used[1], "jerk": outcome.used[2]},
        },
        "refusals": outcome.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

fn rally_text(rally: &Rally) -> String {
    let mut out = format!("{} catches in a row\n", rally.length());
    for (k, exchange) in rally.exchanges.iter().enumerate() {
        let outcome = &exchange.outcome;
        let crossing = outcome.crossing.map_or_else(String::new, |c| {
            format!(", {:.1} mm off, {:.2} m/s against the hand", c.miss_m * 1e3, c.speed_m_s)
        });
        out += &format!(
            "  {:2}: arm {} throws, flight {:.2} s: {}{crossing}\n",
            k + 1,
            exchange.thrower + 1,
            exchange.aimed.flight_s,
            told_word(outcome.told)
        );
    }
    out
}

fn rally_json(rally: &Rally) -> Value {
    json!({
        "length": rally.length(),
        "complete": rally.end == RallyEnd::Complete,
        "exchanges": rally.exchanges.iter().map(|e| json!({
            "thrower": e.thrower + 1, "flight_s": e.aimed.flight_s, "transit_s": e.transit_s, "outcome": as_json(&e.outcome),
        })).collect::<Vec<_>>(),
    })
}

fn study_of(args: &Args, court: &CourtOptions, throws: u32) -> Result<(), ExpectedError> {
    let options = StudyOptions { throws: throws as usize, seed: args.catching.seed, only: args.only.clone() };
    let mut rows = Vec::new();
    let study = study::run(court, &options, |row| {
        if args.json {
            console::note!("{}: {} of {} caught", row.name, row.caught.hits, row.caught.of);
        } else {
            console::text!("{}", row_text(row));
        }
        rows.push(row.clone());
    });
    let study = study.map_err(|why| {
        if args.json && !rows.is_empty() {
            print_json(&json!({"rows": rows}));
        }
        let next = "look at the arms of the court file: the study sets them 2, 2.5 and 3 m apart and leaves the rest; \
                    `--only \"D 2 m\"` makes the rows of that distance alone";
        ExpectedError::new(exit::NO_THROW, format!("{why}\n  next: {next}"))
    })?;
    if args.json {
        print_json(&json!({"rows": rows, "estimator": study.estimator, "rallies": study.rallies}));
    } else {
        console::text!("{}", study.as_text());
    }
    let wrong: usize = rows.iter().map(|row| row.silent.len() + row.limit_passed.len()).sum();
    if wrong > 0 {
        return Err(ExpectedError::new(
            exit::FINDINGS,
            format!(
                "{wrong} trials passed a limit or told what did not happen\n  next: the rows above show in which setting"
            ),
        ));
    }
    Ok(())
}

fn row_text(row: &Row) -> String {
    let (low, high) = row.caught.wilson();
    let bins: Vec<String> =
        row.by_flight.iter().map(|share| format!("{:.0}/{}", share.value() * 100.0, share.of)).collect();
    let possible: Vec<String> = row
        .possible_by_flight
        .iter()
        .map(|share| format!("{:.1}/{}", share.value() * 100.0, share.of))
        .collect();
    let (possible_low, possible_high) = row.of_possible.wilson();
    let (possible_low, possible_high) = (possible_low * 100.0, possible_high * 100.0);
    let first: Vec<String> = row
        .first_decision
        .0
        .iter()
        .filter(|bin| bin.of > 0)
        .map(|bin| format!("{:.2}: {}/{}", bin.predicted, bin.caught, bin.of))
        .collect();
    format!(
        "{}\n  caught {:.1} % [{:.1}, {:.1}] of {}; of those with a place {:.1} % [{possible_low:.1}, {possible_high:.1}] of {} (without one {}); by the rule {:.1} %; by flight time {}; with a place {}\n  miss {:.1} mm (50 %), {:.1} mm (95 %); declined {}; not caught and told {}; told wrongly {:?}; limit passed {:?}; touched although declined {:?} (and column or turntable {}); refused {}\n  largest speed and acceleration: thrower {:.0} / {:.0} %, catcher {:.0} / {:.0} %\n  decision {:.0} / {:.0} us (50 / 99 %), {:.0} candidates; waits at {:.0?} deg\n  first decision, predicted: caught of all {}; Brier score {:.3}\n",
        row.name,
        row.caught.value() * 100.0,
        low * 100.0,
        high * 100.0,
        row.caught.of,
        row.of_possible.value() * 100.0,
        row.of_possible.of,
        row.caught_without_place,
        row.by_rule.value() * 100.0,
        bins.join(" "),
        possible.join(" "),
        row.miss_mm.0,
        row.miss_mm.1,
        row.declined,
        row.safe,
        row.silent,
        row.limit_passed,
        row.not_clear,
        row.declined_at_base,
        row.refusals,
        row.executed[0].speed * 100.0,
        row.executed[0].acceleration * 100.0,
        row.executed[1].speed * 100.0,
        row.executed[1].acceleration * 100.0,
        row.decision_us.0,
        row.decision_us.1,
        row.judged,
        row.wait_deg,
        first.join(", "),
        row.first_decision.1
    )
}
