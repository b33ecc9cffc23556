//! The drive groups that a controller of this program can lead on CAN, behind the one seam; the robot file says which.

use firmware::fault::Refusal;
use firmware::group::{
    Command, DriveGroup, GroupCounters, GroupEvent, PositionSample, Profile, Readings, SetPoint, Standing,
    Taken,
};
use firmware::groups::mit::{GripperMotor, Mit, Motor, Options};
use firmware::groups::powercube::PowerCubes;
use firmware::settings::Settings;
use protocol::{Frame, Instant, JointIndex};
use robot_model::{MitMotor, RobotModel};

use super::settings::NoSettings;

/// The drives of one family.
// One controller has one of them: the smaller one may take the room of the larger.
#[allow(clippy::large_enum_variant)]
pub enum CanDrives {
    PowerCubes(PowerCubes),
    Mit(Mit),
}

impl Default for CanDrives {
    fn default() -> Self {
        Self::PowerCubes(PowerCubes::default())
    }
}

impl CanDrives {
    /// The drives of `robot` that `settings` name.
    ///
    /// # Errors
    /// [`NoSettings::Invalid`]: motors that make no group.
    pub fn of(robot: &RobotModel, settings: &Settings) -> Result<Self, NoSettings> {
        let Some(motors) = robot.mit_motors() else { return Ok(Self::default()) };
        let named = settings.joints().map(|joint| settings.joint.at(joint).address);
        let motor = |address| motors.joints.iter().find(|motor| u32::from(motor.id.get()) == address);
        let joints: Vec<Motor> = named.filter_map(motor).map(motor_of).collect();
        let all = joints.len() == motors.joints.len();
        let options = Options::new(&joints).and_then(|options| match motors.gripper.filter(|_| all) {
            Some(gripper) => options.with_gripper(GripperMotor {
                motor: motor_of(&gripper.motor),
                open_rad: gripper.open_rad as f32,
                closed_rad: gripper.closed_rad as f32,
            }),
            // A controller for some joints leaves the fingers alone.
            None => Ok(options),
        });
        options
            .map(|options| Self::Mit(Mit::new(options)))
            .map_err(|error| NoSettings::Invalid { robot: robot.name().to_owned(), cause: error.to_string() })
    }
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

/// Calls the drives, whichever they are.
macro_rules! forward {
    ($(fn $name:ident(&mut self $(, $arg:ident: $kind:ty)*) $(-> $out:ty)?;)* ; $(fn $look:ident(&self $(, $la:ident: $lk:ty)*) -> $lo:ty;)*) => {
        $(fn $name(&mut self $(, $arg: $kind)*) $(-> $out)? {
            match self {
                Self::PowerCubes(drives) => drives.$name($($arg),*),
                Self::Mit(drives) => drives.$name($($arg),*),
            }
        })*
        $(fn $look(&self $(, $la: $lk)*) -> $lo {
            match self {
                Self::PowerCubes(drives) => drives.$look($($la),*),
                Self::Mit(drives) => drives.$look($($la),*),
            }
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
