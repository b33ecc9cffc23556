//! Physics: mechanics, supplies, flight of the ball. Knows no bus.
//!
//! # The model
//!
//! ```text
//! M(q) q̈ + C(q, q̇) q̇ + g(q) + B q̈ = τ - b q̇ - f - s
//!
//! q     joint angles, rad                         M    mass matrix of the links, kg·m²
//! C, g  Coriolis and centrifugal, gravity, N·m    B    rotor and gear inertia through the gear, kg·m² (diagonal)
//! τ     torque of the drives at the joint, N·m    b    viscous friction, N·m·s/rad
//! f     Coulomb friction and brake, N·m, |f| <= F s    end stops, N·m
//!
//! I_j = K_B |q̇_j| + K_M |M q̈ + C q̇ + g|_j          motor current, A: eq. (9) of the throwing paper
//! ```
//!
//! The torque in eq. (9) is that of the links, as published: friction and rotor are in K_B, which was measured on
//! motors running free. Torque against an obstacle, an end stop or the brake counts like that of the links. The
//! torque *limit* acts on all of τ.
//!
//! # Not in a robot file, chosen here ([`options::MechanicsOptions`])
//!
//! | what | value | why |
//! |---|---|---|
//! | rotor inertia B | 0.2 τ_max / q̈_control | a fifth of the peak torque accelerates the rotor alone; 4.0 kg·m² for a PR-090, what a rotor of 1.5e-4 kg·m² is behind 161:1 |
//! | inertia the servo is tuned for | B + M_jj in the middle of the ranges | a module is tuned once |
//! | Coulomb friction | robot file's deceleration × that inertia | |
//! | viscous friction | 2 % of τ_max at the largest velocity | |
//! | brake | 1.5 τ_max | holds what the gear can give |
//! | end stops | 5 degrees beyond the range, 20 kN·m/rad | |
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | [`plant`] | what drives and mechanics say to each other: the [`Plant`] contract |
//! | `solver` | one implicit step of all joints |
//! | [`arm`] | [`Mechanism`]: robot file or bench behind [`Plant`] |
//! | [`joint`], [`options`] | rotor, friction, brake, stops, gear; how they follow from a robot file |
//! | [`supply`] | 24 V supplies |
//! | [`gripper`], [`ball`] | release and flight |
//! | [`loose`], [`cup`] | a ball that bounces; an open cup that it may fall into |
//! | [`perturb`] | deviations from the model, by seed |

pub mod arm;
pub mod ball;
pub mod cup;
pub mod gripper;
pub mod joint;
pub mod loose;
pub mod options;
pub mod perturb;
pub mod plant;
mod solver;
pub mod supply;

pub use arm::{Body, Mechanism};
pub use ball::{Flight, Landing, Plane};
pub use cup::Cup;
pub use gripper::{Gripper, GripperOptions};
pub use joint::{Elasticity, JointMechanics};
pub use loose::{BallOptions, LooseBall, Surface};
pub use options::MechanicsOptions;
pub use perturb::Scatter;
pub use plant::{AxisInput, AxisState, Energy, HandPoint, Plant, PlantFault, Touch};
pub use supply::{Supply, SupplyOptions};
