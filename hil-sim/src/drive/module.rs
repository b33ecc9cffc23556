//! The module as a participant of the bus: power, request queue, answers in order, timers.

use protocol::powercube::{
    Address, AddressedRequest, BaudRate, Broadcast, Channel, Config, CubeState, Parameter, Reply,
};
use protocol::{Duration, Frame, Instant, ModuleId, Node};

use super::options::{SignOfLife, StateFrames, UnknownRequest};
use super::program::Program;
use super::state::{Brake, Job, Power, PowerCubeDrive, Timers};
use crate::participants::BusConnection;

impl PowerCubeDrive {
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

    /// Switches off and on at once: saved parameters are loaded, home is lost, answers come after the boot time.
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
        // A refresh that is due before the deadline counts, so requests are processed first.
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
