//! What the group must know of its axes, and the ids that it uses on the bus.

use core::f32::consts::TAU;
use core::fmt;

use heapless::Vec;
use protocol::odrive::{NodeId, Version};
use protocol::{JOINTS_MAX, JointIndex, StandardId};

use crate::groups::dynamics::ArmModel;

/// Largest velocity that is fed forward, turns/s: the field is a whole number of 0.001 turns/s with 16 bits.
pub const VELOCITY_MAX_REV_S: f32 = 32.767;
/// Ids of a node: one for each command.
const COMMANDS: u16 = 32;

/// Which shaft an axis counts, and so how a joint finds its zero. No axis keeps its turns without power.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Home {
    /// The shaft of the joint, absolute within a turn: there is nothing to find.
    Joint,
    /// The shaft of the motor, absolute within a turn or by an index. A person leads the joint to its zero; the nearest whole turn of the
    /// motor becomes the zero.
    Motor,
}

/// The axis of a joint. Direction, offset and limits are those of [`crate::settings::JointSettings`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Its node.
    pub node: NodeId,
    /// What it speaks.
    pub version: Version,
    /// Turns of the motor in a turn of the joint.
    pub gear: f32,
    /// See [`Home`].
    pub home: Home,
    /// Largest current, A.
    pub current_max_a: f32,
    /// Gain of the position loop, 1/s.
    pub position_gain_1_s: f32,
    /// Gain of the velocity loop, N·m of the motor per turn/s that is counted.
    pub velocity_gain_nm_s: f32,
    /// Gain of its integral, N·m of the motor per turn that is counted.
    pub integral_gain_nm: f32,
}

/// The axis that moves the fingers, which it counts itself ([`Home::Joint`]). It has the place after the last joint, also in faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperAxis {
    /// Node, gear and gains; current and gains bound the force of the fingers.
    pub axis: Axis,
    /// Angle of open fingers, rad.
    pub open_rad: f32,
    /// Angle of closed fingers, rad.
    pub closed_rad: f32,
}

impl Axis {
    /// Turns that are counted in a turn of the joint.
    pub(super) const fn turns(self) -> f32 {
        match self.home {
            Home::Joint => 1.0,
            Home::Motor => self.gear,
        }
    }

    pub(super) fn to_rad(self, rev: f32) -> f32 {
        rev * (TAU / self.turns())
    }

    pub(super) fn to_rev(self, rad: f32) -> f32 {
        rad * (self.turns() / TAU)
    }
}

/// A parameter of 0.6 that a number leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Period of the estimates, ms, 32 bits: 0, estimates come when they are asked for.
    EstimatesPeriod,
    /// 32 bits: steps of the velocity field in a turn/s.
    VelocityScale,
    /// 32 bits: steps of the torque field in a N·m.
    TorqueScale,
    /// Time-out of the watchdog, float, s.
    WatchdogTime,
    /// Whether it is on, one byte.
    WatchdogOn,
    /// What the loop controls, one byte.
    ControlMode,
    /// How set points become what is controlled, one byte.
    InputMode,
}

impl Parameter {
    /// All, in the order of [`Endpoints::numbers`].
    pub const ALL: [Self; 7] = [
        Self::EstimatesPeriod,
        Self::VelocityScale,
        Self::TorqueScale,
        Self::WatchdogTime,
        Self::WatchdogOn,
        Self::ControlMode,
        Self::InputMode,
    ];

    /// The maker's name.
    #[must_use]
    pub const fn path(self) -> &'static str {
        match self {
            Self::EstimatesPeriod => "axis0.config.can.encoder_msg_rate_ms",
            Self::VelocityScale => "axis0.config.can.input_vel_scale",
            Self::TorqueScale => "axis0.config.can.input_torque_scale",
            Self::WatchdogTime => "axis0.config.watchdog_timeout",
            Self::WatchdogOn => "axis0.config.enable_watchdog",
            Self::ControlMode => "axis0.controller.config.control_mode",
            Self::InputMode => "axis0.controller.config.input_mode",
        }
    }
}

/// Numbers of parameters of 0.6. Each firmware has its own (`flat_endpoints.json` of the maker), so they belong to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoints {
    /// Firmware that has these numbers: major, minor, revision.
    pub firmware: [u8; 3],
    /// In the order of [`Parameter::ALL`].
    pub numbers: [u16; Parameter::ALL.len()],
}

