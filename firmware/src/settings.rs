//! Everything that can be set, as plain numbers with units in their names. [`crate::registers`] gives access by
//! name and checks ranges; [`Settings::check`] checks the conditions between values.

use protocol::{Duration, JointIndex, ModuleId};

use crate::feedback::{Gains, Weights};
use crate::joints::PerJoint;
use crate::registers::{FamilyRegisters, FamilySettings, family};

/// Settings of one joint. Positions are of the joint: q_joint = ±q_drive + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSettings {
    /// Address of the drive, 1..=31.
    pub address: u32,
    /// Joint turns against the drive.
    pub inverted: bool,
    /// Position of the joint where the drive reads zero, rad.
    pub offset_rad: f32,
    /// Lower soft limit, rad.
    pub q_min_rad: f32,
    /// Upper soft limit, rad.
    pub q_max_rad: f32,
    /// Highest speed, commanded and measured, rad/s.
    pub v_max_rad_s: f32,
    /// Highest commanded acceleration, rad/s² (paper 002, eq. 11).
    pub a_max_rad_s2: f32,
    /// Largest following error, rad.
    pub error_max_rad: f32,
    /// Largest distance from the start of a plan at which it may start, rad.
    pub start_tolerance_rad: f32,
    /// Largest current, A.
    pub current_max_a: f32,
    /// Speed of jogging, rad/s.
    pub jog_v_rad_s: f32,
    /// Acceleration of jogging, rad/s².
    pub jog_a_rad_s2: f32,
    /// Feedback, 1/s².
    pub k_error_1_s2: f32,
    /// Feedback, 1/s.
    pub k_rate_1_s: f32,
    /// Feedback, without unit.
    pub k_last: f32,
}

impl JointSettings {
    /// Feedback row.
    pub const fn gains(&self) -> Gains {
        Gains { k_error_1_s2: self.k_error_1_s2, k_rate_1_s: self.k_rate_1_s, k_last: self.k_last }
    }

    /// Joint side position from the drive's.
    pub const fn to_joint_rad(&self, q_drive_rad: f32) -> f32 {
        (if self.inverted { -q_drive_rad } else { q_drive_rad }) + self.offset_rad
    }

    /// Drive side position from the joint's.
    pub const fn to_drive_rad(&self, q_joint_rad: f32) -> f32 {
        let q = q_joint_rad - self.offset_rad;
        if self.inverted { -q } else { q }
    }

    /// Whether a position is within the soft limits.
    pub const fn holds(&self, q_rad: f32) -> bool {
        q_rad >= self.q_min_rad && q_rad <= self.q_max_rad
    }

    /// The drive's address; address 1 for a value that [`Settings::check`] refuses.
    pub fn module(&self) -> ModuleId {
        u8::try_from(self.address).ok().and_then(|a| ModuleId::new(a).ok()).unwrap_or(ModuleId::MIN)
    }
}

