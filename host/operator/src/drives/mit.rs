//! Damiao motors with MIT frames.

use std::f64::consts::TAU;

use firmware::groups::mit::{GripperMotor, Mit, Motor, Options};
use protocol::mit::{REGISTER_ID, State, Status};
use protocol::{Frame, Id};
use robot_model::{Joint, MitMotor, MitMotors, RobotModel};

use super::ahead::model_of;
use super::{CanDrives, Family, JointRad, Measured, Seen, alone};

/// A joint that stands a little beyond its range is not a turn away, rad.
const BESIDE_RAD: f64 = 0.1;

impl Family for MitMotors {
    fn group(&self, robot: &RobotModel) -> Result<CanDrives, String> {
        let joints: Vec<Motor> = self.joints.iter().map(motor_of).collect();
        let mut options = Options::new(&joints).and_then(|all| all.with_model(model_of(robot)));
        if let Some(gripper) = self.gripper {
            let gripper = GripperMotor {
                motor: motor_of(&gripper.motor),
                open_rad: gripper.travel.open_rad as f32,
                closed_rad: gripper.travel.closed_rad as f32,
            };
            options = options.and_then(|all| all.with_gripper(gripper));
        }
        if let Some(bit_s) = self.data_bit_rate_bit_s {
            options = options.and_then(|all| all.with_fd(bit_s));
        }
        let options = options.map_err(|error| error.to_string())?;
        alone(options.ids(), "")?;
        Ok(CanDrives::Mit(Mit::new(options)))
    }

    fn is_order(&self, frame: &Frame) -> bool {
        is_order_to_motor(self, frame)
    }

    fn reader<'a>(&'a self, joints: &'a [Joint]) -> Option<Box<dyn super::Reader + 'a>> {
        Some(Box::new(Reader { motors: &self.joints, joints }))
    }
}

/// Whether a frame is a command or a request of a register to one of the motors.
#[must_use]
pub fn is_order_to_motor(motors: &MitMotors, frame: &Frame) -> bool {
    let Id::Standard(id) = frame.id() else { return false };
    id.get() == REGISTER_ID || motors.all().any(|motor| u16::from(motor.id.get()) == id.get())
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

struct Reader<'a> {
    motors: &'a [MitMotor],
    joints: &'a [Joint],
}

impl super::Reader for Reader<'_> {
    /// The answer of a motor with torque: of one without, an answer of a register looks the same.
    fn take(&mut self, Seen { begun, frame, .. }: Seen<'_>, joint_rad: JointRad<'_>) -> Option<Measured> {
        let state = |motor: &MitMotor| State::decode(frame, motor.id, motor.answers_on, &motor.motor.ranges);
        let mut states = self.motors.iter().map(state).enumerate();
        let (joint, state) = states.find_map(|(joint, state)| Some((joint, state?)))?;
        (state.status == Status::Enabled).then(|| Measured {
            joint,
            at: begun,
            q_rad: in_range(&self.joints[joint], joint_rad(joint, f64::from(state.p_rad))),
            temperature_c: Some(state.transistors_c.max(state.rotor_c).into()),
        })
    }
}

/// After power-up a motor knows its angle within one turn. The range of the joint decides which turn it is.
fn in_range(joint: &Joint, q_rad: f64) -> f64 {
    let (low, high) = (joint.limits.q_min_rad - BESIDE_RAD, joint.limits.q_max_rad + BESIDE_RAD);
    let turns = [q_rad, q_rad - TAU, q_rad + TAU];
    turns.into_iter().find(|q| (low..=high).contains(q)).unwrap_or(q_rad)
}
