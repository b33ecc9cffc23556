//! `[joint.odrive]`, `[gripper.odrive]` and `[odrive_endpoints]`: ODrives that speak CANSimple.

use std::f64::consts::TAU;

use protocol::odrive::{NodeId, Version};
use toml_reader::Value;

use super::reading::{Taken, of_joints, require_range, travel};
use super::{Common, Drives, FingerTravel, Tables};
use crate::error::{LoadError, Problem};
use crate::load::Section;
use crate::model::RobotModel;

/// Highest node: addresses of a controller are 1 to 31.
const NODE_MAX: i64 = 31;

/// The axes of an arm.
#[derive(Debug, Clone)]
pub struct OdriveAxes {
    /// Of the joints, base first.
    pub axes: Vec<OdriveAxis>,
    /// Of the fingers.
    pub gripper: Option<OdriveGripper>,
    /// Numbers by which their parameters are read and written.
    pub endpoints: Option<OdriveEndpoints>,
}

/// Numbers of parameters of 0.6. Each firmware has its own (`flat_endpoints.json` of the maker).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OdriveEndpoints {
    /// Firmware that has these numbers: major, minor, revision.
    pub firmware: [u8; 3],
    /// In the order of [`OdriveEndpoints::KEYS`].
    pub numbers: [u16; OdriveEndpoints::KEYS.len()],
}

impl OdriveEndpoints {
    /// Keys in the robot file: the last part of each path in `flat_endpoints.json`.
    pub const KEYS: [&'static str; 7] = [
        "encoder_msg_rate_ms",
        "input_vel_scale",
        "input_torque_scale",
        "watchdog_timeout",
        "enable_watchdog",
        "control_mode",
        "input_mode",
    ];
}

/// The axis of a joint. Turns are those of the shaft that the axis counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveAxis {
    /// Node on the bus.
    pub node: NodeId,
    /// What it speaks.
    pub version: Version,
    /// Turns of the motor in a turn of the joint.
    pub gear_ratio: f64,
    /// The axis counts the shaft of the joint, absolute within a turn; else that of the motor.
    pub is_at_joint: bool,
    /// Torque of the motor per current, N·m/A.
    pub torque_nm_a: f64,
    /// Largest current, A.
    pub current_max_a: f64,
    /// Gain of the position loop, 1/s.
    pub position_gain_1_s: f64,
    /// Gain of the velocity loop, N·m of the motor per turn/s.
    pub velocity_gain_nm_s: f64,
    /// Gain of its integral, N·m of the motor per turn.
    pub integral_gain_nm: f64,
    /// It closes a brake when it gives no torque.
    pub brake: bool,
    /// Inertia that the rotor adds behind the gear, kg·m².
    pub rotor_kg_m2: f64,
}

/// The axis that moves the fingers, which it counts itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveGripper {
    /// The axis.
    pub axis: OdriveAxis,
    /// How far it turns.
    pub travel: FingerTravel,
}

impl OdriveGripper {
    /// From the order to open to the free ball, s: the loops of the axis move its rotor, within the current. Integrated with steps of 10 us,
    /// for at most a second.
    #[must_use]
    pub fn opening_s(&self) -> f64 {
        const STEP_S: f64 = 1e-5;
        let (axis, FingerTravel { open_rad, closed_rad }) = (&self.axis, self.travel);
        let damping_nms_rad = axis.gear_ratio * axis.velocity_gain_nm_s * axis.counted() / TAU;
        let (mut q_rad, mut v_rad_s, mut t_s) = (closed_rad, 0.0, 0.0);
        while self.travel.open_share(q_rad) < FingerTravel::FREE_SHARE && t_s < 1.0 {
            let wanted_rad_s = axis.position_gain_1_s * (open_rad - q_rad);
            let torque_nm = (damping_nms_rad * (wanted_rad_s - v_rad_s))
                .clamp(-axis.torque_max_nm(), axis.torque_max_nm());
            v_rad_s += torque_nm / axis.rotor_kg_m2 * STEP_S;
            q_rad += v_rad_s * STEP_S;
            t_s += STEP_S;
        }
        t_s
    }
}

impl OdriveAxis {
    /// Largest velocity and torque that a set point feeds forward, turns/s and N·m of the motor: 16 bits in steps of a thousandth.
    pub const FIELD_MAX: f64 = 32.767;

    /// Turns that are counted in a turn of the joint.
    #[must_use]
    pub fn counted(&self) -> f64 {
        if self.is_at_joint { 1.0 } else { self.gear_ratio }
    }

    /// Largest torque at the joint, N·m.
    #[must_use]
    pub fn torque_max_nm(&self) -> f64 {
        self.gear_ratio * self.torque_nm_a * self.current_max_a
    }
}

impl RobotModel {
    /// Axes of ODrives, if the robot file describes them (for all joints or for no joint).
    #[must_use]
    pub fn odrive_axes(&self) -> Option<&OdriveAxes> {
        if let Some(Drives::Odrive(axes)) = self.moved_by() { Some(axes) } else { None }
    }
}

impl OdriveAxes {
    /// All axes: the joints, base first, then the gripper.
    pub fn all(&self) -> impl Iterator<Item = &OdriveAxis> {
        self.axes.iter().chain(self.gripper.as_ref().map(|gripper| &gripper.axis))
    }
}

