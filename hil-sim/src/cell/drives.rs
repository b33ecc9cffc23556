//! Drives of the joints and of the gripper: PowerCubes, motors with MIT frames, CANopen servos, or ODrives.

use std::borrow::Cow;

use mit_protocol::{DATA_RATES, Status};
use protocol::powercube::{Address, BaudRate, Channel};
use protocol::{Duration, Frame, Id, Instant, ModuleId, Node};
use robot_model::{
    Cia402Mode, Cia402Servos, FingerTravel, MitMotor as Described, OdriveAxis as DescribedAxis, RobotModel,
};

use super::{CellError, CellOptions};
use crate::bus::TxOrder;
use crate::drive::PowerCubeDrive;
use crate::drive::bench::{ShaftMotor, turn};
use crate::drive::cia402::{CanopenServo, ServoOptions};
use crate::drive::mit::{MitMotor, MitOptions};
use crate::drive::odrive::{OdriveAxis, OdriveOptions};
use crate::fault::PhysicalFault;
use crate::mechanics::{AxisInput, AxisState};
use crate::participants::BusConnection;

/// Time without a frame after which an ODrive gives no torque.
const ODRIVE_WATCHDOG: Duration = Duration::from_millis(50);

/// Codes of a current that is too high: of an emergency, and of an axis of 0.6.
const SERVO_OVER_CURRENT: u16 = 0x2310;
const AXIS_OVER_CURRENT: u32 = 0x1000;

/// The drives of a cell, base first.
pub(super) enum Drives {
    PowerCubes(Vec<PowerCubeDrive>),
    Mit(Box<Arm<MitMotor>>),
    Cia402(Vec<CanopenServo>),
    Odrive(Box<Arm<OdriveAxis>>),
}

/// One motor for each joint, and perhaps one for the fingers.
pub(super) struct Arm<M> {
    pub(super) joints: Vec<M>,
    fingers: Option<Fingers<M>>,
}

/// Fingers with the inertia of their motor's rotor. The ball is free as soon as they are open by [`FingerTravel::FREE_SHARE`].
struct Fingers<M> {
    motor: M,
    axis: AxisState,
    rotor_kg_m2: f64,
    travel: FingerTravel,
    is_open: bool,
    /// When that changed.
    changed: Instant,
}

impl Arm<MitMotor> {
    /// Motors at rest; the fingers are closed.
    pub(super) fn new(model: &RobotModel, options: &CellOptions, q_rad: &[f64]) -> Result<Self, CellError> {
        let Some(described) = model.mit_motors() else {
            return Err(CellError::NoDrives { robot: model.name().to_owned() });
        };
        let joints = described.joints.iter().zip(q_rad).enumerate();
        let joints = joints
            .map(|(joint, (motor, q_rad))| {
                motor_of(motor, described.data_bit_rate_bit_s, options.mounting_of(joint).drive_rad(*q_rad))
            })
            .collect::<Result<_, _>>()?;
        let fingers = described.gripper.map(|gripper| {
            let motor = motor_of(&gripper.motor, described.data_bit_rate_bit_s, gripper.travel.closed_rad)?;
            Ok(Fingers::closed(motor, gripper.motor.rotor_kg_m2, gripper.travel))
        });
        Ok(Self { joints, fingers: fingers.transpose()? })
    }
}

impl Arm<OdriveAxis> {
    /// Axes at rest, configured as `docs/moving.md` says: their watchdog is on, estimates come when they are asked for. The fingers are closed.
    pub(super) fn new(model: &RobotModel, options: &CellOptions, q_rad: &[f64]) -> Self {
        let described = model.odrive_axes().map_or(&[][..], |all| &all.axes).iter().zip(q_rad).enumerate();
        let joints = described
            .map(|(joint, (axis, q_rad))| axis_of(axis, options.mounting_of(joint).drive_rad(*q_rad)));
        let fingers = model.odrive_axes().and_then(|all| all.gripper).map(|gripper| {
            let motor = axis_of(&gripper.axis, gripper.travel.closed_rad);
            Fingers::closed(motor, gripper.axis.rotor_kg_m2, gripper.travel)
        });
        Self { joints: joints.collect(), fingers }
    }
}

