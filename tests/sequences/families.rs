//! The families of drives that the sequences are played with: two of each on a bench, and their group.

use std::borrow::Cow;
use std::f64::consts::TAU;

use firmware::group::DriveGroup;
use firmware::groups::cia402::{self, Cia402, Follow, GripperOutput, Servo};
use firmware::groups::mit::{self, Mit, Motor};
use firmware::groups::odrive::{self, Axis, Home, Odrive};
use firmware::groups::powercube::PowerCubes;
use firmware::settings::Settings;
use hil_sim::bus::TxOrder;
use hil_sim::drive::bench::ShaftMotor;
use hil_sim::drive::cia402::{CanopenServo, Interpolating, ServoOptions};
use hil_sim::drive::mit::{MitMotor, MitOptions};
use hil_sim::drive::odrive::{OdriveAxis, OdriveOptions};
use hil_sim::mechanics::{Body, JointMechanics, Mechanism, Plant};
use hil_sim::participants::Participants;
use hil_sim::{Cell, CellOptions};
use protocol::canopen::cia402::State;
use protocol::mit::{MotorId, Ranges, Status};
use protocol::powercube::{Config, CubeState, Parameter};
use protocol::{Duration, Frame, Instant, JointIndex, ModuleId, Node, StandardId};
use robot_model::JointVec;

use crate::lab::{JOINTS, OPENING_MS};

/// Inertia at each joint, half of it in the rotor, kg·m².
const INERTIA_KG_M2: f64 = 0.2;
/// Step of the mechanics.
const STEP: Duration = Duration::from_micros(500);
/// Bit of the servo's outputs that opens the hand.
const OUTPUT: u8 = 16;
const TIME_OUT: Duration = Duration::from_millis(50);

/// A family, with what the judge must see of its drives.
pub(crate) trait Family: 'static {
    type Group: DriveGroup<Packet = Frame>;
    type Drives: Participants;
    /// Its frames are those of PowerCubes, which the judge reads.
    const IS_POWERCUBE: bool = false;
    /// Time for finding the drives, ms.
    const BOOT_MS: u16;

    fn group() -> Self::Group;
    fn drives(start_rad: [f64; JOINTS], seed: u64) -> Self::Drives;
    /// Settings of the arm of PowerCubes as this family needs them.
    fn adapt(_settings: &mut Settings) {}
    /// Angle and speed of each joint.
    fn plant(drives: &Self::Drives) -> [(f64, f64); JOINTS];
    /// A drive loses its power and gets it back.
    fn restart(drives: &mut Self::Drives, drive: usize, now: Instant);
    /// Joints that know their zero; `None`: no drive shows it, and the judge holds the controller to what it publishes.
    fn homed(_drives: &Self::Drives, _now: Instant) -> Option<[bool; JOINTS]> {
        None
    }
    /// `None`: nothing opens a hand.
    fn is_open(drives: &Self::Drives) -> Option<bool>;
    /// What a drive holds of an armed group, and should not.
    fn held_wrong(drives: &Self::Drives, joint: usize, current_a: f64, watchdog: bool) -> Option<String>;
}

impl Family for PowerCubes {
    type Group = Self;
    type Drives = Cell;
    const IS_POWERCUBE: bool = true;
    const BOOT_MS: u16 = 900;

    fn group() -> Self {
        Self::default()
    }

    fn drives(start_rad: [f64; JOINTS], seed: u64) -> Cell {
        let mut options = CellOptions::default();
        options.drive.starts_homed = true;
        options.start_q_rad = Some(start_rad.to_vec());
        Cell::bench(JOINTS, 0x4614, &options, seed).expect("two drives on a bench")
    }

    fn plant(cell: &Cell) -> [(f64, f64); JOINTS] {
        let plant = cell.plant();
        std::array::from_fn(|joint| (plant.link_q_rad(joint), plant.axis(joint).v_rad_s))
    }

    fn restart(cell: &mut Cell, drive: usize, now: Instant) {
        cell.drive_mut(drive).expect("a drive of the bench").restart(now);
    }

    fn homed(cell: &Cell, now: Instant) -> Option<[bool; JOINTS]> {
        let homed = |joint: usize| cell.drives()[joint].state_word(now).contains(CubeState::HOME_OK);
        Some(std::array::from_fn(homed))
    }

    fn is_open(cell: &Cell) -> Option<bool> {
        Some(cell.drives()[1].outputs() & 1 == 1)
    }

    fn held_wrong(cell: &Cell, joint: usize, current_a: f64, watchdog: bool) -> Option<String> {
        let drive = &cell.drives()[joint];
        let held_a = drive.held(Parameter::MaxCur);
        let watched = drive.held_config().contains(Config::WATCHDOG_ENABLE);
        ((held_a - current_a).abs() > 0.01 || watched != watchdog).then(|| {
            format!("joint {joint} holds {held_a} A, watchdog {watched}, and not {current_a} A, watchdog {watchdog}")
        })
    }
}

