//! CANopen servos of profile CiA 402.

use std::f64::consts::TAU;

use firmware::groups::cia402::options::HOST_NODE;
use firmware::groups::cia402::{Cia402, Follow, GripperOutput, Home, Options, OptionsError, Servo};
use protocol::canopen::id::Function;
use protocol::{Frame, Instant, JointIndex};
use robot_model::{Cia402Mode, Cia402Servo, Cia402Servos, Joint, RobotModel};

use super::ahead::model_of;
use super::{CanDrives, Family, JointRad, Measured, Seen, alone};

impl Family for Cia402Servos {
    fn group(&self, robot: &RobotModel) -> Result<CanDrives, String> {
        let options = options(self, robot)?;
        alone(options.ids(), " (CANopen servos: 1 to 31)")?;
        Ok(CanDrives::Cia402(Cia402::new(options)))
    }

    fn is_order(&self, frame: &Frame) -> bool {
        match Function::of_frame(frame) {
            Some(Function::Nmt | Function::Sync | Function::Rpdo(..) | Function::SdoToNode(_)) => true,
            Some(Function::Heartbeat(node)) => node.get() == HOST_NODE,
            _ => false,
        }
    }

    fn reader<'a>(&'a self, _joints: &'a [Joint]) -> Option<Box<dyn super::Reader + 'a>> {
        Some(Box::new(Reader { servos: &self.servos, synchronized_at: None }))
    }
}

/// What the group of these servos of `robot` starts from.
///
/// # Errors
/// Why they cannot form a group.
pub fn options(servos: &Cia402Servos, robot: &RobotModel) -> Result<Options, String> {
    let joints: Vec<Servo> = servos.servos.iter().map(servo_of).collect();
    let mut options = Options::new(&joints).and_then(|all| all.with_model(model_of(robot)));
    if let Some(own) = servos.output {
        let joint = JointIndex::new(own.joint).map_err(|_| OptionsError::Output);
        options = options.and_then(|all| all.with_gripper(GripperOutput { joint: joint?, bit: own.bit }));
    }
    options.map_err(|error| error.to_string())
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

struct Reader<'a> {
    servos: &'a [Cia402Servo],
    /// End of the last SYNC, at which servos measure.
    synchronized_at: Option<Instant>,
}

impl super::Reader for Reader<'_> {
    /// Process data of a servo, mapped as the controller does: status word, position in counts.
    fn take(&mut self, Seen { at, frame, .. }: Seen<'_>, joint_rad: JointRad<'_>) -> Option<Measured> {
        let node = match Function::of_frame(frame)? {
            Function::Sync => {
                self.synchronized_at = Some(at);
                return None;
            }
            Function::Tpdo(1, node) => node,
            _ => return None,
        };
        let joint = self.servos.iter().position(|servo| servo.node == node)?;
        let counts = i32::from_le_bytes(*frame.data().get(2..)?.first_chunk()?);
        let turns = f64::from(counts) / f64::from(self.servos[joint].counts_per_turn);
        let (at, q_rad) = (self.synchronized_at?, joint_rad(joint, TAU * turns));
        Some(Measured { joint, at, q_rad, temperature_c: None })
    }
}
