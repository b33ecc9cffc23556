//! Faults of link and robot in each phase of a throw: landed, or stopped and reported; never silent, never a resumed target.

use std::collections::BTreeMap;

use crate::rsi_common::{HIT_M, TARGET, arm, error_m, performed, plan, scenario, thrown, true_lag};
use firmware::fault::Cause;
use hil_sim::krc::bench::RobotFault;
use hil_sim::krc::{CycleRecord, Direction, FaultCause, KrcScenario, LinkFault, LinkFaultKind};
use operator::job::{Outcome, Record};
use operator::rsi::cell::{self, Seen};
use operator::rsi::program::{leading, start_of, station, travel};
use operator::rsi::station::Stage;
use planner::follow::limits::Axes;
use planner::way::way;
use protocol::{Duration, Instant};
use robot_model::collision::Scene;

/// Distance of each axis from the end of the plan at which it counts as there, rad.
const END_RAD: f64 = 1e-3;

#[derive(Clone, Copy, Debug)]
enum Kind {
    Link(Direction, LinkFaultKind),
    CutOut,
    Restart,
}

const KINDS: [(&str, Kind); 15] = {
    use Direction::{ToClient, ToRobot};
    use LinkFaultKind::{Doubled, Late, Lost, Reordered, Torn, WithoutAxes, WrongIpoc};
    const LATE: LinkFaultKind = Late(Duration::from_millis(15));
    [
        ("telegram lost", Kind::Link(ToClient, Lost)),
        ("answer lost", Kind::Link(ToRobot, Lost)),
        ("telegram late", Kind::Link(ToClient, LATE)),
        ("answer late", Kind::Link(ToRobot, LATE)),
        ("telegram doubled", Kind::Link(ToClient, Doubled)),
        ("answer doubled", Kind::Link(ToRobot, Doubled)),
        ("telegram reordered", Kind::Link(ToClient, Reordered)),
        ("answer reordered", Kind::Link(ToRobot, Reordered)),
        ("telegram torn", Kind::Link(ToClient, Torn)),
        ("answer torn", Kind::Link(ToRobot, Torn)),
        ("telegram with a wrong IPOC", Kind::Link(ToClient, WrongIpoc(5))),
        ("answer with a wrong IPOC", Kind::Link(ToRobot, WrongIpoc(1))),
        ("telegram without axes", Kind::Link(ToClient, WithoutAxes)),
        ("cut-out", Kind::CutOut),
        ("restart", Kind::Restart),
    ]
};

/// A robot with its program at its usual start pose, and the way from there to the plan.
struct Cell {
    name: &'static str,
    described: KrcScenario,
}

impl Cell {
    fn new(name: &'static str, source: &str) -> Self {
        let mut described = KrcScenario::open(source).expect("built in");
        described.options.hand.gripper.landing_z_m = Some(TARGET[2]);
        described.seed = 1;
        Self { name, described }
    }

    /// Throws with a fault of link or robot.
    fn thrown(&self, fault: Option<(Kind, Instant, u64)>) -> (Seen, Record, Stage) {
        let mut scenario = self.described.clone();
        match fault {
            Some((Kind::Link(direction, kind), from, length_ms)) => {
                let until = from + Duration::from_millis(length_ms);
                scenario.link_faults = vec![LinkFault { kind, direction, from, until, probability: 1.0 }];
            }
            Some((Kind::CutOut, at, _)) => scenario.robot_faults = vec![RobotFault::CutOut { at }],
            Some((Kind::Restart, at, length_ms)) => {
                let pause = Duration::from_millis(length_ms);
                scenario.robot_faults = vec![RobotFault::Restart { at, pause }];
            }
            None => {}
        }
        let (mut record, stage) = performed(&scenario);
        let seen = record.led.as_mut().and_then(|led| led.seen.take()).expect("simulated");
        (seen, record, stage)
    }