/// Wheels on the shafts of two motors.
pub(crate) struct Wheels<M> {
    motors: Vec<M>,
    plant: Mechanism,
    grid: Instant,
}

impl<M: ShaftMotor> Wheels<M> {
    fn new(motors: Vec<M>) -> Self {
        let joint = JointMechanics {
            coulomb_nm: 5.0 * INERTIA_KG_M2,
            viscous_nms_rad: 0.1,
            brake_nm: 20.0,
            ..JointMechanics::ideal(0.5 * INERTIA_KG_M2)
        };
        let q = JointVec::from_fn(JOINTS, |i| motors[i].q_rad());
        let wheels = Body::Wheels(JointVec::repeat(JOINTS, 0.5 * INERTIA_KG_M2));
        Self { motors, plant: Mechanism::new(wheels, vec![joint; JOINTS], q), grid: Instant::ZERO }
    }
}

impl<M: ShaftMotor> Participants for Wheels<M> {
    fn len(&self) -> usize {
        self.motors.len()
    }

    fn node(&mut self, index: usize) -> &mut dyn Node {
        &mut self.motors[index]
    }

    fn name(&self, index: usize) -> Cow<'_, str> {
        self.motors[index].name().into()
    }

    fn advance(&mut self, to: Instant) {
        let dt_s = STEP.as_secs_f64();
        while self.grid + STEP <= to {
            let inputs: Vec<_> = self.motors.iter().map(ShaftMotor::input).collect();
            self.plant.step(dt_s, &inputs);
            for (joint, motor) in self.motors.iter_mut().enumerate() {
                motor.tick(self.plant.axis(joint), dt_s);
            }
            self.grid += STEP;
        }
    }

    fn accepts(&self, _: usize, frame: &Frame) -> bool {
        !frame.is_extended()
    }

    fn tx_order(&self, _: usize) -> Option<TxOrder> {
        Some(TxOrder::Priority)
    }

    fn module(&self, index: usize) -> Option<ModuleId> {
        ModuleId::new(index as u8 + 1).ok()
    }
}

/// Two motors of a family, which turn [`Wheels`].
pub(crate) trait MotorFamily: 'static {
    type Group: DriveGroup<Packet = Frame>;
    type Motor: ShaftMotor;
    const BOOT_MS: u16;
    /// An output of the last motor opens the hand.
    const OPENS_HAND: bool = false;

    fn group() -> Self::Group;
    fn motor(joint: usize, start_rad: f64) -> Self::Motor;
    fn set_power(motor: &mut Self::Motor, now: Instant, on: bool);
    fn has_torque(motor: &Self::Motor) -> bool;
    /// See [`Family::is_open`]; of the motor of the last joint.
    fn is_open(_: &Self::Motor) -> Option<bool> {
        None
    }
}

impl<F: MotorFamily> Family for F {
    type Group = F::Group;
    type Drives = Wheels<F::Motor>;
    const BOOT_MS: u16 = F::BOOT_MS;

    fn group() -> F::Group {
        F::group()
    }

    fn drives(start_rad: [f64; JOINTS], _: u64) -> Wheels<F::Motor> {
        Wheels::new((0..JOINTS).map(|joint| F::motor(joint, start_rad[joint])).collect())
    }

    fn adapt(settings: &mut Settings) {
        settings.watchdog_timeout_us = TIME_OUT.as_micros() as u32;
        settings.watchdog_refresh_us = 10_000;
        if F::OPENS_HAND {
            settings.gripper_opening_us = u32::from(OPENING_MS) * 1_000;
        }
    }

    fn plant(drives: &Self::Drives) -> [(f64, f64); JOINTS] {
        std::array::from_fn(|joint| (drives.plant.link_q_rad(joint), drives.plant.axis(joint).v_rad_s))
    }

    fn restart(drives: &mut Self::Drives, drive: usize, now: Instant) {
        F::set_power(&mut drives.motors[drive], now, false);
        F::set_power(&mut drives.motors[drive], now, true);
    }

    fn is_open(drives: &Self::Drives) -> Option<bool> {
        F::is_open(&drives.motors[JOINTS - 1])
    }

    /// Lost torque is what a drive of an armed group may not have.
    fn held_wrong(drives: &Self::Drives, joint: usize, _: f64, _: bool) -> Option<String> {
        (!F::has_torque(&drives.motors[joint])).then(|| format!("joint {joint} has no torque"))
    }
}

/// CANopen servos in mode 8. [`InterpolatingServos`] are in mode 7.
pub(crate) struct Servos<const CYCLIC: bool>;
pub(crate) type CyclicServos = Servos<true>;
pub(crate) type InterpolatingServos = Servos<false>;

