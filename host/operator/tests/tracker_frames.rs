//! Frames of the simulated tracker become a target or an error text, in virtual time; the command channel without a
//! socket; VRPN from a server written here by hand. Compared with the true position of the simulated body.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::rc::Rc;

use hil_sim::tracker::{
    BodyMotion, BodyOptions, Connection, Tracker, TrackerFault, TrackerFaultKind, TrackerOptions,
};
use operator::tracker::commands::{CommandError, Tracking};
use operator::tracker::frames::{DTrackFrames, FrameError, VrpnFrames};
use operator::tracker::target::{NoTarget, Target, TargetRequest};
use protocol::{Duration, Instant};

const IP: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
/// This machine's clock is not the tracker's.
const CLOCK_AHEAD: Duration = Duration::from_secs(1_000);

fn ms(ms: u64) -> Instant {
    Instant::from_micros(ms * 1_000)
}

/// A tracker of 60 Hz with its usual noise and latency; one body at (2.5, 0.05, 0.6) m.
fn options() -> TrackerOptions {
    let motion = BodyMotion::at_rest([2_500.0, 50.0, 600.0]);
    TrackerOptions { running: true, bodies: vec![BodyOptions { id: 0, motion }], ..TrackerOptions::default() }
}

fn with_fault(kind: TrackerFaultKind, from_ms: u64, until_ms: u64) -> TrackerOptions {
    let fault = TrackerFault { kind, from: ms(from_ms), until: ms(until_ms), probability: 1.0 };
    TrackerOptions { faults: vec![fault], ..options() }
}

/// What comes of the frames of a tracker within 10 s.
fn seen(options: TrackerOptions) -> Result<Option<Target>, FrameError> {
    seen_through(options, |_, datagram| vec![datagram])
}

/// As [`seen`], through a network that makes of each datagram, counted from 0, what `network` says.
fn seen_through(
    options: TrackerOptions,
    mut network: impl FnMut(u64, Vec<u8>) -> Vec<Vec<u8>>,
) -> Result<Option<Target>, FrameError> {
    let mut tracker = Tracker::new(options, 3);
    tracker.set_output(1, Some(SocketAddr::new(IP, 5_000)));
    let mut frames = DTrackFrames::new(TargetRequest::new(0), Instant::ZERO + CLOCK_AHEAD);
    let mut count = 0;
    while let Some(due) = tracker.poll_timeout().filter(|due| *due <= ms(10_000)) {
        tracker.handle_timeout(due);
        while let Some((_, datagram)) = tracker.poll_data(due) {
            for bytes in network(count, datagram) {
                if let Some(target) = frames.push(due + CLOCK_AHEAD, &bytes)? {
                    return Ok(Some(target));
                }
            }
            count += 1;
        }
        frames.wait(due + CLOCK_AHEAD)?;
    }
    Ok(None)
}

fn none(result: Result<Option<Target>, FrameError>) -> NoTarget {
    match result {
        Err(FrameError::NoTarget(none)) => none,
        other => panic!("{other:?}"),
    }
}

fn away_mm(target: &Target, at_mm: [f64; 3]) -> f64 {
    let squares: f64 = target.mean_m.iter().zip(at_mm).map(|(m, mm)| (1e3 * m - mm).powi(2)).sum();
    squares.sqrt()
}

#[test]
fn body_at_rest_is_where_it_is_within_its_noise() {
    let target = seen(options()).unwrap().expect("a target");
    let away = away_mm(&target, [2_500.0, 50.0, 600.0]);
    // Noise of 0.1 mm on each axis, 60 frames: five standard errors.
    assert!((1e-6..0.065).contains(&away), "{away} mm");
    assert!((0.1e-3..0.25e-3).contains(&target.scatter_m), "{target:?}");
}

#[test]
fn lost_body_is_refused_with_its_number_and_a_short_loss_is_bridged() {
    let error = none(seen(with_fault(TrackerFaultKind::Lost { body: 0 }, 400, 9_000)));
    assert!(matches!(error, NoTarget::Lost { body: 0, seen: 23..=25, missing: 11 }), "{error:?}");
    let target = seen(with_fault(TrackerFaultKind::Lost { body: 0 }, 400, 500)).unwrap().expect("a target");
    assert!((5..=7).contains(&target.missing), "{target:?}");
    let error = none(seen(with_fault(TrackerFaultKind::Unrecognised { body: 0 }, 0, 9_000)));
    assert!(matches!(error, NoTarget::NotSeen { body: 0, .. }), "{error:?}");
}

