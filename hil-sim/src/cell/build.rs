//! From options and a robot file, or a bench, to a cell.

use protocol::powercube::BaudRate;
use protocol::{Duration, Instant, ModuleId};
use robot_model::{Drive, JointVec, RobotModel};

use super::drives::Drives;
use super::finger_release::FingerRelease;
use super::throw::Throw;
use super::{Cell, Mounting};
use crate::drive::arm::Start;
use crate::drive::{DriveOptions, Nameplate, PowerCubeDrive, motors_of};
use crate::mechanics::perturb::JointDeviation;
use crate::mechanics::{
    Body, Gripper, GripperOptions, JointMechanics, MechanicsOptions, Mechanism, Plant, Scatter, Supply,
    SupplyOptions,
};

/// Options of a cell that are not in a robot file.
#[derive(Clone, Debug, PartialEq)]
pub struct CellOptions {
    /// The same for all drives; a scatter varies the delay.
    pub drive: DriveOptions,
    /// Friction, rotors, stops.
    pub mechanics: MechanicsOptions,
    /// The same for all supplies.
    pub supply: SupplyOptions,
    pub gripper: GripperOptions,
    /// The ball leaves between fingers that open, as described by `[fingers]` of the robot file, instead of at one instant.
    pub finger_release: bool,
    /// Deviations from the model.
    pub scatter: Scatter,
    /// Time grid of the mechanics, 10 µs to 5 ms, even number of microseconds. 1 ms moves a throw's landing by 1 µm
    /// against 50 µs; edges of switches and limits are noticed once per step.
    pub step: Duration,
    /// Joint angles at time 0, rad; `None` is 0.1 rad above the middle of the ranges, just beside the home switches.
    pub start_q_rad: Option<Vec<f64>>,
    /// How the drives sit on their joints, base first; the rest reads the angle of its joint.
    pub mounting: Vec<Mounting>,
    /// Rate of the bus; modules set to another one are off it.
    pub bit_rate: BaudRate,
    /// At time 0 the drives are switched on; otherwise they have been up for a while.
    pub cold_start: bool,
    /// The motor supply feeds the electronics too: a cut-out restarts the drives. Off: they have a logic supply of their own.
    pub logic_on_motor_supply: bool,
    /// A CANopen servo without a new target goes on for one period before it stands; off: it stands at once.
    pub servos_extrapolate: bool,
}

impl CellOptions {
    pub(super) fn mounting_of(&self, joint: usize) -> Mounting {
        self.mounting.get(joint).copied().unwrap_or_default()
    }
}

impl Default for CellOptions {
    fn default() -> Self {
        Self {
            drive: DriveOptions::default(),
            mechanics: MechanicsOptions::default(),
            supply: SupplyOptions::default(),
            gripper: GripperOptions::default(),
            finger_release: false,
            scatter: Scatter::default(),
            step: Duration::from_millis(1),
            start_q_rad: None,
            mounting: Vec::new(),
            bit_rate: BaudRate::Kbit1000,
            cold_start: false,
            logic_on_motor_supply: false,
            servos_extrapolate: false,
        }
    }
}

/// Why no cell can be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CellError {
    /// The robot file describes no drives.
    #[error(
        "robot {robot} has no drives: give each [[joint]] of its file a [joint.drive], {} table",
        robot_model::motor_tables()
    )]
    NoDrives { robot: String },
    /// The release between fingers was requested, but the robot file does not describe the fingers.
    #[error(
        "robot {robot} says nothing about its fingers: give its file a [fingers] table, or leave the finger release out"
    )]
    NoFingers { robot: String },
    /// A drive's address is not 1 to 31, or taken.
    #[error("drive address {address} of joint {joint} is outside 1..=31 or used twice")]
    Address {
        /// Joint, from 1.
        joint: usize,
        address: u8,
    },
    #[error("{0}")]
    Motors(String),
    /// The start pose has another number of joints, or a value is not a number.
    #[error("the start pose has {found} usable angles, the robot {expected} joints")]
    StartPose {
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// The time grid is outside its range, or odd.
    #[error("time step of {step} is not an even number of microseconds from 10 us to 5 ms")]
    Step { step: Duration },
}

