//! Which drive is which joint, and how it is mounted.

use protocol::ModuleId;
use serde::{Deserialize, Serialize};

use planner::throw::Arm;

/// The drives of the joints, in the order of the robot file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drives {
    /// Address of each joint's drive.
    pub address: Vec<u8>,
    /// The joint turns against the drive.
    pub inverted: Vec<bool>,
    /// Joint angle where the drive reads zero, rad.
    pub offset_rad: Vec<f64>,
}

impl Drives {
    /// Drives of the robot file, mounted so that each reads its joint's angle; `None` if the file has no drives.
    #[must_use]
    pub fn of(arm: &Arm) -> Option<Self> {
        let address = arm.addresses()?;
        Some(Self { address, inverted: vec![false; arm.n()], offset_rad: vec![0.0; arm.n()] })
    }

    #[must_use]
    pub fn joint_of(&self, module: ModuleId) -> Option<usize> {
        self.address.iter().position(|address| *address == module.get())
    }

    /// Angle of a joint whose drive reads `drive_rad`, rad.
    #[must_use]
    pub fn joint_rad(&self, joint: usize, drive_rad: f64) -> f64 {
        self.turned(joint, drive_rad) + self.offset_rad[joint]
    }

    /// A speed or a current of a drive as one of its joint.
    #[must_use]
    pub fn turned(&self, joint: usize, value: f64) -> f64 {
        if self.inverted[joint] { -value } else { value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_that_is_mounted_the_other_way_round_reads_the_joint_turned_and_shifted() {
        let mut drives = Drives {
            address: vec![1, 2, 3, 4, 5, 9],
            inverted: vec![false; 6],
            offset_rad: vec![0.0, 0.0, 0.0, 0.0, 0.0, -1.5],
        };
        drives.inverted[5] = true;
        let joint = drives.joint_of(ModuleId::new(9).unwrap()).unwrap();
        assert_eq!((joint, drives.joint_rad(joint, 0.5), drives.turned(joint, 0.5)), (5, -2.0, -0.5));
        assert_eq!(drives.joint_of(ModuleId::new(6).unwrap()), None);
        assert_eq!(drives.joint_rad(0, 0.5), 0.5);
    }

    #[test]
    fn an_arm_of_each_family_names_the_drive_of_each_joint_and_an_industrial_robot_has_none() {
        let robots = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/");
        for (name, first, joints) in [
            ("powercube6.toml", 1, 6),
            ("openarm7.toml", 1, 7),
            ("canopen6.toml", 3, 6),
            ("odrive6.toml", 9, 6),
        ] {
            let drives = Drives::of(&Arm::load(&format!("{robots}{name}")).unwrap()).unwrap();
            assert_eq!((drives.address.len(), drives.address[0]), (joints, first), "{name}");
        }
        assert_eq!(Drives::of(&Arm::load("kr16_2").unwrap()), None);
    }
}