    /// A time in each phase of the throw, from a run without faults.
    fn phases(&self) -> [(&'static str, Instant); 7] {
        let (seen, record, stage) = self.thrown(None);
        assert!(record.approach_s.is_some(), "the program starts elsewhere");
        let Stage::Finished { started_at } = stage else { panic!("{}", record.verdict.text) };
        assert!(is_landed(&seen), "{}: {:?}", self.name, error_m(&seen));
        let step = |k: usize| started_at + Duration::from_micros((plan().steps[k].t_s * 1e6) as u64);
        let [first, last] = plan().window;
        // The fastest cycle of the way to the start.
        let way = seen.cycles.windows(2).filter(|pair| pair[1].at < started_at);
        let speed = |pair: &&[CycleRecord]| {
            (0..6).map(|axis| (pair[1].set_deg[axis] - pair[0].set_deg[axis]).abs()).fold(0.0, f64::max)
        };
        let fastest = way.max_by(|a, b| speed(a).total_cmp(&speed(b))).expect("cycles");
        assert!(speed(&fastest) > 0.05, "the arm moves to its start");
        [
            ("waiting", Instant::from_micros(100_000)),
            ("approach", fastest[0].at),
            ("accelerating", step(first / 2)),
            // The ball is in the hand, then free.
            ("following", step(first + 2)),
            ("released", step(last)),
            ("decelerating", step((last + plan().steps.len()) / 2)),
            ("slow", step(plan().steps.len() - 3) + Duration::from_millis(96)),
        ]
    }
}

/// In the simulated world: the ball is in the bottle, the robot did not stop by itself, and the axes stand at the end of the plan.
fn is_landed(seen: &Seen) -> bool {
    let end = plan().steps.last().expect("steps").q_rad;
    let stands = seen.cycles.last().is_some_and(|cycle| {
        (0..6).all(|axis| (cycle.actual_deg[axis].to_radians() - end[axis]).abs() < END_RAD)
    });
    let in_bottle = seen.released.is_some() && error_m(seen).is_some_and(|error| error <= HIT_M);
    seen.fault.is_none() && in_bottle && stands
}

/// Possible causes of the end of a path with such a fault. The controller sees telegrams only: a robot that stopped by itself
/// is silent.
fn causes(kind: Kind, seen: &Seen) -> &'static [Cause] {
    use LinkFaultKind::Doubled;
    match (kind, &seen.fault) {
        (Kind::Link(_, Doubled), _) => &[],
        // It may be the first of another run.
        (Kind::Link(_, LinkFaultKind::WithoutAxes), _) => &[Cause::RobotRestarted],
        (Kind::CutOut, _) => &[Cause::DriveSilent],
        (Kind::Restart, _) => &[Cause::DriveSilent, Cause::RobotRestarted],
        (Kind::Link(..), Some(_)) => &[Cause::DriveSilent],
        // Numbers that fall back are those of a new run.
        (Kind::Link(Direction::ToClient, LinkFaultKind::WrongIpoc(_)), None) => {
            &[Cause::AnswersLate, Cause::DriveSilent, Cause::RobotRestarted]
        }
        (Kind::Link(..), None) => &[Cause::AnswersLate, Cause::DriveSilent, Cause::FollowingError],
    }
}

/// Possible causes of a stop of the simulated robot with such a fault.
fn stops_robot(kind: Kind, cause: &FaultCause) -> bool {
    match kind {
        Kind::CutOut => *cause == FaultCause::Ordered,
        // Held set points at speed, and the leap after them.
        Kind::Link(..) => {
            matches!(
                cause,
                FaultCause::Acceleration { .. } | FaultCause::Jerk { .. } | FaultCause::LateLimit { .. }
            )
        }
        // A new run has no answer until its axes have come to rest: a KR C4 allows 10 late ones.
        Kind::Restart => matches!(cause, FaultCause::LateLimit { .. }),
    }
}

/// The program of the robot begins again, and its set points stay where it began, until the client ends it or the
/// test ends: the earlier motion is not resumed.
fn holds_after_its_new_start(seen: &Seen, place: &str) {
    assert_eq!(seen.started.len(), 2, "{place}: the program of the robot begins again");
    let run: Vec<_> = seen.cycles.iter().filter(|cycle| cycle.at >= seen.started[1]).collect();
    let is_ended = seen.ended.is_some_and(|at| at >= seen.started[1])
        || matches!(seen.fault, Some(FaultCause::LateLimit { .. }));
    assert!(!run.is_empty() && (is_ended || run.len() > 20), "{place}: the new run has {} cycles", run.len());
    let held = run[0].set_deg;
    for cycle in run {
        let moved = cycle.set_deg.iter().zip(&held).any(|(now, held)| (now - held).abs() > 1e-6);
        assert!(!moved, "{place}, {:?}: a target of before", cycle.at);
    }
}

#[test]
fn every_fault_in_every_phase_of_a_kr_c2_over_udp_is_reported_with_its_cause_and_resumes_nothing() {
    every_fault_in_every_phase("KR C2, UDP", "kr-c2");
}

#[test]
fn every_fault_in_every_phase_of_a_kr_c2_over_tcp_is_reported_with_its_cause_and_resumes_nothing() {
    every_fault_in_every_phase("KR C2, TCP", "kr-c2-tcp");
}

