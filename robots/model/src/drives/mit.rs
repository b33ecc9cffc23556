//! `[joint.mit]` and `[gripper.mit]`: Damiao motors that take MIT frames.

use protocol::StandardId;
use protocol::mit::{DATA_RATES, KD_MAX_NM_S_RAD, KP_MAX_NM_RAD, MOTORS, MotorId, MotorType, REGISTER_ID};
use toml_reader::Value;

use super::reading::{Taken, of_joints, require_range, travel};
use super::{Common, Drives, FingerTravel, Tables};
use crate::error::{LoadError, Problem};
use crate::load::Section;
use crate::model::RobotModel;

/// The motors of an arm: one for each joint, and perhaps one for the gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct MitMotors {
    /// Of the joints, base first.
    pub joints: Vec<MitMotor>,
    /// Of the gripper.
    pub gripper: Option<MitGripper>,
    /// Data rate of CAN FD that all of them are set to (register 35), bits per second, with 1 Mbit/s in arbitration; `None`: classical
    /// CAN.
    pub data_bit_rate_bit_s: Option<u32>,
}

/// A motor with its gear; all values at the shaft behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MitMotor {
    /// Type, with the ranges of its frames.
    pub motor: MotorType,
    /// Id of its commands (register 8).
    pub id: MotorId,
    /// Id of its answers (register 7).
    pub answers_on: StandardId,
    /// Position gain of each command, N·m/rad.
    pub kp_nm_rad: f64,
    /// Velocity gain of each command, N·m·s/rad.
    pub kd_nm_s_rad: f64,
    /// Inertia that the rotor adds, kg·m².
    pub rotor_kg_m2: f64,
}

/// The motor that moves the fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MitGripper {
    /// The motor.
    pub motor: MitMotor,
    /// How far it turns.
    pub travel: FingerTravel,
}

impl MitMotors {
    /// All motors: the joints, base first, then the gripper.
    pub fn all(&self) -> impl Iterator<Item = &MitMotor> {
        self.joints.iter().chain(self.gripper.as_ref().map(|gripper| &gripper.motor))
    }
}

impl MitGripper {
    /// From the order to open to the free ball, s: the rotor under the position gain alone.
    #[must_use]
    pub fn opening_s(&self) -> f64 {
        (2.0 * FingerTravel::FREE_SHARE * self.motor.rotor_kg_m2 / self.motor.kp_nm_rad).sqrt()
    }
}

impl RobotModel {
    /// Damiao motors with MIT frames, if the robot file describes them (for all joints or for no joint).
    #[must_use]
    pub fn mit_motors(&self) -> Option<&MitMotors> {
        if let Some(Drives::Mit(motors)) = self.moved_by() { Some(motors) } else { None }
    }
}

pub(super) fn read(tables: &Tables<'_>) -> Result<Option<(MitMotors, Common)>, LoadError> {
    let mut ids = Taken::default();
    let joints = of_joints(("mit", "MIT motor"), tables, |part, section, joint| {
        let motor = read_motor(part, &joint.name, &mut ids)?;
        // A larger value is clipped in the fields of the frames, and nothing on the wire shows it.
        let (limits, ranges) = (&joint.limits, &motor.motor.ranges);
        let turned_rad = limits.q_min_rad.abs().max(limits.q_max_rad.abs());
        let (p_max_rad, v_max_rad_s) = (f64::from(ranges.p_max_rad()), f64::from(ranges.v_max_rad_s()));
        let rows = [
            ("range_deg", turned_rad.to_degrees(), p_max_rad.to_degrees()),
            ("velocity_max_deg_s", limits.v_max_rad_s.to_degrees(), v_max_rad_s.to_degrees()),
            ("torque_max_nm", limits.torque_max_nm.unwrap_or(0.0), f64::from(ranges.t_max_nm())),
        ];
        require_range(section, &rows, || format!("the frames of a motor {}", motor.motor.name))?;
        Ok(motor)
    })?;
    let gripper = tables.gripper.optional("mit", Value::section)?;
    let Some(joints) = joints else {
        return match (gripper, tables.bus) {
            (Some(_), _) => Err(tables.gripper.error("mit", Problem::GripperAlone("MIT motor"))),
            (None, Some(bus)) => {
                Err(bus.error("data_bit_rate_bit_s", Problem::OfFamily(FD_ELSEWHERE.into())))
            }
            (None, None) => Ok(None),
        };
    };
    let gripper = gripper.map(|part| read_gripper(&part, &mut ids)).transpose()?;
    let data_bit_rate_bit_s = tables.bus.map(read_data_rate).transpose()?;
    let common = Common {
        addresses: joints.iter().map(|motor| motor.id.get()).collect(),
        rotors_kg_m2: joints.iter().map(|motor| motor.rotor_kg_m2).collect(),
        // Without the rate of the bus, which changes no motion.
        motors_text: format!("MitMotors {{ joints: {joints:?}, gripper: {gripper:?} }}"),
        of_controller: Some("motors with MIT frames"),
        opening_s: gripper.as_ref().map(MitGripper::opening_s),
        data_bit_rate_bit_s,
        ..Common::default()
    };
    Ok(Some((MitMotors { joints, gripper, data_bit_rate_bit_s }, common)))
}

const FD_ELSEWHERE: &str = "only Damiao motors ([joint.mit]) are led over CAN FD here";

fn read_data_rate(bus: &Section<'_>) -> Result<u32, LoadError> {
    let rate = bus.required("data_bit_rate_bit_s", |value| {
        let rate = value.integer(0..=i64::from(u32::MAX))?;
        DATA_RATES
            .map(|(_, bit_s)| bit_s)
            .into_iter()
            .find(|bit_s| i64::from(*bit_s) == rate)
            .ok_or_else(|| value.error(no_data_rate(rate)))
    })?;
    bus.finish()?;
    Ok(rate)
}

fn read_motor(part: &Section<'_>, owner: &str, ids: &mut Taken) -> Result<MitMotor, LoadError> {
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
    for (key, id) in [("id", u16::from(id.get())), ("answers_on", answers_on.get())] {
        let problem = |owner| Problem::NumberTaken { what: format!("id {id:#x}"), owner };
        ids.take((part, key), id, owner, problem)?;
    }
    Ok(MitMotor {
        motor,
        id,
        answers_on,
        kp_nm_rad: part.required("kp_nm_rad", |v| v.number_in(0.0, f64::from(KP_MAX_NM_RAD)))?,
        kd_nm_s_rad: part.required("kd_nm_s_rad", |v| v.number_in(0.0, f64::from(KD_MAX_NM_S_RAD)))?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
    })
}

fn read_gripper(part: &Section<'_>, ids: &mut Taken) -> Result<MitGripper, LoadError> {
    let motor = read_motor(part, "gripper", ids)?;
    let p_max_deg = f64::from(motor.motor.ranges.p_max_rad()).to_degrees();
    Ok(MitGripper { travel: travel(part, p_max_deg)?, motor })
}

fn no_data_rate(bit_s: i64) -> Problem {
    let rates = "2000000, 2500000, 3200000, 4000000, 5000000, 8000000 or 10000000 (register 35)";
    Problem::OfFamily(format!("{bit_s} bit/s is no data rate of these motors: {rates}").into())
}
