//! The first fault, the events, and everything needed to repeat the run.

use serde_json::Value;

use super::super::chart::escape;
use super::super::page::{Page, Tone, cell, table};
use super::{RunReport, repeat_rows};
use operator::analysis::events::{Event, FirstFault};
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
        page.section("To repeat this run", "Seeds, versions, checksums and files.");
        let mut rows = vec![
            vec![cell("plan: robot"), cell(self.plan.robot.name.clone())],
            vec![cell("plan: fingerprint of the robot"), cell(self.plan.robot.fingerprint.clone())],
            vec![cell("plan: seed of the search"), cell(self.plan.search.seed.to_string())],
            vec![
                cell("log: start of the plan"),
                cell(
                    format!("{:.6} s ({:?})", self.analysis.start_log_s, self.analysis.start_from)
                        .to_lowercase(),
                ),
            ],
        ];
        repeat_rows(self.summary, self.files, &mut rows);
        page.table(&["", "value"], &rows);
    }
}

/// Leaves of a JSON document as rows. Long lists are left out: the rest of the page shows them.
pub(super) fn flatten(path: &str, value: &Value, rows: &mut Vec<Vec<(String, Tone)>>) {
    match value {
        Value::Object(map) => {
            // The analysis is what the rest of the page shows.
            for (key, value) in map.iter().filter(|(key, _)| !path.is_empty() || *key != "analysis") {
                let path = if path.is_empty() { key.clone() } else { format!("{path}: {key}") };
                flatten(&path, value, rows);
            }
        }
        Value::Array(items) if items.iter().any(|item| item.is_object() || item.is_array()) => {
            for (i, item) in items.iter().enumerate().take(20) {
                flatten(&format!("{path} {}", i + 1), item, rows);
            }
        }
        Value::Null => {}
        Value::String(text) => rows.push(vec![cell(path.to_owned()), cell(text.clone())]),
        other => rows.push(vec![cell(path.to_owned()), cell(other.to_string())]),
    }
}

/// All events as a table.
pub(super) fn events_table(events: &[Event]) -> String {
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
