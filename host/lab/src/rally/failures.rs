//! Why a ball was not caught: one throw at a time, from its decisions and from what the cell saw.

use hil_sim::two_arms::TwoArmEvent;
use operator::ball_catch::trial::CatchOutcome;
use operator::ball_catch::trial::Outcome;
use planner::catch::draw::Aimed;
use planner::catch::online::{Decision, Logged};
use serde::Serialize;

/// What the task counts as a catch: miss (m), angle (rad); matched: relative speed (m/s).
pub const RULE: (f64, f64, f64) = (0.040, 30.0 * std::f64::consts::PI / 180.0, 2.0);

/// What kept a ball from being caught.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Cause {
    NeverBegun,
    /// A catch under way was given up.
    GivenUp,
    /// The ball touched a link or the cup before the time of the catch.
    TouchedBefore,
    /// The last forecast said that the ball would pass beside the cup: the arm could not follow in time.
    Motion,
    /// The last forecast said that the ball would enter the cup. The ball passed beside it.
    Estimate,
    /// The ball entered the cup as the rule asks, and bounced out.
    CameOut,
}

/// A throw whose ball was not caught.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Failure {
    /// Number of the throw, from 0.
    pub throw: usize,
    pub flight_s: f64,
    /// A place to catch it exists.
    pub place: bool,
    pub cause: Cause,
    /// The catcher's reason, if it declined.
    pub why: Option<String>,
    /// First decision to move: s after the planned release, predicted probability, standard deviation across the flight (m).
    pub begun: Option<(f64, f64, f64)>,
    /// Time of the catch last chosen, s after the planned release.
    pub catch_s: Option<f64>,
    /// Distance of the ball from the cup's axis by the last forecast, m.
    pub predicted_off_m: Option<f64>,
    /// Where the ball crossed the mouth plane: miss (m), angle (rad), speed (m/s).
    pub crossing: Option<(f64, f64, f64)>,
}

/// The decision that began the first motion of a catch.
pub fn first_begun(outcome: &Outcome) -> Option<&Logged> {
    outcome.log.iter().find(|logged| logged.decision == Decision::Begun)
}

/// Describes a throw that was not caught.
pub fn failure(throw: usize, aimed: &Aimed, place: bool, outcome: &Outcome) -> Failure {
    let release_s = outcome.planned_s.0;
    let begun = first_begun(outcome);
    let why = match outcome.reported {
        CatchOutcome::Declined(why) => Some(why.to_string()),
        _ => None,
    };
    Failure {
        throw,
        flight_s: aimed.flight_s,
        place,
        cause: cause(outcome, begun.is_some()),
        why,
        begun: begun.map(|logged| (logged.at_s - release_s, logged.probability, logged.sigma_m)),
        catch_s: outcome.choice.as_ref().map(|choice| choice.t_s - release_s),
        predicted_off_m: outcome.choice.as_ref().and(outcome.off_m),
        crossing: outcome.crossing.map(|c| (c.miss_m, c.angle_rad, c.speed_m_s)),
    }
}

fn cause(outcome: &Outcome, begun: bool) -> Cause {
    let Some(choice) = &outcome.choice else {
        return if begun { Cause::GivenUp } else { Cause::NeverBegun };
    };
    let touched = |event: &TwoArmEvent| {
        matches!(event, TwoArmEvent::HitCup { arm: 1, .. } | TwoArmEvent::HitLink { arm: 1, .. })
    };
    // The cup's wall is touched within some ms of the catch by a ball that is caught.
    if outcome.events.iter().any(|(t_s, event)| *t_s < choice.t_s - 0.01 && touched(event)) {
        return Cause::TouchedBefore;
    }
    if outcome.crossing.is_some_and(|c| c.miss_m <= RULE.0) {
        return Cause::CameOut;
    }
    if outcome.off_m.is_some_and(|off| off <= RULE.0) { Cause::Estimate } else { Cause::Motion }
}
