//! Robot arms from TOML: kinematics, dynamics, currents and collision of serial arms with revolute joints.
//!
//! A robot file (`robots/*.toml`) holds everything about a machine; the loader turns it into a
//! [`RobotModel`], whose existence is the proof that every check passed. Everything else is a method on it.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | `model` | the validated robot and its parts |
//! | `load` | robot file → model, one function per table; `toml_reader` knows line and key |
//! | `error` | why a file is refused |
//! | `pose` | rigid poses `X_AB` |
//! | `kinematics` | frames of all links |
//! | [`jacobian`] | geometric Jacobian, its rate and its gradient, singular values |
//! | `family` | classes of arms with closed-form inverse kinematics, measured from the frames |
//! | `ik` | all solutions with their branches, placed in the joint ranges |
//! | `ik_numeric` | solutions by damped least squares, for arms of any family |
//! | `dynamics` | inverse dynamics with exact derivatives, mass matrix, forward dynamics, energies |
//! | `currents` | motor and supply currents |
//! | [`collision`] | boxes, pairs |
//! | [`urdf`] | export for other tools, import of serial arms as a robot file |
//! | [`linalg`] | LU and Cholesky of `N × N` matrices on the stack |
//!
//! # Conventions
//! SI units and radians; a unit at the end of a name (`q_rad`, `v_max_rad_s`) where a reader could doubt. World =
//! arm base, z up. `X_AB` is the pose of B in A. A twist is `[v; ω]`, linear part first. Joint `i` turns about the z
//! axis of joint frame `i`, which is also the frame of link `i`, whatever convention the robot file is written in.
//!
//! # Why `RobotModel<N>` with the number of joints in the type
//! The planner evaluates kinematics and dynamics millions of times, so vectors and matrices must live on the stack
//! with loops the compiler can unroll: `N` is a const parameter. Programs that take any robot file ask
//! [`AnyRobot`] first, which dispatches on the number of joints once.

#![warn(missing_docs)]

mod any;
pub mod collision;
mod currents;
mod dynamics;
mod error;
mod family;
mod ik;
mod ik_numeric;
pub mod jacobian;
mod kinematics;
pub mod linalg;
mod load;
mod mat3;
mod model;
mod pose;
pub mod urdf;

pub use any::AnyRobot;
pub use dynamics::InverseDynamicsGradient;
pub use error::{FamilyMismatch, LoadError, Problem};
pub use family::{Family, OrthoParallel, TurntablePlanar};
pub use ik::{Branch, IkSolution, IkSolutions, NoClosedForm, RANGE_SLACK_RAD};
pub use ik_numeric::radical_inverse;
pub use jacobian::Jacobian;
pub use kinematics::Frames;
pub use load::{SCHEMA_VERSION, built_in_robots, built_in_text};
pub use model::{
    Drive, DriveLoop, Gripper, Joint, JointLimits, JointVec, Link, LinkInertia, RobotModel, Supply, World,
};
pub use pose::Pose;
