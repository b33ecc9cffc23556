//! How a catch of a ball ended: exit code, text and JSON.

use hil_sim::two_arms::TwoArmEvent;
use operator::ball_catch::trial::{CatchOutcome, Moment, Outcome};
use planner::catch::online::Decision;
use planner::catch::task::{Decline, Mode};
use serde_json::{Map, Value, json};

use crate::error::ExpectedError;
use crate::exit;
use crate::report::ball_catch::decision_word;

/// How a trial in the simulated cell ends.
///
/// # Errors
/// The ball is not in the cup, or the catcher does not report that it is.
pub fn ended(outcome: &Outcome) -> Result<(), ExpectedError> {
    if outcome.known_caught() {
        return Ok(());
    }
    let error = why_not_caught(outcome.reported);
    if outcome.caught && outcome.reported == CatchOutcome::Missed {
        let what = "the simulated ball lies in the cup, but the catcher reports that it was missed";
        return Err(ExpectedError::new(error.code, what).next("look at the tracker and its room"));
    }
    Err(error)
}

/// Why a ball was not caught, with the exit code.
pub fn why_not_caught(reported: CatchOutcome) -> ExpectedError {
    let (code, what, next) = match reported {
        CatchOutcome::Caught => (exit::MISSED, "the ball was not caught, although the catcher reports a catch".to_owned(), "`--report` shows where it passed"),
        CatchOutcome::Declined(why @ Decline::BouncesOut) => (
            exit::NO_THROW,
            format!("declined: {why}"),
            "throw slower, allow `--hand either`, or line the cup with softer material (`restitution` of the cell file)",
        ),
        CatchOutcome::Declined(why) => (exit::NO_THROW, format!("declined: {why}"), "throw slower, higher or nearer to the arm"),
        CatchOutcome::Missed => (exit::MISSED, "the ball was not caught".to_owned(), "`--report` shows where it passed"),
        CatchOutcome::Unknown => (
            exit::MISSED,
            "whether the ball was caught is not known: the tracker saw nothing after the catch, or the ball still moved in the cup".to_owned(),
            "look at the tracker and at the cup",
        ),
        CatchOutcome::NothingThrown => (
            exit::NOT_RELEASED,
            "no ball was released: the tracker saw none in flight".to_owned(),
            "look at the thrower and the tracker",
        ),
        CatchOutcome::Halted => (exit::STOPPED, "the catcher's arm stopped because of a fault".to_owned(), "`cubectl doctor`"),
    };
    ExpectedError::new(code, what).next(next)
}

/// What the catcher reports, as text.
pub fn reported_text(reported: CatchOutcome) -> String {
    match reported {
        CatchOutcome::Caught => "caught".to_owned(),
        CatchOutcome::Missed => "missed".to_owned(),
        CatchOutcome::Unknown => "not known".to_owned(),
        CatchOutcome::Declined(why) => format!("declined: {why}"),
        CatchOutcome::NothingThrown => "nothing thrown".to_owned(),
        CatchOutcome::Halted => "stopped by a fault".to_owned(),
    }
}

pub(super) fn mode_word(mode: Mode) -> &'static str {
    match mode {
        Mode::Matched => "matched",
        Mode::Hold => "hold",
    }
}

pub fn as_text(outcome: &Outcome) -> String {
    let mut out = format!(
        "reported: {}; the simulated ball is {}the cup\n",
        reported_text(outcome.reported),
        if outcome.caught { "in " } else { "not in " }
    );
    if let Some(choice) = &outcome.choice {
        out += &format!(
            "  {} catch {:.3} s after the release, predicted probability {:.2}, motion uses {:.0} % of the acceleration\n",
            mode_word(choice.mode),
            choice.t_s - outcome.planned_s.0,
            choice.probability,
            choice.used * 100.0
        );
    }
    if let Some(crossing) = outcome.crossing {
        out += &format!(
            "  at the mouth of the cup: {:.1} mm off its axis, {:.0} deg, {:.2} m/s\n",
            crossing.miss_m * 1e3,
            crossing.angle_rad.to_degrees(),
            crossing.speed_m_s
        );
    }
    let by_other_arm = outcome.events.iter().find_map(|(_, event)| match event {
        TwoArmEvent::HitLink { arm: 0, part, .. } => Some(part),
        _ => None,
    });
    if let Some(part) = by_other_arm {
        out += &format!("  the ball hit the other arm of the cell ({part})\n");
    }
    let corrected = outcome.log.iter().filter(|l| l.decision == Decision::Corrected).count();
    let judged: usize = outcome.log.iter().map(|l| l.count.judged).sum();
    out += &format!(
        "  {} forecasts, {corrected} corrections, {judged} candidates judged; catcher: largest speed {:.0} %, acceleration {:.0} % of its limit\n",
        outcome.log.len(),
        outcome.executed[1].speed * 100.0,
        outcome.executed[1].acceleration * 100.0
    );
    out
}

