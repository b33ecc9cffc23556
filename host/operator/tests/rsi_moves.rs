//! Motions, programs of motions and streams over RSI in virtual time. The simulated robot judges: its true axes, which the controller
//! does not see.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use hil_sim::krc::bench::RobotFault;
use hil_sim::krc::{Direction, KrcScenario, LinkFault, LinkFaultKind};
use operator::job::{Answer, Extent, Judge, Order, Outcome, Program, Record, perform};
use operator::port::{Interactive, Operator};
use operator::rsi::cell::{Seen, SimulatedRobot};
use operator::rsi::log::Line;
use operator::rsi::operator::{LedRobot, Place};
use operator::rsi::program::{Lag, leading, passes, start_of, travel};
use operator::servo::{Keeps, Next, Stream, follow};
use planner::motion::Motion;
use planner::plan::{Arm, Joints};
use planner::servo::{Command, Limited, Refused, Servo};
use planner::store::fingerprint_of;
use planner::way::way;
use protocol::cyphal::cubecell::group_state::State;
use protocol::{Duration, Instant};
use robot_model::collision::Scene;

use crate::rsi_common::arm;

fn described() -> KrcScenario {
    KrcScenario::open("kr-c2").expect("built in")
}

/// A robot of `scenario` that is led by what is described of it; `at` gets the time of everything that goes in or out.
fn led<'a>(scenario: &KrcScenario, arm: &Arm, stop: &'a Arc<AtomicBool>, at: Instant) -> LedRobot<'a> {
    let described = described();
    let station = leading(&described, arm, Lag::of(&described), &[]).expect("a station");
    let robot = SimulatedRobot::new(scenario).expect("a robot");
    let log = Box::new(move |lines: &[Line]| {
        stop.fetch_or(lines.iter().any(|line| line.at >= at), Ordering::Relaxed);
    });
    LedRobot::new(described, station, Place::Inside(Box::new(robot)), Arc::clone(stop), log)
}

fn motion(arm: &Arm, from: &Joints, to: [f64; 6], share: f64) -> Motion {
    let to = Joints::from_slice(&to.map(f64::to_radians));
    let travel = travel(&described(), arm, share, 1);
    way(arm, &Scene::default(), &travel, from, &to).expect("a way").expect("another place")
}

fn run(robot: &mut LedRobot<'_>, arm: &Arm, motion: &Motion) -> Record {
    let fingerprint = fingerprint_of(arm);
    let order = Order::new(arm, &fingerprint, Program::Motion(motion.clone()), Judge::Reach);
    perform(robot, &Order { extent: Extent::Run, ..order }, &mut |_| Answer::Yes)
}

fn seen(robot: &mut LedRobot<'_>) -> Seen {
    robot.leave();
    robot.led().and_then(|led| led.seen).expect("a simulated robot")
}

/// Largest distance of a true axis from `motion`, rad, while it runs and until `rest_s` after its end.
fn off_rad(seen: &Seen, motion: &Motion, begun: Instant, rest_s: f64) -> f64 {
    let mut worst = 0.0_f64;
    for cycle in &seen.cycles {
        let Some(since) = cycle.at.checked_since(begun) else { continue };
        let t_s = since.as_secs_f64();
        if t_s <= motion.duration_s() + rest_s {
            let q = motion.at(t_s.min(motion.duration_s())).q;
            let off = |axis: usize| (cycle.actual_deg[axis].to_radians() - q[axis]).abs();
            worst = (0..6).map(off).fold(worst, f64::max);
        }
    }
    worst
}

