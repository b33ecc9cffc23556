//! How a job ends: what people read, and what it leaves in a folder if one is named: plan.json, bus.log, bus.mcap, summary.json and
//! report.html.

use std::path::Path;

use operator::bus::{BusArgs, Session};
use operator::job::{Order, Record};
use planner::motion::Motion;
use planner::plan::Arm;
use planner::plan::file::{MotionInfo, RobotId};
use planner::record::MovePlan;

use super::controlled::tell_warnings;
use super::ended::{Seen, command_line, failure, off_target, outcome_last};
use super::folder::Folder;
use super::progress::Ui;
use super::{print_json, report};
use crate::error::ExpectedError;

pub(super) struct Results(Option<Folder>);

impl Results {
    /// The folder `out`, if one is named, and the recording of `bus` in it.
    pub(super) fn create(out: Option<&Path>, bus: &mut BusArgs) -> Result<Self, ExpectedError> {
        Folder::recording(out, bus).map(Self)
    }

    /// Writes the motion as a plan, which `cubectl run` takes.
    pub(super) fn write_plan(&self, source: &str, arm: &Arm, motion: &Motion) -> Result<(), ExpectedError> {
        let Some(folder) = &self.0 else { return Ok(()) };
        let names = arm.joints().iter().map(|joint| joint.name.clone());
        let plan = MovePlan::new(RobotId::of(source, arm), MotionInfo::of(names, motion));
        folder.write("plan.json", &plan.to_json())
    }

    /// Ends the session of a job. Writes the summary, and the report that is made from the files; prints the summary, or what
    /// `say` says of a job that went well.
    pub(super) fn conclude(
        &self,
        mut session: Session,
        ui: &Ui,
        (order, record): (&Order<'_>, &Record),
        source: &str,
        say: impl FnOnce(),
    ) -> Result<(), ExpectedError> {
        ui.progress.quiet();
        tell_warnings(&mut session);
        let wrong = failure(record).or_else(|| off_target(record, &order.judge));
        let seen = Seen::of(&session);
        let mut finished = session.finish().map_err(ExpectedError::from);
        let mut summary = seen.summary(order, record, wrong.as_ref(), &ui.progress.wall_s);
        if ui.progress.silent {
            print_json(&summary);
        } else if wrong.is_none() {
            say();
        }
        let Some(folder) = &self.0 else { return outcome_last(wrong, finished, None) };
        summary["command_line"] = command_line().into();
        let written = folder.write("summary.json", &format!("{summary:#}\n"));
        finished = finished.and(written).and_then(|()| report::write_into(folder, source));
        if wrong.is_none() && !ui.progress.silent {
            console::line!("results in {}", folder.path.display());
        }
        outcome_last(wrong, finished, Some(&folder.path))
    }
}
