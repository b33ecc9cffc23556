//! A cell: drives, the arm they move, its supplies, gripper and ball, as one [`Participants`].
//!
//! # One step of the time grid
//!
//! ```text
//! 1. every drive states the output of its power stage     input, set-points in the middle of the step
//! 2. the mechanics make the step                           Plant::step
//! 3. the supplies carry the currents                       Supply::step
//! 4. every drive gets its axis state and supply voltage    tick
//! 5. gripper and ball move                                 Throw::step
//! ```
//!
//! The grid is the cell's own ([`CellOptions::step`], 1 ms): [`Cell::advance`](Participants::advance) makes every
//! whole step up to the given time and leaves the rest. Between two grid points closed forms are used: ramps start
//! at their own microsecond, answers extrapolate with the axis's velocity, the ball leaves at the gripper's
//! instant.

mod build;
mod drives;
mod faults;
mod finger_release;
mod mounting;
mod throw;

use std::any::Any;
use std::borrow::Cow;

use protocol::powercube::BaudRate;
use protocol::{Duration, Frame, Instant, ModuleId, Node};

pub use build::{CellError, CellOptions};
pub use mounting::Mounting;
pub use throw::{BallState, ThrowReport};

use crate::bus::TxOrder;
use crate::drive::PowerCubeDrive;
use crate::drive::arm::Arm;
use crate::fault::FaultTarget;
use crate::mechanics::{AxisInput, Plant, Supply};
use crate::participants::{BusConnection, Participants};
use crate::witness::Trace;
use drives::Drives;
use throw::Throw;

/// Below this share of the nominal voltage the electronics fed by the motor supply are off.
const LOGIC_SHARE_MIN: f64 = 0.4;

/// Drives with everything behind them.
pub struct Cell {
    drives: Drives,
    /// Of drives other than PowerCubes, which know their own.
    addresses: Vec<ModuleId>,
    /// On their joints.
    mounting: Vec<Mounting>,
    plant: Box<dyn Plant>,
    supplies: Vec<Supply>,
    /// Supply of each drive; `None` for a drive with a supply of its own with constant voltage.
    supply_of: Vec<Option<usize>>,
    throw: Throw,
    bit_rate: BaudRate,
    /// Of CAN FD.
    data_bit_rate_bit_s: Option<u32>,
    logic_on_motor_supply: bool,
    step: Duration,
    grid: Instant,
    inputs: Vec<AxisInput>,
    loads_a: Vec<f64>,
    trace: Option<Box<Trace>>,
}

impl Cell {
    /// The PowerCubes, in joint order; empty for an arm with other motors.
    pub fn drives(&self) -> &[PowerCubeDrive] {
        self.drives.powercubes()
    }

    /// A PowerCube, for faults and inputs from outside.
    pub fn drive_mut(&mut self, index: usize) -> Option<&mut PowerCubeDrive> {
        self.drives.powercubes_mut().get_mut(index)
    }

    /// The motors of one kind, such as [`OdriveAxis`](crate::drive::odrive::OdriveAxis), in joint order, the one of the gripper last;
    /// empty for an arm with other drives.
    pub fn motors_mut<M: Any>(&mut self) -> impl Iterator<Item = &mut M> {
        let arm = if let Drives::Motors(arm) = &mut self.drives { Some(arm) } else { None };
        arm.into_iter().flat_map(Arm::motors_mut)
    }

    pub fn plant(&self) -> &dyn Plant {
        &*self.plant
    }

    /// The supplies, in the order of the robot file.
    pub fn supplies(&self) -> &[Supply] {
        &self.supplies
    }

    /// What happened to the ball.
    pub fn throw(&self) -> &ThrowReport {
        self.throw.report()
    }

    /// Where the ball is at the last grid point, m; `None` in a cell without a hand.
    pub fn ball(&self) -> Option<BallState> {
        self.throw.ball(&*self.plant, self.grid)
    }

    /// Orders the gripper directly, as a host with its own output would.
    pub fn order_gripper(&mut self, at: Instant, open: bool) {
        self.throw.order(at, open);
    }

    /// When the drives were last ordered to close the hand, also if it was closed; `None` while they are ordered to open it.
    pub fn closed_at(&self) -> Option<Instant> {
        self.throw.closed_at(&self.drives)
    }

    /// Puts a new ball into the hand and closes the gripper.
    pub fn reload(&mut self, at: Instant) {
        self.throw.reload(at);
    }

