//! The gripper's output of a module: written, repeated once, then given up with a cause. The module is the drive of a joint, or
//! one that only holds the gripper.

use protocol::powercube::{ACCEPTED, Dio, Parameter, Reply, Request, Value};
use protocol::{Duration, Instant, JointIndex, ModuleId};

use super::PowerCubes;
use super::drives::Lane;
use super::settings::{GRIPPER_ADDRESS, GRIPPER_LINE};
use crate::fault::{Cause, Fault};
use crate::settings::Settings;

/// Writes of one order.
const TRIES: u8 = 2;
/// A repetition that cannot leave for so long is too late: the ball would fly elsewhere.
const REPEAT_MAX: Duration = Duration::from_millis(20);

/// A write that is not answered yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct GripperWrite {
    open: bool,
    tries: u8,
    /// It is on its way; else it waits for its lane.
    asked: bool,
    /// Given up, or repeated, then.
    deadline: Instant,
}

impl PowerCubes {
    /// Orders the output.
    pub(super) fn write_gripper(&mut self, open: bool) {
        let deadline = Instant::FAR_FUTURE;
        self.gripper_write = Some(GripperWrite { open, tries: 0, asked: false, deadline });
    }

    /// When an answer is missing, or a repetition too late.
    pub(super) fn gripper_deadline(&self) -> Option<Instant> {
        self.gripper_write.map(|write| write.deadline).filter(|deadline| *deadline != Instant::FAR_FUTURE)
    }

    /// Sends a write that waits, if it may be sent now.
    pub(super) fn pump_gripper(&mut self, now: Instant, settings: &Settings) {
        let Some(write) = self.gripper_write.filter(|write| !write.asked) else { return };
        if let Some(joint) = gripper_joint(settings) {
            let request = gripper_request(write.open, self.drives.at(joint).dio, settings);
            if !self.drives.at(joint).can_send(Lane::Side, &request, now) {
                return;
            }
            self.ask(now, settings, joint, Lane::Side, &request);
        } else if let Some(module) = gripper_module(settings) {
            self.send(&gripper_request(write.open, Dio(0), settings).encode(module));
        }
        let deadline = now + self.reply_deadline(settings);
        self.gripper_write = Some(GripperWrite { tries: write.tries + 1, asked: true, deadline, ..write });
    }

    /// An answer of a module that is not a joint.
    pub(super) fn take_stranger(&mut self, settings: &Settings, module: ModuleId, reply: &Reply) {
        if gripper_module(settings) == Some(module)
            && let Reply::SetAck { parameter, code: Some(ACCEPTED) } = *reply
        {
            self.end_gripper_write(parameter);
        }
    }

    /// A write of this parameter was answered.
    pub(super) fn end_gripper_write(&mut self, parameter: Parameter) {
        if parameter == Parameter::DioData {
            self.gripper_write = self.gripper_write.filter(|write| !write.asked);
        }
    }

    /// Repeats the write that was not answered, or gives it up.
    pub(super) fn give_up_gripper(&mut self, now: Instant, settings: &Settings) {
        let Some(write) = self.gripper_write.filter(|write| write.deadline <= now) else { return };
        if write.asked && write.tries < TRIES {
            self.gripper_write = Some(GripperWrite { asked: false, deadline: now + REPEAT_MAX, ..write });
        } else {
            self.gripper_write = None;
            self.fail(Fault { cause: Cause::GripperUnanswered, joint: gripper_joint(settings) });
        }
    }
}

/// The joint whose drive holds the gripper.
fn gripper_joint(settings: &Settings) -> Option<JointIndex> {
    settings.joints().find(|&joint| settings.joint.at(joint).address == GRIPPER_ADDRESS.get(settings))
}

fn gripper_module(settings: &Settings) -> Option<ModuleId> {
    u8::try_from(GRIPPER_ADDRESS.get(settings)).ok().and_then(|address| ModuleId::new(address).ok())
}

/// Write that sets the gripper's line of a module and leaves its other outputs as last seen.
fn gripper_request(open: bool, seen: Dio, settings: &Settings) -> Request {
    let line = 1u8 << (GRIPPER_LINE.get(settings) & 3);
    let level = open != settings.gripper_inverted;
    let outputs = if level { seen.outputs() | line } else { seen.outputs() & !line };
    // Outputs are bits 4 to 7 of the word; inputs are not written.
    Request::Set(Parameter::DioData, Value::U32(u32::from(outputs) << 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gripper_write_keeps_the_other_lines_of_the_module() {
        let mut settings = Settings::powercube6();
        GRIPPER_LINE.set(&mut settings, 2);
        let seen = Dio::new(0b0000, 0b1001);
        let request = gripper_request(true, seen, &settings);
        assert_eq!(request, Request::Set(Parameter::DioData, Value::U32(0b1101_0000)));
        settings.gripper_inverted = true;
        let request = gripper_request(true, seen, &settings);
        assert_eq!(request, Request::Set(Parameter::DioData, Value::U32(0b1001_0000)));
    }
}
