//! PowerCube drives on a CAN bus.
//!
//! # Map
//!
//! | module | is |
//! |---|---|
//! | [`settings`] | registers that only PowerCubes have |
//! | [`drives`] | one drive: requests on their way, which reply belongs to which request, what was read last |
//! | [`words`] | what state words say |
//! | [`schedule`], [`order`], [`slots`], [`cycle_timing`] | who is asked next, in which order, when in the cycle; how long a cycle takes |
//! | [`ramp`] | acceleration in the words of a ramp drive |
//! | `generator` | the ramp generator of a drive, in closed form |
//! | [`drive_model`] | what a drive should do with its commands, and how far its answers are from it |
//! | [`transmit`] | frames on their way out |
//! | `exchange` | requests out, replies in; what each answer says |
//! | `cycle` | periods: set points become requests; reading while nothing moves; signs of life |
//! | `finding`, `homing`, `jogging` | what takes several steps |
//! | `held` | what a drive holds beside its ramp registers |
//! | `output` | the gripper's output of a module |
//! | `readiness` | what the controller asks before it moves anything |
//!
//! A set point goes from `cycle` through [`ramp`] into [`schedule`], from there through `exchange` into [`transmit`]; its
//! answer comes through `exchange` with [`drives`], [`drive_model`] and [`words`].
//!
//! # Invariants
//!
//! 1. A motion is sent in a mode that may move only, through one function (`exchange::ask`).
//! 2. A reply is never taken for another ([`drives`] says why).
//! 3. After a halt nothing that waited is sent.

pub mod cycle_timing;
pub mod drive_model;
pub mod drives;
mod generator;
pub mod order;
pub mod ramp;
pub mod schedule;
pub mod settings;
pub mod slots;
pub mod transmit;
pub mod words;

mod cycle;
mod exchange;
mod finding;
mod held;
mod homing;
mod jogging;
mod output;
mod readiness;

use heapless::Deque;
use protocol::{Duration, Frame, Instant, JointIndex};

pub use self::finding::Stage;

use self::cycle::{Axis, Cycle};
use self::cycle_timing::{CycleTimer, CycleTimes};
use self::drive_model::DriveModel;
use self::drives::DriveRecord;
use self::finding::BootProgress;
use self::homing::Homing;
use self::jogging::Jog;
use self::output::GripperWrite;
use self::schedule::Schedule;
use self::settings::{GRIPPER_ADDRESS, MONITORING, REGISTERS};
use self::slots::Slots;
use self::transmit::TransmitQueue;
use crate::fault::{Fault, Refusal};
use crate::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, Law, PositionSample, Profile, Readings, SetPoint,
    Standing, Taken,
};
use crate::joints::PerJoint;
use crate::registers::FamilyRegisters;
use crate::settings::Settings;

/// Cycles between the order to run and the start of the plan: the loop settles on the standing reference.
const LEAD_CYCLES: u64 = 2;
/// Events of one answer or one deadline: failure, measurement, end of a step.
const EVENTS: usize = 4;

/// What the group is at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// Looking for the drives.
    Finding(Stage),
    /// Reading the drives in turn.
    Standing {
        /// A run may follow.
        armed: bool,
    },
    /// A joint looks for its zero.
    Homing(Homing),
    /// A joint moves slowly.
    Jogging(Jog),
    /// Set points.
    Tracking,
    /// Slow ramps to a position.
    Parking,
    /// Ramps to rest.
    Braking {
        /// The joint of a jog, which brakes alone, with the acceleration of jogs.
        jogged: Option<JointIndex>,
    },
    /// The halt is out; the drives brake by themselves.
    Halted,
}

impl Mode {
    /// Joints move, or may still move.
    const fn may_move(self) -> bool {
        !matches!(self, Self::Finding(_) | Self::Standing { .. })
    }

    /// Motions that leave are ramps to rest.
    const fn ramps_to_rest(self) -> bool {
        match self {
            Self::Braking { .. } => true,
            Self::Jogging(jog) => jog.is_releasing(),
            _ => false,
        }
    }

    /// Led by the control cycle.
    const fn is_cyclic(self) -> bool {
        matches!(self, Self::Tracking | Self::Parking | Self::Braking { .. } | Self::Halted)
    }
}

/// What is left to do in a call, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    /// Deadlines: answers, then a sign of life, then the period.
    Answers,
    LifeThenPeriod,
    Period,
    /// A packet came: a sign of life that is due.
    Life,
    Done,
}