/// The largest way of a true axis from one cycle to the next, over what its largest speed allows.
fn largest_step(seen: &Seen, arm: &Arm) -> f64 {
    let cycle_s = described().options.cycle.as_secs_f64();
    let step = |pair: &[hil_sim::krc::CycleRecord], axis: usize| {
        let way = (pair[1].actual_deg[axis] - pair[0].actual_deg[axis]).to_radians().abs();
        way / (cycle_s * arm.joints()[axis].limits.v_max_rad_s)
    };
    // A program that begins again goes to its start pose by itself, without cycles.
    let is_next = |pair: &&[hil_sim::krc::CycleRecord]| {
        pair[1].at.saturating_since(pair[0].at).as_secs_f64() < 1.5 * cycle_s
    };
    let steps =
        seen.cycles.windows(2).filter(is_next).flat_map(|pair| (0..6).map(move |axis| step(pair, axis)));
    steps.fold(0.0, f64::max)
}

const PLACES_DEG: [[f64; 6]; 3] = [
    [20.0, -80.0, 100.0, 0.0, 60.0, 0.0],
    [-30.0, -70.0, 80.0, 40.0, 70.0, -90.0],
    [0.0, -90.0, 90.0, 0.0, 90.0, 0.0],
];

#[test]
fn true_axes_follow_one_motion_after_the_other_and_the_robot_is_held_between() {
    let (arm, stop) = (arm(), Arc::new(AtomicBool::new(false)));
    let mut robot = led(&described(), &arm, &stop, Instant::FAR_FUTURE);
    let mut from = start_of(&described());
    let mut ran = Vec::new();
    for place in PLACES_DEG {
        let motion = motion(&arm, &from, place, 0.4);
        let record = run(&mut robot, &arm, &motion);
        assert_eq!(record.verdict.outcome, Outcome::Reached, "{}", record.verdict.text);
        ran.push((motion.clone(), record.led.and_then(|led| led.started_at).expect("began")));
        from = motion.stop_rad();
        // A person or a program takes its time.
        robot.pass(Duration::from_secs(2)).expect("held");
    }
    let seen = seen(&mut robot);
    assert_eq!((seen.late, seen.refused, &seen.fault), (0, 0, &None));
    for (motion, begun) in &ran {
        let off = off_rad(&seen, motion, *begun, 1.9);
        assert!((1e-7..2e-4).contains(&off), "{off}");
    }
    let step = largest_step(&seen, &arm);
    assert!((0.1..0.45).contains(&step), "{step}");
}

#[test]
fn interruption_at_any_moment_of_a_motion_leaves_an_arm_at_rest_on_its_path() {
    let arm = arm();
    let motion = motion(&arm, &start_of(&described()), PLACES_DEG[1], 0.6);
    let mut stopped = 0;
    for k in 0..24 {
        let stop = Arc::new(AtomicBool::new(false));
        let at = Instant::from_micros(400_000 + 120_000 * k);
        let mut robot = led(&described(), &arm, &stop, at);
        let record = run(&mut robot, &arm, &motion);
        let outcome = record.verdict.outcome;
        assert!(
            matches!(outcome, Outcome::Stopped | Outcome::Reached | Outcome::NotRun),
            "{at:?}: {outcome:?}"
        );
        let before = robot.pose().expect("axes");
        stop.store(false, Ordering::Relaxed);
        robot.pass(Duration::from_secs(1)).expect("held");
        let after = robot.pose().expect("axes");
        let moved = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(outcome == Outcome::NotRun || moved < 1e-3, "{at:?}: {moved}");
        let seen = seen(&mut robot);
        assert_eq!(seen.fault, None, "{at:?}");
        assert!(largest_step(&seen, &arm) < 0.7, "{at:?}");
        // The true axes are on the path, wherever they came to rest.
        let last = Joints::from_slice(&seen.cycles.last().expect("cycles").actual_deg.map(f64::to_radians));
        let near =
            (0..=2_000).map(|i| (motion.at(motion.duration_s() * f64::from(i) / 2_000.0).q - last).amax());
        let near = near.fold(f64::INFINITY, f64::min);
        assert!(near < 5e-3, "{at:?}: {near}");
        stopped += u32::from(outcome == Outcome::Stopped);
    }
    assert!((8..24).contains(&stopped), "{stopped}");
}

