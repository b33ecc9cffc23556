//! The simulated tracker, seen from its datagrams and its command channel.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use hil_sim::tracker::scenario::TrackerScenario;
use hil_sim::tracker::{
    BodyMotion, BodyOptions, Connection, Tracker, TrackerFault, TrackerFaultKind, TrackerOptions,
};
use protocol::{Duration, Instant};
use tracker_protocol::dtrack::{DataFrame, DayClock, Messages};

const EXAMPLE: &str = "fr 120\r\nts 44597.741924\r\n6dcal 1\r\n6d 1 [0 1.000][2500.000 50.000 1000.000 0.0000 0.0000 90.0000][0.000000 1.000000 0.000000 -1.000000 0.000000 0.000000 0.000000 0.000000 1.000000]\r\n3d 0\r\n";
const MIDNIGHT_US: u64 = 1_795_219_200_000_000;
const MS: fn(u64) -> Instant = |ms| Instant::from_micros(ms * 1000);

fn sink() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], 5000))
}

/// One body at (2.5, 0.05, 1.0) m, no noise, 100 Hz, measuring.
fn exact() -> TrackerOptions {
    let h = 0.5_f64.sqrt();
    let mut motion = BodyMotion::at_rest([2500.0, 50.0, 1000.0]);
    motion.rotation_wxyz = [h, 0.0, 0.0, h];
    TrackerOptions {
        period: Duration::from_millis(10),
        noise_mm: 0.0,
        noise_deg: 0.0,
        running: true,
        bodies: vec![BodyOptions { id: 0, motion }],
        ..TrackerOptions::default()
    }
}

fn with_fault(kind: TrackerFaultKind, from_ms: u64, until_ms: u64) -> TrackerOptions {
    let fault = TrackerFault { kind, from: MS(from_ms), until: MS(until_ms), probability: 1.0 };
    TrackerOptions { faults: vec![fault], ..exact() }
}

/// All datagrams until `until`, with the time at which each leaves.
fn collect(tracker: &mut Tracker, until: Instant) -> Vec<(Instant, Vec<u8>)> {
    let mut out = Vec::new();
    while let Some(due) = tracker.poll_timeout().filter(|due| *due <= until) {
        tracker.handle_timeout(due);
        while let Some((_, bytes)) = tracker.poll_data(due) {
            out.push((due, bytes));
        }
    }
    out
}

fn frames(options: TrackerOptions, until_ms: u64) -> Vec<(Instant, DataFrame)> {
    let mut tracker = Tracker::new(options, 1);
    tracker.set_output(1, Some(sink()));
    let read = |(at, bytes): (Instant, Vec<u8>)| (at, DataFrame::parse(&bytes).expect("a valid datagram"));
    collect(&mut tracker, MS(until_ms)).into_iter().map(read).collect()
}

#[test]
fn documented_datagram_is_sent_byte_by_byte() {
    let options = TrackerOptions {
        first_frame: 120,
        unix_us: MIDNIGHT_US + 44_597_741_924,
        send_ts2: false,
        ..exact()
    };
    let mut tracker = Tracker::new(options, 1);
    tracker.set_output(1, Some(sink()));
    let sent = collect(&mut tracker, MS(16));
    assert_eq!(sent.len(), 1);
    assert_eq!(String::from_utf8(sent[0].1.clone()).unwrap(), EXAMPLE);
}

#[test]
fn datagrams_leave_after_latency_and_jitter_and_contain_it() {
    let sent = frames(exact(), 10_020);
    assert!((1000..=1001).contains(&sent.len()), "{}", sent.len());
    let mut latencies = Vec::new();
    for (k, (at, frame)) in (0..).zip(&sent) {
        assert_eq!(frame.frame, 1 + k);
        let flash = MS(10 * k);
        let latency_us = at.saturating_since(flash).as_micros();
        assert!((15_000..=16_000).contains(&latency_us), "{latency_us} us");
        let ts2 = frame.ts2.unwrap();
        assert_eq!(ts2.latency_us, latency_us);
        assert_eq!(ts2.s * 1_000_000 + u64::from(ts2.us), MIDNIGHT_US + flash.as_micros());
        latencies.push(latency_us);
    }
    let mean = latencies.iter().sum::<u64>() as f64 / latencies.len() as f64;
    // Even over 1 ms: five standard deviations of the mean are 46 us.
    assert!((15_454.0..15_546.0).contains(&mean), "{mean}");
}

