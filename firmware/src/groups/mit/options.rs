//! What the group must know of its motors, and the ids that it uses on the bus.

use core::fmt;

use crate::groups::dynamics::ArmModel;
use heapless::Vec;
use protocol::mit::{DATA_RATES, KD_MAX_NM_S_RAD, KP_MAX_NM_RAD, MotorId, REGISTER_ID, Ranges};
use protocol::{Duration, FdFlags, Frame, JOINTS_MAX, JointIndex, StandardId, bits};

/// The motor of a joint. Direction, offset and limits are those of [`crate::settings::JointSettings`]; angles are of the shaft, so there is
/// no gear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Id to which it listens (register 8).
    pub id: MotorId,
    /// Id on which it answers (register 7), of no other node.
    pub master: StandardId,
    /// What its fields stand for (registers 21 to 23).
    pub ranges: Ranges,
    /// Position gain, N·m/rad.
    pub kp_nm_rad: f32,
    /// Velocity gain, N·m·s/rad.
    pub kd_nm_s_rad: f32,
}

/// The motor that moves the fingers. It has the place after the last joint, also in faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperMotor {
    /// Ids, ranges and gains; the gains bound the force of the fingers.
    pub motor: Motor,
    /// Angle of open fingers, rad of the shaft.
    pub open_rad: f32,
    /// Angle of closed fingers, rad of the shaft.
    pub closed_rad: f32,
}

/// Why a group cannot be made of these motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionsError {
    /// No motor of a joint, or more than [`JOINTS_MAX`] with the gripper's.
    Count,
    /// Two motors, or a motor and the requests for registers, use one id.
    Overlap {
        /// The id.
        id: StandardId,
        /// The first joint that shares it.
        joint: JointIndex,
    },
    /// A gain is outside its field, or the position gain is zero.
    Gain(JointIndex),
    /// No motor can be set to this data rate, bits per second.
    DataRate(u32),
}

impl fmt::Display for OptionsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count => write!(f, "a group has 1 to {JOINTS_MAX} motors"),
            Self::Overlap { id, joint } => write!(
                f,
                "id {:#05x} of joint {joint} is used twice: give each motor an id and a master id of its own (registers 8 and 7)",
                id.get()
            ),
            Self::Gain(joint) => write!(
                f,
                "a gain of joint {joint} does not fit: kp above 0 up to {KP_MAX_NM_RAD} N·m/rad, kd 0 to {KD_MAX_NM_S_RAD} N·m·s/rad"
            ),
            Self::DataRate(bit_s) => {
                write!(
                    f,
                    "no motor has the data rate {bit_s} bit/s: 2, 2.5, 3.2, 4, 5, 8 or 10 Mbit/s (register 35)"
                )
            }
        }
    }
}

impl core::error::Error for OptionsError {}

/// Shortest frame of eight bytes on classical CAN at 1 Mbit/s.
pub const CLASSICAL_FRAME: Duration = Duration::from_micros(111);

/// Motors of one bus, base first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    motors: Vec<Motor, JOINTS_MAX>,
    gripper: Option<GripperMotor>,
    model: Option<ArmModel>,
    /// Value of register 35 if the motors speak CAN FD.
    fd_rate: Option<u32>,
    /// Shortest time of a frame on the bus.
    pub frame: Duration,
    /// Temperature of transistors or rotor that stops the group, °C.
    pub hot_c: u8,
}

impl Options {
    /// Motors on classical CAN at 1 Mbit/s.
    ///
    /// # Errors
    /// See [`OptionsError`].
    pub fn new(motors: &[Motor]) -> Result<Self, OptionsError> {
        let all = Vec::from_slice(motors).map_err(|_| OptionsError::Count)?;
        let options = Self {
            motors: all,
            gripper: None,
            model: None,
            fd_rate: None,
            frame: CLASSICAL_FRAME,
            hot_c: 90,
        };
        if options.motors.is_empty() {
            return Err(OptionsError::Count);
        }
        options.checked()
    }

    /// With a motor for the fingers.
    ///
    /// # Errors
    /// See [`OptionsError`].
    pub fn with_gripper(self, gripper: GripperMotor) -> Result<Self, OptionsError> {
        if self.motors.is_full() {
            return Err(OptionsError::Count);
        }
        Self { gripper: Some(gripper), ..self }.checked()
    }

    /// With the arm that the motors move: they get the torque that their set points need. Without it the gains alone carry the arm.
    ///
    /// # Errors
    /// [`OptionsError::Count`]: not one body for each joint.
    pub fn with_model(self, model: ArmModel) -> Result<Self, OptionsError> {
        let fits = model.bodies.len() == self.motors.len();
        if fits { Ok(Self { model: Some(model), ..self }) } else { Err(OptionsError::Count) }
    }

