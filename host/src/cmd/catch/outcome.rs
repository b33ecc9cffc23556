//! How a catch of a ball ended: exit code, text and JSON.

use operator::ball_catch::trial::{CatchOutcome, Outcome};
use planner::catch::online::Decision;
use planner::catch::task::Mode;
use serde_json::{Value, json};

use crate::error::ExpectedError;
use crate::exit;
use crate::report::ball_catch::decision_word;

/// How a trial in the simulated court ends: its ball decides, not what the catcher reports of it.
///
/// # Errors
/// The ball is not in the cup, or the arm was stopped by a fault.
pub fn ended(outcome: &Outcome) -> Result<(), ExpectedError> {
    match outcome.reported {
        halted @ CatchOutcome::Halted => Err(why_not_caught(halted)),
        _ if outcome.caught => Ok(()),
        other => Err(why_not_caught(other)),
    }
}

/// Why a ball was not caught, with the exit code.
pub fn why_not_caught(reported: CatchOutcome) -> ExpectedError {
    let (code, what, next) = match reported {
        CatchOutcome::Caught => (exit::MISSED, "the ball was not caught, although the catcher reports a catch".to_owned(), "`--report` shows where it passed"),
        CatchOutcome::Declined(why) => (exit::NO_THROW, format!("declined: {why}"), "throw slower, higher or nearer to the arm"),
        CatchOutcome::Missed => (exit::MISSED, "the ball was not caught".to_owned(), "`--report` shows where it passed"),
        CatchOutcome::Unknown => (
            exit::MISSED,
            "whether the ball was caught is not known: the tracker saw nothing after the catch, or the ball still moved in the cup".to_owned(),
            "look at the tracker and at the cup",
        ),
        CatchOutcome::NothingThrown => (
            exit::NOT_RELEASED,
            "no ball was seen in flight; the arm stayed where it was".to_owned(),
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

fn mode_word(mode: Mode) -> &'static str {
    match mode {
        Mode::Matched => "matched",
        Mode::Hold => "hold",
    }
}

/// One outcome as text.
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

/// One outcome as JSON.
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
        "refusals": outcome.refusals.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}
