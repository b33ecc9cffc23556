//! The report about the ball, from the telegrams alone. Judged by the simulated robot's ball.

use crate::rsi_common::{TARGET, arm, error_m, performed, scenario, thrown};
use hil_sim::krc::{Direction, KrcScenario, LinkFault, LinkFaultKind};
use operator::job::Outcome;
use operator::job::follow::{Ball, GripperKnown, measured, of_ball};
use operator::rsi::cell::Seen;
use operator::rsi::cycles::{Cycle, cycles, is_set, last_outputs};
use operator::rsi::log::{Entry, Line};
use operator::rsi::station::{Stage, Station};
use protocol::Duration;

const PERIOD_S: f64 = 0.012;

/// A robot that takes any step of its set points.
fn unlimited(scenario: &KrcScenario) -> KrcScenario {
    let mut scenario = scenario.clone();
    scenario.options.cut_out.acceleration_deg_s2 = [1e9; 6];
    scenario.options.cut_out.jerk_deg_s3 = [1e12; 6];
    scenario.options.cut_out.velocity_deg_s = Some([1e6; 6]);
    scenario
}

/// A throw of such a robot, and its log.
fn thrown_with(scenario: &KrcScenario) -> (Seen, Station, Vec<Line>) {
    let (seen, mut station) = thrown(&unlimited(scenario));
    let lines = station.take_log();
    (seen, station, lines)
}

fn table(lines: &[Line], scenario: &KrcScenario) -> Vec<Cycle> {
    cycles(lines, &scenario.config, "DiO", Some("GripOpen"))
}

fn known(scenario: &KrcScenario, lines: &[Line]) -> GripperKnown {
    let gripper = &scenario.options.hand.gripper;
    GripperKnown {
        output_bit: 0,
        delay_s: gripper.delay.as_secs_f64(),
        jitter_s: gripper.jitter.as_secs_f64(),
        last_outputs: last_outputs(lines, "DiO"),
    }
}

fn concluded(table: &[Cycle], scenario: &KrcScenario, lines: &[Line]) -> Ball {
    measured(&arm(), table, PERIOD_S, &known(scenario, lines), &TARGET)
}

fn predicted_m(outcome: Ball) -> f64 {
    let Ball::Predicted(error_m) = outcome else { panic!("{outcome:?}") };
    error_m
}

/// Telegrams with an answer, in order: their places in the log.
fn places(lines: &[Line]) -> Vec<usize> {
    (0..lines.len()).filter(|k| matches!(lines[*k].entry, Entry::Telegram(_))).collect()
}

#[test]
fn telegram_that_is_missing_in_the_log_moves_no_predicted_landing() {
    let scenario = scenario(1);
    let (seen, _, lines) = thrown_with(&scenario);
    let whole = table(&lines, &scenario);
    let truth = predicted_m(concluded(&whole, &scenario, &lines));
    assert!((truth - error_m(&seen).expect("a landing")).abs() < 5e-3, "{truth}");
    let opened = whole.iter().position(|cycle| is_set(cycle.outputs, 0)).expect("opens");
    let places = places(&lines);
    let first = places.len() - whole.len();
    for away in -6_i64..=6 {
        if away == 0 {
            continue;
        }
        let place = places[first + opened.strict_add_signed(away as isize)];
        let mut without = lines.clone();
        without.remove(place);
        let error = predicted_m(concluded(&table(&without, &scenario), &scenario, &without));
        assert!((error - truth).abs() < 3e-3, "{away} cycles from the release: {error} instead of {truth}");
    }
}

#[test]
fn answer_lost_around_the_release_is_predicted_as_the_ball_lands_or_not_known() {
    let nominal = scenario(1);
    let (_, _, lines) = thrown_with(&nominal);
    let whole = table(&lines, &nominal);
    let opened = whole.iter().position(|cycle| is_set(cycle.outputs, 0)).expect("opens");
    let (mut judged, mut unknown) = (0, 0);
    for away in -8_i64..=4 {
        let mut scenario = nominal.clone();
        let from = whole[opened.strict_add_signed(away as isize)].at;
        let until = from + Duration::from_millis(12);
        let (kind, direction) = (LinkFaultKind::Lost, Direction::ToRobot);
        scenario.link_faults = vec![LinkFault { kind, direction, from, until, probability: 1.0 }];
        let (seen, station, lines) = thrown_with(&scenario);
        assert_eq!(seen.late, 1);
        let (Some(truth), Stage::Finished { .. }) = (error_m(&seen), station.stage()) else {
            assert!(seen.released.is_none() || !matches!(station.stage(), Stage::Finished { .. }));
            continue;
        };
        let error = match concluded(&table(&lines, &scenario), &scenario, &lines) {
            Ball::Predicted(error_m) => error_m,
            // The axes leap in the cycle of the release: the telegrams do not show when.
            Ball::Unknown(_) => {
                println!("{away}: {:.1} mm, not known", 1e3 * truth);
                unknown += 1;
                continue;
            }
            other => panic!("{away}: {other:?}"),
        };
        judged += 1;
        println!("{away}: {:.1} mm, predicted {:.1} mm", 1e3 * truth, 1e3 * error);
        assert!((error - truth).abs() < 0.003, "{away}: {error}, true {truth}");
    }
    assert!(judged >= 8 && unknown <= 1, "{judged} {unknown}");
}

