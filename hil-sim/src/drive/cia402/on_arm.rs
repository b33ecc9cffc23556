//! The servos of `[joint.cia402]` on their arm.

use protocol::Instant;
use robot_model::{Cia402Mode, Cia402Servos};

use super::{CanopenServo, MissingTarget, ServoOptions};
use crate::bus::TxOrder;
use crate::drive::arm::{Arm, ArmMotor, Start};
use crate::mechanics::AxisInput;

/// Code of the emergency of a current that is too high.
const OVER_CURRENT: u16 = 0x2310;

/// Servos whose loops are tuned for the nominal arm: with the stiffness of the drive loop in the robot file.
pub(crate) fn arm(described: &Cia402Servos, start: &Start<'_>) -> Arm {
    let Start { robot, options: cell, q_rad } = start;
    let tuned = cell.mechanics.servo_inertia_kg_m2(robot);
    let (wn_rad_s, damping) =
        robot.drive_loop().map_or((320.0, 0.8), |own| (own.natural_frequency_rad_s, own.damping_ratio));
    Arm::new(described.servos.iter().enumerate().map(|(joint, servo)| {
        let limits = &robot.joints()[joint].limits;
        let delivered = ServoOptions::of(servo.node);
        let delivered = match servo.mode {
            Cia402Mode::CyclicPosition => delivered,
            Cia402Mode::InterpolatedPosition => delivered.interpolating(),
        };
        let options = ServoOptions {
            // A motor encoder with a ratio of 1: a host needs only the product.
            encoder_counts: servo.counts_per_turn,
            gear: 1,
            rated_nm: servo.rated_nm,
            peak_nm: limits.torque_max_nm.unwrap_or(3.0 * servo.rated_nm),
            // Half of the torque is left at the top speed of the joint.
            no_load_rad_s: 2.0 * limits.v_max_rad_s,
            stiffness_nm_rad: tuned[joint] * wn_rad_s * wn_rad_s,
            damping_nms_rad: 2.0 * damping * wn_rad_s * tuned[joint],
            is_absolute: servo.is_absolute,
            missing: if cell.servos_extrapolate { MissingTarget::Extrapolate } else { MissingTarget::Hold },
            gripper_bit: described.output.filter(|own| own.joint == joint).map(|own| own.bit),
            ..delivered
        };
        CanopenServo::new(options, q_rad[joint])
    }))
}

impl ArmMotor for CanopenServo {
    fn input_at(&self, middle: Instant) -> AxisInput {
        self.input_at(middle)
    }

    /// A node has a mailbox for each kind of frame: a heartbeat that waits does not delay process data.
    fn tx_order(&self) -> Option<TxOrder> {
        Some(TxOrder::Priority)
    }

    fn restart(&mut self, now: Instant) {
        self.set_power(now, false);
        self.set_power(now, true);
    }

    fn set_frozen(&mut self, frozen: bool) {
        self.faults_mut().answers_are_stale = frozen;
    }

    fn over_current(&mut self, now: Instant) {
        self.fail(now, OVER_CURRENT);
    }

    fn hand(&self) -> Option<(bool, Instant)> {
        self.gripper()
    }

    fn opens_by_output(&self) -> bool {
        true
    }
}