/// Settings of the group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Joints in use, 1..=8.
    pub joints: u32,
    /// CRC-32 of the robot file that the plans must be for; 0 accepts any.
    pub robot_crc32: u32,
    /// Control period, µs.
    pub cycle_period_us: u32,
    /// Period of reading the drives while nothing moves, µs.
    pub monitor_period_us: u32,
    /// Late cycles in a row that stop the group.
    ///
    /// Frames of a host fill the gaps of a cycle, and in each of these cycles the last answer may wait for one of
    /// them, 0.13 ms. A transfer of eight frames makes up to two cycles late at 3 ms, and up to three together with
    /// the controller's own messages. A limit of five leaves room for two more. A period that is too short for the
    /// drives makes every cycle late.
    pub cycle_late_max: u32,
    /// A motion stops when the host's heartbeat is older than this, µs.
    pub host_timeout_us: u32,
    /// A reply that takes longer counts as missed, µs.
    pub reply_deadline_us: u32,
    /// Missed replies in a row that stop the group.
    pub reply_missed_max: u32,
    /// Time from a drive's measurement to the end of its reply, µs.
    pub reply_age_us: u32,
    /// How far a drive's position is behind its ramp generator, µs: 2ζ/ω of its position loop.
    pub drive_lag_us: u32,
    /// Let the watchdogs expire once at start-up and check that they stop the drives.
    pub watchdog_prove: bool,
    /// Time between signs of life to the drives, µs.
    pub watchdog_refresh_us: u32,
    /// Time after which the drives' watchdogs expire, µs.
    pub watchdog_timeout_us: u32,
    /// Period the gains were designed for, µs.
    pub gains_period_us: u32,
    /// Smallest delay from measurement to action that the gains were designed for, µs.
    pub gains_delay_min_us: u32,
    /// Largest such delay, µs. The loop acts one control period after it measures.
    pub gains_delay_max_us: u32,
    /// CRC-32 of the robot file the gains were designed for.
    pub gains_robot_crc32: u32,
    /// [`certificate_crc32`](crate::registers::certificate_crc32) of the settings that the gains were proven for;
    /// 0: not proven. With a different checksum the group cannot be armed.
    pub gains_certificate_crc32: u32,
    /// CRC-32 of the robot file that the limits come from: they are the widest that may be set without an unlock.
    pub limits_robot_crc32: u32,
    /// Weight of a measurement on the error.
    pub estimator_alpha: f32,
    /// Weight of a measurement on the rate of the error.
    pub estimator_beta: f32,
    /// Share of the acceleration that a stop along the path may use.
    pub stop_share: f32,
    /// A stop along the path that takes longer becomes a quick stop, µs.
    pub stop_path_max_us: u32,
    /// Output on means closed.
    pub gripper_inverted: bool,
    /// Time from switching the output to the ball being free, µs.
    pub gripper_opening_us: u32,
    /// Time between telemetry samples, µs.
    pub telemetry_period_us: u32,
    /// Longest homing of one joint, µs.
    pub home_timeout_us: u32,
    /// Node-ID on the host link, 0..=127.
    pub node_id: u32,
    /// Subject of the stop message.
    pub stop_subject: u32,
    /// Subject of the group state.
    pub group_state_subject: u32,
    /// Subject of the joint state.
    pub joint_state_subject: u32,
    /// Subject of new end states.
    pub target_subject: u32,
    /// Subject of the answers to new end states.
    pub target_answer_subject: u32,
    /// Per joint.
    pub joint: PerJoint<JointSettings>,
    /// What only this family of drives has.
    pub family: FamilySettings,
}

/// Checksum of the robot file `powercube6`, as `host` computes it.
const POWERCUBE6_CRC32: u32 = 0x5FBA_17F9;

impl Settings {
    /// [`Self::powercube6`] as a constant, computed by the compiler and not by code on a board.
    pub const POWERCUBE6: Self = Self::powercube6();
    /// Settings of a controller whose defaults fail [`Self::check`].
    pub const BUILT_IN: Self = Self::POWERCUBE6;