impl<M: ShaftMotor> Arm<M> {
    /// The motors, the one of the fingers last.
    pub(super) fn motors_mut(&mut self) -> impl Iterator<Item = &mut M> {
        self.joints.iter_mut().chain(self.fingers.as_mut().map(|fingers| &mut fingers.motor))
    }

    fn len(&self) -> usize {
        self.joints.len() + usize::from(self.fingers.is_some())
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        match &mut self.fingers {
            Some(fingers) if index == self.joints.len() => &mut fingers.motor,
            _ => &mut self.joints[index],
        }
    }

    fn motor(&self, index: usize) -> &M {
        match &self.fingers {
            Some(fingers) if index == self.joints.len() => &fingers.motor,
            _ => &self.joints[index],
        }
    }

    fn name(&self, index: usize) -> String {
        match &self.fingers {
            Some(fingers) if index == self.joints.len() => format!("gripper ({})", fingers.motor.name()),
            _ => format!("joint {} ({})", index + 1, self.joints[index].name()),
        }
    }

    fn step_fingers(&mut self, dt_s: f64, end: Instant) {
        if let Some(fingers) = &mut self.fingers {
            fingers.step(dt_s, end);
        }
    }

    /// Whether the fingers are open, and since when.
    fn is_open(&self) -> Option<(bool, Instant)> {
        self.fingers.as_ref().map(|fingers| (fingers.is_open, fingers.changed))
    }
}

/// As classical motors are delivered, or set to CAN FD.
fn motor_of(described: &Described, fd_bit_s: Option<u32>, q_rad: f64) -> Result<MitMotor, CellError> {
    let name = described.motor.name;
    let options = MitOptions::of(name, described.id, described.answers_on)
        .ok_or_else(|| CellError::MotorUnknown { motor: name.to_owned() })?;
    let rate = fd_bit_s.and_then(|fd| DATA_RATES.iter().find(|(_, bit_s)| *bit_s == fd));
    let bit_rate = rate.map_or(options.bit_rate, |(code, _)| *code);
    Ok(MitMotor::new(MitOptions { rotor_kg_m2: described.rotor_kg_m2, bit_rate, ..options }, q_rad))
}

impl<M: ShaftMotor> Fingers<M> {
    fn closed(motor: M, rotor_kg_m2: f64, travel: FingerTravel) -> Self {
        let axis = AxisState { q_rad: travel.closed_rad, ..AxisState::default() };
        Self { motor, axis, rotor_kg_m2, travel, is_open: false, changed: Instant::ZERO }
    }

    fn step(&mut self, dt_s: f64, end: Instant) {
        turn(&mut self.axis, &self.motor.input(), self.rotor_kg_m2, dt_s);
        self.motor.tick(self.axis, dt_s);
        let is_open = self.travel.open_share(self.axis.q_rad) >= FingerTravel::FREE_SHARE;
        if is_open != self.is_open {
            (self.is_open, self.changed) = (is_open, end);
        }
    }
}

