//! One axis of an ODrive behind the wire: CANSimple 0.5.6 or 0.6.x, its inner loops, its watchdog.
//!
//! Written from the maker's description of the frames; no real controller was at hand.
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | `axis` | [`OdriveAxis`]: power, frames, torque; the [`protocol::Node`] |
//! | `input` | from what a host wants to the set point of the loops |
//! | `on_arm` | the axes of an arm, made from its robot file |
//! | `options` | [`OdriveOptions`]: the axis as it is configured; [`OdriveFaults`]: what is wrong with it |
//!
//! # State
//!
//! ```text
//!        power          closed loop                     idle, or an error that only Clear_Errors ends
//!  Off ─────────► idle ─────────────► torque on ────────────────────────────► idle
//!                  │ ▲
//!     index search ▼ │ found
//!             turns slowly
//! ```
//!
//! # Inner loops
//!
//! ```text
//! v = clip(v_ff + k_p (p_wanted - p))        turns/s
//! t = t_ff + k_v (v - v_actual) + integral   N·m at the motor, limited by the current
//! ```
//!
//! # Choices where the sources are silent
//!
//! * The watchdog, if it is on, starves only while there is torque; each order feeds it, a request does not.
//! * Entering closed loop, and a change of the mode, put the set point where the shaft stands.
//! * Calibrations other than the index search and homing end with an error: there is nothing to calibrate, and no switch.
//! * Parameters by number (`Rx_Sdo`) are those of [`OdriveOptions::endpoints`]: the numbers differ per build of the firmware.
//! * Estimates are sent in every state, with the position counted from power-on if the index was not found.

mod axis;
mod input;
mod on_arm;
mod options;

pub use axis::OdriveAxis;
pub(super) use on_arm::arm;
pub use options::{OdriveFaults, OdriveOptions, OdriveParameter};
