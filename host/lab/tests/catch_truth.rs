//! What a catch reports and what it does, case by case. The cell observes it: places of the ball and contacts, which neither planner
//! nor estimator can see.

use hil_sim::two_arms::{TwoArmEvent, TwoArmOptions};
use lab::rally::throws::draw_throws;
use nalgebra::Vector3;
use operator::ball_catch::trial::{CatchOutcome, Outcome, Pair, Touch, TrialOptions, WAIT_MATCHED_DEG};
use planner::catch::Joints;
use planner::catch::draw::{Aimed, Window, draw};
use planner::catch::online::Decision;
use planner::catch::task::{Allowed, Decline, Settings};
use planner::flight::FlightModel;
use planner::plan::rng::SplitMix64;

fn pair() -> Pair {
    Pair::new(TwoArmOptions::two_arms().unwrap()).unwrap()
}

/// A ball that passes `at` (world, m) with `v` (m/s), `before_s` after its release.
fn ball_through(pair: &Pair, at: Vector3<f64>, v: Vector3<f64>, before_s: f64) -> Aimed {
    let g = Vector3::new(0.0, 0.0, -9.81);
    pair.ball(at - v * before_s + g * (0.5 * before_s * before_s), v - g * before_s)
}

/// Middle of the cup at rest and its axis, in the world.
fn cup(pair: &Pair, options: &TrialOptions) -> (Vector3<f64>, Vector3<f64>) {
    let (mouth, axis, _) = pair.catcher(false).mouth(&options.wait, &Joints::zeros(6));
    (mouth, axis)
}

/// No catch is possible in the time left; the ball falls into the cup that waits.
#[test]
fn a_ball_that_falls_into_the_waiting_cup_after_a_decline_is_reported_as_caught() {
    let mut cell = TwoArmOptions::two_arms().unwrap();
    cell.ball.drag_1_m = 0.0;
    let pair = Pair::new(cell).unwrap();
    let settings = Settings { keep_clear: false, probability_min: 1.1, ..Settings::default() };
    let options = TrialOptions { settings, ..TrialOptions::default() };
    let (mouth, axis) = cup(&pair, &options);
    let aimed = ball_through(&pair, mouth, -axis * 2.0 + Vector3::new(0.0, 0.0, -0.5), 0.35);
    let outcome = pair.run(&aimed, &options, 3);
    assert!(outcome.caught, "{:?}", outcome.events);
    assert!(
        outcome.choice.is_none() && outcome.log.iter().any(|l| matches!(l.decision, Decision::Declined(_)))
    );
    assert_eq!(outcome.reported, CatchOutcome::Caught);
}

/// A ball in a smooth cup rolls for longer than a trial lasts after its last motion: seen in 4 of 2 000 throws of a study, reported as missed.
#[test]
fn a_ball_that_rolls_in_the_cup_for_long_is_watched_until_it_rests_and_never_reported_as_missed() {
    let mut rested_late = 0;
    for (rolling, seed) in [(0.0, 1), (0.004, 2), (0.01, 3), (0.02, 4), (0.05, 5)] {
        let mut cell = TwoArmOptions::two_arms().unwrap();
        cell.ball.drag_1_m = 0.0;
        (cell.cup.surface.rolling, cell.cup.surface.friction) = (rolling, 0.05);
        cell.cup.surface.restitution = 0.4;
        let pair = Pair::new(cell).unwrap();
        let settings = Settings { keep_clear: false, probability_min: 1.1, ..Settings::default() };
        let options = TrialOptions { settings, ..TrialOptions::default() };
        let (mouth, axis) = cup(&pair, &options);
        let arrival_s = 0.35;
        let aimed = ball_through(&pair, mouth, -axis * 1.2 + Vector3::new(0.0, 0.5, -0.5), arrival_s);
        let aimed = Aimed { flight_s: arrival_s, ..aimed };
        let outcome = pair.run(&aimed, &options, seed);
        let rests = outcome.events.iter().find(|(_, event)| *event == TwoArmEvent::Rests { arm: 1 });
        println!("rolling {rolling}: reported {:?}, caught {}, {rests:?}", outcome.reported, outcome.caught);
        assert_eq!(outcome.reported, CatchOutcome::Caught, "rolling {rolling}");
        assert!(outcome.caught, "rolling {rolling}");
        // The last 0.3 s of one second after the arrival is what a catcher that waits no longer looks at.
        rested_late +=
            usize::from(rests.is_some_and(|(at_s, _)| *at_s > outcome.planned_s.0 + arrival_s + 0.7));
    }
    assert!(rested_late > 0, "every ball rested soon");
}

