//! An industrial robot behind a sensor interface (KUKA RSI): the robot is the clock, one packet carries all axes, and the
//! robot closes its own loops.
//!
//! The group answers each new telegram once, at once, with the telegram's number. An answer holds offsets from the start
//! pose of the robot's program. A runner that finds several telegrams waiting hands over the newest only.
//!
//! # From set point to axis
//!
//! A value in the answer to cycle k comes into force in cycle k+1. The axes follow after a dead time, with a first-order lag.
//! References are taken the dead time later ([`Profile::lag`]), and `q + T q̇` is commanded, so the axes are on the path at
//! the time of the path. A model of the drives ([`model`](self)) tells how far measured axes are from where they should be.
//!
//! # Invariants
//!
//! * A new program run, [`Command::Halt`] and [`Command::Find`] discard the target for good.
//! * A set point never changes faster than [`Options::a_cap_rad_s2`] allows. After a late answer the robot has held the last set
//!   point, and the group continues from that one.
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`packet`] | telegram, answer, options |
//! | `link` | new, old and first telegrams |
//! | `model` | where the axes should be |
//! | `shape` | the next set point of an axis |
//! | `motion` | what all axes do in a mode |
//! | `events` | what waits to be told |

mod events;
mod link;
mod model;
mod motion;
pub mod packet;
mod shape;

use protocol::{Duration, Instant, JointIndex};

use self::events::Pending;
use self::link::{Kind, Order};
use self::model::DriveModel;
use self::motion::{Mode, Setpoints};
pub use self::packet::{Answer, Options, Packet, Telegram};
use crate::fault::{Cause, Fault, Refusal};
use crate::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, Law, PositionSample, Profile, Readings, SetPoint,
    Standing, Taken,
};
use crate::joints::{PerJoint, at_least, clamp};
use crate::rest::Rest;
use crate::settings::Settings;
use crate::span;

/// Cycles without a telegram after which it counts as missed.
const WINDOWS: u64 = 3;
/// Cycles from the end of the lag to the start of a plan.
const LEAD_CYCLES: u64 = 4;
/// The grid follows arrival times with this fraction, as 1/n.
const GRID_SHARE: u64 = 16;
/// And by this share of the period at most, as 1/n. It raises the speed of set points by the same share, and a planned speed may
/// be 0.5 % below the robot's limit. Clocks drift by less than a tenth of it.
const GRID_CAP: u64 = 512;
/// Telegrams in a row with lagging axes that end a path.
const LAGGING_ROW: u8 = 3;

/// See the [module](self).
#[derive(Debug, Default)]
pub struct Rsi {
    options: Options,
    order: Order,
    model: DriveModel,
    motion: Setpoints,
    pending: Pending,
    /// Start pose of the running program, rad.
    start_rad: Option<PerJoint<f32>>,
    sample: PerJoint<Option<PositionSample>>,
    rest: PerJoint<Rest>,
    /// The telegram that waits for its answer.
    unanswered: Option<u64>,
    out: Option<Answer>,
    /// Time of the last telegram, or of the cycle that stands for it.
    at: Instant,
    /// Time of the last telegram.
    heard_at: Instant,
    /// Beginning of the robot's cycle of that telegram, smoothed: a network and a busy computer delay telegrams unevenly, and a
    /// millisecond of that would be a leap of the set points.
    grid: Instant,
    due: Option<Instant>,
    /// Number of the last telegram, and by how much numbers rise per cycle; 0: not known yet.
    ipoc: u64,
    ipoc_step: u64,
    missed_in_row: u32,
    /// Late answers as the robot counted them last, and since the run began.
    late: Option<u32>,
    late_in_run: u32,
    lagging_row: u8,
    open: bool,
    /// Delay until the gripper opens, s.
    opens_in_s: Option<f32>,
    stop: bool,
    answers: u32,
}

impl Rsi {
    /// For a robot and its program.
    pub fn new(options: Options) -> Self {
        Self { options, ..Self::default() }
    }

    /// How much later than expected the axes passed the path, s; negative: earlier. Measured during the last run.
    pub const fn path_delay_s(&self) -> f32 {
        self.model.delay_s()
    }

    /// Start pose of the running program, rad; `None` before its first telegram with positions.
    pub const fn start_rad(&self) -> Option<&PerJoint<f32>> {
        self.start_rad.as_ref()
    }

    /// Forgets everything that belonged to the program run before.
    fn begin(&mut self) {
        let first = self.start_rad.is_none() && self.due.is_none();
        self.start_rad = None;
        self.late = None;
        self.opens_in_s = None;
        self.rest = PerJoint::default();
        if !first && self.motion.mode != Mode::Finding {
            self.motion.mode = Mode::Halted;
            self.pending.trouble(Fault::group(Cause::RobotRestarted));
        }
    }