#[test]
fn every_fault_in_every_phase_of_a_kr_c4_over_udp_is_reported_with_its_cause_and_resumes_nothing() {
    every_fault_in_every_phase("KR C4, UDP", "kr-c4-12ms");
}

fn every_fault_in_every_phase(name: &'static str, source: &'static str) {
    let (mut wrong, mut reported) = (Vec::new(), BTreeMap::<String, usize>::new());
    let cell = Cell::new(name, source);
    let phases = cell.phases();
    println!("{name}: {}", phases.map(|(phase, _)| phase).join(", "));
    for (kind_name, kind) in KINDS {
        if cell.described.network.in_order && matches!(kind, Kind::Link(_, LinkFaultKind::Reordered)) {
            continue;
        }
        let mut row = Vec::new();
        for (phase, from) in phases {
            let mut cell_words = Vec::new();
            for length_ms in [12, 300] {
                let (seen, Record { verdict, .. }, stage) = cell.thrown(Some((kind, from, length_ms)));
                let place = format!("{name}, {kind_name}, {phase}, {length_ms} ms");
                let fault = seen.fault;
                if fault.is_some_and(|fault| !stops_robot(kind, &fault)) {
                    wrong.push(format!("{place}: the robot stopped by {fault:?}"));
                }
                if fault.is_some() != verdict.text.contains("the robot stopped by itself") {
                    wrong.push(format!("{place}: {}", verdict.text));
                }
                let word = match stage {
                    Stage::Finished { .. } if is_landed(&seen) => {
                        assert_eq!(verdict.outcome, Outcome::Landed, "{place}: {}", verdict.text);
                        "landed".to_owned()
                    }
                    // At the end of the path nothing moves any more, but the robot's program was stopped: no success.
                    Stage::Finished { .. } if fault.is_some() => {
                        assert_eq!(verdict.outcome, Outcome::Stopped, "{place}: {}", verdict.text);
                        "stopped by the robot".to_owned()
                    }
                    Stage::Finished { .. } => {
                        wrong.push(format!("{place}: silent, {fault:?}"));
                        "SILENT".to_owned()
                    }
                    Stage::Stopped { fault: stopped } => {
                        if !causes(kind, &seen).contains(&stopped.cause) {
                            wrong.push(format!("{place}: {:?}, robot {fault:?}", stopped.cause));
                        }
                        assert_eq!(verdict.outcome, Outcome::Stopped, "{place}: {}", verdict.text);
                        format!("stopped {}", stopped.cause.code())
                    }
                    // A robot that ends before it is ready: the station listens without a limit, the verdict gives the reason.
                    Stage::NotThrown { .. } | Stage::Waiting if phase == "waiting" => {
                        assert_eq!(verdict.outcome, Outcome::NotThrown, "{place}: {}", verdict.text);
                        if seen.released.is_some() {
                            wrong.push(format!("{place}: not thrown, and the ball left the hand"));
                        }
                        "not thrown".to_owned()
                    }
                    other => {
                        wrong.push(format!("{place}: no end, {other:?}"));
                        "NO END".to_owned()
                    }
                };
                *reported.entry(word.clone()).or_default() += 1;
                cell_words.push(word);
                if matches!(kind, Kind::Restart) && phase != "waiting" {
                    holds_after_its_new_start(&seen, &place);
                }
            }
            cell_words.dedup();
            row.push(cell_words.join(" / "));
        }
        println!("{kind_name:<28} {}", row.join(", "));
    }
    println!("{reported:?}");
    assert!(wrong.is_empty(), "{wrong:#?}");
    // Both outcomes occur, so the faults act.
    let count = |what: &str| -> usize {
        reported.iter().filter(|(word, _)| word.starts_with(what)).map(|(_, count)| count).sum()
    };
    assert!(count("landed") >= 20 && count("stopped") >= 20, "{name}: {reported:?}");
}

/// A robot that accepts any step of its set points and any number of late answers: only the client can end a path.
fn without_cut_out(scenario: &KrcScenario) -> KrcScenario {
    let mut scenario = scenario.clone();
    scenario.options.cut_out.acceleration_deg_s2 = [1e9; 6];
    scenario.options.cut_out.jerk_deg_s3 = [1e12; 6];
    scenario.options.cut_out.velocity_deg_s = Some([1e6; 6]);
    scenario.options.late.limit = 1_000;
    scenario
}

