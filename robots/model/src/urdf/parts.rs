//! What an import collects before it writes the robot file: options, bodies and axes.

use nalgebra::Vector3;

use super::tree::{Inertial, Turn};
use crate::pose::Pose;

/// What a robot file needs and URDF does not say.
#[derive(Debug, Clone, PartialEq)]
pub struct UrdfOptions {
    /// Link whose frame is the end effector; the last link of the chain if `None`.
    pub end_effector: Option<String>,
    /// Acceleration limit per velocity limit, in 1/s. The PowerCubes have 4.
    pub acceleration_per_velocity_1_s: f64,
    /// Jerk limit per acceleration limit, in 1/s.
    pub jerk_per_acceleration_1_s: f64,
    /// Velocity limit of joints that give none, in rad/s.
    pub velocity_default_rad_s: f64,
    /// Height of the floor in m.
    pub floor_z_m: f64,
}

impl Default for UrdfOptions {
    fn default() -> Self {
        Self {
            end_effector: None,
            acceleration_per_velocity_1_s: 4.0,
            jerk_per_acceleration_1_s: 10.0,
            velocity_default_rad_s: 1.0,
            floor_z_m: 0.0,
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

/// A moving joint with the body behind it.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) name: String,
    pub(super) origin: Pose,
    pub(super) turn: Turn,
    pub(super) body: Body,
}
