//! PowerCubes. The settings name the modules; the positions come from the facts of a log.

use protocol::Frame;
use protocol::powercube::{Address, Channel};
use robot_model::{PowerCubes, RobotModel};

use super::{CanDrives, Family};

impl Family for PowerCubes {
    fn group(&self, _robot: &RobotModel) -> Result<CanDrives, String> {
        Ok(CanDrives::default())
    }

    fn is_order(&self, frame: &Frame) -> bool {
        matches!(
            Address::of(frame.id()),
            Some(Address::Broadcast | Address::Module(Channel::Get | Channel::Put, _))
        )
    }
}
