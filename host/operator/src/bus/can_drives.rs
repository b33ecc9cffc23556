//! The drive groups that a controller of this program can lead on CAN, behind the one seam; the robot file says which.

use firmware::fault::Refusal;
use firmware::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, PositionSample, Profile, Readings, SetPoint, Standing,
    Taken,
};
use firmware::groups::cia402::{self, Cia402, Follow, GripperOutput, Home, Servo};
use firmware::groups::dynamics::{ArmModel, Body};
use firmware::groups::mit::{GripperMotor, Mit, Motor, Options};
use firmware::groups::odrive::{self, Axis, GripperAxis, Odrive};
use firmware::groups::powercube::PowerCubes;
use firmware::settings::Settings;
use nalgebra::{Matrix3, Vector3};
use protocol::powercube::Address;
use protocol::{Frame, Id, Instant, JointIndex, StandardId};
use robot_model::{Cia402Mode, Cia402Servo, MitMotor, OdriveAxis, RobotModel};

use super::settings::NoSettings;

/// The families: an enum of them, and a macro that calls the one that is there.
macro_rules! families {
    ($($family:ident),*) => {
        /// The drives of one family.
        // One controller has one of them: the smaller one may take the memory of the larger.
        #[allow(clippy::large_enum_variant)]
        pub enum CanDrives {
            $($family($family),)*
        }

        macro_rules! each {
            ($own:expr, $drives:ident => $call:expr) => {
                match $own {
                    $(CanDrives::$family($drives) => $call,)*
                }
            };
        }
    };
}

families!(PowerCubes, Mit, Cia402, Odrive);

impl Default for CanDrives {
    fn default() -> Self {
        Self::PowerCubes(PowerCubes::default())
    }
}

impl CanDrives {
    /// The drives of `robot`. PowerCubes are those that the settings name; an arm of motors, which has no brakes, is held as a whole.
    ///
    /// # Errors
    /// [`NoSettings::Invalid`]: motors or servos that cannot form a group.
    pub fn of(robot: &RobotModel) -> Result<Self, NoSettings> {
        let invalid = |cause: String| NoSettings::Invalid { robot: robot.name().to_owned(), cause };
        if robot.cia402_servos().is_some() {
            let options = cia402_options(robot)?;
            alone(options.ids()).map_err(invalid)?;
            return Ok(Self::Cia402(Cia402::new(options)));
        }
        if let Some(axes) = robot.odrive_axes() {
            let joints: Vec<Axis> = axes.axes.iter().map(axis_of).collect();
            let options = odrive::Options::new(&joints).and_then(|all| all.with_model(model_of(robot)));
            let options = options.and_then(|all| match axes.gripper {
                Some(gripper) => all.with_gripper(GripperAxis {
                    axis: axis_of(&gripper.axis),
                    open_rad: gripper.travel.open_rad as f32,
                    closed_rad: gripper.travel.closed_rad as f32,
                }),
                None => Ok(all),
            });
            let options = options.map_err(|error| invalid(error.to_string()))?;
            alone(options.ids()).map_err(invalid)?;
            return Ok(Self::Odrive(Odrive::new(options)));
        }
        let Some(motors) = robot.mit_motors() else { return Ok(Self::default()) };
        let joints: Vec<Motor> = motors.joints.iter().map(motor_of).collect();
        let options = Options::new(&joints).and_then(|options| options.with_model(model_of(robot)));
        let options = options.and_then(|options| match motors.gripper {
            Some(gripper) => options.with_gripper(GripperMotor {
                motor: motor_of(&gripper.motor),
                open_rad: gripper.travel.open_rad as f32,
                closed_rad: gripper.travel.closed_rad as f32,
            }),
            None => Ok(options),
        });
        let options = options.and_then(|options| match motors.data_bit_rate_bit_s {
            Some(bit_s) => options.with_fd(bit_s),
            None => Ok(options),
        });
        let options = options.map_err(|error| invalid(error.to_string()))?;
        alone(options.ids()).map_err(invalid)?;
        Ok(Self::Mit(Mit::new(options)))
    }
}

