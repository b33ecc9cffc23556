//! Motors on one bus, each with its own inertia at its shaft, to test clients of such motors.

use std::borrow::Cow;

use protocol::{Duration, Frame, Instant, Node};

use crate::mechanics::{AxisInput, AxisState};
use crate::participants::Participants;

/// Grid of the mechanics.
const STEP: Duration = Duration::from_micros(100);

/// A motor that a shaft can be put on.
pub trait ShaftMotor: Node {
    /// Kind and number, for people.
    fn name(&self) -> String;

    /// Where the shaft stands, rad.
    fn q_rad(&self) -> f64;

    /// What its power stage does in a step of the mechanics.
    fn input(&self) -> AxisInput;

    /// Takes its axis after a step of `dt_s`.
    fn tick(&mut self, axis: AxisState, dt_s: f64);
}

/// Motors without an arm.
#[derive(Clone, Debug)]
pub struct Bench<M> {
    motors: Vec<M>,
    axes: Vec<AxisState>,
    names: Vec<String>,
    inertia_kg_m2: f64,
    grid: Instant,
}

impl<M: ShaftMotor> Bench<M> {
    /// Motors at rest where they stand; `inertia_kg_m2` is at each shaft, rotor included.
    pub fn new(motors: Vec<M>, inertia_kg_m2: f64) -> Self {
        Self {
            axes: motors.iter().map(|m| AxisState { q_rad: m.q_rad(), ..AxisState::default() }).collect(),
            names: motors.iter().map(ShaftMotor::name).collect(),
            motors,
            inertia_kg_m2,
            grid: Instant::ZERO,
        }
    }

    pub fn motors_mut(&mut self) -> &mut [M] {
        &mut self.motors
    }
}

/// One step of a shaft with this inertia under what its motor does.
pub(crate) fn turn(axis: &mut AxisState, input: &AxisInput, inertia_kg_m2: f64, dt_s: f64) {
    // Velocity at the end of the step: stiff gains need no smaller one.
    let (k, d) = (input.stiffness_nm_rad, input.damping_nms_rad);
    let pull_nm = input.torque_nm + k * (input.reference_rad - axis.q_rad);
    let wanted_v_rad_s =
        (inertia_kg_m2 * axis.v_rad_s + dt_s * pull_nm) / (inertia_kg_m2 + dt_s * d + dt_s * dt_s * k);
    let wanted_nm = (wanted_v_rad_s - axis.v_rad_s) * inertia_kg_m2 / dt_s;
    let most_nm = input.limit_nm(wanted_nm, axis.v_rad_s);
    let torque_nm = wanted_nm.clamp(-most_nm, most_nm);
    axis.v_rad_s += torque_nm / inertia_kg_m2 * dt_s;
    axis.q_rad += axis.v_rad_s * dt_s;
    axis.drive_torque_nm = torque_nm;
    axis.saturated = torque_nm != wanted_nm;
}

impl<M: ShaftMotor> Participants for Bench<M> {
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
                turn(axis, &motor.input(), self.inertia_kg_m2, dt_s);
                motor.tick(*axis, dt_s);
            }
            self.grid += STEP;
        }
    }

    fn accepts(&self, _index: usize, frame: &Frame) -> bool {
        !frame.is_extended()
    }
}
