//! Motors that speak MIT frames (Damiao) on one CAN bus: the group is the clock, each motor gets one command per period and gives one answer.
//!
//! The motor gives `kp (p - q) + kd (v - q̇) + t` and holds it until the next command. The group leads a set point (q_c, v_c) of each
//! joint from the accelerations of the law, and sends p = q_c, v = v_c with the gains of [`Motor`], and as t the torque that the set points
//! need by the [`ArmModel`](super::dynamics::ArmModel). Without a model t is 0, and the load costs a distance of load / kp between set point and joint, which the law
//! closes while tracking.
//!
//! # Stops
//!
//! These arms have no brakes: a motor without torque lets its joint fall. So [`Command::Halt`] leads each joint to rest along a ramp of its
//! own, beginning with the next period, and then holds it. Only a motor that reports a fault or does not answer is
//! switched off. [`Command::Abandon`] stops feeding those. A motor that answers has taken its halt, and goes on being held;
//! if the controller dies, its time-out takes the torque.
//!
//! # Answers
//!
//! An answer holds no number of its command. It counts if it comes on the master id of the motor, with its id in the first byte, after the
//! command can have been on the bus, once per command and before the next period. The first one after a missed one may be late: it shows that
//! the motor lives and is no measurement. An answer is stale if it stays the same bit by bit while the
//! set point moves, torn if the joint cannot have got there. It shows the joint when the command came: at the joint's place in the burst.
//!
//! # CAN FD
//!
//! With [`Options::with_fd`] all commands go as CAN FD frames with bit rate switch. A motor that is set to classical CAN obeys them, and
//! answers classically: the last register shows it, and it is refused. A motor that is set to CAN FD does not answer classical commands.
//!
//! # Gripper
//!
//! The motor of the fingers has the place after the last joint. It stands where it is until the first order, then holds the fingers
//! open or closed with its gains, also in a halt. One that does not answer or has a fault stops the group along its plan
//! ([`Cause::GripperUnanswered`]).
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`options`] | motors, gains, ids |
//! | `finding` | from silence to torque: registers compared, time-out proven |
//! | `drive` | a motor as the group knows it |
//! | `motion` | the commands of a period |

mod drive;
mod finding;
mod motion;
pub mod options;

use heapless::Deque;
use mit_protocol::{RegisterAnswer, RegisterRequest, State};
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
pub use self::finding::Mismatch;
use self::finding::{STEP_PERIODS, Step};
pub use self::options::{GripperMotor, Motor, Options, OptionsError};
use super::answers::Worth;
use super::leading::{Leader, Mode, check_drive, finger_limits};
use crate::fault::{Cause, Fault, Refusal};
use crate::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, Law, Measured, PositionSample, Profile, Readings,
    SetPoint, Standing, Taken,
};
use crate::joints::{PerJoint, clamp};
use crate::settings::{JointSettings, Settings};

/// From the order to run to the start of the plan.
const LEAD_PERIODS: u64 = 2;
/// From the end of a ramp to the rest of the joint behind its gains: a joint at 25 rad/s leaves 2 % of its distance by then.
const SETTLING: Duration = Duration::from_millis(160);
/// Time for which a joint must stand. A joint with soft gains swings, and is slow for a moment where it turns back.
const SWING: Duration = Duration::from_millis(200);
/// Duration of a homing, in which no joint turns. A state that lasts a few milliseconds may not reach the host.
const HOMING: Duration = Duration::from_millis(100);
/// See the [module](self).
#[derive(Debug)]
pub struct Mit {
    options: Options,
    drives: PerJoint<Drive>,
    leader: Leader,
    /// Its zero is looked for until then.
    homing: Option<(JointIndex, Instant)>,
    /// Last order to the gripper.
    gripper_open: Option<bool>,
    events: Deque<GroupEvent, 32>,
    out: Deque<Frame, 16>,
    due: Instant,
    /// Beginning of the period.
    at: Instant,
    /// The commands of the period are still to be made.
    is_begun: bool,
    is_odd: bool,
    abandoned: bool,
    mismatch: Option<(JointIndex, Mismatch)>,
    counters: GroupCounters,
}