impl Endpoints {
    pub(super) fn number(&self, parameter: Parameter) -> Option<u16> {
        let mut all = Parameter::ALL.iter().zip(&self.numbers);
        all.find(|(own, _)| **own == parameter).map(|(_, number)| *number)
    }
}

/// Why a group cannot be made of these axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionsError {
    /// No axis of a joint, or more than [`JOINTS_MAX`] with the gripper's.
    Count,
    /// Two axes have one node.
    Overlap {
        /// The node.
        node: NodeId,
        /// The first joint that has it.
        joint: JointIndex,
    },
    /// A gear, a current or a gain is not above zero (the integral: is below zero).
    Value(JointIndex),
    /// The axis of the gripper counts its motor: it does not know after power-up where the fingers are.
    GripperTurns,
}

impl fmt::Display for OptionsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count => write!(f, "a group has 1 to {JOINTS_MAX} axes"),
            Self::Overlap { node, joint } => {
                write!(f, "node {node} of joint {joint} is used twice: give each axis a node of its own")
            }
            Self::Value(joint) => write!(
                f,
                "gear, current, position gain and velocity gain of joint {joint} are above 0, its integral gain is not below"
            ),
            Self::GripperTurns => f.write_str(
                "the axis of the gripper counts the shaft of its motor: it needs an encoder at the fingers",
            ),
        }
    }
}

impl core::error::Error for OptionsError {}

/// Axes of one bus, base first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    axes: Vec<Axis, JOINTS_MAX>,
    gripper: Option<GripperAxis>,
    model: Option<ArmModel>,
    endpoints: Option<Endpoints>,
}

impl Options {
    /// # Errors
    /// See [`OptionsError`].
    pub fn new(axes: &[Axis]) -> Result<Self, OptionsError> {
        let all = Vec::from_slice(axes).map_err(|_| OptionsError::Count)?;
        if all.is_empty() {
            return Err(OptionsError::Count);
        }
        Self { axes: all, gripper: None, model: None, endpoints: None }.checked()
    }

    /// With an axis for the fingers.
    ///
    /// # Errors
    /// See [`OptionsError`].
    pub fn with_gripper(self, gripper: GripperAxis) -> Result<Self, OptionsError> {
        if self.axes.is_full() {
            return Err(OptionsError::Count);
        }
        if gripper.axis.home != Home::Joint {
            return Err(OptionsError::GripperTurns);
        }
        Self { gripper: Some(gripper), ..self }.checked()
    }

    fn checked(self) -> Result<Self, OptionsError> {
        for (joint, axis) in JointIndex::first(JOINTS_MAX).zip(self.all()) {
            if self.all().filter(|other| other.node == axis.node).count() > 1 {
                return Err(OptionsError::Overlap { node: axis.node, joint });
            }
            let above = [axis.gear, axis.current_max_a, axis.position_gain_1_s, axis.velocity_gain_nm_s];
            let fits = above.iter().all(|value| *value > 0.0 && value.is_finite());
            if !(fits && axis.integral_gain_nm >= 0.0 && axis.integral_gain_nm.is_finite()) {
                return Err(OptionsError::Value(joint));
            }
        }
        Ok(self)
    }

    /// With the arm that the axes move: they get the torque that their set points need.
    ///
    /// # Errors
    /// [`OptionsError::Count`]: not one body for each joint.
    pub fn with_model(self, model: ArmModel) -> Result<Self, OptionsError> {
        let fits = model.bodies.len() == self.axes.len();
        if fits { Ok(Self { model: Some(model), ..self }) } else { Err(OptionsError::Count) }
    }

    /// With the numbers of parameters: what no other message shows is written, and read back.
    #[must_use]
    pub fn with_endpoints(self, endpoints: Endpoints) -> Self {
        Self { endpoints: Some(endpoints), ..self }
    }

    pub(super) const fn model(&self) -> Option<&ArmModel> {
        self.model.as_ref()
    }

    pub(super) const fn endpoints(&self) -> Option<&Endpoints> {
        self.endpoints.as_ref()
    }

