//! The module as a participant of the bus: power, request queue, answers in order, timers.

use std::collections::VecDeque;

use protocol::powercube::{
    Address, AddressedRequest, BaudRate, Broadcast, Channel, Config, CubeState, MotionCommand, Parameter,
    Reply, Request,
};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

use super::homing::Homing;
use super::options::{DriveOptions, Nameplate, SignOfLife, StateFrames, UnknownRequest};
use super::program::{Program, SetpointGenerator};
use super::servo::Servo;
use super::store::Store;
use super::supervise::{Brake, Timers};
use crate::mechanics::AxisState;
use crate::participants::BusConnection;
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
enum Job {
    Obey(Request),
    /// No request; sent back as it came.
    Echo(Frame),
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
    /// Emergency stops.
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

/// Faults that last.
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
/// * As a [`Node`] it takes requests and broadcasts and gives answers and, if wanted, STATE frames.
/// * Physics crosses in three calls, all in joint coordinates (the arm's truth, not what the module believes):
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
    was_up_before: bool,
    pub(super) address: ModuleId,
    pub(super) bit_rate: BaudRate,
    queue: VecDeque<Job>,
    /// When the request at the head of the queue is done.
    busy_until: Option<Instant>,
    outbox: VecDeque<Frame>,
    pub(super) counters: DriveCounters,
    /// Set while the watchdog is armed: enabled, and refreshed at least once since.
    pub(super) watchdog: Option<Instant>,
    state_due: Instant,
    state_sent: Option<CubeState>,

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
    /// A module without power, standing at `q_rad` (joint coordinates); its chances come from `seed`.
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

    /// The address it answers on.
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

    /// When the outputs changed last.
    pub fn outputs_changed(&self) -> Instant {
        self.outputs_changed
    }

    pub(super) fn set_outputs(&mut self, now: Instant, outputs: u8) {
        if outputs != self.outputs {
            self.outputs = outputs;
            self.outputs_changed = now;
        }
    }

    /// Sets the digital inputs 0..3 (bits 0..3).
    pub fn set_inputs(&mut self, inputs: u8) {
        self.inputs = inputs & 0x0F;
    }

    /// Takes part in a bus of rate `bus`, is set to another rate, or has no power.
    pub fn link(&self, bus: BaudRate) -> BusConnection {
        match self.power {
            Power::Up if self.bit_rate == bus => BusConnection::On,
            Power::Up => BusConnection::OtherRate,
            Power::Off | Power::Booting { .. } => BusConnection::Off,
        }
    }

    /// Switches the electronics on or off; no change if they are so already.
    pub fn power(&mut self, now: Instant, on: bool) {
        match (on, self.power) {
            (true, Power::Off) => self.boot(now),
            (false, Power::Booting { .. } | Power::Up) => self.power_down(),
            (true, Power::Booting { .. } | Power::Up) | (false, Power::Off) => {}
        }
    }

    /// On and booted at `now`: a cell that has been standing there for a while.
    pub fn switch_on(&mut self, now: Instant) {
        self.come_up(now);
    }

    /// Off and on again at once: saved parameters are loaded, home is lost, answers come after the boot time.
    pub fn restart(&mut self, now: Instant) {
        self.power_down();
        self.boot(now);
    }

    fn power_down(&mut self) {
        self.power = Power::Off;
        self.queue.clear();
        self.busy_until = None;
        self.outbox.clear();
        self.watchdog = None;
        self.waiting = None;
        self.homing = None;
        self.generator.start(self.axis_at, Program::Open);
        self.brake = Brake::closed();
        self.current_a = 0.0;
    }

    fn boot(&mut self, now: Instant) {
        self.power = Power::Booting { until: now + self.options.boot_time };
    }

    /// End of the boot: storage is read, the position known or not, the loop closed.
    fn come_up(&mut self, now: Instant) {
        self.power = Power::Up;
        self.store.reload();
        self.recalc();
        self.address =
            ModuleId::new(self.store.number(Parameter::DefAddress) as u8).unwrap_or(self.plate.address);
        self.bit_rate =
            BaudRate::from_code(self.store.number(Parameter::DefCanBaud) as u8).unwrap_or(BaudRate::Kbit1000);
        let knows_position =
            self.store.setup().is_absolute() || (self.options.starts_homed && !self.was_up_before);
        self.was_up_before = true;
        let q_rad = self.true_q_rad(now);
        self.counter_zero_rad = q_rad;
        self.afflictions.encoder_offset_rad = 0.0;
        self.afflictions.encoder_offset_target_rad = 0.0;
        self.home_ok = knows_position;
        self.shift_rad = if knows_position { -self.plate.home_error_rad } else { -q_rad };
        self.halted = false;
        self.causes = CubeState::EMPTY;
        self.current_limited = false;
        self.set_outputs(now, 0);
        self.temperature_c = self.temperature_c.max(self.options.ambient_c);
        self.timers = Timers::default();
        self.target_rad = self.measured_rad(now);
        (self.saved_rad, self.previous_rad) = (self.target_rad, self.target_rad);
        self.state_due = now;
        self.state_sent = None;
        if self.has_brake() && self.store.config().contains(Config::BRAKE_AT_POWERON) {
            self.generator.start(now, Program::Open);
        } else {
            self.close_loop(now);
        }
    }

