//! Motors on one bus, each with an inertia of its own at its shaft: what clients of such motors are tried with.

use std::borrow::Cow;

use protocol::{Duration, Frame, Instant, Node};

use super::{MitMotor, MitOptions};
use crate::mechanics::AxisState;
use crate::participants::Participants;

/// Grid of the mechanics.
const STEP: Duration = Duration::from_micros(100);

/// Motors without an arm.
#[derive(Clone, Debug)]
pub struct MitBench {
    motors: Vec<MitMotor>,
    axes: Vec<AxisState>,
    names: Vec<String>,
    inertia_kg_m2: f64,
    grid: Instant,
}

impl MitBench {
    /// Motors at rest at their zeros; `inertia_kg_m2` is at each shaft, rotor included.
    pub fn new(options: &[MitOptions], inertia_kg_m2: f64) -> Self {
        Self {
            motors: options.iter().map(|options| MitMotor::new(*options, options.zero_rad)).collect(),
            axes: options.iter().map(|o| AxisState { q_rad: o.zero_rad, ..AxisState::default() }).collect(),
            names: options
                .iter()
                .map(|options| format!("{} at {}", options.motor.name, options.id))
                .collect(),
            inertia_kg_m2,
            grid: Instant::ZERO,
        }
    }

    /// The motors, as they were given.
    pub fn motors_mut(&mut self) -> &mut [MitMotor] {
        &mut self.motors
    }
}

impl Participants for MitBench {
    fn len(&self) -> usize {
        self.motors.len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        &mut self.motors[index]
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        Cow::Borrowed(&self.names[index])
    }

    fn advance(&mut self, to: Instant) {
        let dt_s = STEP.as_secs_f64();
        while self.grid + STEP <= to {
            for (motor, axis) in self.motors.iter_mut().zip(&mut self.axes) {
                let input = motor.input();
                // Velocity at the end of the step: stiff gains need no smaller one.
                let (k, d) = (input.stiffness_nm_rad, input.damping_nms_rad);
                let pull_nm = input.torque_nm + k * (input.reference_rad - axis.q_rad);
                let wanted_v_rad_s = (self.inertia_kg_m2 * axis.v_rad_s + dt_s * pull_nm)
                    / (self.inertia_kg_m2 + dt_s * d + dt_s * dt_s * k);
                let wanted_nm = (wanted_v_rad_s - axis.v_rad_s) * self.inertia_kg_m2 / dt_s;
                let torque_nm = wanted_nm.clamp(-input.torque_max_nm, input.torque_max_nm);
                axis.v_rad_s += torque_nm / self.inertia_kg_m2 * dt_s;
                axis.q_rad += axis.v_rad_s * dt_s;
                axis.drive_torque_nm = torque_nm;
                axis.saturated = torque_nm != wanted_nm;
                motor.tick(*axis, dt_s);
            }
            self.grid += STEP;
        }
    }

    fn accepts(&self, _index: usize, frame: &Frame) -> bool {
        !frame.is_extended()
    }
}
