//! The motors of `[joint.mit]` and `[gripper.mit]` on their arm.

use protocol::Instant;
use protocol::mit::{DATA_RATES, Status};
use robot_model::{MitMotor as Described, MitMotors};

use super::{MitMotor, MitOptions};
use crate::drive::arm::{Arm, ArmMotor, Start};
use crate::participants::BusConnection;

/// Motors at rest, as classical ones are delivered, or set to CAN FD.
pub(crate) fn arm(described: &MitMotors, start: &Start<'_>) -> Result<Arm, String> {
    let rate = described.data_bit_rate_bit_s.and_then(|fd| DATA_RATES.iter().find(|(_, bit_s)| *bit_s == fd));
    let motor_of = |described: &Described, q_rad: f64| {
        let name = described.motor.name;
        let options = MitOptions::of(name, described.id, described.answers_on).ok_or_else(|| {
            format!("no figures for motor '{name}': the simulated ones are 4310, 4340 and 8009")
        })?;
        let bit_rate = rate.map_or(options.bit_rate, |(code, _)| *code);
        Ok::<_, String>(MitMotor::new(
            MitOptions { rotor_kg_m2: described.rotor_kg_m2, bit_rate, ..options },
            q_rad,
        ))
    };
    let joints = described.joints.iter().zip(&start.q_rad).map(|(motor, q_rad)| motor_of(motor, *q_rad));
    let arm = Arm::new(joints.collect::<Result<Vec<_>, _>>()?);
    Ok(match described.gripper {
        Some(own) => {
            let motor = motor_of(&own.motor, own.travel.closed_rad)?;
            arm.with_fingers(motor, own.motor.rotor_kg_m2, own.travel)
        }
        None => arm,
    })
}

impl ArmMotor for MitMotor {
    /// Those of a classical arm are set to the rate of its bus.
    fn connection(&self, bit_s: u32, fd_bit_s: Option<u32>) -> BusConnection {
        if fd_bit_s.is_some() { self.link(bit_s, fd_bit_s) } else { BusConnection::On }
    }

    fn restart(&mut self, _now: Instant) {
        self.set_power(false);
        self.set_power(true);
    }

    fn set_frozen(&mut self, frozen: bool) {
        self.faults_mut().answers_are_stale = frozen;
    }

    fn over_current(&mut self, _now: Instant) {
        self.fail(Status::OverCurrent);
    }
}
