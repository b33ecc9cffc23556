//! Drives nodes on a link with the monotonic clock.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use protocol::{Duration, Frame, Instant, Node};

use crate::clock::Clock;
use crate::error::{LinkError, SendError};
use crate::lateness::Lateness;
use crate::link::{CanLink, LinkEvent, wait};

/// Longest sleep, so that a stop flag set by another thread is seen.
const STOP_LOOK: Duration = Duration::from_millis(50);

/// Events taken from the link before the deadlines are looked at again.
const EVENTS_PER_STEP: usize = 256;

/// Frames that the nodes may exchange as a consequence of one event; more count as an endless exchange of answers.
const FRAMES_PER_EVENT_MAX: usize = 4096;

/// Which way a frame went, seen from the nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the link to all nodes.
    Received,
    /// From the node of this index to the link and the other nodes.
    Sent {
        /// Index in the list of nodes.
        node: usize,
    },
}

/// Why a run ended before its end was ordered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Waiting for input failed.
    #[error("cannot wait for input: {0}")]
    Wait(#[from] io::Error),
    /// A node breaks its contract: its deadline stayed in the past after it was served.
    #[error(
        "node {node} wants to be called at {deadline} s again and again (it is {now} s): a defect of the node"
    )]
    StuckDeadline {
        /// Index in the list of nodes.
        node: usize,
        /// The deadline that does not move.
        deadline: Instant,
        /// Time of the call.
        now: Instant,
    },
    /// The nodes answer each other without end.
    #[error(
        "the nodes exchanged {FRAMES_PER_EVENT_MAX} frames within one event at {now} s: a defect of the nodes"
    )]
    Babble {
        /// Time of the event.
        now: Instant,
    },
}

impl RunError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        match self {
            Self::Link(error) => error.next(),
            _ => None,
        }
    }
}

/// What a run did so far.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunStats {
    /// Frames handed to the nodes from the link.
    pub received: u64,
    /// Frames the nodes sent.
    pub sent: u64,
    /// Frames the link did not take because its queue was full.
    pub dropped: u64,
    /// Bus errors reported by the link.
    pub bus_errors: u64,
    /// How late deadlines were served.
    pub deadlines: Lateness,
    /// Time from the arrival of a frame until the nodes have handled it and their answers are passed to the link.
    pub answers: Lateness,
}

/// The loop of the [`Node`] contract: earliest of (frame, deadline), one `handle_*`, drain.
///
/// A node's `now` is the arrival time for frames and the time of the call for deadlines, and never decreases.
/// Arrived frames are handled before due deadlines. The reason: a link that carries text knows as arrival time only
/// the time of its reading; after a late wake-up, a waiting answer would otherwise count as later than its
/// deadline. Nodes on the same runner see each other's frames at once, without bus time; put a bus model between
/// them if that matters. The call takes as long as the nodes take: nothing runs in the background.
///
/// For the smallest lateness its thread asks to be [`crate::Urgent`].
pub struct Runner<'a> {
    link: &'a mut dyn CanLink,
    clock: Clock,
    last: Instant,
    observer: Option<Box<Observer<'a>>>,
    stats: RunStats,
}

/// See [`Runner::observe`].
type Observer<'a> = dyn FnMut(Instant, Direction, &Frame) + 'a;

impl<'a> Runner<'a> {
    /// Nothing happens before [`Self::run`] or [`Self::step`]. `clock` must be the link's.
    pub fn new(link: &'a mut dyn CanLink, clock: Clock) -> Self {
        Self { link, clock, last: Instant::ZERO, observer: None, stats: RunStats::default() }
    }

    /// Calls `observer` for every frame, in the order in which the nodes see them.
    #[must_use]
    pub fn observe(mut self, observer: impl FnMut(Instant, Direction, &Frame) + 'a) -> Self {
        self.observer = Some(Box::new(observer));
        self
    }

    /// What happened so far.
    pub const fn stats(&self) -> &RunStats {
        &self.stats
    }

