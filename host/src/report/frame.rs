//! Head and foot of the page of a job, over any link: the verdict, who did it, and what is needed to repeat it.

use operator::job::Outcome;
use planner::plan::file::RobotId;
use serde_json::Value;

use super::chart::escape;
use super::page::{Answer, Page, Tone, cell, table};

/// Outcome and sentence of a `summary.json`.
pub(super) fn told_outcome(summary: &Value) -> Option<(Outcome, String)> {
    let outcome = summary.get("outcome").and_then(Value::as_str).and_then(Outcome::from_json_name)?;
    // The second name is that of recordings before version 3.
    let text = ["outcome_text", "text"].into_iter().find_map(|key| summary.get(key)?.as_str());
    Some((outcome, text.unwrap_or(outcome.words()).to_owned()))
}

pub(super) fn tone(outcome: Outcome) -> Tone {
    match outcome {
        Outcome::Landed | Outcome::Reached | Outcome::Stored => Tone::Good,
        Outcome::NotObserved => Tone::Plain,
        Outcome::NotThrown | Outcome::NotRun => Tone::Warn,
        Outcome::Missed | Outcome::NotReleased | Outcome::Stopped | Outcome::NotReached => Tone::Bad,
    }
}

/// Why a job ended as it did and what to do, if its summary names a cause beyond the outcome.
pub(super) fn cause(summary: Option<&Value>) -> Option<(String, String)> {
    let why = summary?.get("cause")?.as_str()?;
    // Recordings before this field have the step in the cause.
    let next = summary?.get("next").and_then(|steps| steps.get(0)?.as_str());
    let says_more = told_outcome(summary?).is_none_or(|(_, text)| text != why);
    says_more.then(|| (why.to_owned(), next.unwrap_or("see the events of this page").to_owned()))
}

/// The page of a throw to a target: `more` stands beside robot, bus, time, controller and seed.
pub(super) fn head(
    title: &str,
    robot: &str,
    summary: Option<&Value>,
    more: Option<String>,
    answer: &Answer,
) -> Page {
    let text = |pointer: &str| summary.and_then(|all| all.pointer(pointer)).and_then(Value::as_str);
    let seed = summary.and_then(|all| all.get("seed")).filter(|seed| !seed.is_null());
    let parts = [
        Some(robot.to_owned()),
        text("/bus").map(|bus| format!("bus {bus}")),
        text("/time").map(str::to_owned),
        text("/controller/kind").map(|kind| format!("controller {kind}")),
        seed.map(|seed| format!("seed {seed}")),
        more,
    ];
    let under: Vec<String> = parts.into_iter().flatten().collect();
    Page::new(&title.replace('-', "−"), &under.join(" · "), answer)
}

/// What is needed to repeat a run: the command, what went into it, the files; the rest of its summary folded away.
pub(super) fn foot(
    page: &mut Page,
    robot: &RobotId,
    seed_of_search: Option<u64>,
    start_in_log: Option<&str>,
    summary: Option<&Value>,
    files: &[(String, u64, String)],
) {
    page.part("To repeat this run", "The command, what went into it, and its files.");
    let noted = |pointer: &str| {
        summary.and_then(|all| all.pointer(pointer)).filter(|value| !value.is_null()).map(plain)
    };
    if let Some(command) = noted("/command_line") {
        page.html(&format!("<div class=\"card\"><pre class=\"wrap\">{}</pre></div>", escape(&command)));
    }
    let rows: Vec<Vec<(String, Tone)>> = [
        ("robot", Some(format!("{}, fingerprint {}", robot.name, robot.fingerprint))),
        ("seed of the search", seed_of_search.map(|seed| seed.to_string())),
        ("seed of the simulated cell", noted("/seed")),
        ("control period", noted("/cycle/period_us").map(|us| format!("{us} µs"))),
        ("gains", noted("/gains_from").map(|from| from.replace('_', " "))),
        ("checksum of the gains", noted("/hashes/gains_crc32")),
        ("checksum of their certificate", noted("/hashes/certificate_crc32")),
        ("checksum of the trajectory", noted("/hashes/trajectory_crc64")),
        ("cubectl", noted("/versions/cubectl")),
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_cause_has_a_next_step_and_does_not_repeat_the_outcome() {
        let of = |cause: &str, next: &[&str]| {
            super::cause(Some(
                &json!({"outcome": "missed", "outcome_text": "missed: 9 mm", "cause": cause, "next": next}),
            ))
        };
        assert_eq!(of("arm: refused", &["home"]), Some(("arm: refused".to_owned(), "home".to_owned())));
        assert_eq!(of("missed: 9 mm", &["look"]), None);
        assert_eq!(of("lost", &[]).unwrap().1, "see the events of this page");
    }

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
