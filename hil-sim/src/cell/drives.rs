//! What turns the joints and opens the hand: PowerCubes, or motors with MIT frames.

use std::borrow::Cow;

use protocol::powercube::{Address, BaudRate, Channel};
use protocol::{Frame, Id, Instant, ModuleId, Node};
use robot_model::{MitGripper, MitMotor as Described, RobotModel};

use super::{CellError, CellOptions};
use crate::drive::PowerCubeDrive;
use crate::drive::bench::{ShaftMotor, turn};
use crate::drive::mit::{MitMotor, MitOptions};
use crate::mechanics::{AxisInput, AxisState};
use crate::participants::BusConnection;

/// The drives of a cell, base first.
pub(super) enum Drives {
    PowerCubes(Vec<PowerCubeDrive>),
    Mit(Box<MitArm>),
}

/// One motor for each joint, and perhaps one for the fingers.
pub(super) struct MitArm {
    pub(super) joints: Vec<MitMotor>,
    fingers: Option<Fingers>,
}

/// Fingers with the inertia of their motor's rotor. The ball is free as soon as they are open by [`MitGripper::FREE_SHARE`].
struct Fingers {
    motor: MitMotor,
    axis: AxisState,
    described: MitGripper,
    is_open: bool,
    /// When that changed.
    changed: Instant,
}

impl MitArm {
    /// Motors at rest; the fingers are closed.
    pub(super) fn new(model: &RobotModel, options: &CellOptions, q_rad: &[f64]) -> Result<Self, CellError> {
        let Some(described) = model.mit_motors() else {
            return Err(CellError::NoDrives { robot: model.name().to_owned() });
        };
        let joints = described.joints.iter().zip(q_rad).enumerate();
        let joints = joints
            .map(|(joint, (motor, q_rad))| motor_of(motor, options.mounting_of(joint).drive_rad(*q_rad)))
            .collect::<Result<_, _>>()?;
        let fingers = described.gripper.map(|gripper| {
            Ok(Fingers {
                motor: motor_of(&gripper.motor, gripper.closed_rad)?,
                axis: AxisState { q_rad: gripper.closed_rad, ..AxisState::default() },
                described: gripper,
                is_open: false,
                changed: Instant::ZERO,
            })
        });
        Ok(Self { joints, fingers: fingers.transpose()? })
    }

    /// The motors, the one of the fingers last.
    pub(super) fn motors_mut(&mut self) -> impl Iterator<Item = &mut MitMotor> {
        self.joints.iter_mut().chain(self.fingers.as_mut().map(|fingers| &mut fingers.motor))
    }
}

fn motor_of(described: &Described, q_rad: f64) -> Result<MitMotor, CellError> {
    let name = described.motor.name;
    let options = MitOptions::of(name, described.id, described.answers_on)
        .ok_or_else(|| CellError::MotorUnknown { motor: name.to_owned() })?;
    Ok(MitMotor::new(MitOptions { rotor_kg_m2: described.rotor_kg_m2, ..options }, q_rad))
}

impl Fingers {
    fn step(&mut self, dt_s: f64, end: Instant) {
        turn(&mut self.axis, &self.motor.input(), self.described.motor.rotor_kg_m2, dt_s);
        self.motor.tick(self.axis, dt_s);
        let is_open = self.described.open_share(self.axis.q_rad) >= MitGripper::FREE_SHARE;
        if is_open != self.is_open {
            (self.is_open, self.changed) = (is_open, end);
        }
    }
}

impl Drives {
    pub(super) fn powercubes(&self) -> &[PowerCubeDrive] {
        match self {
            Self::PowerCubes(drives) => drives,
            Self::Mit(_) => &[],
        }
    }

    pub(super) fn powercubes_mut(&mut self) -> &mut [PowerCubeDrive] {
        match self {
            Self::PowerCubes(drives) => drives,
            Self::Mit(_) => &mut [],
        }
    }

    /// Nodes on the bus.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Mit(arm) => arm.joints.len() + usize::from(arm.fingers.is_some()),
        }
    }

    /// Those that turn a joint.
    pub(super) fn joints(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Mit(arm) => arm.joints.len(),
        }
    }

    pub(super) fn node(&mut self, index: usize) -> &mut dyn Node {
        match self {
            Self::PowerCubes(drives) => &mut drives[index],
            Self::Mit(arm) => match &mut arm.fingers {
                Some(fingers) if index == arm.joints.len() => &mut fingers.motor,
                _ => &mut arm.joints[index],
            },
        }
    }

    pub(super) fn name(&self, index: usize) -> Cow<'_, str> {
        Cow::Owned(match self {
            Self::PowerCubes(drives) => {
                let plate = drives[index].nameplate();
                format!("drive {} ({})", plate.address, plate.module)
            }
            Self::Mit(arm) => match &arm.fingers {
                Some(fingers) if index == arm.joints.len() => format!("gripper ({})", fingers.motor.name()),
                _ => format!("motor {} ({})", index + 1, arm.joints[index].name()),
            },
        })
    }

    pub(super) fn accepts(&self, index: usize, frame: &Frame) -> bool {
        match self {
            Self::PowerCubes(drives) => match Address::of(frame.id()) {
                Some(Address::Broadcast) => true,
                Some(Address::Module(Channel::Get | Channel::Put, module)) => {
                    drives[index].address() == module
                }
                _ => false,
            },
            Self::Mit(_) => matches!(frame.id(), Id::Standard(_)),
        }
    }

    pub(super) fn connection(&self, index: usize, bit_rate: BaudRate) -> BusConnection {
        self.powercubes().get(index).map_or(BusConnection::On, |drive| drive.link(bit_rate))
    }

    pub(super) fn module(&self, index: usize) -> Option<ModuleId> {
        self.powercubes().get(index).map(PowerCubeDrive::address)
    }

    /// What the power stage of a joint does around `middle`, the middle of a step.
    pub(super) fn input(&self, joint: usize, middle: Instant) -> AxisInput {
        match self {
            Self::PowerCubes(drives) => drives[joint].input(middle),
            Self::Mit(arm) => arm.joints[joint].input(),
        }
    }

    /// Moves the fingers on to `end`, if a motor moves them.
    pub(super) fn step_fingers(&mut self, dt_s: f64, end: Instant) {
        if let Self::Mit(arm) = self
            && let Some(fingers) = &mut arm.fingers
        {
            fingers.step(dt_s, end);
        }
    }

    /// Whether the drives have the gripper open, and since when. `output` is the axis and the line of a module's output.
    pub(super) fn gripper(&self, output: Option<(Option<usize>, u8)>) -> Option<(bool, Instant)> {
        match self {
            Self::PowerCubes(drives) => {
                let (axis, line) = output?;
                let drive = axis.map_or(drives.last(), |axis| drives.get(axis))?;
                Some((drive.outputs() >> line & 1 != 0, drive.outputs_changed()))
            }
            Self::Mit(arm) => arm.fingers.as_ref().map(|fingers| (fingers.is_open, fingers.changed)),
        }
    }
}