#[test]
fn noise_has_its_size_in_position_and_rotation() {
    let options =
        TrackerOptions { noise_mm: 0.2, noise_deg: 0.1, period: Duration::from_millis(1), ..exact() };
    let sent = frames(options, 4000);
    let (mut mm, mut deg) = (0.0, 0.0);
    for (_, frame) in &sent {
        let body = frame.bodies.as_ref().unwrap()[0];
        mm += (body.position_mm[1] - 50.0).powi(2);
        deg += (body.angles_deg.unwrap()[2] - 90.0).powi(2);
    }
    let (mm, deg) = ((mm / sent.len() as f64).sqrt(), (deg / sent.len() as f64).sqrt());
    // Five standard deviations of the estimates are 5.6 %.
    assert!((0.188..0.212).contains(&mm) && (0.094..0.106).contains(&deg), "{mm} mm, {deg} deg");
}

#[test]
fn lost_body_is_missing_and_returns_with_its_number() {
    let sent = frames(with_fault(TrackerFaultKind::Lost { body: 0 }, 100, 200), 400);
    for (k, (_, frame)) in (0..).zip(&sent) {
        let lost = (10..20).contains(&k);
        assert_eq!(frame.bodies.as_ref().unwrap().is_empty(), lost, "frame {k}");
        assert_eq!((frame.calibrated, frame.markers.as_ref().unwrap().len()), (Some(1), 0));
        assert_eq!(frame.pose(0, &mut DayClock::new()).unwrap().is_none(), lost);
    }
}

#[test]
fn unrecognised_body_shows_its_spheres_with_new_numbers_after_each_loss() {
    let mut options = with_fault(TrackerFaultKind::Unrecognised { body: 0 }, 100, 200);
    options.faults.push(TrackerFault { from: MS(300), until: MS(400), ..options.faults[0] });
    let sent = frames(options, 500);
    let numbers = |k: usize| -> Vec<u32> {
        sent[k].1.markers.as_ref().unwrap().iter().map(|marker| marker.id).collect()
    };
    assert_eq!((numbers(9), numbers(10)), (vec![], vec![1, 2, 3, 4, 5]));
    assert_eq!((numbers(19), numbers(20)), (vec![1, 2, 3, 4, 5], vec![]));
    assert_eq!((numbers(30), numbers(40)), (vec![6, 7, 8, 9, 10], vec![]));
    assert!(sent[10].1.bodies.as_ref().unwrap().is_empty());
    // The second sphere lies 60 mm along the body's x axis, which points along the room's y.
    let second = sent[10].1.markers.as_ref().unwrap()[1].position_mm;
    assert!((second[0] - 2500.0).abs() < 1e-3 && (second[1] - 110.0).abs() < 1e-3, "{second:?}");
}

#[test]
fn false_markers_leave_the_body_alone() {
    let sent = frames(with_fault(TrackerFaultKind::FalseMarkers { count: 3 }, 100, 200), 300);
    for (k, (_, frame)) in (0..).zip(&sent) {
        let expected = if (10..20).contains(&k) { 3 } else { 0 };
        assert_eq!(frame.markers.as_ref().unwrap().len(), expected);
        assert_eq!(frame.bodies.as_ref().unwrap().len(), 1);
    }
}

