//! What moves the joints: the drives of one family, on all joints or on none.
//!
//! A family is a file here and a row of [`Drives`]: description, reader, and what everybody else asks of it ([`DriveFamily`]).

mod cia402;
mod generic;
mod mit;
mod odrive;
mod powercube;
mod reading;
mod travel;

pub use cia402::{Cia402Mode, Cia402Output, Cia402Servo, Cia402Servos};
pub use mit::{MitGripper, MitMotor, MitMotors};
pub use odrive::{OdriveAxes, OdriveAxis, OdriveGripper};
pub use powercube::{Drive, PowerCubes};
pub use travel::FingerTravel;

pub(crate) use generic::read_generic;
pub(crate) use reading::Tables;

use crate::error::LoadError;
use crate::model::RobotModel;

/// What a family says of its drives. The defaults are those of a family that has no such thing.
pub(crate) trait DriveFamily {
    /// The drives of an arm whose joints have tables of this family.
    fn read(tables: &Tables<'_>) -> Result<Option<Self>, LoadError>
    where
        Self: Sized;

    fn addresses(&self) -> Vec<u8>;

    fn rotor_kg_m2(&self, _joint: usize) -> Option<f64> {
        None
    }

    fn motors_text(&self) -> String {
        String::new()
    }

    fn of_controller(&self) -> Option<&'static str> {
        None
    }

    fn opens_its_hand(&self) -> bool {
        true
    }

    fn opening_s(&self) -> Option<f64> {
        None
    }

    fn data_bit_rate_bit_s(&self) -> Option<u32> {
        None
    }
}

macro_rules! families {
    ($(#[$doc:meta] $family:ident($drives:ty) $key:literal)*) => {
        /// The drives of an arm, by family.
        #[derive(Debug, Clone)]
        pub enum Drives {
            $(#[$doc] $family($drives),)*
        }

        /// Tables of a joint that describe its drive: key, and heading for people.
        const TABLES: &[(&str, &str)] = &[$(($key, concat!("[joint.", $key, "]"))),*];

        impl Drives {
            /// Every family reads its tables and refuses what is beside them, PowerCubes last.
            pub(crate) fn read(tables: &Tables<'_>) -> Result<Option<Self>, LoadError> {
                reading::require_one(tables)?;
                type Reader = fn(&Tables<'_>) -> Result<Option<Drives>, LoadError>;
                let mut readers: Vec<Reader> =
                    vec![$(|tables| Ok(<$drives>::read(tables)?.map(Self::$family))),*];
                readers.rotate_left(1);
                readers.into_iter().try_fold(None, |found, read| Ok(found.or(read(tables)?)))
            }

            fn family(&self) -> &dyn DriveFamily {
                match self {
                    $(Self::$family(drives) => drives,)*
                }
            }
        }
    };
}

families! {
    /// Modules of a PowerCube.
    PowerCubes(PowerCubes) "drive"
    /// Damiao motors with MIT frames.
    Mit(MitMotors) "mit"
    /// CANopen servos of profile CiA 402.
    Cia402(Cia402Servos) "cia402"
    /// Axes of ODrives.
    Odrive(OdriveAxes) "odrive"
}

/// Headings of the tables of a joint with a drive other than a PowerCube, as `[joint.a], [joint.b] or [joint.c]`.
#[must_use]
pub fn motor_tables() -> String {
    let [_, before @ .., (_, last)] = TABLES else { return String::new() };
    let before: Vec<&str> = before.iter().map(|(_, heading)| *heading).collect();
    format!("{} or {last}", before.join(", "))
}

impl RobotModel {
    /// What moves the joints; `None` if the robot file describes no drives.
    #[must_use]
    pub fn moved_by(&self) -> Option<&Drives> {
        self.drives.as_ref()
    }

    fn family_of_drives(&self) -> Option<&dyn DriveFamily> {
        self.drives.as_ref().map(Drives::family)
    }

    /// Number of the drive of each joint on its bus, base first; `None` if the robot file describes no drives.
    #[must_use]
    pub fn addresses(&self) -> Option<Vec<u8>> {
        self.family_of_drives().map(DriveFamily::addresses)
    }

    /// Inertia that the rotor of a joint adds, kg·m²; `None` if the tables of its drives do not say it.
    #[must_use]
    pub fn rotor_kg_m2(&self, joint: usize) -> Option<f64> {
        self.family_of_drives()?.rotor_kg_m2(joint)
    }

    /// The drives as text, for a fingerprint; empty if there are no drives but PowerCubes.
    #[must_use]
    pub fn motors_text(&self) -> String {
        self.family_of_drives().map(DriveFamily::motors_text).unwrap_or_default()
    }

    /// What the drives are, if they answer a controller only; `None` of PowerCubes, which any host may ask, and without drives.
    #[must_use]
    pub fn drives_of_controller(&self) -> Option<&'static str> {
        self.family_of_drives()?.of_controller()
    }

    /// Whether something opens the hand: a CANopen servo with an output for it, or an ODrive of its own. A PowerCube has an output
    /// always, and beside MIT motors the board of the controller may have one.
    #[must_use]
    pub fn opens_its_hand(&self) -> bool {
        self.family_of_drives().is_none_or(DriveFamily::opens_its_hand)
    }

    /// From the order to open to the free ball, s, if a motor opens the hand.
    #[must_use]
    pub fn opening_s(&self) -> Option<f64> {
        self.family_of_drives()?.opening_s()
    }

    /// Data rate of CAN FD that the drives are set to, bits per second; `None`: classical CAN.
    #[must_use]
    pub fn data_bit_rate_bit_s(&self) -> Option<u32> {
        self.family_of_drives()?.data_bit_rate_bit_s()
    }
}
