//! What each fault of the network and of the robot does to a running exchange.

use crate::krc_rig::{Answer, MS, Rig, config, fault, refused, wide};
use hil_sim::krc::options::{KrcOptions, Space};
use hil_sim::krc::{
    Bench, Client, Direction, KrcEvent, LinkFault, LinkFaultKind, LinkOptions, RobotFault, State,
};
use hil_sim::rng::Rng;
use protocol::Duration;
use rsi_protocol::Generation;

use Direction::{ToClient, ToRobot};
use LinkFaultKind::{Doubled, Late, Lost, Reordered, Torn, WithoutAxes, WrongIpoc};

const fn late_ms(ms: u64) -> LinkFaultKind {
    Late(Duration::from_millis(ms))
}

/// A sine of 3 deg and 4.8 s on A1.
fn sine(k: u64) -> Answer {
    let phase = k as f64 * 0.012 * std::f64::consts::TAU / 4.8;
    Answer {
        correction: [3.0 * phase.sin() * (k as f64 / 50.0).min(1.0), 0.0, 0.0, 0.0, 0.0, 0.0],
        ..Answer::default()
    }
}

fn summary<C: Client>(bench: &Bench<C>) -> (u64, Vec<&'static str>, &'static str) {
    let end = match (bench.krc.state(), fault(&bench.events)) {
        (_, Some((_, cause))) => cause.name(),
        (State::Run, None) => "runs",
        (_, None) => "off",
    };
    (bench.krc.late(), refused(&bench.events), end)
}

