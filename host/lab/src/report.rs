//! HTML report of a rally.

use host::report::ball_catch::{answer, body, mode_text, predicted_mm, subtitle};
use host::report::page::{Answer, Page, Tone, cell};
use operator::ball_catch::trial::Pair;

use crate::rally::exchange::{Exchange, Rally};

/// Page of a rally: its exchanges, and the last one in full.
pub(crate) fn rally(rally: &Rally, pair: &Pair, last: &Exchange, jerk: bool) -> String {
    let tone = if last.outcome.caught { Tone::Good } else { Tone::Warn };
    let text = format!("{} catches in a row", rally.length());
    let ended = answer(&last.outcome);
    let why = format!("the last exchange: {}; {}", ended.verdict, ended.why);
    let mut page =
        Page::new("Rally", &subtitle(pair, &last.outcome), &Answer::new(text, tone, why, ended.next));
    let rows: Vec<Vec<(String, Tone)>> = rally
        .exchanges
        .iter()
        .enumerate()
        .map(|(k, exchange)| {
            let outcome = &exchange.outcome;
            let number = |value: Option<f64>, digits: usize| {
                value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
            };
            vec![
                cell((k + 1).to_string()),
                cell((exchange.thrower + 1).to_string()),
                cell(format!("{:.2}", exchange.aimed.flight_s)),
                cell(outcome.choice.as_ref().map_or("–", |c| mode_text(c.mode))),
                cell(number(outcome.choice.as_ref().map(|c| c.probability), 2)),
                cell(number(predicted_mm(outcome), 1)),
                cell(number(outcome.crossing.map(|c| c.miss_m * 1e3), 1)),
                cell(number(outcome.crossing.map(|c| c.speed_m_s), 2)),
                if outcome.caught {
                    ("caught".to_owned(), Tone::Good)
                } else {
                    ("not caught".to_owned(), Tone::Bad)
                },
            ]
        })
        .collect();
    page.section(
        "Exchanges",
        "Predicted and actual miss: distance of the ball's centre from the axis of the cup at its mouth.",
    );
    page.table(
        &[
            "throw",
            "arm",
            "flight s",
            "hand",
            "probability",
            "predicted miss mm",
            "actual miss mm",
            "against the hand m/s",
            "ball",
        ],
        &rows,
    );
    page.section("Last exchange", "");
    body(&mut page, pair, &last.outcome, jerk);
    page.finish()
}
