//! The machine behind a bus for viewers: names, addresses, bodies, and their places at given angles.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use protocol::{Frame, bits};
use robot_model::{JointVec, Pose, RobotModel};
use serde::Serialize;

/// The bodies at joint angles in rad.
type Place = dyn Fn(&[f64]) -> Placed + Send;

/// What stands behind the bus: names, addresses and kinematics of the joints.
pub struct Machine {
    pub robot: String,
    pub joints: Vec<String>,
    /// Address of the drive of each joint; empty if the robot file has none.
    pub addresses: Vec<u8>,
    /// Bodies: number of the link (0 is the base), pose in its frame, half edges in m.
    pub boxes: Vec<(usize, Pose, [f64; 3])>,
    /// Data rate of CAN FD on its bus, bit/s; `None`: classical CAN.
    pub data_bit_rate_bit_s: Option<u32>,
    /// Radius of the ball that the hand holds, m.
    pub ball_radius_m: f64,
    place: Box<Place>,
}

/// The bodies of an arm in the world frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Placed {
    /// Pose of each link: rotation by rows, then place in m.
    pub links: Vec<[f64; 12]>,
    /// Where the hand holds the ball, m.
    pub hand_m: [f64; 3],
}

impl Machine {
    /// The machine that a robot file describes; drives read the angles of their joints.
    #[must_use]
    pub fn of(robot: &RobotModel) -> Self {
        let own = robot.clone();
        Self {
            robot: robot.name().to_owned(),
            joints: robot.joints().iter().map(|joint| joint.name.clone()).collect(),
            addresses: robot
                .drives()
                .map_or_else(Vec::new, |drives| drives.iter().map(|drive| drive.address).collect()),
            boxes: robot.collision().boxes().iter().map(|b| (b.link, b.x_lb, b.half_m.into())).collect(),
            data_bit_rate_bit_s: robot.data_bit_rate_bit_s(),
            ball_radius_m: robot.gripper().ball_radius_m,
            place: Box::new(move |q_rad| placed(&own, q_rad)),
        }
    }

    /// Address of the drive and name of each joint, base first.
    #[must_use]
    pub fn names(&self) -> Vec<(u8, String)> {
        self.addresses.iter().copied().zip(self.joints.iter().cloned()).collect()
    }

    /// Time of a frame on its bus, in bits of this nominal rate, interframe space included; stuff bits of CAN FD only.
    #[must_use]
    pub fn frame_bits(&self, frame: &Frame, bit_rate_bit_s: u32) -> u64 {
        let Some(fast) = self.data_bit_rate_bit_s.filter(|_| frame.fd().is_some()) else {
            return frame.nominal_bits().into();
        };
        let [bit_ns, fast_ns] = [bit_rate_bit_s, fast].map(|rate| u64::from(1_000_000_000 / rate.max(1)));
        bits::length(frame).time_ns(bit_ns, fast_ns) / bit_ns.max(1)
    }

    /// Where links and hand are at these angles, rad.
    #[must_use]
    pub fn place(&self, q_rad: &[f64]) -> Placed {
        (self.place)(q_rad)
    }
}

fn placed(robot: &RobotModel, q_rad: &[f64]) -> Placed {
    let frames = robot.fk(&JointVec::from_fn(robot.n(), |j| q_rad.get(j).copied().unwrap_or_default()));
    let hand = robot.ball(&frames).pos;
    Placed { links: frames.x_w.iter().map(numbers).collect(), hand_m: [hand.x, hand.y, hand.z] }
}

fn numbers(pose: &Pose) -> [f64; 12] {
    let mut all = [0.0; 12];
    let values = pose.rot.transpose();
    for (to, from) in all.iter_mut().zip(values.iter().chain(pose.pos.iter())) {
        *to = *from;
    }
    all
}

/// Place in m and orientation of a link of [`Placed`].
#[must_use]
pub fn link_pose(link: &[f64; 12]) -> ([f64; 3], UnitQuaternion<f64>) {
    ([link[9], link[10], link[11]], quaternion(Matrix3::from_row_slice(&link[..9])))
}

/// A rotation matrix as a quaternion.
#[must_use]
pub fn quaternion(rot: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rot))
}

/// Name of the frame of a link; link 0 is the base, which stands in the world.
#[must_use]
pub fn frame_of(link: usize) -> String {
    if link == 0 { "world".to_owned() } else { format!("link{link}") }
}
