//! The motors of an arm that are no PowerCubes: one for each joint, and perhaps one for the fingers.

use std::any::Any;

use protocol::Instant;
use robot_model::{FingerTravel, RobotModel};

use super::bench::{ShaftMotor, turn};
use crate::bus::TxOrder;
use crate::cell::CellOptions;
use crate::fault::PhysicalFault;
use crate::mechanics::{AxisInput, AxisState};
use crate::participants::BusConnection;

/// What a motor does on the joint of an arm, beside turning a shaft.
pub(crate) trait ArmMotor: ShaftMotor + Any {
    /// What its power stage does around `middle`, the middle of a step.
    fn input_at(&self, _middle: Instant) -> AxisInput {
        self.input()
    }

    /// Its link to a bus of these rates, bits per second.
    fn connection(&self, _bit_s: u32, _fd_bit_s: Option<u32>) -> BusConnection {
        BusConnection::On
    }

    /// Order of its frames that wait, if it differs from that of the bus.
    fn tx_order(&self) -> Option<TxOrder> {
        None
    }

    /// Switches the power off and on.
    fn restart(&mut self, now: Instant);

    /// Begins or ends answers that do not follow the shaft any more.
    fn set_frozen(&mut self, frozen: bool);

    /// Too much current: no torque until the fault is cleared.
    fn over_current(&mut self, now: Instant);

    /// Whether its output has the hand open, and since when; `None`: the hand hangs on no output of it.
    fn hand(&self) -> Option<(bool, Instant)> {
        None
    }

    /// An output opens the hands of such arms, after the delay of the gripper; else a motor moves the fingers.
    fn opens_by_output(&self) -> bool {
        false
    }
}

pub(crate) struct Start<'a> {
    pub(crate) robot: &'a RobotModel,
    pub(crate) options: &'a CellOptions,
    /// Positions that the drives of the joints report at the start, rad.
    pub(crate) q_rad: Vec<f64>,
}

/// The motors in joint order, the one of the fingers last.
pub(crate) struct Arm {
    pub(crate) motors: Vec<Box<dyn ArmMotor>>,
    fingers: Option<Fingers>,
}

/// Fingers with the inertia of their motor's rotor. The ball is free as soon as they are open by [`FingerTravel::FREE_SHARE`].
struct Fingers {
    axis: AxisState,
    rotor_kg_m2: f64,
    travel: FingerTravel,
    is_open: bool,
    changed: Instant,
}

impl Arm {
    /// Without a motor for the fingers.
    pub(crate) fn new(joints: impl IntoIterator<Item = impl ArmMotor>) -> Self {
        let motors = joints.into_iter().map(|motor| Box::new(motor) as Box<dyn ArmMotor>);
        Self { motors: motors.collect(), fingers: None }
    }

    /// With the motor of the fingers, which are closed.
    pub(crate) fn with_fingers(
        mut self,
        motor: impl ArmMotor,
        rotor_kg_m2: f64,
        travel: FingerTravel,
    ) -> Self {
        let axis = AxisState { q_rad: travel.closed_rad, ..AxisState::default() };
        self.motors.push(Box::new(motor));
        self.fingers = Some(Fingers { axis, rotor_kg_m2, travel, is_open: false, changed: Instant::ZERO });
        self
    }

    pub(crate) fn motors_mut<M: Any>(&mut self) -> impl Iterator<Item = &mut M> {
        self.motors.iter_mut().filter_map(|motor| (&mut **motor as &mut dyn Any).downcast_mut())
    }

    /// Those that turn a joint.
    pub(crate) fn joints(&self) -> usize {
        self.motors.len() - usize::from(self.fingers.is_some())
    }

    pub(crate) fn name(&self, index: usize) -> String {
        let name = self.motors[index].name();
        if index == self.joints() {
            format!("gripper ({name})")
        } else {
            format!("joint {} ({name})", index + 1)
        }
    }

    /// Begins a fault at the motor of a joint. Returns false if such a motor cannot have this fault.
    pub(crate) fn begin(&mut self, joint: usize, now: Instant, fault: &PhysicalFault) -> bool {
        let motor = &mut self.motors[joint];
        match fault {
            PhysicalFault::Restart => motor.restart(now),
            PhysicalFault::Frozen => motor.set_frozen(true),
            PhysicalFault::OverCurrent => motor.over_current(now),
            _ => return false,
        }
        true
    }

    /// Ends a fault of the motor of a joint; what it latched stays.
    pub(crate) fn end(&mut self, joint: usize, fault: &PhysicalFault) {
        if *fault == PhysicalFault::Frozen {
            self.motors[joint].set_frozen(false);
        }
    }

    /// Moves the fingers on to `end`, if a motor moves them.
    pub(crate) fn step_fingers(&mut self, dt_s: f64, end: Instant) {
        let (Some(fingers), Some(motor)) = (&mut self.fingers, self.motors.last_mut()) else { return };
        turn(&mut fingers.axis, &motor.input(), fingers.rotor_kg_m2, dt_s);
        motor.tick(fingers.axis, dt_s);
        let is_open = fingers.travel.open_share(fingers.axis.q_rad) >= FingerTravel::FREE_SHARE;
        if is_open != fingers.is_open {
            (fingers.is_open, fingers.changed) = (is_open, end);
        }
    }

    /// Whether the hand is open, and since when.
    pub(crate) fn hand(&self) -> Option<(bool, Instant)> {
        let fingers = self.fingers.as_ref().map(|fingers| (fingers.is_open, fingers.changed));
        fingers.or_else(|| self.motors.iter().find_map(|motor| motor.hand()))
    }

    /// See [`ArmMotor::opens_by_output`].
    pub(crate) fn opens_by_output(&self) -> bool {
        self.motors.iter().any(|motor| motor.opens_by_output())
    }
}
