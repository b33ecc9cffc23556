//! One CANopen servo of profile CiA 402 behind the wire: network management, dictionary, process data, drive.
//!
//! Written from the public contents of CiA 301 and CiA 402-2; no real node was at hand.
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | `servo` | [`CanopenServo`]: power, network management, SYNC, emergencies; the [`protocol::Node`] |
//! | `motion` | state machine, modes, position loop |
//! | `path` | the reference as closed forms of time |
//! | `dictionary` | objects: type, access, range, value |
//! | `server` | service data: expedited, in segments, read in blocks |
//! | `simulated_servo.eds` | electronic data sheet of the servo, which it stores |
//! | `on_arm` | the motors of an arm, made from its robot file |
//! | `options` | [`ServoOptions`]: the servo as delivered; [`ServoFaults`]: its faults |
//!
//! # Choices that the standard leaves open
//!
//! * Set points act with the SYNC after them. From SYNC to SYNC the reference moves on a straight line, in the time of object 60C2.
//!   The reaction to a missing set point is an option: hold, or one more period with the same speed.
//! * Objects 1400 to 1BFF are written outside of the operational state only, and a map only while its PDO is not valid.
//! * The brake is closed whenever there is no torque.
//! * A target that came while the drive had no torque acts with the first SYNC after it is enabled: the worst case for a host.
//! * A module that interpolates (mode 7) holds one position, and follows it as in mode 8. Until its commutation is found it stays switched on.
//!   Where that search turns the shaft is not known: here it does not.
//! * Lost frames (emergency 8110) are reported and change no state.

mod dictionary;
mod motion;
mod on_arm;
mod options;
mod path;
mod server;
mod servo;

pub(super) use on_arm::arm;
pub use options::{Interpolating, MissingTarget, ServoFaults, ServoOptions};
pub use servo::CanopenServo;
