//! The RSI group behind the controller, with a robot that has the clock.
//!
//! The robot is written from the description of the interface, in double precision: absolute corrections from the
//! start pose, HOLDON, a counter of late answers, dead time and first-order lag. The tests observe it: its axes are
//! compared with the closed form of the throw, and the acceleration of its set points with the cut-out of a real
//! robot.

use crate::bench::{HOST, joint, throw_file, throw_reference, throw_start};
use firmware::Controller;
use firmware::authority::Seed;
use firmware::fault::Cause;
use firmware::group::DriveGroup;
use firmware::groups::rsi::{Options, Packet, Rsi, Telegram};
use firmware::joints::PerJoint;
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Instant};

pub(crate) const AXES: usize = 6;
pub(crate) const PERIOD_US: u64 = 12_000;
pub(crate) const DEAD_CYCLES: usize = 8;
const LAG_S: f64 = 0.024;
/// 2000 deg/s2: the acceleration at which a simulated KR C cuts out.
pub(crate) const CUT_OUT_RAD_S2: f64 = 34.906_585;

fn settings() -> Settings {
    Settings { cycle_period_us: PERIOD_US as u32, gains_certificate_crc32: 0, ..Settings::powercube6() }
}

/// What the network does to the telegram of a cycle, or to its answer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Wire {
    #[default]
    Fine,
    TelegramLost,
    AnswerLost,
    /// The answer comes after the window.
    AnswerLate,
    Doubled,
    /// The telegram comes after the next one.
    Overtaken,
    /// The telegram arrives with a wrong number.
    OtherNumber,
    /// The telegram arrives with a count of late answers of zero.
    NoLate,
    /// The telegram arrives with its number only.
    NoPositions,
    /// The telegram arrives without actual axes.
    NoAxes,
}

pub(crate) struct Robot {
    pub(crate) ipoc: u64,
    pub(crate) start: [f64; AXES],
    /// Set points by cycle, newest last.
    pub(crate) set: Vec<[f64; AXES]>,
    pub(crate) q: [f64; AXES],
    pub(crate) accepted: Option<[f64; AXES]>,
    pub(crate) correction: [f64; AXES],
    pub(crate) late: u32,
    pub(crate) open: Option<u64>,
    pub(crate) stopped: bool,
    pub(crate) a_max: f64,
    pub(crate) v_max: f64,
    /// Cycles from a set point to the beginning of its effect.
    pub(crate) dead_cycles: usize,
    /// Late answers are counted in a row.
    pub(crate) counts_in_a_row: bool,
    /// Telegrams carry the count of late answers.
    pub(crate) names_late: bool,
    /// Largest change of an accepted correction, per limit of its axis: of speed (0) and acceleration (1). The
    /// robot's own halt when it has no answer is not counted.
    pub(crate) leap: [f64; 2],
}

impl Robot {
    fn new(start: [f64; AXES]) -> Self {
        Self {
            ipoc: 4_710,
            start,
            set: vec![start; 2 * DEAD_CYCLES],
            q: start,
            accepted: None,
            correction: [0.0; AXES],
            late: 0,
            open: None,
            stopped: false,
            a_max: 0.0,
            v_max: 0.0,
            dead_cycles: DEAD_CYCLES,
            counts_in_a_row: false,
            names_late: true,
            leap: [0.0; 2],
        }
    }

    /// A new program run: the start pose is where the set points stand.
    pub(crate) fn restart(&mut self) {
        let set = *self.set.last().unwrap();
        self.set = vec![set; 2 * DEAD_CYCLES];
        *self = Self {
            start: set,
            q: self.q,
            open: self.open,
            a_max: self.a_max,
            v_max: self.v_max,
            dead_cycles: self.dead_cycles,
            counts_in_a_row: self.counts_in_a_row,
            names_late: self.names_late,
            leap: self.leap,
            set: self.set.clone(),
            ..Self::new(set)
        };
    }

    /// The program of the robot was ended, its arm moved back to its start pose, and the program began again.
    pub(crate) fn return_to_start(&mut self) {
        let start = self.start;
        (self.set, self.q) = (vec![start], start);
        self.restart();
    }

