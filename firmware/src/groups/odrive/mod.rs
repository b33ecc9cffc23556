//! ODrives that speak CANSimple (0.5, 0.6) on one CAN bus: the group is the clock; each axis gets one set point and one request per
//! period, and gives one answer.
//!
//! An axis gives `k_v (v + k_p (p - q) - q̇) + t` and holds p, v and t until the next set point. The group leads a set point of each joint
//! from the accelerations of the law. It sends the means over the period, for which they are held: p, v, and as t the torque that the set
//! points need by the [`ArmModel`](super::dynamics::ArmModel). Gains are those of [`Axis`].
//!
//! # Stops
//!
//! [`Command::Halt`] leads each joint to rest along a ramp of its own, beginning with the next period, and then holds it. An axis that
//! reports an error, falls to idle or does not answer gets the order to stop (Estop), from which only a person leads out by clearing the
//! fault. With [`Command::Abandon`] such an axis gets no frame any more, so its watchdog strikes. If the controller dies, all watchdogs do.
//!
//! # Answers
//!
//! Estimates hold no number of their request. They count if they come after the request can have been on the bus, once per request and
//! before the next period (`groups/answers.rs` has the rest). They show the joint when the request came. Ones that nobody asked for are refused while the axis is looked for:
//! their time is not known. Estimates that are no numbers, which an axis without an encoder sends, are implausible.
//!
//! # Gripper
//!
//! The axis of the fingers has the place after the last joint. It stands where it is until the first order, then holds the fingers open or
//! closed, also in a halt. While it is held, only its heartbeats are read: the group does not ask for its position. One that is silent or has an
//! error stops the group along its plan ([`Cause::GripperUnanswered`]).
//!
//! # Map
//!
//! | file | is |
//! |---|---|
//! | [`options`] | axes, gains, numbers of parameters, ids |
//! | `finding` | from silence to torque: version and parameters compared, watchdog proven |
//! | `drive` | an axis as the group knows it |
//! | `sending` | the frames of a period |

mod drive;
mod finding;
pub mod options;
mod sending;

use heapless::Deque;
use odrive_protocol::{Heartbeat, Order, Report, Version};
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
pub use self::finding::Mismatch;
use self::finding::{Message, SPEED_ROOM, Step};
pub use self::options::{
    Axis, Endpoints, GripperAxis, Home, Options, OptionsError, Parameter, VELOCITY_MAX_REV_S,
};
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
/// From the end of a ramp to the rest of the joint behind its gains: with a position gain of 20 1/s 4 % of the distance are left by then.
const SETTLING: Duration = Duration::from_millis(160);
/// Duration of a homing, in which no joint turns. A state that lasts a few milliseconds may not reach the host.
const HOMING: Duration = Duration::from_millis(100);
/// Frames of a period: two for each axis.
const FRAMES_MAX: usize = 16;

/// See the [module](self).
#[derive(Debug)]
pub struct Odrive {
    options: Options,
    drives: PerJoint<Drive>,
    leader: Leader,
    /// Its zero is looked for until then.
    homing: Option<(JointIndex, Instant)>,
    /// Last order to the gripper.
    gripper_open: Option<bool>,
    events: Deque<GroupEvent, 32>,
    out: Deque<Frame, FRAMES_MAX>,
    due: Instant,
    /// Beginning of the period.
    at: Instant,
    /// The frames of the period are still to be made.
    is_begun: bool,
    abandoned: bool,
    mismatch: Option<(JointIndex, Mismatch)>,
    counters: GroupCounters,
}

impl Default for Odrive {
    /// Without axes: nothing is found.
    fn default() -> Self {
        Self::new(Options::default())
    }
}

