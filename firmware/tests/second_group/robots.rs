//! The group: what a family with one packet for all axes needs. The example of `docs/drive-family.md`.

use std::collections::VecDeque;

use firmware::fault::{Cause, Refusal};
use firmware::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, InForce, Law, Measured, PositionSample, Profile,
    Readings, SetPoint, Standing, Taken,
};
use firmware::rest::Rest;
use firmware::settings::Settings;
use protocol::{Duration, Instant, JointIndex};

use crate::bench::joint;

pub(crate) const AXES: usize = 6;
pub(crate) const PERIOD_US: u64 = 4_000;
pub(crate) const PERIOD: Duration = Duration::from_micros(PERIOD_US);
/// Later than this after the last packet one counts as missed.
pub(crate) const WINDOW: Duration = Duration::from_micros(PERIOD_US + 2_000);

/// What goes over the wire, both ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Packet {
    FromRobot { number: u32, q_rad: [f32; AXES], homed: u8, halted: bool },
    ToRobot { answers: u32, q_rad: [f32; AXES], wish: Wish },
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Wish {
    #[default]
    Follow,
    FindZero(u8),
    Halt,
    Reset,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Mode {
    #[default]
    Finding,
    Standing,
    Homing(JointIndex),
    Jogging {
        joint: JointIndex,
        qd_rad_s: f32,
        until: Instant,
        released: bool,
    },
    Tracking,
    Moving,
    Braking,
    Halted,
}

/// The group: what a family with one packet for all axes needs.
#[derive(Default)]
pub(crate) struct Robots {
    mode: Mode,
    events: VecDeque<GroupEvent>,
    out: Option<Packet>,
    /// The packet that waits for its answer.
    unanswered: Option<u32>,
    last_number: Option<u32>,
    sample: [Option<PositionSample>; AXES],
    rest: [Rest; AXES],
    homed: u8,
    halted: bool,
    /// Positions last commanded, and the speed at which they move.
    target_rad: [f32; AXES],
    speed_rad_s: [f32; AXES],
    end_rad: [f32; AXES],
    wish: Wish,
    at: Instant,
    due: Instant,
    missed_in_row: u32,
}

impl Robots {
    fn hold(&mut self) {
        for (target, sample) in self.target_rad.iter_mut().zip(self.sample) {
            *target = sample.map_or(*target, |sample| sample.q_rad);
        }
        self.speed_rad_s = [0.0; AXES];
    }

    /// Moves the commanded positions by one period.
    fn step(&mut self, now: Instant, settings: &Settings) {
        let dt_s = PERIOD_US as f32 * 1e-6;
        for i in 0..AXES {
            let limits = settings.joint.at(joint(i));
            let (speed, a_rad_s2) = match self.mode {
                Mode::Braking => (0.0, limits.a_max_rad_s2),
                Mode::Jogging { joint, qd_rad_s, until, .. } if joint.get() == i && now < until => {
                    (qd_rad_s, limits.jog_a_rad_s2)
                }
                Mode::Moving => {
                    let way = self.end_rad[i] - self.target_rad[i];
                    let stopping = (2.0 * limits.jog_a_rad_s2 * way.abs()).sqrt();
                    let speed = way.signum() * stopping.min(limits.jog_v_rad_s).min(way.abs() / dt_s);
                    (speed, limits.a_max_rad_s2)
                }
                Mode::Jogging { .. } => (0.0, limits.jog_a_rad_s2),
                _ => continue,
            };
            let change = a_rad_s2 * dt_s;
            self.speed_rad_s[i] += (speed - self.speed_rad_s[i]).clamp(-change, change);
            self.target_rad[i] += self.speed_rad_s[i] * dt_s;
        }
    }
}

impl DriveGroup for Robots {
    type Packet = Packet;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, packet: &Packet) {
        let Packet::FromRobot { number, q_rad, homed, halted } = *packet else { return };
        if self.last_number.is_some_and(|last| number <= last) {
            return;
        }
        let number_is_first = self.last_number.is_none();
        (self.last_number, self.unanswered) = (Some(number), Some(number));
        (self.homed, self.halted, self.missed_in_row) = (homed, halted, 0);
        (self.at, self.due) = (now, now + WINDOW);
        for (i, q_rad) in q_rad.into_iter().enumerate() {
            let sample = PositionSample { q_rad, at: now };
            self.sample[i] = Some(sample);
            self.rest[i].take(sample);
            let in_force = (self.mode == Mode::Tracking).then_some(InForce { u_rad_s2: 0.0, in_time: true });
            self.events.push_back(GroupEvent::Measured(Measured {
                joint: joint(i),
                sample,
                in_force,
                trouble: None,
            }));
        }
        if number_is_first {
            self.hold();
        }
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        match self.mode {
            Mode::Finding if all_rest && !halted => self.events.push_back(GroupEvent::Found),
            Mode::Homing(joint) if homed & joint.bit() != 0 && all_rest => {
                self.events.push_back(GroupEvent::Homed(joint));
            }
            Mode::Jogging { until, released: false, joint, qd_rad_s } if until <= now => {
                self.mode = Mode::Jogging { joint, qd_rad_s, until, released: true };
                self.events.push_back(GroupEvent::JogReleased);
            }
            Mode::Jogging { released: true, .. } if all_rest => self.events.push_back(GroupEvent::JogEnded),
            _ => {}
        }
        self.events.push_back(GroupEvent::Cycle { late: Duration::ZERO, overrun: false });
    }

    fn handle_timeout(&mut self, now: Instant, settings: &Settings) {
        if self.due > now {
            return;
        }
        // The packet stayed away: the group's own clock goes on, without anything to answer.
        let late = now.saturating_since(self.due);
        (self.at, self.due) = (now, now + PERIOD);
        self.missed_in_row += 1;
        for joint in settings.joints() {
            self.events.push_back(GroupEvent::Missed(joint, self.missed_in_row));
        }
        self.events.push_back(GroupEvent::Cycle { late, overrun: true });
    }

    fn poll_event(&mut self, _: Instant, _: &Settings) -> Option<GroupEvent> {
        self.events.pop_front()
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        let Some(answers) = self.unanswered.take() else { return };
        self.step(now, settings);
        let wish = match self.mode {
            Mode::Homing(joint) => Wish::FindZero(joint.bit()),
            _ => core::mem::take(&mut self.wish),
        };
        self.out = Some(Packet::ToRobot { answers, q_rad: self.target_rad, wish });
    }

    fn poll_packet(&mut self) -> Option<Packet> {
        self.out.take()
    }

    fn poll_timeout(&self, _: Instant, _: &Settings) -> Option<Instant> {
        Some(self.due)
    }

    fn command(&mut self, _: Instant, _: &Settings, command: Command) {
        match command {
            Command::Find { reset } => {
                self.hold();
                (self.mode, self.rest) = (Mode::Finding, Default::default());
                self.wish = if reset { Wish::Reset } else { Wish::Follow };
            }
            Command::Reset => {
                self.hold();
                self.wish = Wish::Reset;
            }
            Command::Stand { .. } => self.mode = Mode::Standing,
            Command::Abandon => {
                (self.mode, self.wish) = (Mode::Standing, Wish::Halt);
            }
            Command::Home(joint) => self.mode = Mode::Homing(joint),
            Command::Jog { joint, qd_rad_s, until } => {
                if !matches!(self.mode, Mode::Jogging { .. }) {
                    self.hold();
                }
                self.mode = Mode::Jogging { joint, qd_rad_s, until, released: false };
            }
            Command::Track => {
                self.hold();
                self.mode = Mode::Tracking;
            }
            Command::MoveTo { joint, q_rad } => {
                if self.mode != Mode::Moving {
                    (self.mode, self.end_rad) = (Mode::Moving, self.target_rad);
                }
                self.end_rad[joint.get()] = q_rad;
            }
            Command::Halt | Command::HaltJoint(_) => (self.mode, self.wish) = (Mode::Halted, Wish::Halt),
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        self.mode = Mode::Braking;
        let longest = (0..AXES)
            .map(|i| self.speed_rad_s[i].abs() / settings.joint.at(joint(i)).a_max_rad_s2)
            .fold(0.0f32, f32::max);
        now + Duration::from_micros((longest * 1e6) as u64) + PERIOD * 4
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let limits = settings.joint.at(joint);
        self.target_rad[joint.get()] = set_point.q_rad.clamp(limits.q_min_rad, limits.q_max_rad);
        self.speed_rad_s[joint.get()] = set_point.qd_rad_s;
        Taken::default()
    }

    fn acts_at(&self, _: JointIndex) -> Instant {
        // The robot is there when it sends its next packet.
        self.at + PERIOD
    }

    fn observe(&mut self, _: JointIndex, _: f32, _: f32) {}

    fn set_gripper(&mut self, _: &Settings, _: bool) -> bool {
        false
    }

    fn cancel_gripper(&mut self) {}

    fn profile(&self, _: &Settings) -> Profile {
        Profile { law: Law::Reference, period: PERIOD, lag: Duration::ZERO, lead: PERIOD * 3 }
    }

    fn check_group(&self, _: Instant, _: &Settings) -> Result<(), Refusal> {
        if self.missed_in_row == 0 { Ok(()) } else { Err(Refusal::of(Cause::DriveNotReady)) }
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        if !self.is_homed(joint) {
            return Err(Refusal::at(Cause::NotHomed, joint));
        }
        let fit = self.is_at_rest(now, settings, joint) && !self.halted;
        if fit { Ok(()) } else { Err(Refusal::at(Cause::DriveNotReady, joint)) }
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.sample.get(joint.get()).copied().flatten()
    }

    fn is_homed(&self, joint: JointIndex) -> bool {
        self.homed & joint.bit() != 0
    }

    fn is_at_rest(&self, now: Instant, _: &Settings, joint: JointIndex) -> bool {
        self.rest[joint.get()].since(now, WINDOW * 2).is_some()
    }

    fn is_moving(&self, now: Instant, _: &Settings, joint: JointIndex) -> bool {
        self.rest[joint.get()].is_moving(now, WINDOW * 2)
    }

    fn standing(&self, joint: JointIndex, halted_is_fine: bool) -> Standing {
        let halted = self.halted && !halted_is_fine && joint.get() < AXES;
        Standing { trouble: halted.then_some(Cause::DriveError), ..Standing::default() }
    }

    fn readings(&self, _: JointIndex) -> Readings {
        Readings { missed_in_row: self.missed_in_row, halted: self.halted, ..Readings::default() }
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters::default()
    }

    fn is_keeping_time(&self) -> bool {
        false
    }

    fn is_cycle_done(&self, _: &Settings) -> bool {
        self.unanswered.is_none()
    }
}
