//! The exchange of telegrams, seen from a client on the bench.

use crate::krc_rig::{ARM, Answer, MS, Rig, between, config, fault, refused, running, wide};
use hil_sim::krc::options::{KrcOptions, Space};
use hil_sim::krc::{FaultCause, Krc, KrcEvent, State};
use protocol::{Duration, Instant};
use rsi_protocol::Generation;

const C2: Generation = Generation::KrC2;
const C4: Generation = Generation::KrC4;

/// The documented telegrams of a robot at rest in the common start pose.
#[test]
fn first_telegrams_of_a_kr_c2_are_the_documented_ones_byte_by_byte() {
    let mut bench = Rig::new(KrcOptions::new(C2)).start(|_| Answer::default());
    bench.run_cycles(1);
    let first = r#"<Rob Type="KUKA"><IPOC>4710</IPOC></Rob>"#;
    let second = r#"<Rob Type="KUKA"><RIst X="930.0000" Y="0.0000" Z="1162.0000" A="180.0000" B="0.0000" C="180.0000"/><RSol X="930.0000" Y="0.0000" Z="1162.0000" A="180.0000" B="0.0000" C="180.0000"/><AIPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/><ASPos A1="0.0000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="90.0000" A6="0.0000"/><Delay D="0"/><IPOC>4711</IPOC></Rob>"#;
    let received: Vec<(Instant, &str)> =
        bench.client.received.iter().map(|(at, text)| (*at, text.as_str())).collect();
    assert_eq!(received, [(MS(0), first), (MS(12), second)]);
}