impl Odrive {
    /// For these axes; the first one moves joint 0.
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
            abandoned: false,
            mismatch: None,
            counters: GroupCounters::default(),
        }
    }

    /// What the last search was refused for with [`Cause::DriveSettingsDiffer`].
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

    /// Place and axis of the gripper, unless the settings have a joint at that place.
    fn gripper(&self, settings: &Settings) -> Option<(JointIndex, &GripperAxis)> {
        self.options.gripper().filter(|(place, _)| place.get() == settings.joints as usize)
    }

    fn gripper_place(&self, settings: &Settings) -> Option<JointIndex> {
        self.gripper(settings).map(|(place, _)| place)
    }

    /// Places of all axes: the joints, base first, then the gripper.
    fn places(&self, settings: &Settings) -> impl Iterator<Item = JointIndex> + use<> {
        settings.joints().chain(self.gripper_place(settings))
    }

    /// Limits of a joint, or of the fingers.
    fn limits(&self, settings: &Settings, place: JointIndex) -> JointSettings {
        let own = settings.joint.at(place);
        match self.gripper(settings) {
            Some((fingers, gripper)) if fingers == place => {
                let v_max_rad_s = gripper.axis.to_rad(VELOCITY_MAX_REV_S) / SPEED_ROOM;
                finger_limits(own, [gripper.open_rad, gripper.closed_rad], v_max_rad_s)
            }
            _ => *own,
        }
    }

    fn cause(&self, now: Instant, joint: JointIndex) -> Option<Cause> {
        self.options.axis(joint).and_then(|axis| self.drives.at(joint).cause(now, axis.version))
    }

    /// Stops an axis that is lost or does not do what it should, and reports it; each axis once in a search.
    fn watch(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let Some(cause) = self.cause(now, joint) else { return };
        let is_gripper = self.gripper_place(settings) == Some(joint);
        let cause = if is_gripper { Cause::GripperUnanswered } else { cause };
        let drive = self.drives.at_mut(joint);
        drive.go_to(now, Step::Off);
        if core::mem::replace(&mut drive.is_reported, true) {
            return;
        }
        if self.leader.is_finding() {
            self.refuse(joint, cause);
        } else {
            self.fail(joint, cause);
        }
    }

    /// Counts the answers that did not come.
    fn count_missed(&mut self, settings: &Settings) -> bool {
        let mut any = false;
        for joint in self.places(settings) {
            let drive = self.drives.at_mut(joint);
            if let Some(in_row) = drive.answers.close()
                && drive.is_held()
            {
                any = true;
                self.push(GroupEvent::Missed(joint, in_row));
            }
        }
        any
    }

    fn take_heartbeat(&mut self, now: Instant, settings: &Settings, joint: JointIndex, heartbeat: Heartbeat) {
        let drive = self.drives.at_mut(joint);
        (drive.heartbeat, drive.heard_at) = (Some(heartbeat), now);
        self.take_search_heartbeat(now, settings, joint, &heartbeat);
        self.watch(now, settings, joint);
    }

    fn take_estimates(
        &mut self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
        axis: Axis,
        frame: &Frame,
        rev: f32,
    ) {
        let (began_at, limits) = (self.at, &self.limits(settings, joint));
        let drive = self.drives.at_mut(joint);
        if !drive.has_asked() {
            // Until the parameter that ends them is written they are no fault.
            let may_end =
                matches!(drive.step, Step::Look | Step::Release | Step::Clear | Step::Version | Step::Row(_));
            let counts = !(may_end && self.options.endpoints().is_some());
            drive.unasked = drive.unasked.saturating_add(counts.into());
            return;
        }
        let [earliest, usual] = drive.asked_after;
        let answer = sending::span_of(frame);
        if now < began_at + earliest + answer || !drive.answers.admits(drive.is_held()) {
            return;
        }
        drive.answers.came();
        let at = (began_at + usual).min(now.saturating_sub(answer));
        let q_rad = drive.joint_rad(axis, limits, rev);
        let follows = drive.is_held() && drive.has_torque();
        match drive.answers.take(frame, q_rad, at, limits, follows) {
            Worth::Measured => {}
            _ if !drive.is_held() => return,
            Worth::Frozen => return self.fail(joint, Cause::PositionFrozen),
            Worth::Implausible(again) => return self.push(GroupEvent::Implausible(joint, again)),
        }
        if let Some(sample) = drive.answers.sample.filter(|_| drive.is_held()) {
            let in_force = self.leader.in_force(joint, true);
            self.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause: None }));
        }
    }

    /// Events of modes that end by themselves, and what the axes owe.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        for joint in self.places(settings) {
            self.watch(now, settings, joint);
            if let Some(axis) = self.options.axis(joint).filter(|_| self.leader.is_finding()) {
                self.proceed_search(now, settings, joint, axis);
            }
        }
        if let Some((joint, _)) = self.homing.take_if(|(_, until)| *until <= now) {
            let axis = self.options.axis(joint);
            match axis.and_then(|axis| self.drives.at_mut(joint).home(axis, settings.joint.at(joint))) {
                Some(by_rad) => {
                    self.leader.joints.at_mut(joint).set.q_rad += by_rad;
                    self.push(GroupEvent::Homed(joint));
                }
                None => self.fail(joint, Cause::HomingFailed),
            }
        }
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        if self.leader.is_finding() {
            if all_rest && self.places(settings).all(|place| self.drives.at(place).is_held()) {
                self.leader.mode = Mode::Standing;
                self.push(GroupEvent::Found);
            }
        } else if let Some(event) = self.leader.proceed(now, all_rest) {
            self.push(event);
        }
    }
}