    fn cycle(&mut self, asked: bool) {
        let taken = self.accepted.take();
        match taken {
            Some(correction) => {
                self.correction = correction;
                self.late = if self.counts_in_a_row { 0 } else { self.late };
            }
            None if asked => self.late += 1,
            None => {}
        }
        let n = self.set.len();
        let (before, last) = (self.set[n - 2], self.set[n - 1]);
        let set: [f64; AXES] = std::array::from_fn(|i| self.start[i] + self.correction[i]);
        if taken.is_some() {
            let limits = settings();
            for i in 0..AXES {
                let dt = PERIOD_US as f64 * 1e-6;
                let (v, v_before) = ((set[i] - last[i]) / dt, (last[i] - before[i]) / dt);
                let v_max = f64::from(limits.joint.at(joint(i)).v_max_rad_s);
                self.leap[0] = self.leap[0].max(v.abs() / v_max);
                self.leap[1] = self.leap[1].max((v - v_before).abs() / dt / CUT_OUT_RAD_S2);
            }
        }
        for i in 0..AXES {
            let a = (set[i] - 2.0 * last[i] + before[i]) / (PERIOD_US as f64 * 1e-6).powi(2);
            self.a_max = self.a_max.max(a.abs());
            self.v_max = self.v_max.max((set[i] - last[i]).abs() / (PERIOD_US as f64 * 1e-6));
        }
        self.set.push(set);
        // Dead time, then the lag, solved exactly on the line between two delayed set points.
        let n = self.set.len();
        let (from, to) = (self.set[n - 2 - self.dead_cycles], self.set[n - 1 - self.dead_cycles]);
        let dt = PERIOD_US as f64 * 1e-6;
        for i in 0..AXES {
            let slope = (to[i] - from[i]) / dt;
            let transient = self.q[i] - from[i] + slope * LAG_S;
            self.q[i] = to[i] - slope * LAG_S + transient * (-dt / LAG_S).exp();
        }
        self.ipoc += 1;
    }

    pub(crate) fn telegram(&self) -> Telegram {
        let pose = |q: [f64; AXES]| {
            let mut pose = PerJoint::splat(0.0);
            for (i, q) in q.into_iter().enumerate() {
                pose.set(joint(i), q as f32);
            }
            Some(pose)
        };
        Telegram {
            ipoc: self.ipoc,
            q_rad: pose(self.q),
            start_rad: pose(self.start),
            late: self.names_late.then_some(self.late),
            new_connection: false,
        }
    }
}

pub(crate) struct Cell {
    pub(crate) controller: Box<Controller<RamStorage, Spline, Rsi>>,
    pub(crate) robot: Robot,
    /// Beginning of the next cycle.
    pub(crate) next: u64,
    pub(crate) now: u64,
    pub(crate) cycle: u64,
    pub(crate) wire: fn(u64) -> Wire,
    /// What the network does in the next cycle, instead of `wire`.
    pub(crate) forced: Option<Wire>,
    pub(crate) held_back: Option<Telegram>,
    pub(crate) answers: Vec<u64>,
    pub(crate) track: Vec<(u64, [f64; AXES])>,
    pub(crate) asked: bool,
    /// The robot sends nothing.
    pub(crate) silent: bool,
    /// Telegrams arrive up to this time after they were sent, µs.
    pub(crate) jitter_us: u64,
    pub(crate) rng: crate::bench::Rng,
}

impl Cell {
    pub(crate) fn new() -> Self {
        let group = Rsi::new(Options {
            lower_rad: PerJoint::splat(-6.0),
            upper_rad: PerJoint::splat(6.0),
            ..Options::default()
        });
        let controller =
            Controller::with_group(RamStorage::new(), Spline::empty(), group, &settings(), Seed::FORESEEABLE);
        Self {
            controller: Box::new(controller),
            robot: Robot::new(throw_start()),
            next: 1_000,
            now: 0,
            cycle: 0,
            wire: |_| Wire::Fine,
            forced: None,
            held_back: None,
            answers: Vec::new(),
            track: Vec::new(),
            asked: false,
            silent: false,
            jitter_us: 0,
            rng: crate::bench::Rng(11),
        }
    }

    pub(crate) fn kind(&self) -> StateKind {
        self.controller.state().kind()
    }

    pub(crate) fn cause(&self) -> Option<Cause> {
        self.controller.state().fault().map(|fault| fault.cause)
    }

    pub(crate) fn at(&self) -> Instant {
        Instant::from_micros(self.now)
    }

    fn deadlines_until(&mut self, until: u64) {
        while let Some(due) =
            self.controller.poll_deadline().map(Instant::as_micros).filter(|due| *due <= until)
        {
            self.now = due.max(self.now);
            self.controller.host_heartbeat(self.at(), HOST);
            self.controller.handle_deadline(self.at());
            assert_eq!(self.controller.poll_packet(), None, "nothing is sent unasked");
        }
        self.now = until;
    }