impl Default for Mit {
    /// Without motors: nothing is found.
    fn default() -> Self {
        Self::new(Options::default())
    }
}

impl Mit {
    /// For these motors; the first one moves joint 0.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            drives: PerJoint::default(),
            leader: Leader::new(Mode::Finding { reset: false }),
            homing: None,
            gripper_open: None,
            events: Deque::new(),
            out: Deque::new(),
            due: Instant::ZERO,
            at: Instant::ZERO,
            is_begun: false,
            is_odd: false,
            abandoned: false,
            mismatch: None,
            counters: GroupCounters::default(),
        }
    }

    /// The register for which the last search was refused with [`Cause::DriveSettingsDiffer`].
    pub const fn mismatch(&self) -> Option<&(JointIndex, Mismatch)> {
        self.mismatch.as_ref()
    }

    fn push(&mut self, event: GroupEvent) {
        // There is room: a call makes at most two events per joint, and a few of the group.
        let _ = self.events.push_back(event);
    }

    fn fail(&mut self, joint: JointIndex, cause: Cause) {
        self.push(GroupEvent::Failed(Fault::at(cause, joint)));
    }

    /// Place and motor of the gripper, unless the settings have a joint at that place.
    fn gripper(&self, settings: &Settings) -> Option<(JointIndex, &GripperMotor)> {
        self.options.gripper().filter(|(place, _)| place.get() == settings.joints as usize)
    }

    fn gripper_place(&self, settings: &Settings) -> Option<JointIndex> {
        self.gripper(settings).map(|(place, _)| place)
    }

    /// Places of all motors: the joints, base first, then the gripper.
    fn places(&self, settings: &Settings) -> impl Iterator<Item = JointIndex> + use<> {
        settings.joints().chain(self.gripper_place(settings))
    }

    /// The motor at one of the [`Self::places`].
    fn motor(&self, settings: &Settings, place: JointIndex) -> Option<Motor> {
        self.places(settings).find(|own| *own == place).and_then(|own| self.options.motor(own)).copied()
    }

    /// Limits of a joint, or of the fingers.
    fn limits(&self, settings: &Settings, place: JointIndex) -> JointSettings {
        let own = *settings.joint.at(place);
        match self.gripper(settings) {
            Some((fingers, gripper)) if fingers == place => {
                let v_max_rad_s = gripper.motor.ranges.v_max_rad_s();
                finger_limits(&own, [gripper.open_rad, gripper.closed_rad], v_max_rad_s)
            }
            _ => own,
        }
    }

    /// When the command of a joint is on the bus at the earliest, if `more` frames follow it.
    fn after_command(&self, joint: JointIndex, more: u64) -> Instant {
        self.at + self.options.frame * (self.drives.at(joint).place + more)
    }

    /// Counts the answers that did not come.
    fn count_missed(&mut self, settings: &Settings) -> bool {
        let mut any = false;
        for joint in self.places(settings) {
            let is_gripper = self.gripper_place(settings) == Some(joint);
            let drive = self.drives.at_mut(joint);
            if let Some(in_row) = drive.answers.close() {
                any |= !is_gripper;
                match drive.is_held() {
                    true if !is_gripper => self.push(GroupEvent::Missed(joint, in_row)),
                    true if in_row > settings.reply_missed_max => self.lose_gripper(joint),
                    _ => {}
                }
            }
        }
        any
    }

    /// The motor of the fingers does not answer, or reports a fault.
    fn lose_gripper(&mut self, place: JointIndex) {
        self.drives.at_mut(place).go_to(Step::Off);
        if self.leader.is_finding() {
            self.refuse(place, Cause::GripperUnanswered);
        } else {
            self.fail(place, Cause::GripperUnanswered);
        }
    }

    /// Events of modes that end by themselves.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        if let Some((joint, _)) = self.homing.take_if(|(_, until)| *until <= now) {
            let is_homed = self.drives.at_mut(joint).home(settings.joint.at(joint));
            if is_homed {
                self.push(GroupEvent::Homed(joint));
            } else {
                self.fail(joint, Cause::HomingFailed);
            }
        }
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        if !self.leader.is_finding() {
            if let Some(event) = self.leader.proceed(now, all_rest) {
                self.push(event);
            }
            return;
        }
        for joint in self.places(settings) {
            let drive = self.drives.at_mut(joint);
            drive.periods = drive.periods.saturating_add(1);
            let waits = matches!(drive.step, Step::Held | Step::Silence { .. });
            if !waits && drive.periods > STEP_PERIODS {
                let cause = drive.state.and_then(|state| finding::cause(state.status));
                let answers = drive.answers.missed_in_row == 0;
                self.refuse(joint, cause.filter(|_| answers).unwrap_or(Cause::DriveMissing));
                return;
            }
        }
        if all_rest && self.places(settings).all(|place| self.drives.at(place).is_held()) {
            self.leader.mode = Mode::Standing;
            self.push(GroupEvent::Found);
        }
    }
}

