//! One CANopen servo with an inertia at its shaft, driven by frames.

use hil_sim::drive::bench::Bench;
use hil_sim::drive::cia402::{CanopenServo, MissingTarget, ServoOptions};
use hil_sim::participants::Participants as _;
use protocol::canopen::cia402::{Control, State, Status};
use protocol::canopen::client::{Failure, Transfer};
use protocol::canopen::emcy::Emergency;
use protocol::canopen::long_read::{Form, LongRead};
use protocol::canopen::pdo::{Direction, Entry, Map, Transmission, set_up};
use protocol::canopen::sdo::AbortCode;
use protocol::canopen::{Function, NodeId, Object, nmt};
use protocol::{Duration, Frame, Instant};

const PATIENCE: Duration = Duration::from_millis(20);
const INERTIA_KG_M2: f64 = 0.2;
const PERIOD: Duration = Duration::from_millis(2);

fn node() -> NodeId {
    NodeId::new(3).unwrap()
}

struct Rig {
    bench: Bench<CanopenServo>,
    now: Instant,
    seen: Vec<(Instant, Frame)>,
}

impl Rig {
    fn with(options: ServoOptions) -> Self {
        let bench = Bench::new(vec![CanopenServo::new(options, 0.0)], INERTIA_KG_M2);
        Self { bench, now: Instant::ZERO, seen: Vec::new() }
    }

    fn new() -> Self {
        let mut rig = Self::with(ServoOptions::of(node()));
        rig.run(Duration::from_millis(250));
        rig
    }

    fn servo(&mut self) -> &mut CanopenServo {
        &mut self.bench.motors_mut()[0]
    }

    fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now += Duration::from_micros(100);
            self.bench.advance(self.now);
            self.bench.node(0).handle_timeout(self.now);
            while let Some(frame) = self.bench.node(0).poll_frame() {
                self.seen.push((self.now, frame));
            }
        }
    }

    fn send(&mut self, frame: &Frame) {
        self.bench.node(0).handle_frame(self.now, frame);
    }

    fn transfer(&mut self, mut transfer: Transfer<64>, frame: &Frame) -> Result<Vec<u8>, Failure> {
        let mut next = Some(*frame);
        while transfer.outcome().is_none() {
            if let Some(frame) = next.take() {
                self.send(&frame);
            }
            let before = self.seen.len();
            self.run(Duration::from_micros(100));
            for (at, frame) in &self.seen[before..] {
                next = transfer.handle_frame(*at, frame).or(next);
            }
            next = transfer.handle_timeout(self.now).or(next);
        }
        transfer.outcome().unwrap().map(<[u8]>::to_vec)
    }

    fn read(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, Failure> {
        let (transfer, frame) = Transfer::read(self.now, PATIENCE, node(), Object::new(index, sub));
        self.transfer(transfer, &frame)
    }

    fn write(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), Failure> {
        let object = Object::new(index, sub);
        let (transfer, frame) = Transfer::write(self.now, PATIENCE, node(), object, value).unwrap();
        self.transfer(transfer, &frame).map(|_| ())
    }

    /// Control word and target to it, status word and position from it, with each SYNC.
    fn map(&mut self) {
        self.map_to(Entry::new(0x607A, 0, 4));
        self.write(0x6085, 0, &4_000_000_u32.to_le_bytes()).unwrap();
    }

    fn map_to(&mut self, target: Entry) {
        let to = Map::new(&[Entry::new(0x6040, 0, 2), target]).unwrap();
        let from = Map::new(&[Entry::new(0x6041, 0, 2), Entry::new(0x6064, 0, 4)]).unwrap();
        for (direction, map) in [(Direction::Receive, to), (Direction::Transmit, from)] {
            for (object, value) in set_up(node(), direction, 1, map, Transmission::Sync(1)) {
                self.write(object.index, object.sub, value.get()).unwrap();
            }
        }
        self.write(0x60C2, 1, &[2]).unwrap();
        self.write(0x60C2, 2, &[(-3_i8) as u8]).unwrap();
    }

    /// A period: the set point, unless it is missing, then the SYNC. What comes back: status word and counts.
    fn period(&mut self, control: Control, target: Option<i32>) -> (Status, i32) {
        if let Some(target) = target {
            let [a, b] = control.0.to_le_bytes();
            let [c, d, e, f] = target.to_le_bytes();
            self.send(&Function::Rpdo(1, node()).frame([a, b, c, d, e, f]));
        }
        self.send(&nmt::sync());
        let before = self.seen.len();
        self.run(PERIOD);
        let own = Function::Tpdo(1, node());
        let frame = self.seen[before..].iter().find(|(_, frame)| Function::of_frame(frame) == Some(own));
        let [a, b, c, d, e, f] = *frame.expect("process data").1.data().first_chunk::<6>().unwrap();
        (Status(u16::from_le_bytes([a, b])), i32::from_le_bytes([c, d, e, f]))
    }

    /// In a mode, with torque.
    fn enabled(mode: u8, options: ServoOptions) -> Self {
        let mut rig = Self::with(options);
        rig.run(Duration::from_millis(250));
        rig.map();
        rig.write(0x6060, 0, &[mode]).unwrap();
        rig.send(&nmt::Command::Start.encode(None));
        for word in [Control::SHUT_DOWN, Control::SWITCH_ON, Control::ENABLE, Control::ENABLE] {
            rig.period(word, Some(0));
        }
        assert_eq!(rig.servo().state(), State::OperationEnabled);
        rig
    }

    fn emergencies(&self) -> Vec<u16> {
        self.seen.iter().filter_map(|(_, frame)| Some(Emergency::decode(frame)?.1.code)).collect()
    }
}

