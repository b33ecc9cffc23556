//! One PowerCube behind the wire: the M5 protocol as a module, its motion generator, its position loop.
//!
//! Written from the protocol reference. Where the reference has a gap, the choice is an option with a default ([`options`]).
//!
//! # Map
//!
//! | file | holds |
//! |---|---|
//! | `state` | [`PowerCubeDrive`]: the whole state of a module |
//! | `module` | power, request queue, answers in order, timers; the [`protocol::Node`] |
//! | `obey` | effect of each request and broadcast |
//! | `measure` | content of answers: state word, measured and computed parameters |
//! | `store` | stored parameters: types, limits, defaults, permanent copy |
//! | `supervise` | actions of a module without an order: stops, brake, limits, following error, overload, homing |
//! | `homing` | the search for the zero position |
//! | `program`, [`ramp`] | set-point as a closed-form function of time |
//! | `servo` | position loop and the torque that the current limit allows |
//! | `faults` | its faults |
//! | [`mit`], [`odrive`], [`cia402`] | a Damiao motor, an axis of an ODrive, a CANopen servo instead of a PowerCube |
//! | `arm` | such motors on the joints of an arm |
//! | [`mod@bench`] | such motors with an inertia each, as participants of a bus |
//!
//! # State
//!
//! ```text
//!                power          boot time             HOME                    edge found, standing
//!        Off ───────────► Booting ───────► up, not homed ──────► homing ─────────────────────► homed
//!                                             │  ▲                  │                            │
//!             error, HALT, watchdog           ▼  │ RESET            ▼                            ▼
//!                                        halted (braking, then brake) ◄───────────────────────────
//! ```
//!
//! Choices that are not options, because no host depends on them:
//!
//! * Position in an incremental module is zero at power-on and means nothing until homed; soft limits act only when
//!   homed. Limit switches act always.
//! * A motion during homing, while halted or in error, or with the brake closed by BRAKE_AT_POWERON is answered and not
//!   executed; RESET closes the loop and opens the brake.
//! * BEYOND_SOFT and BEYOND_HARD come when the axis is beyond the limit *and* moves outwards, so that RESET and a
//!   motion inwards lead out again.
//! * Running into both limit switches without an edge ends homing in HALTED without an error bit.
//! * A ramp's phase bits follow the set-point; MOTION falls and RAMP_END rises when the axis stands, too.
//! * The watchdog disarms when it has expired; the next refresh arms it again.
//! * The baud broadcast changes the working copy of the bit rate; after power-off without SAVE the old one is back.
//! * A new address acts from the next power-on, after SAVE.
//! * Bits of Config and Setup without a line in `supervise` or `obey` are stored and read back, and do nothing: they
//!   belong to other hardware (25xx, linear modules, Profibus).

pub(crate) mod arm;
pub mod bench;
pub mod cia402;
mod faults;
mod homing;
mod measure;
pub mod mit;
mod module;
mod obey;
pub mod odrive;
pub mod options;
mod program;
pub mod ramp;
mod servo;
mod state;
mod store;
mod supervise;

use robot_model::Drives;

pub use options::{DriveOptions, Nameplate};
pub use state::{DriveCounters, PowerCubeDrive};
pub use supervise::COUNT_LOSS_RAD_S;

/// The motors at rest that a robot file describes; `None`: it describes PowerCubes, which hang on supplies, or no drives. An error says
/// which motors are not simulated.
pub(crate) fn motors_of(start: &arm::Start<'_>) -> Result<Option<arm::Arm>, String> {
    Ok(match start.robot.moved_by() {
        None | Some(Drives::PowerCubes(_)) => None,
        Some(Drives::Mit(motors)) => Some(mit::arm(motors, start)?),
        Some(Drives::Cia402(servos)) => Some(cia402::arm(servos, start)),
        Some(Drives::Odrive(axes)) => Some(odrive::arm(axes, start)),
    })
}
