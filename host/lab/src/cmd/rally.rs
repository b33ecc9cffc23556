//! `cubelab rally`

use std::path::{Path, PathBuf};

use hil_sim::two_arms::TwoArmOptions;
use host::cmd::catch::catching::Catching;
use host::cmd::catch::outcome::{as_json, ended, reported_text};
use host::cmd::catch::record;
use host::cmd::print_json;
use host::cmd::progress::while_working;
use host::error::ExpectedError;
use host::exit;
use operator::ball_catch::limits::Executed;
use operator::ball_catch::trial::TrialOptions;
use serde_json::{Value, json};

use super::on_wire::{self, Wire};
use crate::rally::calibration::CalibrationBin;
use crate::rally::exchange::{Exchange, Partners, Rally, RallyEnd};
use crate::rally::study::{self, Row, Share, StudyOptions};
use crate::report;

/// Options that change nothing in a study.
const NOT_OF_A_STUDY: [&str; 8] =
    ["throws", "eyes_only", "hand", "jerk", "restitution", "faults", "record", "report"];

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubelab rally --throws 20 --report rally.html\n  cubelab rally --throws 4 --fault frames-lost:0.1 --fault bias:2\n  cubelab rally --study 500 --json > study.json          # the tables of shares; some minutes\n  cubelab rally --bus-thrower socketcand://127.0.0.1:29536/can0 --bus-catcher socketcand://127.0.0.1:29537/can0 \\\n      --tracker 127.0.0.1:5000                           # in real time, with `hil-sim serve-two-arms` or with arms\n\nTwo arms of the cell throw a ball to each other and catch it with open cups, in virtual time. The partners cooperate: the\ncatcher knows the plan of the throw, and the thrower takes the throw that is most surely caught. Whether a ball is caught\nis decided by the simulated contact of ball and cup; what the catcher reports comes from what its tracker saw."
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
    /// Instead of a rally: shares of caught balls over this many throws each, by setting, flight time and fault.
    #[arg(long, value_name = "THROWS", conflicts_with_all = NOT_OF_A_STUDY, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub study: Option<u32>,
    /// Of the study only settings whose name has this in it.
    #[arg(long, value_name = "TEXT", requires = "study", conflicts_with_all = NOT_OF_A_STUDY)]
    pub only: Option<String>,
    /// Over the wire.
    #[command(flatten)]
    pub wire: Wire,
    /// Write a report of the last exchange: both arms, predicted and actual miss, probability over time, decisions.
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let cell = args.catching.cell()?;
    if let Some(throws) = args.study {
        return study_of(args, &cell, throws);
    }
    let mut options = args.catching.trial();
    options.cooperative = !args.eyes_only;
    if args.wire.is_meant() {
        return on_wire(args, cell, &options);
    }
    let refused = |why: &dyn std::fmt::Display| {
        ExpectedError::bad_input(&format!("an arm of the cell cannot catch balls: {why}"))
            .next("`robot = \"powercube6\"`")
    };
    let partners = Partners::new(cell).map_err(|why| refused(&why))?;
    let rally = while_working("rally", "2 s a throw", |bar| {
        partners.play(args.throws as usize, &options, args.catching.seed, |k, exchange| {
            if !args.json {
                bar.suspend(|| console::line!("{}", exchange_text(k, exchange)));
            }
        })
    });
    if let (Some(file), Some(last)) = (&args.report, rally.exchanges.last()) {
        let page = report::rally(&rally, partners.pair(last.thrower), last, options.jerk);
        std::fs::write(file, page).map_err(|e| ExpectedError::output(file, &e))?;
    }
    if let Some(folder) = &args.wire.record {
        record_all(folder, &partners, &rally)?;
    }
    if args.json {
        print_json(&rally_json(&rally));
    } else {
        console::line!("{} catches in a row", rally.length());
        if let (Some(file), true) = (&args.report, !rally.exchanges.is_empty()) {
            console::line!("report: {}", file.display());
        }
    }
    match (rally.end.not_thrown(), rally.exchanges.last()) {
        (Some([why, next]), _) => Err(ExpectedError::new(exit::NO_THROW, why).next(next)),
        (None, Some(last)) if rally.end == RallyEnd::NotCaught => ended(&last.outcome),
        (None, _) => Ok(()),
    }
}

/// Two files for each throw: what the thrower and what the catcher did, both with the ball.
fn record_all(folder: &Path, partners: &Partners, rally: &Rally) -> Result<(), ExpectedError> {
    std::fs::create_dir_all(folder).map_err(|e| ExpectedError::output(folder, &e))?;
    for (k, exchange) in (1..).zip(&rally.exchanges) {
        let pair = partners.pair(exchange.thrower);
        for (arm, name) in ["thrower", "catcher"].into_iter().enumerate() {
            record::simulated(&folder.join(format!("throw-{k}-{name}.mcap")), pair, arm, &exchange.outcome)?;
        }
    }
    Ok(())
}

/// A rally over two buses.
fn on_wire(args: &Args, cell: TwoArmOptions, options: &TrialOptions) -> Result<(), ExpectedError> {
    let (throws, seed, report) = (args.throws as usize, args.catching.seed, args.report.as_deref());
    let rally = args.wire.run(cell, throws, options, seed, report, |k, exchange| {
        if !args.json {
            console::text!("{}", on_wire::exchange_text(k, exchange));
        }
    })?;
    if rally.end.is_err() && rally.exchanges.is_empty() {
        // Nothing was thrown: with --json the failure is the one object.
        return on_wire::ended(rally);
    }
    if args.json {
        print_json(&on_wire::as_json(&rally));
    } else {
        console::line!("{} catches in a row", rally.length());
        if let (Some(file), false) = (report, rally.exchanges.is_empty()) {
            console::line!("report: {}", file.display());
        }
    }
    on_wire::ended(rally)
}

