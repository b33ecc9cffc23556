//! `[generic_drives]`: drives computed from speed and torque of their joints, for an arm whose drives are not described.
//!
//! ```text
//! k_m = v_max / U                              power: τ_max v_max = U I_max; at least 1 A / τ_max
//! k_b = k_m τ_max (1 / efficiency - 1) / v_max  losses, in proportion to the speed
//! I_max = k_m τ_max
//! ```
//!
//! So the current allows a joint its full torque at rest, and at top speed the torque less the losses, never more.
//! One supply feeds all drives.

use toml_reader::Value;

use super::{Common, Drive, Drives, PowerCubes, TABLES, Tables};
use crate::error::{LoadError, Problem};
use crate::load::Section;
use crate::model::{Joint, Supply};
use crate::per_joint::PerJoint;

/// Version of the PowerCube protocol that a generic drive answers with on the simulated bus.
const FIRMWARE: u16 = 0x4614;
/// Least largest current of a drive: a weaker motor takes the place of a smaller one.
const CURRENT_MIN_A: f64 = 1.0;

/// Drives with the addresses 1, 2, … and their supply. Drives, motors or supplies of the file's own are refused beside them.
pub(crate) fn read_generic(
    root: &Section<'_>,
    section: &Section<'_>,
    tables: &Tables<'_>,
) -> Result<((Drives, Common), Supply), LoadError> {
    let mut beside = TABLES.iter().filter(|(key, _)| tables.joints.iter().any(|joint| joint.has(key)));
    let beside = beside.next().map(|(_, table)| *table).or(root.has("supply").then_some("[[supply]]"));
    if let Some(beside) = beside {
        return Err(root.error("generic_drives", Problem::GenericBeside(beside)));
    }
    let joints = tables.described;
    let voltage_v = section.required("voltage_v", |v| v.number_in(1.0, 10_000.0))?;
    let efficiency = section.required("efficiency", |v| v.number_in(0.05, 1.0))?;
    let motor_speed_max_rad_s = section.required("motor_speed_max_rad_s", Value::positive)?;
    let encoder_slots = section.required("encoder_slots", |v| v.integer(1..=0xFF_FFFF))? as u32;
    section.finish()?;
    let drive = |(k, joint): (usize, &Joint)| {
        let (v_max, torque_max_nm) = (joint.limits.v_max_rad_s, joint.limits.torque_max_nm);
        let torque_max_nm = torque_max_nm
            .ok_or_else(|| section.error("voltage_v", Problem::GenericWithoutTorque(joint.name.clone())))?;
        let k_m_a_nm = (v_max / voltage_v).max(CURRENT_MIN_A / torque_max_nm);
        let current_max_a = k_m_a_nm * torque_max_nm;
        let k_b_a_s_rad = current_max_a * (1.0 / efficiency - 1.0) / v_max;
        Ok(Drive {
            module: Drive::GENERIC.to_owned(),
            address: k as u8 + 1,
            firmware: FIRMWARE,
            gear_ratio: motor_speed_max_rad_s / v_max,
            encoder_slots,
            current_max_a,
            k_b_a_s_rad,
            k_m_a_nm,
        })
    };
    let drives: Vec<Drive> = joints.iter().enumerate().map(drive).collect::<Result<_, LoadError>>()?;
    let mut feeds = PerJoint::<bool>::default_of(joints.len());
    feeds.iter_mut().for_each(|fed| *fed = true);
    let current_max_a = drives.iter().map(|drive| drive.current_max_a).sum();
    let (drives, common) = PowerCubes::with_common(drives);
    Ok((
        (Drives::PowerCubes(drives), common),
        Supply { name: Drive::GENERIC.to_owned(), voltage_v, current_max_a, feeds },
    ))
}