    /// The last grid point.
    pub fn grid(&self) -> Instant {
        self.grid
    }

    /// Step of the grid.
    pub fn step(&self) -> Duration {
        self.step
    }

    /// Records the plant from now on, for a judge outside the bus.
    pub fn record_trace(&mut self) {
        self.trace = Some(Box::new(Trace::new(self.plant.axes(), self.step, self.grid)));
    }

    /// The record since [`Cell::record_trace`].
    pub fn trace(&self) -> Option<&Trace> {
        self.trace.as_deref()
    }

    /// Gives the record away and ends it.
    pub fn take_trace(&mut self) -> Option<Trace> {
        self.trace.take().map(|trace| *trace)
    }

    fn index_of(&self, module: ModuleId) -> Option<usize> {
        (0..self.drives.joints()).find(|index| self.module_of(*index) == Some(module))
    }

    /// Address or node of the drive of a joint.
    fn module_of(&self, index: usize) -> Option<ModuleId> {
        self.drives.module(index).or(self.addresses.get(index).copied())
    }

    fn take_step(&mut self) {
        let dt_s = self.step.as_secs_f64();
        let middle = self.grid + Duration::from_micros(self.step.as_micros() / 2);
        let end = self.grid + self.step;
        for (joint, (input, mounting)) in self.inputs.iter_mut().zip(&self.mounting).enumerate() {
            *input = mounting.input(self.drives.input(joint, middle));
        }
        self.plant.step(dt_s, &self.inputs);
        match &mut self.drives {
            Drives::PowerCubes(_) => self.feed_drives(end),
            Drives::Motors(arm) => {
                for (joint, (motor, mounting)) in arm.motors.iter_mut().zip(&self.mounting).enumerate() {
                    motor.tick(mounting.axis(self.plant.axis(joint)), dt_s);
                }
                arm.step_fingers(dt_s, end);
            }
        }
        self.throw.step(&self.drives, &*self.plant, end);
        self.plant.set_ball_held(self.throw.report().released_at.is_none());
        self.grid = end;
        if let Some(trace) = &mut self.trace {
            for axis in 0..self.plant.axes() {
                trace.push([self.plant.link_q_rad(axis), self.plant.axis(axis).v_rad_s]);
            }
            trace.note_gripper(end, self.throw.is_ordered_open());
        }
    }

    /// The supplies carry the currents of the PowerCubes, which take axis and voltage back.
    fn feed_drives(&mut self, end: Instant) {
        let dt_s = self.step.as_secs_f64();
        let drives = self.drives.powercubes_mut();
        self.loads_a.fill(0.0);
        for (drive, supply) in drives.iter().zip(&self.supply_of) {
            if let Some(supply) = *supply {
                self.loads_a[supply] += drive.current_a();
            }
        }
        for (supply, load_a) in self.supplies.iter_mut().zip(&self.loads_a) {
            supply.step(dt_s, *load_a);
        }
        for (index, drive) in drives.iter_mut().enumerate() {
            let nominal_v = drive.nameplate().supply_v;
            let motor_v = self.supply_of[index].map_or(nominal_v, |supply| self.supplies[supply].voltage_v());
            let logic_v = if self.logic_on_motor_supply {
                drive.power(end, motor_v >= LOGIC_SHARE_MIN * nominal_v);
                motor_v
            } else {
                nominal_v
            };
            drive.tick(end, self.mounting[index].axis(self.plant.axis(index)), motor_v, logic_v);
        }
    }
}

impl Participants for Cell {
    fn len(&self) -> usize {
        self.drives.len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        self.drives.node(index)
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        self.drives.name(index)
    }

    fn advance(&mut self, to: Instant) {
        while self.grid + self.step <= to {
            self.take_step();
        }
    }

    fn connection(&self, index: usize) -> BusConnection {
        self.drives.connection(index, self.bit_rate, self.data_bit_rate_bit_s)
    }

    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        self.data_bit_rate_bit_s
    }

    fn accepts(&self, index: usize, frame: &Frame) -> bool {
        self.drives.accepts(index, frame)
    }

    fn tx_order(&self, index: usize) -> Option<TxOrder> {
        self.drives.tx_order(index)
    }

    fn module(&self, index: usize) -> Option<ModuleId> {
        self.module_of(index)
    }

    fn physics(&mut self) -> Option<&mut dyn FaultTarget> {
        Some(self)
    }
}