    /// Every id on which the group or one of its axes sends or listens. No other node of the bus may use one of them.
    pub fn ids(&self) -> impl Iterator<Item = StandardId> + '_ {
        let own = |axis: &Axis| {
            let first = u16::from(axis.node.get()) * COMMANDS;
            (first..first + COMMANDS).map(StandardId::from_low_bits)
        };
        self.all().flat_map(own)
    }

    /// Of the joints, base first, then of the gripper.
    pub(super) fn all(&self) -> impl Iterator<Item = &Axis> {
        self.axes.iter().chain(self.gripper.as_ref().map(|gripper| &gripper.axis))
    }

    pub(super) fn axis(&self, place: JointIndex) -> Option<Axis> {
        self.all().nth(place.get()).copied()
    }

    /// Place and axis of the gripper.
    pub(super) fn gripper(&self) -> Option<(JointIndex, &GripperAxis)> {
        let place = JointIndex::new(self.axes.len()).ok()?;
        self.gripper.as_ref().map(|gripper| (place, gripper))
    }

    /// Place and axis of the node of an id.
    pub(super) fn axis_of(&self, id: StandardId) -> Option<(JointIndex, Axis)> {
        let mut all = JointIndex::first(JOINTS_MAX).zip(self.all());
        let (joint, axis) = all.find(|(_, axis)| u16::from(axis.node.get()) == id.get() / COMMANDS)?;
        Some((joint, *axis))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(node: u8) -> Axis {
        Axis {
            node: NodeId::new(node).unwrap(),
            version: Version::V06,
            gear: 8.0,
            home: Home::Joint,
            current_max_a: 40.0,
            position_gain_1_s: 20.0,
            velocity_gain_nm_s: 1.0,
            integral_gain_nm: 0.0,
        }
    }

    #[test]
    fn a_node_that_is_used_twice_and_a_gain_that_holds_nothing_are_refused_with_their_joint() {
        let joint = |index| JointIndex::new(index).unwrap();
        assert!(Options::new(&[axis(9), axis(10)]).is_ok());
        let twice = Options::new(&[axis(9), axis(10), axis(9)]);
        assert_eq!(twice, Err(OptionsError::Overlap { node: NodeId::new(9).unwrap(), joint: joint(0) }));
        assert_eq!(Options::new(&[]), Err(OptionsError::Count));
        assert_eq!(Options::new(&[axis(9); 9]), Err(OptionsError::Count));
        let soft = Axis { position_gain_1_s: 0.0, ..axis(10) };
        assert_eq!(Options::new(&[axis(9), soft]), Err(OptionsError::Value(joint(1))));
        let unknown = Axis { integral_gain_nm: f32::NAN, ..axis(9) };
        assert_eq!(Options::new(&[unknown]), Err(OptionsError::Value(joint(0))));
    }

    #[test]
    fn a_gripper_needs_a_node_of_its_own_and_an_encoder_at_its_fingers() {
        let hand = |axis| GripperAxis { axis, open_rad: -1.0, closed_rad: 0.0 };
        let first = axis(9);
        let with = |axis| Options::new(&[first]).and_then(|all| all.with_gripper(hand(axis)));
        assert!(with(axis(10)).is_ok());
        let overlap =
            OptionsError::Overlap { node: NodeId::new(9).unwrap(), joint: JointIndex::new(0).unwrap() };
        assert_eq!(with(axis(9)), Err(overlap));
        assert_eq!(with(Axis { home: Home::Motor, ..axis(10) }), Err(OptionsError::GripperTurns));
        let soft = Axis { velocity_gain_nm_s: 0.0, ..axis(10) };
        assert_eq!(with(soft), Err(OptionsError::Value(JointIndex::new(1).unwrap())));
        let eight: std::vec::Vec<Axis> = (9..17).map(axis).collect();
        let full = Options::new(&eight).and_then(|all| all.with_gripper(hand(axis(17))));
        assert_eq!(full, Err(OptionsError::Count));
    }

    #[test]
    fn an_axis_owns_the_ids_of_all_commands_of_its_node() {
        let options = Options::new(&[axis(4), axis(9)]).unwrap();
        let ids: std::vec::Vec<u16> = options.ids().map(StandardId::get).collect();
        assert_eq!(ids, (0x080..0x0A0).chain(0x120..0x140).collect::<std::vec::Vec<u16>>());
        let of = |id| options.axis_of(StandardId::new(id).unwrap()).map(|(joint, _)| joint.get());
        assert_eq!((of(0x12C), of(0x09F), of(0x0A0)), (Some(1), Some(0), None));
    }
}