    /// Repeats [`Self::step`] until `stop` is set or the time is `until`.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn run(
        &mut self,
        nodes: &mut [&mut dyn Node],
        stop: &AtomicBool,
        until: Option<Instant>,
    ) -> Result<(), RunError> {
        while !stop.load(Ordering::Relaxed) && until.is_none_or(|until| self.clock.now() < until) {
            self.step(nodes, until)?;
        }
        Ok(())
    }

    /// Handles what is there and due, then sleeps until the next deadline, event or `until`, at most
    /// 50 ms.
    ///
    /// # Errors
    ///
    /// The link is gone, or a node breaks its contract.
    pub fn step(&mut self, nodes: &mut [&mut dyn Node], until: Option<Instant>) -> Result<(), RunError> {
        for _ in 0..EVENTS_PER_STEP {
            match self.link.receive()? {
                Some(LinkEvent::Frame { at, frame, .. }) => self.serve_frame(nodes, at, &frame)?,
                Some(LinkEvent::BusError { .. }) => self.stats.bus_errors += 1,
                None => {
                    self.serve_deadlines(nodes, self.clock.now())?;
                    return self.sleep(nodes, until);
                }
            }
        }
        // Deadlines are served, however many frames arrive.
        self.serve_deadlines(nodes, self.clock.now())
    }

    fn sleep(&self, nodes: &[&mut dyn Node], until: Option<Instant>) -> Result<(), RunError> {
        let look = self.clock.now() + STOP_LOOK;
        let deadlines = nodes.iter().filter_map(|node| node.poll_timeout());
        let earliest = deadlines.chain(until).chain([look]).min();
        Ok(wait(&[&*self.link], &self.clock, earliest)?)
    }

    fn serve_frame(
        &mut self,
        nodes: &mut [&mut dyn Node],
        at: Instant,
        frame: &Frame,
    ) -> Result<(), RunError> {
        self.last = self.last.max(at);
        let now = self.last;
        self.stats.received += 1;
        self.note(now, Direction::Received, frame);
        for node in &mut *nodes {
            node.handle_frame(now, frame);
        }
        self.drain(nodes, now)?;
        self.stats.answers.record(self.clock.now().saturating_since(at));
        Ok(())
    }

    /// Serves every node whose deadline is at or before `due`.
    fn serve_deadlines(&mut self, nodes: &mut [&mut dyn Node], due: Instant) -> Result<(), RunError> {
        for index in 0..nodes.len() {
            let Some(node) = nodes.get_mut(index) else { break };
            let Some(deadline) = node.poll_timeout().filter(|deadline| *deadline <= due) else { continue };
            self.last = self.last.max(self.clock.now());
            let now = self.last;
            node.handle_timeout(now);
            self.stats.deadlines.record(now.saturating_since(deadline));
            self.drain(nodes, now)?;
            let after = nodes.get(index).and_then(|node| node.poll_timeout());
            if let Some(deadline) = after.filter(|deadline| *deadline <= now) {
                return Err(RunError::StuckDeadline { node: index, deadline, now });
            }
        }
        Ok(())
    }

    /// Passes on what the nodes want to send until all are quiet.
    fn drain(&mut self, nodes: &mut [&mut dyn Node], now: Instant) -> Result<(), RunError> {
        let mut passed = 0;
        loop {
            let before = passed;
            for sender in 0..nodes.len() {
                while let Some(frame) = nodes.get_mut(sender).and_then(|node| node.poll_frame()) {
                    passed += 1;
                    if passed > FRAMES_PER_EVENT_MAX {
                        return Err(RunError::Babble { now });
                    }
                    self.pass_on(nodes, now, sender, &frame)?;
                }
            }
            if passed == before {
                return Ok(());
            }
        }
    }

    fn pass_on(
        &mut self,
        nodes: &mut [&mut dyn Node],
        now: Instant,
        sender: usize,
        frame: &Frame,
    ) -> Result<(), RunError> {
        self.stats.sent += 1;
        self.note(now, Direction::Sent { node: sender }, frame);
        match self.link.send(frame) {
            Ok(()) => {}
            Err(SendError::Link(error)) => return Err(error.into()),
            Err(SendError::QueueFull { .. }) => self.stats.dropped += 1,
        }
        for (index, node) in nodes.iter_mut().enumerate() {
            if index != sender {
                node.handle_frame(now, frame);
            }
        }
        Ok(())
    }

    fn note(&mut self, now: Instant, direction: Direction, frame: &Frame) {
        if let Some(observer) = &mut self.observer {
            observer(now, direction, frame);
        }
    }
}
