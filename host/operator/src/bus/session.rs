//! A session on a bus: supplies time and frames to the [`HostNode`], for every kind of bus.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use can_link::{BusError, LinkError, Role, Urgent};
use firmware::authority::{Digest, Key};
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::cyphal::cubecell::stop::Reason;
use protocol::{Duration, Instant, ModuleId};

use super::cycle_timing::CycleTiming;
use super::failure::BusFailure;
use super::live::LiveBus;
use super::seen::Seen;
use super::sim::SimBus;
use super::soft::SoftReport;
use crate::node::host_node::HostNode;
use crate::node::stop_watch::REST_MAX as STOP_REST_MAX;
use crate::tap::Tap;

/// Time that a halt gets to reach the bus before a session is given up.
const HALT_TIME: Duration = Duration::from_millis(20);

/// How [`Session::run`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The condition came true.
    Done,
    TimedOut,
    /// Ctrl-C, SIGTERM or SIGHUP.
    Interrupted,
}

/// Bit rate of a bus whose rate is not known.
pub const BIT_RATE_BIT_S: u32 = 1_000_000;

/// What every kind of bus does for a session.
pub(super) enum Medium {
    Sim(Box<SimBus>),
    Live(Box<LiveBus>),
}

pub struct Session {
    medium: Medium,
    pub(super) taps: Vec<Box<dyn Tap>>,
    interrupt: Arc<AtomicBool>,
    /// A signal does not end what it does: it puts things back.
    puts_back: bool,
    name: String,
    /// This session may have set something in motion.
    moves: bool,
    /// While it does, this thread is not late: without the host's heartbeat a controller stops.
    urgent: Option<Urgent>,
    bus_errors: Vec<(Instant, BusError)>,
    /// Set: the soft controller of the simulated cell is silent.
    controller_off: Rc<Cell<bool>>,
    /// It is a Cyphal node, with a node-ID that no other tool has.
    pub(crate) joined: bool,
    pub(crate) key: Option<Key>,
    /// What this session uploaded last, and the SHA-256 of it.
    pub(crate) uploaded: Option<(Trajectory, Digest)>,
    /// File and settings of the arming that it confirms with its key.
    pub(crate) armed: Option<Digest>,
}

impl Session {
    pub(super) fn new(
        medium: Medium,
        name: String,
        interrupt: Arc<AtomicBool>,
        controller_off: Rc<Cell<bool>>,
    ) -> Self {
        let bus_errors = Vec::new();
        let (taps, moves, urgent) = (Vec::new(), false, None);
        Self {
            medium,
            taps,
            interrupt,
            puts_back: false,
            name,
            moves,
            urgent,
            bus_errors,
            controller_off,
            joined: false,
            key: None,
            uploaded: None,
            armed: None,
        }
    }

    /// Takes the soft controller of this session off the bus, so that the host may send requests to the drives itself.
    pub fn switch_controller_off(&mut self) {
        self.controller_off.set(true);
        if let Medium::Live(live) = &mut self.medium {
            live.switch_controller_off();
        }
    }

    /// Report of the soft controller's thread, on a live bus; ends it, and with it the session's link.
    pub fn finish_controller(&mut self) -> Option<SoftReport> {
        match &mut self.medium {
            Medium::Sim(_) => None,
            Medium::Live(live) => live.finish_controller(),
        }
    }

    /// Measures for [`super::cycle_timing::SPAN`] which control period this machine and this bus can keep, with
    /// requests to `modules` only; `None` in virtual time, which keeps every period. Recorders do not see the
    /// requests, and no soft controller may be on the bus yet.
    pub fn measure_cycle_timing(&mut self, modules: &[ModuleId]) -> Result<Option<CycleTiming>, BusFailure> {
        match &mut self.medium {
            Medium::Sim(_) => Ok(None),
            Medium::Live(live) => live.measure_cycle_timing(modules).map(Some),
        }
    }

    /// The bus as a person would name it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Present time of the session: virtual time of the cell, or the monotonic clock.
    pub fn now(&self) -> Instant {
        match &self.medium {
            Medium::Sim(sim) => sim.now(),
            Medium::Live(live) => live.now(),
        }
    }