impl Cell {
    /// The cell of a robot, with chances from `seed`.
    ///
    /// # Errors
    /// [`CellError`]: a robot without drives, addresses that clash, a start pose that does not fit, a step out of range.
    pub fn new(model: &RobotModel, options: &CellOptions, seed: u64) -> Result<Self, CellError> {
        let q = start_pose(model, options)?;
        let n = model.n();
        let deviations: Vec<_> = (0..n).map(|i| options.scatter.draw(seed, i)).collect();
        let drives = match model.drives() {
            Some(described) => {
                Drives::PowerCubes(powercubes(model, options, described, &deviations, &q, seed)?)
            }
            None => {
                let q_rad = (0..n).map(|joint| options.mounting_of(joint).drive_rad(q[joint])).collect();
                let motors = motors_of(&Start { robot: model, options, q_rad }).map_err(CellError::Motors)?;
                Drives::Motors(motors.ok_or_else(|| CellError::NoDrives { robot: model.name().to_owned() })?)
            }
        };
        let plant = options.mechanics.build(model, q, &deviations);
        let supplies: Vec<Supply> = model
            .supplies()
            .iter()
            .map(|s| Supply::new(s.voltage_v, s.current_max_a, options.supply))
            .collect();
        let supply_of = (0..n).map(|i| model.supplies().iter().position(|s| s.feeds[i])).collect();
        let world = *model.world();
        let mut gripper = options.gripper;
        // Fingers with a motor take the time that they take.
        if matches!(&drives, Drives::Motors(arm) if !arm.opens_by_output()) {
            (gripper.delay, gripper.jitter) = (Duration::ZERO, Duration::ZERO);
        }
        gripper.delay = options.scatter.draw_gripper_delay(seed, gripper.delay);
        let fingers = match (options.finger_release, model.fingers()) {
            (false, _) => None,
            (true, None) => return Err(CellError::NoFingers { robot: model.name().to_owned() }),
            (true, Some(fingers)) => {
                Some(FingerRelease::new(*fingers, model.gripper().ball_radius_m, world.gravity_m_s2, seed))
            }
        };
        let throw = Throw::new(
            Gripper::new(gripper, seed),
            fingers,
            model.gripper().ball_radius_m,
            world.gravity_m_s2,
            gripper.landing_z_m.unwrap_or(world.floor_z_m),
        );
        let mut cell = Self::assemble(drives, Box::new(plant), supplies, supply_of, throw, options)?;
        if model.drives().is_none() {
            let nodes = model.addresses().unwrap_or_default().into_iter();
            cell.addresses = nodes.filter_map(|node| ModuleId::new(node).ok()).collect();
        }
        cell.data_bit_rate_bit_s = model.data_bit_rate_bit_s();
        Ok(cell)
    }

    /// A bench with `modules` modules, at most [`robot_model::JOINTS_MAX`], addresses from 1. Each turns a wheel of
    /// half the inertia its loop is tuned for, without gravity, on a supply of its own with constant voltage;
    /// friction as in an arm.
    ///
    /// # Errors
    /// [`CellError::Step`], [`CellError::StartPose`].
    pub fn bench(n: usize, firmware: u16, options: &CellOptions, seed: u64) -> Result<Self, CellError> {
        let angles = options.start_q_rad.clone().unwrap_or_else(|| vec![0.1; n]);
        let usable = angles.iter().filter(|q| q.is_finite()).count();
        if usable != n || angles.len() != n {
            return Err(CellError::StartPose { found: usable, expected: n });
        }
        let q = JointVec::from_slice(&angles);
        let mut drives = Vec::with_capacity(n);
        let mut joints = Vec::with_capacity(n);
        for i in 0..n {
            let address = ModuleId::new(i as u8 + 1)
                .map_err(|_| CellError::Address { joint: i + 1, address: i as u8 + 1 })?;
            let mounting = options.mounting_of(i);
            let plate = mounting.plate(Nameplate::bench(address, firmware));
            let half = 0.5 * plate.servo_inertia_kg_m2;
            joints.push(JointMechanics {
                rotor_kg_m2: half,
                coulomb_nm: options.mechanics.coulomb_rad_s2.unwrap_or(5.0) * plate.servo_inertia_kg_m2,
                viscous_nms_rad: options.mechanics.viscous_share * plate.torque_max_nm / plate.v_max_rad_s,
                brake_nm: options.mechanics.brake_share * plate.torque_max_nm,
                stop_min_rad: plate.q_min_rad - options.mechanics.stop_margin_rad,
                stop_max_rad: plate.q_max_rad + options.mechanics.stop_margin_rad,
                stop_stiffness_nm_rad: options.mechanics.stop_stiffness_nm_rad,
                stop_damping_nms_rad: 2.0
                    * (options.mechanics.stop_stiffness_nm_rad * plate.servo_inertia_kg_m2).sqrt(),
                elasticity: options.mechanics.elasticity,
            });
            drives.push(PowerCubeDrive::new(plate, options.drive.clone(), seed, mounting.drive_rad(q[i])));
        }
        let wheels = Body::Wheels(JointVec::repeat(n, 2.0));
        let plant: Box<dyn Plant> = Box::new(Mechanism::new(wheels, joints, q));
        if options.finger_release {
            return Err(CellError::NoFingers { robot: "bench".to_owned() });
        }
        let throw = Throw::new(Gripper::new(options.gripper, seed), None, 0.03, 9.81, 0.0);
        Self::assemble(Drives::PowerCubes(drives), plant, Vec::new(), vec![None; n], throw, options)
    }

