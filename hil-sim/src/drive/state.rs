//! The whole state of a module: the one struct that the other files of this folder read and write.

use std::collections::VecDeque;

use protocol::powercube::{BaudRate, CubeState, MotionCommand, Request};
use protocol::{Duration, Frame, Instant, ModuleId};

use super::homing::Homing;
use super::options::{DriveOptions, Nameplate};
use super::program::SetpointGenerator;
use super::servo::Servo;
use super::store::Store;
use crate::mechanics::AxisState;
use crate::rng::Rng;

/// Power of the electronics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Power {
    Off,
    Booting { until: Instant },
    Up,
}

/// What waits in the queue.
#[derive(Clone, Copy, Debug)]
pub(super) enum Job {
    Obey(Request),
    /// No request; sent back as it came.
    Echo(Frame),
}

/// Spring-closed brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Brake {
    Closed,
    /// Coil energised, free from `at` on.
    Opening {
        at: Instant,
    },
    Open,
}

impl Brake {
    pub(super) fn closed() -> Self {
        Self::Closed
    }
}

/// For how long something has been out of range, s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Timers {
    pub(super) motor_low_s: f64,
    pub(super) motor_high_s: f64,
    pub(super) logic_low_s: f64,
    pub(super) logic_high_s: f64,
    pub(super) above_nominal_s: f64,
    pub(super) at_maximum_s: f64,
}

/// What a module counts about itself; no frame shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriveCounters {
    /// Requests understood and processed.
    pub processed: u64,
    /// Requests lost because the queue was full.
    pub overflowed: u64,
    /// Frames to this module that were not understood.
    pub not_understood: u64,
    pub stops: u64,
}

/// Measured values and state that a hung measurement task keeps showing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Snapshot {
    pub(super) q_rad: f64,
    pub(super) v_rad_s: f64,
    pub(super) current_a: f64,
    pub(super) state: CubeState,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Afflictions {
    pub(super) frozen: Option<Snapshot>,
    pub(super) slow: Duration,
    /// Angle lost so far, and the angle to lose.
    pub(super) encoder_offset_rad: f64,
    pub(super) encoder_offset_target_rad: f64,
    /// Speed with which it was lost in the last step.
    pub(super) count_loss_rad_s: f64,
}

/// One PowerCube behind the wire.
///
/// # Contract
///
/// * As a [`Node`](protocol::Node) it takes requests and broadcasts and gives answers and, if wanted, STATE frames.
/// * Physics crosses in three calls, all in joint coordinates (the true ones of the arm, not those that the module assumes):
///   [`PowerCubeDrive::input`] before each step of the mechanics, [`PowerCubeDrive::tick`] after it, and [`PowerCubeDrive::power`].
/// * A request acts and is answered after the processing delay; broadcasts act on reception, so that "start motion"
///   starts all modules at once.
/// * Answers come in the order of the requests. A request that finds the queue full is lost.
#[derive(Clone, Debug)]
pub struct PowerCubeDrive {
    pub(super) plate: Nameplate,
    pub(super) options: DriveOptions,
    pub(super) store: Store,
    pub(super) rng: Rng,

    // Power and bus.
    pub(super) power: Power,
    pub(super) was_up_before: bool,
    pub(super) address: ModuleId,
    pub(super) bit_rate: BaudRate,
    pub(super) queue: VecDeque<Job>,
    /// When the request at the head of the queue is done.
    pub(super) busy_until: Option<Instant>,
    pub(super) outbox: VecDeque<Frame>,
    pub(super) counters: DriveCounters,
    /// Set while the watchdog is armed: enabled, and refreshed at least once since.
    pub(super) watchdog: Option<Instant>,
    pub(super) state_due: Instant,
    pub(super) state_sent: Option<CubeState>,