    /// Passes a telegram on; returns the answer of the controller.
    fn hand_over(&mut self, telegram: &Telegram) -> Option<Packet> {
        self.controller.host_heartbeat(self.at(), HOST);
        self.controller.handle_packet(self.at(), &Packet::Robot(*telegram));
        let answer = self.controller.poll_packet();
        assert_eq!(self.controller.poll_packet(), None, "one answer at most");
        if let Some(Packet::Pc(answer)) = answer {
            self.answers.push(answer.ipoc);
        }
        answer
    }

    fn take(&mut self, packet: Option<Packet>) {
        let Some(Packet::Pc(answer)) = packet else { return };
        if answer.ipoc == self.robot.ipoc && self.robot.accepted.is_none() {
            self.robot.accepted =
                Some(std::array::from_fn(|i| f64::from(answer.correction_rad.get(joint(i)))));
            if answer.open && self.robot.open.is_none() {
                self.robot.open = Some(self.next);
            }
            self.robot.stopped |= answer.stop;
        }
    }

    pub(crate) fn step(&mut self) {
        self.deadlines_until(self.next);
        if self.robot.stopped || self.silent {
            self.next += PERIOD_US;
            return;
        }
        self.robot.cycle(self.asked);
        self.asked = true;
        self.track.push((self.now, self.robot.q));
        self.next += PERIOD_US;
        self.cycle += 1;
        let telegram = self.robot.telegram();
        if self.jitter_us > 0 {
            let arrival = self.now + self.rng.below(self.jitter_us);
            self.deadlines_until(arrival);
        }
        let late_one = self.held_back.take();
        match self.forced.take().unwrap_or_else(|| (self.wire)(self.cycle)) {
            Wire::Fine => {
                let answer = self.hand_over(&telegram);
                self.take(answer);
            }
            Wire::TelegramLost => {}
            Wire::AnswerLost | Wire::AnswerLate => {
                self.hand_over(&telegram);
            }
            Wire::Doubled => {
                let answer = self.hand_over(&telegram);
                self.take(answer);
                assert_eq!(self.hand_over(&telegram), None, "no second answer");
            }
            Wire::Overtaken => self.held_back = Some(telegram),
            Wire::NoLate => {
                let answer = self.hand_over(&Telegram { late: Some(0), ..telegram });
                self.take(answer);
            }
            Wire::NoPositions => {
                let answer =
                    self.hand_over(&Telegram { q_rad: None, start_rad: None, late: None, ..telegram });
                self.take(answer);
            }
            Wire::NoAxes => {
                let answer = self.hand_over(&Telegram { q_rad: None, ..telegram });
                self.take(answer);
            }
            Wire::OtherNumber => {
                let answer = self.hand_over(&Telegram { ipoc: telegram.ipoc + 700, ..telegram });
                self.take(answer);
            }
        }
        if let Some(old) = late_one {
            assert_eq!(self.hand_over(&old), None, "an overtaken telegram has no answer");
        }
    }

    pub(crate) fn run_until(&mut self, cycles: u64, kind: StateKind) {
        for _ in 0..cycles {
            if self.kind() == kind {
                return;
            }
            self.step();
        }
        assert_eq!(self.kind(), kind, "{:?}", self.controller.state());
    }

    pub(crate) fn order(&mut self, order: Order) -> Done {
        self.controller.order(self.at(), HOST, order).unwrap()
    }

    /// Ready, with a throw committed.
    pub(crate) fn ready() -> (Self, FileName) {
        let mut cell = Self::new();
        cell.run_until(100, StateKind::Ready);
        let file = throw_file(PERIOD_US as u32, true);
        for (i, piece) in file.chunks(256).enumerate() {
            cell.controller.upload(cell.at(), HOST, 256 * i, piece).unwrap();
        }
        let name = FileName { crc64: Crc64::of(&file), len: file.len() as u32 };
        cell.order(Order::Commit(name));
        (cell, name)
    }

    /// In a throw; and when its plan begins, us.
    pub(crate) fn thrown() -> (Self, u64) {
        let (mut cell, name) = Self::ready();
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = cell.order(Order::ArmPrepare { crc64: name.crc64, valid }) else {
            panic!("no offer")
        };
        cell.step();
        cell.order(Order::ArmConfirm { token, valid });
        cell.order(Order::Run(name));
        let lead = cell.controller.group().profile(cell.controller.settings()).lead;
        let start = cell.now + lead.as_micros();
        cell.cycle = 0;
        (cell, start)
    }

