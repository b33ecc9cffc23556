//! An industrial robot behind KUKA RSI: the controller in this program, led by the robot's telegrams.
//!
//! ```text
//! outcome   the verdict, from what the robot did
//!   |
//! cell      controller and simulated robot in virtual time; the robot tells where the ball landed
//! udp       the same station behind a socket, in real time
//!    \   /
//! program       what the robot's program must hold, and the station for it
//!    |
//!   station     controller, group and throw: telegrams in, answers out
//!    /   \
//! wire   plan   XML with the names of the user's configuration file; settings and trajectory file of a throw
//! ```

pub mod cell;
pub mod outcome;
pub mod plan;
pub mod program;
pub mod station;
pub mod udp;
pub mod wire;