#[test]
fn moving_and_jumping_targets_are_where_the_truth_is_and_a_bias_is_not() {
    let mut options = with_fault(TrackerFaultKind::Moved { body: 0, by_mm: [0.0, 100.0, 0.0] }, 200, 300);
    options.bodies[0].motion.velocity_mm_s = [50.0, 0.0, 0.0];
    options.bodies[0].motion.swing_mm = [0.0, 0.0, 30.0];
    options.bodies[0].motion.swing_period = Duration::from_millis(400);
    options.faults.push(TrackerFault {
        kind: TrackerFaultKind::Bias { by_mm: [0.0, 0.0, 7.0] },
        from: MS(600),
        until: MS(700),
        probability: 1.0,
    });
    let tracker = Tracker::new(options.clone(), 1);
    for (k, (_, frame)) in (0..).zip(frames(options, 1000)) {
        let ms = 10 * k;
        let (truth, _) = tracker.truth(0, MS(ms)).unwrap();
        let t = ms as f64 * 1e-3;
        let jump = if (200..300).contains(&ms) { 100.0 } else { 0.0 };
        let swing = 30.0 * (std::f64::consts::TAU * t / 0.4).sin();
        let expected = [2500.0 + 50.0 * t, 50.0 + jump, 1000.0 + swing];
        assert!(truth.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{ms} ms: {truth:?}");
        let seen = frame.bodies.unwrap()[0].position_mm;
        let bias = if (600..700).contains(&ms) { 7.0 } else { 0.0 };
        let off = [seen[0] - truth[0], seen[1] - truth[1], seen[2] - truth[2] - bias];
        assert!(off.iter().all(|x| x.abs() <= 0.000_501), "{ms} ms: {off:?}");
    }
}

#[test]
fn lost_datagrams_and_a_divisor_leave_gaps_in_the_counter() {
    let numbers =
        |options| -> Vec<u64> { frames(options, 420).iter().map(|(_, frame)| frame.frame).collect() };
    let lost = numbers(with_fault(TrackerFaultKind::FramesLost, 100, 200));
    assert_eq!(lost, (1..=10).chain(21..=41).collect::<Vec<u64>>());
    let divided = numbers(TrackerOptions { divisor: 3, ..exact() });
    assert_eq!(divided, (1..=13).map(|k| 3 * k).collect::<Vec<u64>>());
    let late = frames(with_fault(TrackerFaultKind::Delayed { by: Duration::from_millis(25) }, 100, 110), 420);
    let order: Vec<u64> = late.iter().map(|(_, frame)| frame.frame).take(16).collect();
    assert_eq!(order[9..15], [10, 12, 13, 11, 14, 15], "overtaken, as datagrams can be");
}

#[test]
fn counter_begins_anew_after_a_restart_and_time_goes_on_over_midnight() {
    let mut options = with_fault(TrackerFaultKind::Restart, 200, 201);
    options.unix_us = MIDNIGHT_US - 300_000;
    options.send_ts2 = false;
    let sent = frames(options, 700);
    let numbers: Vec<u64> = sent.iter().map(|(_, frame)| frame.frame).collect();
    assert_eq!((numbers[19], numbers[20], numbers[21]), (20, 1, 2));
    let mut clock = DayClock::new();
    let stamps: Vec<Instant> = sent.iter().map(|(_, frame)| frame.stamp(&mut clock).unwrap()).collect();
    assert!(sent[0].1.ts_s.unwrap() > 86_399.0 && sent[40].1.ts_s.unwrap() < 1.0);
    assert!(
        stamps.windows(2).all(|w| w[1].saturating_since(w[0]).as_micros().abs_diff(10_000) <= 1),
        "{stamps:?}"
    );
}

#[test]
fn same_seed_gives_the_same_datagrams() {
    let run = |seed| {
        let fault = TrackerFault {
            kind: TrackerFaultKind::FramesLost,
            from: MS(0),
            until: MS(5000),
            probability: 0.3,
        };
        let options = TrackerOptions { noise_mm: 0.2, faults: vec![fault], ..exact() };
        let mut tracker = Tracker::new(options, seed);
        tracker.set_output(1, Some(sink()));
        collect(&mut tracker, MS(3000))
    };
    assert_eq!(run(4), run(4));
    assert_ne!(run(4), run(5));
}

const IP: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 7));

fn ask(tracker: &mut Tracker, connection: Connection, now: Instant, message: &str) -> String {
    tracker.handle_command(now, connection, message.as_bytes());
    tracker.handle_command(now, connection, &[0]);
    let mut messages = Messages::default();
    let mut answers = Vec::new();
    while let Some((to, bytes)) = tracker.poll_answer() {
        assert_eq!(to, connection);
        answers.extend(messages.push(&bytes));
    }
    assert_eq!(answers.len(), 1, "one answer per command: {answers:?}");
    answers.remove(0).unwrap()
}

#[test]
fn commands_are_answered_as_documented() {
    let mut tracker = Tracker::new(TrackerOptions { running: false, ..exact() }, 1);
    let first = tracker.connect(IP).unwrap();
    let table = [
        ("dtrack2 get system access", "dtrack2 set system access full"),
        ("dtrack2 get status active", "dtrack2 set status active none"),
        ("dtrack2 tracking stop", "dtrack2 ok"),
        ("dtrack2 set output net ch01 udp my_ip 5000", "dtrack2 ok"),
        ("dtrack2 set output net ch02 udp 192.168.0.9 5001", "dtrack2 ok"),
        ("dtrack2 set output net ch03 udp somewhere 5001", "dtrack2 err 5 \"not an address\""),
        ("dtrack2 set output active ch01 all yes", "dtrack2 ok"),
        ("dtrack2 set output active ch02 6d yes", "dtrack2 err 5 \"only 'all' can be switched\""),
        ("dtrack2 get config active_config", "dtrack2 set config active_config standard"),
        ("dtrack2 set config active_config other", "dtrack2 err 6 \"no such configuration\""),
        ("dtrack2 set config active_config standard", "dtrack2 ok"),
        ("dtrack2 getmsg", "dtrack2 ok"),
        ("dtrack2 tracking start", "dtrack2 ok"),
        ("dtrack2 tracking start", "dtrack2 err 4 \"measurement is running\""),
        ("dtrack2 get status active", "dtrack2 set status active mea"),
        ("dtrack2 tracking  stop", "dtrack2 err 1 \"unknown command\""),
        ("hello", "dtrack2 err 1 \"unknown command\""),
        ("", "dtrack2 err 1 \"unknown command\""),
    ];
    for (command, answer) in table {
        assert_eq!(ask(&mut tracker, first, MS(5), command), answer, "{command}");
    }
    let long = "x".repeat(5000);
    assert_eq!(ask(&mut tracker, first, MS(5), &long), "dtrack2 err 2 \"message too long or not ASCII\"");
    // Channel 1 goes to the client, channel 2 is not active.
    let mut data = Vec::new();
    while let Some(due) = tracker.poll_timeout().filter(|due| *due <= MS(42)) {
        tracker.handle_timeout(due);
        data.extend(std::iter::from_fn(|| tracker.poll_data(due)).map(|(to, _)| to));
    }
    assert_eq!(data, [SocketAddr::new(IP, 5000); 2]);
    assert_eq!(ask(&mut tracker, first, MS(50), "dtrack2 tracking stop"), "dtrack2 ok");
    assert!(!tracker.is_measuring());
    assert_eq!(ask(&mut tracker, first, MS(50), "dtrack2 set output net ch01 none"), "dtrack2 ok");
}

