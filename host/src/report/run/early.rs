//! Page of a job that ended before its motion ran, or whose log does not suffice for an analysis.

use serde_json::Value;

use super::super::frame::{cause, foot, head, reported_outcome, tone};
use super::super::page::{Answer, Cell, Tone, cell, number};
use super::{Ran, record};
use operator::analysis::events::RunEvent;
use operator::job::Outcome;
use operator::log::candump::Tear;

/// Page of a job that ended before its motion ran.
pub struct EarlyReport<'a> {
    pub ran: &'a Ran,
    /// `summary.json` of the job.
    pub summary: &'a Value,
    /// Why there is no analysis.
    pub why: &'a str,
    /// Everything that happened, in time of the log.
    pub events: &'a [RunEvent],
    /// Where the log was cut off.
    pub torn: Option<Tear>,
    /// Files behind the report: name, bytes, checksum.
    pub files: &'a [(String, u64, String)],
}

impl EarlyReport<'_> {
    /// One self-contained HTML file.
    #[must_use]
    pub fn html(&self) -> String {
        let (outcome, verdict) = reported_outcome(self.summary)
            .unwrap_or((Outcome::NotThrown, "no outcome is recorded".to_owned()));
        let text_of = |key: &str| self.summary.get(key).and_then(Value::as_str);
        let robot = &self.ran.robot;
        let (why, next) = cause(Some(self.summary)).unwrap_or_else(|| {
            ("the summary names no cause".to_owned(), "see the events of this page".to_owned())
        });
        // The cause is said once.
        let verdict = verdict.split(": ").next().unwrap_or_default().to_owned();
        let answer = Answer { verdict, tone: tone(outcome), why, next };
        let mut page = head(&self.ran.title(), &robot.name, Some(self.summary), None, &answer);
        page.section("What happened", "");
        let steps: Vec<Vec<Cell>> = self
            .summary
            .get("steps")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .map(|step| {
                let took_s = step.get("bus_time_s").and_then(Value::as_f64).unwrap_or_default();
                let name = step.get("step").and_then(Value::as_str).unwrap_or_default();
                vec![cell(name), number(took_s, 3)]
            })
            .chain(
                text_of("ended_in_step").map(|step| vec![cell(step), ("ended here".to_owned(), Tone::Bad)]),
            )
            .collect();
        page.table(&["step", "time of the bus, s"], steps);
        page.note(&format!("No motion is shown: {}.", self.why));
        if let Some(tear) = &self.torn {
            page.note(&format!("Attention: {tear}."));
        }
        page.part(
            "Events",
            "What controller, host and drives said. Time zero is the first frame of the log.",
        );
        record::events(&mut page, self.events);
        foot(&mut page, robot, self.ran.seed(), None, Some(self.summary), self.files);
        page.finish()
    }
}