fn aborted<T>(code: u32) -> Result<T, Failure> {
    Err(Failure::Aborted(AbortCode(code)))
}

/// Frames that came at once would not fit the transmit buffers of a bus.
#[test]
fn the_sheet_comes_in_blocks_one_frame_at_a_time() {
    let mut rig = Rig::new();
    let sheet = Object::new(0x1021, 0);
    let (mut read, frame) = LongRead::new(rig.now, PATIENCE, node(), sheet, 1 << 20, Form::Blocks);
    let (mut next, mut blocks, mut bytes) = (Some(frame), 0, Vec::<u8>::new());
    while read.outcome().is_none() {
        if let Some(frame) = next.take() {
            blocks += usize::from(frame.data()[0] == 0xA2);
            rig.send(&frame);
        }
        let before = rig.seen.len();
        rig.run(Duration::from_micros(100));
        assert!(rig.seen.len() <= before + 1);
        for (at, frame) in &rig.seen[before..] {
            next = read.handle_frame(*at, frame, &mut |part| bytes.extend(part)).or(next);
        }
        next = read.handle_timeout(rig.now).or(next);
    }
    assert_eq!(read.outcome(), Some(Ok(())));
    assert_eq!(bytes, include_bytes!("../src/drive/cia402/simulated_servo.eds"));
    assert_eq!(blocks, bytes.len().div_ceil(7 * 127));
}

#[test]
fn it_boots_up_and_its_heartbeat_shows_what_the_network_orders() {
    let mut rig = Rig::with(ServoOptions::of(node()));
    rig.run(Duration::from_millis(199));
    assert!(rig.seen.is_empty());
    rig.run(Duration::from_millis(2));
    assert_eq!(nmt::State::decode(&rig.seen[0].1), Some((node(), nmt::State::BootUp)));
    rig.write(0x1017, 0, &100_u16.to_le_bytes()).unwrap();
    for (command, state) in [
        (nmt::Command::Start, nmt::State::Operational),
        (nmt::Command::PreOperational, nmt::State::PreOperational),
        (nmt::Command::Stop, nmt::State::Stopped),
    ] {
        rig.send(&command.encode(Some(node())));
        let before = rig.seen.len();
        rig.run(Duration::from_millis(250));
        let beats: Vec<_> =
            rig.seen[before..].iter().filter_map(|(_, frame)| nmt::State::decode(frame)).collect();
        assert!((2..=3).contains(&beats.len()), "{beats:?}");
        assert!(beats.iter().all(|beat| *beat == (node(), state)), "{beats:?}");
    }
    assert_eq!(rig.read(0x1000, 0), Err(Failure::TimeOut), "stopped: no service data");
    rig.send(&nmt::Command::Stop.encode(NodeId::new(9)));
    rig.send(&nmt::Command::ResetNode.encode(None));
    rig.run(Duration::from_millis(250));
    assert_eq!(rig.servo().network(), nmt::State::PreOperational);
    assert_eq!(rig.read(0x1017, 0), Ok(vec![0, 0]), "a reset forgets what was written");
}