/// A cup that looks 6 degrees down holds a ball for half a second; the trial ends at several times after that. Seen in 2 of 10 000 throws
/// of a study, reported as caught.
#[test]
fn a_ball_that_has_just_fallen_out_of_the_cup_is_not_reported_as_caught() {
    let mut cell = TwoArmOptions::two_arms().unwrap();
    cell.ball.drag_1_m = 0.0;
    let pair = Pair::new(cell).unwrap();
    let settings = Settings { keep_clear: false, probability_min: 1.1, ..Settings::default() };
    let level = TrialOptions { settings, ..TrialOptions::default() };
    let turned = |turn: f64| level.wait + Joints::from([0.0, 0.0, 0.0, 0.0, turn, 0.0]);
    let below = |turn: f64| (pair.catcher(false).mouth(&turned(turn), &Joints::zeros(6)).1.z + 0.099).abs();
    let turns = (0..800).map(|k| 0.004 * f64::from(k) - 1.6);
    let turn = turns.min_by(|a, b| below(*a).total_cmp(&below(*b))).unwrap();
    let options = TrialOptions { wait: turned(turn), ..level };
    let (mouth, axis) = cup(&pair, &options);
    let mut fell_late = 0;
    for flight_s in [0.01, 0.04, 0.07, 0.1, 0.13] {
        let aimed = ball_through(&pair, mouth, -axis * 1.5, 0.35);
        // The trial ends one second after this.
        let outcome = pair.run(&Aimed { flight_s, ..aimed }, &options, 1);
        let end_s = outcome.trace.last().unwrap().t_s;
        let fell = outcome.events.iter().find(|(_, event)| *event == TwoArmEvent::FellOut { arm: 1 });
        println!("reported {:?}, caught {}, {fell:?}, end {end_s}", outcome.reported, outcome.caught);
        assert!(outcome.reported_truly(), "{:?}", outcome.reported);
        fell_late += usize::from(fell.is_some_and(|(at_s, _)| *at_s > end_s - 0.25));
    }
    assert!(fell_late > 0, "no ball fell out late");
}

/// The hand comes from the side and moves with the ball: its cup must not be swept through the flight before the catch.
#[test]
fn a_hand_that_moves_with_the_ball_does_not_hit_it_with_the_outside_of_its_cup() {
    let pair = pair();
    let throws = draw_throws(&pair, &Window::high(), 36, 1).unwrap();
    let options = TrialOptions {
        settings: Settings { allowed: Allowed::Matched, ..Settings::default() },
        wait: Joints::from(WAIT_MATCHED_DEG.map(f64::to_radians)),
        cooperative: true,
        ..TrialOptions::default()
    };
    let mut tried = 0;
    for (k, aimed) in throws.iter().enumerate() {
        let outcome = pair.run(aimed, &options, 1 + k as u64);
        let Some(choice) = &outcome.choice else { continue };
        tried += 1;
        let early = outcome.events.iter().find(|(t_s, event)| {
            *t_s < choice.t_s - 0.01 && matches!(event, TwoArmEvent::HitCup { arm: 1, .. })
        });
        assert!(early.is_none(), "throw {k}: {early:?}, catch at {:.3}", choice.t_s);
    }
    assert!(tried > 20, "{tried}");
}