pub fn as_json(outcome: &Outcome) -> Value {
    json!({
        "caught": outcome.caught,
        "reported": reported_text(outcome.reported),
        "crossing": outcome.crossing.map(|c| json!({"miss_m": c.miss_m, "angle_rad": c.angle_rad, "speed_m_s": c.speed_m_s})),
        "choice": outcome.choice.as_ref().map(|c| json!({
            "mode": mode_word(c.mode), "after_release_s": c.t_s - outcome.planned_s.0, "p_m": c.p_m.as_slice(),
            "axis": c.axis.as_slice(), "q_rad": c.q[..], "qd_rad_s": c.qd[..],
            "probability": c.probability, "used": c.used, "relative_m_s": c.relative_m_s,
        })),
        "decisions": outcome.log.iter().map(|l| json!({
            "after_release_s": l.at_s - outcome.planned_s.0, "decision": decision_word(&l.decision),
            "probability": l.probability, "sigma_m": l.sigma_m, "off_m": l.off_m, "judged": l.count.judged,
        })).collect::<Vec<_>>(),
        "limits": {
            "thrower": outcome.executed[0], "catcher": outcome.executed[1], "arms_touched": outcome.arms_touched,
            "planned": {"speed": outcome.used[0], "acceleration": outcome.used[1], "jerk": outcome.used[2]},
        },
        "events": outcome.events.iter().map(|(at_s, event)| event_json(at_s - outcome.planned_s.0, event)).collect::<Vec<_>>(),
        "trace": trace(outcome),
        "refusals": outcome.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

/// Where ball and catcher were, in the world of the cell, as executed.
fn trace(outcome: &Outcome) -> Value {
    let column = |of: &dyn Fn(&Moment) -> Value| -> Value { outcome.trace.iter().map(of).collect() };
    json!({
        "t_s": column(&|moment| json!(moment.t_s - outcome.planned_s.0)),
        "ball_m": column(&|moment| json!(moment.ball_m.as_slice())),
        "q_rad": column(&|moment| json!(moment.q[1][..])),
    })
}

fn event_json(after_release_s: f64, event: &TwoArmEvent) -> Value {
    let (what, arm, more) = match event {
        TwoArmEvent::Released { arm } => ("released", Some(arm), None),
        TwoArmEvent::Crossed { arm, .. } => ("crossed the mouth of the cup", Some(arm), None),
        TwoArmEvent::HitCup { arm, speed_m_s } => {
            ("hit the cup", Some(arm), Some(("speed_m_s", json!(speed_m_s))))
        }
        TwoArmEvent::HitLink { arm, part, .. } => ("hit a link", Some(arm), Some(("part", json!(part)))),
        TwoArmEvent::HitFloor => ("hit the floor", None, None),
        TwoArmEvent::Rests { arm } => ("rests in the cup", Some(arm), None),
        TwoArmEvent::FellOut { arm } => ("fell out of the cup", Some(arm), None),
        TwoArmEvent::Gripped { arm } => ("gripped", Some(arm), None),
    };
    let mut result = Map::new();
    result.insert("after_release_s".to_owned(), json!(after_release_s));
    result.insert("event".to_owned(), json!(what));
    let arm = arm.map(|arm| if *arm == 0 { "thrower" } else { "catcher" });
    result.insert("arm".to_owned(), json!(arm));
    if let Some((name, value)) = more {
        result.insert(name.to_owned(), value);
    }
    Value::Object(result)
}
