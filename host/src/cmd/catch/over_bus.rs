//! `cubectl catch --bus`: a ball that somebody throws, caught by an arm on a bus with the eyes of a tracker.

use std::path::PathBuf;

use can_link::BusSpec;
use nalgebra::Vector3;
use operator::ball_catch::on_bus::catch_ball;
use operator::ball_catch::reported::CatchOutcome;
use operator::ball_catch::trial::Pair;
use operator::ball_catch::wire::ArmOnBus;
use operator::interrupt::interrupt;
use planner::catch::Joints;

use super::super::consent::Consent;
use super::super::print_json;
use super::super::tracker::base_in_room;
use super::ball::cell_of;
use super::on_bus::{as_json, clocks_text, failed};
use super::outcome::{reported_text, why_not_caught};
use super::{Args, record};
use crate::error::ExpectedError;
use crate::report::ball_catch as report;

/// Where arm and tracker are.
#[derive(Debug, clap::Args, serde::Deserialize)]
#[command(next_help_heading = "Over the wire")]
pub struct OverBus {
    /// Bus of an arm that catches a ball which somebody throws, with a controller in this program; instead of a simulated ball.
    #[arg(long, value_parser = can_link::bus_of_option, value_name = "SPEC", requires = "tracker",
        conflicts_with_all = ["disc", "start", "velocity", "air", "no_limits", "on_controller", "ball", "cooperative", "faults", "seed"])]
    #[serde(skip)]
    pub bus: Option<BusSpec>,
    /// Address of this machine to which the tracker (DTrack) sends its data. With lockstep://: where `hil-sim serve-two-arms`
    /// has them (its --data).
    #[arg(long, value_name = "HOST:PORT", requires = "bus")]
    #[serde(skip)]
    pub tracker: Option<String>,
    /// Where the tracker's room is, seen from the arm: a file of `cubectl tracker calibrate` [default: the arm stands in the
    /// room as the cell says].
    #[arg(long, value_name = "FILE", requires = "bus")]
    #[serde(skip)]
    pub calibration: Option<PathBuf>,
    /// Wait for a ball at most so many seconds.
    #[arg(long = "for-s", value_name = "SECONDS", default_value_t = 60, requires = "bus", value_parser = clap::value_parser!(u32).range(1..=600))]
    #[serde(rename = "-for_s")]
    pub wait_s: u32,
    /// Do not ask before the arm moves.
    #[arg(long, requires = "bus")]
    #[serde(skip)]
    pub yes: bool,
    /// Control period of the controller, ms: 3, 5, 10 or 17.
    #[arg(long, value_name = "MS", default_value_t = 5, requires = "bus", value_parser = clap::value_parser!(u32).range(1..=40))]
    #[serde(rename = "-period")]
    pub period: u32,
    /// Record for viewers: of a simulated catch joints and ball to PATH.mcap (of a disc with --on-controller); with --bus every
    /// frame to PATH.log and PATH.mcap, and what the tracker shows to PATH-ball.mcap.
    #[arg(long, value_name = "PATH", conflicts_with = "no_limits")]
    #[serde(skip)]
    pub record: Option<PathBuf>,
}

pub(super) fn run(args: &Args, bus: &BusSpec, tracker: &str) -> Result<(), ExpectedError> {
    if *bus == BusSpec::Sim {
        return Err(ExpectedError::bad_input(&"nobody throws a ball on the bus sim").next(
            "`--ball` throws one in virtual time; `hil-sim serve-two-arms --ball` throws one for a bus",
        ));
    }
    let over = &args.over_bus;
    let mut cell = cell_of(args)?;
    let robot = cell.arms[1].model.clone();
    if let Some(file) = &over.calibration {
        // The room is the world.
        cell.arms[1].x_wb = base_in_room(file, robot.name())?;
    }
    let pair = Pair::new(cell).map_err(|why| {
        ExpectedError::bad_input(&format!("the robot cannot catch balls: {why}")).next("`--robot powercube6`")
    })?;
    Consent::on(bus, over.yes)?.require(
        "The arm homes, goes to where it waits, and moves when a ball flies. Nobody in its reach?",
        &interrupt(),
    )?;
    let arm =
        ArmOnBus { bus: bus.clone(), robot, period_us: over.period * 1_000, record: over.record.clone() };
    let caught =
        catch_ball(&arm, &pair, &args.catching.trial(), tracker, f64::from(over.wait_s)).map_err(failed)?;
    if let Some(path) = &over.record {
        let mut ball = path.clone().into_os_string();
        ball.push("-ball.mcap");
        record::markers(ball.as_ref(), pair.cell.ball.radius_m, [&caught])?;
    }
    let release_s = caught.first_seen_s.unwrap_or(0.0);
    if let Some(file) = &args.report {
        let end_s = caught.choice.as_ref().map_or(release_s, |choice| choice.t_s);
        let first_m =
            caught.ball.iter().find(|(t_s, _)| *t_s >= release_s).map_or(Vector3::zeros(), |(_, p_m)| *p_m);
        let shown = caught.as_shown((release_s, end_s), first_m, |_| Joints::zeros(6));
        std::fs::write(file, report::one(&pair, &shown, args.catching.jerk))
            .map_err(|error| ExpectedError::output(file, &error))?;
    }
    if args.json {
        print_json(&as_json(&caught, release_s));
    } else {
        console::line!("reported: {}", reported_text(caught.reported));
        console::text!("{}", clocks_text(&caught, release_s, "the ball was seen"));
        if let Some(file) = &args.report {
            console::line!("report: {}", file.display());
        }
    }
    match caught.reported {
        CatchOutcome::Caught => Ok(()),
        other => Err(why_not_caught(other)),
    }
}
