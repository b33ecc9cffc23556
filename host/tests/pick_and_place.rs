//! A program that picks and places, for long and with stops at any time. The plant judges: angles of its joints, which no node on the bus
//! can read. The measured figures are of `CYCLES=200` and `STOPS=200` in the environment.

use clap::Parser;
use hil_sim::scenario::Action;
use hil_sim::witness::Trace;
use host::cmd::connected::Connected;
use host::cmd::{program_run, run};
use nalgebra::Vector3;
use operator::bus::period::settings_with_gains;
use operator::bus::{BusArgs, Session};
use operator::port::{Interactive as _, OnBus};
use planner::plan::rng::SplitMix64;
use planner::plan::{Arm, Joints};
use planner::store::fingerprint_of;
use protocol::{Duration, ExtendedId, Frame, Instant, StandardId};

use crate::bus_common::Folder;

const PICK_M: [f64; 3] = [0.5, 0.15, 0.45];
const PLACE_M: [f64; 3] = [0.5, -0.15, 0.45];

fn program(holding: bool) -> String {
    let move_to = |[x, y, z]: [f64; 3]| format!("\n[[step]]\nto = \"{x},{y},{z}\"\nstraight = true\n");
    let grip = |order: &str| format!("\n[[step]]\ngripper = \"{order}\"\n\n[[step]]\nwait_s = 0.1\n");
    let above = |[x, y, _]: [f64; 3]| [x, y, 0.5];
    [
        format!("schema_version = 1\nrobot = \"powercube6\"\nspeed_share = 1.0\nholding = {holding}\n"),
        "\n[[step]]\njoints = \"38.5deg,-89.7deg,-186.1deg,64.2deg,-96.5deg,124.6deg\"\n".to_owned(),
        move_to(PICK_M),
        grip("close"),
        move_to(above(PICK_M)),
        move_to(above(PLACE_M)),
        move_to(PLACE_M),
        grip("open"),
        move_to(above(PLACE_M)),
    ]
    .concat()
}

#[derive(Parser)]
struct Words {
    #[command(flatten)]
    run: run::Args,
}

fn words(folder: &Folder, holding: bool, cycles: u32) -> run::Args {
    let path = folder.file(&format!("holding_{holding}.toml"));
    std::fs::write(&path, program(holding)).unwrap();
    Words::parse_from(["run", &path, "--json", "--repeat", &cycles.to_string()]).run
}

/// A cell whose drives have their zeros, with frames of another node at a time.
fn open(stop: Option<(f64, Frame)>) -> Session {
    let mut cell = BusArgs::default().cell.load().unwrap();
    cell.setup.cell.drive.starts_homed = true;
    cell.setup.actions.extend(stop.map(|(at_s, frame)| Action {
        at: Instant::from_micros((1e6 * at_s) as u64),
        frames: vec![frame],
        every: None,
        count: None,
    }));
    let settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
    session.sim().unwrap().world().with_participants(|all, _| all.0.0.0.record_trace()).unwrap();
    session
}

fn trace(session: &mut Session) -> Trace {
    let world = session.sim().unwrap().world();
    world.with_participants(|all, _| all.0.0.0.take_trace()).unwrap().unwrap()
}

/// Rows of `cycles.csv`, and how it ended.
fn done(
    session: &mut Session,
    arm: &Arm,
    args: &run::Args,
    clears: bool,
) -> (usize, Result<(), host::error::ExpectedError>) {
    let fingerprint = fingerprint_of(arm);
    let mut operator = OnBus::new(session, None);
    if clears {
        operator.clear_fault().unwrap();
    }
    let mut rows = 0;
    let mut connected = Connected::new(&mut operator, arm, &fingerprint);
    let ended = program_run::on_arm(&mut connected, args, &mut |_| rows += 1);
    (rows, ended)
}

fn angles(trace: &Trace, index: usize) -> Joints {
    let sample = trace.sample(index);
    Joints::from_fn(sample.len(), |j| sample[j][0])
}

