//! Drives of the joints and of the gripper: PowerCubes on their supplies, or the motors of another family.

use std::borrow::Cow;

use protocol::powercube::{Address, BaudRate, Channel};
use protocol::{Frame, Id, Instant, ModuleId, Node};

use crate::bus::TxOrder;
use crate::drive::PowerCubeDrive;
use crate::drive::arm::Arm;
use crate::fault::PhysicalFault;
use crate::mechanics::AxisInput;
use crate::participants::BusConnection;

/// The drives of a cell, base first.
pub(super) enum Drives {
    PowerCubes(Vec<PowerCubeDrive>),
    Motors(Arm),
}

impl Drives {
    pub(super) fn powercubes(&self) -> &[PowerCubeDrive] {
        if let Self::PowerCubes(drives) = self { drives } else { &[] }
    }

    pub(super) fn powercubes_mut(&mut self) -> &mut [PowerCubeDrive] {
        if let Self::PowerCubes(drives) = self { drives } else { &mut [] }
    }

    /// Nodes on the bus.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Motors(arm) => arm.motors.len(),
        }
    }

    /// Those that turn a joint.
    pub(super) fn joints(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Motors(arm) => arm.joints(),
        }
    }

    pub(super) fn node(&mut self, index: usize) -> &mut dyn Node {
        match self {
            Self::PowerCubes(drives) => &mut drives[index],
            Self::Motors(arm) => &mut *arm.motors[index],
        }
    }

    pub(super) fn name(&self, index: usize) -> Cow<'_, str> {
        Cow::Owned(match self {
            Self::PowerCubes(drives) => {
                let plate = drives[index].nameplate();
                format!("drive {} ({})", plate.address, plate.module)
            }
            Self::Motors(arm) => arm.name(index),
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
            Self::Motors(_) => matches!(frame.id(), Id::Standard(_)),
        }
    }

    pub(super) fn tx_order(&self, index: usize) -> Option<TxOrder> {
        if let Self::Motors(arm) = self { arm.motors[index].tx_order() } else { None }
    }

    pub(super) fn connection(
        &self,
        index: usize,
        bit_rate: BaudRate,
        fd_bit_s: Option<u32>,
    ) -> BusConnection {
        match self {
            Self::PowerCubes(drives) => drives[index].link(bit_rate),
            Self::Motors(arm) => arm.motors[index].connection(bit_rate.bit_per_s(), fd_bit_s),
        }
    }

    pub(super) fn module(&self, index: usize) -> Option<ModuleId> {
        self.powercubes().get(index).map(PowerCubeDrive::address)
    }

    /// Begins a fault of the drive of a joint; false: such a drive has no such fault.
    pub(super) fn begin(&mut self, joint: usize, now: Instant, fault: &PhysicalFault) -> bool {
        match self {
            Self::PowerCubes(drives) => drives[joint].begin(now, fault),
            Self::Motors(arm) => arm.begin(joint, now, fault),
        }
    }

    /// Ends a fault of the drive of a joint; what it latched stays.
    pub(super) fn end(&mut self, joint: usize, fault: &PhysicalFault) {
        match self {
            Self::PowerCubes(drives) => drives[joint].end(fault),
            Self::Motors(arm) => arm.end(joint, fault),
        }
    }

    /// What the power stage of a joint does around `middle`, the middle of a step.
    pub(super) fn input(&self, joint: usize, middle: Instant) -> AxisInput {
        match self {
            Self::PowerCubes(drives) => drives[joint].input(middle),
            Self::Motors(arm) => arm.motors[joint].input_at(middle),
        }
    }

    /// When the gripper was last ordered to close, also if it was closed; `None` while it is ordered to open.
    pub(super) fn gripper_closed(&self, output: Option<(Option<usize>, u8)>) -> Option<Instant> {
        let (open, changed) = self.gripper(output)?;
        let set = match (self, output) {
            (Self::PowerCubes(drives), Some((axis, _))) => {
                axis.map_or(drives.last(), |axis| drives.get(axis)).map(PowerCubeDrive::outputs_set)
            }
            _ => None,
        };
        (!open).then(|| set.unwrap_or(changed))
    }

    /// Whether the drives have the gripper open, and since when. `output` is the axis and the line of a module's output.
    pub(super) fn gripper(&self, output: Option<(Option<usize>, u8)>) -> Option<(bool, Instant)> {
        match self {
            Self::PowerCubes(drives) => {
                let (axis, line) = output?;
                let drive = axis.map_or(drives.last(), |axis| drives.get(axis))?;
                Some((drive.outputs() >> line & 1 != 0, drive.outputs_changed()))
            }
            Self::Motors(arm) => arm.hand(),
        }
    }
}