#[test]
fn body_that_was_moved_is_reported_as_a_jump_and_one_that_is_pushed_slowly_as_moving() {
    let by_mm = [0.0, 30.0, 0.0];
    let error = none(seen(with_fault(TrackerFaultKind::Moved { body: 0, by_mm }, 500, 9_000)));
    assert!(
        matches!(error, NoTarget::Jumps { body: 0, by_mm } if (29.0..31.0).contains(&by_mm)),
        "{error:?}"
    );
    let mut pushed = options();
    pushed.bodies[0].motion.velocity_mm_s = [0.0, 5.0, 0.0];
    assert!(matches!(none(seen(pushed)), NoTarget::Moves { body: 0, .. }));
}

#[test]
fn swinging_body_is_refused_also_where_its_mean_is_right() {
    let mut swinging = options();
    swinging.bodies[0].motion.swing_mm = [8.0, 0.0, 0.0];
    // Three whole swings within the 60 frames, one in each third: all means are those of a body at rest.
    swinging.bodies[0].motion.swing_period = Duration::from_micros(20 * 16_667);
    let error = none(seen(swinging));
    assert!(matches!(&error, NoTarget::Moves { what, .. } if what.contains("scatter")), "{error:?}");
}

#[test]
fn frames_that_are_delayed_are_stale_with_and_without_the_latency_of_the_tracker() {
    let delayed = |by_ms, send_ts2| TrackerOptions {
        send_ts2,
        ..with_fault(TrackerFaultKind::Delayed { by: Duration::from_millis(by_ms) }, 400, 9_000)
    };
    for send_ts2 in [true, false] {
        let error = none(seen(delayed(600, send_ts2)));
        assert!(matches!(error, NoTarget::Stale { .. }), "{send_ts2}: {error:?}");
        assert!(seen(delayed(100, send_ts2)).unwrap().is_some(), "{send_ts2}");
    }
}

#[test]
fn frame_that_comes_again_for_ever_is_stale_after_three_seconds() {
    let mut last = Vec::new();
    let error = none(seen_through(options(), |k, datagram| {
        if k <= 20 {
            last = datagram;
        }
        vec![last.clone()]
    }));
    assert!(
        matches!(&error, NoTarget::Stale { what } if what.contains("3.0 s") && what.contains("frame 21 ")),
        "{error:?}"
    );
    // From the very first frame on.
    let mut first = None;
    let frozen = |_, datagram: Vec<u8>| vec![first.get_or_insert(datagram).clone()];
    assert!(matches!(none(seen_through(options(), frozen)), NoTarget::Stale { .. }));
}

#[test]
fn numbers_that_go_on_while_the_time_stands_are_stale() {
    let mut first: Option<String> = None;
    let error = none(seen_through(options(), |k, datagram| {
        let text = String::from_utf8(datagram).expect("ASCII");
        let stands = first.get_or_insert(text).clone();
        let number = stands.lines().next().expect("a number").to_owned();
        vec![stands.replacen(&number, &format!("fr {}", k + 1), 1).into_bytes()]
    }));
    assert!(matches!(&error, NoTarget::Stale { what } if what.contains("time")), "{error:?}");
}

#[test]
fn one_datagram_torn_anywhere_does_not_end_a_measurement_and_moves_no_target() {
    for (torn, length) in [0, 30].into_iter().flat_map(|torn| (0..190).map(move |length| (torn, length))) {
        let target = seen_through(options(), |k, mut datagram| {
            if k == torn {
                datagram.truncate(length);
            }
            vec![datagram]
        });
        let target = target.unwrap_or_else(|e| panic!("{length} bytes of {torn}: {e}")).expect("a target");
        assert!(away_mm(&target, [2_500.0, 50.0, 600.0]) < 0.065, "{length} bytes of {torn}: {target:?}");
    }
}

#[test]
fn a_sender_that_is_no_tracker_is_refused_with_what_is_wrong() {
    let other = seen_through(options(), |_, _| vec![b"hello".to_vec()]);
    assert!(matches!(&other, Err(FrameError::Unreadable(what)) if what.contains("fr")), "{other:?}");
    let timeless = |_, datagram: Vec<u8>| {
        let text = String::from_utf8(datagram).expect("ASCII");
        let lines = text.split_inclusive('\n').filter(|line| !line.starts_with("ts"));
        vec![lines.collect::<String>().into_bytes()]
    };
    let other = seen_through(options(), timeless);
    assert!(matches!(&other, Err(FrameError::Unreadable(what)) if what.contains("`ts`")), "{other:?}");
}

#[test]
fn doubled_and_overtaken_datagrams_change_nothing() {
    let mut before: Option<Vec<u8>> = None;
    let doubled = seen_through(options(), |_, datagram| {
        let old = before.replace(datagram.clone());
        [Some(datagram.clone()), Some(datagram), old].into_iter().flatten().collect()
    });
    assert_eq!(doubled, seen(options()));
}

