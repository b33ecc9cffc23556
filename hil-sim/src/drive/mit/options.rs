//! A motor as it is delivered, and what is wrong with it.

use mit_protocol::{MotorId, MotorType};
use protocol::{Duration, StandardId};

/// A motor as it is delivered. Torques and speeds at the shaft, behind the gear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MitOptions {
    /// Id to which it listens.
    pub id: MotorId,
    /// Id on which it answers.
    pub master: StandardId,
    /// Ranges and gear.
    pub motor: MotorType,
    /// Torque that it can give for ever, N·m.
    pub rated_nm: f64,
    /// Torque that it can give at rest, N·m.
    pub peak_nm: f64,
    /// Speed at which it gives no torque any more, rad/s.
    pub no_load_rad_s: f64,
    /// Inertia of the rotor behind the gear, kg·m².
    pub rotor_kg_m2: f64,
    /// Time without a command after which it gives no torque, in 50 µs; 0: never.
    pub time_out: u32,
    /// Mode in flash: 1 to 4.
    pub mode: u32,
    /// From a command to its answer.
    pub answer_after: Duration,
    /// Where the zero lies, rad of the shaft. A turn is known within half of one at power-on.
    pub zero_rad: f64,
}

/// What is wrong with a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MitFaults {
    /// Every so many answers one stays away; 0: none.
    pub answer_lost_every: u32,
    /// The time-out is a number that nothing acts on.
    pub time_out_is_dead: bool,
    /// It counts velocities with a range this many times the one in its register; 0: as the register says.
    pub velocity_range_factor: f32,
    /// Answers hold the state of the first one.
    pub answers_are_stale: bool,
}
