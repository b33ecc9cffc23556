//! The search for a catch against an exhaustive one, and its limits.

use nalgebra::{Matrix3, Vector3};
use planner::catch::Joints;
use planner::catch::motion::used;
use planner::catch::online::{Catcher, Decision};
use planner::catch::search::search;
use planner::catch::task::{Allowed, Decline, Mode, Settings, Start};
use planner::motion_law::State;

use super::catch_rig::{Asked, WAIT_DEG, arm, exhaustive, forecast, found, refusals, throws};

/// A refusal for want of a posture or of time is right where the exhaustive search finds nothing either. What the search
/// misses between its grid points is counted.
#[test]
fn refusals_agree_with_an_exhaustive_search() {
    let arm = arm(false);
    let (mut refused, mut wrong, mut taken, mut beyond) = (0, 0, 0, 0);
    for (k, (p, v)) in throws(40, 3).into_iter().enumerate() {
        let forecast = forecast(p, v);
        let from_s = [0.0, 0.07, 0.15][k % 3];
        for (mode, allowed) in [(Mode::Hold, Allowed::Hold), (Mode::Matched, Allowed::Matched)] {
            let settings = Settings { allowed, ..Settings::default() };
            match found(&arm, &settings, from_s, &forecast) {
                Ok(_) => {
                    taken += 1;
                    beyond +=
                        usize::from(!exhaustive(&arm, &settings, mode, from_s, &forecast, Asked::Bound));
                }
                Err(
                    Decline::Contact
                    | Decline::CupDown
                    | Decline::BallFirst
                    | Decline::Current
                    | Decline::TooUncertain,
                ) => {}
                Err(_) => {
                    refused += 1;
                    wrong += usize::from(exhaustive(&arm, &settings, mode, from_s, &forecast, Asked::Motion));
                }
            }
        }
    }
    assert!(refused > 10 && taken > 20, "{refused} refused, {taken} taken");
    // A catch that the least peak acceleration forbids would be wrong by physics.
    assert_eq!(beyond, 0, "of {taken} catches taken");
    assert!(wrong * 20 <= refused, "{wrong} of {refused} refusals are wrong");
}

/// With the whole motion judged: contacts, currents and the ball against the arm as well. `--example catch_refusals` judges 200.
#[test]
fn refusals_of_whole_motions_agree_with_an_exhaustive_search() {
    let (refused, taken) = refusals(&arm(false), 30, 8);
    let wrong: Vec<_> = refused.iter().filter(|refusal| refusal.wrong).map(ToString::to_string).collect();
    assert!(refused.len() >= 15 && taken >= 5, "{} refused, {taken} taken", refused.len());
    assert!(wrong.len() * 10 <= refused.len(), "{wrong:?}");
}

#[test]
fn the_motion_found_meets_the_ball_and_keeps_every_limit() {
    for jerk in [false, true] {
        let arm = arm(jerk);
        let (mut taken, mut judged) = (0, 0);
        for (p, v) in throws(30, 4) {
            let forecast = forecast(p, v);
            let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
            let start = Start { at_s: 0.05, state: &state, under_way: None };
            let (found, count) = search(&arm, &Settings::default(), &start, &forecast);
            judged = judged.max(count.judged);
            let Ok(choice) = found else { continue };
            taken += 1;
            let (q, qd) = choice.motion.joints_at(choice.t_s);
            let (mouth, axis, hand) = arm.mouth(&q, &qd);
            let ball = forecast.at(choice.t_s).unwrap();
            assert!((mouth - ball.p_m).norm() < 1e-6, "{mouth} {}", ball.p_m);
            let relative = ball.v_m_s - hand;
            assert!((relative.norm() - choice.relative_m_s).abs() < 1e-6);
            assert!(-relative.dot(&axis) / relative.norm() > 30.0_f64.to_radians().cos());
            let [speed, acceleration, share_of_jerk] = used(&arm, &choice.motion);
            assert!(speed <= 0.95 + 1e-9 && acceleration <= 0.8 + 1e-9, "{speed} {acceleration}");
            assert!(!jerk || share_of_jerk <= 0.95 + 1e-6, "{share_of_jerk}");
            let (_, end) = choice.motion.joints_at(choice.motion.end_s());
            assert!(end.amax() < 1e-9, "{end}");
            assert_eq!(choice.motion.at(0.05).map(|s| s.q), state.map(|s| s.q));
        }
        assert!(taken >= 10, "{taken} of 30 taken");
        assert!(judged >= 5000, "{judged} candidates judged");
    }
}

#[test]
fn a_ball_far_away_or_too_uncertain_is_declined_with_the_reason() {
    let arm = arm(false);
    let away = forecast(Vector3::new(0.0, 3.0, 0.5), Vector3::new(0.0, 2.0, 3.0));
    assert_eq!(found(&arm, &Settings::default(), 0.0, &away), Err(Decline::OutOfReach));
    let (p, v) = throws(8, 5)
        .into_iter()
        .find(|(p, v)| found(&arm, &Settings::default(), 0.0, &forecast(*p, *v)).is_ok())
        .unwrap();
    let mut vague = forecast(p, v);
    for point in &mut vague.points {
        point.covariance_m2 = Matrix3::identity() * 4.0;
    }
    assert_eq!(found(&arm, &Settings::default(), 0.0, &vague), Err(Decline::TooUncertain));
    assert!(found(&arm, &Settings::default(), 0.9, &forecast(p, v)).is_err());
}

