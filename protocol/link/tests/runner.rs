//! The runner with nodes that record their calls, on a socketcand link over 127.0.0.1.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use can_link::socketcand::{Client, Server, ServerOptions};
use can_link::{CanLink, Clock, Direction, RunError, Runner};
use protocol::text::BusName;
use protocol::{Duration, Frame, Instant, Node, StandardId};

const PERIOD: Duration = Duration::from_millis(2);

fn frame(id: u16, byte: u8) -> Frame {
    Frame::from_array(StandardId::new(id).unwrap(), [byte])
}

/// Sends one frame per period; counts the answers.
#[derive(Default)]
struct Metronome {
    due: Instant,
    ready: Option<Frame>,
    ticks: u8,
    answers: Vec<u8>,
    last_now: Instant,
}

impl Metronome {
    fn see(&mut self, now: Instant) {
        assert!(now >= self.last_now, "time ran backwards");
        self.last_now = now;
    }
}

impl Node for Metronome {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.see(now);
        assert_ne!(frame.id().raw(), 0x100, "a node is never shown its own frames");
        self.answers.extend(frame.data());
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.see(now);
        if now >= self.due {
            self.ready = Some(frame(0x100, self.ticks));
            self.ticks += 1;
            self.due = now + PERIOD;
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.ready.take()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.due)
    }
}

/// Answers every frame of the metronome with the same byte.
#[derive(Default)]
struct Echo {
    ready: Option<Frame>,
}

impl Node for Echo {
    fn handle_frame(&mut self, _: Instant, request: &Frame) {
        if request.id().raw() == 0x100 {
            self.ready = request.data().first().map(|byte| frame(0x200, *byte));
        }
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_frame(&mut self) -> Option<Frame> {
        self.ready.take()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

fn server(clock: Clock) -> Server {
    Server::listen("127.0.0.1", 0, "can0", clock, ServerOptions::default()).unwrap()
}

#[test]
fn two_nodes_on_one_runner_hear_each_other_and_the_observer_hears_both() {
    let clock = Clock::manual();
    let mut link = server(clock);
    let (mut metronome, mut echo) = (Metronome::default(), Echo::default());
    let mut seen = Vec::new();
    let until = clock.now() + Duration::from_millis(50);
    let mut runner =
        Runner::new(&mut link, clock).observe(|_, direction, frame| seen.push((direction, *frame)));
    runner.run(&mut [&mut metronome, &mut echo], &AtomicBool::new(false), Some(until)).unwrap();
    let stats = runner.stats().clone();
    drop(runner);
    let ticks = metronome.ticks;
    assert!((24..=25).contains(&ticks), "{ticks} ticks of 2 ms in 50 ms");
    assert_eq!(metronome.answers, (0..ticks).collect::<Vec<_>>());
    assert_eq!((stats.sent, stats.received), (2 * u64::from(ticks), 0));
    assert_eq!(stats.deadlines.count(), u64::from(ticks));
    assert_eq!(seen[0], (Direction::Sent { node: 0 }, frame(0x100, 0)));
    assert_eq!(seen[1], (Direction::Sent { node: 1 }, frame(0x200, 0)));
}

#[test]
fn a_metronome_here_and_an_echo_across_a_socket_keep_time_together() {
    let clock = Clock::start();
    let mut link = server(clock);
    let port = link.local_addr().port();
    let stop = AtomicBool::new(false);
    let mut metronome = Metronome::default();
    thread::scope(|scope| {
        let far = scope.spawn(|| {
            let clock = Clock::start();
            let mut link = Client::connect("127.0.0.1", port, BusName::new("can0").unwrap(), clock).unwrap();
            let mut runner = Runner::new(&mut link, clock);
            runner.run(&mut [&mut Echo::default()], &stop, None).unwrap();
            runner.stats().clone()
        });
        let mut runner = Runner::new(&mut link, clock);
        while runner.stats().received < 20 {
            runner.step(&mut [&mut metronome], None).unwrap();
            assert!(clock.now() < Instant::from_micros(120_000_000), "{:?}", runner.stats());
        }
        stop.store(true, Ordering::Relaxed);
        let far = far.join().unwrap();
        assert!(far.received >= 20 && far.sent == far.received && far.dropped == 0, "{far:?}");
    });
    // Frames that were sent before the far side listened are lost; after the first answer no frame is lost.
    let first = metronome.answers[0];
    let expected: Vec<_> = (first..).take(metronome.answers.len()).collect();
    assert_eq!(metronome.answers, expected);
}

#[test]
fn the_stop_flag_ends_a_run_without_any_traffic() {
    let clock = Clock::start();
    let mut link = server(clock);
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            thread::sleep(std::time::Duration::from_millis(30));
            stop.store(true, Ordering::Relaxed);
        });
        let mut nodes: [&mut dyn Node; 1] = [&mut Echo::default()];
        Runner::new(&mut link, clock).run(&mut nodes, &stop, None).unwrap();
    });
    assert!(clock.now() >= Instant::from_micros(30_000));
}

#[test]
fn a_lost_link_ends_a_run_with_its_reason() {
    let clock = Clock::start();
    let mut far = server(clock);
    let port = far.local_addr().port();
    let (stop, joined) = (AtomicBool::new(false), AtomicBool::new(false));
    let error = thread::scope(|scope| {
        let run = scope.spawn(|| {
            let mut link = Client::connect("127.0.0.1", port, BusName::new("can0").unwrap(), clock).unwrap();
            joined.store(true, Ordering::Relaxed);
            Runner::new(&mut link, clock).run(&mut [&mut Echo::default()], &stop, None).unwrap_err()
        });
        while !joined.load(Ordering::Relaxed) {
            assert!(far.receive().unwrap().is_none());
            thread::sleep(std::time::Duration::from_millis(1));
        }
        drop(far);
        run.join().unwrap()
    });
    assert!(matches!(error, RunError::Link(_)), "{error}");
}

/// Never moves its deadline.
struct Stuck;

impl Node for Stuck {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        Some(Instant::ZERO)
    }
}

#[test]
fn a_deadline_that_never_moves_is_reported_as_a_defect() {
    let clock = Clock::start();
    let mut link = server(clock);
    let error =
        Runner::new(&mut link, clock).step(&mut [&mut Echo::default(), &mut Stuck], None).unwrap_err();
    assert!(matches!(error, RunError::StuckDeadline { node: 1, .. }), "{error}");
}

/// Always has one more frame to send.
struct Babbler;

impl Node for Babbler {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        Some(frame(1, 1))
    }
    fn poll_timeout(&self) -> Option<Instant> {
        Some(Instant::ZERO)
    }
}

#[test]
fn endless_frames_of_a_node_are_reported_as_a_defect() {
    let clock = Clock::start();
    let mut link = server(clock);
    let error = Runner::new(&mut link, clock).step(&mut [&mut Babbler], None).unwrap_err();
    assert!(matches!(error, RunError::Babble { .. }), "{error}");
}