    /// With CAN FD, bit rate switch included: 1 Mbit/s, and this data rate in bits per second. Each motor must be set to it.
    ///
    /// # Errors
    /// [`OptionsError::DataRate`].
    pub fn with_fd(self, data_bit_rate_bit_s: u32) -> Result<Self, OptionsError> {
        let rate = DATA_RATES.iter().find(|(_, bit_s)| *bit_s == data_bit_rate_bit_s);
        let Some((code, bit_s)) = rate else { return Err(OptionsError::DataRate(data_bit_rate_bit_s)) };
        let ns = bits::fd_best_case(false, true, 8).time_ns(1_000, u64::from(1_000_000_000 / bit_s));
        Ok(Self { fd_rate: Some(*code), frame: Duration::from_micros(ns / 1_000), ..self })
    }

    /// What register 35 of each motor must hold; `None`: classical CAN, where another value is silence.
    pub(super) const fn fd_rate(&self) -> Option<u32> {
        self.fd_rate
    }

    /// The frame as it goes onto the bus.
    pub(super) const fn on_bus(&self, frame: Frame) -> Frame {
        if self.fd_rate.is_some() { frame.with_fd(FdFlags::BRS) } else { frame }
    }

    /// Time of a frame in bits of 1 Mbit/s, without stuff bits.
    pub(super) const fn frame_bits(&self) -> u32 {
        self.frame.as_micros() as u32
    }

    pub(super) const fn model(&self) -> Option<&ArmModel> {
        self.model.as_ref()
    }

    fn checked(self) -> Result<Self, OptionsError> {
        for (joint, motor) in JointIndex::first(JOINTS_MAX).zip(self.all()) {
            for id in [StandardId::from_low_bits(motor.id.get().into()), motor.master] {
                if self.ids().filter(|used| *used == id).count() > 1 {
                    return Err(OptionsError::Overlap { id, joint });
                }
            }
            let fits = motor.kp_nm_rad > 0.0
                && motor.kp_nm_rad <= KP_MAX_NM_RAD
                && (0.0..=KD_MAX_NM_S_RAD).contains(&motor.kd_nm_s_rad);
            if !fits {
                return Err(OptionsError::Gain(joint));
            }
        }
        Ok(self)
    }

    /// Of the joints, base first, then of the gripper.
    pub(super) fn all(&self) -> impl Iterator<Item = &Motor> {
        self.motors.iter().chain(self.gripper.as_ref().map(|gripper| &gripper.motor))
    }

    /// Every id on which the group or one of its motors sends. No other node of the bus may use one of them.
    pub fn ids(&self) -> impl Iterator<Item = StandardId> + '_ {
        let own = |motor: &Motor| [StandardId::from_low_bits(motor.id.get().into()), motor.master];
        self.all().flat_map(own).chain([StandardId::from_low_bits(REGISTER_ID)])
    }

    pub(super) fn motor(&self, place: JointIndex) -> Option<&Motor> {
        self.all().nth(place.get())
    }

    /// Place of the motor that answers on this id.
    pub(super) fn place_on(&self, master: StandardId) -> Option<JointIndex> {
        let index = self.all().position(|motor| motor.master == master)?;
        JointIndex::new(index).ok()
    }

    /// Place and motor of the gripper.
    pub(super) fn gripper(&self) -> Option<(JointIndex, &GripperMotor)> {
        let place = JointIndex::new(self.motors.len()).ok()?;
        self.gripper.as_ref().map(|gripper| (place, gripper))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motor(id: u8, master: u16) -> Motor {
        Motor {
            id: MotorId::new(id).unwrap(),
            master: StandardId::new(master).unwrap(),
            ranges: Ranges::new(12.5, 45.0, 54.0).unwrap(),
            kp_nm_rad: 50.0,
            kd_nm_s_rad: 5.0,
        }
    }

    #[test]
    fn ids_that_overlap_are_refused_with_id_and_joint() {
        assert!(Options::new(&[motor(1, 0x11), motor(2, 0x12)]).is_ok());
        let overlap = |motors: &[Motor]| match Options::new(motors) {
            Err(OptionsError::Overlap { id, joint }) => (id.get(), joint.get()),
            other => panic!("{other:?}"),
        };
        assert_eq!(overlap(&[motor(1, 0x11), motor(1, 0x12)]), (1, 0));
        assert_eq!(overlap(&[motor(1, 0x11), motor(2, 0x11)]), (0x11, 0));
        assert_eq!(overlap(&[motor(1, 0x11), motor(2, 1)]), (1, 0), "motor 1 obeys the answers of motor 2");
        assert_eq!(overlap(&[motor(1, 0x11), motor(2, 0x7FF)]), (0x7FF, 1));
        assert_eq!(Options::new(&[]), Err(OptionsError::Count));
        assert_eq!(Options::new(&[motor(1, 0x11); 9]), Err(OptionsError::Count));
        let fd = |bit_s| Options::new(&[motor(1, 0x11)]).unwrap().with_fd(bit_s);
        assert_eq!(fd(5_000_000).unwrap().frame, Duration::from_micros(49));
        assert_eq!(fd(6_000_000), Err(OptionsError::DataRate(6_000_000)));
        let joint = JointIndex::new(0).unwrap();
        let refused = Options::new(&[Motor { kd_nm_s_rad: 5.1, ..motor(1, 0x11) }]);
        assert_eq!(refused, Err(OptionsError::Gain(joint)));
    }
}
