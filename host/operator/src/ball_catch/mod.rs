//! A ball that an arm catches with a cup: on the simulated cell in virtual time, and over a bus with the eyes of a tracker.
//!
//! ```text
//! thrower's motion ──► TwoArmCell (ball, cups, tracker) ──► datagrams ──► MarkerStream ──► BallWatch ──► forecast
//!        ▲                     ▲                                                                       │
//!   Thrower              joints of the catcher ◄── Executor ◄── motion ◄── planner::catch::Catcher ◄───┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`executor`] | the port behind which a catcher's arm moves; an arm with the lag of its drives |
//! | [`thrower`] | a planned throw as it is executed: scatter, faults |
//! | [`obstacles`] | the thrower, as the catcher keeps clear of it |
//! | [`limits`] | the limits against the joints of both arms as they moved |
//! | [`reported`] | what the catcher reports of its catch |
//! | [`controller_arm`] | an arm behind its controller |
//! | [`wire`] | an arm on its bus, and the tracker's data |
//! | [`on_bus`] | one catch with both |
//! | [`trial`] | one throw from the first run-up to the ball at rest; what was reported and what happened |
//!
//! The cell is the witness: what the catcher reports is compared with where the simulated ball lies.

pub mod controller_arm;
pub mod executor;
pub mod limits;
pub mod obstacles;
pub mod on_bus;
pub mod reported;
pub mod thrower;
pub mod trial;
pub mod wire;
