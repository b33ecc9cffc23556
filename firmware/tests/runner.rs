//! The loop of a board: frames, deadlines and pins through the traits of embedded Rust. Judged by the bench's
//! drives and by a CAN controller, a clock and pins that the test controls.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use crate::bench::host::Host;
use crate::bench::{Bench, Controlled, Options};
use embedded_can::nb::Can;
use embedded_hal::digital::{ErrorKind as PinErrorKind, ErrorType, OutputPin};
use firmware::groups::powercube::PowerCubes;
use firmware::groups::powercube::settings::GRIPPER_ADDRESS;
use firmware::runner::{Clock, FRAMES_BEFORE_DEADLINE, LATE_MAX, Pins, Runner, Turn};
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::RamStorage;
use firmware::{Controller, ControllerNode};
use protocol::cyphal::cubecell::command::{self, Gripper};
use protocol::cyphal::uavcan::command::Status;
use protocol::powercube::CubeState;
use protocol::{ExtendedId, Frame, Id, Instant, Node, StandardId};

/// A CAN controller with a number of mailboxes: the one with the lowest id goes first, and a frame that is more
/// urgent than all of them replaces the least urgent one, as on bxCAN. With `usize::MAX` mailboxes it is a queue.
#[derive(Default)]
struct Registers {
    mailboxes_max: usize,
    mailboxes: Vec<Frame>,
    received: VecDeque<Result<Frame, embedded_can::ErrorKind>>,
    /// A frame that is received again and again.
    flood: Option<Frame>,
    receives: u32,
}

#[derive(Clone, Default)]
struct CanPort(Rc<RefCell<Registers>>);

impl CanPort {
    fn with_mailboxes(mailboxes_max: usize) -> Self {
        Self(Rc::new(RefCell::new(Registers { mailboxes_max, ..Registers::default() })))
    }

    /// The frame that leaves next.
    fn take_next(&self) -> Option<Frame> {
        let Registers { mailboxes, mailboxes_max, .. } = &mut *self.0.borrow_mut();
        if *mailboxes_max == usize::MAX && !mailboxes.is_empty() {
            return Some(mailboxes.remove(0));
        }
        let (index, _) = mailboxes.iter().enumerate().min_by_key(|(_, frame)| frame.arbitration_key())?;
        Some(mailboxes.remove(index))
    }
}

impl Can for CanPort {
    type Frame = Frame;
    type Error = embedded_can::ErrorKind;

    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, Self::Error> {
        let registers = &mut *self.0.borrow_mut();
        if registers.mailboxes.len() < registers.mailboxes_max {
            registers.mailboxes.push(*frame);
            return Ok(None);
        }
        let least = registers.mailboxes.iter_mut().max_by_key(|waiting| waiting.arbitration_key());
        match least {
            Some(least) if least.arbitration_key() > frame.arbitration_key() => {
                Ok(Some(std::mem::replace(least, *frame)))
            }
            _ => Err(nb::Error::WouldBlock),
        }
    }

    fn receive(&mut self) -> nb::Result<Frame, Self::Error> {
        let registers = &mut *self.0.borrow_mut();
        if let Some(frame) = registers.flood {
            registers.receives += 1;
            return Ok(frame);
        }
        registers.received.pop_front().ok_or(nb::Error::WouldBlock)?.map_err(nb::Error::Other)
    }
}

#[derive(Clone, Default)]
struct HandClock(Rc<Cell<Instant>>);

impl Clock for HandClock {
    fn now(&mut self) -> Instant {
        self.0.get()
    }
}

/// A pin that keeps its levels, and refuses a given number of times.
#[derive(Clone, Default)]
struct Pin {
    levels: Rc<RefCell<Vec<bool>>>,
    refusals: Rc<Cell<u32>>,
}

impl Pin {
    fn set(&self, high: bool) -> Result<(), PinErrorKind> {
        if self.refusals.get() > 0 {
            self.refusals.set(self.refusals.get() - 1);
            return Err(PinErrorKind::Other);
        }
        self.levels.borrow_mut().push(high);
        Ok(())
    }
}

impl ErrorType for Pin {
    type Error = PinErrorKind;
}

impl OutputPin for Pin {
    fn set_low(&mut self) -> Result<(), PinErrorKind> {
        self.set(false)
    }

    fn set_high(&mut self) -> Result<(), PinErrorKind> {
        self.set(true)
    }
}

/// A board on the bench: frames of the bench go through the CAN controller and the runner.
struct Board {
    node: ControllerNode<RamStorage, Spline, PowerCubes>,
    runner: Runner<CanPort, HandClock, Pin, Pin, Pin>,
    can: CanPort,
    clock: HandClock,
    gripper: Pin,
    enable: Pin,
    lamp: Pin,
}

impl Board {
    fn new(options: &Options, mailboxes_max: usize) -> Self {
        let (can, clock) = (CanPort::with_mailboxes(mailboxes_max), HandClock::default());
        let (gripper, enable, lamp) = (Pin::default(), Pin::default(), Pin::default());
        let pins = Pins { gripper: gripper.clone(), enable: enable.clone(), lamp: lamp.clone() };
        let runner = Runner::new(can.clone(), clock.clone(), pins);
        let node = Host::node(RamStorage::new(), options);
        Self { node, runner, can, clock, gripper, enable, lamp }
    }

