//! One Damiao motor behind the wire: MIT frames, its four modes, its registers, its time-out.
//!
//! Written from public descriptions of the frames; no real motor was at hand.
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | `motor` | [`MitMotor`]: power, frames, torque; the [`protocol::Node`] |
//! | `on_arm` | the motors of an arm, made from its robot file |
//! | `options` | [`MitOptions`]: the motor as delivered; [`MitFaults`]: its faults |
//! | `registers` | settings in RAM and flash |
//!
//! # State
//!
//! ```text
//!        power          FC enable                 time-out, heat
//!  Off ─────────► off ◄────────────► on ─────────────────────────► fault, no torque
//!                  ▲    FD disable                                   │
//!                  └──────────────── FB clear ───────────────────────┘
//! ```
//!
//! # Choices that the sources leave open
//!
//! * A set point that arrives while the motor is off is kept. It acts as soon as the motor is enabled, unless another one arrives
//!   first: the worst case for a host. Power-on and a change of the mode clear it.
//! * `FE` sets the zero in every state.
//! * Set to CAN FD (register 35), it obeys and answers CAN FD frames with bit rate switch only, as users report. Set to classical CAN, it
//!   obeys both, and answers classically. The setting acts from the next power-on on.
//! * An order to store is ignored while the motor is on.
//! * Modes 2 to 4 lead a reference at the largest velocity behind a position loop that is critically damped at 30 rad/s for the
//!   rotor alone.

mod motor;
mod on_arm;
mod options;
mod registers;

pub use motor::MitMotor;
pub(super) use on_arm::arm;
pub use options::{MitFaults, MitOptions};
