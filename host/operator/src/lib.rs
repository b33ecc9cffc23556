//! A throw as a job on a bus: sessions, dialogue with drives and controllers, recordings, analysis of a run.
//!
//! # Map
//! An arrow goes from user to used; none goes up.
//!
//! ```text
//! ball_catch                           a ball that an arm catches with a cup, on the simulated cell
//!   |
//!   v
//! disc  servo  flight_estimator        a catch of a disc as a run of a controller; a stream of commands; a ball seen by a tracker
//!   |
//!   v
//! job    tracker      identify         the job: move to the start, upload, run, follow, judge; targets from an optical tracker; measuring a drive
//!   |   \                 |
//!   |    port             |            the links of a job: on a bus, in this program
//!   |     |  \            |
//!   |     |   rsi         |            an industrial robot behind its sensor interface, and the link to it
//!   |     |     \         |
//!   |     |         trajectory         motions as files of a controller
//!   |     v               v
//!   |     dialogue ------------------  requests to drives, orders to a controller
//!   |        |
//!   v        v
//! analysis  bus   live                 a run against its plan; sessions in virtual and real time; the live view of a bus
//!   |       /  \  |
//!   v      /    \ |
//! samples /      \|                    measurements and reports of a run, for every link
//!      \ /        \
//!       v          v
//!       log       node                 recordings, and the content of their frames; the host's node, without IO
//!        |
//!        v
//!   tap  machine  interrupt  eds  drives   who sees the frames of a session; the arm as viewers need it; signals that ask the
//!                                          program to end; data sheets of CANopen nodes; the families of drives on CAN
//! ```

pub mod analysis;
pub mod ball_catch;
pub mod bus;
pub mod dialogue;
pub mod disc;
pub mod drives;
pub mod eds;
pub mod flight_estimator;
pub mod identify;
pub mod interrupt;
pub mod job;
pub mod live;
pub mod log;
pub mod machine;
pub mod node;
pub mod port;
pub mod rsi;
pub mod samples;
pub mod servo;
pub mod tap;
pub mod tracker;
pub mod trajectory;
