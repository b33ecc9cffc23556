//! The commands of a period.

use protocol::mit::{Command, Mit as SetPoint};
use protocol::{Frame, Instant, JointIndex};

use super::finding::{Ask, Step};
use super::{Mit, Motor};
use crate::groups::dynamics::{Motion, torques_ahead_nm};
use crate::groups::position::Drive as _;
use crate::joints::PerJoint;
use crate::settings::Settings;

/// Share of a range: a zero that is less by it is rounded down. No field has a zero; half a step of the velocity of an 8009 is 55 mN·m with a
/// gain of 5. So zeros are rounded up and down in turn.
const BELOW_ZERO: f32 = 1e-6;

impl Mit {
    /// The command of a joint in this period.
    fn command_of(&mut self, now: Instant, settings: &Settings, joint: JointIndex) -> Option<Frame> {
        let motor = self.motor(settings, joint)?;
        let limits = &self.limits(settings, joint);
        if let Step::Silence { until } = self.drives.at(joint).step {
            if now < until {
                return None;
            }
            self.drives.at_mut(joint).go_to(Step::Expired);
        }
        let is_gripper = self.gripper_place(settings) == Some(joint);
        let fd_rate = self.options.fd_rate();
        let (is_finding, abandoned, is_odd) = (self.leader.is_finding(), self.abandoned, self.is_odd);
        let set = self.leader.joints.at(joint).set;
        let drive = self.drives.at_mut(joint);
        drive.asked = None;
        if drive.is_held() && is_gripper {
            return self.finger_command(joint, &motor);
        }
        if drive.is_held() {
            let (p_rad, v_rad_s, t_nm) = drive.for_motor(limits, set);
            let Motor { ranges, kp_nm_rad, kd_nm_s_rad, .. } = motor;
            let below = if is_odd { -BELOW_ZERO } else { 0.0 };
            let (v_rad_s, t_nm) = (v_rad_s + below * ranges.v_max_rad_s(), t_nm + below * ranges.t_max_nm());
            let command = SetPoint { p_rad, v_rad_s, kp_nm_rad, kd_nm_s_rad, t_nm };
            self.count_motion();
            return encode(Command::Mit(command), &motor);
        }
        self.leader.joints.at_mut(joint).set.v_rad_s = 0.0;
        let may_ask = if drive.step == Step::Off { !abandoned } else { is_finding };
        if !may_ask {
            return None;
        }
        drive.looked_since.get_or_insert(now);
        match drive.step.ask(&motor, settings, fd_rate)? {
            Ask::Register(request) => {
                drive.asked = Some(request);
                Some(request.encode(motor.id))
            }
            Ask::Command(command) => encode(command, &motor),
        }
    }

    /// The set points of this period, and the torques that they need.
    fn lead_all(&mut self, now: Instant, settings: &Settings) {
        let mut motion = PerJoint::default();
        for joint in settings.joints() {
            let drive = self.drives.at_mut(joint);
            let at = if drive.is_held() {
                self.leader.next(settings, joint, now, &mut drive.answers, drive.is_homed, f32::INFINITY)
            } else {
                Motion { q_rad: drive.answers.sample.map_or(0.0, |sample| sample.q_rad), ..Motion::default() }
            };
            motion.set(joint, at);
        }
        let torques = torques_ahead_nm(self.options.model(), &motion);
        settings.joints().for_each(|joint| self.drives.at_mut(joint).ahead_nm = torques.get(joint));
    }

    /// The command of the fingers: where they were ordered to, or where they were found.
    pub(super) fn finger_command(&mut self, place: JointIndex, motor: &Motor) -> Option<Frame> {
        let (_, gripper) = self.options.gripper()?;
        let set = &mut self.leader.joints.at_mut(place).set;
        if let Some(open) = self.gripper_open {
            set.q_rad = if open { gripper.open_rad } else { gripper.closed_rad };
        }
        let Motor { kp_nm_rad, kd_nm_s_rad, .. } = *motor;
        let command = SetPoint { p_rad: set.q_rad, kp_nm_rad, kd_nm_s_rad, ..SetPoint::default() };
        encode(Command::Mit(command), motor)
    }

    /// The commands of a period, in the order of the bus.
    pub(super) fn send_burst(&mut self, now: Instant, settings: &Settings) {
        self.out.clear();
        self.lead_all(now, settings);
        let mut frames = PerJoint::default();
        for joint in self.places(settings) {
            frames.set(joint, self.command_of(now, settings, joint));
        }
        // The place in the burst says when a motor gets its command.
        for place in 1..=self.places(settings).count() as u64 {
            let key = |joint: &JointIndex| frames.get(*joint).map(|frame: Frame| frame.arbitration_key());
            let next = self.places(settings).filter(|joint| key(joint).is_some()).min_by_key(key);
            let Some((joint, frame)) = next.and_then(|joint| Some((joint, frames.get(joint)?))) else {
                break;
            };
            frames.set(joint, None);
            let drive = self.drives.at_mut(joint);
            (drive.answers.awaited, drive.place) = (true, place);
            self.send(frame);
        }
    }
}

fn encode(command: Command, motor: &Motor) -> Option<Frame> {
    command.encode(motor.id, &motor.ranges).ok().map(|(frame, _)| frame)
}