    fn latch(&mut self, pose_rad: PerJoint<f32>) {
        self.start_rad = Some(pose_rad);
        self.motion.rest_at(pose_rad);
        self.model.rest_at(pose_rad);
    }

    /// Moves the grid on to the cycle of a telegram that arrives now; returns the cycles that have passed.
    ///
    /// Its number says how many: a telegram that a busy computer or a held-up robot hands over late, but before it counts as
    /// missed, is still the next one. The time says it for a number ahead by more than one cycle, which is wrong, and after a
    /// silence since the telegram before, in which the robot stood.
    fn advance_grid(&mut self, now: Instant, period: Duration, ipoc: u64) -> u32 {
        let period_us = period.as_micros().max(1);
        let cycles_since = |at: Instant| {
            (now.saturating_since(at).as_micros().saturating_add(period_us / 2) / period_us).max(1)
        };
        let by_time = cycles_since(self.grid);
        let rise = ipoc.saturating_sub(self.ipoc);
        if rise > 0 && (self.ipoc_step == 0 || rise < self.ipoc_step) {
            self.ipoc_step = rise;
        }
        let by_number = rise.checked_div(self.ipoc_step).unwrap_or(by_time).max(1);
        let is_ahead = by_number > by_time.saturating_add(1);
        let is_missed = cycles_since(self.heard_at) >= by_number.saturating_add(WINDOWS);
        let cycles = if is_ahead || is_missed { by_time } else { by_number };
        let expected = self.grid + period * cycles;
        let towards =
            |off: Duration| Duration::from_micros((off.as_micros() / GRID_SHARE).min(period_us / GRID_CAP));
        self.grid = match now.checked_since(expected) {
            Some(later) => expected + towards(later),
            None => expected.saturating_sub(towards(expected.saturating_since(now))),
        };
        u32::try_from(cycles).unwrap_or(u32::MAX)
    }

    /// What the robot did with the answers since the last telegram, `cycles` ago.
    fn account(&mut self, telegram: &Telegram, period: Duration, cycles: u32) {
        let late = match (self.late, telegram.late) {
            (Some(before), Some(now)) => now.saturating_sub(before),
            _ => 0,
        };
        self.late = telegram.late.or(self.late);
        self.late_in_run = self.late_in_run.saturating_add(late);
        if late >= cycles {
            self.motion.refused();
        } else if cycles > 1 {
            self.motion.held();
        }
        let set_rad = self.motion.set_rad();
        // A long silence ends the run, so few cycles are left to make up for.
        for _ in 0..cycles.min(model::KEPT_CYCLES as u32) {
            self.model.step(&self.options, period, &set_rad);
        }
    }

    fn measure(&mut self, at: Instant, settings: &Settings, q_rad: &PerJoint<f32>) {
        for joint in settings.joints() {
            let sample = PositionSample { q_rad: q_rad.get(joint), at };
            self.sample.set(joint, Some(sample));
            self.rest.at_mut(joint).take(sample);
        }
        self.model.compare(settings.joints as usize, q_rad);
        self.pending.measured(settings);
    }

    /// Faults of the link that end a path.
    fn judge(&mut self) {
        if self.motion.mode != Mode::Tracking {
            self.lagging_row = 0;
            return;
        }
        let (residual_rad, worst) = self.model.residual_rad();
        // Written so that NaN lags.
        let follows = residual_rad <= self.options.lag_max_rad
            && self.model.delay_s().abs() <= span::seconds(self.options.delay_max);
        self.lagging_row = if follows { 0 } else { self.lagging_row.saturating_add(1) };
        if self.lagging_row >= LAGGING_ROW {
            self.lagging_row = 0;
            self.pending.trouble(Fault { cause: Cause::RobotLags, joint: worst });
        } else if self.late_in_run >= self.options.late_max {
            self.late_in_run = 0;
            self.pending.trouble(Fault::group(Cause::AnswersLate));
        }
    }

    /// Events of modes that end by themselves.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        match &mut self.motion.mode {
            Mode::Finding if all_rest && self.start_rad.is_some() => self.pending.tell(GroupEvent::Found),
            Mode::Homing(joint) => {
                let joint = *joint;
                self.motion.mode = Mode::Standing;
                self.pending.tell(GroupEvent::Homed(joint));
            }
            Mode::Jogging { until, released, .. } if !*released && *until <= now => {
                *released = true;
                self.pending.tell(GroupEvent::JogReleased);
            }
            Mode::Jogging { released: true, .. } if all_rest => self.pending.tell(GroupEvent::JogEnded),
            _ => {}
        }
    }

    /// All axes brake together; the ball is kept.
    fn halt(&mut self, settings: &Settings) {
        self.opens_in_s = None;
        self.motion.brake(settings, &self.options);
        self.motion.mode = Mode::Halted;
    }

    fn serve_gripper(&mut self, period_s: f32) {
        let Some(left_s) = self.opens_in_s else { return };
        if self.motion.mode == Mode::Tracking && left_s > 0.5 * period_s {
            self.opens_in_s = Some(left_s - period_s);
        } else {
            (self.open, self.opens_in_s) = (true, None);
        }
    }
}

