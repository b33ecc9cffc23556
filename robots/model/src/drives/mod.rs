//! What moves the joints: the drives of one family, on all joints or on none.
//!
//! A family is a file here and a row of [`Drives`]: description, reader, and what everybody else asks of it ([`Common`]).

mod cia402;
mod generic;
mod mit;
mod odrive;
mod powercube;
mod reading;
mod travel;

pub use cia402::{Cia402Mode, Cia402Output, Cia402Servo, Cia402Servos};
pub use mit::{MitGripper, MitMotor, MitMotors};
pub use odrive::{OdriveAxes, OdriveAxis, OdriveEndpoints, OdriveGripper};
pub use powercube::{Drive, PowerCubes};
pub use travel::FingerTravel;

pub(crate) use generic::read_generic;
pub(crate) use reading::Tables;

use crate::error::LoadError;
use crate::model::RobotModel;

/// What everybody asks of the drives, whatever their family.
#[derive(Debug, Clone, Default)]
pub(crate) struct Common {
    /// Numbers on the bus, base first.
    addresses: Vec<u8>,
    /// Of each joint; empty if the tables do not say it.
    rotors_kg_m2: Vec<f64>,
    motors_text: String,
    of_controller: Option<&'static str>,
    hand_lacks_opener: bool,
    opening_s: Option<f64>,
    data_bit_rate_bit_s: Option<u32>,
}

macro_rules! families {
    ($(#[$doc:meta] $family:ident($drives:ty) $module:ident $key:literal)*) => {
        /// The drives of an arm, by family.
        #[derive(Debug, Clone)]
        pub enum Drives {
            $(#[$doc] $family($drives),)*
        }

        /// Tables of a joint that describe its drive: key, and heading for people.
        const TABLES: &[(&str, &str)] = &[$(($key, concat!("[joint.", $key, "]"))),*];

        impl Drives {
            /// Every family reads its tables and refuses what is beside them, PowerCubes last.
            pub(crate) fn read(tables: &Tables<'_>) -> Result<Option<(Self, Common)>, LoadError> {
                reading::require_one(tables)?;
                type Reader = fn(&Tables<'_>) -> Result<Option<(Drives, Common)>, LoadError>;
                let mut readers: Vec<Reader> = vec![$(|tables| {
                    Ok($module::read(tables)?.map(|(drives, common)| (Self::$family(drives), common)))
                }),*];
                readers.rotate_left(1);
                readers.into_iter().try_fold(None, |found, read| Ok(found.or(read(tables)?)))
            }
        }
    };
}

families! {
    /// Modules of a PowerCube.
    PowerCubes(PowerCubes) powercube "drive"
    /// Damiao motors with MIT frames.
    Mit(MitMotors) mit "mit"
    /// CANopen servos of profile CiA 402.
    Cia402(Cia402Servos) cia402 "cia402"
    /// Axes of ODrives.
    Odrive(OdriveAxes) odrive "odrive"
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
        self.drives.as_ref().map(|(drives, _)| drives)
    }

    fn common(&self) -> Option<&Common> {
        self.drives.as_ref().map(|(_, common)| common)
    }

    /// Number of the drive of each joint on its bus, base first; `None` if the robot file describes no drives.
    #[must_use]
    pub fn addresses(&self) -> Option<Vec<u8>> {
        self.common().map(|common| common.addresses.clone())
    }

    /// Inertia that the rotor of a joint adds, kg·m²; `None` if the tables of its drives do not say it.
    #[must_use]
    pub fn rotor_kg_m2(&self, joint: usize) -> Option<f64> {
        self.common()?.rotors_kg_m2.get(joint).copied()
    }

    /// The drives as text, for a fingerprint; empty if there are no drives but PowerCubes.
    #[must_use]
    pub fn motors_text(&self) -> String {
        self.common().map(|common| common.motors_text.clone()).unwrap_or_default()
    }

    /// What the drives are, if they answer a controller only; `None` of PowerCubes, which any host may ask, and without drives.
    #[must_use]
    pub fn drives_of_controller(&self) -> Option<&'static str> {
        self.common()?.of_controller
    }

    /// Whether something opens the hand: a CANopen servo with an output for it, or an ODrive of its own. A PowerCube has an output
    /// always, and beside MIT motors the board of the controller may have one.
    #[must_use]
    pub fn opens_its_hand(&self) -> bool {
        !self.common().is_some_and(|common| common.hand_lacks_opener)
    }

    /// From the order to open to the free ball, s, if a motor opens the hand.
    #[must_use]
    pub fn opening_s(&self) -> Option<f64> {
        self.common()?.opening_s
    }

    /// Data rate of CAN FD that the drives are set to, bits per second; `None`: classical CAN.
    #[must_use]
    pub fn data_bit_rate_bit_s(&self) -> Option<u32> {
        self.common()?.data_bit_rate_bit_s
    }
}