    /// The PowerCube arm (`powercube6`), gains of the certified saturated design at 3 ms.
    ///
    /// Gains and certificate: `host/tuner/gains/powercube6-3ms.toml`, made by `host/tuner/gains/make`. Its initial
    /// errors are the start tolerance here: a plan does not start from farther away.
    /// Speeds, accelerations and currents: paper 002, table II and eq. (11). Following error,
    /// tolerance and slow speeds are chosen.
    pub const fn powercube6() -> Self {
        // Degrees of the tables, as written there.
        const fn joint(
            address: u32,
            q_deg: (f32, f32),
            v_deg_s: f32,
            a_rad_s2: f32,
            current_a: f32,
            gains: (f32, f32, f32),
        ) -> JointSettings {
            const RAD: f32 = core::f32::consts::PI / 180.0;
            JointSettings {
                address,
                inverted: false,
                offset_rad: 0.0,
                q_min_rad: q_deg.0 * RAD,
                q_max_rad: q_deg.1 * RAD,
                v_max_rad_s: v_deg_s * RAD,
                a_max_rad_s2: a_rad_s2,
                error_max_rad: 0.25,
                start_tolerance_rad: 0.02,
                current_max_a: current_a,
                jog_v_rad_s: 0.25,
                jog_a_rad_s2: 1.0,
                k_error_1_s2: gains.0,
                k_rate_1_s: gains.1,
                k_last: gains.2,
            }
        }
        const PR: (f32, f32, f32) = (-314.848_14, -27.242_262, -0.198_569_52);
        const PW_1: (f32, f32, f32) = (-513.861_8, -35.654_125, -0.256_924_57);
        const PW_2: (f32, f32, f32) = (-656.476_14, -40.876_137, -0.292_596_58);
        let j1 = joint(1, (-180.0, 180.0), 149.0, 10.4, 30.0, PR);
        let j2 = joint(2, (-240.0, 60.0), 149.0, 10.4, 30.0, PR);
        let j3 = joint(3, (-230.0, 50.0), 149.0, 10.4, 30.0, PR);
        let j4 = joint(4, (-180.0, 180.0), 149.0, 10.4, 15.0, PR);
        let j5 = joint(5, (-115.0, 115.0), 248.0, 16.6, 15.0, PW_1);
        let j6 = joint(6, (-180.0, 180.0), 320.0, 22.3, 15.0, PW_2);
        let j7 = joint(7, (-180.0, 180.0), 149.0, 10.4, 15.0, PR);
        let j8 = joint(8, (-180.0, 180.0), 149.0, 10.4, 15.0, PR);
        Self {
            joints: 6,
            robot_crc32: 0,
            cycle_period_us: 3_000,
            monitor_period_us: 10_000,
            cycle_late_max: 5,
            host_timeout_us: 100_000,
            reply_deadline_us: 2_000,
            reply_missed_max: 2,
            reply_age_us: 130,
            drive_lag_us: 5_000,
            watchdog_prove: true,
            watchdog_refresh_us: 20_000,
            watchdog_timeout_us: 50_000,
            gains_period_us: 3_000,
            gains_delay_min_us: 2_250,
            gains_delay_max_us: 3_000,
            gains_robot_crc32: POWERCUBE6_CRC32,
            gains_certificate_crc32: 0xC812_30AB,
            limits_robot_crc32: POWERCUBE6_CRC32,
            estimator_alpha: 0.6,
            estimator_beta: 0.2,
            stop_share: 0.9,
            stop_path_max_us: 1_000_000,
            gripper_inverted: false,
            gripper_opening_us: 20_000,
            telemetry_period_us: 100_000,
            home_timeout_us: 15_000_000,
            node_id: 10,
            stop_subject: 1000,
            group_state_subject: 1001,
            joint_state_subject: 1002,
            target_subject: 1003,
            target_answer_subject: 1004,
            joint: PerJoint([j1, j2, j3, j4, j5, j6, j7, j8]),
            family: FamilySettings::of(&family::NONE),
        }
    }