impl DriveGroup for Mit {
    type Packet = Frame;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        let Id::Standard(id) = frame.id() else { return };
        let joint = self.options.place_on(id);
        let Some((joint, motor)) = joint.and_then(|joint| Some((joint, self.motor(settings, joint)?))) else {
            if self.options.ids().any(|own| own == id) {
                self.counters.foreign = self.counters.foreign.saturating_add(1);
            }
            return;
        };
        self.counters.bits = self.counters.bits.wrapping_add(self.options.frame_bits());
        // The command and its answer, at least.
        let is_early = now < self.after_command(joint, 1);
        let at = self.after_command(joint, 0);
        let drive = self.drives.at_mut(joint);
        if is_early || !drive.answers.admits(drive.is_held()) {
            return;
        }
        if let Some(asked @ (RegisterRequest::Read(_) | RegisterRequest::Write(..))) = drive.asked {
            if let Some(answer) = RegisterAnswer::decode(frame, motor.id, motor.master, &asked) {
                drive.answers.came();
                self.take_register(settings, joint, &motor, answer);
            }
            return;
        }
        let Some(state) = State::decode(frame, motor.id, motor.master, &motor.ranges) else { return };
        drive.answers.came();
        let is_gripper = self.gripper_place(settings) == Some(joint);
        let limits = self.limits(settings, joint);
        let drive = self.drives.at_mut(joint);
        match drive.take(state, at, &limits, frame) {
            Worth::Measured => {}
            _ if is_gripper => return,
            Worth::Frozen => return self.fail(joint, Cause::PositionFrozen),
            Worth::Implausible(again) => return self.push(GroupEvent::Implausible(joint, again)),
        }
        if !drive.is_held() {
            self.take_search_state(now, settings, joint, &state);
            return;
        }
        if is_gripper {
            if drive.cause(self.options.hot_c).is_some() {
                self.lose_gripper(joint);
            }
            return;
        }
        let in_force = self.leader.in_force(joint, true);
        let cause = drive.cause(self.options.hot_c);
        if finding::cause(state.status).is_some() {
            drive.go_to(Step::Off);
        }
        if let Some(sample) = drive.answers.sample {
            self.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause }));
        }
        if let Some(cause) = cause.filter(|_| self.leader.is_finding()) {
            self.refuse(joint, cause);
        }
    }

    fn handle_timeout(&mut self, now: Instant, settings: &Settings) {
        if now < self.due {
            return;
        }
        let period = settings.cycle_period();
        let late = if self.at == Instant::ZERO { Duration::ZERO } else { now.saturating_since(self.due) };
        let overrun = self.count_missed(settings) || late >= period;
        // A period that came late is not made up for: two bursts at once say nothing more.
        self.due = if late >= period { now } else { now.saturating_sub(late) } + period;
        (self.at, self.is_begun, self.is_odd) = (now, true, !self.is_odd);
        self.proceed(now, settings);
        self.push(GroupEvent::Cycle { late, overrun });
    }

    fn poll_event(&mut self, _: Instant, _: &Settings) -> Option<GroupEvent> {
        self.events.pop_front()
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        if !core::mem::take(&mut self.is_begun) {
            return;
        }
        self.send_burst(now, settings);
    }

    fn poll_packet(&mut self) -> Option<Frame> {
        self.out.pop_front().map(|frame| self.options.on_bus(frame))
    }

    fn poll_timeout(&self, _: Instant, _: &Settings) -> Option<Instant> {
        Some(self.due)
    }

    fn command(&mut self, now: Instant, settings: &Settings, command: Command) {
        self.homing = None;
        if let Some(joint) = self.leader.command(now, settings, command) {
            let (drive, led) = (self.drives.at_mut(joint), self.leader.joints.at_mut(joint));
            led.load_rad = drive.answers.sample.map_or(0.0, |sample| led.set.q_rad - sample.q_rad);
            drive.answers.rest.forget();
        }
        match command {
            Command::Find { .. } => {
                (self.abandoned, self.mismatch) = (false, None);
                for joint in self.places(settings) {
                    let drive = self.drives.at_mut(joint);
                    drive.find(settings.reply_missed_max);
                    drive.periods = 0;
                }
            }
            Command::Abandon => self.abandoned = true,
            Command::Home(joint) => self.homing = Some((joint, now + HOMING)),
            Command::HaltJoint(joint) if self.leader.mode != Mode::Halted => {
                self.drives.at_mut(joint).go_to(Step::Off);
            }
            _ => {}
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        now + self.leader.brake(settings) + settings.cycle_period() * 2 + SETTLING
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let (range_rad_s, limits) = match self.options.motor(joint) {
            Some(motor) => (motor.ranges.v_max_rad_s(), *settings.joint.at(joint)),
            None => return Taken::default(),
        };
        let limits = JointSettings { v_max_rad_s: clamp(limits.v_max_rad_s, 0.0, range_rad_s), ..limits };
        let sample = self.drives.at(joint).answers.sample;
        self.leader.given(&limits, joint, set_point, sample)
    }

    fn acts_at(&self, joint: JointIndex) -> Instant {
        self.after_command(joint, 0)
    }

    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        let Some(place) = self.gripper_place(settings) else { return false };
        self.gripper_open = Some(open);
        // The order leaves at once: the next burst, which repeats it, may be a period away.
        if self.drives.at(place).is_held()
            && let Some(motor) = self.motor(settings, place)
            && let Some(frame) = self.finger_command(place, &motor)
        {
            // Without room the burst carries it.
            let _ = self.out.push_back(frame);
        }
        true
    }

    fn profile(&self, settings: &Settings) -> Profile {
        let period = settings.cycle_period();
        // The velocity of the set point is fed forward: positions do not lag behind a steady motion.
        Profile { law: Law::Feedback, period, lag: Duration::ZERO, lead: period * LEAD_PERIODS }
    }

    fn check_group(&self, _: Instant, _: &Settings) -> Result<(), Refusal> {
        self.leader.check_group()
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        let is_sound = self.standing(joint, true).cause.is_none() && self.drives.at(joint).is_held();
        let is_fit = is_sound && self.is_at_rest(now, settings, joint);
        check_drive(joint, self.is_homed(joint), is_fit)
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.drives.at(joint).answers.sample
    }

    fn is_homed(&self, joint: JointIndex) -> bool {
        self.drives.at(joint).is_homed
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.leader.is_at_rest(now, settings, joint, &self.drives.at(joint).answers, SWING)
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.drives.at(joint).answers.is_moving(now, settings)
    }

    fn standing(&self, joint: JointIndex, _: bool) -> Standing {
        let drive = self.drives.at(joint);
        let cause = drive.cause(self.options.hot_c);
        Standing { cause, reports_motion: false, yields: !drive.is_held() }
    }

    fn readings(&self, joint: JointIndex) -> Readings {
        let drive = self.drives.at(joint);
        let status = drive.state.map(|state| state.status.code().into());
        let error = drive.cause(self.options.hot_c).is_some();
        self.leader.readings(joint, &drive.answers, status, error)
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }

    fn is_keeping_time(&self) -> bool {
        // A motor that is held takes a command in each period: at rest, and while others are looked for.
        self.options.places().any(|place| self.drives.at(place).is_held())
    }

    fn is_cycle_done(&self, settings: &Settings) -> bool {
        let mut held = self.places(settings).filter(|place| self.drives.at(*place).is_held());
        held.all(|place| !self.drives.at(place).answers.awaited)
    }
}
