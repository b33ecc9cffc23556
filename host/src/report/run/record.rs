//! The first fault, the events, and everything needed to repeat the run.

use super::super::page::{Block, Page, Tone, cell, number};
use super::RunReport;
use crate::report::frame::foot;
use operator::analysis::events::{FirstFault, RunEvent};
use operator::log::watch::Severity;

impl RunReport<'_> {
    pub(super) fn fault(&self, page: &mut Page, fault: &FirstFault) {
        let place = fault.joint.map_or("the group".to_owned(), |joint| format!("joint {joint}"));
        page.section(
            &format!("First fault: {} ({})", fault.what, fault.code),
            &format!(
                "At {:.3} s of the plan, of {place}, while {}. What to do: {}.",
                fault.t_s, fault.state_before, fault.recovery
            ),
        );
        let milli = |value: Option<f64>| number(value.map(|value| 1e3 * value), 2);
        let rows = fault.joints.iter().zip(&self.analysis.joints).map(|(frozen, joint)| {
            vec![
                cell(&joint.name),
                number(frozen.q_rad, 4),
                milli(frozen.error_rad),
                milli(frozen.age_s),
                number(frozen.current_a, 2),
                number(frozen.ramp_target_rad, 4),
                number(frozen.ramp_a_rad_s2, 2),
            ]
        });
        let head = ["joint", "q rad", "error mrad", "age ms", "current A", "ramp target rad", "ramp rad/s²"];
        page.table(&head, rows.collect());
        let block = Box::new(Block::Pre(fault.frames.join("\n")));
        page.push(Block::Folded { name: "The last frames before it", block });
    }

    pub(super) fn repeat(&self, page: &mut Page) {
        let start =
            format!("{:.6} s ({:?})", self.analysis.start_log_s, self.analysis.start_from).to_lowercase();
        foot(page, &self.ran.robot, self.ran.seed(), Some(&start), self.summary, self.files);
    }
}

pub(super) fn events(page: &mut Page, events: &[RunEvent]) {
    let rows = events.iter().map(|event| {
        let tone = match event.severity {
            Severity::Info => Tone::Plain,
            Severity::Warning => Tone::Warn,
            Severity::Error => Tone::Bad,
        };
        let t_s = format!("{:+.4}", event.t_s).replace('-', "−");
        vec![cell(t_s), cell(&event.source), (event.text.clone(), tone)]
    });
    page.table(&["time s", "who", "what"], rows.collect());
}
