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
//! the time of the path. A model of the drives ([`model`](self)) says how far measured axes are from where they should be.
//!
//! # Invariants
//!
//! * A new program run, [`Command::Halt`] and [`Command::Find`] discard the target for good.
//! * A set point never changes faster than [`Options::a_cap_rad_s2`] allows, whatever comes in: `motion` bounds each one against
//!   the last one that was sent. After a late answer the robot has held the last set point, and the group continues from that one.
//! * A telegram that may be of another run has no answer until the axes show which correction is in force (`doubt`). So an arm
//!   that is away from its start pose never gets a correction of zero. A telegram without axes, as the first of a KR C2, shows
//!   nothing.
//! * The ball is not released while the axes are off their path.
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`packet`] | telegram, answer, options |
//! | `link` | whether a telegram is new, old, or the first of another run |
//! | `grid` | when the cycle of a telegram began, and how many have passed |
//! | `doubt` | which correction is in force after a break |
//! | `model` | where the axes should be |
//! | `motion` | what all axes do in a mode |
//! | `events` | what waits to be reported |

mod doubt;
mod events;
mod grid;
mod link;
mod model;
mod motion;
pub mod packet;

use protocol::{Duration, Instant, JointIndex};

pub use self::doubt::AT_START_RAD;
use self::doubt::{Doubt, Found, Sight, away_rad};
use self::events::Pending;
use self::grid::{Grid, WINDOWS};
use self::link::{Kind, Order};
use self::model::DriveModel;
use self::motion::{Mode, Setpoints, Window};
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

/// Cycles from the end of the lag to the start of a plan.
const LEAD_CYCLES: u64 = 4;
/// Telegrams in a row with lagging axes that end a path.
const LAGGING_ROW: u8 = 3;
/// Axes farther than this from their path do not release the ball, rad: 10 mm at the hand.
const RELEASE_RAD: f32 = 5e-3;
/// As [`RELEASE_RAD`], of their speed, rad/s: 50 mm/s at the hand.
const RELEASE_RAD_S: f32 = 0.03;

/// See the [module](self).
#[derive(Debug, Default)]
pub struct Rsi {
    options: Options,
    order: Order,
    model: DriveModel,
    /// The same drives, led by the references: where the path is.
    path: DriveModel,
    motion: Setpoints,
    pending: Pending,
    /// Start pose of the running program, rad.
    start_rad: Option<PerJoint<f32>>,
    /// Nothing is answered before it is explained.
    doubt: Option<Doubt>,
    sample: PerJoint<Option<PositionSample>>,
    rest: PerJoint<Rest>,
    /// The telegram that waits for its answer.
    unanswered: Option<u64>,
    /// Cycles of which the robot has not said yet whether their answers were late; the first of them had an answer.
    unaccounted: u32,
    answered: bool,
    out: Option<Answer>,
    /// Time of the last telegram, or of the cycle that stands for it.
    at: Instant,
    grid: Grid,
    due: Option<Instant>,
    missed_in_row: u32,
    /// Late answers as the robot counted them last, and since the run began.
    late: Option<u32>,
    counts_all: bool,
    late_in_run: u32,
    lagging_row: u8,
    open: bool,
    /// Delay until the gripper opens, s.
    opens_in_s: Option<f32>,
    /// How far the axes were from their path when the ball was not released for that, rad.
    withheld_rad: Option<f32>,
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

    /// The start pose of the running program is known.
    const fn is_known(&self) -> bool {
        self.start_rad.is_some() && self.doubt.is_none()
    }

    /// How far the axes were from their path at a release that was not given for that, rad.
    pub const fn release_withheld_rad(&self) -> Option<f32> {
        self.withheld_rad
    }

    /// Nothing is answered until it is known what the robot does. What was under way ends, but in some modes.
    fn interrupt(&mut self, cause: Cause, unharmed: &[Mode]) {
        self.doubt = Some(Doubt::default());
        self.opens_in_s = None;
        self.rest = PerJoint::default();
        let is_first = self.start_rad.is_none() && self.due.is_none();
        if !is_first && !unharmed.contains(&self.motion.mode) {
            self.motion.mode = Mode::Halted;
            self.pending.fail(Fault::group(cause));
        }
    }

    /// Largest correction given, rad.
    fn given_rad(&self) -> f32 {
        self.start_rad.as_ref().map_or(0.0, |start| away_rad(&self.motion.set_rad(), start))
    }