impl DriveGroup for Rsi {
    type Packet = Packet;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, packet: &Packet) {
        let Packet::Robot(telegram) = packet else { return };
        let period = settings.cycle_period();
        match self.order.judge(now, telegram) {
            Kind::Old => return,
            Kind::First => {
                self.ipoc_step = 0;
                self.grid = now;
                self.begin();
            }
            Kind::Next => {
                let cycles = self.advance_grid(now, period, telegram.ipoc);
                self.account(telegram, period, cycles);
            }
        }
        self.unanswered = Some(telegram.ipoc);
        self.ipoc = telegram.ipoc;
        (self.at, self.heard_at, self.missed_in_row) = (self.grid, now, 0);
        self.due = Some(now + period * WINDOWS);
        let finite = |q_rad: &PerJoint<f32>| settings.joints().all(|joint| q_rad.get(joint).is_finite());
        if let Some(q_rad) = telegram.q_rad.filter(finite) {
            if self.start_rad.is_none() {
                self.latch(telegram.start_rad.filter(finite).unwrap_or(q_rad));
            }
            self.late = telegram.late.or(self.late);
            self.measure(self.grid, settings, &q_rad);
            self.judge();
            self.proceed(now, settings);
        }
        self.pending.cycle(Duration::ZERO, false);
    }

    fn handle_timeout(&mut self, now: Instant, settings: &Settings) {
        let Some(due) = self.due.filter(|due| *due <= now) else { return };
        // The group's own clock goes on, without anything to answer.
        self.at = now;
        self.due = Some(now + settings.cycle_period());
        self.missed_in_row = self.missed_in_row.saturating_add(1);
        self.pending.missed(settings, self.missed_in_row);
        self.pending.cycle(now.saturating_since(due), true);
    }

    fn poll_event(&mut self, _: Instant, _: &Settings) -> Option<GroupEvent> {
        let tracking = (self.motion.mode == Mode::Tracking).then(|| self.model.delay_s());
        self.pending.poll(&self.sample, tracking)
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        let Some(ipoc) = self.unanswered.take() else { return };
        let period_s = settings.cycle_period_s();
        let mut correction_rad = PerJoint::default();
        if let Some(start_rad) = self.start_rad {
            self.motion.step(now, settings, &self.options);
            for joint in settings.joints() {
                let wish = self.motion.axis(joint).q_rad - start_rad.get(joint);
                let (low, high) = (self.options.lower_rad.get(joint), self.options.upper_rad.get(joint));
                correction_rad.set(joint, clamp(wish, low, high));
                self.motion.put(joint, start_rad.get(joint) + correction_rad.get(joint));
            }
            self.serve_gripper(period_s);
        }
        self.answers = self.answers.wrapping_add(1);
        self.out = Some(Answer { ipoc, correction_rad, open: self.open, stop: self.stop });
    }

    fn poll_packet(&mut self) -> Option<Packet> {
        self.out.take().map(Packet::Pc)
    }

    fn poll_timeout(&self, _: Instant, _: &Settings) -> Option<Instant> {
        self.due
    }

    fn command(&mut self, _: Instant, settings: &Settings, command: Command) {
        match command {
            Command::Find { .. } => {
                self.motion.brake(settings, &self.options);
                (self.motion.mode, self.rest, self.stop) = (Mode::Finding, PerJoint::default(), false);
            }
            Command::Reset | Command::Stand { .. } => {
                self.motion.brake(settings, &self.options);
                self.motion.mode = Mode::Standing;
            }
            Command::Abandon => {
                self.halt(settings);
                self.stop = true;
            }
            Command::Home(joint) => self.motion.mode = Mode::Homing(joint),
            Command::Jog { joint, qd_rad_s, until } => {
                self.motion.mode = Mode::Jogging { joint, qd_rad_s, until, released: false };
            }
            Command::Track => {
                self.model.forget_delay();
                (self.late_in_run, self.lagging_row) = (0, 0);
                self.motion.track();
            }
            Command::MoveTo { joint, q_rad } => self.motion.move_to(joint, q_rad),
            Command::Halt | Command::HaltJoint(_) => self.halt(settings),
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        let length_s = self.motion.brake(settings, &self.options);
        self.motion.mode = Mode::Braking;
        let settling_s = DriveModel::settling_s(&self.options);
        now + span::of_seconds(length_s + settling_s) + settings.cycle_period() * LEAD_CYCLES
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let limits = settings.joint.at(joint);
        let lag_s = span::seconds(self.options.time_constant);
        let wish = set_point.q_rad + lag_s * set_point.qd_rad_s;
        let start_rad = self.start_rad.map_or(0.0, |start| start.get(joint));
        let low = at_least(start_rad + self.options.lower_rad.get(joint), limits.q_min_rad);
        let high = crate::joints::at_most(start_rad + self.options.upper_rad.get(joint), limits.q_max_rad);
        let q_rad = clamp(wish, low, high);
        self.motion.refer(joint, q_rad);
        // Written so that NaN is limited.
        let within = (q_rad - wish).abs() <= 1e-6;
        Taken { position_limited: !within }
    }

    fn acts_at(&self, _: JointIndex) -> Instant {
        self.at + self.motion.period()
    }

    fn observe(&mut self, _: JointIndex, _: f32, _: f32) {}

    fn set_gripper(&mut self, _: &Settings, open: bool) -> bool {
        if open {
            // The axes pass the point of the release later by the delay of the path.
            self.opens_in_s = Some(at_least(self.model.delay_s(), 0.0));
        } else {
            (self.open, self.opens_in_s) = (false, None);
        }
        true
    }

    fn cancel_gripper(&mut self) {
        self.opens_in_s = None;
    }

    fn profile(&self, settings: &Settings) -> Profile {
        let (period, lag) = (settings.cycle_period(), self.options.dead_time);
        Profile { law: Law::Reference, period, lag, lead: lag + period * LEAD_CYCLES }
    }

    fn check_group(&self, now: Instant, settings: &Settings) -> Result<(), Refusal> {
        let recent = now.saturating_since(self.heard_at) <= settings.cycle_period() * WINDOWS;
        let fit = self.start_rad.is_some() && recent && !self.stop;
        if fit { Ok(()) } else { Err(Refusal::of(Cause::DriveNotReady)) }
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        if !self.is_homed(joint) {
            return Err(Refusal::at(Cause::NotHomed, joint));
        }
        let fit = self.is_at_rest(now, settings, joint) && self.motion.mode != Mode::Halted;
        if fit { Ok(()) } else { Err(Refusal::at(Cause::DriveNotReady, joint)) }
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.sample.get(joint)
    }

    fn is_homed(&self, _: JointIndex) -> bool {
        // Axes are absolute; what must be known is the start pose.
        self.start_rad.is_some()
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        let period = settings.cycle_period();
        self.model.is_settled(&self.options, period)
            && self.rest.at(joint).since(now, period * (WINDOWS + 1)).is_some()
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.rest.at(joint).is_moving(now, settings.cycle_period() * (WINDOWS + 1))
    }

    fn standing(&self, _: JointIndex, _: bool) -> Standing {
        Standing::default()
    }

    fn readings(&self, _: JointIndex) -> Readings {
        let halted = self.motion.mode == Mode::Halted;
        Readings { missed_in_row: self.missed_in_row, halted, ..Readings::default() }
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters { motions: self.answers, ..GroupCounters::default() }
    }

    fn is_keeping_time(&self) -> bool {
        false
    }

    fn is_cycle_done(&self, _: &Settings) -> bool {
        self.unanswered.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn telegram_counts_cycles_by_its_number_unless_that_is_ahead_of_the_time() {
        let period = Duration::from_millis(4);
        let after = |ms: u64, ipoc: u64| {
            let mut group = Rsi { ipoc: 100, ipoc_step: 4, ..Rsi::new(Options::default()) };
            group.grid = Instant::from_micros(1_000_000);
            group.heard_at = group.grid;
            let now = group.grid + Duration::from_millis(ms);
            (group.advance_grid(now, period, ipoc), group.grid)
        };
        assert_eq!(after(4, 104), (1, Instant::from_micros(1_004_000)));
        // Held up by more than a cycle: the next telegram all the same, and the grid follows slowly, by 1/512 of a cycle at most.
        assert_eq!(after(12, 104), (1, Instant::from_micros(1_004_007)));
        assert_eq!(after(5, 104), (1, Instant::from_micros(1_004_007)));
        assert_eq!(after(3, 104), (1, Instant::from_micros(1_003_993)));
        assert_eq!(after(12, 112).0, 3, "two were lost");
        assert_eq!(after(40, 104).0, 10, "a silence");
        assert_eq!(after(4, 2_900).0, 1, "a wrong number");
    }
}