fn exchange_text(k: usize, exchange: &Exchange) -> String {
    let outcome = &exchange.outcome;
    let crossing = outcome.crossing.map_or_else(String::new, |c| {
        format!(", {:.1} mm off, {:.2} m/s against the hand", c.miss_m * 1e3, c.speed_m_s)
    });
    let [x, y, _] = exchange.gripped_e_m[0].into();
    format!(
        "{:2}: arm {} throws from {:.0} mm beside the axis of its cup, flight {:.2} s: {}{crossing}",
        k + 1,
        exchange.thrower + 1,
        f64::hypot(x, y) * 1e3,
        exchange.aimed.flight_s,
        reported_text(outcome.reported)
    )
}

fn rally_json(rally: &Rally) -> Value {
    json!({
        "length": rally.length(),
        "complete": rally.end == RallyEnd::Complete,
        "exchanges": rally.exchanges.iter().map(|e| json!({
            "thrower": e.thrower + 1, "flight_s": e.aimed.flight_s, "transit_s": e.transit_s,
            "gripped_e_m": e.gripped_e_m[0].as_slice(), "planned_gripped_e_m": e.gripped_e_m[1].as_slice(), "outcome": as_json(&e.outcome),
        })).collect::<Vec<_>>(),
    })
}

fn study_of(args: &Args, cell: &TwoArmOptions, throws: u32) -> Result<(), ExpectedError> {
    let options = StudyOptions { throws: throws as usize, seed: args.catching.seed, only: args.only.clone() };
    let mut rows = Vec::new();
    let study = while_working("study", "some minutes with 500 throws", |bar| {
        study::run(cell, &options, |row| {
            bar.suspend(|| {
                if args.json {
                    console::note!("{}: {} of {} caught", row.name, row.caught.hits, row.caught.of);
                } else {
                    console::text!("{}", row_text(row));
                }
            });
            rows.push(row.clone());
        })
    });
    let study = study.map_err(|why| {
        if args.json && !rows.is_empty() {
            print_json(&json!({"rows": rows}));
        }
        let next = "look at the arms of the cell file: the study sets them 2, 2.5 and 3 m apart and leaves the rest; \
                    `--only \"D 2 m\"` makes the rows of that distance alone";
        ExpectedError::new(exit::NO_THROW, why.to_string()).next(next)
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
            format!("{wrong} trials passed a limit or reported what did not happen"),
        )
        .next("the rows above show in which setting"));
    }
    Ok(())
}

fn row_text(row: &Row) -> String {
    let Row { name, caught_without_place, declined, safe, silent, limit_passed, not_clear, .. } = row;
    let Row { declined_at_base, refusals, judged, wait_deg, .. } = row;
    let in_time = row.in_time.map_or_else(String::new, |reached| {
        format!(
            "; {reached} of {} could be reached if the flight were known 50 ms after the release",
            row.caught.of
        )
    });
    let share = |share: &Share| {
        let (low, high) = share.wilson();
        format!("{:.1} % [{:.1}, {:.1}] of {}", share.value() * 100.0, low * 100.0, high * 100.0, share.of)
    };
    let by_flight = |shares: &[Share], digits: usize| {
        let shares = shares.iter().map(|share| format!("{:.digits$}/{}", share.value() * 100.0, share.of));
        shares.collect::<Vec<_>>().join(" ")
    };
    let executed = |arm: &Executed| format!("{:.0} / {:.0} %", arm.speed * 100.0, arm.acceleration * 100.0);
    let bins = |bins: &[CalibrationBin]| {
        let bins = bins.iter().filter(|bin| bin.of > 0);
        let bins = bins.map(|bin| format!("{:.2}: {}/{}", bin.predicted, bin.caught, bin.of));
        bins.collect::<Vec<_>>().join(", ")
    };
    format!(
        "{name}\n  caught {}, of those begun {} (predicted {:.1} %); of those with a place {} (without one {caught_without_place}){in_time}; by the rule {:.1} %; by flight time {}; with a place {}\n  miss {:.1} mm (50 %), {:.1} mm (95 %); declined {declined}; not caught and reported {safe}; reported wrongly {silent:?}; limit passed {limit_passed:?}; touched although declined {not_clear:?} (and column or turntable {declined_at_base}); refused {refusals}\n  largest speed and acceleration: thrower {}, catcher {}\n  decision {:.0} / {:.0} us (50 / 99 %), {judged:.0} candidates; waits at {wait_deg:.0?} deg\n  first decision, predicted: caught of all {}; Brier score {:.3}\n  last decision, of those begun {}; Brier score {:.3}\n",
        share(&row.caught),
        share(&row.begun),
        row.predicted * 100.0,
        share(&row.of_possible),
        row.by_rule.value() * 100.0,
        by_flight(&row.by_flight, 0),
        by_flight(&row.possible_by_flight, 1),
        row.miss_mm.0,
        row.miss_mm.1,
        executed(&row.executed[0]),
        executed(&row.executed[1]),
        row.decision_us.0,
        row.decision_us.1,
        bins(&row.first_decision.0),
        row.first_decision.1,
        bins(&row.last_decision.0),
        row.last_decision.1
    )
}