/// The client ends in each phase of the throw, and another one gets the robot's telegrams a cycle to 0.3 s later,
/// its first telegram with or without axes. It does not know the set points of the first one; the axes follow a
/// correction after 120 ms.
#[test]
fn client_that_begins_again_in_a_run_moves_no_set_point() {
    for source in ["kr-c2", "kr-c4-12ms"] {
        let cell = Cell::new(source, source);
        let scene = Scene { ball_held: true, ..Scene::default() };
        let start = Axes::from(plan().steps[0].q_rad);
        let travel = travel(&cell.described, &arm(), 0.8, 1);
        let found = way(&arm(), &scene, &travel, &start_of(&cell.described), &start).expect("a way");
        let ways: Vec<_> = found.into_iter().collect();
        for (phase, from) in cell.phases() {
            for (gap_ms, first) in [(12, 0), (12, 12), (60, 0), (60, 12), (120, 0), (300, 0), (300, 12)] {
                let place = format!("{source}, {phase}, {gap_ms} ms, {first} ms without axes");
                let mut scenario = without_cut_out(&cell.described);
                let begins = from + Duration::from_millis(gap_ms);
                let sees = begins + Duration::from_millis(first);
                scenario.link_faults =
                    [(LinkFaultKind::Lost, from, begins), (LinkFaultKind::WithoutAxes, begins, sees)]
                        .map(|(kind, from, until)| {
                            let direction = Direction::ToClient;
                            LinkFault { kind, direction, from, until, probability: 1.0 }
                        })
                        .to_vec();
                let lag = true_lag(&scenario);
                let mut first = station(&scenario, &arm(), plan(), lag, &ways).expect("a station");
                let mut next = Some(leading(&scenario, &arm(), lag, &[]).expect("a station"));
                let seen = cell::run_with(&scenario, &mut first, &mut |now, station| {
                    if now >= from
                        && let Some(next) = next.take()
                    {
                        *station = next;
                    }
                    now < from + Duration::from_secs(2)
                });
                let cycles = seen.expect("a robot").cycles;
                // What was answered before the end of the first one comes into force in the next cycle.
                let after: Vec<_> = cycles.iter().filter(|cycle| cycle.at > from).collect();
                assert!(after.len() > 20, "{place}: {} cycles", after.len());
                let moved = |axis: usize| {
                    let set = after.iter().skip(1).map(|cycle| cycle.set_deg[axis] - after[1].set_deg[axis]);
                    set.fold(0.0, |most: f64, way| most.max(way.abs()))
                };
                let moved = (0..6).map(moved).fold(0.0, f64::max);
                assert!(moved < 1e-6, "{place}: {moved:.3} deg");
            }
        }
    }
}

#[test]
fn one_late_answer_at_any_speed_is_caught_up_or_reported_and_the_axes_end_on_the_path() {
    let (_, nominal) = thrown(&scenario(1));
    let Stage::Finished { started_at } = *nominal.stage() else { panic!("{:?}", nominal.stage()) };
    let last = plan().steps.last().expect("steps").q_rad;
    let mut fastest_caught_up = 0.0_f64;
    for k in (2..plan().steps.len() - 2).step_by(12) {
        let mut scenario = without_cut_out(&scenario(1));
        let at = started_at + Duration::from_micros((plan().steps[k].t_s * 1e6) as u64);
        // The set point of a step is in force before the axes are there.
        let from = at.saturating_sub(Duration::from_millis(96));
        let until = from + Duration::from_millis(12);
        let (kind, direction) = (LinkFaultKind::Lost, Direction::ToRobot);
        scenario.link_faults = vec![LinkFault { kind, direction, from, until, probability: 1.0 }];
        let (seen, station) = thrown(&scenario);
        assert_eq!(seen.late, 1, "step {k}");
        let fastest = plan().steps[k].qd_rad_s.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        match station.stage() {
            Stage::Finished { .. } => {
                let end = seen.cycles.last().expect("cycles").actual_deg;
                let away = (0..6).map(|i| (end[i].to_radians() - last[i]).abs()).fold(0.0, f64::max);
                assert!(away < 1e-3, "step {k}: {away} rad beside the end of the path");
                fastest_caught_up = fastest_caught_up.max(fastest);
            }
            Stage::Stopped { fault } => {
                assert_eq!(fault.cause, Cause::FollowingError, "step {k}");
            }
            other => panic!("step {k}: {other:?}"),
        }
        println!("step {k}, {fastest:.2} rad/s: {:?}", station.stage());
    }
    // An axis with 2 rad/s falls 0.08 rad behind until the cap lets it have its speed again.
    assert!(fastest_caught_up > 2.0, "{fastest_caught_up}");
}