    fn turn(&mut self) -> Turn {
        self.runner.turn(&mut self.node)
    }

    fn turn_at(&mut self, us: u64) -> Turn {
        self.clock.0.set(Instant::from_micros(us));
        self.turn()
    }

    /// Turns until there is nothing to do.
    fn settle(&mut self) {
        for _ in 0..100 {
            if self.turn().idle_until.is_some() {
                return;
            }
        }
        panic!("a hundred turns at one time, and still no rest");
    }
}

impl Node for Board {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.clock.0.set(now);
        self.can.0.borrow_mut().received.push_back(Ok(*frame));
        self.settle();
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.clock.0.set(now);
        self.settle();
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        if self.runner.waits_for_room() {
            self.settle();
        }
        self.can.take_next()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.node.poll_timeout()
    }
}

impl Controlled for Board {
    fn core(&self) -> &Controller<RamStorage, Spline, PowerCubes> {
        self.node.controller()
    }
    fn core_mut(&mut self) -> &mut Controller<RamStorage, Spline, PowerCubes> {
        panic!("a board gets orders by its bus and its node only")
    }
}

/// A whole throw over the host link, through the runner. Judged by the drives' positions at its end.
fn throw(options: Options, mailboxes_max: usize) -> Host<Board> {
    let mut host = Host::over(Board::new(&options, mailboxes_max), options);
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(1_400_000, |_, _| {});
    host
}

#[test]
fn a_throw_through_three_mailboxes_keeps_to_its_path_and_sets_the_pins() {
    let mut options = Options::default();
    // The gripper is connected to the board's own output.
    GRIPPER_ADDRESS.set(&mut options.settings, 0);
    let mut host = throw(options, 3);
    assert!(host.bench.distance_from_path() < 1e-3, "{} rad", host.bench.distance_from_path());
    let board = &host.bench.controller;
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert_eq!(*board.enable.levels.borrow(), [false, true, false]);
    assert_eq!(*board.lamp.levels.borrow(), [false, true, false]);
    for open in [true, false] {
        assert_eq!(host.command(command::GRIPPER, &Gripper { open }).0, Status::SUCCESS);
    }
    let board = &host.bench.controller;
    assert_eq!(*board.gripper.levels.borrow(), [true, false]);
    assert_eq!(board.runner.counters(), Default::default());
}

#[test]
fn a_board_with_room_for_every_frame_sends_what_the_node_sends() {
    let board = throw(Options::default(), usize::MAX);
    let mut bare = Host::new();
    let name = bare.armed();
    bare.command(command::RUN, &name);
    bare.run(1_400_000, |_, _| {});
    assert!(bare.bench.log.len() > 1_000);
    assert!(board.bench.log == bare.bench.log, "the logs of the bus differ");
}

#[test]
fn a_flooded_bus_holds_a_deadline_up_for_no_more_than_eight_frames() {
    let mut board = Board::new(&Options::default(), 3);
    // Past the deadlines of start-up, which a frame may move.
    let mut due = board.node.poll_timeout().unwrap();
    while due < Instant::from_micros(5_000) {
        let _ = board.turn_at(due.as_micros());
        due = board.node.poll_timeout().unwrap();
    }
    let stranger = Frame::from_array(Id::Standard(StandardId::from_low_bits(0x7FF)), [0; 8]);
    board.can.0.borrow_mut().flood = Some(stranger);
    for _ in 0..20 {
        assert!(board.turn_at(due.as_micros() - 1).idle_until.is_none());
    }
    board.can.0.borrow_mut().receives = 0;
    for _ in 0..FRAMES_BEFORE_DEADLINE {
        let _ = board.turn_at(due.as_micros());
        assert_eq!(board.node.poll_timeout(), Some(due), "not served yet");
    }
    let _ = board.turn_at(due.as_micros());
    assert!(board.node.poll_timeout().unwrap() > due);
    assert_eq!(board.can.0.borrow().receives, FRAMES_BEFORE_DEADLINE.into());
}

#[test]
fn a_deadline_served_too_late_is_no_healthy_turn_and_is_counted() {
    let mut board = Board::new(&Options::default(), 3);
    board.settle();
    let due = board.node.poll_timeout().unwrap();
    let latest = due + LATE_MAX;
    assert!(board.turn_at(latest.as_micros()).healthy);
    let due = board.node.poll_timeout().unwrap();
    let too_late = (due + LATE_MAX).as_micros() + 1;
    assert!(!board.turn_at(too_late.max(latest.as_micros())).healthy);
    assert_eq!(board.runner.counters().late, 1);
}

