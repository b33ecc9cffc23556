//! Lag and gripper of a robot that differs from its description, measured over the link. Compared with the
//! scenario, which only the simulated robot reads.

use crate::rsi_common::arm;
use hil_sim::krc::KrcScenario;
use operator::rsi::cell;
use operator::rsi::cycles::{Cycle, cycles};
use operator::rsi::identify::{Unclear, gripper, lag, wiggle, with_measured};
use operator::rsi::program::{Lag, NoStation, exploring};
use operator::rsi::station::{Stage, Station};
use planner::follow::limits::Axes;
use protocol::{Duration, Instant};

const PERIOD_S: f64 = 0.012;

/// True values of the robot: dead time, time constant, set points averaged, gripper delay and jitter, ms.
const TRUTHS: [(u64, u64, usize, u64, u64); 4] =
    [(96, 24, 1, 20, 10), (72, 40, 1, 35, 10), (140, 0, 1, 20, 0), (84, 20, 4, 50, 8)];

fn measured(truth: &KrcScenario) -> Vec<Cycle> {
    let described = KrcScenario::open("kr-c2").expect("built in");
    let start = Axes::from(described.options.start_deg.map(f64::to_radians));
    let motion = wiggle(&start, 6.0_f64.to_radians());
    let mut station = exploring(&described, &arm(), &[motion]).expect("a station");
    let (mut next, mut orders) = (None::<Instant>, 0_u32);
    let mut each = |now: Instant, station: &mut Station| {
        if !matches!(station.stage(), Stage::Finished { .. }) {
            return !station.stage().is_end();
        }
        if next.is_none_or(|next| next <= now) {
            station.set_gripper(now, orders.is_multiple_of(2)).expect("stands");
            next = Some(now + Duration::from_micros(250_000 + u64::from(orders) * 7_331 % 40_000));
            orders += 1;
        }
        orders < 80
    };
    let seen = cell::run_with(truth, &mut station, &mut each).expect("a robot");
    assert!(matches!(station.stage(), Stage::Finished { .. }), "{:?} {:?}", station.stage(), seen.fault);
    assert_eq!((seen.late, seen.fault), (0, None));
    let lines = station.take_log();
    cycles(&lines, &described.config, "DiO", Some("GripOpen"))
}

#[test]
fn lag_smoothing_and_gripper_delay_of_other_robots_than_described_are_found() {
    let mut outside = 0;
    for (dead, constant, smoothing, delay, jitter) in TRUTHS {
        let mut truth = KrcScenario::open("kr-c2").expect("built in");
        truth.seed = 11;
        truth.options.lag.dead_time = Duration::from_millis(dead);
        truth.options.lag.time_constant = Duration::from_millis(constant);
        truth.options.lag.smoothing_cycles = smoothing;
        truth.options.hand.gripper.delay = Duration::from_millis(delay);
        truth.options.hand.gripper.jitter = Duration::from_millis(jitter);
        let table = measured(&truth);
        let found = lag(&table, PERIOD_S).expect("a lag");
        println!("{dead} {constant} {smoothing}: {found:?}, {:.2} ms in all", 1e3 * found.total_s(PERIOD_S));
        let total_s = 1e-3 * (dead + constant) as f64 + 0.5 * (smoothing - 1) as f64 * PERIOD_S;
        assert!((found.total_s(PERIOD_S) - total_s).abs() < 5e-4, "{found:?}");
        assert_eq!(found.smoothing_cycles, smoothing);
        // The intervals hold the truth and are short enough to be of use.
        let apart_s = [
            found.dead_s - 1e-3 * dead as f64,
            found.constant_s - 1e-3 * constant as f64,
            found.total_s(PERIOD_S) - total_s,
        ];
        println!("apart by {apart_s:?}, known to {:?}", found.known_s);
        // Half the width of a 95 % interval is two standard errors: one in twenty is farther, none is twice as far.
        let shares = apart_s.iter().zip(found.known_s).map(|(by, known)| by.abs() / known);
        outside += shares.clone().filter(|share| *share > 1.0).count();
        assert!(shares.fold(0.0, f64::max) < 2.0, "{found:?} {apart_s:?}");
        assert!(found.known_s[2] < 1e-3 && found.known_s[0] < 5e-3, "{found:?}");
        assert!(
            (found.dead_s - 1e-3 * dead as f64).abs() < 2e-3
                && (found.constant_s - 1e-3 * constant as f64).abs() < 2e-3
        );
        let fingers = gripper(&table, PERIOD_S, 0).expect("openings");
        println!("gripper {delay} +- {jitter} ms: {fingers:?}");
        assert!((fingers.delay_s - 1e-3 * delay as f64).abs() <= fingers.known_s + 2e-3, "{fingers:?}");
        // A description with it believes that lag.
        let changed = with_measured(&truth, &found, Some(&fingers));
        let believed = Lag::of(&changed);
        let all_s = (believed.dead_time + believed.time_constant).as_secs_f64();
        assert!((all_s - total_s).abs() < 1e-3, "{all_s}");
    }
    assert!(outside <= 2, "{outside} of 12");
}

