//! A link of the operating system in real time.

use can_link::{BusSpec, CanLink, Clock, LinkError, LinkEvent, LinkStats, PollSet, SendError};
use firmware::settings::Settings;
use protocol::{Duration, Frame, Instant, ModuleId, Node};

use super::cycle_timing::{self, CycleTiming};
use super::failure::BusFailure;
use super::seen::Seen;
use super::soft::{SoftController, SoftReport};
use crate::drives::CanDrives;
use crate::node::host_node::HostNode;
use crate::tap::Way;

/// Longest sleep, so that Ctrl-C is seen.
const NAP: Duration = Duration::from_millis(20);
/// In lock step this program gets frames up to this much late: a host reacts to no frame at once.
const FRAME_DELAY: Duration = Duration::from_millis(2);
/// Events taken before deadlines are looked at again.
const EVENTS_PER_STEP: usize = 64;

pub struct LiveBus {
    link: Box<dyn CanLink + Send>,
    soft: Option<SoftController>,
    clock: Clock,
    spec: BusSpec,
    host_node: HostNode,
    last: Instant,
    dropped: u64,
}

impl LiveBus {
    /// Joins the bus that `spec` names.
    pub fn open(spec: &BusSpec) -> Result<Self, BusFailure> {
        let clock = spec.clock();
        let mut link = can_link::open(spec, clock)?;
        link.bear_late_frames(FRAME_DELAY);
        let last = clock.now();
        Ok(Self {
            link,
            soft: None,
            clock,
            spec: spec.clone(),
            host_node: HostNode::default(),
            last,
            dropped: 0,
        })
    }

    /// Puts a soft controller on the bus, in a thread of its own.
    ///
    /// # Errors
    /// The operating system gives no thread or no random bytes.
    pub(super) fn start_controller(self, settings: Settings, drives: CanDrives) -> Result<Self, BusFailure> {
        if self.clock.is_manual() {
            // Each thread has its own turns, and so its own connection.
            let clock = self.spec.clock();
            let wire = can_link::open(&self.spec, clock)?;
            let (soft, _) = SoftController::start(wire, clock, settings, drives)?;
            return Ok(Self { soft: Some(soft), ..self });
        }
        let (soft, session_link) = SoftController::start(self.link, self.clock, settings, drives)?;
        Ok(Self { link: Box::new(session_link), soft: Some(soft), ..self })
    }

    /// Measures what the machine and the bus can keep, with requests to `modules`; the host node gets no frames meanwhile.
    pub(super) fn measure_cycle_timing(&mut self, modules: &[ModuleId]) -> Result<CycleTiming, BusFailure> {
        self.link.bear_late_frames(Duration::ZERO);
        let measured = cycle_timing::measure(&mut *self.link, self.clock, modules);
        self.link.bear_late_frames(FRAME_DELAY);
        Ok(measured?)
    }

    /// Takes the soft controller off the bus; the link stays.
    pub(super) fn switch_controller_off(&mut self) {
        if let Some(soft) = &self.soft {
            soft.switch_off();
        }
    }

    /// How the soft controller's thread did; ends it, and with it the link.
    pub(super) fn finish_controller(&mut self) -> Option<SoftReport> {
        let soft = self.soft.as_mut()?;
        if self.clock.is_manual() {
            soft.ask_to_end();
            // Time would wait for this side while this side waits for the thread.
            self.link = Box::new(Closed(self.spec.to_string()));
        }
        soft.finish()
    }

    /// Of the adapter that this program sets up.
    pub(super) const fn bit_rate_bit_s(&self) -> Option<u32> {
        match self.spec {
            BusSpec::Slcan { bitrate, .. } => Some(bitrate.bits_per_second()),
            _ => None,
        }
    }

    pub(super) fn takes_fd(&self) -> Result<(), LinkError> {
        self.link.takes_fd()
    }

    pub(super) fn now(&self) -> Instant {
        self.clock.now().max(self.last)
    }

    /// Events reported later have this time or a later one. [`LiveBus::now`] does not guarantee that: a frame may
    /// have arrived while this thread slept.
    pub(super) const fn heard_until(&self) -> Instant {
        self.last
    }

    /// Unix time at time zero; zero in lock step.
    pub(super) fn zero_unix(&self) -> Duration {
        self.clock.to_unix(Instant::ZERO).saturating_since(Instant::ZERO)
    }

    pub(super) fn host_node(&mut self) -> &mut HostNode {
        let now = self.now();
        self.host_node.advance_to(now);
        &mut self.host_node
    }

