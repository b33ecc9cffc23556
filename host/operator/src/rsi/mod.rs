//! An industrial robot behind KUKA RSI: the controller in this program, led by the robot's telegrams.
//!
//! ```text
//! outcome   the verdict, from what the robot did or from what it measured
//!   |   \             identify   lag and gripper of a robot
//!   |    \              /
//!   |     cycles -------     set and measured axes, from the log
//!   v
//! cell      controller and simulated robot in virtual time; the robot tells where the ball landed
//! live      the same station behind a socket, by the clock or in step with a simulated robot
//!    \   /
//! program       what the robot's program must hold, and the station for it
//!    |   replay  runs a log again on a station
//!    |    /
//!   station     controller, group and throw: telegrams in, answers out
//!    /   \   \
//!   /     \   log   what went into a station and came out of it
//! wire   plan   XML with the names of the user's configuration file; settings and trajectory file of a throw
//! ```

pub mod cell;
pub mod cycles;
pub mod identify;
mod lag_interval;
pub mod live;
pub mod log;
pub mod outcome;
pub mod plan;
pub mod program;
pub mod replay;
pub mod station;
pub mod wire;