#[test]
fn service_data_read_in_segments_and_refuse_with_the_code_of_the_reason() {
    let mut rig = Rig::new();
    assert_eq!(rig.read(0x1000, 0), Ok(vec![0x92, 0x01, 0x02, 0x00]));
    assert_eq!(rig.read(0x1008, 0), Ok(b"simulated servo of CiA 402".to_vec()));
    assert_eq!(rig.read(0x2000, 0), aborted(0x0602_0000));
    assert_eq!(rig.read(0x1018, 5), aborted(0x0609_0011));
    assert_eq!(rig.write(0x1018, 1, &[0; 4]), aborted(0x0601_0002));
    assert_eq!(rig.write(0x1008, 0, b"x"), aborted(0x0601_0002));
    assert_eq!(rig.write(0x1017, 0, &[1]), aborted(0x0607_0010));
    assert_eq!(rig.write(0x1029, 1, &[7]), aborted(0x0609_0030));
    assert_eq!(rig.write(0x1017, 0, b"more than four bytes"), aborted(0x0607_0010));
    // A block transfer is no part of this server.
    rig.send(&Function::SdoToNode(node()).frame([0xA0, 0, 0x10, 0, 0, 0, 0, 0]));
    rig.run(Duration::from_millis(2));
    assert_eq!(rig.seen.last().unwrap().1.data()[4..], 0x0504_0001_u32.to_le_bytes());
}

#[test]
fn a_map_is_set_in_its_order_only_and_of_objects_that_may_stand_in_it() {
    let mut rig = Rig::new();
    assert_eq!(rig.write(0x1A00, 0, &[0]), aborted(0x0800_0022), "it is valid");
    rig.write(0x1800, 1, &0x8000_0183_u32.to_le_bytes()).unwrap();
    assert_eq!(rig.write(0x1A00, 1, &0x6064_0020_u32.to_le_bytes()), aborted(0x0800_0022), "its count");
    rig.write(0x1A00, 0, &[0]).unwrap();
    assert_eq!(rig.write(0x1A00, 1, &0x607A_0020_u32.to_le_bytes()), aborted(0x0604_0041));
    assert_eq!(rig.write(0x1A00, 1, &0x6064_0010_u32.to_le_bytes()), aborted(0x0604_0041));
    for sub in 1..=3 {
        rig.write(0x1A00, sub, &0x6064_0020_u32.to_le_bytes()).unwrap();
    }
    assert_eq!(rig.write(0x1A00, 0, &[3]), aborted(0x0604_0042), "twelve bytes");
    rig.map();
    rig.send(&nmt::Command::Start.encode(None));
    assert_eq!(rig.write(0x1800, 1, &0x8000_0183_u32.to_le_bytes()), aborted(0x0800_0022), "operational");
    assert_eq!(rig.period(Control::DISABLE_VOLTAGE, None).0.state(), Some(State::SwitchOnDisabled));
}

#[test]
fn the_shaft_follows_targets_on_lines_and_a_missing_one_holds_or_goes_on_for_a_period() {
    for (missing, ends) in [(MissingTarget::Hold, 20), (MissingTarget::Extrapolate, 21)] {
        let mut rig = Rig::enabled(8, ServoOptions { missing, ..ServoOptions::of(node()) });
        let step = 100;
        for k in 1..=20 {
            let (status, counts) = rig.period(Control::ENABLE, Some(step * k));
            assert!(status.mode_works());
            // With SYNC k the line to target k begins: the shaft is at target k - 1.
            assert!(k < 10 || (counts - step * (k - 1)).abs() <= 8, "{k}: {counts}");
        }
        for _ in 0..20 {
            rig.period(Control::ENABLE, None);
        }
        let counts = rig.period(Control::ENABLE, None).1;
        assert!((counts - step * ends).abs() <= 2, "{missing:?}: {counts}");
    }
}

