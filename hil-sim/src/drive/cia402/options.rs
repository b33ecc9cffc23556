//! A servo as it is delivered, and what is wrong with it.

use protocol::Duration;
use protocol::canopen::NodeId;

/// What the reference does from a SYNC without a new target on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissingTarget {
    /// It stands.
    Hold,
    /// It continues for one period, then stands.
    Extrapolate,
}

/// A module that interpolates: modes profile position, velocity and interpolated position (1, 2, 7), of which only the last one moves
/// it here; a fixed unit. It shows the objects that SCHUNK's public DCF of 2013 (PRL+, ERB) names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interpolating {
    /// Duration of the search for the commutation, at the first order to enable in mode 7 while SYNC runs.
    pub commutation: Duration,
    /// SYNCs without a new position until it brakes, as object 200E is delivered; 0: it does not watch.
    pub cycles_without_data: u8,
    /// Reaction to a lost link, as object 6007 has it: 0 none, 1 fault, 2 off, 3 quick stop.
    pub on_lost_link: u8,
    /// Positions that may wait (object 60C4:2, delivered as 0). More than one is shown only.
    pub queue: u32,
}

/// A servo as delivered. Torques and speeds at the shaft, behind the gear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoOptions {
    /// Its number.
    pub node: NodeId,
    /// Vendor and product (objects 1018:1, 1018:2).
    pub vendor: u32,
    /// See `vendor`.
    pub product: u32,
    /// Name (object 1008).
    pub name: &'static str,
    /// Counts of the encoder per turn of the motor (object 608F).
    pub encoder_counts: u32,
    /// Turns of the motor per turn of the shaft (object 6091).
    pub gear: u32,
    /// Continuous torque, N·m; the unit of torques (object 6076).
    pub rated_nm: f64,
    /// Torque that it can give at rest, N·m.
    pub peak_nm: f64,
    /// Speed at which it gives no torque any more, rad/s.
    pub no_load_rad_s: f64,
    /// Position loop, N·m/rad.
    pub stiffness_nm_rad: f64,
    /// Velocity loop, N·m·s/rad.
    pub damping_nms_rad: f64,
    /// The encoder knows the shaft at power-on.
    pub is_absolute: bool,
    /// Angle of the shaft at which an absolute encoder counts 0, rad.
    pub zero_rad: f64,
    /// Modes: bit n - 1 for mode n (object 6502).
    pub modes: u32,
    /// It follows in mode 7 only.
    pub interpolating: Option<Interpolating>,
    /// See [`MissingTarget`].
    pub missing: MissingTarget,
    /// Maps of PDOs cannot be changed.
    pub maps_are_fixed: bool,
    /// Bit of the outputs (object 60FE:1) that opens a gripper; `None`: no gripper hangs on it.
    pub gripper_bit: Option<u8>,
    /// From power to the first heartbeat.
    pub boot: Duration,
    /// From service data to their answer.
    pub answer_after: Duration,
    /// From SYNC to the process data.
    pub process_after: Duration,
}

impl ServoOptions {
    /// Homing and the cyclic modes.
    pub const MODES: u32 = 1 << 5 | 1 << 7;

    /// A servo of 50 N·m with an absolute encoder and a gear of 100.
    pub fn of(node: NodeId) -> Self {
        Self {
            node,
            vendor: 0xFB,
            product: 0x6150_0000,
            name: "simulated servo of CiA 402",
            encoder_counts: 4_096,
            gear: 100,
            rated_nm: 50.0,
            peak_nm: 100.0,
            no_load_rad_s: 3.0,
            stiffness_nm_rad: 1e5,
            damping_nms_rad: 500.0,
            is_absolute: true,
            zero_rad: 0.0,
            modes: Self::MODES,
            interpolating: None,
            missing: MissingTarget::Hold,
            maps_are_fixed: false,
            gripper_bit: None,
            boot: Duration::from_millis(200),
            answer_after: Duration::from_micros(800),
            process_after: Duration::from_micros(60),
        }
    }

    /// Modes of a module that interpolates.
    pub const INTERPOLATING_MODES: u32 = 0x43;

    /// The same as a module that interpolates and counts millidegrees.
    #[must_use]
    pub fn interpolating(self) -> Self {
        Self {
            name: "simulated module of CiA 402",
            encoder_counts: 360_000,
            gear: 1,
            modes: Self::INTERPOLATING_MODES,
            interpolating: Some(Interpolating {
                commutation: Duration::from_millis(5_000),
                cycles_without_data: 6,
                on_lost_link: 1,
                queue: 0,
            }),
            ..self
        }
    }

    /// Counts in a radian of the shaft.
    pub fn counts_per_rad(&self) -> f64 {
        f64::from(self.encoder_counts) * f64::from(self.gear) / std::f64::consts::TAU
    }
}

/// What is wrong with a servo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ServoFaults {
    /// It takes and sends nothing.
    pub is_silent: bool,
    /// Its heartbeat is missing; everything else works.
    pub heartbeat_is_lost: bool,
    /// The heartbeat of others can be supervised, and nothing happens when it stays away.
    pub supervision_is_dead: bool,
    /// Object 6061 never shows the ordered mode.
    pub mode_is_never_shown: bool,
    /// In mode 7 it takes no positions, whatever is ordered.
    pub interpolation_is_off: bool,
    /// The next positions of this number are torn: their upper half is from another time.
    pub torn_answers: u32,
    /// Process data hold what the last ones before held.
    pub answers_are_stale: bool,
    /// One set of process data in this many is not sent; 0: all are sent.
    pub answer_lost_every: u32,
}
