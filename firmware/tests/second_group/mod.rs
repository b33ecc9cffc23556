//! A second group behind the same controller: ideal position drives of a robot that is the clock itself.
//!
//! One packet carries all axes, both ways, and is no CAN frame. The robot sends a packet every 4 ms; the group answers each
//! one with positions, at once and exactly once. The robot follows positions by itself, so the controller closes no loop
//! ([`Law::Reference`]) and needs no gains. There is no host link: orders are given in the process.
//!
//! The witness is the robot: its positions are compared with the closed form of the throw in double precision.

mod robots;

use crate::bench::{HA, HB, HOST, joint, throw_file, throw_reference, throw_start};
use firmware::Controller;
use firmware::authority::Seed;
use firmware::fault::{Cause, Fault, Refusal};
use firmware::orders::{Done, Order};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::state::StateKind;
use firmware::store::{FileName, RamStorage};
use protocol::cyphal::crc::Crc64;
use protocol::{Duration, Instant};
use robots::{AXES, PERIOD_US, Packet, Robots, WINDOW, Wish};

/// The robot as it is: ideal drives in double precision, with a clock of its own.
struct Robot {
    number: u32,
    q_rad: [f64; AXES],
    target_rad: [f64; AXES],
    homed: u8,
    /// Joint on its way to its zero, and packets left until it is there.
    homing: Option<(usize, u32)>,
    halted: bool,
    silent: bool,
    answers: u32,
    unasked: u32,
    /// Largest change of position in one period, and largest change of that change, rad.
    step_max_rad: f64,
    leap_max_rad: f64,
    before: [f64; AXES],
}

impl Robot {
    fn period(&mut self) -> Packet {
        self.number += 1;
        for i in 0..AXES {
            let step = if self.halted { 0.0 } else { self.target_rad[i] - self.q_rad[i] };
            self.step_max_rad = self.step_max_rad.max(step.abs());
            if !self.halted {
                self.leap_max_rad = self.leap_max_rad.max((step - self.before[i]).abs());
            }
            self.before[i] = step;
            self.q_rad[i] += step;
        }
        if let Some((joint, left)) = &mut self.homing {
            *left -= 1;
            if *left == 0 {
                self.homed |= 1 << *joint;
                self.homing = None;
            }
        }
        let q_rad = self.q_rad.map(|q| q as f32);
        Packet::FromRobot { number: self.number, q_rad, homed: self.homed, halted: self.halted }
    }

    fn take(&mut self, packet: &Packet) {
        let Packet::ToRobot { answers, q_rad, wish } = *packet else { panic!("a packet from the robot") };
        if answers != self.number {
            self.unasked += 1;
            return;
        }
        self.answers += 1;
        match wish {
            Wish::Follow => {}
            Wish::FindZero(mask) => {
                let joint = mask.trailing_zeros() as usize;
                if self.homed & mask == 0 && self.homing.is_none() {
                    self.homing = Some((joint, 50));
                }
            }
            Wish::Halt => self.halted = true,
            Wish::Reset => {
                self.halted = false;
                self.before = [0.0; AXES];
            }
        }
        if !self.halted {
            self.target_rad = q_rad.map(f64::from);
        }
    }
}

struct Cell {
    controller: Box<Controller<RamStorage, Spline, Robots>>,
    robot: Robot,
    now: u64,
    packet_due: u64,
    packets: u32,
    rng: crate::bench::Rng,
    /// Packets arrive up to so much late.
    jitter_us: u64,
    heartbeat: bool,
    gripper: Vec<(u64, bool)>,
    /// Position at each packet.
    track: Vec<(u64, [f64; AXES])>,
}

fn settings() -> Settings {
    Settings {
        cycle_period_us: PERIOD_US as u32,
        // No gains: the robot closes its own loop.
        gains_certificate_crc32: 0,
        ..Settings::powercube6()
    }
}

impl Cell {
    fn new(q_rad: [f64; AXES], homed: u8) -> Self {
        let robot = Robot {
            number: 4_710,
            q_rad,
            target_rad: q_rad,
            homed,
            homing: None,
            halted: false,
            silent: false,
            answers: 0,
            unasked: 0,
            step_max_rad: 0.0,
            leap_max_rad: 0.0,
            before: [0.0; AXES],
        };
        let controller =
            Controller::with_spline(RamStorage::new(), Spline::empty(), &settings(), Seed::FORESEEABLE);
        Self {
            controller: Box::new(controller),
            robot,
            now: 0,
            packet_due: 1_000,
            packets: 0,
            rng: crate::bench::Rng(7),
            jitter_us: 0,
            heartbeat: true,
            gripper: Vec::new(),
            track: Vec::new(),
        }
    }

