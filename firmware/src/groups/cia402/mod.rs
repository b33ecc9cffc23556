//! CANopen servos of profile CiA 402 on one CAN bus, in cyclic synchronous or interpolated position mode: the group gives the SYNC, and is
//! the clock.
//!
//! ```text
//! SYNC k                    half a period                     SYNC k + 1
//!  │ positions of SYNC k      │ control step  │ set points       │ the set points begin to act: each servo goes to
//!  │ come from all servos     │               │ to all servos    │ its own on a line that ends at SYNC k + 2
//! ```
//!
//! So the loop acts one period after it measures. The group leads a set point of each joint from the accelerations of the law. The torque
//! that the set points need by the [`ArmModel`](super::dynamics::ArmModel) goes with them.
//!
//! # Stops
//!
//! [`Command::Halt`] leads each joint to rest along a ramp of its own, from the next SYNC on, and then holds it. A servo that reports a fault
//! or does not answer gets the order for a quick stop; with [`Command::Abandon`] its node is stopped, too, which for it is a lost link. A
//! servo that answers has taken its halt, and goes on being held. If the controller dies, its heartbeat stays away. A servo whose
//! link is lost goes to fault by itself: its own ramp, then its brake. That is proven before the first motion.
//!
//! # Gripper
//!
//! An output of a servo opens the hand ([`GripperOutput`]). It stays as it is until the first order, which leaves at once and then again in
//! each period. The servo takes it when it comes, not with the next SYNC.
//!
//! # Answers
//!
//! Process data hold no number of their SYNC. They count if they come after the SYNC can have been on the bus, once per SYNC and before
//! the next one; after the control step they are of use for the next step. The first ones after missed ones may be those of a SYNC
//! before: they show that the servo lives and are no measurement. They are stale if they stay the same bit by bit while the set point moves, torn if the joint cannot have got there.
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`options`] | servos, units, ids |
//! | `finding` | from silence to torque, step by step; supervision proven |
//! | `rows` | the objects that are compared, written and read back |
//! | `sending` | the set points of a period, and the heartbeats |
//! | `drive` | a servo as the group knows it |

mod drive;
mod finding;
pub mod options;
mod rows;
mod sending;

use canopen_protocol::emcy::Emergency;
use canopen_protocol::{Function, NodeId, nmt};
use heapless::Deque;
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
pub use self::finding::{Found, Mismatch};
use self::finding::{HEARTBEAT, Step};
pub use self::options::{Follow, GripperOutput, Home, Options, OptionsError, Servo};
pub use self::rows::{Need, Use};
use super::answers::Worth;
use super::leading::{Leader, Mode, check_drive};
use crate::fault::{Cause, Fault, Refusal};
use crate::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, Law, Measured, PositionSample, Profile, Readings,
    SetPoint, Standing, Taken,
};
use crate::joints::PerJoint;
use crate::settings::Settings;

/// Periods from the order to run to the start of the plan: a set point acts two periods after it is made.
const LEAD_PERIODS: u64 = 3;
/// From the end of a ramp to the rest of the joint behind its loop.
const SETTLING: Duration = Duration::from_millis(60);
/// Shortest SYNC, and shortest process data of six bytes, at 1 Mbit/s.
const SYNC_FRAME: Duration = Duration::from_micros(47);
const DATA_FRAME: Duration = Duration::from_micros(95);
/// Heartbeats of a servo that may stay away.
const BEATS_MAX: u64 = 4;
/// Duration of a homing with an absolute encoder. A state that lasts a few milliseconds may not reach the host.
const HOMING: Duration = Duration::from_millis(100);

/// See the [module](self).
#[derive(Debug)]
pub struct Cia402 {
    options: Options,
    drives: PerJoint<Drive>,
    leader: Leader,
    /// Its zero is looked for until then.
    homing: Option<(JointIndex, Instant)>,
    /// Last order to the gripper.
    gripper_open: Option<bool>,
    events: Deque<GroupEvent, 32>,
    out: Deque<Frame, 40>,
    due: Instant,
    /// The control step comes next, and not the SYNC.
    is_half: bool,
    /// SYNC runs: all servos are configured.
    is_synchronous: bool,
    /// Last SYNC, and when it was due.
    sync_at: Instant,
    sync_due: Instant,
    /// Set points of the period are still to be made.
    is_begun: bool,
    is_odd: bool,
    abandoned: bool,
    /// Next heartbeat of the controller.
    beats_at: Instant,
    proof_ends_at: Instant,
    mismatch: Option<(JointIndex, Mismatch)>,
    counters: GroupCounters,
}

