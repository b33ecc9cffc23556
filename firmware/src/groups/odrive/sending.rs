//! The frames of a period.

use heapless::Vec;
use protocol::odrive::{Order, Request};
use protocol::{Duration, Frame, Instant, JointIndex};

use super::finding::{Message, Step};
use super::{Axis, FRAMES_MAX, Odrive};
use crate::groups::dynamics::{Motion, torques_ahead_nm};
use crate::groups::position::{Drive as _, Fingers};
use crate::groups::shape::Axis as Set;
use crate::joints::PerJoint;
use crate::settings::Settings;

/// Shortest time of estimates on the bus at 1 Mbit/s.
const ANSWER: Duration = Duration::from_micros(111);

/// Shortest time of a frame on the bus at 1 Mbit/s.
pub(super) fn span_of(frame: &Frame) -> Duration {
    Duration::from_micros(frame.nominal_bits().into())
}

impl Odrive {
    /// The set points of this period, and the torques that they need.
    fn lead_all(&mut self, settings: &Settings) {
        let (mut motion, dt_s) = (PerJoint::default(), settings.cycle_period_s());
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            let at = if drive.is_held() {
                let reached_at = self.at + settings.cycle_period();
                let at = self.leader.next(
                    settings,
                    joint,
                    reached_at,
                    &mut drive.answers,
                    drive.is_homed,
                    f32::INFINITY,
                );
                drive.middle = Set {
                    q_rad: at.q_rad - 0.5 * at.qd_rad_s * dt_s,
                    v_rad_s: at.qd_rad_s - 0.5 * at.qdd_rad_s2 * dt_s,
                };
                at
            } else {
                self.leader.joints.at_mut(joint).set.v_rad_s = 0.0;
                let q_rad = drive.answers.sample.map_or(0.0, |sample| sample.q_rad);
                Motion { q_rad, ..Motion::default() }
            };
            motion.set(joint, at);
        }
        if let Some(place) = self.gripper_place(settings) {
            self.lead_fingers(settings, place);
        }
        let torques = torques_ahead_nm(self.options.model(), &motion);
        settings.joints().for_each(|joint| self.drives.at_mut(joint).ahead_nm = torques.get(joint));
    }

    /// The set point of the fingers: where they were ordered to, or where they were found.
    pub(super) fn lead_fingers(&mut self, settings: &Settings, place: JointIndex) {
        let Some(Fingers { open_rad, closed_rad, .. }) = self.fingers(settings) else { return };
        let drive = self.drives.at_mut(place);
        if let Some(open) = self.gripper_open.filter(|_| drive.is_held()) {
            drive.middle = Set { q_rad: if open { open_rad } else { closed_rad }, v_rad_s: 0.0 };
            drive.answers.sent = drive.middle;
        }
    }

    pub(super) fn frame_of(
        &self,
        settings: &Settings,
        joint: JointIndex,
        axis: Axis,
        message: Message,
    ) -> Option<Frame> {
        let order = match message {
            Message::Request(request) => return Some(request.encode(axis.node)),
            Message::Order(order) => order,
            Message::SetPoint => {
                let (drive, limits) = (self.drives.at(joint), self.limits(settings, joint));
                let (rev, rev_s) = drive.for_axis(axis, &limits);
                let turned_nm = if limits.inverted { -drive.ahead_nm } else { drive.ahead_nm };
                Order::Position { rev, rev_s, nm: turned_nm / axis.gear }
            }
        };
        order.encode(axis.node, axis.version).ok().map(|(frame, _)| frame)
    }

    /// The frames of a period, in the order of the bus.
    pub(super) fn send_burst(&mut self, now: Instant, settings: &Settings) {
        self.out.clear();
        self.lead_all(settings);
        let mut frames: Vec<Option<(Frame, JointIndex)>, FRAMES_MAX> = Vec::new();
        for joint in self.places(settings) {
            let Some(axis) = self.options.axis(joint) else { continue };
            let step = self.drives.at(joint).step;
            let may_ask = match step {
                Step::Held => true,
                Step::Off => !self.abandoned,
                _ => self.leader.is_finding(),
            };
            if !may_ask {
                continue;
            }
            for message in self.ask(now, settings, joint, axis).into_iter().flatten() {
                if message == Message::SetPoint && step == Step::Held {
                    self.count_motion();
                }
                if let Some(frame) = self.frame_of(settings, joint, axis, message) {
                    // There is room for two frames of each axis.
                    let _ = frames.push(Some((frame, joint)));
                }
                self.drives.at_mut(joint).answers.awaited |= message == Message::Request(Request::Estimates);
            }
        }
        self.put_out(&mut frames);
    }

    /// Sends the frames, and notes when each is on the bus.
    fn put_out(&mut self, frames: &mut Vec<Option<(Frame, JointIndex)>, FRAMES_MAX>) {
        // Without the answers of the axes before, and with them.
        let (mut earliest, mut usual) = (Duration::ZERO, Duration::ZERO);
        for _ in 0..FRAMES_MAX {
            let waiting = frames.iter_mut().filter(|frame| frame.is_some());
            let next = waiting.min_by_key(|frame| frame.map(|(frame, _)| frame.arbitration_key()));
            let Some((frame, joint)) = next.and_then(Option::take) else { break };
            let span = span_of(&frame);
            (earliest, usual) = (earliest + span, usual + span);
            let drive = self.drives.at_mut(joint);
            if frame.data().is_empty() {
                drive.asked_after = [earliest, usual];
                usual += ANSWER;
            } else {
                drive.acts_after = usual;
            }
            self.send(frame);
        }
    }
}
