//! A group of drives on one CAN bus that follow positions: what all such families share. [`Family`] is what each brings.

use core::fmt;

use heapless::Deque;
use protocol::cyphal::cubecell::group_state::DriveDifference;
use protocol::{Duration, Frame, Instant, JointIndex};

use super::answers::Answers;
use super::leading::{Leader, Mode};
use crate::fault::{Cause, Fault, Refusal};
use crate::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, Law, PositionSample, Profile, Readings, SetPoint,
    Standing, Taken,
};
use crate::joints::{PerJoint, at_least, at_most, clamp};
use crate::settings::{JointSettings, Settings};

/// Duration of a homing in which no joint turns. A state that lasts a few milliseconds may not reach the host.
const HOMING: Duration = Duration::from_millis(100);

/// Fingers that a drive of the group moves. It has the place after the last joint.
#[derive(Clone, Copy, Debug)]
pub struct Fingers {
    pub(super) place: JointIndex,
    pub(super) open_rad: f32,
    pub(super) closed_rad: f32,
    pub(super) v_max_rad_s: f32,
}

/// A drive as its group knows it.
pub trait Drive: fmt::Debug + Default {
    fn answers(&self) -> &Answers;

    fn answers_mut(&mut self) -> &mut Answers;

    /// It has torque from this group.
    fn is_held(&self) -> bool;

    /// It is held, and does nothing but take set points.
    fn is_ready(&self) -> bool {
        self.is_held()
    }

    fn is_homed(&self) -> bool;

    /// It gets no set point any more.
    fn switch_off(&mut self, now: Instant);
}

/// What a family adds to [`PositionDrives`], and its own part of the state.
pub trait Family: fmt::Debug + Default {
    /// Its drives and their ids.
    type Options: fmt::Debug + Default;
    /// A drive.
    type Drive: Drive;
    /// What in a drive differs from the settings.
    type Mismatch: fmt::Debug + Copy + Into<DriveDifference>;

    /// Periods from the order to run to the start of the plan.
    const LEAD_PERIODS: u64;
    /// Periods from an order to the set point that it changes.
    const BRAKE_PERIODS: u64;
    /// From the end of a ramp to the rest of the joint behind its loop.
    const SETTLING: Duration;
    /// Time for which a joint must stand to be at rest.
    const SWING: Duration = Duration::ZERO;
    /// In a halt a drive that does not answer keeps its torque: without it the joint falls.
    const HALTED_IS_HELD: bool = true;

    /// Number of drives, the gripper's included.
    fn drives(options: &Self::Options) -> usize;

    /// The fingers, if a drive of their own moves them.
    fn fingers(_: &Self::Options) -> Option<Fingers> {
        None
    }

    /// Largest speed of a joint that its drive can be ordered; `None`: the joint has no drive.
    fn v_max_rad_s(options: &Self::Options, joint: JointIndex) -> Option<f32>;

    /// The frame as it goes onto the bus.
    fn on_bus(_: &Self::Options, frame: Frame) -> Frame {
        frame
    }

    /// Time of a frame in nominal bits.
    fn bits(_: &Self::Options, frame: &Frame) -> u32 {
        frame.nominal_bits()
    }

    /// A deadline has come. Returns how late the control step is and whether it is an overrun; `None`: it is not the time of a control step.
    fn begin(
        group: &mut PositionDrives<Self>,
        now: Instant,
        settings: &Settings,
    ) -> Option<(Duration, bool)> {
        let period = settings.cycle_period();
        let is_first = group.at == Instant::ZERO;
        let late = if is_first { Duration::ZERO } else { now.saturating_since(group.due) };
        let overrun = group.count_missed(now, settings) || late >= period;
        // A period that came late is not made up for: two bursts at once say nothing more.
        group.due = if late >= period { now } else { now.saturating_sub(late) } + period;
        group.at = now;
        Some((late, overrun))
    }

    /// See [`DriveGroup::handle_packet`].
    fn take_frame(group: &mut PositionDrives<Self>, now: Instant, settings: &Settings, frame: &Frame);

    /// Stops and reports drives that are lost, and goes on with what the drives do by themselves.
    fn watch(_: &mut PositionDrives<Self>, _: Instant, _: &Settings) {}

    /// Begins a search.
    fn find(group: &mut PositionDrives<Self>, now: Instant, settings: &Settings);

