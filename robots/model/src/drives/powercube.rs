//! `[joint.drive]`: modules of a PowerCube.

use toml_reader::Value;

use super::reading::{Taken, of_joints};
use super::{Common, Drives, Tables};
use crate::error::{LoadError, Problem};
use crate::model::RobotModel;

/// The modules of an arm, base first.
#[derive(Debug, Clone)]
pub struct PowerCubes(pub Vec<Drive>);

impl PowerCubes {
    pub(super) fn with_common(drives: Vec<Drive>) -> (Self, Common) {
        let addresses = drives.iter().map(|drive| drive.address).collect();
        (Self(drives), Common { addresses, ..Common::default() })
    }
}

/// The drive module behind a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// Module type as printed on it.
    pub module: String,
    /// Address on the bus, 1 to 31.
    pub address: u8,
    /// Firmware version as the module reports it, for example 0x4614.
    pub firmware: u16,
    /// Motor turns per joint turn.
    pub gear_ratio: f64,
    /// Encoder slots per motor turn.
    pub encoder_slots: u32,
    /// Largest current of the module in A.
    pub current_max_a: f64,
    /// K_B of eq. (9): current per joint speed, A·s/rad.
    pub k_b_a_s_rad: f64,
    /// K_M of eq. (9): current per joint torque, A/(N·m).
    pub k_m_a_nm: f64,
}

impl Drive {
    /// Type of a module that is not described, and name of its supply.
    pub const GENERIC: &str = "generic";
}

impl RobotModel {
    /// The drive modules, if the robot file describes them (for all joints or for no joint).
    #[must_use]
    pub fn drives(&self) -> Option<&[Drive]> {
        if let Some(Drives::PowerCubes(PowerCubes(drives))) = self.moved_by() { Some(drives) } else { None }
    }

    /// True if the drives are computed from speed and torque of the joints (`[generic_drives]`): the file describes no real
    /// drives.
    #[must_use]
    pub fn drives_are_assumed(&self) -> bool {
        self.drives().is_some_and(|drives| drives.iter().all(|drive| drive.module == Drive::GENERIC))
    }
}

pub(super) fn read(tables: &Tables<'_>) -> Result<Option<(PowerCubes, Common)>, LoadError> {
    let mut addresses = Taken::default();
    let drives = of_joints(("drive", "drive"), tables, |part, _, joint| {
        let address = part.required("address", |v| v.integer(1..=31))? as u8;
        let problem = |owner| Problem::NumberTaken { what: format!("bus address {address}"), owner };
        addresses.take((part, "address"), address.into(), &joint.name, problem)?;
        Ok(Drive {
            module: part.required("module", Value::text)?.to_owned(),
            address,
            firmware: part.required("firmware", |v| v.integer(0..=0xFFFF))? as u16,
            gear_ratio: part.required("gear_ratio", Value::positive)?,
            encoder_slots: part.required("encoder_slots", |v| v.integer(1..=0xFF_FFFF))? as u32,
            current_max_a: part.required("current_max_a", Value::positive)?,
            k_b_a_s_rad: part.required("k_b_a_s_rad", Value::non_negative)?,
            k_m_a_nm: part.required("k_m_a_nm", Value::non_negative)?,
        })
    })?;
    Ok(drives.map(PowerCubes::with_common))
}
