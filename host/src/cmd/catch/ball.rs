//! `cubectl catch --ball`

use hil_sim::two_arms::TwoArmOptions;
use nalgebra::Vector3;
use operator::ball_catch::trial::{Outcome, Pair};
use robot_model::RobotModel;

use super::super::print_json;
use super::outcome::{as_json, as_text, ended};
use super::{Args, record};
use crate::error::ExpectedError;
use crate::report::ball_catch as report;

/// Farthest place (m) and largest speed (m/s) of a ball that is taken.
const BALL_MAX: (f64, f64) = (10.0, 15.0);

pub(super) struct Trial {
    pub(super) pair: Pair,
    pub(super) outcome: Outcome,
}

pub(super) fn run(args: &Args, ball: &[f64; 6]) -> Result<(), ExpectedError> {
    let Trial { pair, outcome } = trial(args, ball)?;
    if let Some(file) = &args.report {
        let page = report::one(&pair, &outcome, args.catching.jerk);
        std::fs::write(file, page).map_err(|e| ExpectedError::output(file, &e))?;
    }
    let recorded = args.over_bus.record.as_deref().map(record::file_of);
    if let Some(file) = &recorded {
        record::simulated(file, &pair, 1, &outcome)?;
    }
    if args.json {
        print_json(&as_json(&outcome));
    } else {
        console::text!("{}", as_text(&outcome));
        if let Some(file) = &recorded {
            console::line!("recorded: {}", file.display());
        }
        if let Some(file) = &args.report {
            console::line!("report: {}", file.display());
        }
    }
    ended(&outcome)
}

/// Makes the trial; nothing is written or printed.
pub(super) fn trial(args: &Args, ball: &[f64; 6]) -> Result<Trial, ExpectedError> {
    let mut options = args.catching.trial();
    options.cooperative = args.cooperative;
    let cell = cell_of(args)?;
    let [x, y, z, vx, vy, vz] = *ball;
    let (p, v) = (Vector3::new(x, y, z), Vector3::new(vx, vy, vz));
    if p.norm() > BALL_MAX.0 || v.norm() > BALL_MAX.1 {
        return Err(ExpectedError::bad_input(&format!(
            "--ball: farther than {} m or faster than {} m/s",
            BALL_MAX.0, BALL_MAX.1
        ))
        .next("place in m, velocity in m/s, in the base frame of the arm"));
    }
    let x_wb = cell.arms[1].x_wb;
    let pair = Pair::new(cell).map_err(|why| {
        ExpectedError::bad_input(&format!("the robot cannot catch balls: {why}")).next("`--robot powercube6`")
    })?;
    let aimed = pair.ball(x_wb.transform_point(&p), x_wb.rot * v);
    let outcome = pair.run(&aimed, &options, args.catching.seed);
    Ok(Trial { pair, outcome })
}

/// The cell with the robot as its catcher; without another arm if no cell was given.
pub(super) fn cell_of(args: &Args) -> Result<TwoArmOptions, ExpectedError> {
    let mut cell = args.catching.cell()?;
    if args.catching.cell.is_none() {
        cell = cell.without_thrower();
    }
    place_robot(&mut cell, args.robot.as_deref().unwrap_or("powercube6"))?;
    Ok(cell)
}

/// The catcher of the cell becomes this robot.
fn place_robot(cell: &mut TwoArmOptions, robot: &str) -> Result<(), ExpectedError> {
    let model = RobotModel::load(robot).map_err(|e| ExpectedError::bad_input(&e))?;
    if model.n() != 6 {
        return Err(ExpectedError::bad_input(&format!(
            "robot \"{robot}\" cannot catch balls: it has {} joints instead of six",
            model.n()
        ))
        .next("`--robot powercube6`, or `--disc` for a disc"));
    }
    if cell.alone {
        cell.arms[0].model = model.clone();
    }
    cell.arms[1].model = model;
    Ok(())
}
