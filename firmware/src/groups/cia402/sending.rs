//! What leaves in a period: set points with the torques that they need, and the heartbeat of the controller.

use protocol::canopen::cia402::Control;
use protocol::canopen::{Function, nmt};
use protocol::{Duration, Frame, Id, Instant, JointIndex, StandardId};

use super::finding::Step;
use super::rows;
use super::{Cia402, Options, SYNC_FRAME};
use crate::groups::dynamics::{Motion, torques_ahead_nm};
use crate::groups::position::Drive as _;
use crate::joints::{PerJoint, clamp};
use crate::settings::Settings;

/// Per mille of the rated torque that are fed forward at most.
const TORQUE_MAX: f32 = 3_000.0;
/// Share of a joint's top speed with which a module makes up for lost set points. A shaft that starts from rest overshoots this speed by a fifth.
const CATCH_UP_SHARE: f32 = 0.8;

impl Cia402 {
    /// The set points of this period, and the torques that they need.
    pub(super) fn lead_all(&mut self, settings: &Settings) {
        let mut motion = PerJoint::default();
        // The line to a set point ends two SYNCs after the last one.
        let reached_at = self.at + SYNC_FRAME + settings.cycle_period() * 2;
        for joint in settings.joints() {
            let v_catch_up_rad_s = self.v_catch_up_rad_s(settings, joint);
            let drive = self.drives.at_mut(joint);
            let at = if drive.step == Step::Held {
                self.leader.next(
                    settings,
                    joint,
                    reached_at,
                    &mut drive.answers,
                    drive.is_homed,
                    v_catch_up_rad_s,
                )
            } else {
                let set = self.leader.joints.at(joint).set;
                let qdd_rad_s2 = drive.answers.send(set, settings.cycle_period_s());
                Motion { q_rad: set.q_rad, qd_rad_s: set.v_rad_s, qdd_rad_s2 }
            };
            motion.set(joint, at);
        }
        let torques = torques_ahead_nm(self.options.model(), &motion);
        settings.joints().for_each(|joint| self.drives.at_mut(joint).torque_nm = torques.get(joint));
    }

    /// Largest speed with which a servo may make up for lost set points. A module that interpolates has no limit of speed: it would do so within
    /// one period. If an answer is missing, the set point before it may be lost, too.
    fn v_catch_up_rad_s(&self, settings: &Settings, joint: JointIndex) -> f32 {
        if self.interpolates(joint) {
            CATCH_UP_SHARE * settings.joint.at(joint).v_max_rad_s
        } else {
            f32::INFINITY
        }
    }

    /// Process data to a servo.
    pub(super) fn data_to(&self, settings: &Settings, joint: JointIndex) -> Option<Frame> {
        let servo = self.options.servo(joint)?;
        let map = self.options.to_servo(servo)?;
        let (drive, limits) = (self.drives.at(joint), settings.joint.at(joint));
        if !drive.has_process_data() || drive.answers.sample.is_none() {
            return None;
        }
        let Control(control) = self.control_of(joint);
        let target = servo.to_counts(limits.to_drive_rad(drive.answers.sent.q_rad));
        let turned_nm = if limits.inverted { -drive.torque_nm } else { drive.torque_nm };
        let share = clamp(turned_nm * 1e6 / servo.rated_mnm as f32, -TORQUE_MAX, TORQUE_MAX);
        let torque = if drive.is_held() { libm::roundf(share) as i32 } else { 0 };
        let data = map.pack(&[i32::from(control), target, torque]);
        let id = Id::Standard(StandardId::from_low_bits(Function::Rpdo(1, servo.node).id()));
        Frame::new(id, data.get()).ok()
    }

    /// The order to the gripper, if one was given and its servo takes process data.
    pub(super) fn data_to_gripper(&self) -> Option<Frame> {
        let (gripper, open, map) = (self.options.gripper()?, self.gripper_open?, Options::to_outputs()?);
        let servo =
            self.options.servo(gripper.joint).filter(|_| self.drives.at(gripper.joint).has_process_data())?;
        let data = map.pack(&[if open { gripper.mask() as i32 } else { 0 }]);
        let id = Id::Standard(StandardId::from_low_bits(Function::Rpdo(2, servo.node).id()));
        Frame::new(id, data.get()).ok()
    }

    pub(super) fn beat(&mut self, now: Instant, settings: &Settings) {
        let is_silent = settings.joints().any(|joint| self.drives.at(joint).step == Step::Silence);
        if !self.own.is_synchronous || is_silent || now < self.own.beats_at {
            return;
        }
        let refresh = Duration::from_micros(settings.watchdog_refresh_us.into());
        // Not later than half of what the servos wait.
        let most = Duration::from_micros(rows::time_out(settings).as_micros() / 2);
        self.own.beats_at = now + refresh.min(most);
        if let Some(node) = Self::host_node() {
            self.send(nmt::State::Operational.encode(node));
        }
        if !self.abandoned {
            return;
        }
        for joint in settings.joints() {
            let is_sound = self.drives.at(joint).is_sound(settings.reply_missed_max);
            if let Some(servo) = self.options.servo(joint).filter(|_| !is_sound) {
                self.send(nmt::Command::Stop.encode(Some(servo.node)));
            }
        }
    }
}