/// The servos of `[joint.cia402]`, whose loops are tuned for the nominal arm: with the stiffness of the drive loop in the robot
/// file.
pub(super) fn servos(
    model: &RobotModel,
    options: &CellOptions,
    q_rad: &[f64],
) -> Result<Vec<CanopenServo>, CellError> {
    let Some(Cia402Servos { servos: described, output }) = model.cia402_servos() else {
        return Err(CellError::NoDrives { robot: model.name().to_owned() });
    };
    let tuned = options.mechanics.servo_inertia_kg_m2(model);
    let (wn_rad_s, damping) =
        model.drive_loop().map_or((320.0, 0.8), |own| (own.natural_frequency_rad_s, own.damping_ratio));
    let servo = |joint: usize| {
        let (described, limits) = (&described[joint], &model.joints()[joint].limits);
        let delivered = ServoOptions::of(described.node);
        let delivered = match described.mode {
            Cia402Mode::CyclicPosition => delivered,
            Cia402Mode::InterpolatedPosition => delivered.interpolating(),
        };
        let options_of = ServoOptions {
            // A motor encoder with a ratio of 1: a host needs only the product.
            encoder_counts: described.counts_per_turn,
            gear: 1,
            rated_nm: described.rated_nm,
            peak_nm: limits.torque_max_nm.unwrap_or(3.0 * described.rated_nm),
            // Half of the torque is left at the top speed of the joint.
            no_load_rad_s: 2.0 * limits.v_max_rad_s,
            stiffness_nm_rad: tuned[joint] * wn_rad_s * wn_rad_s,
            damping_nms_rad: 2.0 * damping * wn_rad_s * tuned[joint],
            is_absolute: described.is_absolute,
            gripper_bit: output.filter(|own| own.joint == joint).map(|own| own.bit),
            ..delivered
        };
        CanopenServo::new(options_of, options.mounting_of(joint).drive_rad(q_rad[joint]))
    };
    Ok((0..described.len()).map(servo).collect())
}

fn axis_of(described: &DescribedAxis, q_rad: f64) -> OdriveAxis {
    let options = OdriveOptions {
        gear: described.gear_ratio,
        counted: described.counted(),
        torque_nm_a: described.torque_nm_a,
        current_max_a: described.current_max_a,
        brakes: described.brake,
        watchdog: Some(ODRIVE_WATCHDOG),
        estimates: None,
        ..OdriveOptions::new(described.node, described.version)
    };
    OdriveAxis::new(options, q_rad)
}

impl Drives {
    pub(super) fn powercubes(&self) -> &[PowerCubeDrive] {
        match self {
            Self::PowerCubes(drives) => drives,
            Self::Mit(_) | Self::Cia402(_) | Self::Odrive(_) => &[],
        }
    }

    pub(super) fn powercubes_mut(&mut self) -> &mut [PowerCubeDrive] {
        match self {
            Self::PowerCubes(drives) => drives,
            Self::Mit(_) | Self::Cia402(_) | Self::Odrive(_) => &mut [],
        }
    }

