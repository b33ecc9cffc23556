//! Whether the throw of a row is valid, and what it costs.

use planner::plan::relaxation::levels;
use planner::plan::{Kept, Options};
use planner::request::plan_of;
use planner::verify;
use robot_model::RobotModel;

use super::rows::Row;

/// The price of the row's throw, computed from it, if it keeps every limit of a relaxation level (column `level`) by the verifier.
///
/// # Errors
/// Why the throw is not valid.
pub(crate) fn judge(arm: &RobotModel, row: &Row, level: usize) -> Result<f64, String> {
    let throw = row.throw(arm.n()).ok_or("the throw is missing or has another number of joints")?;
    let (_, options) = levels(&Options::best(), Kept::default())
        .into_iter()
        .nth(level)
        .ok_or_else(|| format!("there is no level {level}"))?;
    let plan = plan_of(arm, &throw, row.target, &options)
        .map_err(|e| e.to_string())?
        .ok_or("the ball does not come down at the target")?;
    let report = verify::check(arm, &plan);
    match report.findings.iter().find(|f| f.enforced && !f.ok) {
        Some(finding) => Err(format!("{}: {}", finding.what, finding.worst)),
        None => Ok(plan.objective.value),
    }
}