#[test]
fn behind_lost_targets_a_servo_with_a_limit_of_speed_runs_no_faster_than_it() {
    // 100 counts in 2 ms are 732 turns of the motor in a minute.
    for (turns_per_minute, low, high) in [(3_000_u32, 150, 400), (800, 100, 115)] {
        let mut rig = Rig::enabled(8, ServoOptions::of(node()));
        rig.write(0x6080, 0, &turns_per_minute.to_le_bytes()).unwrap();
        let (mut places, step) = (Vec::new(), 100);
        for k in 1..=60 {
            let target = (!(20..24).contains(&k)).then_some(step * k);
            places.push(rig.period(Control::ENABLE, target).1);
        }
        let fastest = places.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!((low..=high).contains(&fastest), "{turns_per_minute}: {fastest} counts in a period");
    }
}

#[test]
fn a_target_that_leaps_trips_the_following_window_and_a_reset_clears_it() {
    let mut rig = Rig::enabled(8, ServoOptions::of(node()));
    rig.write(0x6065, 0, &1_000_u32.to_le_bytes()).unwrap();
    for _ in 0..20 {
        rig.period(Control::ENABLE, Some(200_000));
    }
    assert_eq!(rig.emergencies(), [0x8611]);
    for _ in 0..100 {
        rig.period(Control::ENABLE, Some(200_000));
    }
    assert_eq!(rig.servo().state(), State::Fault);
    assert_eq!(rig.read(0x603F, 0), Ok(vec![0x11, 0x86]));
    assert_eq!(rig.read(0x1003, 1), Ok(vec![0x11, 0x86, 0, 0]));
    assert_eq!(rig.read(0x1001, 0), Ok(vec![0x21]));
    rig.period(Control::DISABLE_VOLTAGE, Some(0));
    rig.period(Control::FAULT_RESET, Some(0));
    assert_eq!(rig.servo().state(), State::SwitchOnDisabled);
    assert_eq!(rig.emergencies(), [0x8611, 0]);
}

#[test]
fn a_heartbeat_that_stays_away_is_reported_and_acts_as_object_6007_says() {
    for (option, state) in [
        (0_i16, State::OperationEnabled),
        (1, State::Fault),
        (2, State::SwitchOnDisabled),
        (3, State::QuickStopActive),
    ] {
        let mut rig = Rig::enabled(8, ServoOptions::of(node()));
        rig.write(0x6007, 0, &option.to_le_bytes()).unwrap();
        rig.write(0x605A, 0, &6_i16.to_le_bytes()).unwrap();
        rig.write(0x1029, 1, &[1]).unwrap();
        rig.write(0x1016, 1, &(0x7F_u32 << 16 | 50).to_le_bytes()).unwrap();
        let beat = nmt::State::Operational.encode(NodeId::new(0x7F).unwrap());
        for _ in 0..10 {
            rig.send(&beat);
            rig.run(Duration::from_millis(40));
        }
        assert_eq!((rig.servo().state(), rig.emergencies().len()), (State::OperationEnabled, 0));
        rig.run(Duration::from_millis(100));
        assert_eq!((rig.servo().state(), rig.emergencies()), (state, vec![0x8130]), "option {option}");
    }
}

