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
//! [`Command::Halt`](crate::group::Command::Halt) leads each joint to rest along a ramp of its own, from the next SYNC on, and then holds it. A servo that reports a fault
//! or does not answer gets the order for a quick stop; with [`Command::Abandon`](crate::group::Command::Abandon) its node is stopped, too, which for it is a lost link. A
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
mod mismatch;
pub mod options;
mod rows;
mod sending;

use protocol::canopen::emcy::Emergency;
use protocol::canopen::{Function, NodeId, nmt};
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
use self::finding::{HEARTBEAT, Step};
pub use self::mismatch::{Found, Mismatch};
pub use self::options::{Follow, GripperOutput, Home, Options, OptionsError, Servo};
pub use self::rows::{Need, Use};
use super::answers::Worth;
use super::position::{Drive as _, Family, PositionDrives};
use crate::fault::Cause;
use crate::group::{GroupEvent, Measured};
use crate::settings::Settings;

/// Shortest SYNC, and shortest process data of six bytes, at 1 Mbit/s.
const SYNC_FRAME: Duration = Duration::from_micros(47);
const DATA_FRAME: Duration = Duration::from_micros(95);
/// Heartbeats of a servo that may stay away.
const BEATS_MAX: u64 = 4;

/// See the [module](self).
pub type Cia402 = PositionDrives<Servos>;

/// What the family adds. The period begins with its SYNC.
#[derive(Debug, Default)]
pub struct Servos {
    /// The control step comes next, and not the SYNC.
    is_half: bool,
    /// SYNC runs: all servos are configured.
    is_synchronous: bool,
    /// When the last SYNC was due.
    sync_due: Instant,
    /// Next heartbeat of the controller.
    beats_at: Instant,
    proof_ends_at: Instant,
}

