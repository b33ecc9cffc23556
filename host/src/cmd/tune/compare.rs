//! `cubectl tune --compare A B`: two sets of gains in the same throws, simulated and recorded.

use std::path::Path;

use firmware::settings::Settings;
use toml_reader::{DESCRIPTION_MAX_BYTES, read_text};

use super::apply::InForce;
use super::trial::{self, Named, Row, Throw};
use super::{Args, Work};
use crate::cmd::log::report;
use crate::cmd::throw::read_gains;
use crate::error::ExpectedError;
use crate::exit;
use operator::bus::settings::{crc32_of, settings_of};
use planner::plan::file::PlanFile;

/// Prints both sets of gains in every throw.
///
/// # Errors
/// Files, or gains with which the controller does not get through a throw: [`exit::FINDINGS`].
pub(super) fn run(args: &Args) -> Result<(), ExpectedError> {
    let work = Work::new(args)?;
    let of_robot = settings_of(&work.robot).map_err(|e| ExpectedError::bad_input(&e))?;
    let mut sets = Vec::new();
    let mut about = String::new();
    for path in &args.compare {
        let (gains, what) = read(path, &work, &of_robot)?;
        let name = path.display().to_string();
        about += &format!("{name}: {what}\n");
        sets.push(Named { name, gains });
    }
    let mut throws = Vec::new();
    let mut seen = Vec::new();
    for folder in &args.log {
        let (throw, row) = recorded(folder, &work, &of_robot, &sets)?;
        throws.push(throw);
        seen.push(row);
    }
    if args.plan.is_some() || throws.is_empty() {
        throws.push(work.trial.clone());
    }
    let mut rows = trial::simulate(&work.robot, &of_robot, &sets, &throws);
    rows.extend(seen);
    if args.json {
        crate::cmd::print_json(&serde_json::json!({ "robot": work.machine.robot, "rows": rows }));
    } else {
        console::text!("{about}{}", trial::text(&rows));
    }
    match rows.iter().find_map(|row| Some((row, row.failed.as_ref()?))) {
        Some((row, why)) => {
            Err(ExpectedError::new(exit::FINDINGS, format!("{} in {}: {why}", row.gains, row.throw))
                .next("use other gains for this throw"))
        }
        None => Ok(()),
    }
}

/// Gains of a file, and what is known of them: a gains file proves its certificate here, the gains that a controller held bring none.
fn read(path: &Path, work: &Work, of_robot: &Settings) -> Result<(InForce, String), ExpectedError> {
    let text = read_text(path, DESCRIPTION_MAX_BYTES).map_err(|error| ExpectedError::io(path, &error))?;
    if let Ok(held) = InForce::from_toml(&text) {
        if held.k_pos_1_s2.len() != work.robot.n() {
            return Err(ExpectedError::bad_input(&format!(
                "{}: gains of {} joints; {} has {}",
                path.display(),
                held.k_pos_1_s2.len(),
                work.machine.robot,
                work.robot.n()
            ))
            .next("name the robot of the gains with --robot"));
        }
        return Ok((held, "held by a controller; the file has no certificate to verify".to_owned()));
    }
    let file = read_gains(path, &work.machine.robot)?;
    let joints = file.joint.len();
    if joints != work.robot.n() {
        return Err(ExpectedError::bad_input(&format!(
            "{}: gains of {joints} of {} joints",
            path.display(),
            work.robot.n()
        ))
        .next("tune all joints"));
    }
    let error_rad =
        file.joint.iter().map(|joint| joint.problem.error_position_rad).fold(f64::INFINITY, f64::min);
    let gains = InForce::of(of_robot).with(&file, crc32_of(&work.robot))?;
    Ok((gains, format!("certificates verified, for initial errors up to {error_rad} rad")))
}

/// The throw of a folder, and what was measured in it.
fn recorded(
    folder: &Path,
    work: &Work,
    of_robot: &Settings,
    sets: &[Named],
) -> Result<(Throw, Row), ExpectedError> {
    let name = folder.display().to_string();
    let [plan, log, summary, gains] =
        ["plan.json", "bus.log", "summary.json", "gains.toml"].map(|name| folder.join(name));
    let file = PlanFile::read(&plan).map_err(|e| ExpectedError::bad_input(&e))?;
    let seen = report::read(&plan, &log, Some(&summary), Some(&work.source), None)?;
    let analysis = seen.analysis.map_err(|why| ExpectedError::bad_input(&why).at(log.display()))?;
    let (its, _) = read(&gains, work, of_robot)?;
    let ran_with = |set: &&Named| {
        let numbers = |gains: &InForce| {
            (gains.period_us, gains.k_pos_1_s2.clone(), gains.k_vel_1_s.clone(), gains.k_last.clone())
        };
        numbers(&set.gains) == numbers(&its)
    };
    let set = sets.iter().find(ran_with).map_or("its own gains", |set| &set.name);
    let landed = seen.summary.as_ref().and_then(|summary| summary.get("landing_error_m")?.as_f64());
    let landing_m = landed.or_else(|| analysis.release.as_ref()?.landing_error_m);
    let row = trial::recorded(set, &name, its.period_us, &analysis, landing_m);
    Ok((Throw { name, motion: trial::of_plan(&file) }, row))
}