pub(super) fn read(tables: &Tables<'_>) -> Result<Option<(OdriveAxes, Common)>, LoadError> {
    let mut nodes = Taken::default();
    let axes = of_joints(("odrive", "ODrive axis"), tables, |part, section, joint| {
        let axis = read_axis(part)?;
        // Fields of a set point clip what is larger; the current limits the torque.
        let (limits, field) = (&joint.limits, OdriveAxis::FIELD_MAX);
        let torque_max_nm = axis.torque_max_nm().min(field * axis.gear_ratio);
        let rows = [
            ("velocity_max_deg_s", limits.v_max_rad_s.to_degrees(), field * 360.0 / axis.counted()),
            ("torque_max_nm", limits.torque_max_nm.unwrap_or(0.0), torque_max_nm),
        ];
        require_range(section, &rows, || "the set points of this ODrive".to_owned())?;
        nodes.take_node(part, axis.node.get(), &joint.name)?;
        Ok(axis)
    })?;
    let gripper = read_gripper(tables.gripper, axes.is_some(), &mut nodes)?;
    let endpoints = tables.root.optional(ENDPOINTS, Value::section)?;
    let endpoints = endpoints.map(|part| read_endpoints(&part)).transpose()?;
    let mut own = axes.iter().flatten().chain(gripper.as_ref().map(|gripper| &gripper.axis)).peekable();
    if endpoints.is_some() && (own.peek().is_none() || own.any(|axis| axis.version == Version::V05)) {
        let why = "only ODrives with version = \"0.6\" have parameters with numbers: leave the table out";
        return Err(tables.root.error(ENDPOINTS, Problem::OfFamily(why.into())));
    }
    Ok(axes.map(|axes| {
        let common = Common {
            addresses: axes.iter().map(|axis| axis.node.get()).collect(),
            rotors_kg_m2: axes.iter().map(|axis| axis.rotor_kg_m2).collect(),
            // Without the endpoints, which change no motion.
            motors_text: format!("{axes:?} {gripper:?}"),
            of_controller: Some("ODrives"),
            hand_lacks_opener: gripper.is_none(),
            opening_s: gripper.as_ref().map(OdriveGripper::opening_s),
            ..Common::default()
        };
        (OdriveAxes { axes, gripper, endpoints }, common)
    }))
}

/// Table of the numbers of parameters.
const ENDPOINTS: &str = "odrive_endpoints";

fn read_endpoints(part: &Section<'_>) -> Result<OdriveEndpoints, LoadError> {
    let firmware = part.required("firmware", |v| {
        let numbers: Option<Vec<u8>> = v.text()?.split('.').map(|number| number.parse().ok()).collect();
        match numbers.as_deref() {
            Some([0, 6, revision]) => Ok([0, 6, *revision]),
            _ => Err(v.wrong_type("a firmware of 0.6, as \"0.6.10\"")),
        }
    })?;
    let (mut taken, mut numbers) = (Taken::default(), [0; OdriveEndpoints::KEYS.len()]);
    for (key, number) in OdriveEndpoints::KEYS.into_iter().zip(&mut numbers) {
        *number = part.required(key, |v| v.integer(1..=i64::from(u16::MAX)))? as u16;
        let problem = |owner| Problem::NumberTaken { what: format!("endpoint {number}"), owner };
        taken.take((part, key), *number, key, problem)?;
    }
    part.finish()?;
    Ok(OdriveEndpoints { firmware, numbers })
}

/// The axis of the fingers, or nothing.
fn read_gripper(
    gripper: &Section<'_>,
    joints_have_axes: bool,
    nodes: &mut Taken,
) -> Result<Option<OdriveGripper>, LoadError> {
    let Some(part) = gripper.optional("odrive", Value::section)? else { return Ok(None) };
    if !joints_have_axes {
        return Err(gripper.error("odrive", Problem::GripperAlone("ODrive axis")));
    }
    let axis = read_axis(&part)?;
    nodes.take_node(&part, axis.node.get(), "gripper")?;
    if !axis.is_at_joint {
        let why = "the axis of the gripper counts its motor and forgets its turns without power: it needs encoder = \"joint\"";
        return Err(part.error("encoder", Problem::OfFamily(why.into())));
    }
    // Without an inertia the fingers would take no time.
    part.required("rotor_kg_m2", Value::positive)?;
    Ok(Some(OdriveGripper { axis, travel: travel(&part, 180.0)? }))
}

fn read_axis(part: &Section<'_>) -> Result<OdriveAxis, LoadError> {
    let node = part.required("node", |v| {
        let number = v.integer(1..=NODE_MAX)?;
        u8::try_from(number).ok().and_then(NodeId::new).ok_or_else(|| v.wrong_type("the number of a node"))
    })?;
    Ok(OdriveAxis {
        node,
        version: part.required("version", |v| v.word(&[("0.5", Version::V05), ("0.6", Version::V06)]))?,
        gear_ratio: part.required("gear_ratio", Value::positive)?,
        is_at_joint: part.required("encoder", |v| v.word(&[("joint", true), ("motor", false)]))?,
        torque_nm_a: part.required("torque_nm_a", Value::positive)?,
        current_max_a: part.required("current_max_a", Value::positive)?,
        position_gain_1_s: part.required("position_gain_1_s", Value::positive)?,
        velocity_gain_nm_s: part.required("velocity_gain_nm_s", Value::positive)?,
        integral_gain_nm: part.or("integral_gain_nm", 0.0, Value::non_negative)?,
        brake: part.required("brake", Value::boolean)?,
        rotor_kg_m2: part.required("rotor_kg_m2", Value::non_negative)?,
    })
}