    fn instant(&self) -> Instant {
        Instant::from_micros(self.now)
    }

    fn kind(&self) -> StateKind {
        self.controller.state().kind()
    }

    fn cause(&self) -> Option<Cause> {
        self.controller.state().fault().map(|fault| fault.cause)
    }

    /// One event: a packet of the robot or a deadline of the controller.
    fn step(&mut self) {
        let due = self.controller.poll_deadline().map_or(u64::MAX, Instant::as_micros).max(self.now);
        self.now = due.min(self.packet_due);
        let at = self.instant();
        if self.heartbeat {
            self.controller.host_heartbeat(at, HOST);
        }
        if self.packet_due <= due {
            let packet = self.robot.period();
            self.track.push((self.now, self.robot.q_rad));
            let late = if self.jitter_us > 0 { self.rng.below(self.jitter_us) } else { 0 };
            self.packet_due += PERIOD_US;
            if !self.robot.silent {
                self.packets += 1;
                self.now += late;
                let at = self.instant();
                self.controller.handle_packet(at, &packet);
            }
        } else {
            self.controller.handle_deadline(at);
        }
        self.drain();
    }

    fn drain(&mut self) {
        while let Some(packet) = self.controller.poll_packet() {
            self.robot.take(&packet);
        }
        if let Some(level) = self.controller.take_gripper_level() {
            self.gripper.push((self.now, level));
        }
    }

    fn run_for(&mut self, us: u64) {
        let end = self.now + us;
        while self.now < end {
            self.step();
        }
    }

    fn run_until(&mut self, us: u64, kind: StateKind) {
        let end = self.now + us;
        while self.now < end && self.kind() != kind {
            self.step();
        }
        assert_eq!(self.kind(), kind, "{:?}", self.controller.state());
    }

    fn order(&mut self, order: Order) -> Result<Done, Refusal> {
        let at = self.instant();
        let outcome = self.controller.order(at, HOST, order);
        self.drain();
        outcome
    }

    fn armed(&mut self) -> FileName {
        let file = throw_file(PERIOD_US as u32, true);
        for (i, piece) in file.chunks(256).enumerate() {
            let at = self.instant();
            self.controller.upload(at, HOST, 256 * i, piece).unwrap();
        }
        let name = FileName { crc64: Crc64::of(&file), len: file.len() as u32 };
        self.order(Order::Commit(name)).unwrap();
        let valid = Duration::from_secs(5);
        let Done::Offer { token, .. } = self.order(Order::ArmPrepare { crc64: name.crc64, valid }).unwrap()
        else {
            panic!("no offer")
        };
        self.run_for(20_000);
        self.order(Order::ArmConfirm { token, valid }).unwrap();
        name
    }

    /// A throw that has begun; returns when its plan starts.
    fn thrown(jitter_us: u64) -> (Self, u64) {
        let mut cell = Self::new(throw_start(), 0x3f);
        cell.run_until(500_000, StateKind::Ready);
        cell.jitter_us = jitter_us;
        let name = cell.armed();
        cell.order(Order::Run(name)).unwrap();
        let start = cell.now + 3 * PERIOD_US;
        (cell, start)
    }

    /// Largest distance of the robot from the closed form of the throw, rad.
    fn away_rad(&self, start: u64) -> f64 {
        let away = |&(at, q): &(u64, [f64; AXES])| {
            let t = (at as f64 - start as f64) * 1e-6;
            (0..AXES).map(|i| (q[i] - throw_reference(i, t).0).abs()).fold(0.0, f64::max)
        };
        self.track.iter().filter(|(at, _)| *at + PERIOD_US > start).map(away).fold(0.0, f64::max)
    }
}

#[test]
fn robot_that_is_the_clock_is_found_homed_and_throws() {
    let mut cell = Cell::new(throw_start(), 0);
    assert_eq!(cell.kind(), StateKind::Boot);
    cell.run_until(500_000, StateKind::Idle);
    cell.order(Order::Home { mask: 0x3f }).unwrap();
    cell.run_until(5_000_000, StateKind::Ready);
    assert_eq!(cell.robot.homed, 0x3f);
    let name = cell.armed();
    cell.order(Order::Run(name)).unwrap();
    let start = cell.now + 3 * PERIOD_US;
    cell.run_until(100_000, StateKind::Running);
    cell.run_until(2_000_000, StateKind::Ready);

    let away = cell.away_rad(start);
    println!("largest distance from the closed form {away:.2e} rad");
    // Single precision, and rounding of the start to the packet's time, at most 2.6 rad/s times a microsecond.
    assert!((1e-9..2e-5).contains(&away), "{away}");
    let speed_max = cell.robot.step_max_rad / (PERIOD_US as f64 * 1e-6);
    assert!((2.5..2.6).contains(&speed_max), "{speed_max} rad/s");
    let opened: Vec<u64> = cell.gripper.iter().filter(|(_, open)| *open).map(|(at, _)| *at).collect();
    let free_at = start + (HA * 1e6).round() as u64;
    assert_eq!(opened, [free_at - u64::from(settings().gripper_opening_us)]);
    assert_eq!((cell.robot.answers, cell.robot.unasked), (cell.packets, 0), "one answer per packet");
}

