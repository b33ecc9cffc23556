//! One arm throws, the other catches: in virtual time, and over two buses.
//!
//! | module | holds |
//! |---|---|
//! | [`throws`] | throws for trials, drawn |
//! | [`exchange`] | throw, catch, throw back |
//! | [`on_wire`] | both arms behind their controllers on buses of their own, and a tracker |
//! | [`study`] | many trials: shares with intervals, by flight time and by fault |
//! | [`degraded`] | what can go wrong, one fault at a time |
//! | [`waiting`] | where the catcher waits, found for throws of a kind |
//! | [`placing`] | search for the poses of the bases |
//! | [`failures`] | why a ball was not caught, one throw at a time |
//! | [`calibration`] | predicted probabilities against what came of them |
//! | [`estimator`] | errors of the flight estimator against their bound |
//!
//! One throw and its catch are in `operator::ball_catch`.

pub mod calibration;
pub mod degraded;
pub mod estimator;
pub mod exchange;
pub mod failures;
pub mod on_wire;
pub mod placing;
pub mod study;
pub mod throws;
pub mod waiting;
