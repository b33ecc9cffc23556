//! Ends of a throw over RSI that this program did not order: the robot stops, its program ends, the link is lost;
//! and the effect of a signal. The simulated robot judges: where its axes stand, and whether the ball left its
//! hand.

use std::cell::Cell;
use std::sync::atomic::Ordering;

use crate::rsi_common::{HIT_M, TARGET, error_m, performed_by, plan};
use hil_sim::krc::bench::RobotFault;
use hil_sim::krc::{Direction, KrcScenario, LinkFault, LinkFaultKind};
use operator::dialogue::operator::OperatorError;
use operator::job::{Answer, JobError, Outcome, Progress, Question, Record, Step};
use operator::rsi::cell::Seen;
use protocol::{Duration, Instant};

/// How long a person thinks before the throw.
const THINKS: Duration = Duration::from_secs(2);

fn described() -> KrcScenario {
    let mut described = KrcScenario::open("kr-c2").expect("built in");
    described.options.hand.gripper.landing_z_m = Some(TARGET[2]);
    described.seed = 1;
    described
}

/// Throws; the flag of a signal is set at `signal`.
fn thrown(scenario: &KrcScenario, signal: Option<Instant>) -> (Record, Seen) {
    let (now, asked) = (Cell::new(Instant::ZERO), Cell::new(None));
    let at = |at: Instant, stop: &std::sync::atomic::AtomicBool| {
        now.set(at);
        if signal.is_some_and(|signal| at >= signal) {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let mut answers = |progress: Progress<'_>| match progress {
        Progress::May(Question::Throw) => {
            let since = asked.get().unwrap_or(now.get());
            asked.set(Some(since));
            // As the program: a signal is a no.
            match (signal, now.get().saturating_since(since) >= THINKS) {
                (Some(signal), _) if now.get() >= signal => Answer::No,
                (_, true) => Answer::Yes,
                (_, false) => Answer::Waiting,
            }
        }
        _ => Answer::Yes,
    };
    let (mut record, _) = performed_by(scenario, 0.3, &at, &mut answers);
    let seen = record.led.as_mut().and_then(|led| led.seen.take()).expect("simulated");
    (record, seen)
}

/// A time in each step of a throw, from one that nothing ends; and whether the ball is in the hand then.
fn places(record: &Record, seen: &Seen) -> Vec<(&'static str, Instant, bool)> {
    let ended = |step: Step| record.steps.iter().find(|(s, ..)| *s == step).expect("a step").2;
    let begun = |step: Step| record.steps.iter().find(|(s, ..)| *s == step).expect("a step").1;
    let (released, _) = seen.released.expect("released");
    let started = Duration::from_secs_f64(plan().release_time_s);
    vec![
        ("to the start", begun(Step::Approach) + Duration::from_millis(800), true),
        ("question", ended(Step::Approach) + Duration::from_secs(1), true),
        ("throw, ball held", released.saturating_sub(started) + Duration::from_millis(200), true),
        ("throw, just before the release", released.saturating_sub(Duration::from_millis(150)), true),
        ("throw, ball free", released + Duration::from_millis(150), false),
    ]
}

/// The axes stand: the robot has stopped by itself, or its set points are the same for the last half second.
fn stands(seen: &Seen, what: &str) {
    if seen.fault.is_some() {
        return;
    }
    let last = seen.cycles.last().expect("cycles");
    let half_a_second = seen
        .cycles
        .iter()
        .rev()
        .take_while(|cycle| last.at.saturating_since(cycle.at) < Duration::from_millis(500));
    for cycle in half_a_second {
        let moved = cycle.set_deg.iter().zip(&last.set_deg).any(|(a, b)| (a - b).abs() > 1e-6);
        assert!(!moved, "{what}: it moves at {:?}", cycle.at);
    }
}

#[test]
fn robot_that_stops_ends_or_is_lost_ends_a_throw_in_every_step_as_stopped() {
    let (clean, seen) = thrown(&described(), None);
    assert_eq!(clean.verdict.outcome, Outcome::Landed, "{}", clean.verdict.text);
    for (place, at, held) in places(&clean, &seen) {
        for kind in ["stop", "new start", "link lost"] {
            let mut scenario = described();
            match kind {
                "stop" => scenario.robot_faults = vec![RobotFault::CutOut { at }],
                "new start" => {
                    let pause = Duration::from_millis(300);
                    scenario.robot_faults = vec![RobotFault::Restart { at, pause }];
                }
                _ => {
                    let until = at + Duration::from_secs(60);
                    let fault = |direction| LinkFault {
                        kind: LinkFaultKind::Lost,
                        direction,
                        from: at,
                        until,
                        probability: 1.0,
                    };
                    scenario.link_faults = vec![fault(Direction::ToClient), fault(Direction::ToRobot)];
                }
            }
            let (record, seen) = thrown(&scenario, None);
            let what = format!("{kind}, {place}: {}", record.verdict.text);
            println!("{what}");
            assert_eq!(record.verdict.outcome, Outcome::Stopped, "{what}");
            let Some(JobError::Operator(error)) = &record.ended else { panic!("{what}") };
            assert!(matches!(error, OperatorError::RobotStopped { .. }), "{what}");
            assert!(error.next().is_some(), "{error}");
            assert_eq!(seen.released.is_none(), held, "{what}");
            assert_eq!(record.verdict.text.contains("the ball is in the hand"), held, "{what}");
            stands(&seen, &what);
        }
    }
}

#[test]
fn signal_in_every_step_of_a_throw_over_rsi_stops_the_arm_and_nothing_is_thrown_after_it() {
    let (clean, seen) = thrown(&described(), None);
    for (place, at, held) in places(&clean, &seen) {
        let (record, seen) = thrown(&described(), Some(at));
        let what = format!("{place}: {}", record.verdict.text);
        println!("{what}");
        let expected = if place == "question" { Outcome::NotThrown } else { Outcome::Stopped };
        assert_eq!(record.verdict.outcome, expected, "{what}");
        assert_eq!(seen.released.is_none(), held, "{what}");
        stands(&seen, &what);
        assert_eq!(seen.fault, None, "{what}: the robot need not stop by itself");
        if !held {
            // It flew on as it was thrown.
            assert!(error_m(&seen).is_some_and(|error_m| error_m < HIT_M), "{what}");
        }
    }
}