#[test]
fn second_connection_may_only_ask_until_the_first_leaves() {
    let mut tracker = Tracker::new(exact(), 1);
    let first = tracker.connect(IP).unwrap();
    let second = tracker.connect(IP).unwrap();
    let now = MS(1);
    assert_eq!(ask(&mut tracker, second, now, "dtrack2 get system access"), "dtrack2 set system access none");
    assert_eq!(ask(&mut tracker, second, now, "dtrack2 get status active"), "dtrack2 set status active mea");
    let refused = "dtrack2 err 3 \"no access: another client is connected\"";
    for command in ["dtrack2 tracking stop", "dtrack2 getmsg", "dtrack2 set output net ch01 none"] {
        assert_eq!(ask(&mut tracker, second, now, command), refused);
    }
    assert!(tracker.is_measuring());
    tracker.disconnect(first);
    tracker.handle_command(now, first, b"dtrack2 tracking stop\0");
    assert!(tracker.is_measuring() && tracker.poll_answer().is_none());
    let third = tracker.connect(IP).unwrap();
    assert_eq!(ask(&mut tracker, third, now, "dtrack2 get system access"), "dtrack2 set system access full");
    assert_eq!(ask(&mut tracker, second, now, "dtrack2 get system access"), "dtrack2 set system access none");
    let more = std::iter::from_fn(|| tracker.connect(IP)).take(100).count();
    assert_eq!(more, 6, "eight connections at most");
}

#[test]
fn restart_of_the_tracker_is_a_message() {
    let mut tracker = Tracker::new(with_fault(TrackerFaultKind::Restart, 100, 101), 1);
    let client = tracker.connect(IP).unwrap();
    assert_eq!(ask(&mut tracker, client, MS(1), "dtrack2 getmsg"), "dtrack2 ok");
    collect(&mut tracker, MS(150));
    let message = ask(&mut tracker, client, MS(150), "dtrack2 getmsg");
    assert_eq!(message, "dtrack2 msg system warning 1 1 \"controller started again\"");
    assert_eq!(ask(&mut tracker, client, MS(150), "dtrack2 getmsg"), "dtrack2 ok");
}

#[test]
fn scenario_that_comes_with_the_program_is_read_and_wrong_ones_are_refused() {
    let text = include_str!("../scenarios/tracker/target.toml");
    let scenario = TrackerScenario::from_toml("a.toml", text).unwrap();
    assert_eq!(scenario.options.bodies.len(), 1);
    let h = 0.5_f64.sqrt();
    let q = scenario.options.bodies[0].motion.rotation_wxyz;
    assert!(q.iter().zip([h, 0.0, 0.0, h]).all(|(a, b)| (a - b).abs() < 1e-12), "{q:?}");
    let table = [
        ("[[fault]]\nkind = \"lost\"\nbody = 1\n", "there is no body 1"),
        ("[[body]]\nid = 0\nposition_mm = [0, 0, 0]\n", "body 0 is there already"),
        ("[[fault]]\nkind = \"moved\"\nbody = 0\n", "by_mm: missing"),
        ("[[fault]]\nkind = \"bias\"\nby_mm = [1e9, 0, 0]\n", "each of -100000 to 100000 mm"),
        ("[[body]]\nid = 1\n", "position_mm: missing"),
        ("[[fault]]\nkind = \"lots\"\n", "kind"),
    ];
    for (more, reason) in table {
        let error = TrackerScenario::from_toml("a.toml", &format!("{text}{more}")).unwrap_err().to_string();
        let line: usize = error.split(':').nth(1).unwrap().parse().unwrap();
        assert!(line > text.lines().count() && error.contains(reason), "{more}: {error}");
    }
}
