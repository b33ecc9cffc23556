//! A throw as a job on a bus: sessions, dialogue with drives and controllers, recordings, analysis of a run.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! rsi                                  an industrial robot behind its sensor interface, and its throw
//!   |
//!   v
//! throw                 identify       jobs: from a plan to where the ball landed; measuring a drive
//!   |    \                /
//!   |     v              v
//!   |    dialogue ------------------   questions to drives, orders to a controller
//!   |        |
//!   v        v
//! analysis  bus                        a recorded run against its plan; sessions in virtual and real time
//!      \    /  \
//!       v  v    v
//!       log    node                    recordings, and what their frames say; the host's node, without IO
//!        |
//!        v
//!       tap                            who sees the frames of a session
//! ```

pub mod analysis;
pub mod bus;
pub mod dialogue;
pub mod identify;
pub mod log;
pub mod node;
pub mod rsi;
pub mod tap;
pub mod throw;