#[test]
fn kr_c4_begins_with_a_full_telegram_and_counts_milliseconds() {
    for cycle_ms in [4, 12] {
        let mut options = KrcOptions::new(C4);
        options.cycle = Duration::from_millis(cycle_ms);
        options.window = options.cycle;
        let mut bench = Rig::new(options).start(|_| Answer::default());
        bench.run_cycles(250);
        let ipoc = |text: &String| between(text, "<IPOC>", "</IPOC>").unwrap().parse::<u64>().unwrap();
        let received = &bench.client.received;
        assert!(received[0].1.contains(r#"<AIPos A1="0.0" A2="-90.0""#), "{}", received[0].1);
        let (start, numbers) = (ipoc(&received[0].1), received.iter().map(|(_, text)| ipoc(text)));
        let expected: Vec<u64> = (0..=250).map(|k| start + k * cycle_ms).collect();
        assert_eq!(numbers.collect::<Vec<_>>(), expected);
        assert!(
            received.windows(2).all(|w| w[1].0.saturating_since(w[0].0) == Duration::from_millis(cycle_ms))
        );
    }
}

#[test]
fn ten_thousand_cycles_have_no_late_answer_in_both_generations_over_datagrams_and_stream() {
    for (generation, protocol) in [(C2, "UDP"), (C2, "TCP"), (C4, "UDP")] {
        let mut rig = Rig::new(wide(generation));
        rig.config = config(protocol, Space::Axes, true);
        rig.link.in_order = protocol == "TCP";
        rig.link.delay = Duration::from_micros(100);
        rig.link.jitter = Duration::from_micros(900);
        let sine = |k: u64| 5.0 * (k as f64 * 0.01).sin();
        let mut bench = rig.start(move |k| Answer { correction: [sine(k); 6], ..Answer::default() });
        bench.run_cycles(10_002);
        assert_eq!((bench.krc.late(), bench.krc.state()), (0, State::Run), "{generation:?} {protocol}");
        assert_eq!(refused(&bench.events), Vec::<&str>::new());
        // The answer to telegram k is the set point of telegram k + 1.
        assert!(bench.client.full >= 10_000);
        let set: Vec<f64> = bench
            .events
            .iter()
            .filter_map(|event| match event {
                KrcEvent::Cycle(cycle) => Some(cycle.set_deg[0]),
                _ => None,
            })
            .collect();
        let first_full = usize::from(generation == C2);
        for k in [0_usize, 1, 57, 9000] {
            let expected = (sine(k as u64) * 1e6).round() / 1e6;
            assert!(
                (set[first_full + k + 1] - expected).abs() < 1e-12,
                "{k}: {} {expected}",
                set[first_full + k + 1]
            );
        }
    }
}

#[test]
fn answer_counts_until_just_before_the_window_ends() {
    for (generation, window_us) in [(C2, 10_000), (C4, 4_000)] {
        for (after_us, late) in [(window_us - 1, 0), (window_us, 20)] {
            let mut options = wide(generation);
            options.late.limit = 1000;
            let mut bench = Rig::new(options)
                .start(move |_| Answer { after: Duration::from_micros(after_us), ..Answer::default() });
            // One cycle for the first telegram of a KR C2, and the last window is not over.
            bench.run_cycles(20 + u64::from(generation == C2));
            assert_eq!(bench.krc.late(), late, "{generation:?}, answer after {after_us} us");
        }
    }
}

#[test]
fn answers_with_a_wrong_number_or_type_or_twice_do_not_count() {
    let run = |ipoc_off: i64| {
        let mut options = wide(C2);
        options.late.limit = 1000;
        let mut bench = Rig::new(options)
            .start(move |k| Answer { ipoc_off: if k == 5 { ipoc_off } else { 0 }, ..Answer::default() });
        bench.run_cycles(20);
        (bench.krc.late(), refused(&bench.events))
    };
    assert_eq!(run(0), (0, vec![]));
    for off in [-1, 1, 4, 12] {
        assert_eq!(run(off), (1, vec!["wrong-ipoc"]), "IPOC {off:+}");
    }
    let mut krc = Krc::new(ARM.clone(), config("UDP", Space::Axes, true), wide(C2), 1).unwrap();
    krc.start().unwrap();
    krc.connected(MS(0));
    krc.handle_timeout(MS(12));
    let answer = |kind: &str, ipoc: u64| format!("<Sen{kind}><IPOC>{ipoc}</IPOC></Sen>");
    for text in [
        answer(" Type=\"Other\"", 4711),
        answer("", 4711),
        answer(" Type=\"ImFree\"", 4711).replace("/Sen", "/Rob"),
        "<Sen Type=\"ImFree\"><AK A1=\"1e9\"/><IPOC>4711</IPOC></Sen>".to_owned(),
        answer(" TYPE=\"ImFree\"", 4711),
        answer(" Type=\"ImFree\"", 4711),
    ] {
        krc.handle_bytes(MS(13), text.as_bytes());
    }
    let events: Vec<KrcEvent> = std::iter::from_fn(|| krc.poll_event()).collect();
    assert_eq!(refused(&events), ["wrong-type", "wrong-type", "unreadable", "unreadable", "second"]);
}

#[test]
fn counter_of_late_answers_stops_the_robot_one_above_its_limit() {
    // Every third answer is missing: in all they add up, in a row they never do.
    for (consecutive, missing_from, expected_late, stops) in
        [(false, 3, 5, true), (true, 3, 5, false), (true, 1, 5, true), (false, 1, 4, false)]
    {
        let mut options = wide(C2);
        options.late.limit = 4;
        options.late.consecutive = consecutive;
        let mut bench = Rig::new(options).start(move |k| Answer {
            silent: k % missing_from == 0 && k / missing_from < expected_late,
            ..Answer::default()
        });
        bench.run_cycles(30);
        let case = format!("consecutive {consecutive}, each {missing_from}");
        assert_eq!(bench.krc.late(), expected_late, "{case}");
        match fault(&bench.events) {
            Some((at, FaultCause::LateLimit { late: 5 })) if stops => {
                // The window of the fifth missing answer.
                assert_eq!(at, MS(12 + 4 * missing_from * 12 + 10), "{case}");
                let last = bench.client.received.last().unwrap();
                assert!(last.0 < at, "a telegram after the fault: {last:?}");
                assert!(last.1.contains("<Delay D=\"4\"/>"), "{}", last.1);
            }
            other => assert!(!stops && other.is_none(), "{case}: {other:?}"),
        }
    }
}

#[test]
fn share_of_late_answers_warns_once_or_stops() {
    for stops in [false, true] {
        let mut options = wide(C2);
        options.late.limit = 1000;
        options.late.field_of_view = 20;
        options.late.percent_stops = stops;
        // 10 of 20 late is not above 50 percent; 11 of 20 is.
        let mut bench =
            Rig::new(options).start(|k| Answer { silent: k % 2 == 0 || k == 41, ..Answer::default() });
        bench.run_cycles(80);
        let warnings: Vec<Instant> = bench
            .events
            .iter()
            .filter_map(|event| match event {
                KrcEvent::LateWarning { at } => Some(*at),
                _ => None,
            })
            .collect();
        assert_eq!(warnings, [MS(12 + 41 * 12 + 10)]);
        assert_eq!(fault(&bench.events).map(|(_, cause)| cause.name()), stops.then_some("late-percent"));
    }
}

#[test]
fn robot_that_only_sends_expects_no_answers() {
    let mut rig = Rig::new(wide(C4));
    rig.config.only_send = true;
    let mut bench = rig.start(|_| Answer { silent: true, ..Answer::default() });
    bench.run_cycles(500);
    assert_eq!((bench.krc.late(), running(&bench), bench.client.received.len()), (0, true, 501));
}

#[test]
fn programmed_pose_stays_while_the_actual_pose_moves() {
    let mut bench = Rig::new(wide(C2)).start(|k| Answer {
        correction: [0.05 * (k.min(100) as f64), 0.0, 0.0, 0.0, 0.0, 0.0],
        ..Answer::default()
    });
    bench.run_cycles(200);
    let text = &bench.client.received.last().unwrap().1;
    assert!(text.contains(r#"<RSol X="930.0000" Y="0.0000" Z="1162.0000""#), "{text}");
    assert!(
        text.contains(r#"<ASPos A1="0.0000""#) && text.contains(r#"<AIPos A1="5.0000" A2="-90.0000""#),
        "{text}"
    );
    // A1 of this robot turns about -z.
    let (x, y) = (930.0 * 5_f64.to_radians().cos(), -930.0 * 5_f64.to_radians().sin());
    assert!(text.contains(&format!("<RIst X=\"{x:.4}\" Y=\"{y:.4}\" Z=\"1162.0000\"")), "{text}");
}

#[test]
fn stop_ends_the_motion_without_a_fault_and_text_is_shown_once() {
    let mut bench = Rig::new(wide(C2)).start(|k| Answer {
        stop: k == 10,
        text: (k == 3).then_some("Info: hello"),
        ..Answer::default()
    });
    bench.run_cycles(40);
    assert_eq!((bench.krc.state(), bench.client.full), (State::Off, 11));
    let texts: Vec<&KrcEvent> = bench.events.iter().filter(|e| matches!(e, KrcEvent::Text { .. })).collect();
    assert_eq!(texts, [&KrcEvent::Text { at: MS(60), text: "Info: hello".to_owned() }]);
    assert!(bench.events.contains(&KrcEvent::Stopped { at: MS(144) }), "{}", bench.log());
}

#[test]
fn new_start_begins_where_the_arm_stands_and_counts_anew() {
    use hil_sim::krc::RobotFault;
    let mut rig = Rig::new(wide(C2));
    rig.robot_faults = vec![RobotFault::Restart { at: MS(1200), pause: Duration::from_millis(50) }];
    let mut bench = rig.start(|k| Answer {
        // 6 deg/s; after the restart (full telegrams go on counting) zero.
        correction: [if k < 100 { 0.072 * k as f64 } else { 0.0 }, 0.0, 0.0, 0.0, 0.0, 0.0],
        ..Answer::default()
    });
    bench.run_cycles(400);
    let starts: Vec<Instant> = bench
        .events
        .iter()
        .filter_map(|event| match event {
            KrcEvent::Started { at } => Some(*at),
            _ => None,
        })
        .collect();
    assert_eq!(starts.len(), 2, "{starts:?}");
    assert!(starts[1] >= MS(1250) && running(&bench));
    // The set point of the cycle at 1188 ms answers telegram 97; then 6^2 / (2 * 600) deg of braking.
    let stands = 0.072 * 97.0 + 6.0 * 6.0 / 1200.0;
    let start = bench.krc.start_deg()[0];
    assert!((start - stands).abs() < 1e-9, "{start} {stands}");
    let ipoc = |wanted: Instant| {
        let text = bench.client.received.iter().find(|(at, _)| *at >= wanted).unwrap();
        between(&text.1, "<IPOC>", "</IPOC>").unwrap().to_owned()
    };
    assert_eq!((ipoc(MS(0)).as_str(), ipoc(starts[1]).as_str()), ("4710", "4710"));
    // No correction of the old run moves the new one.
    let end = bench.krc.actual(bench.now()).q_deg[0];
    assert!((end - stands).abs() < 1e-6, "{end} {stands}");
}

#[test]
fn options_that_do_not_fit_the_configuration_file_are_refused() {
    let refusal = |change: fn(&mut Rig)| {
        let mut rig = Rig::new(wide(C4));
        change(&mut rig);
        Krc::new(ARM.clone(), rig.config, rig.options, 1)
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default()
    };
    assert_eq!(refusal(|_| {}), "");
    assert_eq!(
        refusal(|rig| rig.config = config("TCP", Space::Axes, true)),
        "PROTOCOL is TCP: a KR C4 has UDP only"
    );
    assert_eq!(
        refusal(|rig| rig.config = config("UDP", Space::Base, true)),
        "RECEIVE has no element with attributes A1 to A6 of type DOUBLE"
    );
    assert!(refusal(|rig| rig.config.length_prefix = true).starts_with("PROTCOLLENGTH is On"));
    assert!(refusal(|rig| rig.options.window = Duration::from_millis(5)).contains("not within the cycle"));
    assert!(refusal(|rig| rig.options.lag.dead_time = Duration::from_millis(3)).contains("below one cycle"));
    assert!(refusal(|rig| rig.options.start_deg[1] = 36.0).starts_with("start pose: A2 = 36"));
    assert!(refusal(|rig| rig.options.correction.lower[0] = 1.0).contains("must include zero"));
}