#[test]
fn late_packets_within_the_window_move_the_throw_by_their_lateness_only() {
    let (mut cell, start) = Cell::thrown(1_500);
    cell.run_until(100_000, StateKind::Running);
    cell.run_until(2_000_000, StateKind::Ready);
    let away = cell.away_rad(start);
    assert!((1e-4..2.6 * 1.5e-3).contains(&away), "{away} rad");
    assert_eq!((cell.robot.answers, cell.robot.unasked), (cell.packets, 0));
}

#[test]
fn packets_that_stay_away_stop_the_group_and_keep_the_ball() {
    for into_us in [150_000, 320_000, 450_000] {
        let (mut cell, start) = Cell::thrown(0);
        cell.run_for(start + into_us - cell.now);
        assert_eq!(cell.kind(), StateKind::Running);
        cell.robot.silent = true;
        let silent_at = cell.now;
        while cell.kind() == StateKind::Running {
            cell.step();
        }
        let after = cell.now - silent_at;
        assert!((WINDOW.as_micros()..=WINDOW.as_micros() + 2 * PERIOD_US).contains(&after), "{after} us");
        // The robot comes back before the group has given up: the rest of the stop is a ramp.
        cell.robot.silent = false;
        let (q_before, step_before) = (cell.robot.q_rad, cell.robot.step_max_rad);
        cell.run_until(1_500_000, StateKind::Fault);
        assert_eq!(cell.controller.state().fault(), Some(Fault::at(Cause::DriveSilent, joint(0))));
        cell.run_for(50_000);
        assert!(cell.robot.halted);
        let rest = cell.robot.q_rad;
        cell.run_for(200_000);
        assert_eq!(cell.robot.q_rad, rest, "the robot stands");
        let moved = (0..AXES).map(|i| (rest[i] - q_before[i]).abs()).fold(0.0, f64::max);
        assert!(moved < 0.5, "{moved} rad to rest");
        assert!(
            cell.robot.step_max_rad <= step_before.max(2.6 * 0.004),
            "no step back to where the plan would be"
        );
        assert!(cell.gripper.iter().all(|(_, open)| !open), "the ball is kept");
        // Cleared, it stands and can be armed again.
        cell.order(Order::ClearFault { code: Cause::DriveSilent.code() }).unwrap();
        cell.run_until(500_000, StateKind::Ready);
        assert!(!cell.robot.halted);
    }
}

#[test]
fn stop_order_keeps_the_path_of_a_group_without_gains() {
    let (mut cell, start) = Cell::thrown(0);
    cell.run_for(start + 400_000 - cell.now);
    cell.order(Order::Stop).unwrap();
    cell.run_until(1_500_000, StateKind::Stopped);
    assert_eq!(cell.cause(), Some(Cause::StopOrdered));
    let distance =
        |t: f64| (0..AXES).map(|i| (cell.robot.q_rad[i] - throw_reference(i, t).0).abs()).fold(0.0, f64::max);
    let away =
        (0..=2_000).map(|k| distance(f64::from(k) * (HA + HB) / 2_000.0)).fold(f64::INFINITY, f64::min);
    assert!(away < 1e-3, "{away} rad beside the path");
}

#[test]
fn jog_moves_one_joint_while_it_is_repeated() {
    let mut cell = Cell::new([0.0; AXES], 0);
    cell.run_until(500_000, StateKind::Idle);
    for _ in 0..10 {
        let hold = Duration::from_millis(100);
        cell.order(Order::Jog { joint: joint(2), qd_rad_s: -0.2, hold }).unwrap();
        cell.run_for(50_000);
    }
    cell.run_until(1_000_000, StateKind::Idle);
    let q = cell.robot.q_rad;
    assert!((-0.13..-0.09).contains(&q[2]), "{q:?}");
    assert!(q.iter().enumerate().all(|(i, q)| i == 2 || *q == 0.0), "{q:?}");
}
