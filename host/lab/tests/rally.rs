//! One arm throws, the other catches: what the catcher reports against where the simulated ball lies.

use hil_sim::two_arms::TwoArmOptions;
use lab::rally::exchange::{Partners, RallyEnd};
use lab::rally::study::{Row, row};
use lab::rally::throws::{draw_throws, place_exists};
use operator::ball_catch::controller_arm::ControllerArm;
use operator::ball_catch::thrower::ThrowFault;
use operator::ball_catch::trial::{CatchOutcome, Pair, TrialFault, TrialOptions};
use planner::catch::Joints;
use planner::catch::draw::{Aimed, Window};

fn pair() -> Pair {
    Pair::new(TwoArmOptions::two_arms().unwrap()).unwrap()
}

fn throws(pair: &Pair, count: usize) -> Vec<Aimed> {
    let window = Window { flight_s: (0.6, 0.9), ..Window::default() };
    let throws = draw_throws(pair, &window, 4 * count, 5).unwrap();
    let options = TrialOptions::default();
    throws.into_iter().filter(|aimed| place_exists(pair, aimed, &options)).take(count).collect()
}

fn in_setting(pair: &Pair, throws: &[Aimed], options: &TrialOptions) -> Row {
    let row = row("", pair, throws, &|_| options.clone(), &[], 11);
    let wrong = (row.silent.len(), row.limit_passed.len(), row.refusals);
    assert_eq!(wrong, (0, 0, 0), "{row:?}");
    row
}

#[test]
fn throws_with_a_place_are_caught_by_eyes_and_by_plan_and_with_jerk_limits() {
    let pair = pair();
    let throws = throws(&pair, 8);
    for (cooperative, jerk) in [(false, false), (true, false), (true, true)] {
        let options = TrialOptions { cooperative, jerk, ..TrialOptions::default() };
        let row = in_setting(&pair, &throws, &options);
        assert!(row.caught.hits >= 7, "{cooperative} {jerk}: {row:?}");
        assert!(row.miss_mm.1 < 15.0, "{row:?}");
    }
}

/// Tracker, throw or a drive fail at any moment: whatever happens is reported, and no limit is passed.
#[test]
fn whatever_fails_is_caught_declined_or_reported() {
    let pair = pair();
    let throws = throws(&pair, 4);
    for (k, aimed) in throws.iter().enumerate() {
        let at_s = 0.15 * k as f64;
        for fault in [
            TrialFault::TrackerDead { at_s },
            TrialFault::FramesLost { probability: 0.3 },
            TrialFault::Bias { by_mm: 20.0 },
            TrialFault::FalseMarkers { count: 4 },
            TrialFault::DriveLost { at_s },
            TrialFault::Throw(ThrowFault::NotReleased),
            TrialFault::Throw(ThrowFault::Stops { before_s: 0.05 + at_s }),
        ] {
            for cooperative in [false, true] {
                let options = TrialOptions { cooperative, faults: vec![fault], ..TrialOptions::default() };
                let outcome = pair.run(aimed, &options, k as u64);
                assert!(outcome.reported_truly(), "{fault:?} {cooperative}: {:?}", outcome.reported);
                assert!(outcome.within_limits(false), "{fault:?}: {:?} {:?}", outcome.used, outcome.executed);
                if let TrialFault::Throw(_) = fault {
                    assert!(!outcome.caught);
                }
            }
        }
    }
}

#[test]
fn without_a_ball_an_uninformed_arm_stays_where_it_is() {
    let pair = pair();
    let options =
        TrialOptions { faults: vec![TrialFault::Throw(ThrowFault::NotReleased)], ..TrialOptions::default() };
    let outcome = pair.run(&throws(&pair, 1)[0], &options, 1);
    assert_eq!(outcome.reported, CatchOutcome::NothingThrown);
    assert!(outcome.trace.iter().all(|moment| (moment.q[1] - options.wait).amax() < 1e-3));
}

#[test]
fn the_same_seed_gives_the_same_trial_and_another_one_another() {
    let pair = pair();
    let aimed = &throws(&pair, 1)[0];
    let run = |seed| pair.run(aimed, &TrialOptions::default(), seed);
    assert_eq!(run(3).trace, run(3).trace);
    assert_ne!(run(3).trace, run(4).trace);
}

