//! One arm throws, the other catches, in virtual time.
//!
//! ```text
//! thrower's motion ──► Court (ball, cups, tracker) ──► datagrams ──► MarkerStream ──► BallWatch ──► forecast
//!        ▲                     ▲                                                                       │
//!   Thrower              joints of the catcher ◄── Executor ◄── motion ◄── planner::catch::Catcher ◄───┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`executor`] | the port behind which a catcher's arm moves; an arm with the lag of its drives |
//! | [`on_controller`] | the arm behind its controller: simulated drives on a simulated bus |
//! | [`thrower`] | a planned throw as it is executed: scatter, faults |
//! | [`throws`] | throws for trials, drawn
//! | [`trial`] | one throw from the first run-up to the ball at rest; what was told and what happened |
//! | [`study`] | many trials: shares with intervals, by flight time and by fault |
//! | [`exchange`] | throw, catch, throw back |
//!
//! The court is the witness: what the catcher believes is compared with where the simulated ball lies.

pub mod exchange;
pub mod executor;
pub mod on_controller;
pub mod study;
pub mod thrower;
pub mod throws;
pub mod trial;
