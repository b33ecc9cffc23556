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
//! | [`on_wire`] | both arms behind their controllers on buses of their own, and a tracker, in real time |
//! | [`thrower`] | a planned throw as it is executed: scatter, faults |
//! | [`throws`] | throws for trials, drawn |
//! | [`obstacles`] | the thrower, as the catcher keeps clear of it |
//! | [`limits`] | the limits against the joints of both arms as they moved |
//! | [`told`] | what the catcher tells about its catch |
//! | [`trial`] | one throw from the first run-up to the ball at rest; what was told and what happened |
//! | [`failures`] | why a ball was not caught, one throw at a time |
//! | [`calibration`] | predicted probabilities against what came of them |
//! | [`waiting`] | where the catcher waits, found for throws of a kind |
//! | [`study`] | many trials: shares with intervals, by flight time and by fault |
//! | [`degraded`] | what can go wrong, one fault at a time |
//! | [`estimator`] | errors of the flight estimator against their bound |
//! | [`exchange`] | throw, catch, throw back |
//!
//! The court is the witness: what the catcher believes is compared with where the simulated ball lies.

pub mod calibration;
pub mod degraded;
pub mod estimator;
pub mod exchange;
pub mod executor;
pub mod failures;
pub mod limits;
pub mod obstacles;
pub mod on_controller;
pub mod on_wire;
pub mod study;
pub mod thrower;
pub mod throws;
pub mod told;
pub mod trial;
pub mod waiting;
