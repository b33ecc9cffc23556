//! A ball and a cup that bounce: what the arm predicts against where the simulated ball lies in the end.

use hil_sim::two_arms::TwoArmOptions;
use lab::rally::study::{Row, row};
use lab::rally::throws::draw_throws;
use operator::ball_catch::trial::{Pair, TrialOptions, WAIT_HOLD_DEG, WAIT_MATCHED_DEG};
use planner::catch::Joints;
use planner::catch::draw::Window;
use planner::catch::task::{Allowed, Decline, Settings};

const THROWS: usize = 16;

/// The throws with a cup of this restitution; `believed` is what the arm counts on, if that is something else.
fn caught(restitution: f64, allowed: Allowed, believed: Option<f64>) -> Row {
    let mut cell = TwoArmOptions::two_arms().unwrap();
    cell.cup.surface.restitution = restitution;
    let pair = Pair::new(cell).unwrap();
    let window = Window { flight_s: (0.6, 0.9), ..Window::default() };
    let throws = draw_throws(&pair, &window, THROWS, 5).unwrap();
    let wait = if allowed == Allowed::Hold { WAIT_HOLD_DEG } else { WAIT_MATCHED_DEG };
    let options = TrialOptions {
        settings: Settings { allowed, ..Settings::default() },
        wait: Joints::from(wait.map(f64::to_radians)),
        restitution: believed,
        ..TrialOptions::default()
    };
    let row = row("", &pair, &throws, &|_| options.clone(), &[], 3);
    assert!(row.silent.is_empty() && row.limit_passed.is_empty(), "{row:?}");
    println!("{restitution} {allowed:?}: {:?} begun, predicted {:.2}", row.begun, row.predicted);
    row
}

/// At rest the hand keeps a ball on foam; on rubber it declines, and says why.
#[test]
fn a_hand_at_rest_catches_what_stays_and_declines_what_would_bounce_out() {
    let foam = caught(0.15, Allowed::Hold, None);
    assert!(foam.begun.hits >= THROWS - 2 && foam.predicted > 0.9, "{foam:?}");
    let rubber = caught(0.75, Allowed::Hold, None);
    let bounces = Decline::BouncesOut.to_string();
    let declined = rubber.reasons.iter().find(|(why, _)| *why == bounces).map_or(0, |(_, n)| *n);
    assert!(declined >= THROWS - 4, "{:?}", rubber.reasons);
    assert!(rubber.caught.hits <= 1, "{rubber:?}");
}

/// The arm that may choose moves with the ball where a hand at rest would lose it.
#[test]
fn a_hand_that_moves_with_the_ball_is_chosen_where_one_at_rest_would_lose_it() {
    let row = caught(0.65, Allowed::Either, None);
    assert!(row.begun.of >= THROWS / 2, "{row:?}");
    assert!(row.begun.hits * 10 >= row.begun.of * 9 && row.predicted > 0.8, "{row:?}");
}

/// An arm that knows the cup is right about it; one that counts on a cup without bounce is not, and loses most of what it is sure of.
#[test]
fn predictions_are_right_for_the_cup_that_is_there_and_wrong_for_one_that_is_not() {
    let known = caught(0.5, Allowed::Hold, None);
    assert!((known.predicted - known.begun.value()).abs() < 0.3, "{known:?}");
    assert!(known.last_decision.1 < 0.2, "{known:?}");
    let wrong = caught(0.5, Allowed::Hold, Some(0.0));
    assert!(wrong.begun.of >= THROWS - 4 && wrong.predicted > 0.9, "{wrong:?}");
    assert!(wrong.begun.value() < 0.5 && wrong.last_decision.1 > 0.4, "{wrong:?}");
}