/// The CANopen servos of a robot.
///
/// # Errors
/// [`NoSettings::Invalid`]: none, or servos that cannot form a group.
pub fn cia402_options(robot: &RobotModel) -> Result<cia402::Options, NoSettings> {
    let own = robot.cia402_servos();
    let joints: Vec<Servo> = own.map_or(&[][..], |own| &own.servos).iter().map(servo_of).collect();
    let options = cia402::Options::new(&joints).and_then(|all| all.with_model(model_of(robot)));
    let options = options.and_then(|all| match own.and_then(|own| own.output) {
        Some(own) => {
            let joint = JointIndex::new(own.joint).map_err(|_| cia402::OptionsError::Output)?;
            all.with_gripper(GripperOutput { joint, bit: own.bit })
        }
        None => Ok(all),
    });
    options.map_err(|error| NoSettings::Invalid { robot: robot.name().to_owned(), cause: error.to_string() })
}

/// Refuses ids on which other frames of these programs go: those of PowerCubes, which `status`, `doctor` and their like send on any bus.
/// Frames of the host link have 29 bits and meet no drive.
fn alone(ids: impl Iterator<Item = StandardId>) -> Result<(), String> {
    let mut ids = ids.map(Id::Standard);
    match ids.find(|id| Address::of(*id).is_some()) {
        Some(id) => Err(format!(
            "id {id} of a drive is also one of a PowerCube, to which other verbs speak: give the drive another number (ODrives: 1, 2, 4, \
             9 to 31; CANopen servos: 1 to 31)"
        )),
        None => Ok(()),
    }
}

/// The arm with its ball in the hand, as the torques ahead see it.
fn model_of(robot: &RobotModel) -> ArmModel {
    let robot = &robot.holding_ball().unwrap_or_else(|| robot.clone());
    let rotor_kg_m2 = |joint: usize| robot.rotor_kg_m2(joint).unwrap_or(0.0);
    let vector = |v: &Vector3<f64>| v.map(|x| x as f32).into();
    let rows = |m: &Matrix3<f64>| m.transpose().map(|x| x as f32).into();
    let bodies = robot.joints().iter().zip(robot.links()).enumerate().map(|(index, (joint, link))| Body {
        rotation: rows(&joint.x_pj.rot),
        origin_m: vector(&joint.x_pj.pos),
        mass_kg: link.inertia.mass_kg() as f32,
        first_moment_kg_m: vector(link.inertia.first_moment_kg_m()),
        inertia_kg_m2: rows(link.inertia.about_origin_kg_m2()),
        rotor_kg_m2: rotor_kg_m2(index) as f32,
    });
    ArmModel { bodies: bodies.collect(), gravity_m_s2: robot.world().gravity_m_s2 as f32 }
}

fn motor_of(motor: &MitMotor) -> Motor {
    Motor {
        id: motor.id,
        master: motor.answers_on,
        ranges: motor.motor.ranges,
        kp_nm_rad: motor.kp_nm_rad as f32,
        kd_nm_s_rad: motor.kd_nm_s_rad as f32,
    }
}

fn axis_of(axis: &OdriveAxis) -> Axis {
    Axis {
        node: axis.node,
        version: axis.version,
        gear: axis.gear_ratio as f32,
        home: if axis.is_at_joint { odrive::Home::Joint } else { odrive::Home::Motor },
        current_max_a: axis.current_max_a as f32,
        position_gain_1_s: axis.position_gain_1_s as f32,
        velocity_gain_nm_s: axis.velocity_gain_nm_s as f32,
        integral_gain_nm: axis.integral_gain_nm as f32,
    }
}

fn servo_of(servo: &Cia402Servo) -> Servo {
    Servo {
        node: servo.node,
        counts_per_turn: servo.counts_per_turn,
        rated_mnm: (1e3 * servo.rated_nm).round() as u32,
        home: if servo.is_absolute { Home::Absolute } else { Home::Here },
        follow: match servo.mode {
            Cia402Mode::CyclicPosition => Follow::Cyclic,
            Cia402Mode::InterpolatedPosition => Follow::Interpolated,
        },
    }
}

