//! How a job ends: what people read, and what it leaves in a folder if one is named: plan.json, bus.log, bus.mcap, summary.json and
//! report.html.

use std::path::Path;

use operator::bus::BusArgs;
use operator::job::{Order, Record};
use planner::motion::Motion;
use planner::plan::file::{MotionInfo, RobotId};
use planner::record::MovePlan;

use super::ended::{command_line, failure, off_target, outcome_last};
use super::folder::Folder;
use super::link::{Link, Machine};
use super::log::report;
use super::print_json;
use super::progress::Ui;
use crate::error::ExpectedError;

pub(super) struct Results(Option<Folder>);

impl Results {
    /// The folder `out`, if one is named, and the recording of `bus` in it.
    pub(super) fn create(out: Option<&Path>, bus: &mut BusArgs) -> Result<Self, ExpectedError> {
        Folder::recording(out, bus).map(Self)
    }

    pub(super) const fn folder(&self) -> Option<&Folder> {
        self.0.as_ref()
    }

    /// Writes the motion as a plan, which `cubectl run` takes.
    pub(super) fn write_plan(&self, machine: &Machine, motion: &Motion) -> Result<(), ExpectedError> {
        let (Some(folder), Machine { source, arm, .. }) = (&self.0, machine) else { return Ok(()) };
        let names = arm.joints().iter().map(|joint| joint.name.clone());
        let plan = MovePlan::new(RobotId::of(source, arm), MotionInfo::of(names, motion));
        folder.write("plan.json", &plan.to_json())
    }

    /// Ends the link of a job. Writes the summary, and the report that is made from the files; prints the summary, or what
    /// `say` says of a job that went well.
    pub(super) fn conclude(
        &self,
        link: Link,
        ui: &Ui,
        (order, mut record): (&Order<'_>, Record),
        machine: &Machine,
        say: impl FnOnce(&Record),
    ) -> Result<(), ExpectedError> {
        ui.progress.quiet();
        let wrong = failure(&record).or_else(|| off_target(&record, &order.judge));
        let mut ended = link.end();
        let kept = ended.keep(machine, self.folder(), Some(&mut record));
        let mut finished = std::mem::replace(&mut ended.finished, Ok(())).and(kept);
        let mut summary = ended.seen.summary(order, &record, wrong.as_ref(), &ui.progress.wall_s);
        if ui.progress.silent {
            print_json(&summary);
        } else if wrong.is_none() {
            say(&record);
        }
        let Some(folder) = &self.0 else {
            ended.show(&record.verdict.text, None);
            return outcome_last(wrong, finished, None);
        };
        summary["command_line"] = command_line().into();
        let written = folder.write("summary.json", &format!("{summary:#}\n"));
        finished = finished.and(written).and_then(|()| report::write_into(folder, &machine.source));
        if wrong.is_none() && !ui.progress.silent {
            console::line!("results in {}", folder.path.display());
        }
        ended.show(&record.verdict.text, Some(folder));
        outcome_last(wrong, finished, Some(&folder.path))
    }
}