    /// Nodes on the bus.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Mit(arm) => arm.len(),
            Self::Cia402(servos) => servos.len(),
            Self::Odrive(arm) => arm.len(),
        }
    }

    /// Those that turn a joint.
    pub(super) fn joints(&self) -> usize {
        match self {
            Self::PowerCubes(drives) => drives.len(),
            Self::Mit(arm) => arm.joints.len(),
            Self::Cia402(servos) => servos.len(),
            Self::Odrive(arm) => arm.joints.len(),
        }
    }

    pub(super) fn node(&mut self, index: usize) -> &mut dyn Node {
        match self {
            Self::PowerCubes(drives) => &mut drives[index],
            Self::Mit(arm) => arm.node(index),
            Self::Cia402(servos) => &mut servos[index],
            Self::Odrive(arm) => arm.node(index),
        }
    }

    pub(super) fn name(&self, index: usize) -> Cow<'_, str> {
        Cow::Owned(match self {
            Self::PowerCubes(drives) => {
                let plate = drives[index].nameplate();
                format!("drive {} ({})", plate.address, plate.module)
            }
            Self::Mit(arm) => arm.name(index),
            Self::Cia402(servos) => format!("joint {} ({})", index + 1, servos[index].name()),
            Self::Odrive(arm) => arm.name(index),
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
            Self::Mit(_) | Self::Cia402(_) | Self::Odrive(_) => matches!(frame.id(), Id::Standard(_)),
        }
    }

    /// A CANopen node has a mailbox for each kind of frame: a heartbeat that waits does not delay process data.
    pub(super) fn tx_order(&self) -> Option<TxOrder> {
        matches!(self, Self::Cia402(_)).then_some(TxOrder::Priority)
    }

    pub(super) fn connection(
        &self,
        index: usize,
        bit_rate: BaudRate,
        fd_bit_s: Option<u32>,
    ) -> BusConnection {
        match self {
            Self::PowerCubes(drives) => drives[index].link(bit_rate),
            // Those of a classical arm are set to the rate of its bus.
            Self::Mit(arm) if fd_bit_s.is_some() => arm.motor(index).link(bit_rate.bit_per_s(), fd_bit_s),
            Self::Mit(_) | Self::Cia402(_) | Self::Odrive(_) => BusConnection::On,
        }
    }

    pub(super) fn module(&self, index: usize) -> Option<ModuleId> {
        self.powercubes().get(index).map(PowerCubeDrive::address)
    }

    /// Begins a fault of the drive of a joint; false: such a drive has no such fault.
    pub(super) fn begin(&mut self, joint: usize, now: Instant, fault: &PhysicalFault) -> bool {
        match (self, fault) {
            (Self::PowerCubes(drives), fault) => return drives[joint].begin(now, fault),
            (Self::Mit(arm), PhysicalFault::Restart) => {
                arm.joints[joint].set_power(false);
                arm.joints[joint].set_power(true);
            }
            (Self::Mit(arm), PhysicalFault::Frozen) => {
                arm.joints[joint].faults_mut().answers_are_stale = true;
            }
            (Self::Mit(arm), PhysicalFault::OverCurrent) => arm.joints[joint].fail(Status::OverCurrent),
            (Self::Cia402(servos), PhysicalFault::Restart) => {
                servos[joint].set_power(now, false);
                servos[joint].set_power(now, true);
            }
            (Self::Cia402(servos), PhysicalFault::Frozen) => {
                servos[joint].faults_mut().answers_are_stale = true;
            }
            (Self::Cia402(servos), PhysicalFault::OverCurrent) => servos[joint].fail(now, SERVO_OVER_CURRENT),
            (Self::Odrive(arm), PhysicalFault::Restart) => {
                arm.joints[joint].set_power(now, false);
                arm.joints[joint].set_power(now, true);
            }
            (Self::Odrive(arm), PhysicalFault::Frozen) => {
                arm.joints[joint].faults_mut().estimates_are_stale = true;
            }
            (Self::Odrive(arm), PhysicalFault::OverCurrent) => arm.joints[joint].fail(AXIS_OVER_CURRENT),
            _ => return false,
        }
        true
    }

    /// Ends a fault of the drive of a joint; what it latched stays.
    pub(super) fn end(&mut self, joint: usize, fault: &PhysicalFault) {
        match (self, fault) {
            (Self::PowerCubes(drives), fault) => drives[joint].end(fault),
            (Self::Mit(arm), PhysicalFault::Frozen) => {
                arm.joints[joint].faults_mut().answers_are_stale = false;
            }
            (Self::Cia402(servos), PhysicalFault::Frozen) => {
                servos[joint].faults_mut().answers_are_stale = false;
            }
            (Self::Odrive(arm), PhysicalFault::Frozen) => {
                arm.joints[joint].faults_mut().estimates_are_stale = false;
            }
            _ => {}
        }
    }

    /// What the power stage of a joint does around `middle`, the middle of a step.
    pub(super) fn input(&self, joint: usize, middle: Instant) -> AxisInput {
        match self {
            Self::PowerCubes(drives) => drives[joint].input(middle),
            Self::Mit(arm) => arm.joints[joint].input(),
            Self::Cia402(servos) => servos[joint].input_at(middle),
            Self::Odrive(arm) => arm.joints[joint].input(),
        }
    }

    /// Moves the fingers on to `end`, if a motor moves them.
    pub(super) fn step_fingers(&mut self, dt_s: f64, end: Instant) {
        match self {
            Self::Mit(arm) => arm.step_fingers(dt_s, end),
            Self::Odrive(arm) => arm.step_fingers(dt_s, end),
            Self::PowerCubes(_) | Self::Cia402(_) => {}
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
            Self::Mit(arm) => arm.is_open(),
            Self::Odrive(arm) => arm.is_open(),
            Self::Cia402(servos) => servos.iter().find_map(CanopenServo::gripper),
        }
    }
}
