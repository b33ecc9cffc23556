//! Which frames on a bus are orders of a controller, by the drives of its robot.

use canopen_protocol::id::Function;
use firmware::groups::cia402::options::HOST_NODE;
use mit_protocol::REGISTER_ID;
use odrive_protocol::{Order, Request};
use protocol::powercube::{Address, Channel};
use protocol::{Frame, Id};
use robot_model::{MitMotors, RobotModel};

/// Whether a controller sends such a frame to the drives of `robot`; no drive does. Frames of the host link are none.
#[must_use]
pub fn is_order(robot: &RobotModel, frame: &Frame) -> bool {
    if let Some(motors) = robot.mit_motors() {
        return is_order_to_motor(motors, frame);
    }
    if robot.cia402_servos().is_some() {
        return match Function::of_frame(frame) {
            Some(Function::Nmt | Function::Sync | Function::Rpdo(..) | Function::SdoToNode(_)) => true,
            Some(Function::Heartbeat(node)) => node.get() == HOST_NODE,
            _ => false,
        };
    }
    if let Some(axes) = robot.odrive_axes() {
        return axes.all().any(|axis| {
            let order = Order::decode(frame, axis.version).map(|(node, _)| node);
            let request = Request::decode(frame, axis.version).map(|(node, _)| node);
            order.or(request) == Some(axis.node)
        });
    }
    matches!(
        Address::of(frame.id()),
        Some(Address::Broadcast | Address::Module(Channel::Get | Channel::Put, _))
    )
}

/// The same for Damiao motors: commands and requests of registers.
#[must_use]
pub fn is_order_to_motor(motors: &MitMotors, frame: &Frame) -> bool {
    let Id::Standard(id) = frame.id() else { return false };
    id.get() == REGISTER_ID || motors.all().any(|motor| u16::from(motor.id.get()) == id.get())
}