    /// Unix time at the session's time zero; zero in virtual time.
    pub fn zero_unix(&self) -> Duration {
        match &self.medium {
            Medium::Sim(_) => Duration::ZERO,
            Medium::Live(live) => live.zero_unix(),
        }
    }

    /// True in virtual time.
    pub const fn is_simulated(&self) -> bool {
        matches!(self.medium, Medium::Sim(_))
    }

    /// Bit rate outside the data phase of CAN FD: that of the simulated bus, or the one that an SLCAN adapter was set to. Of others it is
    /// not known here, and 1 Mbit/s is assumed.
    pub fn bit_rate_bit_s(&self) -> u32 {
        match &self.medium {
            Medium::Sim(sim) => sim.bit_rate_bit_s(),
            Medium::Live(live) => live.bit_rate_bit_s().unwrap_or(BIT_RATE_BIT_S),
        }
    }

    /// Whether CAN FD frames can be sent on this bus.
    ///
    /// # Errors
    /// [`LinkError::ClassicalOnly`], with what helps.
    pub fn takes_fd(&self) -> Result<(), LinkError> {
        match &self.medium {
            Medium::Sim(sim) => sim.takes_fd(),
            Medium::Live(live) => live.takes_fd(),
        }
    }

    /// The embedded cell, if there is one.
    pub fn sim(&mut self) -> Option<&mut SimBus> {
        match &mut self.medium {
            Medium::Sim(sim) => Some(sim),
            Medium::Live(_) => None,
        }
    }

    pub fn add_tap(&mut self, tap: Box<dyn Tap>) {
        self.taps.push(tap);
    }

    pub fn bus_errors(&self) -> &[(Instant, BusError)] {
        &self.bus_errors
    }

    /// The host's node, at the present time. Messages given to it leave with the next [`Session::run`].
    pub fn host_node(&mut self) -> &mut HostNode {
        match &mut self.medium {
            Medium::Sim(sim) => sim.host_node(),
            Medium::Live(live) => live.host_node(),
        }
    }

    /// Declares that from now on something may move because of this session: every end of the session sends a halt first.
    pub fn guard_motion(&mut self) {
        self.moves = true;
        if let (Medium::Live(_), None) = (&self.medium, &self.urgent) {
            self.urgent = Some(Urgent::request(Role::Host));
        }
    }

    /// The motion has ended in order.
    pub fn release_motion(&mut self) {
        self.moves = false;
        self.urgent = None;
    }

    /// Ctrl-C, SIGTERM or SIGHUP has come, and it ends what this session does.
    pub fn is_interrupted(&self) -> bool {
        self.interrupt.load(Ordering::Relaxed) && !self.puts_back
    }

    /// Continues after a signal or a stop: halts what moves, lets it come to rest, and calls `after`. A second
    /// signal still ends the process.
    ///
    /// # Errors
    /// As [`Session::run`], before `after` was called.
    pub fn put_back<R>(&mut self, after: impl FnOnce(&mut Self) -> R) -> Result<R, BusFailure> {
        self.puts_back = true;
        self.host_node().stops.end();
        let rested = self.come_to_rest().map(|()| after(self));
        self.puts_back = false;
        rested
    }

    fn come_to_rest(&mut self) -> Result<(), BusFailure> {
        self.halt_if_moving()?;
        let until = self.now() + STOP_REST_MAX;
        self.run(until, &mut |host_node| {
            let group = host_node.inbox().and_then(|inbox| inbox.group);
            group.is_none_or(|(_, _, group)| !group.state.may_move())
        })
        .map(drop)
    }

