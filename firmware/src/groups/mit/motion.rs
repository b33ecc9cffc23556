//! What the set points do in a mode, and the commands of a period.

use mit_protocol::{Command, Mit as SetPoint};
use protocol::{Frame, Instant, JointIndex};

use super::dynamics::Motion;
use super::finding::{Ask, Step};
use super::{Mit, Motor};
use crate::joints::{PerJoint, clamp};
use crate::reach::{self, SoftLimits};
use crate::settings::{JointSettings, Settings};

/// A jog is ordered to where its speed leads in this time, s: beyond every range.
const JOG_WAY_S: f32 = 1e3;

/// Share of a range: a zero that is less by it is rounded down. No field has a zero; half a step of the velocity of an 8009 is 55 mN·m with a
/// gain of 5. So zeros are rounded up and down in turn.
const BELOW_ZERO: f32 = 1e-6;

/// What the set points do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) enum Mode {
    /// With a reset faults are cleared.
    Finding {
        reset: bool,
    },
    #[default]
    Standing,
    Jogging {
        joint: JointIndex,
        qd_rad_s: f32,
        until: Instant,
        released: bool,
    },
    Tracking,
    /// Joints that have an end position go there.
    Moving,
    Braking,
    /// Brakes, and refuses motion.
    Halted,
}

impl Mit {
    /// The set point of a joint for this period, unless the law gave it.
    fn lead(&mut self, settings: &Settings, joint: JointIndex) {
        let (dt_s, limits) = (settings.cycle_period_s(), settings.joint.at(joint));
        let (end_rad, braking_rad_s2) = (self.end_rad.get(joint), self.braking_rad_s2(limits));
        let drive = self.drives.at_mut(joint);
        let is_given = core::mem::take(&mut drive.is_given);
        let set = &mut drive.set;
        match self.mode {
            Mode::Tracking if is_given => {}
            Mode::Moving if let Some(end_rad) = end_rad => {
                set.approach(end_rad + drive.load_rad, limits.jog_v_rad_s, limits.jog_a_rad_s2, dt_s);
            }
            Mode::Jogging { joint: at_work, qd_rad_s, released: false, .. } if at_work == joint => {
                // From the measured position: the load must not lead the joint beyond a limit.
                let q_rad = drive.sample.map_or(set.q_rad, |sample| sample.q_rad);
                let soft = SoftLimits::kept(limits, drive.is_homed);
                let way_rad = reach::reachable(q_rad, soft, q_rad + JOG_WAY_S * qd_rad_s) - q_rad;
                let v_max = clamp(qd_rad_s.abs(), 0.0, limits.jog_v_rad_s);
                set.approach(set.q_rad + way_rad, v_max, limits.jog_a_rad_s2, dt_s);
            }
            _ => set.drive(0.0, braking_rad_s2, dt_s),
        }
    }

    /// Acceleration with which a joint brakes: slow motions end slowly.
    pub(super) const fn braking_rad_s2(&self, limits: &JointSettings) -> f32 {
        match self.mode {
            Mode::Moving | Mode::Jogging { .. } => limits.jog_a_rad_s2,
            _ => limits.a_max_rad_s2,
        }
    }

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
        let (is_finding, abandoned, is_odd) = (self.is_finding(), self.abandoned, self.is_odd);
        let drive = self.drives.at_mut(joint);
        drive.asked = None;
        if drive.is_held() && is_gripper {
            return self.finger_command(joint, &motor);
        }
        if drive.is_held() {
            let (p_rad, v_rad_s, t_nm) = drive.for_motor(limits);
            let Motor { ranges, kp_nm_rad, kd_nm_s_rad, .. } = motor;
            let below = if is_odd { -BELOW_ZERO } else { 0.0 };
            let (v_rad_s, t_nm) = (v_rad_s + below * ranges.v_max_rad_s(), t_nm + below * ranges.t_max_nm());
            let command = SetPoint { p_rad, v_rad_s, kp_nm_rad, kd_nm_s_rad, t_nm };
            if matches!(self.mode, Mode::Tracking | Mode::Moving | Mode::Jogging { .. }) {
                self.counters.motions = self.counters.motions.saturating_add(1);
            }
            return encode(Command::Mit(command), &motor);
        }
        drive.set.v_rad_s = 0.0;
        let may_ask = if drive.step == Step::Off { !abandoned } else { is_finding };
        if !may_ask {
            return None;
        }
        drive.looked_since.get_or_insert(now);
        match drive.step.ask(&motor, settings)? {
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
            if self.drives.at(joint).is_held() {
                self.lead(settings, joint);
            }
            let drive = self.drives.at_mut(joint);
            let at = if drive.is_held() {
                drive.keep_near(now, settings.joint.at(joint), settings.cycle_period());
                let qdd_rad_s2 = drive.send_set_point(settings.cycle_period_s());
                Motion { q_rad: drive.set.q_rad, qd_rad_s: drive.set.v_rad_s, qdd_rad_s2 }
            } else {
                Motion { q_rad: drive.sample.map_or(0.0, |sample| sample.q_rad), ..Motion::default() }
            };
            motion.set(joint, at);
        }
        let Some(torques) = self.options.model().map(|model| model.torques_nm(&motion)) else { return };
        for joint in settings.joints() {
            let t_nm = torques.get(joint);
            self.drives.at_mut(joint).ahead_nm = if t_nm.is_finite() { t_nm } else { 0.0 };
        }
    }

    /// The command of the fingers: where they were ordered to, or where they were found.
    pub(super) fn finger_command(&mut self, place: JointIndex, motor: &Motor) -> Option<Frame> {
        let (_, gripper) = self.options.gripper()?;
        let set = &mut self.drives.at_mut(place).set;
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
            (drive.awaited, drive.place) = (true, place);
            self.counters.bits = self.counters.bits.wrapping_add(frame.nominal_bits());
            // There is room for one frame per motor.
            let _ = self.out.push_back(frame);
        }
    }
}

fn encode(command: Command, motor: &Motor) -> Option<Frame> {
    command.encode(motor.id, &motor.ranges).ok().map(|(frame, _)| frame)
}
