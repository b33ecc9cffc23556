//! How a drive sits on its joint: which way round, and where it reads zero.

use crate::drive::Nameplate;
use crate::mechanics::{AxisInput, AxisState};

/// A drive reads `q_drive`, its joint is at `q = ± q_drive + offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounting {
    /// The joint turns against the drive.
    pub inverted: bool,
    /// Joint angle where the drive reads zero, rad.
    pub offset_rad: f64,
}

impl Mounting {
    const fn turned(self, value: f64) -> f64 {
        if self.inverted { -value } else { value }
    }

    /// Angle of the drive at an angle of its joint, rad.
    pub(super) fn drive_rad(self, joint_rad: f64) -> f64 {
        self.turned(joint_rad - self.offset_rad)
    }

    /// What the drive does to its joint.
    pub(super) fn input(self, drive: AxisInput) -> AxisInput {
        AxisInput {
            reference_rad: self.turned(drive.reference_rad) + self.offset_rad,
            torque_nm: self.turned(drive.torque_nm),
            ..drive
        }
    }

    /// The joint as its drive sees it.
    pub(super) fn axis(self, joint: AxisState) -> AxisState {
        AxisState {
            q_rad: self.drive_rad(joint.q_rad),
            v_rad_s: self.turned(joint.v_rad_s),
            drive_torque_nm: self.turned(joint.drive_torque_nm),
            link_torque_nm: self.turned(joint.link_torque_nm),
            output_torque_nm: self.turned(joint.output_torque_nm),
            ..joint
        }
    }

    /// The nameplate with the range of the joint in angles of the drive.
    pub(super) fn plate(self, joint: Nameplate) -> Nameplate {
        let ends = [joint.q_min_rad, joint.q_max_rad].map(|q_rad| self.drive_rad(q_rad));
        Nameplate {
            q_min_rad: ends[0].min(ends[1]),
            q_max_rad: ends[0].max(ends[1]),
            home_edge_rad: self.drive_rad(joint.home_edge_rad),
            ..joint
        }
    }
}