/// What the group waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Timer {
    /// An answer of a drive is missing.
    Answer,
    /// The gripper's module has not answered.
    Gripper,
    /// The drives want a sign of life.
    Life,
    /// A period begins.
    Period,
    /// A request waits for its slot, or for its key to get free.
    Slot,
}

/// Each of them: all that are due are served in one call, in this order.
const TIMERS: [Timer; 5] = [Timer::Answer, Timer::Gripper, Timer::Life, Timer::Period, Timer::Slot];

/// See the [module](self).
pub struct PowerCubes {
    mode: Mode,
    turn: Turn,
    drives: PerJoint<DriveRecord>,
    axes: PerJoint<Axis>,
    progress: PerJoint<BootProgress>,
    schedule: Schedule,
    slots: Slots,
    timing: CycleTimer,
    cycle: Cycle,
    transmit: TransmitQueue,
    events: Deque<GroupEvent, EVENTS>,
    /// Joints whose missed answers are still to be reported: once, and a second time.
    unreported: [u8; 2],
    /// Next sign of life to the drives; `None` while they get none.
    watchdog_due: Option<Instant>,
    /// What the drives said before this is from before the last reset.
    reset_at: Instant,
    /// Gripper write that is not answered.
    gripper_write: Option<GripperWrite>,
    counters: GroupCounters,
}

#[inline(never)]
fn default_in_place<T: Default>() -> T {
    T::default()
}

impl Default for PowerCubes {
    fn default() -> Self {
        Self {
            mode: Mode::Finding(Stage::FIRST_SCAN),
            turn: Turn::Done,
            drives: default_in_place(),
            axes: default_in_place(),
            progress: PerJoint::default(),
            schedule: default_in_place(),
            slots: Slots::default(),
            timing: CycleTimer::default(),
            cycle: Cycle::default(),
            transmit: default_in_place(),
            events: Deque::new(),
            unreported: [0; 2],
            watchdog_due: None,
            reset_at: Instant::ZERO,
            gripper_write: None,
            counters: GroupCounters::default(),
        }
    }
}

impl PowerCubes {
    /// What the group is at.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// A drive as it is known.
    pub const fn drive(&self, joint: JointIndex) -> &DriveRecord {
        self.drives.at(joint)
    }

    /// What a drive should have done with its commands by now, and how far its last answer was from it.
    pub const fn drive_model(&self, joint: JointIndex) -> &DriveModel {
        &self.axes.at(joint).model
    }

    /// Durations of the control cycles of the last run; and how long one takes by the last timing checks, µs ([`cycle_timing`]), `None`
    /// before the first.
    pub fn cycle_times(&self, settings: &Settings) -> (CycleTimes, Option<u32>) {
        (self.timing.times(), self.timing.cycle_us(settings.joints, MONITORING.get(settings)))
    }

    fn push(&mut self, event: GroupEvent) {
        // No call makes more than there is room for. If one did, a fault would take the place of the newest event.
        if let Err(event) = self.events.push_back(event)
            && let GroupEvent::Failed(_) = event
        {
            self.events.pop_back();
            let _ = self.events.push_back(event);
        }
    }

    /// When a deadline comes, if there is one.
    fn deadline(&self, timer: Timer, now: Instant, settings: &Settings) -> Option<Instant> {
        match timer {
            Timer::Answer => settings.joints().filter_map(|joint| self.drives.at(joint).deadline()).min(),
            Timer::Gripper => self.gripper_deadline(),
            Timer::Life => self.watchdog_due,
            Timer::Period => Some(self.cycle.due),
            Timer::Slot => self.schedule.wake_up(now, settings.joints(), &self.drives),
        }
    }

    fn fail(&mut self, fault: Fault) {
        self.push(GroupEvent::Failed(fault));
    }

    fn send(&mut self, frame: &Frame) {
        self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
        self.transmit.push(frame);
    }

    fn halt(&mut self, settings: &Settings) {
        self.schedule.clear_all();
        for joint in settings.joints() {
            self.axes.at_mut(joint).model.stop_watching();
        }
        self.transmit.halt();
        self.mode = Mode::Halted;
    }
}

impl DriveGroup for PowerCubes {
    type Packet = Frame;