#[test]
fn faults_of_link_and_robot_during_a_motion_end_in_the_truth() {
    use Direction::{ToClient, ToRobot};
    use LinkFaultKind::{Doubled, Late, Lost, Reordered, Torn, WithoutAxes, WrongIpoc};
    let arm = arm();
    let motion = motion(&arm, &start_of(&described()), PLACES_DEG[1], 0.6);
    let late = Late(Duration::from_millis(15));
    let kinds = [Lost, late, Doubled, Reordered, Torn, WithoutAxes, WrongIpoc(3)];
    let (mut reached, mut stopped) = (0, 0);
    for kind in kinds {
        for direction in [ToClient, ToRobot] {
            for (from_ms, span_ms, probability) in [(300, 40, 1.0), (900, 200, 1.0), (500, 3_000, 0.1)] {
                let mut scenario = described();
                let from = Instant::from_micros(1_000 * from_ms);
                let until = from + Duration::from_millis(span_ms);
                scenario.link_faults = vec![LinkFault { kind, direction, from, until, probability }];
                check(&scenario, &arm, &motion, (&mut reached, &mut stopped));
            }
        }
    }
    for at_ms in [300, 900, 1_500] {
        let at = Instant::from_micros(1_000 * at_ms);
        let pause = Duration::from_millis(400);
        for fault in [RobotFault::CutOut { at }, RobotFault::Restart { at, pause }] {
            let scenario = KrcScenario { robot_faults: vec![fault], ..described() };
            check(&scenario, &arm, &motion, (&mut reached, &mut stopped));
        }
    }
    println!("{reached} reached, {stopped} did not");
    assert!(reached >= 5 && stopped >= 5, "{reached} {stopped}");
}

/// The report of the job agrees with the true axes.
fn check(scenario: &KrcScenario, arm: &Arm, motion: &Motion, (reached, stopped): (&mut u32, &mut u32)) {
    let stop = Arc::new(AtomicBool::new(false));
    let mut robot = led(scenario, arm, &stop, Instant::FAR_FUTURE);
    let record = run(&mut robot, arm, motion);
    let seen = seen(&mut robot);
    let name = format!("{:?} {:?}", scenario.link_faults, scenario.robot_faults);
    let last = Joints::from_slice(&seen.cycles.last().expect("cycles").actual_deg.map(f64::to_radians));
    let away = (last - motion.stop_rad()).amax();
    match record.verdict.outcome {
        Outcome::Reached => {
            *reached += 1;
            assert!(away < 1e-2, "{name}: {away}");
        }
        Outcome::Stopped | Outcome::NotReached | Outcome::NotRun => {
            *stopped += 1;
            // It says why.
            assert!(record.verdict.text.len() > 20, "{name}");
        }
        other => panic!("{name}: {other:?}"),
    }
    assert!(largest_step(&seen, arm) < 1.05, "{name}: {}", largest_step(&seen, arm));
}

#[test]
fn motion_beyond_what_the_program_of_the_robot_passes_is_refused_before_anything_moves() {
    let (arm, stop) = (arm(), Arc::new(AtomicBool::new(false)));
    let mut narrow = described();
    narrow.options.correction.upper[0] = 15.0;
    let motion = motion(&arm, &start_of(&narrow), PLACES_DEG[0], 0.4);
    let why = passes(&narrow, &motion).expect_err("20 degrees").to_string();
    assert!(why.contains("a correction of 20.") || why.contains("on A1"), "{why}");
    let station = leading(&narrow, &arm, Lag::of(&narrow), &[]).expect("a station");
    let place = Place::Inside(Box::new(SimulatedRobot::new(&narrow).expect("a robot")));
    let mut robot = LedRobot::new(narrow, station, place, Arc::clone(&stop), Box::new(|_| {}));
    let record = run(&mut robot, &arm, &motion);
    assert_eq!(record.verdict.outcome, Outcome::NotRun, "{}", record.verdict.text);
    assert!(record.verdict.text.contains("passes"), "{}", record.verdict.text);
    let seen = seen(&mut robot);
    assert!(largest_step(&seen, &arm) < 1e-9);
}