impl DriveGroup for Odrive {
    type Packet = Frame;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        let Id::Standard(id) = frame.id() else { return };
        let of = self.options.axis_of(id).filter(|(place, _)| self.places(settings).any(|own| own == *place));
        let Some((joint, axis)) = of else { return };
        // Only 0.6 reports its version: also where 0.5 is expected.
        let report = Report::decode(frame, axis.version).or_else(|| {
            let other = Report::decode(frame, Version::V06);
            other.filter(|(_, report)| matches!(report, Report::Version { .. }))
        });
        let report = report.filter(|_| !frame.data().is_empty());
        let Some((_, report)) = report else {
            // Of a request too: somebody else asks or orders.
            let is_foreign = frame.data().is_empty() || Order::decode(frame, axis.version).is_some();
            self.counters.foreign = self.counters.foreign.saturating_add(is_foreign.into());
            return;
        };
        self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
        match report {
            Report::Heartbeat(heartbeat) => self.take_heartbeat(now, settings, joint, heartbeat),
            Report::Estimates { rev, .. } => self.take_estimates(now, settings, joint, axis, frame, rev),
            other => self.take_answer(now, settings, joint, &other),
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
        (self.at, self.is_begun) = (now, true);
        self.proceed(now, settings);
        self.push(GroupEvent::Cycle { late, overrun });
    }

    fn poll_event(&mut self, _: Instant, _: &Settings) -> Option<GroupEvent> {
        self.events.pop_front()
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        if core::mem::take(&mut self.is_begun) {
            self.send_burst(now, settings);
        }
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
            let (drive, led) = (self.drives.at_mut(joint), self.leader.joints.at_mut(joint));
            led.load_rad = drive.answers.sample.map_or(0.0, |sample| led.set.q_rad - sample.q_rad);
            drive.answers.rest.forget();
        }
        match command {
            Command::Find { .. } => {
                (self.abandoned, self.mismatch) = (false, None);
                for joint in self.places(settings) {
                    if let Some(axis) = self.options.axis(joint) {
                        self.drives.at_mut(joint).find(now, settings.reply_missed_max, axis.version);
                    }
                }
            }
            Command::Abandon => self.abandoned = true,
            Command::Home(joint) => self.homing = Some((joint, now + HOMING)),
            Command::HaltJoint(joint) if self.leader.mode != Mode::Halted => {
                self.drives.at_mut(joint).go_to(now, Step::Off);
            }
            _ => {}
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        now + self.leader.brake(settings) + settings.cycle_period() * 2 + SETTLING
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let Some(axis) = self.options.axis(joint) else { return Taken::default() };
        let limits = settings.joint.at(joint);
        let v_max_rad_s = clamp(limits.v_max_rad_s, 0.0, axis.to_rad(VELOCITY_MAX_REV_S));
        let sample = self.drives.at(joint).answers.sample;
        self.leader.given(&JointSettings { v_max_rad_s, ..*limits }, joint, set_point, sample)
    }

    fn acts_at(&self, joint: JointIndex) -> Instant {
        self.at + self.drives.at(joint).acts_after
    }

    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        let Some(place) = self.gripper_place(settings) else { return false };
        self.gripper_open = Some(open);
        // The order leaves at once: the next burst, which repeats it, may be a period away.
        self.lead_fingers(settings, place);
        if self.drives.at(place).is_held()
            && let Some(axis) = self.options.axis(place)
            && let Some(frame) = self.frame_of(settings, place, axis, Message::SetPoint)
        {
            self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
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
        let is_sound = self.cause(now, joint).is_none() && self.drives.at(joint).is_held();
        check_drive(joint, self.is_homed(joint), is_sound && self.is_at_rest(now, settings, joint))
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
        Standing { cause: self.cause(self.at, joint), reports_motion: false, yields: !drive.is_held() }
    }

    fn readings(&self, joint: JointIndex) -> Readings {
        let drive = self.drives.at(joint);
        let error = drive.heartbeat.is_some_and(|heartbeat| heartbeat.error != 0);
        // Errors, by their bits; their highest byte gives way to the state of the axis.
        let state = drive.heartbeat.map(|beat| beat.error << 8 | u32::from(beat.state.number()));
        self.leader.readings(joint, &drive.answers, state, error)
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }

    fn is_keeping_time(&self) -> bool {
        // An axis that is held takes a set point in each period: at rest, and while others are looked for.
        self.options.places().any(|place| self.drives.at(place).is_held())
    }

    fn is_cycle_done(&self, settings: &Settings) -> bool {
        let mut held = settings.joints().filter(|joint| self.drives.at(*joint).is_held());
        held.all(|joint| !self.drives.at(joint).answers.awaited)
    }
}