    fn registers(&self) -> &'static FamilyRegisters {
        &REGISTERS
    }

    fn handle_packet(&mut self, now: Instant, settings: &Settings, frame: &Frame) {
        self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
        self.take_frame(now, settings, frame);
        self.turn = Turn::Life;
    }

    fn handle_timeout(&mut self, _now: Instant, _settings: &Settings) {
        self.turn = Turn::Answers;
    }

    #[inline(never)]
    fn poll_event(&mut self, now: Instant, settings: &Settings) -> Option<GroupEvent> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Some(event);
            }
            if let Some(missed) = self.next_missed(settings) {
                return Some(missed);
            }
            match self.turn {
                Turn::Answers => {
                    self.give_up_due(now, settings);
                    self.give_up_gripper(now, settings);
                    self.turn = Turn::LifeThenPeriod;
                }
                Turn::LifeThenPeriod => {
                    self.refresh_watchdog(now, settings);
                    self.turn = Turn::Period;
                }
                Turn::Period => {
                    self.turn = Turn::Done;
                    self.begin_period(now, settings);
                }
                Turn::Life => {
                    self.refresh_watchdog(now, settings);
                    self.turn = Turn::Done;
                }
                Turn::Done => return None,
            }
        }
    }

    fn flush(&mut self, now: Instant, settings: &Settings) {
        self.end_period(settings);
        self.pump(now, settings);
    }

    fn poll_packet(&mut self) -> Option<Frame> {
        self.transmit.pop()
    }

    fn poll_timeout(&self, now: Instant, settings: &Settings) -> Option<Instant> {
        TIMERS.into_iter().filter_map(|timer| self.deadline(timer, now, settings)).min()
    }

    fn command(&mut self, now: Instant, settings: &Settings, command: Command) {
        match command {
            Command::Find { reset } => self.find(now, settings, reset),
            Command::Reset => self.send_reset(now, settings),
            Command::Stand { armed } => self.mode = Mode::Standing { armed },
            Command::Abandon => {
                self.watchdog_due = None;
                self.mode = Mode::Standing { armed: false };
            }
            Command::Home(joint) => self.home(settings, joint),
            Command::Jog { joint, qd_rad_s, until } => self.jog(now, settings, joint, qd_rad_s, until),
            Command::Track => self.track(now, settings),
            Command::MoveTo { joint, q_rad } => self.move_to(settings, joint, q_rad),
            Command::Halt => self.halt(settings),
            Command::HaltJoint(joint) => {
                self.schedule.clear(joint);
                self.halt_drive(now, settings, joint);
            }
        }
    }

    fn brake(&mut self, now: Instant, settings: &Settings) -> Instant {
        self.brake_all(now, settings)
    }

    fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken {
        self.realise(settings, joint, set_point)
    }

    fn acts_at(&self, joint: JointIndex) -> Instant {
        self.cycle.at + Duration::from_micros(self.axes.at(joint).phase_us.into())
    }

    fn observe(&mut self, joint: JointIndex, qd_rad_s: f32, dt_s: f32) {
        self.axes.at_mut(joint).generator.pull(qd_rad_s, dt_s);
    }

    fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool {
        let is_module = GRIPPER_ADDRESS.get(settings) != 0;
        if is_module {
            self.write_gripper(open);
        }
        is_module
    }

    fn cancel_gripper(&mut self) {
        self.gripper_write = None;
    }

    fn profile(&self, settings: &Settings) -> Profile {
        let period = settings.cycle_period();
        Profile {
            law: Law::Feedback,
            period,
            lag: Duration::from_micros(settings.drive_lag_us.into()),
            lead: period * LEAD_CYCLES,
        }
    }

    fn check_group(&self, now: Instant, settings: &Settings) -> Result<(), Refusal> {
        self.is_group_ready(now, settings)
    }

    fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal> {
        self.is_drive_ready(now, settings, joint)
    }

    fn position(&self, joint: JointIndex) -> Option<PositionSample> {
        self.drives.at(joint).position
    }

    fn is_homed(&self, joint: JointIndex) -> bool {
        self.drives.at(joint).is_homed()
    }

    fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.stands(now, settings, joint)
    }

    fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        self.moves(now, settings, joint)
    }

    fn standing(&self, joint: JointIndex) -> Standing {
        self.report_of(joint)
    }

    fn readings(&self, joint: JointIndex) -> Readings {
        self.read(joint)
    }

    fn counters(&self) -> GroupCounters {
        self.counters
    }

    fn needs_wire(&self, settings: &Settings) -> bool {
        let is_done = |joint| self.schedule.is_done(joint, self.drives.at(joint));
        (self.mode.is_cyclic() || self.timing.is_checking()) && !settings.joints().all(is_done)
    }
}