/// A hand that goes around a circle, with commands that are lost, late and nonsense between.
struct Circle {
    next: u32,
    refused: u32,
    end_s: f64,
}

impl Stream for Circle {
    fn next(&mut self, t_s: f64) -> Next {
        let due_s = 0.03 * f64::from(self.next);
        if due_s > self.end_s {
            return Next::End;
        }
        if due_s > t_s {
            return Next::Nothing;
        }
        self.next += 1;
        let place = [1.1 + 0.12 * due_s.sin(), 0.12 * due_s.cos() - 0.12, 1.0];
        Next::Command(match self.next % 11 {
            3 => Command::Joints(Joints::from_slice(&[f64::NAN; 6])),
            5 => Command::JointSpeeds(Joints::from_slice(&[std::f64::consts::PI; 6])),
            _ => Command::Point(place.into()),
        })
    }

    fn refused(&mut self, _: f64, _: Refused) {
        self.refused += 1;
    }

    fn ticked(&mut self, _: f64, _: &Servo<'_>, _: Option<&Limited>) {}
}

/// The robot waits to be led; what keeps a stream in bounds.
fn ready(robot: &mut LedRobot<'_>) -> Keeps {
    robot.wait_for(Duration::from_secs(20), &|state| state == State::Ready).unwrap();
    Keeps {
        share: 0.3,
        v_max_rad_s: f64::INFINITY,
        hold: Duration::from_millis(200),
        scene: Scene::default(),
    }
}

#[test]
fn stream_leads_the_true_axes_within_their_speeds_and_ends_at_rest() {
    let (arm, stop) = (arm(), Arc::new(AtomicBool::new(false)));
    let mut robot = led(&described(), &arm, &stop, Instant::FAR_FUTURE);
    let keeps = ready(&mut robot);
    for end_s in [4.0, 3.0] {
        let mut circle = Circle { next: 0, refused: 0, end_s };
        let streamed = follow(&mut robot, &arm, &keeps, &mut circle).expect("followed");
        assert_eq!((streamed.restarts, streamed.late.len(), streamed.interrupted), (0, 0, false));
        assert!(circle.refused > 5 && streamed.taken > 80, "{} {}", circle.refused, streamed.taken);
        let off = streamed
            .end_rad
            .iter()
            .zip(&streamed.measured_rad)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(off < 1e-3, "{off}");
    }
    assert!(!robot.is_interrupted());
    let seen = seen(&mut robot);
    assert_eq!((seen.late, &seen.fault), (0, &None));
    let step = largest_step(&seen, &arm);
    assert!((0.02..0.31).contains(&step), "{step}");
}

#[test]
fn stream_without_commands_comes_to_rest_and_an_interrupted_one_too() {
    let (arm, stop) = (arm(), Arc::new(AtomicBool::new(false)));
    let mut robot = led(&described(), &arm, &stop, Instant::from_micros(6_000_000));
    let keeps = ready(&mut robot);
    let mut circle = Circle { next: 0, refused: 0, end_s: 60.0 };
    let streamed = follow(&mut robot, &arm, &keeps, &mut circle).expect("ended in order");
    assert!(streamed.interrupted && streamed.duration_s < 6.5, "{streamed:?}");
    stop.store(false, Ordering::Relaxed);
    let before = robot.pose().expect("axes");
    robot.pass(Duration::from_secs(1)).expect("held");
    let moved =
        before.iter().zip(robot.pose().expect("axes")).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved < 1e-4, "{moved}");
    assert_eq!(seen(&mut robot).fault, None);
}