impl Cia402 {
    /// The SYNC, after which all servos owe their process data.
    fn synchronize(&mut self, now: Instant, settings: &Settings) {
        self.count_missed(now, settings);
        self.at = now;
        if !self.own.is_synchronous {
            return;
        }
        self.send(nmt::sync());
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            drive.answers.awaited = drive.has_process_data();
        }
    }

    /// Reports a servo that is lost or does not do what it should; each servo once in a search.
    fn report_once(&mut self, joint: JointIndex, cause: Cause) {
        if !core::mem::replace(&mut self.drives.at_mut(joint).is_reported, true) {
            self.report(joint, cause);
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
            self.report_once(joint, cause);
        }
    }

    fn take_heartbeat(&mut self, now: Instant, joint: JointIndex, state: nmt::State) {
        let drive = self.drives.at_mut(joint);
        drive.heard_at = now;
        // It has started again, or somebody else manages the network.
        if drive.is_held() && state != nmt::State::Operational {
            self.report_once(joint, Cause::DriveError);
        }
    }

    fn take_process_data(&mut self, now: Instant, settings: &Settings, joint: JointIndex, frame: &Frame) {
        let (Some(servo), Some(map)) = (self.options.servo(joint), Options::from_servo()) else { return };
        let at = self.at + SYNC_FRAME;
        let is_early = now < at + DATA_FRAME;
        let drive = self.drives.at_mut(joint);
        if is_early {
            return;
        }
        if !drive.answers.admits(drive.is_held()) {
            if let Some([_, counts, ..]) = map.unpack(frame.data()) {
                drive.answers.take_doubtful(settings.joint.at(joint).to_joint_rad(servo.to_rad(counts)));
            }
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
        let has_torque = drive.state() == Some(protocol::canopen::cia402::State::OperationEnabled);
        if drive.step != Step::Held && !(drive.step == Step::Enabled && has_torque) {
            // The target stays at the position until the servo has torque.
            self.leader.stand(joint, sample.q_rad);
            drive.answers.taken_rad = sample.q_rad;
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
        let in_force = self.leader.in_force(joint, self.own.is_half);
        self.push(GroupEvent::Measured(Measured { joint, sample, in_force, cause }));
        if let Some(cause) = cause {
            self.refuse(joint, cause);
        }
    }

    /// Asks what is to be read and written next, and ends transfers that are late.
    fn proceed_transfers(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let aborted = self.drives.at_mut(joint).transfer.as_mut().and_then(|t| t.handle_timeout(now));
        if let Some(frame) = aborted {
            self.send(frame);
            self.proceed_transfer(now, settings, joint);
        }
        if self.leader.is_finding() || self.drives.at(joint).is_held() {
            self.ask(now, settings, joint);
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

impl Family for Servos {
    type Options = Options;
    type Drive = Drive;
    type Mismatch = Mismatch;

    /// A set point acts two periods after it is made.
    const LEAD_PERIODS: u64 = 3;
    const BRAKE_PERIODS: u64 = 3;
    const SETTLING: Duration = Duration::from_millis(60);
    /// Its own ramp and its brake stop a servo that is lost.
    const HALTED_IS_HELD: bool = false;

    fn drives(options: &Options) -> usize {
        options.joints().count()
    }

    fn v_max_rad_s(_: &Options, _: JointIndex) -> Option<f32> {
        Some(f32::MAX)
    }

    fn begin(group: &mut Cia402, now: Instant, settings: &Settings) -> Option<(Duration, bool)> {
        let period = settings.cycle_period();
        let half = Duration::from_micros(period.as_micros() / 2);
        if !group.own.is_half {
            // A period that came late is not made up for.
            let is_first = group.own.sync_due == Instant::ZERO;
            let is_late = is_first || now.saturating_since(group.due) >= half;
            group.own.sync_due = if is_late { now } else { group.due };
            (group.own.is_half, group.due) = (true, group.own.sync_due + half);
            group.synchronize(now, settings);
            return None;
        }
        let late = now.saturating_since(group.due);
        let overrun = !group.have_answered(settings) || late >= half;
        // A SYNC that is due already waits until the set points of this step are sent.
        let next = group.own.sync_due + period;
        (group.own.is_half, group.due) = (false, if next > now { next } else { now + half });
        Some((late, overrun))
    }

    fn take_frame(group: &mut Cia402, now: Instant, settings: &Settings, frame: &Frame) {
        let of = |node: NodeId| {
            group.options.joint_of(node).filter(|joint| settings.joints().any(|j| j == *joint))
        };
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
            if group.is_own(frame) {
                group.count_foreign();
            }
            return;
        };
        group.counters.bits = group.counters.bits.wrapping_add(frame.nominal_bits());
        match function {
            Function::Tpdo(..) => group.take_process_data(now, settings, joint, frame),
            Function::SdoFromNode(_) => {
                let transfer = group.drives.at_mut(joint).transfer.as_mut();
                if let Some(next) = transfer.and_then(|transfer| transfer.handle_frame(now, frame)) {
                    group.send(next);
                }
                group.proceed_transfer(now, settings, joint);
            }
            Function::Emergency(_) => {
                if let Some((_, emergency)) = Emergency::decode(frame) {
                    group.take_emergency(joint, &emergency);
                }
            }
            Function::Heartbeat(_) => {
                if let Some((_, state)) = nmt::State::decode(frame) {
                    group.take_heartbeat(now, joint, state);
                }
            }
            _ => {}
        }
    }

    fn watch(group: &mut Cia402, now: Instant, settings: &Settings) {
        for joint in settings.joints() {
            let drive = group.drives.at(joint);
            if drive.is_held() && now.saturating_since(drive.heard_at) > HEARTBEAT * BEATS_MAX {
                group.report_once(joint, Cause::DriveSilent);
            }
            group.proceed_transfers(now, settings, joint);
        }
    }

    fn find(group: &mut Cia402, now: Instant, settings: &Settings) {
        settings.joints().for_each(|joint| group.drives.at_mut(joint).is_reported = false);
        let is_sound = |joint| group.drives.at(joint).is_sound(settings.reply_missed_max);
        if !settings.joints().all(is_sound) {
            group.own.is_synchronous = false;
            settings.joints().for_each(|joint| group.drives.at_mut(joint).forget(now));
        }
    }

    fn search(group: &mut Cia402, now: Instant, settings: &Settings) {
        group.proceed_search(now, settings);
    }

    fn send_period(group: &mut Cia402, now: Instant, settings: &Settings) {
        if !group.own.is_synchronous {
            return;
        }
        group.lead_all(settings);
        for joint in settings.joints() {
            let Some(frame) = group.data_to(settings, joint) else { continue };
            if group.drives.at(joint).is_held() {
                group.count_motion();
            }
            group.send(frame);
        }
        // Again in each period: a frame may be lost.
        if let Some(frame) = group.data_to_gripper() {
            group.send(frame);
        }
        // After the set points: its id has a lower priority than every frame of the host link, and a link may keep the order of frames.
        group.beat(now, settings);
    }

    fn begin_homing(group: &mut Cia402, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        let is_here = group.options.servo(joint).is_some_and(|servo| servo.home == Home::Here);
        let begins = is_here && group.drives.at(joint).is_ready();
        if begins {
            group.drives.at_mut(joint).go_to(now, Step::Homing(0));
            group.ask(now, settings, joint);
        }
        begins
    }

    fn home(group: &mut Cia402, settings: &Settings, joint: JointIndex) -> bool {
        group.drives.at_mut(joint).home(settings.joint.at(joint))
    }

    fn cause(group: &Cia402, _: Instant, joint: JointIndex) -> Option<Cause> {
        group.drives.at(joint).cause()
    }

    fn state(group: &Cia402, joint: JointIndex) -> (Option<u32>, bool) {
        let drive = group.drives.at(joint);
        // The emergency code above the status word.
        let state = drive.status.map(|status| u32::from(drive.emergency) << 16 | u32::from(status.0));
        (state, drive.cause().is_some())
    }

    fn acts_at(group: &Cia402, _: JointIndex) -> Instant {
        // With the next SYNC.
        group.due + SYNC_FRAME
    }

    fn has_asked(group: &Cia402) -> bool {
        // From the control step on the set points come, then the SYNC: what is queued before them delays it.
        group.own.is_half
    }

    fn has_gripper(group: &Cia402, settings: &Settings) -> bool {
        group.options.gripper().is_some_and(|gripper| settings.joints().any(|own| own == gripper.joint))
    }

    fn gripper_frame(group: &mut Cia402, _: &Settings) -> Option<Frame> {
        group.data_to_gripper()
    }
}