/// From the environment, or `usual`.
fn count(name: &str, usual: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// The largest step of each joint from one tick of the plant to the next, over what its largest speed allows.
fn largest_step(arm: &Arm, trace: &Trace) -> f64 {
    let v = arm.limit(|l| l.v_max_rad_s) * trace.step().as_secs_f64();
    let step = |index: usize| (angles(trace, index) - angles(trace, index - 1)).component_div(&v).abs();
    (1..trace.len()).map(|index| step(index).amax()).fold(0.0, f64::max)
}

#[test]
#[ignore = "20 s: run by the stage long of CI"]
fn picks_and_places_do_not_drift_in_the_plant() {
    let cycles = count("CYCLES", 30);
    let some = cycles / 10;
    let (folder, arm) = (Folder::new("pick-long"), Arm::load("powercube6").unwrap());
    let mut session = open(None);
    let (rows, ended) = done(&mut session, &arm, &words(&folder, false, cycles as u32), false);
    ended.unwrap();
    assert_eq!(rows, cycles * 10);
    let trace = trace(&mut session);
    let orders = trace.gripper_orders();
    // The hand is closed when the program begins: its first order to close is none.
    for (open, place, count) in [(false, PICK_M, cycles - 1), (true, PLACE_M, cycles)] {
        let off = |(at, _): &(Instant, bool)| {
            arm.ee_at(&angles(&trace, trace.index_at(*at))).pos - Vector3::from(place)
        };
        let all: Vec<Vector3<f64>> = orders.iter().filter(|order| order.1 == open).map(off).collect();
        let farthest_m = all.iter().map(Vector3::norm).fold(0.0, f64::max);
        let mean = |some: &[Vector3<f64>]| some.iter().sum::<Vector3<f64>>() / some.len() as f64;
        let drift_m = (mean(&all[count - some..]) - mean(&all[..some])).norm();
        println!("open {open}: at most {farthest_m:.2e} m from the place, drift {drift_m:.2e} m");
        assert_eq!(all.len(), count);
        assert!(farthest_m < 3e-4, "{farthest_m}");
        assert!(drift_m < 3e-5, "{drift_m}");
    }
    assert!(largest_step(&arm, &trace) < 1.15);
}

/// The stop message of node 99, and the halt broadcast to the drives.
fn stops() -> [Frame; 2] {
    let message = Frame::from_array(ExtendedId::from_low_bits(0x0063_E863), [1, 4, 0, 0, 0xE0]);
    [message, Frame::from_array(StandardId::from_low_bits(0x100), [0x02])]
}

/// What came of a program that was begun again after a stop.
#[derive(Debug, Default, PartialEq)]
struct Counts {
    continued: usize,
    refused_first: usize,
}

#[test]
#[ignore = "20 s: run by the stage long of CI"]
fn program_that_is_stopped_at_any_time_is_done_when_begun_again_and_the_plant_never_leaps() {
    let (folder, arm) = (Folder::new("pick-stops"), Arm::load("powercube6").unwrap());
    let whole_s = {
        let mut session = open(None);
        done(&mut session, &arm, &words(&folder, false, 1), false).1.unwrap();
        session.now().as_secs_f64()
    };
    let mut rng = SplitMix64::new(7);
    let mut counts = Counts::default();
    let mut largest = 0.0_f64;
    for k in 0..count("STOPS", 10) {
        let at_s = 0.4 + (whole_s - 0.5) * rng.unit();
        let frame = stops()[usize::from(rng.unit() < 0.5)];
        let what = format!("stop {k}, {frame} at {at_s:.3} s");
        let mut session = open(Some((at_s, frame)));
        let (_, ended) = done(&mut session, &arm, &words(&folder, false, 1), false);
        let error = ended.expect_err(&what);
        assert!(!error.next.is_empty(), "{what}: {error}");
        session.pass(Duration::from_millis(500)).unwrap();
        let at_rest = |session: &mut Session| {
            let plant = session.sim().unwrap().cell().plant();
            (0..6).map(|j| plant.link_q_rad(j)).collect::<Vec<_>>()
        };
        let stands = at_rest(&mut session);
        session.pass(Duration::from_millis(500)).unwrap();
        for (q, before) in at_rest(&mut session).iter().zip(&stands) {
            assert!((q - before).abs() < 1e-4, "{what}: it moves after the stop");
        }
        // Begun again as a person would: with a full hand if the gripper is closed, and cleared if it is refused for a fault.
        let holding = session
            .sim()
            .unwrap()
            .cell()
            .trace()
            .unwrap()
            .gripper_orders()
            .last()
            .is_some_and(|order| !order.1);
        let again = words(&folder, holding, 1);
        let (rows, ended) = match done(&mut session, &arm, &again, false) {
            (0, Err(error)) if error.to_string().contains("reports a fault") => {
                assert!(!error.next.is_empty(), "{what}: {error}");
                counts.refused_first += 1;
                done(&mut session, &arm, &again, true)
            }
            other => other,
        };
        ended.unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(rows, 10, "{what}");
        counts.continued += 1;
        let trace = trace(&mut session);
        let hand = arm.ee_at(&angles(&trace, trace.len() - 1)).pos;
        let end = Vector3::new(PLACE_M[0], PLACE_M[1], 0.5);
        assert!((hand - end).norm() < 1e-3, "{what}: the hand is at {hand:?}");
        let step = largest_step(&arm, &trace);
        assert!(step < 1.15, "{what}: {step}");
        largest = largest.max(step);
    }
    println!("{counts:?}, largest step {largest:.3} of the largest speed");
    assert!(counts.refused_first > 0 && counts.refused_first < counts.continued, "{counts:?}");
}
