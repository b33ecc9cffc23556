//! Robot arms from TOML: kinematics, dynamics, currents and collision of serial arms with revolute joints.
//!
//! A robot file (`robots/*.toml`) holds everything about a machine. The loader turns it into a [`RobotModel`]; a
//! model exists only if every check has passed. Everything else is a method on it.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | `model` | the validated robot and its parts |
//! | `load` | robot file → model, one function per table; `toml_reader` knows line and key |
//! | `drives` | what moves the joints, a file for each family of drives |
//! | `error` | why a file is refused |
//! | `fingers` | how two fingers grip a ball and open |
//! | [`release`] | how a ball leaves the fingers of a hand that moves |
//! | `pose` | rigid poses `X_AB` |
//! | `kinematics` | frames of all links |
//! | [`jacobian`] | geometric Jacobian, its rate and its gradient, singular values |
//! | `family` | classes of arms with closed-form inverse kinematics, measured from the frames |
//! | `ik_solution` | solutions of inverse kinematics, and the branches they belong to |
//! | `ik` | all closed-form solutions, placed in the joint ranges |
//! | `ik_axis` | solutions for a point and a direction, the roll about the direction left free |
//! | `ik_numeric` | solutions by damped least squares, for arms of any family |
//! | `dynamics` | inverse dynamics with exact derivatives, mass matrix, forward dynamics, energies |
//! | [`cubic`] | the cubic between two states |
//! | `currents` | motor and supply currents |
//! | `boxes` | boxes around the links, and which pairs of them are tested |
//! | [`collision`] | contact and clearance of a configuration, of a whole motion |
//! | [`survey`] | what is missing, assumed or implausible in a robot file |
//! | [`uses`] | what a robot file still needs to simulate and to move drives |
//! | [`urdf`] | export for other tools, import of serial arms as a robot file |
//! | `per_joint` | values of the joints of one arm, on the stack |
//! | [`linalg`] | LU and Cholesky of small square matrices on the stack |
//!
//! # Conventions
//! SI units and radians; a unit at the end of a name (`q_rad`, `v_max_rad_s`) where a reader could doubt. World =
//! arm base, z up. `X_AB` is the pose of B in A. A twist is `[v; ω]`, linear part first. Joint `i` turns about the z
//! axis of joint frame `i`, which is also the frame of link `i`, whatever convention the robot file is written in.
//!
//! # Vectors with a variable number of joints
//! The planner evaluates kinematics and dynamics millions of times, so vectors and matrices live on the stack: they have room
//! for [`JOINTS_MAX`] joints, and know how many there are ([`PerJoint`], [`linalg::SquareMatrix`]). A vector has the length of
//! the arm that it is used with; debug builds check it.

#![warn(missing_docs)]

mod boxes;
pub mod collision;
pub mod cubic;
mod currents;
mod drives;
mod dynamics;
mod error;
mod family;
mod fingers;
mod ik;
mod ik_axis;
mod ik_numeric;
mod ik_solution;
pub mod jacobian;
mod kinematics;
pub mod linalg;
mod load;
mod mat3;
mod model;
mod per_joint;
mod pose;
pub mod release;
pub mod survey;
pub mod urdf;
pub mod uses;

pub use drives::*;
pub use dynamics::InverseDynamicsGradient;
pub use error::{FamilyMismatch, LoadError, Problem};
pub use family::{Family, OrthoParallel, TurntablePlanar};
pub use fingers::{Deviation, FingerScatter, Fingers};
pub use ik::{NoClosedForm, RANGE_SLACK_RAD};
pub use ik_axis::AxisTool;
pub use ik_numeric::radical_inverse;
pub use ik_solution::{Branch, IkSolution, IkSolutions};
pub use jacobian::Jacobian;
pub use kinematics::Frames;
pub use load::{SCHEMA_VERSION, built_in_robots, built_in_text, text_of};
pub use model::{DriveLoop, Gripper, Joint, JointLimits, Link, LinkInertia, RobotModel, Supply, World};
pub use per_joint::{JOINTS_MAX, JointVec, PerJoint};
pub use pose::Pose;