    /// The same arm at the paper's period of 17 ms; the estimator weights are one.
    ///
    /// The paper does not print its gains. These are the certified saturated design for the period,
    /// `host/tuner/gains/powercube6-17ms.toml`.
    pub const fn powercube6_paper() -> Self {
        let mut settings = Self::powercube6();
        settings.cycle_period_us = 17_000;
        settings.gains_period_us = 17_000;
        (settings.gains_delay_min_us, settings.gains_delay_max_us) = (15_000, 17_000);
        settings.gains_certificate_crc32 = 0xECA8_6A82;
        settings.reply_deadline_us = 6_000;
        settings.estimator_alpha = 1.0;
        settings.estimator_beta = 1.0;
        let PerJoint([a, b, c, d, e, f, g, h]) = &mut settings.joint;
        let joints = [a, b, c, d, e, f, g, h];
        const PR: (f32, f32, f32) = (-294.525_6, -30.211_485, -0.569_498_3);
        const GAINS: [(f32, f32, f32); 8] = [
            PR,
            PR,
            PR,
            PR,
            (-480.693_5, -45.174_12, -0.842_663_65),
            (-614.102_5, -52.545_9, -0.968_054_3),
            PR,
            PR,
        ];
        let mut i = 0;
        while i < joints.len() {
            // Const evaluation: an index out of range would not compile.
            #[allow(clippy::indexing_slicing)]
            let (joint, gains) = (&mut *joints[i], GAINS[i]);
            (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = gains;
            i += 1;
        }
        settings
    }

    /// Makes them settings for drives of the family with these registers: its defaults, unless they are for it already.
    pub fn take_family(&mut self, list: &'static FamilyRegisters) {
        if !self.family.is_of(list) {
            self.family = FamilySettings::of(list);
        }
    }

    /// Joints in use, base first.
    pub fn joints(&self) -> impl DoubleEndedIterator<Item = JointIndex> + Clone + use<> {
        JointIndex::first(self.joints as usize)
    }

    /// Joint of a drive's address.
    pub fn joint_of(&self, module: ModuleId) -> Option<JointIndex> {
        self.joints().find(|&joint| self.joint.at(joint).address == u32::from(module.get()))
    }

    /// Control period.
    pub const fn cycle_period(&self) -> Duration {
        Duration::from_micros(self.cycle_period_us as u64)
    }

    /// Control period, s.
    pub const fn cycle_period_s(&self) -> f32 {
        self.cycle_period_us as f32 * 1e-6
    }

    /// Weights of the estimator.
    pub const fn weights(&self) -> Weights {
        Weights { alpha: self.estimator_alpha, beta: self.estimator_beta }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Cause;

    #[test]
    fn built_in_settings_pass_their_own_check() {
        assert_eq!(Settings::powercube6().check(), Ok(()));
        assert_eq!(Settings::powercube6_paper().check(), Ok(()));
        for settings in [Settings::powercube6(), Settings::powercube6_paper()] {
            let crc32 = crate::registers::certificate_crc32(&settings);
            assert_eq!(format!("{:08x}", settings.gains_certificate_crc32), format!("{crc32:08x}"));
        }
    }

    #[test]
    fn built_in_gains_of_every_joint_act_against_the_error() {
        for settings in [Settings::powercube6(), Settings::powercube6_paper()] {
            for joint in JointIndex::first(usize::try_from(settings.joints).unwrap()) {
                let JointSettings { k_error_1_s2, k_rate_1_s, k_last, .. } = *settings.joint.at(joint);
                assert!(k_error_1_s2 < 0.0 && k_rate_1_s < 0.0 && k_last < 0.0, "joint {joint}");
            }
        }
    }

    #[test]
    fn limits_out_of_order_lost_numbers_and_shared_addresses_are_refused_with_the_joint() {
        let third = JointIndex::new(2).unwrap();
        let mut settings = Settings::powercube6();
        settings.joint.at_mut(third).q_min_rad = f32::NAN;
        let refused = settings.check().unwrap_err();
        assert_eq!((refused.cause, refused.joint), (Cause::SettingsInvalid, Some(third)));
        let mut settings = Settings::powercube6();
        settings.joint.at_mut(third).address = 1;
        assert_eq!(settings.check().unwrap_err().cause, Cause::DuplicateAddress);
    }

    #[test]
    fn drive_and_joint_side_are_each_others_inverse() {
        let mut joint = *Settings::powercube6().joint.at(JointIndex::new(1).unwrap());
        (joint.inverted, joint.offset_rad) = (true, -1.5);
        assert_eq!(joint.to_joint_rad(0.0), -1.5);
        assert_eq!(joint.to_drive_rad(joint.to_joint_rad(0.25)), 0.25);
        assert!(joint.to_joint_rad(0.25) < joint.to_joint_rad(0.0));
    }
}
