//! An industrial robot behind KUKA RSI: the controller in this program, led by the robot's telegrams.
//!
//! ```text
//! operator      the link of a job: it pushes one motion after the other      identify   lag and gripper of a robot
//!   |     \                                                                    /
//!   |      cycles ------------------------------------------------------------     set and measured axes, from the log
//!   v
//! cell      the simulated robot in virtual time; it knows where the ball landed
//! live      a robot behind a socket, by the clock or in step with a simulated robot
//!    \   /
//! program       what the robot's program must hold, and the station for it
//!    |   replay  runs a log again on a station
//!    |    /
//!   station     controller, group and motions: telegrams in, answers out
//!    /   \   \
//!   /     \   log   what went into a station and came out of it
//! wire   plan   XML with the names of the user's configuration file; settings and motion of a throw
//! ```

pub mod cell;
pub mod cycles;
pub mod identify;
mod lag_interval;
pub mod live;
pub mod log;
pub mod operator;
pub mod plan;
pub mod program;
pub mod replay;
pub mod station;
pub mod wire;