#[test]
fn lost_telegrams_change_no_measured_lag_and_a_long_gap_is_refused() {
    let mut truth = KrcScenario::open("kr-c2").expect("built in");
    truth.seed = 11;
    let whole = measured(&truth);
    let without = |lost: &dyn Fn(usize) -> bool| -> Vec<Cycle> {
        whole.iter().enumerate().filter(|(k, _)| !lost(*k)).map(|(_, cycle)| cycle.clone()).collect()
    };
    let all = lag(&whole, PERIOD_S).expect("a lag");
    // One of 40: a second of the motion is one telegram shorter, by the count of cycles.
    let few = lag(&without(&|k| k % 40 == 7), PERIOD_S).expect("a lag");
    assert!((few.total_s(PERIOD_S) - all.total_s(PERIOD_S)).abs() < 3e-4, "{few:?} {all:?}");
    let middle = whole.len() / 8;
    let gap = lag(&without(&|k| (middle..middle + 30).contains(&k)), PERIOD_S);
    assert_eq!(gap, Err(Unclear::Gap(30)));
}

#[test]
fn swing_that_leaves_the_range_of_an_axis_or_brings_bodies_together_is_refused() {
    let described = KrcScenario::open("kr-c2").expect("built in");
    let start = Axes::from(described.options.start_deg.map(f64::to_radians));
    let refused =
        |start: &Axes, deg: f64| exploring(&described, &arm(), &[wiggle(start, deg.to_radians())]).err();
    assert_eq!(refused(&start, 6.0), None);
    assert!(matches!(refused(&start, 80.0), Some(NoStation::Unfree { .. })));
    // The arm bends into its own base.
    let mut folded = start;
    folded[2] = 150.0_f64.to_radians();
    assert!(matches!(refused(&folded, 3.0), Some(NoStation::Unfree { .. })), "{:?}", refused(&folded, 3.0));
}

#[test]
fn a_robot_that_did_not_move_shows_no_lag_and_no_openings_no_gripper() {
    let cycle = |k: u64| Cycle {
        at: Instant::from_micros(12_000 * k),
        ipoc: k,
        start_deg: [0.0; 6],
        set_deg: [0.0; 6],
        actual_deg: [0.0; 6],
        outputs: 0.0,
        fingers_open: Some(false),
        late: 0,
    };
    let still: Vec<Cycle> = (0..500).map(cycle).collect();
    assert_eq!(lag(&still, PERIOD_S), Err(Unclear::TooFew(0)));
    assert_eq!(gripper(&still, PERIOD_S, 0), Err(Unclear::NoOpenings(0)));
    // Axes that do not follow at all.
    let stuck: Vec<Cycle> = still
        .into_iter()
        .map(|mut cycle| {
            cycle.set_deg[0] = 3.0 * (0.05 * cycle.ipoc as f64).sin();
            cycle
        })
        .collect();
    assert!(matches!(lag(&stuck, PERIOD_S), Err(Unclear::NoFit { .. })));
}