    /// Goes on with the search: what no answer ends.
    fn search(group: &mut PositionDrives<Self>, now: Instant, settings: &Settings);

    /// The frames of a period.
    fn send_period(group: &mut PositionDrives<Self>, now: Instant, settings: &Settings);

    /// Begins a homing that the drive ends; false: the drive has nothing to do.
    fn begin_homing(_: &mut PositionDrives<Self>, _: Instant, _: &Settings, _: JointIndex) -> bool {
        false
    }

    /// Whether the joint has its zero now.
    fn home(group: &mut PositionDrives<Self>, settings: &Settings, joint: JointIndex) -> bool;

    /// What is wrong with a drive.
    fn cause(group: &PositionDrives<Self>, now: Instant, joint: JointIndex) -> Option<Cause>;

    /// Its state in the encoding of the family, and whether it reports an error.
    fn state(group: &PositionDrives<Self>, joint: JointIndex) -> (Option<u32>, bool);

    /// See [`DriveGroup::acts_at`].
    fn acts_at(group: &PositionDrives<Self>, joint: JointIndex) -> Instant;

    /// The drives have been asked for their positions in this period.
    fn has_asked(_: &PositionDrives<Self>) -> bool {
        true
    }

    /// A drive opens the hand.
    fn has_gripper(group: &PositionDrives<Self>, settings: &Settings) -> bool {
        group.gripper_place(settings).is_some()
    }

    /// The order to the hand; `None`: it cannot be given now.
    fn gripper_frame(group: &mut PositionDrives<Self>, settings: &Settings) -> Option<Frame>;
}

/// See the [module](self).
#[derive(Debug)]
pub struct PositionDrives<F: Family> {
    pub(super) options: F::Options,
    pub(super) drives: PerJoint<F::Drive>,
    pub(super) leader: Leader,
    pub(super) own: F,
    /// Its zero is looked for until then.
    homing: Option<(JointIndex, Instant)>,
    /// Last order to the gripper.
    pub(super) gripper_open: Option<bool>,
    events: Deque<GroupEvent, 32>,
    pub(super) out: Deque<Frame, 40>,
    pub(super) due: Instant,
    /// Beginning of the period.
    pub(super) at: Instant,
    /// The frames of the period are still to be made.
    is_begun: bool,
    pub(super) is_odd: bool,
    pub(super) abandoned: bool,
    pub(super) mismatch: Option<(JointIndex, F::Mismatch)>,
    pub(super) counters: GroupCounters,
}

impl<F: Family> Default for PositionDrives<F> {
    /// Without drives: nothing is found.
    fn default() -> Self {
        Self::new(F::Options::default())
    }
}