    /// Runs until `done` returns true, `until`, or Ctrl-C. `done` is called after each event.
    ///
    /// # Errors
    /// The bus has failed, a recording cannot be written, or another node or a person stopped the arm
    /// ([`Session::watch_stops`]). If [`Session::guard_motion`] is on, a halt was sent before (as far as the bus
    /// still accepted it).
    pub fn run(
        &mut self,
        until: Instant,
        done: &mut dyn FnMut(&mut HostNode) -> bool,
    ) -> Result<Ended, BusFailure> {
        loop {
            if self.is_interrupted() {
                return Ok(Ended::Interrupted);
            }
            // The caller gets the controller's report of a stop first; without the report no more events are taken from the
            // bus.
            let stop = self.host_node().stop_due();
            let is_done = stop.is_none_or(|stop| stop.group.is_some()) && done(self.host_node());
            if is_done && stop.is_none_or(|stop| !stop.by_other) {
                return Ok(Ended::Done);
            }
            if let Some(stop) = stop {
                // The stop must not end again the work that follows it.
                self.host_node().stops.end();
                return Err(self.give_up(BusFailure::StoppedByOther(stop)));
            }
            if self.now() >= until {
                return Ok(Ended::TimedOut);
            }
            if let Err(failure) = self.step(until) {
                return Err(self.give_up(failure));
            }
        }
    }

    /// From now on a stop that this session does not send ends its work, once, with [`BusFailure::StoppedByOther`].
    pub fn watch_stops(&mut self) {
        self.host_node().stops.start();
    }

    /// Ends the job if another node or a person has stopped the arm since [`Session::watch_stops`]; waits for the
    /// controller's report of it. Nothing may be ordered before.
    pub fn heed_stops(&mut self) -> Result<(), BusFailure> {
        let until = self.now() + STOP_REST_MAX;
        while self.host_node().stops.is_pending() && !self.is_interrupted() {
            self.run(until, &mut |_| false)?;
        }
        Ok(())
    }

    /// Lets time pass, also after Ctrl-C; for work that must follow an interruption.
    pub fn pass(&mut self, span: Duration) -> Result<(), BusFailure> {
        let until = self.now() + span;
        while self.now() < until {
            self.step(until)?;
        }
        Ok(())
    }

    /// Halts everything on the bus and gives the frames time to leave.
    pub fn halt(&mut self, reason: Reason) -> Result<(), BusFailure> {
        self.host_node().halt(reason);
        // The controller's report of this halt is expected.
        self.host_node().stops.end();
        self.moves = false;
        self.pass(HALT_TIME)
    }

    /// Halts everything if this session may have left something moving, as its end does.
    pub fn halt_if_moving(&mut self) -> Result<(), BusFailure> {
        if self.moves { self.halt(Reason::SHUTDOWN) } else { Ok(()) }
    }

    /// Ends the session: recordings are complete on the disk when this returns.
    ///
    /// # Errors
    /// [`BusFailure::Recording`].
    pub fn finish(mut self) -> Result<(), BusFailure> {
        let mut result = Ok(());
        for tap in &mut self.taps {
            if let Err(source) = tap.finish() {
                result = Err(BusFailure::Recording { source, halted: false });
            }
        }
        self.taps.clear();
        result
    }

    fn step(&mut self, until: Instant) -> Result<(), BusFailure> {
        let mut seen = Seen { taps: &mut self.taps, errors: &mut self.bus_errors, failed: None };
        match &mut self.medium {
            Medium::Sim(sim) => sim.step(until, &mut seen)?,
            Medium::Live(live) => live.step(until, &mut seen)?,
        }
        let now = match &self.medium {
            Medium::Sim(sim) => sim.now(),
            Medium::Live(live) => live.heard_until(),
        };
        for tap in &mut *seen.taps {
            if let Err(error) = tap.time(now) {
                seen.failed.get_or_insert(error);
            }
        }
        match seen.failed {
            Some(source) => Err(BusFailure::Recording { source, halted: false }),
            None => Ok(()),
        }
    }

    /// Stops what this session moves, with the recorders out of the way.
    fn give_up(&mut self, failure: BusFailure) -> BusFailure {
        if !self.moves {
            return failure;
        }
        if !matches!(failure, BusFailure::StoppedByOther(_)) {
            self.taps.clear();
        }
        let halted = self.halt(Reason::HOST).is_ok();
        match failure {
            BusFailure::Recording { source, .. } => BusFailure::Recording { source, halted },
            other => other,
        }
    }
}

impl Drop for Session {
    /// A caller that leaves without [`Session::release_motion`], also by a panic, leaves a standing arm.
    fn drop(&mut self) {
        let _ = self.halt_if_moving();
        for tap in &mut self.taps {
            let _ = tap.finish();
        }
    }
}
