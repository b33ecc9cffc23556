//! What the host knows of a family of drives on CAN: the group that a controller of this program leads, which frames are orders, and
//! what a log says of the joints.
//!
//! A family is a file here and a name in `families!`.

mod ahead;
pub mod cia402;
pub mod mit;
mod odrive;
mod powercube;

use std::fmt::Display;

use firmware::fault::Refusal;
use firmware::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, PositionSample, Profile, Readings, SetPoint, Standing,
    Taken,
};
use firmware::groups::cia402::Cia402;
use firmware::groups::mit::Mit;
use firmware::groups::odrive::Odrive;
use firmware::groups::powercube::PowerCubes;
use firmware::registers::FamilyRegisters;
use firmware::settings::Settings;
use protocol::cyphal::cubecell::group_state::DriveDifference;
use protocol::powercube::Address;
use protocol::{Frame, Id, Instant, JointIndex, StandardId};
use robot_model::{Drives, Joint, RobotModel};

/// A family to the host.
trait Family {
    /// The group of the drives of `robot`, or why they form none.
    fn group(&self, robot: &RobotModel) -> Result<CanDrives, String>;

    /// See [`is_order`].
    fn is_order(&self, frame: &Frame) -> bool;

    /// See [`reader`].
    fn reader<'a>(&'a self, _joints: &'a [Joint]) -> Option<Box<dyn Reader + 'a>> {
        None
    }
}

/// Whether a controller sends such a frame to the drives of `robot`; no drive does. Frames of the host link are no orders.
#[must_use]
pub fn is_order(robot: &RobotModel, frame: &Frame) -> bool {
    family_of(robot).is_order(frame)
}

/// Reads positions from the frames of a log in ascending time; `None`: nothing but the facts of [`crate::log`] says them.
pub(crate) fn reader(robot: &RobotModel) -> Option<Box<dyn Reader + '_>> {
    family_of(robot).reader(robot.joints())
}

/// What a frame says of a joint.
pub(crate) struct Measured {
    pub(crate) joint: usize,
    pub(crate) at: Instant,
    pub(crate) q_rad: f64,
    pub(crate) temperature_c: Option<f64>,
}

/// A frame of a log.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a> {
    /// When its bits began and ended.
    pub(crate) begun: Instant,
    pub(crate) at: Instant,
    pub(crate) frame: &'a Frame,
}

/// Angle of a joint whose drive reads an angle, rad.
pub(crate) type JointRad<'a> = &'a dyn Fn(usize, f64) -> f64;

/// See [`reader`].
pub(crate) trait Reader {
    fn take(&mut self, seen: Seen<'_>, joint_rad: JointRad<'_>) -> Option<Measured>;

    /// Takes what the controller reports of a joint, rad.
    fn align(&mut self, _joint: usize, _reported_rad: f64) {}
}

/// Refuses ids on which other frames of these programs go: those of PowerCubes, which `status`, `doctor` and their like send on any bus.
/// Frames of the host link have 29 bits and meet no drive. `fit` says which numbers do, in brackets.
fn alone(ids: impl Iterator<Item = StandardId>, fit: &str) -> Result<(), String> {
    let mut ids = ids.map(Id::Standard);
    match ids.find(|id| Address::of(*id).is_some()) {
        Some(id) => Err(format!(
            "id {id} of a drive is also one of a PowerCube, to which other verbs speak: give the drive another number{fit}"
        )),
        None => Ok(()),
    }
}

/// The families, as [`Drives`] names them: an enum of their groups, and a macro that calls the one that is there.
macro_rules! families {
    ($($family:ident),*) => {
        fn family_of(robot: &RobotModel) -> &dyn Family {
            static WITHOUT: robot_model::PowerCubes = robot_model::PowerCubes(Vec::new());
            match robot.moved_by() {
                None => &WITHOUT,
                $(Some(Drives::$family(drives)) => drives,)*
            }
        }

        /// The drives of one family.
        // One controller has one of them: the smaller one may take the memory of the larger.
        #[allow(clippy::large_enum_variant)]
        pub enum CanDrives {
            $($family($family),)*
        }

        /// Registers that only one family has, of all families.
        pub fn family_registers() -> impl Iterator<Item = &'static FamilyRegisters> {
            [$($family::default().registers()),*].into_iter()
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

/// The object, register or parameter that differs from the robot file, as a controller reports it with fault 209.
#[must_use]
pub fn difference_text(reported: DriveDifference) -> Option<String> {
    use firmware::groups::{cia402, mit, odrive};
    let text = |mismatch: &dyn Display| mismatch.to_string();
    cia402::Mismatch::reported(reported)
        .map(|own| text(&own))
        .or_else(|| mit::Mismatch::reported(reported).map(|own| text(&own)))
        .or_else(|| odrive::Mismatch::reported(reported).map(|own| text(&own)))
}

/// See [`CanDrives::of`]; an error is why motors or servos cannot form a group.
pub(crate) fn group_of(robot: &RobotModel) -> Result<CanDrives, String> {
    family_of(robot).group(robot)
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

    fn registers(&self) -> &'static FamilyRegisters {
        each!(self, drives => drives.registers())
    }

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
        fn standing(&self, joint: JointIndex) -> Standing;
        fn readings(&self, joint: JointIndex) -> Readings;
        fn difference(&self) -> Option<(JointIndex, DriveDifference)>;
        fn counters(&self) -> GroupCounters;
        fn needs_wire(&self, settings: &Settings) -> bool;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::groups::{cia402, mit, odrive};

    #[test]
    fn each_kind_of_difference_belongs_to_one_family() {
        for kind in 0..=u8::MAX {
            // A register and a parameter that there are.
            let read = [0, 21].map(|number| {
                let reported = DriveDifference {
                    what: u32::from_be_bytes([kind, 0, 0, number]),
                    ..DriveDifference::default()
                };
                let families = [
                    cia402::Mismatch::reported(reported).is_some(),
                    mit::Mismatch::reported(reported).is_some(),
                    odrive::Mismatch::reported(reported).is_some(),
                ];
                families.into_iter().filter(|reads| *reads).count()
            });
            assert_eq!(read.into_iter().max(), Some(usize::from((1..=10).contains(&kind))), "{kind}");
        }
    }
}
