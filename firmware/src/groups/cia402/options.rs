//! What the group must know of its servos, and the ids that it uses on the bus.

use core::f32::consts::TAU;
use core::fmt;

use heapless::Vec;
use protocol::canopen::pdo::{Entry, Map};
use protocol::canopen::{Function, NodeId, cia402};
use protocol::{JOINTS_MAX, JointIndex, StandardId};

use crate::groups::dynamics::ArmModel;

/// Node of the controller, whose heartbeat the servos supervise, if nothing else is said.
pub const HOST_NODE: u8 = 0x7F;

/// How a joint finds its zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Home {
    /// The encoder is absolute.
    Absolute,
    /// A person leads the joint to its zero; the servo takes the place by its homing method 37.
    Here,
}

/// How a servo follows the positions that it gets with each SYNC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Follow {
    /// Mode 8, cyclic synchronous position: object 607A.
    Cyclic,
    /// Mode 7, interpolated position: object 60C1:1, and bit 4 of the control word starts it. Such servos may have a fixed unit, without
    /// objects 608F and 6091, and may look for their commutation for some seconds when they first get torque.
    Interpolated,
}

impl Follow {
    pub(super) const fn mode(self) -> cia402::Mode {
        match self {
            Self::Cyclic => cia402::Mode::CyclicPosition,
            Self::Interpolated => cia402::Mode::InterpolatedPosition,
        }
    }
}

/// The servo of a joint. Direction, offset and limits are those of [`crate::settings::JointSettings`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    /// Its node.
    pub node: NodeId,
    /// Counts per turn of the joint: objects 608F and 6091 together.
    pub counts_per_turn: u32,
    /// Rated torque at the joint, mN·m: object 6076, unit of the torque that is fed forward.
    pub rated_mnm: u32,
    /// See [`Home`].
    pub home: Home,
    /// See [`Follow`].
    pub follow: Follow,
}

impl Servo {
    pub(super) fn to_rad(self, counts: i32) -> f32 {
        counts as f32 * (TAU / self.counts_per_turn as f32)
    }

    /// The nearest count.
    pub(super) fn to_counts(self, rad: f32) -> i32 {
        libm::roundf(rad * (self.counts_per_turn as f32 / TAU)) as i32
    }
}

/// The digital output of a servo that opens the hand (object 60FE).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GripperOutput {
    /// Joint whose servo has it.
    pub joint: JointIndex,
    /// Its bit, 0 to 31: 1 opens.
    pub bit: u8,
}

impl GripperOutput {
    /// Value of the object with this output on.
    pub(super) const fn mask(self) -> u32 {
        1_u32.wrapping_shl(self.bit as u32)
    }
}

/// Why a group cannot be made of these servos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionsError {
    /// No servo, or more than [`JOINTS_MAX`].
    Count,
    /// Two servos, or a servo and the controller, have one node.
    Overlap {
        /// The node.
        node: NodeId,
        /// The joint that has it, too.
        joint: JointIndex,
    },
    /// A turn has no counts, or a servo no torque.
    Units(JointIndex),
    /// A servo in interpolated position mode is to take the place where it stands as its zero; it has no such mode.
    Home(JointIndex),
    /// The output that opens the hand is of no servo, or has no such bit.
    Output,
}

impl fmt::Display for OptionsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count => write!(f, "a group has 1 to {JOINTS_MAX} servos"),
            Self::Overlap { node, joint } => write!(
                f,
                "node {node} of joint {joint} is used twice: give each servo a node of its own, other than {HOST_NODE}, the controller's"
            ),
            Self::Units(joint) => write!(f, "counts per turn and rated torque of joint {joint} are above 0"),
            Self::Home(joint) => write!(
                f,
                "the servo of joint {joint} follows in interpolated position mode: it needs an absolute encoder"
            ),
            Self::Output => {
                f.write_str("the output that opens the hand is bit 0 to 31 of a servo of the group")
            }
        }
    }
}

impl core::error::Error for OptionsError {}

/// Servos of one bus, base first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    servos: Vec<Servo, JOINTS_MAX>,
    gripper: Option<GripperOutput>,
    model: Option<ArmModel>,
}

impl Options {
    /// # Errors
    /// See [`OptionsError`].
    pub fn new(servos: &[Servo]) -> Result<Self, OptionsError> {
        let all = Vec::from_slice(servos).map_err(|_| OptionsError::Count)?;
        if all.is_empty() {
            return Err(OptionsError::Count);
        }
        for (joint, servo) in JointIndex::first(all.len()).zip(servos) {
            let same = servos.iter().filter(|other| other.node == servo.node).count();
            if same > 1 || servo.node.get() == HOST_NODE {
                return Err(OptionsError::Overlap { node: servo.node, joint });
            }
            if servo.counts_per_turn == 0 || servo.rated_mnm == 0 {
                return Err(OptionsError::Units(joint));
            }
            if servo.follow == Follow::Interpolated && servo.home == Home::Here {
                return Err(OptionsError::Home(joint));
            }
        }
        Ok(Self { servos: all, gripper: None, model: None })
    }

    /// With the arm that the servos move: they get the torque that their set points need (object 60B2).
    ///
    /// # Errors
    /// [`OptionsError::Count`]: not one body for each joint.
    pub fn with_model(self, model: ArmModel) -> Result<Self, OptionsError> {
        let fits = model.bodies.len() == self.servos.len();
        if fits { Ok(Self { model: Some(model), ..self }) } else { Err(OptionsError::Count) }
    }

