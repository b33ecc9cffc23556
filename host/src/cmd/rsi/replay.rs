//! `cubectl log replay` on a recorded exchange over RSI.

use std::path::Path;

use hil_sim::krc::KrcScenario;
use operator::rsi::log::{FILE_MAX_BYTES, parse};
use operator::rsi::program::replay_station;
use operator::rsi::replay::{Difference, Replayed, replay as run_again};
use operator::rsi::station::Station;
use planner::record::PlanRecord;
use toml_reader::read_text;

use super::{DESCRIPTION, LOG};
use crate::cmd::print_json;
use crate::error::ExpectedError;
use crate::exit;

/// Whether a path is the folder of a recording over RSI.
#[must_use]
pub fn is_recording(path: &Path) -> bool {
    path.join(LOG).is_file()
}

/// Runs a station on the recorded telegrams of a folder again.
fn run(folder: &Path) -> Result<(Replayed, Station), ExpectedError> {
    let log = folder.join(LOG);
    let text = read_text(&log, FILE_MAX_BYTES).map_err(|error| ExpectedError::io(&log, &error))?;
    let lines =
        parse(&text).map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", log.display())))?;
    let described =
        KrcScenario::load(&folder.join(DESCRIPTION)).map_err(|error| ExpectedError::bad_input(&error))?;
    let arm = crate::cmd::six_axes(&described.robot)?;
    let plan_file = folder.join("plan.json");
    let record = plan_file.is_file().then(|| PlanRecord::read(&plan_file)).transpose();
    // Settings follow from the plan of a throw; the log has the motions.
    let plan = match record.map_err(|error| ExpectedError::bad_input(&error))? {
        Some(PlanRecord::Follow(plan)) => Some(plan),
        _ => None,
    };
    let mut station = replay_station(&described, &arm, plan.as_deref())
        .map_err(|error| ExpectedError::bad_input(&error))?;
    let replayed = run_again(&lines, &mut station);
    Ok((replayed, station))
}

/// Freeze frame and trace of the controller of a recorded exchange: it ran inside the program and is gone, and the same telegrams
/// bring a new one to the same state.
///
/// # Errors
/// A file cannot be read, or the recorded answers are of another controller.
pub fn history(folder: &Path) -> Result<[Vec<u8>; 2], ExpectedError> {
    let (replayed, station) = run(folder)?;
    if let Some(Difference { at, .. }) = replayed.difference {
        return Err(ExpectedError::new(
            exit::FINDINGS,
            format!(
                "{}: the controller of this version answers otherwise from {:.6} s on, so it cannot show \
                     what happened",
                folder.join(LOG).display(),
                at.as_secs_f64()
            ),
        )
        .next(format!(
            "`cubectl log replay {}` shows the difference; use the version that made the recording",
            folder.display()
        )));
    }
    Ok(station.history())
}

/// Hands the recorded telegrams to a new station and compares its answers with the recorded ones, byte for byte.
///
/// # Errors
/// A file cannot be read, or an answer differs.
pub fn replay(folder: &Path, json: bool) -> Result<(), ExpectedError> {
    let log = folder.join(LOG);
    let (replayed, _) = run(folder)?;
    let show = |bytes: &Option<Vec<u8>>| {
        bytes.as_ref().map_or("nothing".to_owned(), |bytes| String::from_utf8_lossy(bytes).into_owned())
    };
    if json {
        print_json(&serde_json::json!({
            "identical": replayed.difference.is_none(),
            "telegrams": replayed.telegrams,
            "same_answers": replayed.same,
            "difference": replayed.difference.as_ref().map(|Difference { at, recorded, given }| serde_json::json!({
                "at_s": at.as_secs_f64(), "recorded": show(recorded), "given": show(given),
            })),
        }));
    }
    match &replayed.difference {
        None => {
            if !json {
                console::line!(
                    "identical: {} answers of the controller to {} telegrams",
                    replayed.same,
                    replayed.telegrams
                );
            }
            Ok(())
        }
        Some(Difference { at, recorded, given }) => Err(ExpectedError::new(
            exit::FINDINGS,
            format!(
                "{}, {:.6} s: recorded {}, but the controller answers {} ({} answers before were the same)",
                log.display(),
                at.as_secs_f64(),
                show(recorded),
                show(given),
                replayed.same
            ),
        )
        .next("same version and files as in the recording? then the controller has changed")),
    }
}