impl<F: Family> PositionDrives<F> {
    /// For these drives; the first one moves joint 0.
    pub fn new(options: F::Options) -> Self {
        Self {
            options,
            drives: PerJoint(core::array::from_fn(|_| F::Drive::default())),
            leader: Leader::new(Mode::Finding { reset: false }),
            own: F::default(),
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

    /// What the last search was refused for with [`Cause::DriveSettingsDiffer`], and the joint.
    pub const fn mismatch(&self) -> Option<&(JointIndex, F::Mismatch)> {
        self.mismatch.as_ref()
    }

    pub(super) fn push(&mut self, event: GroupEvent) {
        // There is room: a call makes at most two events per joint, and a few of the group.
        let _ = self.events.push_back(event);
    }

    pub(super) fn fail(&mut self, joint: JointIndex, cause: Cause) {
        self.push(GroupEvent::Failed(Fault::at(cause, joint)));
    }

    /// Ends the search.
    pub(super) fn refuse(&mut self, joint: JointIndex, cause: Cause) {
        if self.leader.is_finding() {
            self.leader.mode = Mode::Halted;
            self.fail(joint, cause);
        }
    }

    /// Reports a drive, in a search as the end of it.
    pub(super) fn report(&mut self, joint: JointIndex, cause: Cause) {
        if self.leader.is_finding() {
            self.refuse(joint, cause);
        } else {
            self.fail(joint, cause);
        }
    }

    pub(super) fn send(&mut self, frame: Frame) {
        self.counters.bits = self.counters.bits.wrapping_add(F::bits(&self.options, &frame));
        // There is room for a period: the runner empties it after each call.
        let _ = self.out.push_back(frame);
    }

    /// Counts a motion command if a motion was ordered.
    pub(super) fn count_motion(&mut self) {
        let moves = self.leader.moves();
        self.counters.motions = self.counters.motions.saturating_add(moves.into());
    }

    pub(super) fn count_foreign(&mut self) {
        self.counters.foreign = self.counters.foreign.saturating_add(1);
    }

    /// The fingers, unless the settings have a joint at their place.
    pub(super) fn fingers(&self, settings: &Settings) -> Option<Fingers> {
        F::fingers(&self.options).filter(|own| own.place.get() == settings.joints as usize)
    }

    pub(super) fn gripper_place(&self, settings: &Settings) -> Option<JointIndex> {
        self.fingers(settings).map(|fingers| fingers.place)
    }

    /// Places of all drives: the joints, base first, then the fingers.
    pub(super) fn places(&self, settings: &Settings) -> impl Iterator<Item = JointIndex> + use<F> {
        settings.joints().chain(self.gripper_place(settings))
    }

    /// Limits of a joint, or of the fingers.
    pub(super) fn limits(&self, settings: &Settings, place: JointIndex) -> JointSettings {
        let own = *settings.joint.at(place);
        match self.fingers(settings) {
            Some(Fingers { place: fingers, open_rad, closed_rad, v_max_rad_s }) if fingers == place => {
                JointSettings {
                    inverted: false,
                    offset_rad: 0.0,
                    q_min_rad: at_most(open_rad, closed_rad),
                    q_max_rad: at_least(open_rad, closed_rad),
                    v_max_rad_s,
                    ..own
                }
            }
            _ => own,
        }
    }

    /// Counts the answers that did not come. Returns whether one of a joint with torque is missing.
    pub(super) fn count_missed(&mut self, now: Instant, settings: &Settings) -> bool {
        let (mut any, fingers) = (false, self.gripper_place(settings));
        for place in self.places(settings) {
            let drive = self.drives.at_mut(place);
            let Some(in_row) = drive.answers_mut().close().filter(|_| drive.is_held()) else { continue };
            if fingers != Some(place) {
                any = true;
                self.push(GroupEvent::Missed(place, in_row));
            } else if in_row > settings.reply_missed_max {
                self.lose_gripper(now, place);
            }
        }
        any
    }

    /// The drive of the fingers does not answer, or reports a fault.
    pub(super) fn lose_gripper(&mut self, now: Instant, place: JointIndex) {
        self.drives.at_mut(place).switch_off(now);
        self.report(place, Cause::GripperUnanswered);
    }

    /// Events of modes that end by themselves, and what the drives owe.
    fn proceed(&mut self, now: Instant, settings: &Settings) {
        F::watch(self, now, settings);
        if let Some((joint, _)) = self.homing.take_if(|(_, until)| *until <= now) {
            self.end_homing(settings, joint);
        }
        if self.leader.is_finding() {
            F::search(self, now, settings);
        }
        let all_rest = settings.joints().all(|joint| self.is_at_rest(now, settings, joint));
        if !self.leader.is_finding() {
            if let Some(event) = self.leader.proceed(now, all_rest) {
                self.push(event);
            }
        } else if all_rest && self.places(settings).all(|place| self.drives.at(place).is_ready()) {
            self.leader.mode = Mode::Standing;
            self.push(GroupEvent::Found);
        }
    }

    /// The joint takes its zero where it stands, or fails.
    pub(super) fn end_homing(&mut self, settings: &Settings, joint: JointIndex) {
        if F::home(self, settings, joint) {
            self.push(GroupEvent::Homed(joint));
        } else {
            self.fail(joint, Cause::HomingFailed);
        }
    }
}

impl<F: Family> DriveGroup for PositionDrives<F> {
    type Packet = Frame;

    fn handle_packet(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        F::take_frame(self, now, settings, frame);
    }

    fn handle_timeout(&mut self, now: Instant, settings: &Settings) {
        if now < self.due {
            return;
        }
        if let Some((late, overrun)) = F::begin(self, now, settings) {
            (self.is_begun, self.is_odd) = (true, !self.is_odd);
            self.proceed(now, settings);
            self.push(GroupEvent::Cycle { late, overrun });
        }
    }

    fn poll_event(&mut self, _: Instant, _: &Settings) -> Option<GroupEvent> {
        self.events.pop_front()
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        if core::mem::take(&mut self.is_begun) {
            F::send_period(self, now, settings);
        }
    }

    fn poll_packet(&mut self) -> Option<Frame> {
        self.out.pop_front().map(|frame| F::on_bus(&self.options, frame))
    }

    fn poll_timeout(&self, _: Instant, _: &Settings) -> Option<Instant> {
        Some(self.due)
    }

    fn command(&mut self, now: Instant, settings: &Settings, command: Command) {
        self.homing = None;
        if let Some(joint) = self.leader.command(now, settings, command) {
            let (answers, led) = (self.drives.at_mut(joint).answers_mut(), self.leader.joints.at_mut(joint));
            led.load_rad = answers.sample.map_or(0.0, |sample| led.set.q_rad - sample.q_rad);
            answers.rest.forget();
        }
        match command {
            Command::Find { .. } => {
                (self.abandoned, self.mismatch) = (false, None);
                F::find(self, now, settings);
            }
            Command::Abandon => self.abandoned = true,
            Command::Home(joint) if !F::begin_homing(self, now, settings, joint) => {
                self.homing = Some((joint, now + HOMING));
            }
            Command::HaltJoint(joint) if !(F::HALTED_IS_HELD && self.leader.mode == Mode::Halted) => {
                self.drives.at_mut(joint).switch_off(now);
            }
            _ => {}
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        now + self.leader.brake(settings) + settings.cycle_period() * F::BRAKE_PERIODS + F::SETTLING
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        let Some(v_max_rad_s) = F::v_max_rad_s(&self.options, joint) else { return Taken::default() };
        let limits = *settings.joint.at(joint);
        let limits = JointSettings { v_max_rad_s: clamp(limits.v_max_rad_s, 0.0, v_max_rad_s), ..limits };
        self.leader.given(&limits, joint, set_point, self.position(joint))
    }

    fn acts_at(&self, joint: JointIndex) -> Instant {
        F::acts_at(self, joint)
    }

    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        if !F::has_gripper(self, settings) {
            return false;
        }
        self.gripper_open = Some(open);
        // The order leaves at once: the next period, which repeats it, may be a while away.
        if let Some(frame) = F::gripper_frame(self, settings) {
            self.send(frame);
        }
        true
    }

    fn profile(&self, settings: &Settings) -> Profile {
        let period = settings.cycle_period();
        // The drives interpolate, or get the velocity of the set point: positions do not lag behind a steady motion.
        Profile { law: Law::Feedback, period, lag: Duration::ZERO, lead: period * F::LEAD_PERIODS }
    }

    fn check_group(&self, _: Instant, _: &Settings) -> Result<(), Refusal> {
        self.leader.check_group()
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        let is_sound = F::cause(self, now, joint).is_none() && self.drives.at(joint).is_ready();
        if !self.is_homed(joint) {
            Err(Refusal::at(Cause::NotHomed, joint))
        } else if is_sound && self.is_at_rest(now, settings, joint) {
            Ok(())
        } else {
            Err(Refusal::at(Cause::DriveNotReady, joint))
        }
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.drives.at(joint).answers().sample
    }

    fn is_homed(&self, joint: JointIndex) -> bool {
        self.drives.at(joint).is_homed()
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.leader.is_at_rest(now, settings, joint, self.drives.at(joint).answers(), F::SWING)
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.drives.at(joint).answers().is_moving(now, settings)
    }

    fn standing(&self, joint: JointIndex) -> Standing {
        let yields = !self.drives.at(joint).is_held();
        Standing { cause: F::cause(self, self.at, joint), yields, ..Standing::default() }
    }

    fn readings(&self, joint: JointIndex) -> Readings {
        let (state, error) = F::state(self, joint);
        self.leader.readings(joint, self.drives.at(joint).answers(), state, error)
    }

    fn difference(&self) -> Option<(JointIndex, DriveDifference)> {
        self.mismatch.map(|(joint, mismatch)| (joint, mismatch.into()))
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }

    fn needs_wire(&self, settings: &Settings) -> bool {
        // A drive that is held takes a set point in each period: at rest, and while others are looked for.
        let is_held = |place| self.drives.at(place).is_held();
        let awaits = |place| is_held(place) && self.drives.at(place).answers().awaited;
        let is_kept = JointIndex::first(F::drives(&self.options)).any(is_held);
        is_kept && (!F::has_asked(self) || self.places(settings).any(awaits))
    }
}