/// Begun on a vague forecast, these catches cannot be corrected when the ball is seen better: the hand would stand 70 to 130 mm beside
/// the flight.
#[test]
fn a_catch_that_has_become_hopeless_is_given_up_and_reported() {
    let pair = pair();
    let [thrower, catcher] = &pair.cell.arms;
    let flight = FlightModel::vacuum(9.81).unwrap().with_drag(pair.cell.ball.drag_1_m).unwrap();
    for (cooperative, k) in [(false, 73), (true, 28), (true, 34), (true, 94)] {
        let from_s = if cooperative { 0.55 } else { 0.4 };
        let window = Window { flight_s: (from_s, 0.9), ..Window::default() };
        let mut rng = SplitMix64::stream(2, k);
        let (a, b) = (&thrower.x_wb, &catcher.x_wb);
        let aimed = draw(&thrower.model, a, b, &flight, &window, &mut rng, 3_000_000).unwrap();
        let options = TrialOptions {
            settings: Settings { allowed: Allowed::Matched, ..Settings::default() },
            wait: Joints::from(WAIT_MATCHED_DEG.map(f64::to_radians)),
            cooperative,
            ..TrialOptions::default()
        };
        let outcome = pair.run(&aimed, &options, 2 + k);
        println!("{k}: {:?} caught {} {:?}", outcome.reported, outcome.caught, outcome.crossing);
        assert!(outcome.reported_truly() && outcome.within_limits(false), "{k}: {:?}", outcome.reported);
        assert!(outcome.caught || outcome.choice.is_none(), "{k}: {:?}", outcome.crossing);
    }
}

fn at_the_forearm(keep_clear: bool, seed: u64) -> Outcome {
    let mut cell = TwoArmOptions::two_arms().unwrap();
    cell.ball.drag_1_m = 0.0;
    let pair = Pair::new(cell).unwrap();
    // The hand would have to be as fast as the ball: no arm is.
    let settings =
        Settings { keep_clear, allowed: Allowed::Matched, relative_m_s: 0.0, ..Settings::default() };
    let options = TrialOptions { settings, ..TrialOptions::default() };
    let arm = pair.catcher(false);
    let forearm = arm.model().collision().boxes().iter().position(|b| b.name == "forearm tube").unwrap();
    let at = arm.boxes(&options.wait)[forearm].pose.pos;
    let side = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
    let across = Vector3::new(0.8, side * (0.45 + 0.05 * seed as f64), -0.25).normalize();
    pair.run(&ball_through(&pair, at, across * 5.0, 0.5), &options, seed)
}

/// The same balls hit an arm that stays where it is.
#[test]
fn a_ball_that_is_declined_does_not_touch_the_arm() {
    let mut hit = 0;
    for seed in 0..6 {
        let stays = at_the_forearm(false, seed);
        let moves = at_the_forearm(true, seed);
        println!(
            "{seed}: {:?} {:?} / {:?} {:?}",
            stays.reported,
            stays.first_touch(),
            moves.reported,
            moves.first_touch()
        );
        assert!(matches!(moves.reported, CatchOutcome::Declined(_)), "{:?}", moves.reported);
        assert!(moves.log.iter().any(|l| matches!(l.decision, Decision::MovedClear(_))), "{seed}");
        assert_eq!(moves.first_touch(), None, "{seed}: {:?}", moves.events);
        assert!(moves.within_limits(false), "{:?} {:?}", moves.used, moves.executed);
        hit += usize::from(stays.first_touch() == Some(Touch::Moving));
    }
    assert!(hit >= 4, "{hit} of 6 balls hit an arm that stays");
}

/// Two metres apart, the arms could touch each other.
#[test]
fn arms_near_each_other_keep_apart_and_one_in_the_way_is_a_reason_to_decline() {
    let mut cell = TwoArmOptions::two_arms().unwrap();
    cell.arms[1].x_wb.pos.x = 1.5;
    let near = Pair::new(cell).unwrap();
    // Over the thrower's shoulder: within reach of the catcher, and within that of the thrower. A ball that goes less far to the side
    // rises where the hand would be, and hits it.
    let at = Vector3::new(0.75, 0.0, 0.55);
    let aimed = ball_through(&near, at, Vector3::new(0.5, 0.0, -2.0), 0.7);
    let options = TrialOptions::default();
    let outcome = near.run(&aimed, &options, 1);
    assert!(!outcome.arms_touched);
    let reasons: Vec<Decline> = outcome
        .log
        .iter()
        .filter_map(|l| match l.decision {
            Decision::Declined(why) | Decision::MovedClear(why) | Decision::GivenUp(why) => Some(why),
            _ => None,
        })
        .collect();
    assert!(
        outcome.choice.is_none() && reasons.contains(&Decline::Contact),
        "{reasons:?} {:?}",
        outcome.choice
    );
}
