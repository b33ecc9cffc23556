//! The first fault, the events, and everything needed to repeat the run.

use super::super::chart::escape;
use super::super::page::{Page, Tone, cell, table};
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
        let number = |value: Option<f64>, digits: usize| {
            cell(value.map_or("–".to_owned(), |v| format!("{v:.digits$}").replace('-', "−")))
        };
        let rows: Vec<Vec<(String, Tone)>> = fault
            .joints
            .iter()
            .zip(&self.analysis.joints)
            .map(|(frozen, joint)| {
                vec![
                    cell(joint.name.clone()),
                    number(frozen.q_rad, 4),
                    number(frozen.error_rad.map(|e| e * 1e3), 2),
                    number(frozen.age_s.map(|s| s * 1e3), 2),
                    number(frozen.current_a, 2),
                    number(frozen.ramp_target_rad, 4),
                    number(frozen.ramp_a_rad_s2, 2),
                ]
            })
            .collect();
        page.table(
            &["joint", "q rad", "error mrad", "age ms", "current A", "ramp target rad", "ramp rad/s²"],
            &rows,
        );
        let frames = escape(&fault.frames.join("\n"));
        page.html(&format!(
            "<details><summary>The last frames before it</summary><div class=\"card\"><pre>{frames}</pre></div></details>"
        ));
    }

    pub(super) fn repeat(&self, page: &mut Page) {
        let start =
            format!("{:.6} s ({:?})", self.analysis.start_log_s, self.analysis.start_from).to_lowercase();
        foot(page, &self.ran.robot, self.ran.seed(), Some(&start), self.summary, self.files);
    }
}

/// All events as a table.
pub(super) fn events_table(events: &[RunEvent]) -> String {
    let rows: Vec<Vec<(String, Tone)>> = events
        .iter()
        .map(|event| {
            let tone = match event.severity {
                Severity::Info => Tone::Plain,
                Severity::Warning => Tone::Warn,
                Severity::Error => Tone::Bad,
            };
            let t_s = format!("{:+.4}", event.t_s).replace('-', "−");
            vec![cell(t_s), (event.source.clone(), Tone::Plain), (event.text.clone(), tone)]
        })
        .collect();
    table(&["time s", "who", "what"], &rows)
}