/// One telegram, or its answer, at 1.2 s of an exchange with 12 ms.
#[test]
fn one_fault_of_the_network_costs_at_most_one_answer() {
    type Row = (&'static str, LinkFaultKind, Direction, u64, &'static [&'static str]);
    let table: [Row; 21] = [
        ("UDP", Lost, ToRobot, 1, &[]),
        ("UDP", Lost, ToClient, 1, &[]),
        ("UDP", late_ms(5), ToRobot, 0, &[]),
        ("UDP", late_ms(5), ToClient, 0, &[]),
        ("UDP", late_ms(11), ToRobot, 1, &["outside-window"]),
        ("UDP", late_ms(11), ToClient, 1, &["outside-window"]),
        ("UDP", late_ms(13), ToRobot, 1, &["wrong-ipoc"]),
        ("UDP", late_ms(13), ToClient, 1, &["wrong-ipoc"]),
        ("UDP", Doubled, ToRobot, 0, &["second"]),
        ("UDP", Doubled, ToClient, 0, &["second"]),
        ("UDP", Reordered, ToRobot, 1, &["wrong-ipoc"]),
        ("UDP", Reordered, ToClient, 1, &["wrong-ipoc"]),
        ("UDP", Torn, ToRobot, 1, &["unreadable"]),
        ("UDP", Torn, ToClient, 1, &[]),
        ("UDP", WrongIpoc(1), ToRobot, 1, &["wrong-ipoc"]),
        ("UDP", WrongIpoc(-1), ToClient, 1, &["wrong-ipoc"]),
        // The client of this test has no answer to it.
        ("UDP", WithoutAxes, ToClient, 1, &[]),
        ("TCP", Torn, ToRobot, 1, &["torn"]),
        ("TCP", Doubled, ToRobot, 0, &["second"]),
        // The stream keeps the order: the next answer comes right behind and counts.
        ("TCP", late_ms(13), ToRobot, 1, &["wrong-ipoc"]),
        ("TCP", late_ms(5), ToClient, 0, &[]),
    ];
    for (protocol, kind, direction, late, words) in table {
        let mut rig = Rig::new(KrcOptions::new(Generation::KrC2));
        rig.config = config(protocol, Space::Axes, true);
        rig.link.in_order = protocol == "TCP";
        rig.link_faults =
            vec![LinkFault { kind, direction, from: MS(1195), until: MS(1205), probability: 1.0 }];
        let mut bench = rig.start(sine);
        bench.run(MS(5000));
        assert_eq!(bench.link.counts(), [1], "{protocol} {kind:?} {direction:?}");
        assert_eq!(summary(&bench), (late, words.to_vec(), "runs"), "{protocol} {kind:?} {direction:?}");
    }
}

/// The same faults without end stop the robot by its late limit, unless the answers still come in time.
#[test]
fn lasting_faults_of_the_network_end_at_the_late_limit() {
    let stopped = [Lost, late_ms(11), late_ms(30), Reordered, Torn, WrongIpoc(4)];
    for direction in [ToRobot, ToClient] {
        for (kind, end) in stopped
            .map(|kind| (kind, "late-limit"))
            .into_iter()
            .chain([(late_ms(9), "runs"), (Doubled, "runs")])
        {
            // Reordering every telegram but the last delays each by one cycle.
            let mut rig = Rig::new(KrcOptions::new(Generation::KrC2));
            rig.link_faults =
                vec![LinkFault { kind, direction, from: MS(1195), until: MS(60_000), probability: 1.0 }];
            let mut bench = rig.start(|_| Answer::default());
            bench.run(MS(4000));
            let (late, _, got) = summary(&bench);
            assert_eq!(got, end, "{kind:?} {direction:?}");
            assert_eq!(late, if end == "runs" { 0 } else { 101 }, "{kind:?} {direction:?}");
            if end != "runs" {
                let (at, _) = fault(&bench.events).unwrap();
                assert_eq!(at, MS(1200 + 100 * 12 + 10), "{kind:?} {direction:?}");
                assert!(
                    bench.client.received.iter().all(|(sent, _)| *sent <= at + Duration::from_millis(30))
                );
            }
        }
    }
}

#[test]
fn faults_of_the_robot_stop_it_where_it_is_and_a_restart_begins_there() {
    for (robot_fault, end) in [
        (RobotFault::CutOut { at: MS(1206) }, "cut-out"),
        (RobotFault::Restart { at: MS(1206), pause: Duration::from_millis(300) }, "runs"),
    ] {
        let mut rig = Rig::new(KrcOptions::new(Generation::KrC2));
        rig.robot_faults = vec![robot_fault];
        let mut bench = rig.start(|k| if k < 100 { sine(k) } else { Answer::default() });
        bench.run(MS(5000));
        let (late, _, got) = summary(&bench);
        assert_eq!((late, got), (0, end));
        // 3 deg at 1.2 s is the crest of the sine: there is nothing to brake.
        let stands = bench.krc.actual(bench.now()).q_deg[0];
        assert!((2.98..3.02).contains(&stands), "{stands}");
    }
}

#[test]
fn closed_connection_stops_the_robot() {
    let mut rig = Rig::new(wide(Generation::KrC2));
    rig.config = config("TCP", Space::Axes, true);
    let mut bench = rig.start(sine);
    bench.run(MS(1000));
    bench.krc.connection_lost(MS(1000));
    bench.run(MS(3000));
    assert_eq!(summary(&bench), (0, vec![], "connection-lost"));
}

/// With any fault of the network: the set points that reach the drives keep all limits, nothing is sent after a
/// fault, and the same seed gives the same log.
#[test]
fn random_faults_never_break_the_limits_and_repeat_exactly() {
    let (mut faults_seen, mut runs_on) = (0, 0);
    for seed in 0..150 {
        let run = || {
            let mut rng = Rng::stream(seed, "random faults");
            let generation = if rng.chance(0.5) { Generation::KrC2 } else { Generation::KrC4 };
            let mut rig = Rig::new(KrcOptions::new(generation));
            rig.seed = seed;
            let hold = rng.chance(0.7);
            rig.config = config("UDP", Space::Axes, hold);
            rig.options.lag.noise_deg = 0.001;
            rig.link = LinkOptions {
                delay: Duration::from_micros(rng.within(0, 1000)),
                jitter: Duration::from_micros(rng.within(0, 2000)),
                in_order: false,
            };
            let kinds =
                [Lost, late_ms(3), late_ms(20), Doubled, Reordered, Torn, WrongIpoc(1), WrongIpoc(-12)];
            for _ in 0..rng.within(0, 4) {
                let from = rng.within(0, 2000);
                rig.link_faults.push(LinkFault {
                    kind: kinds[rng.below(kinds.len() as u64) as usize],
                    direction: if rng.chance(0.5) { ToRobot } else { ToClient },
                    from: MS(from),
                    until: MS(from + rng.within(1, 1000)),
                    probability: rng.unit() * 0.3,
                });
            }
            if rng.chance(0.3) {
                let (at, pause) = (MS(rng.within(1, 3000)), Duration::from_millis(rng.within(0, 500)));
                rig.robot_faults.push(RobotFault::Restart { at, pause });
            }
            let mut bench = rig.start(move |k| Answer { outputs: i32::from(k > 150), ..sine(k) });
            bench.run(MS(4000));
            bench
        };
        let bench = run();
        assert_eq!(bench.log(), run().log(), "seed {seed}");
        let (_, _, end) = summary(&bench);
        runs_on += u64::from(end == "runs");
        faults_seen += u64::from(end != "runs" && end != "off");
        let mut last: Option<(u64, f64)> = None;
        let mut over = false;
        for event in &bench.events {
            match event {
                KrcEvent::Started { .. } => (over, last) = (false, None),
                KrcEvent::Fault { .. } | KrcEvent::Stopped { .. } => over = true,
                KrcEvent::Cycle(cycle) => {
                    assert!(!over, "seed {seed}: a telegram after the end");
                    let at = cycle.at.as_micros();
                    if let Some((before, q)) = last {
                        let speed = (cycle.set_deg[0] - q) / ((at - before) as f64 * 1e-6);
                        assert!(speed.abs() <= 150.001, "seed {seed}: {speed} deg/s");
                    }
                    last = Some((at, cycle.set_deg[0]));
                    assert!(cycle.set_deg[0].abs() <= 6.1, "seed {seed}: {}", cycle.set_deg[0]);
                    assert!(cycle.actual_deg.iter().all(|q| q.is_finite()), "seed {seed}");
                }
                _ => {}
            }
        }
    }
    // Both ends occur, or the test shows nothing.
    assert!(faults_seen >= 15 && runs_on >= 15, "{faults_seen} faults, {runs_on} runs");
}
