//! `cubectl plan throw --targets FILE`: one throw per row of a table, one row of results for each.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use planner::plan::file::PlanFile;
use planner::request::Plans;
use robot_model::RobotModel;
use throw_tables::{TargetList, TargetRow};

use super::args::Args;
use super::search::{Planned, Watcher};
use super::shards::{table_error, words_of};
use super::table::{append, continued};
use crate::error::ExpectedError;
use crate::exit;
use operator::interrupt::interrupt;

/// Most targets of a list.
const LIST_MAX_ROWS: u64 = 1_000_000;
/// Columns of the results. `outcome` is `thrown`, `relaxed` (without some of what was asked for, see the note) or
/// `refused` (the note says why).
const HEADER: [&str; 13] = [
    "row",
    "x_m",
    "y_m",
    "z_m",
    "outcome",
    "objective",
    "release_s",
    "duration_s",
    "flight_s",
    "speed_m_s",
    "spread_m",
    "hit_probability",
    "note",
];

/// Plans the rows of the list that the results do not have yet, in order.
///
/// # Errors
/// If the list is refused, a file cannot be written, or Ctrl-C stops it; rows that are done stay.
pub(super) fn run<const N: usize>(arm: &RobotModel<N>, list: &Path, args: &Args) -> Result<(), ExpectedError>
where
    RobotModel<N>: Plans<N>,
{
    let Some(out) = &args.out else {
        return Err(ExpectedError::bad_input(&"--targets needs --out FILE for the table of results"));
    };
    let (rows, crc32) = read_list(list)?;
    if let Some(folder) = &args.plans {
        std::fs::create_dir_all(folder).map_err(|e| ExpectedError::output(folder, &e))?;
    }
    let mut starts = args.search.options.starts(arm)?;
    let mut words = words_of(&args.search, arm, (args.seed, args.fast), &starts)?;
    words.insert("target list".to_owned(), format!("CRC-32 {crc32:08x}"));
    let (file, mut lines) = continued(out, &HEADER.join(","), &words)?;
    console::note!("cubectl: {} targets, {} already in {}", rows.len(), lines.len(), out.display());
    let stop = interrupt();
    for (number, row) in rows.iter().enumerate().skip(lines.len()) {
        let planned = args.search.with_target(row).plan_from(
            arm,
            &mut starts,
            row.target_m,
            (args.seed, args.fast),
            Watcher::Terminal,
        );
        if stop.load(Ordering::Relaxed) {
            return Err(ExpectedError::new(
                exit::INTERRUPTED,
                format!(
                    "stopped after {number} of {} targets; what is done is in {}\n  next: run the same command again, it continues there",
                    rows.len(),
                    out.display()
                ),
            ));
        }
        let line = match planned {
            Ok(planned) => {
                if let Some(folder) = &args.plans {
                    let path = plan_path(folder, number);
                    planned.plan.write(&path).map_err(|e| ExpectedError::new(exit::OUTPUT, e.to_string()))?;
                }
                thrown(number, row, &planned)
            }
            Err(e) if [exit::NO_THROW, exit::BAD_INPUT].contains(&e.code) => refused(number, row, &e)?,
            Err(e) => return Err(e),
        };
        append(&file, &line).map_err(|e| ExpectedError::output(out, &e))?;
        lines.push(line);
    }
    report(out, &lines);
    Ok(())
}

/// The plan of row `number` (from 0) in a folder.
fn plan_path(folder: &Path, number: usize) -> PathBuf {
    folder.join(format!("plan-{:06}.json", number + 1))
}

fn line(fields: &[String]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing to memory does not fail.
    let written = writer.write_record(fields).ok().and_then(|()| writer.into_inner().ok());
    String::from_utf8(written.unwrap_or_default()).unwrap_or_default().trim_end().to_owned()
}

fn head(number: usize, row: &TargetRow) -> Vec<String> {
    let [x, y, z] = row.target_m;
    vec![(number + 1).to_string(), x.to_string(), y.to_string(), z.to_string()]
}

fn thrown(number: usize, row: &TargetRow, planned: &Planned<PlanFile>) -> String {
    let plan = &planned.plan;
    let [[xx, _], [_, yy]] = plan.landing.covariance_m2;
    let speed = plan.release.velocity_m_s.iter().map(|v| v * v).sum::<f64>().sqrt();
    let mut fields = head(number, row);
    fields.extend([
        if planned.note.is_some() { "relaxed" } else { "thrown" }.to_owned(),
        plan.objective.value.to_string(),
        plan.release_time_s.to_string(),
        plan.end_time_s.to_string(),
        plan.landing.flight_s.to_string(),
        speed.to_string(),
        (xx + yy).sqrt().to_string(),
        plan.landing.hit_probability.map_or_else(String::new, |p| p.to_string()),
        planned.note.unwrap_or_default().to_owned(),
    ]);
    line(&fields)
}

fn refused(number: usize, row: &TargetRow, e: &ExpectedError) -> Result<String, ExpectedError> {
    let mut fields = head(number, row);
    let note = e.message.lines().map(str::trim).collect::<Vec<_>>().join("; ");
    fields.push("refused".to_owned());
    fields.extend(std::iter::repeat_n(String::new(), HEADER.len() - fields.len() - 1));
    fields.push(note);
    Ok(line(&fields))
}

/// Counts of the outcomes.
fn report(out: &Path, lines: &[String]) {
    let count = |outcome| lines.iter().filter(|line| line.split(',').nth(4) == Some(outcome)).count();
    let (thrown, relaxed) = (count("thrown"), count("relaxed"));
    console::line!(
        "{thrown} throws with all that was asked for, {relaxed} without some of it, {} refused (see the notes): {}",
        lines.len() - thrown - relaxed,
        out.display()
    );
}

/// The rows of a list, and its CRC-32.
fn read_list(path: &Path) -> Result<(Vec<TargetRow>, u32), ExpectedError> {
    let list = TargetList::open(path).map_err(table_error)?;
    if list.len() > LIST_MAX_ROWS {
        return Err(ExpectedError::bad_input(&format!(
            "{}: {} targets, at most {LIST_MAX_ROWS}\n  next: `cubectl plan sweep --targets {} --shards N --out FOLDER` takes longer lists",
            path.display(),
            list.len(),
            path.display()
        )));
    }
    let rows = list.rows_from(0).map_err(table_error)?.collect::<Result<_, _>>().map_err(table_error)?;
    Ok((rows, list.crc32()))
}
