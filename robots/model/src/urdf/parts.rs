//! What an import collects before it writes the robot file: options, bodies and axes.

use nalgebra::Vector3;

use super::tree::{Inertial, Turn};
use crate::pose::Pose;

/// Radius of the assumed ball, m.
pub(super) const BALL_RADIUS_M: f64 = 0.03;

/// Data that a robot file needs and URDF does not have.
#[derive(Debug, Clone, PartialEq)]
pub struct UrdfOptions {
    /// Link whose frame is the end effector: the arm ends there. If `None` the arm ends where hand or branches begin, and the last
    /// link that it moves is the end effector.
    pub end_effector: Option<String>,
    /// Acceleration limit per velocity limit, in 1/s. The PowerCubes have 4.
    pub acceleration_per_velocity_1_s: f64,
    /// Jerk limit per acceleration limit, in 1/s.
    pub jerk_per_acceleration_1_s: f64,
    /// Velocity limit of joints without one in the file, in rad/s.
    pub velocity_default_rad_s: f64,
    /// Height of the floor in m. If `None` it is the height of the base, or lower if needed so that the arm in the
    /// middle of its ranges does not touch it.
    pub floor_z_m: Option<f64>,
}

impl Default for UrdfOptions {
    fn default() -> Self {
        Self {
            end_effector: None,
            acceleration_per_velocity_1_s: 4.0,
            jerk_per_acceleration_1_s: 10.0,
            velocity_default_rad_s: 1.0,
            floor_z_m: None,
        }
    }
}

/// A body: everything bolted together between two moving joints.
#[derive(Debug, Clone)]
pub(super) struct Body {
    pub(super) name: String,
    pub(super) line: u32,
    pub(super) inertial: Option<Inertial>,
    /// Name, pose in the body, half sizes.
    pub(super) boxes: Vec<(String, Pose, Vector3<f64>)>,
    /// Links of the body with their poses in it.
    pub(super) links: Vec<(usize, Pose)>,
}

/// Torque of a joint: given, or assumed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Effort {
    pub(super) nm: f64,
    pub(super) given: bool,
}

/// All that a robot file is written from.
#[derive(Debug)]
pub(super) struct Draft<'a> {
    pub(super) name: &'a str,
    pub(super) file: &'a str,
    pub(super) base: Body,
    pub(super) axes: Vec<Axis>,
    pub(super) efforts: Vec<Effort>,
    /// In the frame of the last body.
    pub(super) end_effector: Pose,
    pub(super) release: Pose,
    /// Voltage of the generic drives, V.
    pub(super) voltage_v: f64,
    /// Links that are not tested against each other; 0 is the base.
    pub(super) untested: Vec<[usize; 2]>,
    pub(super) floor_z_m: f64,
    /// First link that is tested against the floor.
    pub(super) floor_from_link: usize,
    pub(super) notes: Vec<String>,
}

/// A moving joint with the body behind it.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) origin: Pose,
    pub(super) turn: Turn,
    pub(super) body: Body,
}