#[test]
fn ball_is_kept_when_an_answer_lost_before_has_led_the_axes_off_their_path() {
    let nominal = scenario(1);
    let (seen, _, _) = thrown_with(&nominal);
    let (released, _) = seen.released.expect("released");
    let mut scenario = nominal.clone();
    let from = released.saturating_sub(Duration::from_millis(360));
    let until = from + Duration::from_millis(12);
    let (kind, direction) = (LinkFaultKind::Lost, Direction::ToRobot);
    scenario.link_faults = vec![LinkFault { kind, direction, from, until, probability: 1.0 }];
    let record = performed(&unlimited(&scenario)).0;
    let seen = record.led.as_ref().and_then(|led| led.seen.as_ref()).expect("simulated");
    assert!(seen.released.is_none(), "{:?}", error_m(seen));
    println!("{}", record.verdict.text);
    if record.ended.is_none() {
        assert_eq!(record.verdict.outcome, Outcome::NotReleased);
        assert!(record.verdict.text.contains("off their path"), "{}", record.verdict.text);
    }
}

#[test]
fn telegrams_that_end_after_the_answer_to_open_leave_the_ball_unknown() {
    let scenario = scenario(1);
    let (_, _, mut lines) = thrown_with(&scenario);
    let opens = |line: &Line| match &line.entry {
        Entry::Answer(bytes) => String::from_utf8_lossy(bytes).contains("<DiO>1</DiO>"),
        _ => false,
    };
    let answer = lines.iter().position(opens).expect("opens");
    lines.truncate(answer + 1);
    let outcome = concluded(&table(&lines, &scenario), &scenario, &lines);
    assert!(matches!(outcome, Ball::Unknown(_)), "{outcome:?}");
    let (verdict, text) = of_ball(outcome, 0.035);
    assert!(!text.contains("in the hand") && verdict != Outcome::NotObserved, "{text}");
    // Before that answer the ball is in the hand.
    lines.truncate(answer);
    assert_eq!(concluded(&table(&lines, &scenario), &scenario, &lines), Ball::InHand);
    // Some cycles later the further motion of the hand is not known.
    let (_, _, mut lines) = thrown_with(&scenario);
    lines.truncate(answer + 6);
    let outcome = concluded(&table(&lines, &scenario), &scenario, &lines);
    assert!(matches!(outcome, Ball::Unknown(_)), "{outcome:?}");
}

#[test]
fn finger_sensor_that_contradicts_the_order_to_open_is_reported_as_that() {
    let scenario = scenario(1);
    let (_, _, lines) = thrown_with(&scenario);
    let whole = table(&lines, &scenario);
    let opened = whole.iter().position(|cycle| is_set(cycle.outputs, 0)).expect("opens");
    let with = |sensor: &dyn Fn(usize) -> bool| {
        let mut table = whole.clone();
        for (k, cycle) in table.iter_mut().enumerate() {
            cycle.fingers_open = Some(sensor(k));
        }
        concluded(&table, &scenario, &lines)
    };
    let truth = predicted_m(with(&|k| k >= opened + 3));
    assert!(truth < 0.01);
    assert_eq!(with(&|_| false), Ball::FingersClosed);
    assert_eq!(with(&|_| true), Ball::FingersOpenBefore);
    let late = with(&|k| k >= opened + 3 + 11);
    let Ball::PredictedLate(error_m, late_s) = late else { panic!("{late:?}") };
    // The hand follows the flight for 0.4 s, so the ball is still on its way to the target.
    assert!(error_m < 0.01 && (0.11..0.16).contains(&late_s), "{error_m} {late_s}");
    let outcome = |ball| of_ball(ball, 0.035).0;
    assert_eq!(outcome(Ball::FingersClosed), Outcome::NotReleased);
    assert_eq!(outcome(Ball::FingersOpenBefore), Outcome::Missed);
    let (_, text) = of_ball(late, 0.035);
    assert!(text.contains("open 142 ms later than described"), "{text}");
    assert_eq!(outcome(Ball::PredictedLate(0.2, late_s)), Outcome::Missed);
}
