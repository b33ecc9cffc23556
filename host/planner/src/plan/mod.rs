//! Throw planner: from a target to the best throw of the arm, or to the reason why there is no throw.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`options`] | the request: form, goal, bounds, margins, limits |
//! | [`problem`] | target, limits and options, validated |
//! | [`bounds`] | search space: the paper's, the robot's, or a requested one |
//! | [`goal`] | the price of a throw that a search minimises: objective (1), energy, or a measure of the landing |
//! | [`paper`] | the paper's eight parameters, release frame, choice of branch |
//! | [`margins`] | margins of a throw to every limit |
//! | `energy` | electrical energy of a throw, with gradient |
//! | `disturbed` | the deviations of one throw |
//! | `landed`, `spread` | landing of a disturbed throw; mean and covariance with gradients |
//! | `layout` | the place of each variable and each row of a throw |
//! | `rows` | objective and constraints with exact gradients |
//! | `cuts`, `scan` | constraints at every instant: their rows, and their worst instants |
//! | `local` | one start |
//! | `warm_start` | which stored throws to try first |
//! | `posture` | postures of the arm at a release: closed form, numerical, or drawn |
//! | `place` | stored throws turned to a target |
//! | `continuation` | stored throws carried to a target in steps |
//! | `optima` | local optima in which the starts ended, and when to stop starting |
//! | [`planner`] | common data of all starts to one target |
//! | [`outcome`] | budget of a search, and its result |
//! | [`relaxation`] | requirements that a search gives up if no throw keeps all limits of the landing's shift |
//! | [`search`] | stored and random starts on all cores |
//! | [`nearest`] | the nearest reachable target, for one that is not |
//! | [`release_delays`] | delays of a measured gripper |
//! | [`opening`] | a disc that the ball passes |
//! | `obstruction` | the body that blocks every posture of the arm |
//! | [`seeds`], [`prepare`] | the stored throws that come with the program, and how tables are made |
//! | [`statistics`] | covariance of the landing, probability of a hit |
//! | [`finger_release`] | the same for a ball that leaves between fingers that open |
//! | [`mod@file`] | the plan file |
//! | [`rng`] | seeded numbers |

pub mod bounds;
mod continuation;
mod cuts;
mod disturbed;
mod energy;
pub mod file;
pub mod finger_release;
pub mod goal;
mod landed;
mod layout;
mod local;
pub mod margins;
pub mod nearest;
mod obstruction;
pub mod opening;
mod optima;
pub mod options;
pub mod outcome;
pub mod paper;
mod place;
pub mod planner;
mod posture;
pub mod prepare;
pub mod problem;
pub mod relaxation;
pub mod release_delays;
pub mod rng;
#[expect(clippy::needless_range_loop, reason = "matrix code reads like its formulas with indices")]
mod rows;
pub mod scan;
pub mod search;
pub mod seeds;
mod spread;
pub mod statistics;
mod warm_start;

pub use crate::throw::{Arm, Joints, Throw};
pub use bounds::Bounds;
pub use local::{Blocked, Found, Nearest};
pub use margins::Margins;
pub use obstruction::Obstruction;
pub use optima::Confidence;
pub use options::{AskedBounds, DelayWindow, Form, Goal, Opening, Options};
pub use outcome::{Best, Budget, NoThrow, Watch};
pub use paper::PaperParameters;
pub use planner::Planner;
pub use problem::{Problem, ProblemError};
pub use relaxation::{GivenUp, Kept, Relaxation};
