//! Sequences of orders and faults that nobody thought of, against the controller with its host link and simulated drives.
//!
//! `steps` says what can happen and draws it, `lab` puts the controller on a bus, `judge` applies the `rules`, `shrink` makes a
//! sequence that breaks a rule short enough to read. What it prints can be pasted below as a test.
//!
//! `SEEDS=0..4000 cargo test --release -p sequences -- --ignored --nocapture` for more; a seed is a sequence of 60 steps.

mod families;
mod judge;
mod lab;
mod play;
mod rules;
mod shrink;
mod steps;

use std::collections::BTreeMap;

use rayon::prelude::*;

use families::{CyclicServos, Family, InterpolatingServos};
use firmware::groups::mit::Mit;
use firmware::groups::odrive::Odrive;
use firmware::groups::powercube::PowerCubes;
use play::play;
use rules::{Rule, Taken};
use steps::{Act, Hand, Step, Who};

/// Steps of one sequence.
const STEPS: usize = 60;

/// Plays all seeds: how much happened, and the shortest sequence for each rule that is broken, as code.
fn broken<F: Family>(seeds: std::ops::Range<u64>) -> (Taken, Vec<String>) {
    let played: Vec<(u64, Vec<Rule>, Taken)> = seeds
        .into_par_iter()
        .map(|seed| {
            let (start, steps) = steps::draw(seed, STEPS);
            let (found, taken) = play::<F>(start, seed, &steps);
            let mut rules: Vec<Rule> = found.iter().map(|found| found.rule).collect();
            rules.sort_unstable();
            rules.dedup();
            (seed, rules, taken)
        })
        .collect();
    let mut of_rule: BTreeMap<Rule, Vec<u64>> = BTreeMap::new();
    let mut all = Taken::default();
    for (seed, rules, taken) in played {
        all += taken;
        for rule in rules {
            of_rule.entry(rule).or_default().push(seed);
        }
    }
    (all, of_rule.into_par_iter().map(|(rule, seeds)| shrink::shortest::<F>(rule, &seeds, STEPS)).collect())
}

/// Breaks no rule, and much happens.
fn check<F: Family>(share: u32, seeds: std::ops::Range<u64>) {
    let count = u32::try_from(seeds.end - seeds.start).expect("fewer seeds");
    let (taken, broken) = broken::<F>(seeds);
    println!("{count} sequences of {STEPS} steps: {taken:?}");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
    let Taken { homings, jogs, commits, armings, runs, clears, stops_in_motion } = taken;
    for often in [homings, jogs, commits, armings, runs, clears, stops_in_motion] {
        assert!(often >= count / share, "too little happens to show anything: {taken:?}");
    }
}

fn keeps(start_mrad: [i16; lab::JOINTS], seed: u64, steps: &[Step]) -> Taken {
    keeps_with::<PowerCubes>(start_mrad, seed, steps)
}

fn keeps_with<F: Family>(start_mrad: [i16; lab::JOINTS], seed: u64, steps: &[Step]) -> Taken {
    let (found, taken) = play::<F>(start_mrad, seed, steps);
    assert!(found.is_empty(), "{found:#?}");
    taken
}

#[test]
fn run_that_is_held_up_over_its_start_does_not_begin_in_mid_plan() {
    let plan = Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::Nothing };
    let mut steps = vec![
        (0, plan),
        (40, Act::Commit),
        (40, Act::Prepare),
        (60, Act::Confirm),
        (60, Act::RunIn { ms: 118 }),
    ];
    let with_run = |late: Step| {
        let mut steps = steps.clone();
        steps.push(late);
        keeps([491, 621], 0, &steps)
    };
    for (wait, ms) in [(93, 42), (93, 80), (100, 42), (110, 60)] {
        assert_eq!(with_run((wait, Act::Late(ms))).armings, 1, "the run was ordered");
    }
    steps.push((1_500, Act::Wait));
    assert_eq!(keeps([491, 621], 0, &steps).runs, 1);
}

#[test]
fn jog_after_a_start_that_was_missed_is_no_late_run_and_may_halve_the_current() {
    let plan = Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::Nothing };
    let jogs = |start_mrad, seed, waits: [u16; 6], run_ms, late_ms, joint, mrad_s| {
        let acts = [
            plan,
            Act::Commit,
            Act::Prepare,
            Act::Confirm,
            Act::RunIn { ms: run_ms },
            Act::Late(late_ms),
            Act::Jog { joint, mrad_s, hold_ms: 115 },
        ];
        let steps: Vec<Step> = waits.into_iter().chain([51]).zip(acts).collect();
        assert_eq!(keeps(start_mrad, seed, &steps).jogs, 1);
    };
    jogs([-512, 57], 220, [0, 0, 0, 10, 0, 26], 82, 15, 0, 200);
    jogs([103, 572], 655, [8_566, 0, 43, 170, 46, 86], 120, 40, 1, -250);
}

/// An answer that was on its way when the drive was halted came late, and its halt was taken for an error: the stop became fault 200.
#[test]
fn stop_of_a_jog_is_no_error_of_its_drive_when_an_answer_is_late() {
    let steps = [
        (493, Act::Jog { joint: 1, mrad_s: 50, hold_ms: 198 }),
        (197, Act::EmergencyStop(Who::Host)),
        (10, Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::Nothing }),
    ];
    keeps([856, 443], 256, &steps);
}