/// The catcher's arm is six simulated drives under the controller: end states go over the bus, and the plant is the arm that the
/// ball meets.
#[test]
fn an_arm_behind_its_controller_catches() {
    let pair = pair();
    let throws = throws(&pair, 3);
    let mut caught = 0;
    for (k, aimed) in throws.iter().enumerate() {
        let mut options = TrialOptions { cooperative: k == 0, ..TrialOptions::default() };
        // Message, two control periods and the lag of the drives.
        options.settings.actuation_s = ControllerArm::ACTUATION_S;
        let mut arm = ControllerArm::new(&options.wait).unwrap();
        let outcome = pair.run_on(aimed, &options, k as u64, &mut arm, |observe| observe());
        assert!(outcome.reported_truly(), "{:?} {:?}", outcome.reported, outcome.events);
        // The position loop of a drive overshoots a step of the acceleration.
        let executed = outcome.executed[1];
        let kept = executed.speed <= 1.0 && executed.acceleration <= 1.2 && !executed.left_range;
        assert!(kept, "{executed:?}");
        assert!(arm.answered.0 > 3, "{:?} {:?}", arm.answered, outcome.refusals);
        println!("{:?} {:?} {:?} {:?}", outcome.reported, outcome.crossing, arm.answered, outcome.refusals);
        caught += usize::from(outcome.caught);
    }
    assert!(caught >= 2, "{caught} of {}", throws.len());
}

#[test]
fn a_rally_goes_to_and_fro() {
    let partners = Partners::new(TwoArmOptions::two_arms().unwrap()).unwrap();
    let options = TrialOptions { cooperative: true, ..TrialOptions::default() };
    let rally = partners.play(4, &options, 2, |_, _| {});
    assert_eq!((&rally.end, rally.length()), (&RallyEnd::Complete, 4));
    assert_eq!(rally.exchanges.iter().map(|e| e.thrower).collect::<Vec<_>>(), [0, 1, 0, 1]);
    // The ball lies at the wall of the cup. It is thrown from there, and the tracker knows the place.
    for pair in rally.exchanges.windows(2) {
        let [lies_m, seen_m] = pair[0].outcome.lies_e_m.unwrap();
        assert_eq!(pair[1].gripped_e_m, [lies_m, seen_m]);
        assert!((lies_m - seen_m).norm() < 0.002, "{lies_m} {seen_m}");
    }
    assert!(rally.exchanges[1..].iter().any(|e| e.gripped_e_m[0].xy().norm() > 0.03));
}

/// On the wire the arms stand anywhere: both ways begin there, and the arm that finds none is named.
#[test]
fn both_arms_go_from_where_they_stand_to_the_run_up_and_to_the_waiting_pose() {
    let partners = Partners::new(TwoArmOptions::two_arms().unwrap()).unwrap();
    let options = TrialOptions { cooperative: true, ..TrialOptions::default() };
    let upright = Joints::from([0.0, -90.0, -90.0, 0.0, 0.0, 0.0].map(f64::to_radians));
    let plan = |k, q: &[Joints; 2]| partners.plan(k, q, partners.first_e_m(), &options, 1);
    for k in [0, 1] {
        let planned = plan(k, &[upright; 2]).unwrap();
        let ends = [planned.aimed.throw.start(), options.wait];
        for (way, end) in planned.ways.iter().zip(ends) {
            let way = way.as_ref().unwrap();
            assert!((way.start_rad() - upright).amax() < 1e-9 && (way.stop_rad() - end).amax() < 1e-9);
        }
        assert!(planned.transit_s() > 1.0, "three tenths of the limits: {}", planned.transit_s());
    }
    let mut outside = [upright; 2];
    outside[1][1] = 3.0;
    let refused = plan(0, &outside).unwrap_err();
    assert!(matches!(refused, RallyEnd::NoTransit { arm: 1, .. }), "{refused:?}");
    let [why, _] = refused.not_thrown().unwrap();
    assert!(why.contains("arm 2") && why.contains("joint 2"), "{why}");
}