#[test]
fn silent_tracker_is_reported_and_a_restarted_one_is_measured_from_its_start() {
    let mut tracker = options();
    tracker.running = false;
    assert_eq!(seen(tracker), Ok(None), "no deadline of its own");
    let frames = DTrackFrames::new(TargetRequest::new(0), ms(0));
    assert_eq!(frames.wait(ms(2_999)), Ok(()));
    assert_eq!(frames.wait(ms(3_000)), Err(FrameError::Silent));
    // The counter falls from 30 to 1: ten frames later it is believed.
    let target = seen(with_fault(TrackerFaultKind::Restart, 500, 501)).unwrap().expect("a target");
    assert_eq!(target.frames, 60);
    // A tracker that starts again and again has no end.
    let mut restarting = options();
    restarting.faults = (1..60)
        .map(|k| TrackerFault {
            kind: TrackerFaultKind::Restart,
            from: ms(400 * k),
            until: ms(400 * k + 1),
            probability: 1.0,
        })
        .collect();
    let error = none(seen(restarting));
    assert!(matches!(&error, NoTarget::Stale { what } if what.contains("begins again")), "{error:?}");
}

/// The command channel of a simulated tracker, as a stream.
#[derive(Clone, Debug)]
struct Channel {
    tracker: Rc<RefCell<Tracker>>,
    connection: Connection,
    waiting: VecDeque<u8>,
    heard: Rc<RefCell<Vec<String>>>,
}

impl Channel {
    fn open(tracker: &Rc<RefCell<Tracker>>) -> Self {
        let connection = tracker.borrow_mut().connect(IP).expect("a place");
        Self { tracker: Rc::clone(tracker), connection, waiting: VecDeque::new(), heard: Rc::default() }
    }
}

impl Write for Channel {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned();
        self.heard.borrow_mut().push(text);
        self.tracker.borrow_mut().handle_command(ms(5), self.connection, bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Read for Channel {
    /// A byte at a time: answers come in pieces.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some((_, bytes)) = self.tracker.borrow_mut().poll_answer() {
            self.waiting.extend(bytes);
        }
        match (self.waiting.pop_front(), buffer.first_mut()) {
            (Some(byte), Some(place)) => {
                *place = byte;
                Ok(1)
            }
            _ => Ok(0),
        }
    }
}

fn idle_tracker() -> Rc<RefCell<Tracker>> {
    Rc::new(RefCell::new(Tracker::new(TrackerOptions { running: false, ..options() }, 1)))
}

#[test]
fn measurement_is_started_sends_to_the_port_of_this_machine_and_is_stopped_again() {
    let tracker = idle_tracker();
    let channel = Channel::open(&tracker);
    let heard = Rc::clone(&channel.heard);
    let tracking = Tracking::start(channel, 5_017).expect("started");
    assert_eq!(
        *heard.borrow(),
        [
            "dtrack2 get system access",
            "dtrack2 set output net ch01 udp my_ip 5017",
            "dtrack2 set output active ch01 all yes",
            "dtrack2 get status active",
            "dtrack2 tracking start",
        ]
    );
    assert!(tracker.borrow().is_measuring());
    let mut to = Vec::new();
    while to.is_empty() {
        let due = tracker.borrow().poll_timeout().expect("a flash");
        tracker.borrow_mut().handle_timeout(due);
        to.extend(tracker.borrow_mut().poll_data(due).map(|(to, _)| to));
    }
    assert_eq!(to, [SocketAddr::new(IP, 5_017)]);
    tracking.stop();
    assert!(!tracker.borrow().is_measuring());
}

#[test]
fn measurement_of_another_program_is_used_and_left_running() {
    let tracker = Rc::new(RefCell::new(Tracker::new(options(), 1)));
    assert!(tracker.borrow().is_measuring());
    let tracking = Tracking::start(Channel::open(&tracker), 5_000).expect("started");
    tracking.stop();
    assert!(tracker.borrow().is_measuring());
}

#[test]
fn tracker_that_another_client_commands_refuses_and_its_text_is_reported() {
    let tracker = idle_tracker();
    let _other = Channel::open(&tracker);
    let error = Tracking::start(Channel::open(&tracker), 5_000).expect_err("no access");
    assert!(
        matches!(&error, CommandError::Refused { command, answer }
        if command == "dtrack2 get system access" && answer.contains("none")),
        "{error}"
    );
    assert!(!tracker.borrow().is_measuring());
}

#[test]
fn channel_that_closes_or_answers_nonsense_is_an_error() {
    let tracker = idle_tracker();
    let channel = Channel::open(&tracker);
    tracker.borrow_mut().disconnect(channel.connection);
    assert!(matches!(Tracking::start(channel, 5_000), Err(CommandError::Stream(_))));
    let mut channel = Channel::open(&tracker);
    channel.waiting.extend(*b"hello\0");
    let error = Tracking::start(channel, 5_000).expect_err("no answer");
    assert!(matches!(&error, CommandError::Unreadable(text) if text == "hello"), "{error}");
}

