//! Feedback gains with a certificate (paper 002 section V).
//!
//! | file | holds |
//! |---|---|
//! | [`machine`] | robot model and motion → data per joint |
//! | [`problem`] | data of one joint, checked |
//! | `lmi` | matrix inequalities as data, and why there is no solution |
//! | `interior` | their solution, an interior-point method |
//! | `rigor` | definiteness proven with rounding bounds |
//! | `paper` | design A: Theorem 1, continuous, with `Q >= I` added |
//! | `law` | the saturated law: gains, weights, scaled coordinates |
//! | [`saturated`] | design B: sampled, delay and lag as states, saturation certified |
//! | `region` | its semidefinite program for one phase of the motion |
//! | `certificate` | the claims of design B, and their check |
//! | `evidence` | the saturated loop simulated from the certified region |
//! | [`lqr`] | plain LQR, to compare with |
//! | `margins` | eigenvalues, delay margin, sensitivity |
//! | [`plant`], [`compare`] | joint with friction and encoder following a throw |
//! | [`trial`] | gains on the simulated cell with the firmware's controller |
//! | [`design`] | one joint, all of the above |
//! | [`gains_file`] | `gains.toml`, proven again when read |
//! | [`choose`] | gains for a robot at a period: built in, or designed on the way |
//! | [`picture`] | curves of a tuned joint to draw |
//!
//! What the certificate of design B covers: the firmware's law as it runs, that is its estimator with its weights, gains as
//! the f32 it holds, the clip to what the reference leaves, the command that acts a delay later, the drive's position loop,
//! every period and delay of the stated ranges, changing from cycle to cycle. What it does not: friction, positions in
//! steps of 0.02 degrees, the velocity limit of the ramp generator, lost replies, torque limits and coupling between joints,
//! the time in which the firmware blends new gains in, and f32 rounding of the law itself. Those are in [`trial`] only.
//!
//! Only `rigor` and the two checks must be trusted. Solver, search and simulation only propose.

mod certificate;
pub mod choose;
pub mod compare;
pub mod design;
mod evidence;
pub mod gains_file;
mod interior;
#[cfg(test)]
mod interior_tests;
mod law;
mod lmi;
pub mod lqr;
pub mod machine;
mod margins;
mod paper;
pub mod picture;
pub mod plant;
pub mod problem;
mod region;
mod rigor;
pub mod saturated;
#[cfg(test)]
mod saturated_tests;
pub mod trial;
