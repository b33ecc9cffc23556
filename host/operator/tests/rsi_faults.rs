//! Faults of link and robot in each phase of a throw: landed, or stopped and told; never silent, never a resumed target.

mod rsi_common;

use std::collections::BTreeMap;

use hil_sim::krc::bench::RobotFault;
use hil_sim::krc::{Direction, LinkFault, LinkFaultKind};
use operator::rsi::outcome::judge;
use operator::rsi::station::Stage;
use operator::throw::Outcome;
use protocol::{Duration, Instant};
use rsi_common::{HIT_M, TARGET, error_m, plan, scenario, thrown};

#[derive(Clone, Copy, Debug)]
enum Kind {
    Link(Direction, LinkFaultKind),
    CutOut,
    Restart,
}

const KINDS: [(&str, Kind); 14] = {
    use Direction::{ToClient, ToRobot};
    use LinkFaultKind::{Doubled, Late, Lost, Reordered, Torn, WrongIpoc};
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
        ("cut-out", Kind::CutOut),
        ("restart", Kind::Restart),
    ]
};

#[test]
fn every_fault_in_every_phase_is_told_and_resumes_nothing() {
    let (_, nominal) = thrown(&scenario(1));
    let Stage::Finished { started_at } = *nominal.stage() else { panic!("{:?}", nominal.stage()) };
    let step = |k: usize| started_at + Duration::from_micros((plan().steps[k].t_s * 1e6) as u64);
    let [first, last] = plan().window;
    let phases = [
        ("waiting", Instant::from_micros(100_000)),
        ("accelerating", step(first / 2)),
        // The ball is in the hand, then free.
        ("following", step(first + 2)),
        ("released", step(last)),
        ("decelerating", step((last + plan().steps.len()) / 2)),
        ("slow", step(plan().steps.len() - 3) + Duration::from_millis(96)),
    ];
    let (mut silent, mut told) = (Vec::new(), BTreeMap::<String, usize>::new());
    for (name, kind) in KINDS {
        let mut row = Vec::new();
        for (phase, from) in phases {
            for length_ms in [12, 300] {
                let mut scenario = scenario(1);
                match kind {
                    Kind::Link(direction, kind) => {
                        let until = from + Duration::from_millis(length_ms);
                        scenario.link_faults =
                            vec![LinkFault { kind, direction, from, until, probability: 1.0 }];
                    }
                    Kind::CutOut => scenario.robot_faults = vec![RobotFault::CutOut { at: from }],
                    Kind::Restart => {
                        let pause = Duration::from_millis(length_ms);
                        scenario.robot_faults = vec![RobotFault::Restart { at: from, pause }];
                    }
                }
                let (seen, station) = thrown(&scenario);
                let hit = error_m(&seen).is_some_and(|error| error <= HIT_M);
                let word = match station.stage() {
                    Stage::Finished { .. } if seen.fault.is_none() && hit => "landed",
                    Stage::Finished { .. } => {
                        silent.push(format!("{name}, {phase}, {length_ms} ms: {:?}", seen.fault));
                        "SILENT"
                    }
                    Stage::Stopped { .. } => "stopped",
                    Stage::NotThrown { .. } => "not thrown",
                    // A robot that ends before it is ready: the station listens without a limit, the verdict says why.
                    Stage::Waiting if seen.fault.is_some() => {
                        let verdict = judge(&seen, station.stage(), &TARGET, HIT_M);
                        assert_eq!(verdict.outcome, Outcome::NotThrown, "{}", verdict.text);
                        "not thrown"
                    }
                    _ => {
                        silent.push(format!("{name}, {phase}, {length_ms} ms: no end"));
                        "NO END"
                    }
                };
                *told.entry(word.to_owned()).or_default() += 1;
                row.push(word);
                // After a new start of the program its set points stay where it began, until the fault is cleared.
                if matches!(kind, Kind::Restart) && phase != "waiting" {
                    let after: Vec<_> = seen.cycles.iter().filter(|cycle| cycle.at > from).collect();
                    let begins = after.windows(2).position(|pair| pair[1].ipoc < pair[0].ipoc);
                    if let Some(begins) = begins {
                        let held = after[begins + 1].set_deg;
                        let moved = after[begins + 1..].iter().any(|cycle| {
                            cycle.set_deg.iter().zip(&held).any(|(now, held)| (now - held).abs() > 1e-6)
                        });
                        assert!(!moved, "{name}, {phase}: a target of before");
                    }
                }
            }
        }
        println!("{name:<28} {}", row.join(", "));
    }
    println!("{told:?}");
    assert!(silent.is_empty(), "{silent:#?}");
    // Both outcomes occur, so the faults act.
    assert!(
        told.get("landed").is_some_and(|n| *n >= 20) && told.get("stopped").is_some_and(|n| *n >= 20),
        "{told:?}"
    );
}

/// A robot that takes any step of its set points: what ends a path is the client alone.
#[test]
fn one_late_answer_at_any_speed_is_caught_up_or_told_and_the_axes_end_on_the_path() {
    let (_, nominal) = thrown(&scenario(1));
    let Stage::Finished { started_at } = *nominal.stage() else { panic!("{:?}", nominal.stage()) };
    let last = plan().steps.last().expect("steps").q_rad;
    let mut fastest_caught_up = 0.0_f64;
    for k in (2..plan().steps.len() - 2).step_by(12) {
        let mut scenario = scenario(1);
        scenario.options.cut_out.acceleration_deg_s2 = [1e9; 6];
        scenario.options.cut_out.jerk_deg_s3 = [1e12; 6];
        scenario.options.cut_out.velocity_deg_s = Some([1e6; 6]);
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
                assert_eq!(fault.cause, firmware::fault::Cause::FollowingError, "step {k}");
            }
            other => panic!("step {k}: {other:?}"),
        }
        println!("step {k}, {fastest:.2} rad/s: {:?}", station.stage());
    }
    // An axis with 2 rad/s falls 0.08 rad behind until the cap lets it have its speed again.
    assert!(fastest_caught_up > 2.0, "{fastest_caught_up}");
}