impl Default for Cia402 {
    /// Without servos: nothing is found.
    fn default() -> Self {
        Self::new(Options::default())
    }
}

impl Cia402 {
    /// For these servos; the first one moves joint 0.
    pub fn new(options: Options) -> Self {
        Self {
            options,
            drives: PerJoint(core::array::from_fn(|_| Drive::default())),
            leader: Leader::new(Mode::Finding { reset: false }),
            homing: None,
            gripper_open: None,
            events: Deque::new(),
            out: Deque::new(),
            due: Instant::ZERO,
            is_half: false,
            is_synchronous: false,
            sync_at: Instant::ZERO,
            sync_due: Instant::ZERO,
            is_begun: false,
            is_odd: false,
            abandoned: false,
            beats_at: Instant::ZERO,
            proof_ends_at: Instant::ZERO,
            mismatch: None,
            counters: GroupCounters::default(),
        }
    }

    /// The object for which the last search was refused with [`Cause::DriveSettingsDiffer`].
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

    fn send(&mut self, frame: Frame) {
        self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
        // There is room for a period: the runner empties it after each call.
        let _ = self.out.push_back(frame);
    }

    /// The SYNC, after which all servos owe their process data.
    fn synchronize(&mut self, now: Instant, settings: &Settings) {
        self.count_missed(settings);
        self.sync_at = now;
        if !self.is_synchronous {
            return;
        }
        self.send(nmt::sync());
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            drive.answers.awaited = drive.has_process_data();
        }
    }

    /// Counts the answers that did not come.
    fn count_missed(&mut self, settings: &Settings) {
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            if let Some(in_row) = drive.answers.close()
                && drive.is_held()
            {
                self.push(GroupEvent::Missed(joint, in_row));
            }
        }
    }

    /// Reports a servo that is lost or does not do what it should; each servo once in a search.
    fn report(&mut self, joint: JointIndex, cause: Cause) {
        let drive = self.drives.at_mut(joint);
        if core::mem::replace(&mut drive.is_reported, true) {
            return;
        }
        if self.leader.is_finding() {
            self.refuse(joint, cause);
        } else {
            self.fail(joint, cause);
        }
    }

    fn take_emergency(&mut self, joint: JointIndex, emergency: &Emergency) {
        let drive = self.drives.at_mut(joint);
        // The first emergency is the cause. Code 0 says that no error is left.
        if drive.emergency == 0 || emergency.code == 0 {
            drive.emergency = emergency.code;
        }
        let is_watched = drive.is_held() || matches!(drive.step, Step::Enabling | Step::Enabled);
        if let Some(cause) = drive.cause().filter(|_| is_watched) {
            self.report(joint, cause);
        }
    }

    fn take_heartbeat(&mut self, now: Instant, joint: JointIndex, state: nmt::State) {
        let drive = self.drives.at_mut(joint);
        drive.heard_at = now;
        // It has started again, or somebody else manages the network.
        if drive.is_held() && state != nmt::State::Operational {
            self.report(joint, Cause::DriveError);
        }
    }

    fn take_process_data(&mut self, now: Instant, settings: &Settings, joint: JointIndex, frame: &Frame) {
        let (Some(servo), Some(map)) = (self.options.servo(joint), Options::from_servo()) else { return };
        let at = self.sync_at + SYNC_FRAME;
        let is_early = now < at + DATA_FRAME;
        let drive = self.drives.at_mut(joint);
        if is_early || !drive.answers.admits(drive.is_held()) {
            return;
        }
        drive.answers.came();
        if !matches!(drive.step, Step::Held | Step::Off) {
            // A homing moves the zero; nothing else moves.
            drive.answers.sample = None;
            if drive.is_held() {
                drive.answers.rest.forget();
            }
        }
        match drive.take(frame, &map, at, servo, settings.joint.at(joint)) {
            Some(Worth::Measured) => {}
            None => return,
            Some(Worth::Frozen) => return self.fail(joint, Cause::PositionFrozen),
            Some(Worth::Implausible(again)) => return self.push(GroupEvent::Implausible(joint, again)),
        }
        if drive.step != Step::Held {
            self.take_search_state(now, joint);
        }
        let drive = self.drives.at_mut(joint);
        let Some(sample) = drive.answers.sample else { return };
        let has_torque = drive.state() == Some(canopen_protocol::cia402::State::OperationEnabled);
        if drive.step != Step::Held && !(drive.step == Step::Enabled && has_torque) {
            // The target stays at the position until the servo has torque.
            self.leader.stand(joint, sample.q_rad);
        }
        let drive = self.drives.at_mut(joint);
        if !drive.is_held() {
            return;
        }
        let cause = drive.cause();
        if cause.is_some() {
            drive.go_to(now, Step::Off);
        }
        // After the control step the set point that it gave is not yet in force.
        let in_force = self.leader.in_force(joint, self.is_half);
        self.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause }));
        if let Some(cause) = cause.filter(|_| self.leader.is_finding()) {
            self.refuse(joint, cause);
        }
    }

    /// Events of modes that end by themselves, and what the servos owe.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            let is_lost = drive.is_held() && now.saturating_since(drive.heard_at) > HEARTBEAT * BEATS_MAX;
            if is_lost {
                self.report(joint, Cause::DriveSilent);
            }
            let aborted = self.drives.at_mut(joint).transfer.as_mut().and_then(|t| t.handle_timeout(now));
            if let Some(frame) = aborted {
                self.send(frame);
                self.proceed_transfer(now, settings, joint);
            }
            let is_asking = self.leader.is_finding() || self.drives.at(joint).is_held();
            if is_asking {
                self.ask(now, settings, joint);
            }
        }
        if let Some((joint, _)) = self.homing.take_if(|(_, until)| *until <= now) {
            let is_homed = self.drives.at_mut(joint).home(settings.joint.at(joint));
            if is_homed {
                self.push(GroupEvent::Homed(joint));
            } else {
                self.fail(joint, Cause::HomingFailed);
            }
        }
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        if self.leader.is_finding() {
            self.proceed_search(now, settings);
            let all_held = settings.joints().all(|joint| self.drives.at(joint).step == Step::Held);
            if all_held && all_rest && self.leader.is_finding() {
                self.leader.mode = Mode::Standing;
                self.push(GroupEvent::Found);
            }
        } else if let Some(event) = self.leader.proceed(now, all_rest) {
            self.push(event);
        }
    }

    fn have_answered(&self, settings: &Settings) -> bool {
        settings.joints().all(|joint| !self.drives.at(joint).answers.awaited)
    }

    fn is_own(&self, frame: &Frame) -> bool {
        let Id::Standard(id) = frame.id() else { return false };
        self.options.ids().any(|own| own == id)
    }
}