    /// Finds out which correction is in force.
    fn resolve(
        &mut self,
        settings: &Settings,
        q_rad: PerJoint<f32>,
        start_rad: Option<PerJoint<f32>>,
        late: Option<u32>,
    ) {
        let Some(doubt) = &mut self.doubt else { return };
        let start_rad = start_rad.or(self.start_rad).unwrap_or(q_rad);
        let (set_rad, model_rad) = (self.motion.set_rad(), self.model.q_rad());
        let old_start_rad = self.start_rad.as_ref();
        let seen =
            Sight { q_rad: &q_rad, start_rad: &start_rad, old_start_rad, set_rad: &set_rad, model_rad, late };
        let settling = DriveModel::settling_s(&self.options) / settings.cycle_period_s();
        match doubt.look(&seen, settling as u32 + 1) {
            Found::NewRun => {
                (self.doubt, self.start_rad, self.late) = (None, Some(start_rad), None);
                self.counts_all = false;
                self.motion.rest_at(start_rad);
                self.model.rest_at(start_rad);
            }
            Found::OldRun => {
                self.doubt = None;
                self.motion.held();
            }
            Found::Nothing => {}
        }
    }

    /// The axes stand at the start pose, and were led away from it: another run began, and nothing else shows it.
    fn is_back_at_start(&self, telegram: &Telegram) -> bool {
        let (Some(q_rad), Some(start_rad)) = (&telegram.q_rad, &self.start_rad) else { return false };
        let has_fewer_late = matches!((self.late, telegram.late), (Some(old), Some(new)) if new < old);
        let away_max_rad = if has_fewer_late { doubt::NEAR_RAD } else { doubt::AWAY_RAD };
        away_rad(q_rad, start_rad) <= AT_START_RAD && away_rad(q_rad, self.model.q_rad()) > away_max_rad
    }

    /// What the robot did with the answers since the last telegram, `cycles` ago.
    fn account(&mut self, telegram: &Telegram, period: Duration, cycles: u32) {
        let passed = cycles;
        let cycles = self.unaccounted.saturating_add(passed);
        if self.late.is_some() && telegram.late.is_none() {
            self.unaccounted = cycles;
            return self.model_follows(period, passed);
        }
        // A robot whose count stays after an answer in time counts all late answers: its count does not fall.
        let known = self.late.zip(telegram.late);
        self.counts_all |=
            self.answered && cycles == 1 && known.is_some_and(|(before, now)| now == before && now > 0);
        let is_wrong = self.counts_all && known.is_some_and(|(before, now)| now < before);
        // A count that falls, or rises by more than the number of cycles, is not used.
        let late = known
            .and_then(|(before, now)| now.checked_sub(before))
            .filter(|late| *late == 1 || cycles > 1)
            .unwrap_or(0);
        self.late = telegram.late.filter(|_| !is_wrong).or(self.late);
        self.late_in_run = self.late_in_run.saturating_add(late);
        if self.answered && late >= cycles {
            self.motion.refused();
        } else if cycles > 1 || !self.answered {
            self.motion.held();
        }
        (self.unaccounted, self.answered) = (0, false);
        self.model_follows(period, passed);
    }

    fn model_follows(&mut self, period: Duration, cycles: u32) {
        let (set_rad, reference_rad) = (self.motion.set_rad(), *self.motion.last_reference_rad());
        // A long silence ends the run, so few cycles are left to make up for.
        for _ in 0..cycles.min(model::KEPT_CYCLES as u32) {
            self.model.step(&self.options, period, &set_rad);
            self.path.step(&self.options, period, &reference_rad);
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
        if matches!(self.motion.mode, Mode::Finding | Mode::Halted) {
            self.lagging_row = 0;
            return;
        }
        let is_tracking = self.motion.mode == Mode::Tracking;
        let (residual_rad, worst) = self.model.residual_rad();
        // Written so that NaN lags.
        let follows = residual_rad <= self.options.lag_max_rad
            && self.model.delay_s().abs() <= span::seconds(self.options.delay_max);
        self.lagging_row = if follows { 0 } else { self.lagging_row.saturating_add(1) };
        if self.lagging_row >= LAGGING_ROW {
            self.lagging_row = 0;
            self.pending.fail(Fault { cause: Cause::RobotLags, joint: worst });
        } else if is_tracking && self.late_in_run >= self.options.late_max {
            self.late_in_run = 0;
            self.pending.fail(Fault::group(Cause::AnswersLate));
        }
    }

    /// Events of modes that end by themselves.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        let is_known = self.is_known();
        match &mut self.motion.mode {
            Mode::Finding if all_rest && is_known => self.pending.push(GroupEvent::Found),
            Mode::Homing(joint) => {
                let joint = *joint;
                self.motion.mode = Mode::Standing;
                self.pending.push(GroupEvent::Homed(joint));
            }
            Mode::Jogging { until, released, .. } if !*released && *until <= now => {
                *released = true;
                self.pending.push(GroupEvent::JogReleased);
            }
            Mode::Jogging { released: true, .. } if all_rest => self.pending.push(GroupEvent::JogEnded),
            _ => {}
        }
    }

    /// All axes brake together; the ball is kept.
    fn halt(&mut self, settings: &Settings) {
        self.opens_in_s = None;
        self.motion.brake(settings, &self.options);
        self.motion.mode = Mode::Halted;
    }

