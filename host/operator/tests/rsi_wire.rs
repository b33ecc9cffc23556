//! Requirements on the description of a robot's program, and the names of its configuration file. Judged by the
//! simulated robot: its program ends, or its axes move.

use crate::rsi_common::{arm, plan, scenario, true_lag};
use firmware::fault::Cause;
use hil_sim::krc::{CycleRecord, FaultCause, KrcScenario, Space};
use operator::rsi::cell;
use operator::rsi::program::{
    Lag, NoStation, can_be_led, exploring, leading, prepare, replay_station, station,
};
use operator::rsi::station::Stage;
use protocol::{Duration, Instant};

const DESCRIPTION: &str = include_str!("../../../robots/kr16_2/kr_c2.toml");
const CONFIG: &str = include_str!("../../../robots/kr16_2/rsi_udp.xml");

fn described(description: &str, config: &str) -> KrcScenario {
    KrcScenario::from_toml("robot.toml", description, |_| Ok(config.to_owned())).expect("a description")
}

#[test]
fn program_that_adds_corrections_or_corrects_the_tool_is_led_by_no_station() {
    let relative = described(&DESCRIPTION.replace("relative = false", "relative = true"), CONFIG);
    assert!(relative.options.correction.relative);
    let of_space = |word: &str| described(&DESCRIPTION.replace("\"axes\"", &format!("\"{word}\"")), CONFIG);
    let cases = [
        (relative, NoStation::Relative),
        (of_space("base"), NoStation::NotAxes { space: "base" }),
        (of_space("tool"), NoStation::NotAxes { space: "tool" }),
    ];
    for (mut scenario, expected) in cases {
        let lag = Lag::of(&scenario);
        assert_eq!(can_be_led(&scenario), Err(expected.clone()));
        assert_eq!(leading(&scenario, &arm(), lag, &[]).err(), Some(expected.clone()));
        assert_eq!(exploring(&scenario, &arm(), &[]).err(), Some(expected.clone()));
        assert_eq!(replay_station(&scenario, &arm(), None).err(), Some(expected.clone()));
        prepare(&mut scenario, &arm(), plan());
        assert_eq!(station(&scenario, &arm(), plan(), lag, &[]).err(), Some(expected.clone()));
        assert!(expected.next().unwrap().contains("ST_AXISCORR"), "{expected}");
    }
    assert_eq!(can_be_led(&described(DESCRIPTION, CONFIG)), Ok(()));
    assert_eq!(Space::Axes.word(), "axes");
}

/// The description says absolute, but the robot's program adds. No file shows this to the client; only the axes do.
/// A held correction moves such a robot on, so braking along the path does not end it: its program is ordered to
/// leave the sensor motion.
#[test]
fn robot_that_adds_corrections_against_its_description_is_ordered_to_leave_as_soon_as_its_axes_run_away() {
    let described = scenario(1);
    let thrown = |takes_every_step: bool| {
        let mut truth = described.clone();
        truth.options.correction.relative = true;
        if takes_every_step {
            truth.options.cut_out.velocity_deg_s = Some([1e6; 6]);
            truth.options.cut_out.acceleration_deg_s2 = [1e9; 6];
            truth.options.cut_out.jerk_deg_s3 = [1e12; 6];
        }
        let mut station = station(&described, &arm(), plan(), true_lag(&described), &[]).expect("a station");
        (cell::run(&truth, &mut station).expect("a robot"), *station.stage())
    };
    // A robot that takes every step: the client alone stops it.
    let (seen, stage) = thrown(true);
    let Stage::Stopped { fault } = stage else { panic!("{stage:?}") };
    assert_eq!((fault.cause, seen.fault), (Cause::RobotLags, None));
    let ended = seen.ended.expect("its program is ended");
    let start = &described.options.start_deg;
    let away = |cycle: &CycleRecord| {
        (0..6).map(|axis| (cycle.actual_deg[axis] - start[axis]).abs()).fold(0.0, f64::max)
    };
    let last = seen.cycles.last().expect("cycles");
    println!("{stage:?} after {ended:?}, {:.1} deg from the start pose", away(last));
    // It moved away by more than the whole throw takes: that is why such a robot is never led knowingly.
    assert!(last.at <= ended && away(last) > 10.0, "{}", away(last));
    // One with the usual limits stops itself first. It moves by each correction once per cycle of 12 ms, so a correction of 1.8 deg is
    // its speed limit of 150 deg/s, and a client that moves with 24 deg/s is its acceleration limit of 2000 deg/s2. A ramp of
    // 120 deg/s2 is at 1.8 deg first, a ramp that begins smoothly is at 24 deg/s first.
    let (seen, stage) = thrown(false);
    let by_its_limits =
        matches!(seen.fault, Some(FaultCause::Velocity { .. } | FaultCause::Acceleration { .. }));
    assert!(by_its_limits, "{:?}", seen.fault);
    assert!(matches!(stage, Stage::Stopped { fault } if fault.cause == Cause::DriveSilent), "{stage:?}");
}

/// Time from the order to leave to the robot's last telegram.
fn goes_on_after_leaving(scenario: &KrcScenario) -> Duration {
    let mut station = leading(scenario, &arm(), Lag::of(scenario), &[]).expect("a station");
    let mut left_at = None;
    let seen = cell::run_with(scenario, &mut station, &mut |now, station| {
        if now < Instant::from_micros(200_000) {
            return true;
        }
        station.leave(now);
        left_at = Some(now);
        false
    })
    .expect("a robot");
    let last = seen.cycles.last().expect("cycles").at;
    last.saturating_since(left_at.expect("left"))
}

#[test]
fn robot_program_ends_by_the_name_that_the_configuration_gives_and_by_no_other() {
    let renamed = CONFIG.replace("TAG=\"Stop\"", "TAG=\"Halt\"");
    let by_own_name = described(&DESCRIPTION.replace("stop = \"Stop\"", "stop = \"Halt\""), &renamed);
    assert_eq!(by_own_name.options.stop_name, "Halt");
    let cycle = by_own_name.options.cycle;
    assert!(goes_on_after_leaving(&by_own_name) <= cycle * 2);
    assert!(goes_on_after_leaving(&described(DESCRIPTION, CONFIG)) <= cycle * 2);
    // The file has no such name: the program continues until a person ends it at the robot.
    assert!(goes_on_after_leaving(&described(DESCRIPTION, &renamed)) > cycle * 100);
}
