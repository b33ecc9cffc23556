//! Every fault of a throw and its catch, at many moments: the ball is caught, the throw is declined, or the failure is reported. Nothing
//! is reported that did not happen, no arm passes a limit, and the arms do not touch each other.
//!
//! The witness works from the places of the ball and of the joints alone: neither the words of the catcher nor those of the cell's
//! contact rules enter.

use hil_sim::two_arms::TwoArmOptions;
use lab::rally::degraded::degradations;
use lab::rally::throws::draw_throws;
use operator::ball_catch::thrower::ThrowFault;
use operator::ball_catch::trial::{CatchOutcome, Outcome, Pair, TrialFault, TrialOptions};
use planner::catch::Joints;
use planner::catch::draw::{Aimed, Window};
use rayon::prelude::*;

/// What the places say at the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    /// In the catcher's cup.
    InCup,
    /// In the thrower's hand: it never flew.
    InHand,
    /// Anywhere else.
    Elsewhere,
}

/// The ball in the last 100 ms of the trace, against the cup of the cell file at the last joints.
fn seen(pair: &Pair, outcome: &Outcome) -> Seen {
    let last = outcome.trace.last().unwrap();
    let cup = &pair.cell.cup;
    let arm = &pair.cell.arms[1];
    let x_we = arm.x_wb * arm.model.ee(&arm.model.fk(&last.q[1]));
    let ball_e = x_we.inverse_transform_point(&last.ball_m);
    let below_mouth = cup.mouth_from_ee_m - ball_e.z;
    let room = cup.shape.inner_radius_m - pair.cell.ball.radius_m + 0.002;
    let in_cup = below_mouth > 0.0 && below_mouth < cup.shape.depth_m && ball_e.x.hypot(ball_e.y) < room;
    let thrower = &pair.cell.arms[0];
    let held = thrower.x_wb.transform_point(&thrower.model.ball(&thrower.model.fk(&last.q[0])).pos);
    if in_cup {
        Seen::InCup
    } else if (held - last.ball_m).norm() < 1e-3 {
        Seen::InHand
    } else {
        Seen::Elsewhere
    }
}

/// Joint speeds from places 8 ms apart, as shares of the limit: largest of both arms.
fn speed(pair: &Pair, outcome: &Outcome) -> f64 {
    let mut most = 0.0_f64;
    for w in outcome.trace.windows(2) {
        let h = w[1].t_s - w[0].t_s;
        for (arm, place) in pair.cell.arms.iter().enumerate() {
            let by: Joints = (w[1].q[arm] - w[0].q[arm]) / h;
            for (i, joint) in place.model.joints().iter().enumerate() {
                most = most.max(by[i].abs() / joint.limits.v_max_rad_s);
            }
        }
    }
    most
}

#[derive(Debug, Default)]
struct Tally {
    caught: usize,
    declined: usize,
    reported: usize,
    silent: Vec<String>,
}

fn judge(name: &str, pair: &Pair, outcome: &Outcome, tally: &mut Tally) {
    let seen = seen(pair, outcome);
    let truth = match outcome.reported {
        CatchOutcome::Caught => seen == Seen::InCup,
        CatchOutcome::Missed | CatchOutcome::Declined(_) | CatchOutcome::NothingThrown => seen != Seen::InCup,
        // Told: not known.
        CatchOutcome::Unknown | CatchOutcome::Halted => true,
    };
    match outcome.reported {
        CatchOutcome::Caught => tally.caught += 1,
        CatchOutcome::Declined(_) | CatchOutcome::NothingThrown => tally.declined += 1,
        _ => tally.reported += 1,
    }
    let speed = speed(pair, outcome);
    let kept = speed <= 1.0 && outcome.within_limits(false);
    if !truth || !kept || outcome.caught != (seen == Seen::InCup) {
        tally.silent.push(format!(
            "{name}: reported {:?}, seen {seen:?}, speed {speed:.3}, {:?} {}",
            outcome.reported, outcome.executed, outcome.arms_touched
        ));
    }
}

fn throws(pair: &Pair, count: usize) -> Vec<Aimed> {
    draw_throws(pair, &Window::high(), count, 7).unwrap()
}

fn run_all(
    name: &str,
    pair: &Pair,
    throws: &[Aimed],
    options: &(impl Fn(usize) -> TrialOptions + Sync),
) -> Tally {
    let run = |(k, aimed): (usize, &Aimed)| pair.run(aimed, &options(k), 70 + k as u64);
    let outcomes: Vec<Outcome> = throws.par_iter().enumerate().map(run).collect();
    let mut tally = Tally::default();
    for outcome in &outcomes {
        judge(name, pair, outcome, &mut tally);
    }
    println!(
        "{name:48} caught {:2} declined {:2} reported {:2} silent {}",
        tally.caught,
        tally.declined,
        tally.reported,
        tally.silent.len()
    );
    assert!(tally.silent.is_empty(), "{:#?}", tally.silent);
    tally
}

#[test]
#[ignore = "6 s: run by the stage long of CI"]
fn every_fault_ends_caught_declined_or_reported_and_none_silently() {
    let cell = TwoArmOptions::two_arms().unwrap();
    let throws = throws(&Pair::new(cell.clone()).unwrap(), 10);
    for (name, cell, options) in degradations(&cell) {
        let pair = Pair::new(cell).unwrap();
        let tally = run_all(name, &pair, &throws, &options);
        match name {
            // The matrix can see a difference: without a fault most are caught, without a ball none.
            "nothing" => assert!(tally.caught >= 6, "{tally:?}"),
            _ if name.contains("not released") || name.contains("stops") => assert_eq!(tally.caught, 0),
            _ => {}
        }
    }
}

/// Tracker, drive and thrower fail at moments 60 ms apart over the whole of one throw, with and without its plan.
#[test]
fn a_fault_at_any_moment_of_a_throw_is_not_silent() {
    let pair = Pair::new(TwoArmOptions::two_arms().unwrap()).unwrap();
    let throws = throws(&pair, 2);
    let moments: Vec<f64> = (0..20).map(|k| -0.25 + 0.06 * f64::from(k)).collect();
    let repeated: Vec<Aimed> = moments.iter().map(|_| throws[0]).collect();
    for cooperative in [false, true] {
        let with =
            |fault: TrialFault| TrialOptions { faults: vec![fault], cooperative, ..TrialOptions::default() };
        let dead = |k: usize| with(TrialFault::TrackerDead { at_s: moments[k] });
        run_all(&format!("tracker dead, plan known {cooperative}"), &pair, &repeated, &dead);
        let lost = |k: usize| with(TrialFault::DriveLost { at_s: moments[k] });
        run_all(&format!("drive lost, plan known {cooperative}"), &pair, &repeated, &lost);
        let stops = |k: usize| with(TrialFault::Throw(ThrowFault::Stops { before_s: 0.02 * (k + 1) as f64 }));
        let tally = run_all(&format!("thrower stops, plan known {cooperative}"), &pair, &repeated, &stops);
        assert_eq!(tally.caught, 0);
    }
}