    fn serve_gripper(&mut self, settings: &Settings) {
        let Some(left_s) = self.opens_in_s else { return };
        let period_s = settings.cycle_period_s();
        if self.motion.mode == Mode::Tracking && left_s > 0.5 * period_s {
            self.opens_in_s = Some(left_s - period_s);
            return;
        }
        let off_rad = if self.motion.mode == Mode::Tracking { self.off_path_rad(settings) } else { None };
        (self.open, self.opens_in_s, self.withheld_rad) = (off_rad.is_none(), None, off_rad);
    }

    /// Largest distance of the axes from their path, rad, from now until a gripper that is ordered now has opened. `None`: they
    /// are on their path. Distances are predicted: these axes follow set points that were given within the dead time before.
    fn off_path_rad(&self, settings: &Settings) -> Option<f32> {
        let (mut path, mut model) = (self.path, self.model);
        let (set_rad, reference_rad) = (self.motion.set_rad(), *self.motion.last_reference_rad());
        let period = settings.cycle_period();
        let ahead = settings.gripper_opening_us.checked_div(settings.cycle_period_us).unwrap_or(0) + 1;
        let (mut off_rad, mut off_rad_s) = (0.0, 0.0);
        for _ in 0..ahead.min(model::KEPT_CYCLES as u32) {
            off_rad = at_least(away_rad(path.q_rad(), model.q_rad()), off_rad);
            off_rad_s = at_least(away_rad(path.qd_rad_s(), model.qd_rad_s()), off_rad_s);
            model.step(&self.options, period, &set_rad);
            path.step(&self.options, period, &reference_rad);
        }
        (off_rad > RELEASE_RAD || off_rad_s > RELEASE_RAD_S).then_some(off_rad)
    }
}

impl DriveGroup for Rsi {
    type Packet = Packet;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, packet: &Packet) {
        let Packet::Robot(telegram) = packet else { return };
        let period = settings.cycle_period();
        let kind = self.order.judge(now, telegram);
        if kind == Kind::Old {
            return;
        }
        let is_back = self.doubt.is_none() && self.is_back_at_start(telegram);
        let was_silent = self.missed_in_row > 0 && self.given_rad() > AT_START_RAD;
        let cycles = self.grid.advance(now, period, telegram.ipoc);
        self.account(telegram, period, cycles);
        if kind == Kind::Break {
            self.grid.begin_anew(now);
        }
        if kind == Kind::Break || is_back {
            self.interrupt(Cause::RobotRestarted, &[Mode::Finding]);
        } else if was_silent {
            self.interrupt(Cause::DriveSilent, &[Mode::Finding, Mode::Standing, Mode::Halted]);
        }
        (self.at, self.missed_in_row) = (self.grid.at, 0);
        self.due = Some(now + period * WINDOWS);
        let finite = |q_rad: &PerJoint<f32>| settings.joints().all(|joint| q_rad.get(joint).is_finite());
        if let Some(q_rad) = telegram.q_rad.filter(finite) {
            self.resolve(settings, q_rad, telegram.start_rad.filter(finite), telegram.late);
            self.late = self.late.or(telegram.late);
            self.measure(self.grid.at, settings, &q_rad);
            self.judge();
            self.proceed(now, settings);
        }
        self.unanswered = self.doubt.is_none().then_some(telegram.ipoc);
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
        let mut correction_rad = PerJoint::default();
        if let Some(start_rad) = self.start_rad {
            let shifted = |by: &PerJoint<f32>| {
                let mut sum = start_rad;
                settings.joints().for_each(|joint| sum.set(joint, start_rad.get(joint) + by.get(joint)));
                sum
            };
            let window = Window {
                low_rad: shifted(&self.options.lower_rad),
                high_rad: shifted(&self.options.upper_rad),
            };
            self.motion.step(now, settings, &self.options, &window);
            let set_rad = self.motion.set_rad();
            for joint in settings.joints() {
                correction_rad.set(joint, set_rad.get(joint) - start_rad.get(joint));
            }
            self.serve_gripper(settings);
        }
        self.answered = true;
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
                (self.late_in_run, self.lagging_row, self.withheld_rad) = (0, 0, None);
                self.motion.track();
                self.path = self.model;
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
        let recent = now.saturating_since(self.grid.heard_at) <= settings.cycle_period() * WINDOWS;
        let fit = self.is_known() && recent && !self.stop;
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
        self.is_known()
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        let period = settings.cycle_period();
        self.model.is_settled(&self.options, period)
            && self.rest.at(joint).since(now, period * (WINDOWS + 1)).is_some()
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.rest.at(joint).is_moving(now, settings.cycle_period() * (WINDOWS + 1))
    }

    fn standing(&self, _: JointIndex) -> Standing {
        Standing::default()
    }

    fn readings(&self, _: JointIndex) -> Readings {
        let halted = self.motion.mode == Mode::Halted;
        Readings { missed_in_row: self.missed_in_row, halted, ..Readings::default() }
    }

    fn counters(&self) -> GroupCounters {
        GroupCounters { motions: self.answers, ..GroupCounters::default() }
    }
}