    /// Largest distance of the robot from the closed form of the throw since `from`, rad.
    pub(crate) fn away_rad(&self, start: u64, from: u64) -> f64 {
        let away = |&(at, q): &(u64, [f64; AXES])| {
            let t = (at as f64 - start as f64) * 1e-6;
            (0..AXES).map(|i| (q[i] - throw_reference(i, t).0).abs()).fold(0.0, f64::max)
        };
        self.track.iter().filter(|(at, _)| *at >= from).map(away).fold(0.0, f64::max)
    }
}

/// Cycles of a throw until the arm clearly moves.
pub(crate) const UNDER_WAY: u64 = 40;

#[test]
fn robot_behind_dead_time_and_lag_is_on_the_path_at_the_time_of_the_path() {
    let (mut cell, start) = Cell::thrown();
    cell.run_until(400, StateKind::Ready);
    let away = cell.away_rad(start, start);
    // Straight lines between set points and a jump of the acceleration at the start: the robot causes both.
    assert!((1e-5..6e-3).contains(&away), "{away}");
    assert!(cell.robot.open.is_some(), "the gripper opened");
    assert_eq!(cell.robot.late, 0);
    let numbers = &cell.answers;
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "each telegram has its answer");
}

#[test]
fn lost_telegram_at_speed_is_answered_by_a_catch_up_within_the_cap() {
    for wire in [Wire::TelegramLost, Wire::AnswerLost, Wire::AnswerLate] {
        let (mut cell, start) = Cell::thrown();
        cell.wire = match wire {
            Wire::TelegramLost => |k| if k == UNDER_WAY { Wire::TelegramLost } else { Wire::Fine },
            Wire::AnswerLost => |k| if k == UNDER_WAY { Wire::AnswerLost } else { Wire::Fine },
            _ => |k| if k == UNDER_WAY { Wire::AnswerLate } else { Wire::Fine },
        };
        for _ in 0..UNDER_WAY + 1 {
            cell.step();
        }
        // The robot itself holds for one cycle; later changes are caused by the group.
        cell.robot.a_max = 0.0;
        let lead_cycles = (start - 1_000) / PERIOD_US;
        assert!(lead_cycles > 0 && cell.robot.late == 1, "{wire:?}");
        cell.step();
        cell.robot.a_max = 0.0;
        cell.run_until(400, StateKind::Ready);
        assert!(cell.robot.a_max <= CUT_OUT_RAD_S2, "{wire:?}: {}", cell.robot.a_max);
        let tail = cell.now - 200_000;
        assert!(cell.away_rad(start, tail) < 5e-4, "{wire:?}: ends on its path");
    }
}

#[test]
fn late_answers_one_after_another_end_the_path_and_are_reported() {
    let (mut cell, start) = Cell::thrown();
    cell.wire = |k| if k >= UNDER_WAY && k % 2 == 0 { Wire::AnswerLate } else { Wire::Fine };
    cell.run_until(400, StateKind::Fault);
    assert_eq!(cell.cause(), Some(Cause::AnswersLate));
    assert!(cell.robot.stopped, "the robot is asked to leave the sensor motion");
    assert!(cell.now > start);
}

#[test]
fn doubled_and_overtaken_telegrams_have_no_answer_and_do_no_harm() {
    let (mut cell, _) = Cell::thrown();
    cell.wire = |k| if k % 3 == 0 { Wire::Doubled } else { Wire::Fine };
    cell.run_until(400, StateKind::Ready);
    assert_eq!(cell.robot.late, 0);
    let (mut cell, _) = Cell::thrown();
    cell.wire = |k| if k == UNDER_WAY { Wire::Overtaken } else { Wire::Fine };
    cell.run_until(400, StateKind::Ready);
    assert_eq!(cell.robot.late, 1);
}

#[test]
fn wrong_number_is_echoed_as_it_came_and_the_run_ends_when_numbers_fall_back() {
    let (mut cell, _) = Cell::thrown();
    cell.wire = |k| if k == UNDER_WAY { Wire::OtherNumber } else { Wire::Fine };
    cell.run_until(400, StateKind::Fault);
    assert_eq!(cell.cause(), Some(Cause::RobotRestarted));
}