    fn assemble(
        mut drives: Drives,
        plant: Box<dyn Plant>,
        supplies: Vec<Supply>,
        supply_of: Vec<Option<usize>>,
        throw: Throw,
        options: &CellOptions,
    ) -> Result<Self, CellError> {
        let us = options.step.as_micros();
        if !(10..=5_000).contains(&us) || !us.is_multiple_of(2) {
            return Err(CellError::Step { step: options.step });
        }
        for drive in drives.powercubes_mut() {
            if options.cold_start {
                drive.power(Instant::ZERO, true);
            } else {
                drive.switch_on(Instant::ZERO);
            }
        }
        Ok(Self {
            inputs: vec![Default::default(); drives.joints()],
            loads_a: vec![0.0; supplies.len()],
            mounting: (0..drives.joints()).map(|joint| options.mounting_of(joint)).collect(),
            drives,
            addresses: Vec::new(),
            plant,
            supplies,
            supply_of,
            throw,
            bit_rate: options.bit_rate,
            data_bit_rate_bit_s: None,
            logic_on_motor_supply: options.logic_on_motor_supply,
            step: options.step,
            grid: Instant::ZERO,
            trace: None,
        })
    }
}

/// The drives of `[joint.drive]`, tuned for the nominal arm.
fn powercubes(
    model: &RobotModel,
    options: &CellOptions,
    described: &[Drive],
    deviations: &[JointDeviation],
    q: &JointVec,
    seed: u64,
) -> Result<Vec<PowerCubeDrive>, CellError> {
    let n = model.n();
    let tuned = options.mechanics.servo_inertia_kg_m2(model);
    let mut drives = Vec::with_capacity(n);
    for i in 0..n {
        let address = described[i].address;
        let clash = drives.iter().any(|d: &PowerCubeDrive| d.address().get() == address);
        let plate = Nameplate::of_joint(model, i, tuned[i]).filter(|_| !clash);
        let mounting = options.mounting_of(i);
        let mut plate = mounting.plate(plate.ok_or(CellError::Address { joint: i + 1, address })?);
        plate.k_b_a_s_rad *= deviations[i].current;
        plate.k_m_a_nm *= deviations[i].current;
        plate.home_error_rad = deviations[i].home_rad;
        let mut own = options.drive.clone();
        own.processing_delay =
            Duration::from_secs_f64(own.processing_delay.as_secs_f64() * deviations[i].delay);
        drives.push(PowerCubeDrive::new(plate, own, seed, mounting.drive_rad(q[i])));
    }
    Ok(drives)
}

fn start_pose(model: &RobotModel, options: &CellOptions) -> Result<JointVec, CellError> {
    let n = model.n();
    match &options.start_q_rad {
        None => Ok((model.q_min() + model.q_max()) * 0.5 + JointVec::repeat(n, 0.1)),
        Some(given) => {
            let usable = given.iter().filter(|q| q.is_finite()).count();
            if usable == n && given.len() == n {
                Ok(JointVec::from_slice(given))
            } else {
                Err(CellError::StartPose { found: usable, expected: n })
            }
        }
    }
}