/// Without this rule the cup looks down at the end of some of these motions, and the ball rolls out.
#[test]
fn the_cup_looks_up_where_the_hand_stops() {
    let settings = Settings { allowed: Allowed::Matched, ..Settings::default() };
    for jerk in [false, true] {
        let arm = arm(jerk);
        let mut taken = 0;
        for (p, v) in throws(240, 9) {
            let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
            let start = Start { at_s: 0.05, state: &state, under_way: None };
            let Ok(choice) = search(&arm, &settings, &start, &forecast(p, v)).0 else { continue };
            taken += 1;
            let (q, qd) = choice.motion.joints_at(choice.motion.end_s());
            let up = arm.mouth(&q, &qd).1.z;
            assert!(up >= 0.17, "jerk {jerk}: {up}");
        }
        assert!(taken >= 20, "{taken}");
    }
}

/// A flight known to 30 mm: of a ball at the edge of the reach some flights are out of it.
#[test]
fn a_catch_at_the_edge_of_the_reach_is_reported_as_less_likely() {
    let (arm, sigma_m) = (arm(false), 0.03_f64);
    let settings = Settings { allowed: Allowed::Hold, ..Settings::default() };
    let (p, v) = throws(8, 5)
        .into_iter()
        .find(|(p, v)| found(&arm, &settings, 0.0, &forecast(*p, *v)).is_ok())
        .unwrap();
    let reported = |out_m: f64| {
        let away = {
            let d = p - arm.shoulder_m();
            Vector3::new(d.x, d.y, 0.0).normalize()
        };
        let mut vague = forecast(p + Vector3::new(-away.y, away.x, 0.0) * out_m, v);
        for point in &mut vague.points {
            point.covariance_m2 = Matrix3::identity() * (sigma_m * sigma_m);
        }
        let state = WAIT_DEG.map(|q| State::rest(q.to_radians()));
        let start = Start { at_s: 0.0, state: &state, under_way: None };
        search(&arm, &settings, &start, &vague).0.map_or(0.0, |choice| choice.probability)
    };
    let all: Vec<f64> = (-40..=40).map(|k| reported(0.03 * f64::from(k))).collect();
    assert!(all.iter().any(|p| *p > 0.99), "{all:?}");
    let between = all.iter().filter(|p| (0.1..0.95).contains(*p)).count();
    assert!(between >= 1, "{all:?}");
    assert!(all[0] == 0.0 && all[all.len() - 1] == 0.0, "{all:?}");
}

/// At the end of every flight no posture is in reach. What kept the arm from a catch is another thing.
#[test]
fn a_ball_that_was_too_fast_is_not_reported_as_out_of_reach_when_it_has_passed() {
    let arm = arm(false);
    let wait = Joints::from(WAIT_DEG.map(f64::to_radians));
    let settings =
        Settings { allowed: Allowed::Matched, relative_m_s: 0.1, keep_clear: false, ..Settings::default() };
    let mut fast = 0;
    for (p, v) in throws(20, 10) {
        let forecast = forecast(p, v);
        let mut catcher = Catcher::new(&arm, settings, &wait);
        for k in 0..100 {
            catcher.observe(&forecast, 0.01 * f64::from(k));
        }
        let said: Vec<Decision> = catcher.log().iter().map(|logged| logged.decision).collect();
        let last = said.iter().rev().find(|said| **said != Decision::Declined(Decline::OutOfReach));
        if said[0] != Decision::Declined(Decline::TooFast) || catcher.choice().is_some() {
            continue;
        }
        fast += usize::from(last != Some(&Decision::Declined(Decline::TooFast)));
        assert!(
            matches!(catcher.declined(), Some(Decline::TooFast | Decline::TooLate | Decline::NoStop)),
            "{:?}",
            catcher.declined()
        );
    }
    assert!(fast >= 3, "{fast}");
}

/// The forecast moves by 10 mm while the catch is under way: the motion follows without a jump, and meets the new place.
#[test]
fn a_forecast_that_moves_is_followed_without_a_jump() {
    let arm = arm(true);
    let wait = Joints::from(WAIT_DEG.map(f64::to_radians));
    let mut followed = 0;
    for (p, v) in throws(30, 6) {
        let mut catcher = Catcher::new(&arm, Settings::default(), &wait);
        if catcher.observe(&forecast(p, v), 0.0).is_none() {
            continue;
        }
        let before = catcher.motion().clone();
        let moved = forecast(p + Vector3::new(0.0, 0.01, 0.0), v);
        let Some(after) = catcher.observe(&moved, 0.1).cloned() else { continue };
        followed += 1;
        for (a, b) in before.at(after.start_s).iter().zip(&after.at(after.start_s)) {
            assert!((a.q - b.q).abs() < 1e-9 && (a.v - b.v).abs() < 1e-9 && (a.a - b.a).abs() < 1e-6);
        }
        let choice = catcher.choice().unwrap();
        let (q, qd) = after.joints_at(choice.t_s);
        assert!((arm.mouth(&q, &qd).0 - moved.at(choice.t_s).unwrap().p_m).norm() < 1e-6);
        assert_eq!(catcher.log().last().unwrap().decision, Decision::Corrected);
    }
    assert!(followed >= 5, "{followed}");
}