/// A VRPN server with one tracker, whose stream is made here from the description of the wire format.
struct Vrpn;

impl Vrpn {
    fn message(at: Instant, sender: i32, kind: i32, body: &[u8]) -> Vec<u8> {
        let mut bytes = (24 + body.len() as u32).to_be_bytes().to_vec();
        let us = at.as_micros();
        for word in [(us / 1_000_000) as i32, (us % 1_000_000) as i32, sender, kind, 0] {
            bytes.extend(word.to_be_bytes());
        }
        bytes.extend(body);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    fn greeting(tracker: &str) -> Vec<u8> {
        let mut bytes = b"vrpn: ver. 07.33  0".to_vec();
        bytes.resize(24, 0);
        for (id, kind, text) in [(0, -1, tracker), (5, -2, "vrpn_Tracker Pos_Quat")] {
            let mut body = (text.len() as u32 + 1).to_be_bytes().to_vec();
            body.extend(text.as_bytes());
            body.push(0);
            bytes.extend(Self::message(ms(0), id, kind, &body));
        }
        bytes
    }

    fn pose(at: Instant, sensor: i32, [x, y, z]: [f64; 3]) -> Vec<u8> {
        let mut body = sensor.to_be_bytes().to_vec();
        body.extend([0; 4]);
        for number in [x, y, z, 0.0, 0.0, 0.0, 1.0] {
            body.extend(number.to_be_bytes());
        }
        Self::message(at, 0, 5, &body)
    }
}

/// Result of poses at 100 Hz for 10 s; `pose` gives stamp and position of each, `None`: the server sends another body.
fn vrpn(
    tracker: &str,
    pose: impl Fn(u64) -> Option<(Instant, [f64; 3])>,
) -> Result<Option<Target>, FrameError> {
    let mut frames = VrpnFrames::new(TargetRequest::new(2), tracker, ms(0));
    frames.push(ms(0), &Vrpn::greeting("Tracker0"))?;
    for k in 1..1_000 {
        let at = ms(10 * k);
        let mut stream = Vrpn::pose(at, 7, [9.0; 3]);
        if let Some((stamp, p)) = pose(k) {
            stream.extend(Vrpn::pose(stamp, 2, p));
        }
        // In two pieces, cut anywhere.
        let (first, rest) = stream.split_at((k % 80) as usize);
        for piece in [first, rest] {
            if let Some(target) = frames.push(at, piece)? {
                return Ok(Some(target));
            }
        }
    }
    Ok(None)
}

#[test]
fn poses_of_a_vrpn_server_make_a_target_in_metres_and_other_bodies_do_not() {
    let at = [2.5, 0.05, 0.6];
    let target = vrpn("Tracker0", |k| Some((ms(10 * k + 3), at))).unwrap().expect("a target");
    assert!(away_mm(&target, [2_500.0, 50.0, 600.0]) < 1e-6, "{target:?}");
    assert_eq!(target.frames, 60);
    assert_eq!(vrpn("Other", |k| Some((ms(10 * k), at))), Err(FrameError::Silent));
}

#[test]
fn vrpn_bodies_that_are_lost_swing_or_stand_in_time_are_refused() {
    let at = [2.5, 0.05, 0.6];
    let lost = none(vrpn("Tracker0", |k| (k < 30).then_some((ms(10 * k), at))));
    assert!(matches!(lost, NoTarget::Lost { body: 2, seen: 29, .. }), "{lost:?}");
    assert_eq!(vrpn("Tracker0", |_| None), Err(FrameError::Silent));
    let swings = |k: u64| Some((ms(10 * k), [2.5 + 0.01 * (0.6 * k as f64).sin(), 0.05, 0.6]));
    assert!(matches!(none(vrpn("Tracker0", swings)), NoTarget::Moves { body: 2, .. }));
    let frozen = |k: u64| Some((ms(10 * k.min(20)), at));
    assert!(matches!(none(vrpn("Tracker0", frozen)), NoTarget::Stale { .. }));
    // The stamps fall behind: the server sends data of half a second ago.
    let late =
        |k: u64| Some((ms(if k < 20 { 10 * k } else { (10 * k).saturating_sub(500).max(200 + k) }), at));
    let late = none(vrpn("Tracker0", late));
    assert!(matches!(late, NoTarget::Stale { .. }), "{late:?}");
    let nan = |k: u64| Some((ms(10 * k), [f64::NAN, 0.0, 0.0]));
    assert!(matches!(none(vrpn("Tracker0", nan)), NoTarget::NotAPose { body: 2, .. }));
}