    /// Time from taking up a request to its answer.
    fn delay(&mut self) -> Duration {
        let (mean, jitter) =
            (self.options.processing_delay.as_micros(), self.options.processing_jitter.as_micros());
        let drawn = self.rng.within(mean.saturating_sub(jitter), mean.saturating_add(jitter));
        Duration::from_micros(drawn.max(1)) + self.afflictions.slow
    }

    fn take_request(&mut self, now: Instant, frame: &Frame) {
        let job = match AddressedRequest::decode(frame) {
            Ok(addressed) => Job::Obey(addressed.request),
            Err(_) => {
                self.counters.not_understood += 1;
                if self.options.unknown == UnknownRequest::Silence || frame.data().is_empty() {
                    return;
                }
                Job::Echo(*frame)
            }
        };
        if self.queue.len() >= self.options.queue_depth.max(1) {
            self.counters.overflowed += 1;
            return;
        }
        self.queue.push_back(job);
        if self.busy_until.is_none() {
            self.busy_until = Some(now + self.delay());
        }
    }

    fn process_due_requests(&mut self, now: Instant) {
        while let Some(done) = self.busy_until.filter(|&done| done <= now) {
            match self.queue.pop_front() {
                None => {
                    self.busy_until = None;
                    return;
                }
                Some(Job::Obey(request)) => {
                    self.counters.processed += 1;
                    if let Some(reply) = self.obey(done, request) {
                        self.outbox.push_back(reply.encode(self.address));
                    }
                }
                Some(Job::Echo(frame)) => {
                    self.outbox.extend(Frame::new(Channel::Ack.id(self.address), frame.data()));
                }
            }
            self.busy_until = if self.queue.is_empty() { None } else { Some(done + self.delay()) };
        }
    }

    fn take_broadcast(&mut self, now: Instant, frame: &Frame) {
        match Broadcast::decode(frame) {
            Ok(broadcast) => self.obey_all(now, broadcast),
            Err(_) => self.counters.not_understood += 1,
        }
    }

    /// Enabled and refreshed: armed for another time-out.
    pub(super) fn refresh_watchdog(&mut self, now: Instant) {
        if self.store.config().contains(Config::WATCHDOG_ENABLE) {
            self.watchdog = Some(now + self.options.watchdog_timeout);
        }
    }

    fn state_interval(&self) -> Option<Duration> {
        let bounded = |every: Duration| every.max(Duration::from_micros(100));
        match self.options.state_frames {
            StateFrames::Never => None,
            StateFrames::OnChange { every } => Some(bounded(every)),
            StateFrames::SyncTransmit { every } => {
                self.store.config().contains(Config::SYNC_TRANSMIT).then(|| bounded(every))
            }
        }
    }

    fn send_state_if_due(&mut self, now: Instant) {
        let Some(every) = self.state_interval() else { return };
        if now < self.state_due {
            return;
        }
        self.state_due = now + every;
        let state = self.shown_state(now);
        let always = matches!(self.options.state_frames, StateFrames::SyncTransmit { .. });
        if always || self.state_sent != Some(state) {
            self.state_sent = Some(state);
            self.outbox.push_back(Reply::State(state).encode(self.address));
        }
    }
}

impl Node for PowerCubeDrive {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.handle_timeout(now);
        if self.power != Power::Up || frame.is_remote() {
            return;
        }
        let to_me = match Address::of(frame.id()) {
            Some(Address::Broadcast) => {
                self.take_broadcast(now, frame);
                true
            }
            Some(Address::Module(Channel::Get | Channel::Put, module)) if module == self.address => {
                self.take_request(now, frame);
                true
            }
            _ => false,
        };
        if to_me && self.options.sign_of_life == SignOfLife::AnyFrame && self.watchdog.is_some() {
            self.refresh_watchdog(now);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if let Power::Booting { until } = self.power
            && until <= now
        {
            self.come_up(until);
        }
        if self.power != Power::Up {
            return;
        }
        // A refresh that is due to be processed before the deadline counts, so requests come first.
        self.process_due_requests(now);
        if let Some(deadline) = self.watchdog.filter(|&deadline| deadline <= now) {
            self.watchdog = None;
            self.raise(deadline, CubeState::COMM_ERROR);
        }
        self.send_state_if_due(now);
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.outbox.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.power {
            Power::Off => None,
            Power::Booting { until } => Some(until),
            Power::Up => {
                let state = self.state_interval().map(|_| self.state_due);
                [self.busy_until, self.watchdog, state].into_iter().flatten().min()
            }
        }
    }
}
