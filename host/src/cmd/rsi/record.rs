//! `cubectl log record` on RSI.

use std::path::Path;

use can_link::RsiSpec;
use hil_sim::krc::KrcScenario;
use operator::rsi::program::{Lag, leading};
use planner::follow::limits::Arm;

use super::{CONFIG, DESCRIPTION, LOG, LogFile, Watch, serve_at};
use crate::error::ExpectedError;

/// Holds the robot where its program starts and writes the exchange into a folder, for `span_s` or until Ctrl-C.
pub fn record(
    folder: &Path,
    span_s: Option<f64>,
    spec: &RsiSpec,
    described: &KrcScenario,
    arm: &Arm,
) -> Result<(), ExpectedError> {
    std::fs::create_dir_all(folder).map_err(|error| ExpectedError::output(folder, &error))?;
    let mut station =
        leading(described, arm, Lag::of(described), &[]).map_err(|error| ExpectedError::bad_input(&error))?;
    let mut on = |_, _: &mut _| true;
    let log = folder.join(LOG);
    let mut watch = Watch::new(format!("rsi:{spec}"), span_s, false, &mut on)
        .keeping(0)
        .recording(LogFile::create(&log)?);
    write_description(folder, described)?;
    serve_at(spec, described, &mut station, &mut watch)?;
    watch.take_file().map_or(Ok(()), |mut file| file.finish(&log))?;
    let (telegrams, answers) = watch.count;
    let why = if watch.was_interrupted() { " (ended by a signal)" } else { "" };
    console::line!("{telegrams} telegrams and {answers} answers in {}{why}", log.display());
    Ok(())
}

/// Puts what a replay needs beside a log.
pub fn write_description(folder: &Path, described: &KrcScenario) -> Result<(), ExpectedError> {
    let text =
        described.description("The robot and its program, as they were described for this run.", CONFIG);
    for (name, text) in [(DESCRIPTION, &text), (CONFIG, &described.config_text)] {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|error| ExpectedError::output(&path, &error))?;
    }
    Ok(())
}
