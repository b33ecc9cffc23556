//! Joint angles, speeds and accelerations that put the hand where it belongs.

use nalgebra::Vector6;
use robot_model::{Family, Pose};

use super::hand::HandState;
use super::limits::{Arm, Axes};

/// Joints at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posture {
    /// Angles in rad.
    pub q: Axes,
    /// Speeds in rad/s.
    pub qd: Axes,
    /// Accelerations in rad/s².
    pub qdd: Axes,
}

/// Inverse kinematics of the ball frame: closed form where the arm has one, else by iteration.
#[derive(Debug, Clone, Copy)]
pub struct Reach<'m> {
    arm: &'m Arm,
    x_be: Pose,
    closed: bool,
}

/// Starts of the numerical search for all postures of one pose.
const NUMERIC_STARTS: usize = 48;

impl<'m> Reach<'m> {
    #[must_use]
    pub fn new(arm: &'m Arm) -> Self {
        let closed = !matches!(arm.family(), Family::General);
        Self { arm, x_be: arm.gripper().x_eb.inverse(), closed }
    }

    #[must_use]
    pub fn arm(&self) -> &'m Arm {
        self.arm
    }

    /// All postures inside the joint ranges for a pose of the ball frame.
    #[must_use]
    pub fn all(&self, x_wb: &Pose) -> Vec<Axes> {
        let x_we = *x_wb * self.x_be;
        match self.arm.ik(&x_we) {
            Ok(solutions) => solutions.in_range().filter(|s| !s.singular).map(|s| s.q).collect(),
            Err(_) => self.arm.ik_search(&x_we, NUMERIC_STARTS),
        }
    }

    /// The posture next to `q_ref`, which must be near: a step along a path. Ranges are not applied.
    #[must_use]
    pub fn near(&self, x_wb: &Pose, q_ref: &Axes) -> Option<Axes> {
        let x_we = *x_wb * self.x_be;
        if !self.closed {
            return self.arm.ik_from(&x_we, q_ref);
        }
        self.arm.ik_next(&x_we, q_ref).ok()?
    }

    /// Speeds by the inverse Jacobian (paper 000, equation 5) and accelerations; `None` at a singular posture.
    #[must_use]
    pub fn rates(&self, q: Axes, hand: &HandState) -> Option<Posture> {
        let frames = self.arm.fk(&q);
        let jacobian = frames.jacobian(&hand.x_wb.pos);
        let inverse = jacobian.lu()?;
        let qd = inverse.solve(&hand.twist.into());
        let bias: Vector6<f64> = frames.bias_acceleration(&jacobian, &qd);
        Some(Posture { q, qd, qdd: inverse.solve(&(hand.twist_rate - bias).into()) })
    }
}

/// Largest distance of the ball from the first joint, by the lengths of the links, in m.
#[must_use]
pub fn reach_m(arm: &Arm) -> f64 {
    let links: f64 = arm.joints().iter().skip(1).map(|j| j.x_pj.pos.norm()).sum();
    links + (*arm.end_effector() * arm.gripper().x_eb).pos.norm()
}
