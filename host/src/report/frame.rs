//! Head and foot of the page of a job, over any link: the verdict, who did it, and what is needed to repeat it.

use operator::job::Outcome;
use planner::plan::file::RobotId;
use serde_json::Value;

use super::page::{Answer, Block, Cell, Page, Tone, cell, table};

/// Outcome and sentence of a `summary.json`.
pub(super) fn reported_outcome(summary: &Value) -> Option<(Outcome, String)> {
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
    let says_more = reported_outcome(summary?).is_none_or(|(_, text)| text != why);
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
    let noted = |pointer: &str| match summary?.pointer(pointer)? {
        Value::Null => None,
        Value::String(text) => Some(text.clone()),
        value => Some(value.to_string()),
    };
    if let Some(command) = noted("/command_line") {
        page.push(Block::Command(command));
    }
    let rows: Vec<Vec<Cell>> = [
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
    let file =
        |(name, bytes, checksum): &(String, u64, String)| vec![cell(name), cell(bytes), cell(checksum)];
    page.push(Block::Beside(vec![
        table(&["", "value"], rows),
        table(&["file", "bytes", "CRC-64"], files.iter().map(file).collect()),
    ]));
    if let Some(Value::Object(summary)) = summary {
        // The analysis is what the rest of the page shows.
        let shown = summary.iter().filter(|(key, value)| *key != "analysis" && !value.is_null());
        page.summary(&shown.map(|(key, value)| (key.clone(), value.clone())).collect());
    }
}

#[cfg(test)]
mod tests {
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
}
