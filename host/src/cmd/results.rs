//! What a motion leaves behind if a folder is named: plan.json, bus.log, bus.mcap, summary.json and report.html.

use std::path::Path;

use operator::bus::BusArgs;
use planner::motion::Motion;
use planner::plan::Arm;
use planner::plan::file::{MotionInfo, RobotId};
use planner::record::MovePlan;
use serde_json::Value;

use super::folder::Folder;
use super::report;
use crate::error::ExpectedError;

pub(super) struct Results(Folder);

impl Results {
    /// The folder `out`, and the recording of `bus` in it; nothing if none was named.
    pub(super) fn create(out: Option<&Path>, bus: &mut BusArgs) -> Result<Option<Self>, ExpectedError> {
        let Some(path) = out else { return Ok(None) };
        let folder = Folder::create(Some(path))?;
        bus.record = Some(folder.file("bus"));
        Ok(Some(Self(folder)))
    }

    /// Writes the motion as a plan, which `cubectl run` takes.
    pub(super) fn write_plan(&self, robot: RobotId, arm: &Arm, motion: &Motion) -> Result<(), ExpectedError> {
        let names = arm.joints().iter().map(|joint| joint.name.clone());
        self.0.write("plan.json", &MovePlan::new(robot, MotionInfo::of(names, motion)).to_json())
    }

    /// Writes the summary, and the report that is made from the files.
    pub(super) fn write(&self, source: &str, mut summary: Value) -> Result<(), ExpectedError> {
        summary["command_line"] = std::env::args().collect::<Vec<_>>().join(" ").into();
        self.0.write("summary.json", &format!("{summary:#}\n"))?;
        report::write_into(&self.0, source)
    }

    pub(super) fn path(&self) -> &Path {
        &self.0.path
    }
}