#[test]
fn restart_in_mid_path_drops_the_path_and_answers_zero_until_the_fault_is_cleared() {
    let (mut cell, _) = Cell::thrown();
    for _ in 0..UNDER_WAY {
        cell.step();
    }
    cell.robot.restart();
    cell.step();
    assert_eq!((cell.kind(), cell.cause()), (StateKind::Fault, Some(Cause::RobotRestarted)));
    let start = cell.robot.start;
    cell.robot.stopped = false;
    for _ in 0..200 {
        cell.robot.stopped = false;
        cell.step();
        assert_eq!(cell.robot.set.last(), Some(&start), "no target of before");
    }
    let fault = cell.controller.state().fault().unwrap();
    cell.order(Order::ClearFault { code: fault.cause.code() });
    cell.robot.stopped = false;
    cell.run_until(100, StateKind::Ready);
    for _ in 0..50 {
        cell.step();
        assert_eq!(cell.robot.set.last(), Some(&start));
    }
    assert!(cell.controller.order(cell.at(), HOST, Order::Stop).is_ok());
    assert!(cell.robot.open.is_none(), "the ball is kept");
}

#[test]
fn silent_robot_is_reported_and_its_return_resumes_nothing() {
    let (mut cell, _) = Cell::thrown();
    for _ in 0..UNDER_WAY {
        cell.step();
    }
    cell.silent = true;
    cell.run_until(100, StateKind::Fault);
    assert!(matches!(cell.cause(), Some(Cause::DriveSilent | Cause::CycleOverrun)), "{:?}", cell.cause());
    // The last answer before the silence comes into force when the robot goes on.
    (cell.silent, cell.robot.stopped) = (false, false);
    cell.step();
    let held = *cell.robot.set.last().unwrap();
    for _ in 0..20 {
        cell.robot.stopped = false;
        cell.step();
        let set = cell.robot.set.last().unwrap();
        let away = (0..AXES).map(|i| (set[i] - held[i]).abs()).fold(0.0, f64::max);
        assert!(away < 1e-6, "{away}");
    }
}

/// Largest acceleration and speed of the set points in a throw whose telegrams arrive up to `jitter_us` late.
fn set_points_with_jitter(jitter_us: u64) -> (f64, f64) {
    let (mut cell, start) = Cell::thrown();
    cell.jitter_us = jitter_us;
    cell.run_until(400, StateKind::Ready);
    assert_eq!(cell.robot.late, 0);
    let away = cell.away_rad(start, start);
    assert!(away < 0.012, "{away}");
    (cell.robot.a_max, cell.robot.v_max)
}

/// A network delays telegrams by some milliseconds, a busy computer by more than half a cycle. Each counts as one cycle, and the
/// reference keeps its pace: it follows the arrival by 23 us per cycle at most, 2 rad/s of which are 1 rad/s2 and 0.2 % of the
/// speed. A planned speed may be 0.5 % below the limit at which a robot stops.
#[test]
fn telegrams_that_arrive_unevenly_or_late_change_neither_pace_nor_acceleration_of_the_set_points() {
    let (a_even, v_even) = set_points_with_jitter(0);
    assert!((2.0..3.0).contains(&v_even), "{v_even}");
    for jitter_us in [4_000, 9_500] {
        let (a, v) = set_points_with_jitter(jitter_us);
        assert!(a < a_even + 1.0 && v < 1.0025 * v_even, "{jitter_us} us: {a} {a_even}, {v} {v_even}");
    }
}

/// The robot stood for longer than a cycle, and its telegrams come later from then on. The reference catches up slowly.
#[test]
fn robot_that_stood_for_some_cycles_sees_no_faster_set_points_afterwards() {
    let (_, v_even) = set_points_with_jitter(0);
    for stood_us in [7_000, 20_000] {
        let (mut cell, _) = Cell::thrown();
        for _ in 0..UNDER_WAY {
            cell.step();
        }
        cell.next += stood_us;
        for _ in 0..5 {
            cell.step();
        }
        cell.next += stood_us;
        cell.run_until(400, StateKind::Ready);
        let v = cell.robot.v_max;
        assert!(v < 1.0025 * v_even, "{stood_us} us: {v} {v_even}");
        assert!(cell.robot.a_max <= CUT_OUT_RAD_S2);
    }
}

#[test]
fn axis_that_stays_behind_ends_the_path_and_is_reported_with_its_number() {
    let (mut cell, _) = Cell::thrown();
    for _ in 0..UNDER_WAY {
        cell.step();
    }
    for _ in 0..40 {
        cell.robot.q[2] -= 0.2;
        cell.step();
        // The push of this cycle has decayed by one period of the lag.
        cell.robot.q[2] += 0.2 * (-0.5f64).exp();
    }
    cell.run_until(400, StateKind::Fault);
    assert_eq!(cell.cause(), Some(Cause::RobotLags));
}
