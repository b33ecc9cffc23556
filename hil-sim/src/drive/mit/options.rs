//! A motor as it is delivered, and what is wrong with it.

use protocol::mit::{MOTORS, MotorId, MotorType};
use protocol::{Duration, StandardId};

/// A motor as delivered. Torques and speeds at the shaft, behind the gear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MitOptions {
    /// Id to which it listens.
    pub id: MotorId,
    /// Id on which it answers.
    pub master: StandardId,
    /// Ranges and gear ratio.
    pub motor: MotorType,
    /// Continuous torque, N·m.
    pub rated_nm: f64,
    /// Torque that it can give at rest, N·m.
    pub peak_nm: f64,
    /// Speed at which it gives no torque any more, rad/s.
    pub no_load_rad_s: f64,
    /// Inertia of the rotor at the shaft, kg·m².
    pub rotor_kg_m2: f64,
    /// Time without a command after which it gives no torque, in 50 µs; 0: never.
    pub time_out: u32,
    /// Mode in flash: 1 to 4.
    pub mode: u32,
    /// Register 35 in flash: 4 for 1 Mbit/s on classical CAN; 5 to 11 for CAN FD.
    pub bit_rate: u32,
    /// From a command to its answer.
    pub answer_after: Duration,
    /// Position of the zero, rad of the shaft. At power-on it is known within half a turn.
    pub zero_rad: f64,
}

/// Rated and largest torque, speed without load at 24 V, by name; and the inertia of the rotor at the shaft. Only
/// that inertia of the 4340 is published: the others are assumed.
const FIGURES: [(&str, [f64; 4]); 3] =
    [("4310", [3.0, 7.0, 20.9, 0.01]), ("4340", [9.0, 27.0, 5.4, 0.16]), ("8009", [20.0, 40.0, 16.8, 0.03])];

impl MitOptions {
    /// A motor of the makers' table as delivered: MIT mode, no time-out. `None` if its figures are not known.
    pub fn of(name: &str, id: MotorId, master: StandardId) -> Option<Self> {
        let motor = *MOTORS.iter().find(|motor| motor.name == name)?;
        let (_, [rated_nm, peak_nm, no_load_rad_s, rotor_kg_m2]) =
            *FIGURES.iter().find(|(own, _)| *own == name)?;
        Some(Self {
            id,
            master,
            motor,
            rated_nm,
            peak_nm,
            no_load_rad_s,
            rotor_kg_m2,
            time_out: 0,
            mode: 1,
            bit_rate: 4,
            answer_after: Duration::from_micros(150),
            zero_rad: 0.0,
        })
    }
}

/// What is wrong with a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MitFaults {
    /// One answer in this many is not sent; 0: all are sent.
    pub answer_lost_every: u32,
    /// The time-out can be set and read, and nothing happens when it is over.
    pub time_out_is_dead: bool,
    /// Its velocities have a range this many times the one in its register; 0: the range of the register.
    pub velocity_range_factor: f32,
    /// Answers hold the state of the last one before.
    pub answers_are_stale: bool,
}
