//! ODrives that speak CANSimple (0.5, 0.6) on one CAN bus: the group is the clock; each axis gets one set point and one request per
//! period, and gives one answer.
//!
//! An axis gives `k_v (v + k_p (p - q) - q̇) + t` and holds p, v and t until the next set point. The group leads a set point of each joint
//! from the accelerations of the law. It sends the means over the period, for which they are held: p, v, and as t the torque that the set
//! points need by the [`ArmModel`](super::dynamics::ArmModel). Gains are those of [`Axis`].
//!
//! # Stops
//!
//! [`Command::Halt`](crate::group::Command::Halt) leads each joint to rest along a ramp of its own, beginning with the next period, and then holds it. An axis that
//! reports an error, falls to idle or does not answer gets the order to stop (Estop), from which only a person leads out by clearing the
//! fault. With [`Command::Abandon`](crate::group::Command::Abandon) such an axis gets no frame any more, so its watchdog strikes. If the controller dies, all watchdogs do.
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
mod mismatch;
pub mod options;
mod sending;

use protocol::odrive::{Heartbeat, Order, Report, Version};
use protocol::{Duration, Frame, Id, Instant, JointIndex};

use self::drive::Drive;
use self::finding::{Message, SPEED_ROOM, Step};
pub use self::mismatch::Mismatch;
pub use self::options::{
    Axis, Endpoints, GripperAxis, Home, Options, OptionsError, Parameter, VELOCITY_MAX_REV_S,
};
use super::answers::Worth;
use super::position::{Drive as _, Family, Fingers, PositionDrives};
use crate::fault::Cause;
use crate::group::{GroupEvent, Measured};
use crate::rest::BAND_RAD;
use crate::settings::Settings;

/// Frames of a period: two for each axis.
const FRAMES_MAX: usize = 16;

/// See the [module](self).
pub type Odrive = PositionDrives<Axes>;

/// What the family adds.
#[derive(Debug, Default)]
pub struct Axes;

impl Odrive {
    fn axis_cause(&self, now: Instant, joint: JointIndex) -> Option<Cause> {
        self.options.axis(joint).and_then(|axis| self.drives.at(joint).cause(now, axis.version))
    }

    /// Stops an axis that is lost or does not do what it should, and reports it; each axis once in a search.
    fn watch(&mut self, now: Instant, settings: &Settings, joint: JointIndex) {
        let Some(cause) = self.axis_cause(now, joint) else { return };
        let is_gripper = self.gripper_place(settings) == Some(joint);
        let drive = self.drives.at_mut(joint);
        drive.go_to(now, Step::Off);
        if !core::mem::replace(&mut drive.is_reported, true) {
            self.report(joint, if is_gripper { Cause::GripperUnanswered } else { cause });
        }
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
        match drive.answers.take(frame, q_rad, at, limits, follows, BAND_RAD) {
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
}

impl Family for Axes {
    type Options = Options;
    type Drive = Drive;
    type Mismatch = Mismatch;

    const LEAD_PERIODS: u64 = 2;
    const BRAKE_PERIODS: u64 = 2;
    /// With a position gain of 20 1/s 4 % of the distance are left by then.
    const SETTLING: Duration = Duration::from_millis(160);

    fn drives(options: &Options) -> usize {
        options.all().count()
    }

    fn fingers(options: &Options) -> Option<Fingers> {
        let (place, GripperAxis { axis, open_rad, closed_rad }) = options.gripper()?;
        let v_max_rad_s = axis.to_rad(VELOCITY_MAX_REV_S) / SPEED_ROOM;
        Some(Fingers { place, open_rad: *open_rad, closed_rad: *closed_rad, v_max_rad_s })
    }

    fn v_max_rad_s(options: &Options, joint: JointIndex) -> Option<f32> {
        options.axis(joint).map(|axis| axis.to_rad(VELOCITY_MAX_REV_S))
    }

    fn take_frame(group: &mut Odrive, now: Instant, settings: &Settings, frame: &Frame) {
        let Id::Standard(id) = frame.id() else { return };
        let of = group.options.axis_of(id);
        let Some((joint, axis)) = of.filter(|(place, _)| group.places(settings).any(|own| own == *place))
        else {
            return;
        };
        // Only 0.6 reports its version: also where 0.5 is expected.
        let report = Report::decode(frame, axis.version).or_else(|| {
            let other = Report::decode(frame, Version::V06);
            other.filter(|(_, report)| matches!(report, Report::Version { .. }))
        });
        let report = report.filter(|_| !frame.data().is_empty());
        let Some((_, report)) = report else {
            // Of a request too: somebody else asks or orders.
            if frame.data().is_empty() || Order::decode(frame, axis.version).is_some() {
                group.count_foreign();
            }
            return;
        };
        group.counters.bits = group.counters.bits.wrapping_add(frame.nominal_bits());
        match report {
            Report::Heartbeat(heartbeat) => group.take_heartbeat(now, settings, joint, heartbeat),
            Report::Estimates { rev, .. } => group.take_estimates(now, settings, joint, axis, frame, rev),
            other => group.take_answer(now, settings, joint, &other),
        }
    }

    fn watch(group: &mut Odrive, now: Instant, settings: &Settings) {
        group.places(settings).for_each(|place| group.watch(now, settings, place));
    }

    fn find(group: &mut Odrive, now: Instant, settings: &Settings) {
        for place in group.places(settings) {
            if let Some(axis) = group.options.axis(place) {
                group.drives.at_mut(place).find(now, settings.reply_missed_max, axis.version);
            }
        }
    }

    fn search(group: &mut Odrive, now: Instant, settings: &Settings) {
        for place in group.places(settings) {
            if let Some(axis) = group.options.axis(place).filter(|_| group.leader.is_finding()) {
                group.proceed_search(now, settings, place, axis);
            }
        }
    }

    fn send_period(group: &mut Odrive, now: Instant, settings: &Settings) {
        group.send_burst(now, settings);
    }

    fn home(group: &mut Odrive, settings: &Settings, joint: JointIndex) -> bool {
        let axis = group.options.axis(joint);
        let limits = settings.joint.at(joint);
        let by_rad = axis.and_then(|axis| group.drives.at_mut(joint).home(axis, limits));
        group.leader.joints.at_mut(joint).set.q_rad += by_rad.unwrap_or(0.0);
        by_rad.is_some()
    }

    fn cause(group: &Odrive, now: Instant, joint: JointIndex) -> Option<Cause> {
        group.axis_cause(now, joint)
    }

    fn state(group: &Odrive, joint: JointIndex) -> (Option<u32>, bool) {
        let heartbeat = group.drives.at(joint).heartbeat;
        // Errors, by their bits; their highest byte gives way to the state of the axis.
        let state = heartbeat.map(|beat| beat.error << 8 | u32::from(beat.state.number()));
        (state, heartbeat.is_some_and(|beat| beat.error != 0))
    }

    fn acts_at(group: &Odrive, joint: JointIndex) -> Instant {
        group.at + group.drives.at(joint).acts_after
    }

    fn gripper_frame(group: &mut Odrive, settings: &Settings) -> Option<Frame> {
        let place = group.gripper_place(settings)?;
        group.lead_fingers(settings, place);
        let axis = group.options.axis(place).filter(|_| group.drives.at(place).is_held())?;
        group.frame_of(settings, place, axis, Message::SetPoint)
    }
}