impl<const CYCLIC: bool> MotorFamily for Servos<CYCLIC> {
    type Group = Cia402;
    type Motor = CanopenServo;
    const BOOT_MS: u16 = if CYCLIC { 1_500 } else { 2_000 };
    const OPENS_HAND: bool = true;

    fn group() -> Cia402 {
        let servo = |i: usize| Servo {
            node: protocol::canopen::NodeId::new(i as u8 + 3).expect("a node"),
            counts_per_turn: if CYCLIC { 409_600 } else { 360_000 },
            rated_mnm: 50_000,
            home: cia402::Home::Absolute,
            follow: if CYCLIC { Follow::Cyclic } else { Follow::Interpolated },
        };
        let gripper = GripperOutput { joint: JointIndex::new(1).expect("two joints"), bit: OUTPUT };
        let options = cia402::Options::new(&[servo(0), servo(1)]).and_then(|all| all.with_gripper(gripper));
        Cia402::new(options.expect("two servos"))
    }

    fn motor(joint: usize, start_rad: f64) -> CanopenServo {
        let own = ServoOptions::of(protocol::canopen::NodeId::new(joint as u8 + 3).expect("a node"));
        let own = if CYCLIC { own } else { own.interpolating() };
        let commutation = Duration::from_millis(50);
        let interpolating = own.interpolating.map(|module| Interpolating { commutation, ..module });
        let gripper_bit = (joint == 1).then_some(OUTPUT);
        CanopenServo::new(ServoOptions { gripper_bit, interpolating, ..own }, start_rad)
    }

    fn set_power(servo: &mut CanopenServo, now: Instant, on: bool) {
        servo.set_power(now, on);
    }

    fn has_torque(servo: &CanopenServo) -> bool {
        servo.state() == State::OperationEnabled
    }

    fn is_open(servo: &CanopenServo) -> Option<bool> {
        servo.gripper().map(|(open, _)| open)
    }
}

impl MotorFamily for Mit {
    type Group = Self;
    type Motor = MitMotor;
    const BOOT_MS: u16 = 1_500;

    fn group() -> Self {
        let motor = |i: usize| Motor {
            id: MotorId::new(i as u8 + 1).expect("an id"),
            master: StandardId::from_low_bits(i as u16 + 0x11),
            ranges: Ranges::new(12.5, 45.0, 54.0).expect("ranges of an 8009"),
            kp_nm_rad: 200.0,
            kd_nm_s_rad: 5.0,
        };
        Self::new(mit::Options::new(&[motor(0), motor(1)]).expect("two motors"))
    }

    fn motor(joint: usize, start_rad: f64) -> MitMotor {
        let id = MotorId::new(joint as u8 + 1).expect("an id");
        let options = MitOptions::of("8009", id, StandardId::from_low_bits(joint as u16 + 0x11));
        MitMotor::new(options.expect("figures of an 8009"), start_rad)
    }

    fn set_power(motor: &mut MitMotor, _: Instant, on: bool) {
        motor.set_power(on);
    }

    fn has_torque(motor: &MitMotor) -> bool {
        motor.status() == Status::Enabled
    }
}

impl MotorFamily for Odrive {
    type Group = Self;
    type Motor = OdriveAxis;
    const BOOT_MS: u16 = 2_000;

    fn group() -> Self {
        let axis = |i: usize| Axis {
            node: protocol::odrive::NodeId::new(i as u8 + 9).expect("a node"),
            version: protocol::odrive::Version::V06,
            gear: 8.0,
            home: Home::Joint,
            current_max_a: 40.0,
            position_gain_1_s: 30.0,
            // 100 rad/s of the velocity loop.
            velocity_gain_nm_s: (100.0 * INERTIA_KG_M2 * TAU / 8.0) as f32,
            integral_gain_nm: 0.0,
        };
        Self::new(odrive::Options::new(&[axis(0), axis(1)]).expect("two axes"))
    }

    fn motor(joint: usize, start_rad: f64) -> OdriveAxis {
        let node = protocol::odrive::NodeId::new(joint as u8 + 9).expect("a node");
        let options = OdriveOptions {
            counted: 1.0,
            brakes: true,
            watchdog: Some(TIME_OUT),
            estimates: None,
            ..OdriveOptions::new(node, protocol::odrive::Version::V06)
        };
        OdriveAxis::new(options, start_rad)
    }

    fn set_power(axis: &mut OdriveAxis, now: Instant, on: bool) {
        axis.set_power(now, on);
    }

    fn has_torque(axis: &OdriveAxis) -> bool {
        axis.state() == protocol::odrive::AxisState::ClosedLoop
    }
}
