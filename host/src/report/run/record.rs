//! The first fault, the events, and everything needed to repeat the run.

use serde_json::Value;

use super::super::chart::escape;
use super::super::page::{Page, Tone, cell, table};
use super::RunReport;
use operator::analysis::events::{FirstFault, RunEvent};
use operator::log::watch::Severity;
use planner::plan::file::PlanFile;

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
        repeat(page, self.plan, Some(&start), self.summary, self.files);
    }
}

/// What is needed to repeat a run: the command, what went into it, the files; the rest of its summary folded away.
pub(super) fn repeat(
    page: &mut Page,
    plan: &PlanFile,
    start_in_log: Option<&str>,
    summary: Option<&Value>,
    files: &[(String, u64, String)],
) {
    page.section("To repeat this run", "The command, what went into it, and its files.");
    let told = |pointer: &str| {
        summary.and_then(|all| all.pointer(pointer)).filter(|value| !value.is_null()).map(plain)
    };
    if let Some(command) = told("/command_line") {
        page.html(&format!(
            "<div class=\"card\"><pre class=\"wrap\">{}</pre></div><p></p>",
            escape(&command)
        ));
    }
    let of_search = plan.search.seed.to_string();
    let rows: Vec<Vec<(String, Tone)>> = [
        ("robot", Some(format!("{}, fingerprint {}", plan.robot.name, plan.robot.fingerprint))),
        ("seed of the search", Some(of_search)),
        ("seed of the simulated cell", told("/seed")),
        ("control period", told("/cycle/period_us").map(|us| format!("{us} µs"))),
        ("gains", told("/gains_from").map(|from| from.replace('_', " "))),
        ("checksum of the gains", told("/hashes/gains_crc32")),
        ("checksum of their certificate", told("/hashes/certificate_crc32")),
        ("checksum of the trajectory", told("/hashes/trajectory_crc64")),
        ("cubectl", told("/versions/cubectl")),
        ("start of the plan in the log", start_in_log.map(str::to_owned)),
    ]
    .into_iter()
    .filter_map(|(what, value)| Some(vec![cell(what), cell(value?)]))
    .collect();
    let files: Vec<Vec<(String, Tone)>> = files
        .iter()
        .map(|(name, bytes, checksum)| vec![cell(name), cell(bytes.to_string()), cell(checksum)])
        .collect();
    page.html(&format!(
        "<div class=\"two\">{}{}</div>",
        table(&["", "value"], &rows),
        table(&["file", "bytes", "CRC-64"], &files)
    ));
    if let Some(Value::Object(summary)) = summary {
        page.html("<details><summary>Everything in summary.json</summary>");
        page.html(&groups(summary));
        page.html("</details>");
    }
}

/// The document as tables: the values at its top in one, then one for each group.
fn groups(summary: &serde_json::Map<String, Value>) -> String {
    // The analysis is what the rest of the page shows.
    let shown = || summary.iter().filter(|(key, value)| *key != "analysis" && !value.is_null());
    let is_group = |value: &Value| match value {
        Value::Object(_) => true,
        Value::Array(items) => items.iter().any(Value::is_object),
        _ => false,
    };
    let single: Vec<_> =
        shown().filter(|(_, value)| !is_group(value)).map(|(key, value)| row(key, value)).collect();
    let mut html = format!("<div class=\"two\">{}", table(&["run", "value"], &single));
    for (key, value) in shown().filter(|(_, value)| is_group(value)) {
        html += &match value {
            Value::Array(items) => listed(key, items),
            Value::Object(map) => {
                let mut rows = Vec::new();
                flatten("", map, &mut rows);
                table(&[&key.replace('_', " "), "value"], &rows)
            }
            _ => String::new(),
        };
    }
    html + "</div>"
}

/// Objects of one kind: a column for each key.
fn listed(name: &str, items: &[Value]) -> String {
    let objects = || items.iter().filter_map(Value::as_object);
    let mut keys: Vec<&str> = Vec::new();
    for key in objects().flat_map(|object| object.keys()) {
        if !keys.contains(&key.as_str()) {
            keys.push(key);
        }
    }
    // What is named first as text.
    keys.sort_by_key(|key| !objects().all(|object| object.get(*key).is_some_and(Value::is_string)));
    let value =
        |object: &serde_json::Map<String, Value>, key: &str| object.get(key).map_or(String::new(), plain);
    let rows: Vec<Vec<(String, Tone)>> =
        objects().map(|object| keys.iter().map(|key| cell(value(object, key))).collect()).collect();
    let mut head: Vec<String> = keys.iter().map(|key| key.replace('_', " ")).collect();
    if let Some(first) = head.first_mut() {
        *first = format!("{}: {first}", name.replace('_', " "));
    }
    table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &rows)
}

fn row(key: &str, value: &Value) -> Vec<(String, Tone)> {
    vec![cell(key.replace('_', " ")), cell(plain(value))]
}

fn flatten(path: &str, map: &serde_json::Map<String, Value>, rows: &mut Vec<Vec<(String, Tone)>>) {
    for (key, value) in map {
        let path = if path.is_empty() { key.clone() } else { format!("{path}: {key}") };
        match value {
            Value::Null => {}
            Value::Object(map) => flatten(&path, map, rows),
            other => rows.push(row(&path, other)),
        }
    }
}

/// A value as people read it: six digits of a fraction, the elements of a list between commas.
fn plain(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Number(number) => match number.as_f64().filter(|_| number.is_f64()) {
            Some(fraction) => format!("{fraction:.5e}").parse().unwrap_or(fraction).to_string(),
            None => number.to_string(),
        },
        Value::Array(items) if items.iter().any(|item| item.is_array() || item.is_object()) => {
            items.iter().map(plain).collect::<Vec<_>>().join("; ")
        }
        Value::Array(items) => items.iter().map(plain).collect::<Vec<_>>().join(", "),
        other => other.to_string(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_summary_is_shown_in_groups_with_columns_for_lists() {
        let summary = json!({
            "seed": 7, "cause": null, "analysis": {"long": 1}, "tolerance_m": 0.023_184_923_595_672_563,
            "cycle": {"period_us": 3000, "thread": {"late": 2}},
            "steps": [{"bus_time_s": 0.5, "step": "home"}, {"bus_time_s": 6.0, "step": "arm", "took_s": 0.25}],
            "target_m": [1.0, 1.0, -1.0],
        });
        let html = groups(summary.as_object().unwrap());
        for text in
            ["seed", "0.0231849", "1, 1, -1", "thread: late", "steps: step", "bus time s", "home", "0.25"]
        {
            assert!(html.contains(text), "{text}: {html}");
        }
        assert!(!html.contains("long") && !html.contains("null") && !html.contains("0231849235"), "{html}");
        assert_eq!(html.matches("<table>").count(), 3, "{html}");
    }
}