/// A turn with nothing to do must not feed the watchdog when every deadline is late.
#[test]
fn a_loop_that_serves_every_deadline_too_late_is_never_healthy() {
    let mut board = Board::new(&Options::default(), 3);
    board.settle();
    for _ in 0..20 {
        let due = board.node.poll_timeout().unwrap();
        let late = (due + LATE_MAX).as_micros() + 5_000;
        for turn in 0..6 {
            assert!(!board.turn_at(late).healthy, "turn {turn}");
        }
    }
    let due = board.node.poll_timeout().unwrap();
    assert!(board.turn_at(due.as_micros()).healthy, "in time again");
}

#[test]
fn enable_falls_after_a_fault_once_the_drives_stand() {
    let options = Options::default();
    let mut host = Host::over(Board::new(&options, 3), options);
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(500_000, |_, _| {});
    let sick = CubeState::ERROR.union(CubeState::POWERFAULT);
    host.bench.drives[2].state = host.bench.drives[2].state.union(sick);
    let enabled = |host: &Host<Board>| *host.bench.controller.enable.levels.borrow().last().unwrap();
    let mut braked_with_enable = false;
    for _ in 0..2_000 {
        host.run(1_000, |_, _| {});
        let fastest = host.bench.drives.iter().map(|drive| drive.v.abs()).fold(0.0, f64::max);
        if !enabled(&host) {
            assert!(fastest < 0.02, "enable fell at {fastest} rad/s");
            break;
        }
        braked_with_enable |= host.bench.kind() == StateKind::Fault && fastest > 0.1;
    }
    assert!(braked_with_enable && !enabled(&host));
    host.run(2_000_000, |_, _| {});
    assert_eq!(*host.bench.controller.enable.levels.borrow(), [false, true, false]);
}

#[test]
fn a_clock_that_goes_back_stands_still_for_the_controller() {
    let mut board = Board::new(&Options::default(), 3);
    let _ = board.turn_at(70_000);
    let _ = board.turn_at(10_000);
    assert_eq!(board.runner.now(), Instant::from_micros(70_000));
}

#[test]
fn a_pin_that_refuses_is_set_again_in_the_next_turn() {
    let mut board = Board::new(&Options::default(), 3);
    board.enable.refusals.set(2);
    for _ in 0..4 {
        let _ = board.turn();
    }
    assert_eq!(*board.enable.levels.borrow(), [false]);
    assert_eq!(board.runner.counters().pin_errors, 2);
}

#[test]
fn an_error_of_the_can_controller_is_counted_and_the_next_frame_is_taken() {
    let mut board = Board::new(&Options::default(), 3);
    board.settle();
    let stranger = Frame::from_array(Id::Extended(ExtendedId::from_low_bits(1)), []);
    {
        let received = &mut board.can.0.borrow_mut().received;
        received.push_back(Err(embedded_can::ErrorKind::Overrun));
        received.push_back(Ok(stranger));
    }
    assert_eq!(board.turn().idle_until, None, "more may wait behind an error");
    assert_eq!(board.turn().idle_until, None);
    assert!(board.can.0.borrow().received.is_empty());
    assert_eq!(board.runner.counters().can_errors, 1);
}

#[test]
fn a_frame_that_finds_no_room_waits_and_no_frame_is_lost() {
    let options = Options::default();
    let mut board = Board::new(&options, 1);
    let mut bare = Host::node(RamStorage::new(), &options);
    let mut wanted = Vec::new();
    for step in 0..200 {
        let at = Instant::from_micros(step * 500);
        bare.handle_timeout(at);
        wanted.extend(std::iter::from_fn(|| bare.poll_frame()));
    }
    let mut sent = Vec::new();
    for step in 0..200 {
        let _ = board.turn_at(step * 500);
        // One frame leaves per turn at most.
        sent.extend(board.can.take_next());
    }
    for _ in 0..wanted.len() {
        let _ = board.turn();
        sent.extend(board.can.take_next());
    }
    assert!(wanted.len() > 6, "{} frames", wanted.len());
    let key = |frame: &Frame| (frame.arbitration_key(), frame.data().to_vec());
    wanted.sort_by_key(key);
    sent.sort_by_key(key);
    assert_eq!(sent, wanted);
}

#[test]
fn the_lamp_blinks_in_fault_and_the_board_is_woken_for_it() {
    let options = Options::default();
    let mut bench = Bench::with(Board::new(&options, 3), options);
    bench.heartbeat = false;
    bench.drives[2].silent = true;
    bench.run_until(10_000_000, |bench| bench.kind() == StateKind::Fault);
    assert_eq!(bench.kind(), StateKind::Fault);
    let board = &mut *bench.controller;
    board.lamp.levels.borrow_mut().clear();
    let (start, end) = (bench.now, bench.now + 5_300_000);
    let mut now = start;
    while now < end {
        now = match board.turn_at(now).idle_until {
            Some(until) => until.as_micros().max(now + 1),
            None => now,
        };
        while board.can.take_next().is_some() {}
    }
    let levels = board.lamp.levels.borrow();
    assert!((10..=11).contains(&levels.len()), "{} changes in 5.3 s", levels.len());
    assert!(levels.windows(2).all(|pair| pair[0] != pair[1]));
    assert!(!board.enable.levels.borrow().last().unwrap());
}
