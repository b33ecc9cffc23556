//! HTML report of a rally.

use host::report::ball_catch::{answer, body, mode_text, predicted_mm, subtitle};
use host::report::page::{Answer, Page, Tone, cell, number};
use operator::ball_catch::trial::Pair;

use crate::rally::exchange::{Exchange, Rally};

/// Page of a rally: its exchanges, and the last one in full.
pub(crate) fn rally(rally: &Rally, pair: &Pair, last: &Exchange, jerk: bool) -> String {
    let text = format!("{} of {} balls caught", rally.length(), rally.exchanges.len());
    let again = "play another rally: `--seed`, `--fault`; `--study` counts over many throws";
    let ball = answer(&last.outcome, again);
    let answer = match rally.end.not_thrown() {
        Some([why, next]) => Answer::new(text, Tone::Warn, why, next),
        None => {
            Answer::new(text, ball.tone, format!("the last ball: {}; {}", ball.verdict, ball.why), ball.next)
        }
    };
    let mut page = Page::new("Rally", &subtitle(pair, &last.outcome), &answer);
    let rows = rally.exchanges.iter().enumerate().map(|(k, exchange)| {
        let outcome = &exchange.outcome;
        let word = if outcome.caught { "caught" } else { "not caught" };
        vec![
            cell(k + 1),
            (word.to_owned(), Tone::of(outcome.caught)),
            cell(exchange.thrower + 1),
            number(exchange.aimed.flight_s, 2),
            cell(outcome.choice.as_ref().map_or("–", |c| mode_text(c.mode))),
            number(outcome.choice.as_ref().map(|c| c.probability), 2),
            number(predicted_mm(outcome), 1),
            number(outcome.crossing.map(|c| c.miss_m * 1e3), 1),
            number(outcome.crossing.map(|c| c.speed_m_s), 2),
        ]
    });
    page.section(
        "Exchanges",
        "Predicted and actual miss: distance of the ball's centre from the axis of the cup at its mouth.",
    );
    let head = [
        "throw",
        "ball",
        "arm",
        "flight s",
        "hand",
        "probability",
        "predicted miss mm",
        "actual miss mm",
        "against the hand m/s",
    ];
    page.table(&head, rows.collect());
    page.section("Last exchange", "");
    body(&mut page, pair, &last.outcome, jerk);
    page.finish()
}