#[test]
fn stop_of_a_jog_that_has_not_begun_moves_nothing() {
    // The drive has its brake closed: a command opens it, and the joint sags.
    keeps([1_175, 568], 2_107, &[(0, Act::Restart(1)), (0, Act::LetGo(1)), (706, Act::Stop(Who::Host))]);
}

#[test]
fn jog_outside_the_limits_that_turns_round_after_a_late_loop_goes_no_further_out() {
    let jog = |mrad_s, hold_ms| Act::Jog { joint: 0, mrad_s, hold_ms };
    let steps = [(0, jog(-120, 108)), (42, jog(-120, 108)), (93, Act::Late(50)), (21, jog(120, 176))];
    keeps([1_181, 428], 1_254, &steps);
}

#[test]
fn second_run_order_after_a_missed_start_begins_its_own_run() {
    let plan = Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::CloseAndOpen(313) };
    let arm = [(0, plan), (0, Act::Commit), (0, Act::Prepare), (9, Act::Confirm)];
    let run = [(0, Act::RunIn { ms: 111 }), (62, Act::Late(59)), (0, Act::Run)];
    keeps([183, 765], 810, &[&arm[..], &run[..]].concat());
}

#[test]
fn homing_that_is_stopped_as_it_begins_is_halted_until_its_rest_is_measured() {
    // The halt overtakes the order to home in the drive.
    let steps = [
        (26, Act::LetGo(1)),
        (25, Act::Stop(Who::Host)),
        (81, Act::Home(3)),
        (0, Act::EmergencyStop(Who::Host)),
        (10, Act::Jog { joint: 1, mrad_s: 50, hold_ms: 122 }),
        (0, Act::LetGo(1)),
    ];
    keeps([634, 862], 1_225, &steps);
}

#[test]
fn set_point_of_a_period_that_is_over_does_not_leave_after_a_late_loop() {
    let plan = Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::Open(32) };
    let arm = [(0, plan), (0, Act::Commit), (0, Act::Prepare), (8, Act::Confirm)];
    let run = [(0, Act::RunIn { ms: 40 }), (15, Act::Late(58)), (0, Act::Prepare)];
    keeps([104, 837], 7_790, &[&arm[..], &run[..]].concat());
}

#[test]
fn missed_start_leaves_drives_at_rest_that_have_set_points_of_the_wait() {
    let plan = Act::Upload { mrad: [100, 0], ms: 1_000, hand: Hand::Nothing };
    let arm = [(0, plan), (0, Act::Commit), (0, Act::Prepare), (8, Act::Confirm)];
    let run = [(0, Act::RunIn { ms: 60 }), (42, Act::Late(28)), (8_000, Act::Wait)];
    keeps([104, 837], 7_790, &[&arm[..], &run[..]].concat());
}

#[test]
fn jog_that_is_let_go_before_a_late_loop_does_not_come_back() {
    let jog = Act::Jog { joint: 0, mrad_s: 250, hold_ms: 186 };
    keeps([466, -420], 2_803, &[(0, jog), (58, Act::LetGo(0)), (2, Act::Late(5))]);
}

/// 10 000 steps.
#[test]
fn ten_thousand_drawn_steps_break_no_rule() {
    check::<PowerCubes>(2, 0..167);
}

/// Seeds of each family that follows positions: 10 000 steps.
fn seeds(usual: &str) -> std::ops::Range<u64> {
    let seeds = std::env::var("SEEDS").unwrap_or_else(|_| usual.to_owned());
    let (first, end) = seeds.split_once("..").expect("SEEDS=first..end");
    first.parse().expect("a number")..end.parse().expect("a number")
}

/// What a joint does by a later jog is not counted as the travel after the one that was stopped at once. Seed 86 with CANopen servos.
#[test]
fn jog_that_is_stopped_at_once_leaves_room_for_the_next_ones() {
    let next = Act::Jog { joint: 0, mrad_s: 200, hold_ms: 174 };
    let steps = [
        (0, Act::Clear { right: true }),
        (3, Act::Jog { joint: 0, mrad_s: 250, hold_ms: 240 }),
        (0, Act::Stop(Who::Host)),
        (89, next),
        (45, next),
        (70, Act::Prepare),
    ];
    assert_eq!(keeps_with::<CyclicServos>([1140, 96], 86, &steps).jogs, 3);
}

#[test]
fn drawn_steps_with_canopen_servos_break_no_rule() {
    check::<CyclicServos>(6, seeds("0..167"));
}

#[test]
fn drawn_steps_with_modules_that_interpolate_break_no_rule() {
    check::<InterpolatingServos>(6, seeds("0..167"));
}

#[test]
fn drawn_steps_with_mit_motors_break_no_rule() {
    check::<Mit>(6, seeds("0..167"));
}

#[test]
fn drawn_steps_with_odrives_break_no_rule() {
    check::<Odrive>(6, seeds("0..167"));
}

/// 1 000 000 steps.
#[test]
#[ignore = "minutes: run by night"]
fn a_million_drawn_steps_break_no_rule() {
    let seeds = std::env::var("SEEDS").unwrap_or_else(|_| "0..16667".to_owned());
    let (first, end) = seeds.split_once("..").expect("SEEDS=first..end");
    let (first, end) = (first.parse().expect("a number"), end.parse().expect("a number"));
    check::<PowerCubes>(2, first..end);
}