/// Calls the drives of the present family.
macro_rules! forward {
    ($(fn $name:ident(&mut self $(, $arg:ident: $kind:ty)*) $(-> $out:ty)?;)* ; $(fn $look:ident(&self $(, $la:ident: $lk:ty)*) -> $lo:ty;)*) => {
        $(fn $name(&mut self $(, $arg: $kind)*) $(-> $out)? {
            each!(self, drives => drives.$name($($arg),*))
        })*
        $(fn $look(&self $(, $la: $lk)*) -> $lo {
            each!(self, drives => drives.$look($($la),*))
        })*
    };
}

impl DriveGroup for CanDrives {
    type Packet = Frame;

    forward! {
        fn handle_packet(&mut self, now: Instant, settings: &Settings, packet: &Frame);
        fn handle_timeout(&mut self, now: Instant, settings: &Settings);
        fn poll_event(&mut self, now: Instant, settings: &Settings) -> Option<GroupEvent>;
        fn flush(&mut self, now: Instant, settings: &Settings);
        fn poll_packet(&mut self) -> Option<Frame>;
        fn command(&mut self, now: Instant, settings: &Settings, command: Command);
        fn brake(&mut self, now: Instant, settings: &Settings) -> Instant;
        fn set_point(&mut self, settings: &Settings, joint: JointIndex, set_point: &SetPoint) -> Taken;
        fn observe(&mut self, joint: JointIndex, qd_rad_s: f32, dt_s: f32);
        fn set_gripper(&mut self, settings: &Settings, open: bool) -> bool;
        fn cancel_gripper(&mut self);
        ;
        fn poll_timeout(&self, now: Instant, settings: &Settings) -> Option<Instant>;
        fn acts_at(&self, joint: JointIndex) -> Instant;
        fn profile(&self, settings: &Settings) -> Profile;
        fn check_group(&self, now: Instant, settings: &Settings) -> Result<(), Refusal>;
        fn check_drive(&self, now: Instant, settings: &Settings, joint: JointIndex) -> Result<(), Refusal>;
        fn position(&self, joint: JointIndex) -> Option<PositionSample>;
        fn is_homed(&self, joint: JointIndex) -> bool;
        fn is_at_rest(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool;
        fn is_moving(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool;
        fn standing(&self, joint: JointIndex, halted_is_fine: bool) -> Standing;
        fn readings(&self, joint: JointIndex) -> Readings;
        fn counters(&self) -> GroupCounters;
        fn is_keeping_time(&self) -> bool;
        fn is_cycle_done(&self, settings: &Settings) -> bool;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::groups::dynamics::Motion;
    use firmware::joints::PerJoint;
    use robot_model::JointVec;

    #[test]
    fn torques_ahead_are_those_of_the_model_of_the_robot_and_its_rotors() {
        let robot = format!("{}/../../robots/openarm7.toml", env!("CARGO_MANIFEST_DIR"));
        let robot = RobotModel::load(&robot).unwrap();
        let (arm, holding) = (model_of(&robot), robot.holding_ball().unwrap());
        let rotors = &robot.mit_motors().unwrap().joints;
        for k in 0..200 {
            let wave = |scale: f64, f: f64| {
                JointVec::from_fn(robot.n(), |i| scale * (f64::from(k) * f + 1.7 * i as f64).sin())
            };
            let (q, qd, qdd) = (wave(2.0, 0.71), wave(4.0, 1.13), wave(30.0, 1.57));
            let wanted = holding.inverse_dynamics(&q, &qd, &qdd);
            let mut motion = PerJoint::default();
            for joint in JointIndex::first(robot.n()) {
                let i = joint.get();
                motion.set(
                    joint,
                    Motion { q_rad: q[i] as f32, qd_rad_s: qd[i] as f32, qdd_rad_s2: qdd[i] as f32 },
                );
            }
            let found = arm.torques_nm(&motion);
            for joint in JointIndex::first(robot.n()) {
                let i = joint.get();
                let wanted_nm = wanted[i] + rotors[i].rotor_kg_m2 * qdd[i];
                let off_nm = (f64::from(found.get(joint)) - wanted_nm).abs();
                assert!(off_nm < 2e-4, "joint {}: {off_nm} N·m beside {wanted_nm}", i + 1);
            }
        }
    }
}
