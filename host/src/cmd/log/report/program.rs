//! The report of a program: what its folder keeps, and the page that is made from that.

use std::path::Path;

use planner::plan::file::RobotId;
use planner::store::file::write_whole;
use serde_json::Value;

use super::{checksum, summary_of};
use crate::cmd::folder::Folder;
use crate::cmd::program_record::Performed;
use crate::cmd::rsi::LOG;
use crate::error::ExpectedError;
use crate::report::program::{ProgramDone, ProgramReport};

/// What was done of a program, in its folder.
pub(super) const DONE: &str = "program.json";
/// Longest file of it that is read, bytes.
const DONE_MAX_BYTES: u64 = 256 << 20;

/// Leaves what was done of the program `file`, its summary and its report in the folder.
pub(in crate::cmd) fn keep(
    folder: &Folder,
    file: &Path,
    performed: Performed,
    robot: RobotId,
    summary: &Value,
) -> Result<(), ExpectedError> {
    let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let done = performed.into_done(name, robot);
    folder.write("summary.json", &format!("{summary:#}\n"))?;
    folder.write(DONE, &serde_json::json!(done).to_string())?;
    write(&folder.path, &folder.file("report.html"))
}

/// Writes the report from the files of a folder.
pub(super) fn write(folder: &Path, out: &Path) -> Result<(), ExpectedError> {
    let file = folder.join(DONE);
    let text =
        toml_reader::read_text(&file, DONE_MAX_BYTES).map_err(|error| ExpectedError::io(&file, &error))?;
    let done: ProgramDone = serde_json::from_str(&text)
        .map_err(|error| ExpectedError::bad_input(&format!("{}: {error}", file.display())))?;
    let arm = crate::cmd::robot(&done.robot.source)?;
    let files = ["bus.log", LOG, "cycles.csv"].map(|name| folder.join(name));
    let files = files.iter().filter(|file| file.is_file()).map(|file| checksum(file));
    let files = files.collect::<Result<Vec<_>, _>>()?;
    let summary = summary_of(&folder.join("summary.json"))?;
    let html = ProgramReport { arm: &arm, done: &done, summary: &summary, files: &files }.html();
    write_whole(out, html.as_bytes()).map_err(|error| ExpectedError::output(out, &error))
}