#[test]
fn homing_takes_the_place_as_zero_or_looks_for_the_index() {
    for (method, zero) in [(37, 0), (35, 0), (34, 4_096)] {
        let options = ServoOptions { is_absolute: false, ..ServoOptions::of(node()) };
        let mut rig = Rig::with(options);
        rig.bench = Bench::new(vec![CanopenServo::new(options, 0.03)], INERTIA_KG_M2);
        rig.run(Duration::from_millis(250));
        rig.map();
        rig.write(0x6060, 0, &[6]).unwrap();
        rig.write(0x6098, 0, &[method]).unwrap();
        rig.write(0x607C, 0, &500_i32.to_le_bytes()).unwrap();
        rig.send(&nmt::Command::Start.encode(None));
        for word in [Control::SHUT_DOWN, Control::SWITCH_ON, Control::ENABLE] {
            rig.period(word, Some(0));
        }
        let mut status = rig.period(Control::ENABLE.with_mode_bit(), Some(0)).0;
        assert!(method != 34 || !status.target_reached());
        for _ in 0..4_000 {
            status = rig.period(Control::ENABLE.with_mode_bit(), Some(0)).0;
        }
        assert!(status.target_reached() && status.mode_works() && !status.mode_fails(), "{method}");
        // 0.03 rad are 1 956 counts above a pulse; the next one is 4 096 above it.
        let counts_per_rad = options.counts_per_rad();
        let stood = (0.03 * counts_per_rad).round() as i32;
        let moved = if method == 34 { zero - stood } else { 0 };
        let shaft = (rig.servo().shaft_rad() * counts_per_rad).round() as i32;
        let true_counts = (hil_sim::drive::bench::ShaftMotor::q_rad(rig.servo()) * counts_per_rad) as i32;
        assert!((true_counts - stood - moved).abs() < 60, "{method}: {true_counts} {stood} {moved}");
        assert!((shaft - 500).abs() < 60, "{method}: {shaft}");
    }
}

#[test]
fn quick_stop_and_halt_brake_on_the_ramp_and_a_halt_goes_on_where_it_stands() {
    let mut rig = Rig::enabled(8, ServoOptions::of(node()));
    rig.write(0x605A, 0, &6_i16.to_le_bytes()).unwrap();
    let mut target = 0;
    let mut run = |rig: &mut Rig, periods| {
        let mut counts = 0;
        for _ in 0..periods {
            target += 200;
            counts = rig.period(Control::ENABLE, Some(target)).1;
        }
        counts
    };
    let before = run(&mut rig, 50);
    let mut after = 0;
    for _ in 0..100 {
        after = rig.period(Control(0x10F), Some(0)).1;
    }
    // 100 000 counts/s with 4 000 000 counts/s2: 1 250 counts, and a period to the SYNC.
    assert!((after - before - 1_450).abs() < 60, "{}", after - before);
    assert_eq!(rig.servo().state(), State::OperationEnabled);
    let mut rig = Rig::enabled(8, ServoOptions::of(node()));
    rig.write(0x605A, 0, &6_i16.to_le_bytes()).unwrap();
    for k in 1..=50 {
        rig.period(Control::ENABLE, Some(200 * k));
    }
    for _ in 0..100 {
        rig.period(Control::QUICK_STOP, Some(0));
    }
    assert_eq!(rig.servo().state(), State::QuickStopActive);
    let counts = (rig.servo().shaft_rad() * ServoOptions::of(node()).counts_per_rad()).round() as i32;
    assert!((counts - 10_000 - 1_250).abs() < 60, "{counts}");
}

#[test]
fn a_quick_stop_behind_lost_targets_does_not_speed_the_shaft_up() {
    let mut rig = Rig::enabled(8, ServoOptions { peak_nm: 20.0, ..ServoOptions::of(node()) });
    // No limit of the speed.
    rig.write(0x6080, 0, &u32::MAX.to_le_bytes()).unwrap();
    rig.write(0x605A, 0, &6_i16.to_le_bytes()).unwrap();
    for k in 1..=50 {
        rig.period(Control::ENABLE, Some(40 * k));
    }
    for _ in 51..=54 {
        rig.period(Control::ENABLE, None);
    }
    // The line to this target is six times as fast as the motion was.
    let before = rig.period(Control::ENABLE, Some(2_200)).1;
    let mut places = vec![before, rig.period(Control::QUICK_STOP, Some(2_200)).1];
    for _ in 0..20 {
        places.push(rig.period(Control::QUICK_STOP, Some(2_200)).1);
    }
    let ways: Vec<i32> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let fastest = ways[1..].iter().max().unwrap();
    assert!((5..40).contains(&ways[0]) && *fastest <= ways[0] + 20, "{ways:?}");
}