impl DriveGroup for Cia402 {
    type Packet = Frame;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        let of =
            |node: NodeId| self.options.joint_of(node).filter(|joint| settings.joints().any(|j| j == *joint));
        let from = Function::of_frame(frame);
        let (Some(function), joint) = (
            from,
            match from {
                Some(
                    Function::Tpdo(1, node)
                    | Function::SdoFromNode(node)
                    | Function::Emergency(node)
                    | Function::Heartbeat(node),
                ) => of(node),
                _ => None,
            },
        ) else {
            return;
        };
        let Some(joint) = joint else {
            if self.is_own(frame) {
                self.counters.foreign = self.counters.foreign.saturating_add(1);
            }
            return;
        };
        self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
        match function {
            Function::Tpdo(..) => self.take_process_data(now, settings, joint, frame),
            Function::SdoFromNode(_) => {
                let transfer = self.drives.at_mut(joint).transfer.as_mut();
                if let Some(next) = transfer.and_then(|transfer| transfer.handle_frame(now, frame)) {
                    self.send(next);
                }
                self.proceed_transfer(now, settings, joint);
            }
            Function::Emergency(_) => {
                if let Some((_, emergency)) = Emergency::decode(frame) {
                    self.take_emergency(joint, &emergency);
                }
            }
            Function::Heartbeat(_) => {
                if let Some((_, state)) = nmt::State::decode(frame) {
                    self.take_heartbeat(now, joint, state);
                }
            }
            _ => {}
        }
    }

    fn handle_timeout(&mut self, now: Instant, settings: &Settings) {
        if now < self.due {
            return;
        }
        let period = settings.cycle_period();
        let half = Duration::from_micros(period.as_micros() / 2);
        if !self.is_half {
            // A period that came late is not made up for.
            let is_first = self.sync_due == Instant::ZERO;
            let is_late = is_first || now.saturating_since(self.due) >= half;
            self.sync_due = if is_late { now } else { self.due };
            (self.is_half, self.due) = (true, self.sync_due + half);
            self.synchronize(now, settings);
            return;
        }
        let late = now.saturating_since(self.due);
        let overrun = !self.have_answered(settings) || late >= half;
        // A SYNC that is due already waits until the set points of this step are sent.
        let next = self.sync_due + period;
        (self.is_half, self.due) = (false, if next > now { next } else { now + half });
        (self.is_begun, self.is_odd) = (true, !self.is_odd);
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
        if !self.is_synchronous {
            return;
        }
        self.lead_all(settings);
        for joint in settings.joints() {
            let Some(frame) = self.data_to(settings, joint) else { continue };
            if self.leader.moves() && self.drives.at(joint).is_held() {
                self.counters.motions = self.counters.motions.saturating_add(1);
            }
            self.send(frame);
        }
        // Again in each period: a frame may be lost.
        if let Some(frame) = self.data_to_gripper() {
            self.send(frame);
        }
        // After the set points: its id has a lower priority than every frame of the host link, and a link may keep the order of frames.
        self.beat(now, settings);
    }

    fn poll_packet(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self, _: Instant, _: &Settings) -> Option<Instant> {
        Some(self.due)
    }

    fn command(&mut self, now: Instant, settings: &Settings, command: Command) {
        self.homing = None;
        if let Some(joint) = self.leader.command(now, settings, command) {
            self.drives.at_mut(joint).answers.rest.forget();
        }
        match command {
            Command::Find { .. } => {
                (self.abandoned, self.mismatch) = (false, None);
                settings.joints().for_each(|joint| self.drives.at_mut(joint).is_reported = false);
                let is_sound = |joint| self.drives.at(joint).is_sound(settings.reply_missed_max);
                if !settings.joints().all(is_sound) {
                    self.is_synchronous = false;
                    settings.joints().for_each(|joint| self.drives.at_mut(joint).forget(now));
                }
            }
            Command::Abandon => self.abandoned = true,
            Command::Home(joint) => match self.options.servo(joint).map(|servo| servo.home) {
                Some(Home::Here) if self.drives.at(joint).step == Step::Held => {
                    self.drives.at_mut(joint).go_to(now, Step::Homing(0));
                    self.ask(now, settings, joint);
                }
                _ => self.homing = Some((joint, now + HOMING)),
            },
            Command::HaltJoint(joint) => self.drives.at_mut(joint).go_to(now, Step::Off),
            _ => {}
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        now + self.leader.brake(settings) + settings.cycle_period() * 3 + SETTLING
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let sample = self.drives.at(joint).answers.sample;
        self.leader.given(settings.joint.at(joint), joint, set_point, sample)
    }

    fn acts_at(&self, _: JointIndex) -> Instant {
        // With the next SYNC.
        self.due + SYNC_FRAME
    }

    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        if self.options.gripper().is_none_or(|gripper| !settings.joints().any(|own| own == gripper.joint)) {
            return false;
        }
        self.gripper_open = Some(open);
        if let Some(frame) = self.data_to_gripper() {
            self.send(frame);
        }
        true
    }

    fn profile(&self, settings: &Settings) -> Profile {
        let period = settings.cycle_period();
        // The servos interpolate: positions do not lag behind a steady motion.
        Profile { law: Law::Feedback, period, lag: Duration::ZERO, lead: period * LEAD_PERIODS }
    }

    fn check_group(&self, _: Instant, _: &Settings) -> Result<(), Refusal> {
        self.leader.check_group()
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        let drive = self.drives.at(joint);
        let is_sound = drive.cause().is_none() && drive.step == Step::Held;
        check_drive(joint, drive.is_homed, is_sound && self.is_at_rest(now, settings, joint))
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.drives.at(joint).answers.sample
    }

    fn is_homed(&self, joint: JointIndex) -> bool {
        self.drives.at(joint).is_homed
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.leader.is_at_rest(now, settings, joint, &self.drives.at(joint).answers, Duration::ZERO)
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.drives.at(joint).answers.is_moving(now, settings)
    }

    fn standing(&self, joint: JointIndex, _: bool) -> Standing {
        let drive = self.drives.at(joint);
        Standing { cause: drive.cause(), reports_motion: false, yields: !drive.is_held() }
    }

    fn readings(&self, joint: JointIndex) -> Readings {
        let drive = self.drives.at(joint);
        // The emergency code above the status word.
        let state = drive.status.map(|status| u32::from(drive.emergency) << 16 | u32::from(status.0));
        self.leader.readings(joint, &drive.answers, state, drive.cause().is_some())
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }

    fn is_keeping_time(&self) -> bool {
        // A servo that is held takes a set point in each period: at rest, and while others are looked for.
        self.options.joints().any(|joint| self.drives.at(joint).is_held())
    }

    fn is_cycle_done(&self, settings: &Settings) -> bool {
        // From the control step on the set points come, then the SYNC: what is queued before them delays it.
        let mut held = settings.joints().filter(|joint| self.drives.at(*joint).is_held());
        self.is_half && held.all(|joint| !self.drives.at(joint).answers.awaited)
    }
}