    /// With an output that opens the hand.
    ///
    /// # Errors
    /// [`OptionsError::Output`].
    pub fn with_gripper(self, gripper: GripperOutput) -> Result<Self, OptionsError> {
        let fits = gripper.joint.get() < self.servos.len() && gripper.bit < 32;
        if fits { Ok(Self { gripper: Some(gripper), ..self }) } else { Err(OptionsError::Output) }
    }

    pub(super) const fn gripper(&self) -> Option<GripperOutput> {
        self.gripper
    }

    pub(super) const fn model(&self) -> Option<&ArmModel> {
        self.model.as_ref()
    }

    /// Every id on which the group or one of its servos sends. No other node of the bus may use one of them.
    pub fn ids(&self) -> impl Iterator<Item = StandardId> + '_ {
        let own = |servo: &Servo| {
            let node = servo.node;
            [
                Function::Emergency(node),
                Function::Tpdo(1, node),
                Function::Rpdo(1, node),
                Function::SdoFromNode(node),
                Function::SdoToNode(node),
                Function::Heartbeat(node),
            ]
        };
        let host = NodeId::new(HOST_NODE).map(Function::Heartbeat);
        let common = [Function::Nmt, Function::Sync].into_iter().chain(host);
        let outputs = self.gripper.and_then(|own| self.servo(own.joint));
        let outputs = outputs.map(|servo| Function::Rpdo(2, servo.node));
        let all = self.servos.iter().flat_map(own).chain(common).chain(outputs);
        all.map(|function| StandardId::from_low_bits(function.id()))
    }

    pub(super) fn servo(&self, joint: JointIndex) -> Option<Servo> {
        self.servos.get(joint.get()).copied()
    }

    /// Joints that have a servo.
    pub(super) fn joints(&self) -> impl Iterator<Item = JointIndex> + use<> {
        JointIndex::first(self.servos.len())
    }

    /// Joint of a node.
    pub(super) fn joint_of(&self, node: NodeId) -> Option<JointIndex> {
        let index = self.servos.iter().position(|servo| servo.node == node)?;
        JointIndex::new(index).ok()
    }

    /// What goes to a servo: control word, position, and torque if it is known.
    pub(super) fn to_servo(&self, servo: Servo) -> Option<Map> {
        let target = match servo.follow {
            Follow::Cyclic => Entry::new(cia402::TARGET_POSITION, 0, 4),
            Follow::Interpolated => Entry::new(cia402::INTERPOLATION_DATA, 1, 4),
        };
        let all = [Entry::new(cia402::CONTROL, 0, 2), target, Entry::new(cia402::TORQUE_OFFSET, 0, 2)];
        let known = if self.model.is_some() { all.len() } else { all.len() - 1 };
        Map::new(all.get(..known)?)
    }

    /// What goes to the servo whose output opens the hand, beside that: its outputs.
    pub(super) fn to_outputs() -> Option<Map> {
        Map::new(&[Entry::new(cia402::OUTPUTS, 1, 4)])
    }

    /// What comes from a servo: status word and position.
    pub(super) fn from_servo() -> Option<Map> {
        Map::new(&[Entry::new(cia402::STATUS, 0, 2), Entry::new(cia402::POSITION, 0, 4)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn servo(node: u8) -> Servo {
        let node = NodeId::new(node).unwrap();
        Servo {
            node,
            counts_per_turn: 409_600,
            rated_mnm: 50_000,
            home: Home::Absolute,
            follow: Follow::Cyclic,
        }
    }

    #[test]
    fn nodes_that_are_used_twice_are_refused_with_node_and_joint() {
        assert!(Options::new(&[servo(1), servo(2)]).is_ok());
        let overlap = |servos: &[Servo]| match Options::new(servos) {
            Err(OptionsError::Overlap { node, joint }) => (node.get(), joint.get()),
            other => panic!("{other:?}"),
        };
        assert_eq!(overlap(&[servo(1), servo(2), servo(1)]), (1, 0));
        assert_eq!(overlap(&[servo(1), servo(HOST_NODE)]), (HOST_NODE, 1));
        assert_eq!(Options::new(&[]), Err(OptionsError::Count));
        assert_eq!(Options::new(&[servo(1); 9]), Err(OptionsError::Count));
        let joint = JointIndex::new(0).unwrap();
        let output = |index, bit| GripperOutput { joint: JointIndex::new(index).unwrap(), bit };
        let with = |output| Options::new(&[servo(1), servo(2)]).and_then(|all| all.with_gripper(output));
        assert!(with(output(1, 31)).is_ok());
        assert_eq!(with(output(2, 16)), Err(OptionsError::Output));
        assert_eq!(with(output(1, 32)), Err(OptionsError::Output));
        let here = Servo { follow: Follow::Interpolated, home: Home::Here, ..servo(1) };
        assert_eq!(Options::new(&[here]), Err(OptionsError::Home(joint)));
        assert_eq!(Options::new(&[Servo { rated_mnm: 0, ..servo(1) }]), Err(OptionsError::Units(joint)));
    }

    #[test]
    fn each_id_of_the_group_is_listed_once() {
        let options = Options::new(&[servo(3), servo(4)]).unwrap();
        let mut ids: std::vec::Vec<u16> = options.ids().map(StandardId::get).collect();
        ids.sort_unstable();
        assert_eq!(
            ids,
            [
                0x000, 0x080, 0x083, 0x084, 0x183, 0x184, 0x203, 0x204, 0x583, 0x584, 0x603, 0x604, 0x703,
                0x704, 0x77F
            ]
        );
    }
}