#[test]
fn torn_and_stale_answers_lost_heartbeats_and_a_mode_that_is_never_shown_are_played() {
    let mut rig = Rig::enabled(8, ServoOptions::of(node()));
    rig.servo().faults_mut().torn_answers = 1;
    assert_eq!(rig.period(Control::ENABLE, Some(0)).1.abs(), 0x0001_0000);
    assert!(rig.period(Control::ENABLE, Some(0)).1.abs() < 3);
    rig.servo().faults_mut().answers_are_stale = true;
    let stale = rig.period(Control::ENABLE, Some(3_000)).1;
    assert_eq!((1..20).map(|_| rig.period(Control::ENABLE, Some(3_000)).1).max(), Some(stale));
    rig.servo().faults_mut().answers_are_stale = false;
    rig.servo().faults_mut().heartbeat_is_lost = true;
    rig.write(0x1017, 0, &10_u16.to_le_bytes()).unwrap();
    let before = rig.seen.len();
    rig.run(Duration::from_millis(100));
    assert!(!rig.seen[before..].iter().any(|(_, frame)| nmt::State::decode(frame).is_some()));
    rig.servo().faults_mut().mode_is_never_shown = true;
    rig.write(0x6060, 0, &[6]).unwrap();
    assert_eq!(rig.read(0x6061, 0), Ok(vec![8]));
    rig.servo().faults_mut().is_silent = true;
    assert_eq!(rig.read(0x6061, 0), Err(Failure::TimeOut));
}

#[test]
fn a_module_takes_torque_after_its_commutation_follows_while_bit_4_is_set_and_brakes_without_positions() {
    let mut rig = Rig::with(ServoOptions::of(node()).interpolating());
    rig.run(Duration::from_millis(250));
    assert_eq!(rig.read(0x6502, 0), Ok(vec![0x43, 0, 0, 0]));
    for (index, sub) in [(0x608F, 1), (0x6091, 1), (0x1029, 1), (0x6007, 0), (0x603F, 0), (0x605A, 0)] {
        assert_eq!(rig.read(index, sub), aborted(0x0602_0000), "{index:x} is not shown");
        assert_eq!(rig.write(index, sub, &[1, 0]), aborted(0x0602_0000), "{index:x} is not shown");
    }
    assert_eq!(rig.read(0x1600, 3), Ok(0x60C1_0120_u32.to_le_bytes().to_vec()), "the map as delivered");
    rig.map_to(Entry::new(0x60C1, 1, 4));
    rig.write(0x6060, 0, &[8]).unwrap();
    assert_eq!(rig.read(0x6061, 0), Ok(vec![0]), "it has no mode 8");
    rig.write(0x6060, 0, &[7]).unwrap();
    rig.send(&nmt::Command::Start.encode(None));
    for word in [Control::SHUT_DOWN, Control::SWITCH_ON] {
        rig.period(word, Some(0));
    }
    let begun = rig.now;
    while rig.servo().state() == State::SwitchedOn {
        rig.period(Control::ENABLE, Some(0));
    }
    let took = rig.now.saturating_since(begun);
    assert!((5_000..5_010).contains(&(took.as_micros() / 1_000)), "{took:?}");
    // Without bit 4 no position acts.
    let (status, counts) = rig.period(Control::ENABLE, Some(360));
    assert!(!status.mode_works() && counts == 0);
    let active = Control::ENABLE.with_mode_bit();
    for step in 1..=100 {
        rig.period(active, Some(36 * step));
    }
    let (status, counts) = rig.period(active, Some(3_600));
    assert!(status.mode_works());
    assert!((counts - 3_600).abs() <= 40, "{counts}");
    // Six SYNCs without a position are borne, the seventh is not.
    for missing in 1..=7 {
        assert_eq!(rig.servo().state(), State::OperationEnabled, "{missing}");
        rig.period(active, None);
    }
    // Its quick stop ends without torque, as object 605A is delivered.
    assert_eq!(rig.servo().state(), State::SwitchOnDisabled);
}
