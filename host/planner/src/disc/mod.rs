//! Catching a flying disc with a four-axis arm (paper 001).
//!
//! Map:
//! - [`arm`]: the arm and its gripper, closed-form positions, Jacobian of eq. (5) and its roll-pitch-yaw equivalent.
//! - [`screws`]: the same kinematics by product of exponentials, a second formulation.
//! - [`inverse`]: Levenberg-Marquardt inverse kinematics, full (6)-(11) and reduced (12)-(13).
//! - [`mod@throw`]: a thrown disc, and the two throws of the paper.
//! - [`paper`]: the four stages of the paper, step by step, without limits.
//! - [`flight`]: flight of a disc: parabola, or spinning disc with lift, drag and wind ([`aero`] holds the coefficients).
//! - [`estimate`]: flight estimated from noisy views of centre and normal.
//! - [`motion`]: joint motion under speed, acceleration and jerk limits.
//! - [`intercept`]: where and when to catch under limits; declines with a reason.
//! - [`online`]: a catch in progress: views in, motion out.
//! - [`witness`]: the observer; judges a catch from joint angles and the disc alone.
//!
//! SI units and radians. The paper prints centimetres.

pub mod aero;
pub mod arm;
pub mod estimate;
pub mod flight;
pub mod intercept;
pub mod inverse;
pub mod motion;
pub mod online;
pub mod paper;
pub mod screws;
pub mod throw;
pub mod witness;

/// Joint angles, speeds or accelerations of the four axes.
pub type Joints = nalgebra::Vector4<f64>;
/// Twist of the hand by the speeds of four joints.
pub type HandJacobian = nalgebra::SMatrix<f64, 6, 4>;
