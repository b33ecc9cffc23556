//! The axes of `[joint.odrive]` and `[gripper.odrive]` on their arm.

use protocol::{Duration, Instant};
use robot_model::{OdriveAxes, OdriveAxis as Described, OdriveEndpoints};

use super::{OdriveAxis, OdriveOptions};
use crate::drive::arm::{Arm, ArmMotor, Start};

/// Time without a frame after which an axis gives no torque.
const WATCHDOG: Duration = Duration::from_millis(50);
/// Code of a current that is too high, of an axis of 0.6.
const OVER_CURRENT: u32 = 0x1000;

/// Axes at rest, configured as `docs/moving.md` says: their watchdog is on, estimates come when they are asked for.
pub(crate) fn arm(described: &OdriveAxes, start: &Start<'_>) -> Arm {
    let axis_of = |axis: &Described, q_rad: f64| axis_of(axis, described.endpoints, q_rad);
    let arm = Arm::new(described.axes.iter().zip(&start.q_rad).map(|(axis, q_rad)| axis_of(axis, *q_rad)));
    match &described.gripper {
        Some(own) => {
            let motor = axis_of(&own.axis, own.travel.closed_rad);
            arm.with_fingers(motor, own.axis.rotor_kg_m2, own.travel)
        }
        None => arm,
    }
}

fn axis_of(described: &Described, endpoints: Option<OdriveEndpoints>, q_rad: f64) -> OdriveAxis {
    let delivered = OdriveOptions::new(described.node, described.version);
    let options = OdriveOptions {
        gear: described.gear_ratio,
        counted: described.counted(),
        torque_nm_a: described.torque_nm_a,
        current_max_a: described.current_max_a,
        brakes: described.brake,
        watchdog: Some(WATCHDOG),
        estimates: None,
        firmware: endpoints.map_or(delivered.firmware, |own| own.firmware),
        endpoints: endpoints.map(|own| own.numbers),
        ..delivered
    };
    OdriveAxis::new(options, q_rad)
}

impl ArmMotor for OdriveAxis {
    fn restart(&mut self, now: Instant) {
        self.set_power(now, false);
        self.set_power(now, true);
    }

    fn set_frozen(&mut self, frozen: bool) {
        self.faults_mut().estimates_are_stale = frozen;
    }

    fn over_current(&mut self, _now: Instant) {
        self.fail(OVER_CURRENT);
    }
}