    /// Frames that the link did not take because its queue was full.
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    pub(super) fn step(&mut self, until: Instant, seen: &mut Seen<'_>) -> Result<(), BusFailure> {
        self.send_out(seen)?;
        let mut idle = false;
        for _ in 0..EVENTS_PER_STEP {
            match self.link.receive()? {
                Some(LinkEvent::Frame { at, frame, .. }) => {
                    self.last = self.last.max(at);
                    self.serve_deadline();
                    seen.frame(self.last, Way::Received, &frame);
                    self.host_node.handle_frame(self.last, &frame);
                }
                Some(LinkEvent::BusError { at, error }) => {
                    self.last = self.last.max(at);
                    seen.bus_error(self.last, &error);
                }
                None => {
                    idle = true;
                    break;
                }
            }
            self.send_out(seen)?;
        }
        self.last = self.now();
        self.serve_deadline();
        self.send_out(seen)?;
        if idle {
            let wake = self.host_node.poll_timeout().into_iter().chain([until, self.last + NAP]).min();
            // An answer to what was just sent may have changed what the caller waits for: at most one nap late.
            can_link::wait(&[&*self.link], &self.clock, wake).map_err(BusFailure::Wait)?;
        }
        Ok(())
    }

    fn serve_deadline(&mut self) {
        if self.host_node.poll_timeout().is_some_and(|due| due <= self.last) {
            self.host_node.handle_timeout(self.last);
        }
    }

    fn send_out(&mut self, seen: &mut Seen<'_>) -> Result<(), BusFailure> {
        while let Some(frame) = self.host_node.poll_frame() {
            // A later event may have an earlier time, that of its arrival elsewhere; the record continues in order.
            self.last = self.now();
            match self.link.send(&frame) {
                Ok(()) => seen.frame(self.last, Way::Sent, &frame),
                Err(SendError::QueueFull { .. }) => self.dropped += 1,
                Err(SendError::Link(error)) => return Err(error.into()),
                Err(_) => self.dropped += 1,
            }
        }
        Ok(())
    }
}

/// A link that was given up.
struct Closed(String);

impl CanLink for Closed {
    fn name(&self) -> &str {
        &self.0
    }

    fn send(&mut self, _: &Frame) -> Result<(), SendError> {
        Err(LinkError::Closed { link: self.0.clone() }.into())
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        Err(LinkError::Closed { link: self.0.clone() })
    }

    fn register<'a>(&'a self, _: &mut PollSet<'a>) {}

    fn stats(&self) -> LinkStats {
        LinkStats::default()
    }
}

#[cfg(test)]
mod tests {
    use std::cell::{Cell, RefCell};
    use std::rc::Rc;
    use std::sync::Arc;
    use std::{io, thread};

    use protocol::StandardId;

    use super::super::session::{Medium, Session};
    use super::*;
    use crate::tap::Tap;

    /// Every second `receive` returns a frame. Its time is that of the `receive` before, which returned no frame.
    struct Delayed {
        clock: Clock,
        arrived: Option<Instant>,
    }

    impl CanLink for Delayed {
        fn name(&self) -> &str {
            "delayed"
        }

        fn send(&mut self, _: &Frame) -> Result<(), SendError> {
            Ok(())
        }

        fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
            let frame = Frame::from_array(StandardId::from_low_bits(0x0A5), [8]);
            let event = self.arrived.take().map(|at| LinkEvent::Frame { at, stamp: None, frame });
            if event.is_none() {
                thread::sleep(std::time::Duration::from_micros(100));
                self.arrived = Some(self.clock.now());
            }
            Ok(event)
        }

        fn register<'a>(&'a self, _: &mut PollSet<'a>) {}

        fn stats(&self) -> LinkStats {
            LinkStats::default()
        }
    }

    /// Times in the order of the reports: of frames, and of complete reception.
    #[derive(Clone, Default)]
    struct Times(Rc<RefCell<Vec<(bool, Instant)>>>);

    impl Tap for Times {
        fn frame(&mut self, at: Instant, _: Way, _: &Frame) -> io::Result<()> {
            self.0.borrow_mut().push((true, at));
            Ok(())
        }

        fn time(&mut self, now: Instant) -> io::Result<()> {
            self.0.borrow_mut().push((false, now));
            Ok(())
        }
    }

    #[test]
    fn no_frame_is_reported_with_a_time_before_one_that_was_reported_already() {
        let spec: BusSpec = "vcan0".parse().unwrap();
        let clock = spec.clock();
        let (link, last) = (Box::new(Delayed { clock, arrived: None }), clock.now());
        let bus = LiveBus { link, soft: None, clock, spec, host_node: HostNode::default(), last, dropped: 0 };
        let name = "delayed".to_owned();
        let mut session =
            Session::new(Medium::Live(Box::new(bus)), name, Arc::default(), Rc::new(Cell::new(false)));
        let times = Times::default();
        session.add_tap(Box::new(times.clone()));
        session.pass(Duration::from_millis(200)).unwrap();
        let reported = times.0.borrow();
        let frames = reported.iter().filter(|(is_frame, _)| *is_frame).count();
        assert!(frames > 1, "only {frames} frames");
        assert!(reported.iter().map(|(_, at)| at).is_sorted(), "{reported:?}");
    }
}