    // Axis, in joint coordinates.
    pub(super) axis: AxisState,
    pub(super) axis_at: Instant,
    pub(super) motor_v: f64,
    pub(super) logic_v: f64,
    /// Measured minus true position, rad.
    pub(super) shift_rad: f64,
    /// True position at which the raw counter was zero, rad.
    pub(super) counter_zero_rad: f64,
    pub(super) home_counter_rad: f64,
    pub(super) home_to_index_rad: f64,
    pub(super) inputs: u8,
    pub(super) outputs: u8,
    outputs_changed: Instant,
    outputs_set: Instant,

    // Motion and state, in module coordinates.
    pub(super) generator: SetpointGenerator,
    pub(super) servo: Servo,
    pub(super) homing: Option<Homing>,
    pub(super) waiting: Option<MotionCommand>,
    pub(super) target_rad: f64,
    pub(super) saved_rad: f64,
    pub(super) previous_rad: f64,
    pub(super) home_ok: bool,
    pub(super) halted: bool,
    pub(super) causes: CubeState,
    pub(super) current_limited: bool,
    pub(super) current_a: f64,
    pub(super) temperature_c: f64,
    pub(super) brake: Brake,
    pub(super) timers: Timers,
    pub(super) afflictions: Afflictions,
}

impl PowerCubeDrive {
    /// A module without power, standing at `q_rad` (joint coordinates); `seed` feeds its random numbers.
    pub fn new(plate: Nameplate, options: DriveOptions, seed: u64, q_rad: f64) -> Self {
        let store = Store::factory(&plate, &options);
        let address = plate.address;
        let mut drive = Self {
            rng: Rng::stream(seed, &format!("drive {address}")),
            power: Power::Off,
            was_up_before: false,
            address,
            bit_rate: BaudRate::Kbit1000,
            queue: VecDeque::new(),
            busy_until: None,
            outbox: VecDeque::new(),
            counters: DriveCounters::default(),
            watchdog: None,
            state_due: Instant::ZERO,
            state_sent: None,
            axis: AxisState { q_rad, ..AxisState::default() },
            axis_at: Instant::ZERO,
            motor_v: plate.supply_v,
            logic_v: 24.0,
            shift_rad: 0.0,
            counter_zero_rad: q_rad,
            home_counter_rad: 0.0,
            home_to_index_rad: 0.0,
            inputs: 0,
            outputs: 0,
            outputs_changed: Instant::ZERO,
            outputs_set: Instant::ZERO,
            generator: SetpointGenerator::new(options.step_path),
            servo: Servo::new(&plate, 1.0, 1.0, 1.0),
            homing: None,
            waiting: None,
            target_rad: 0.0,
            saved_rad: 0.0,
            previous_rad: 0.0,
            home_ok: false,
            halted: false,
            causes: CubeState::EMPTY,
            current_limited: false,
            current_a: 0.0,
            temperature_c: options.ambient_c,
            brake: Brake::closed(),
            timers: Timers::default(),
            afflictions: Afflictions::default(),
            store,
            plate,
            options,
        };
        drive.recalc();
        drive
    }

    pub fn address(&self) -> ModuleId {
        self.address
    }

    /// What is engraved on it.
    pub fn nameplate(&self) -> &Nameplate {
        &self.plate
    }

    /// What it counts about itself.
    pub fn counters(&self) -> DriveCounters {
        self.counters
    }

    /// Digital outputs 0..3 in bits 0..3; output 0 may show errors by set-up.
    pub fn outputs(&self) -> u8 {
        self.shown_outputs()
    }

    pub fn outputs_changed(&self) -> Instant {
        self.outputs_changed
    }

    /// When the outputs were set last, changed or not.
    pub fn outputs_set(&self) -> Instant {
        self.outputs_set
    }

    pub(super) fn set_outputs(&mut self, now: Instant, outputs: u8) {
        self.outputs_set = now;
        if outputs != self.outputs {
            self.outputs = outputs;
            self.outputs_changed = now;
        }
    }

    /// Sets the digital inputs 0..3 (bits 0..3).
    pub fn set_inputs(&mut self, inputs: u8) {
        self.inputs = inputs & 0x0F;
    }
}
