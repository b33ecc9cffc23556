//! `[joint.mit]` and `[gripper.mit]`: Damiao motors that take MIT frames.

use mit_protocol::{DATA_RATES, KD_MAX_NM_S_RAD, KP_MAX_NM_RAD, MOTORS, MotorId, MotorType, REGISTER_ID};
use protocol::StandardId;
use toml_reader::Value;

use super::Section;
use crate::error::{LoadError, Problem};
use crate::mit::{MitGripper, MitMotor, MitMotors};
use crate::model::Joint;
use crate::travel::FingerTravel;

/// Ids in use: which, and by what.
#[derive(Default)]
struct Ids(Vec<(u16, String)>);

impl Ids {
    fn take(&mut self, section: &Section<'_>, key: &str, id: u16, owner: &str) -> Result<(), LoadError> {
        if let Some((_, first)) = self.0.iter().find(|(taken, _)| *taken == id) {
            return Err(section.error(key, Problem::DuplicateMitId { id, owner: first.clone() }));
        }
        self.0.push((id, owner.to_owned()));
        Ok(())
    }
}

/// The motors of all joints, or of no joint.
pub(super) fn read(
    sections: &[Section<'_>],
    gripper: &Section<'_>,
    joints: &[Joint],
    bus: Option<&Section<'_>>,
) -> Result<Option<MitMotors>, LoadError> {
    let (mut ids, mut motors, mut bare) = (Ids::default(), Vec::new(), None);
    for (section, joint) in sections.iter().zip(joints) {
        match section.optional("mit", Value::section)? {
            Some(part) => {
                let motor = read_motor(&part, &joint.name, &mut ids)?;
                require_range(section, joint, &motor.motor)?;
                part.finish()?;
                motors.push(motor);
            }
            None => bare = bare.or(Some((section, joint))),
        }
    }
    let gripper_part = gripper.optional("mit", Value::section)?;
    match (bare, gripper_part) {
        (Some((section, joint)), _) if !motors.is_empty() => {
            Err(section.error("mit", Problem::FamilyMissing { what: "MIT motor", joint: joint.name.clone() }))
        }
        (Some(_), Some(_)) => Err(gripper.error("mit", Problem::GripperAlone("MIT motor"))),
        (Some(_), None) => match bus {
            Some(bus) => Err(bus.error("data_bit_rate_bit_s", Problem::FdWithoutMit)),
            None => Ok(None),
        },
        (None, part) => {
            let gripper = part.map(|part| read_gripper(&part, &mut ids)).transpose()?;
            let data_bit_rate_bit_s = bus.map(read_data_rate).transpose()?;
            Ok(Some(MitMotors { joints: motors, gripper, data_bit_rate_bit_s }))
        }
    }
}

fn read_data_rate(bus: &Section<'_>) -> Result<u32, LoadError> {
    let rate = bus.required("data_bit_rate_bit_s", |value| {
        let rate = value.integer(0..=i64::from(u32::MAX))?;
        DATA_RATES
            .map(|(_, bit_s)| bit_s)
            .into_iter()
            .find(|bit_s| i64::from(*bit_s) == rate)
            .ok_or_else(|| value.error(Problem::DataRate { bit_s: rate }))
    })?;
    bus.finish()?;
    Ok(rate)
}

fn read_motor(part: &Section<'_>, owner: &str, ids: &mut Ids) -> Result<MitMotor, LoadError> {
    let words = MOTORS.map(|motor| (motor.name, motor));
    let motor = part.required("motor", |v| v.word(&words))?;
    let id = part.required("id", |v| {
        let number = v.integer(1..=0x7F)?;
        u8::try_from(number).ok().and_then(MotorId::new).ok_or_else(|| v.wrong_type("the id of a motor"))
    })?;
    let answers_on = part.required("answers_on", |v| {
        let number = v.integer(1..=i64::from(REGISTER_ID) - 1)?;
        u16::try_from(number)
            .ok()
            .and_then(|id| StandardId::new(id).ok())
            .ok_or_else(|| v.wrong_type("an 11-bit id"))
    })?;
    ids.take(part, "id", u16::from(id.get()), owner)?;
    ids.take(part, "answers_on", answers_on.get(), owner)?;
    Ok(MitMotor {
        motor,
        id,
        answers_on,
        kp_nm_rad: part.required("kp_nm_rad", |v| v.number_in(0.0, f64::from(KP_MAX_NM_RAD)))?,
        kd_nm_s_rad: part.required("kd_nm_s_rad", |v| v.number_in(0.0, f64::from(KD_MAX_NM_S_RAD)))?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
    })
}

fn read_gripper(part: &Section<'_>, ids: &mut Ids) -> Result<MitGripper, LoadError> {
    let motor = read_motor(part, "gripper", ids)?;
    let p_max_deg = f64::from(motor.motor.ranges.p_max_rad()).to_degrees();
    let angle = |key| part.required(key, |v| v.number_in(-p_max_deg, p_max_deg)).map(f64::to_radians);
    let travel = FingerTravel { open_rad: angle("open_deg")?, closed_rad: angle("closed_deg")? };
    if travel.open_rad == travel.closed_rad {
        return Err(part.error("open_deg", Problem::GripperStill));
    }
    part.finish()?;
    Ok(MitGripper { motor, travel })
}

/// The limits of the joint must fit into the fields of the frames: a larger value is clipped, and nothing on the wire shows it.
fn require_range(section: &Section<'_>, joint: &Joint, motor: &MotorType) -> Result<(), LoadError> {
    let (limits, ranges) = (&joint.limits, &motor.ranges);
    let turned_rad = limits.q_min_rad.abs().max(limits.q_max_rad.abs());
    let rows = [
        ("range_deg", turned_rad.to_degrees(), f64::from(ranges.p_max_rad()).to_degrees()),
        ("velocity_max_deg_s", limits.v_max_rad_s.to_degrees(), f64::from(ranges.v_max_rad_s()).to_degrees()),
        ("torque_max_nm", limits.torque_max_nm.unwrap_or(0.0), f64::from(ranges.t_max_nm())),
    ];
    match rows.into_iter().find(|(_, value, max)| value > max) {
        Some((key, value, max)) => {
            Err(section.error(key, Problem::BeyondMitRange { value, max, motor: motor.name }))
        }
        None => Ok(()),
    }
}
