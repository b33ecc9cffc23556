//! The contract of every link, and waiting on several of them.

use std::os::fd::{AsFd, BorrowedFd};

use protocol::{Duration, Frame, Instant};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::bus_error::BusError;
use crate::clock::Clock;
use crate::error::{LinkError, SendError};

/// What to do where CAN FD frames do not pass.
const NO_FD: &str = "use a SocketCAN interface with CAN FD, or set drives and robot file to classical CAN (without `[bus] data_bit_rate_bit_s`)";

/// What came in over a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// A frame of another participant; a link never hands back what was sent through it.
    Frame {
        /// Arrival by the link's [`Clock`]; never decreases from event to event.
        at: Instant,
        /// Time stamp of the far side, by its own clock, if the medium carries one.
        stamp: Option<Instant>,
        frame: Frame,
    },
    /// The CAN controller behind the link reports errors of the bus.
    BusError {
        /// Arrival by the link's [`Clock`].
        at: Instant,
        error: BusError,
    },
}

/// Counters of a link since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkStats {
    /// Frames handed out by [`CanLink::receive`].
    pub frames_in: u64,
    /// Frames accepted by [`CanLink::send`].
    pub frames_out: u64,
    /// Frames (of each receiver, if there are several) lost because an output queue was full, or a server's protocol has no text for
    /// CAN FD.
    pub dropped_out: u64,
    /// Sent frames that the far side refused, and other errors that it reported.
    pub refused_out: u64,
    /// Received messages or lines that could not be read.
    pub malformed_in: u64,
}

/// One way to reach a CAN bus.
///
/// # Calling order
///
/// [`send`](CanLink::send) and [`receive`](CanLink::receive) never block. An owner repeats: call
/// [`receive`](CanLink::receive) until it returns `None`, do what is due, then [`wait`]. A link does its
/// reading, writing and housekeeping inside [`receive`](CanLink::receive), so an owner that stops calling
/// it also stops its output queue from draining.
pub trait CanLink {
    /// The link as a person would name it (`socketcand://127.0.0.1:29536/can0`), for messages.
    fn name(&self) -> &str;

    /// Queues a frame for the bus.
    ///
    /// # Errors
    ///
    /// [`SendError::QueueFull`] if the frame was dropped; the link stays usable. Any other error
    /// means that the link is gone.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError>;

    /// Next event, or `None` if nothing is there at the moment.
    ///
    /// # Errors
    ///
    /// The link is gone; further calls repeat the error.
    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError>;

    /// Whether CAN FD frames can be sent.
    ///
    /// # Errors
    ///
    /// [`LinkError::ClassicalOnly`], with what helps; the link stays usable.
    fn takes_fd(&self) -> Result<(), LinkError> {
        Err(LinkError::ClassicalOnly { link: self.name().to_owned(), advice: NO_FD.to_owned() })
    }

    /// Names what the link waits for.
    fn register<'a>(&'a self, set: &mut PollSet<'a>);

    /// Earliest time at which [`receive`](CanLink::receive) has housekeeping to do even if nothing
    /// arrives.
    fn deadline(&self) -> Option<Instant> {
        None
    }

    /// Reports to the far side of a link in lock step that this side has nothing to do before `until`; true if
    /// there is such a far side, which then moves the clock.
    fn end_turn(&self, until: Instant) -> bool {
        let _ = until;
        false
    }

    /// In lock step, frames may come up to `delay` late, with their own times. This saves turns if no program must react at
    /// once.
    fn bear_late_frames(&mut self, delay: Duration) {
        let _ = delay;
    }

    /// Counters since the link was opened.
    fn stats(&self) -> LinkStats;
}

impl<L: CanLink + ?Sized> CanLink for Box<L> {
    fn name(&self) -> &str {
        (**self).name()
    }
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        (**self).send(frame)
    }
    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        (**self).receive()
    }
    fn takes_fd(&self) -> Result<(), LinkError> {
        (**self).takes_fd()
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        (**self).register(set);
    }
    fn deadline(&self) -> Option<Instant> {
        (**self).deadline()
    }
    fn end_turn(&self, until: Instant) -> bool {
        (**self).end_turn(until)
    }
    fn bear_late_frames(&mut self, delay: Duration) {
        (**self).bear_late_frames(delay);
    }
    fn stats(&self) -> LinkStats {
        (**self).stats()
    }
}

/// File descriptors to wait for, collected from links by [`wait`].
#[derive(Default)]
pub struct PollSet<'a> {
    fds: Vec<PollFd<'a>>,
}

impl<'a> PollSet<'a> {
    /// Wakes when `fd` can be read or is closed, and, if `write` is set, also when it can be written.
    pub fn add(&mut self, fd: &'a impl AsFd, write: bool) {
        self.add_borrowed(fd.as_fd(), true, write);
    }

    /// Wakes when `fd` can be written or is closed.
    pub fn add_for_writing(&mut self, fd: &'a impl AsFd) {
        self.add_borrowed(fd.as_fd(), false, true);
    }

    /// As [`add`](Self::add), with a choice of what wakes; an `fd` with neither wakes only when closed.
    pub fn add_borrowed(&mut self, fd: BorrowedFd<'a>, read: bool, write: bool) {
        let mut flags = PollFlags::empty();
        flags.set(PollFlags::IN, read);
        flags.set(PollFlags::OUT, write);
        self.fds.push(PollFd::from_borrowed_fd(fd, flags));
    }
}

/// Sleeps until one of `links` has something to do, `until` has come, or a signal arrives.
///
/// With a [manual](Clock::manual) clock this does not sleep for a time. The far side of a link in lock step gets
/// the earliest deadline, and reports the time when it has come. Without such a link, and if no link has something
/// to do, the clock is set to the deadline.
///
/// May return early without a reason; the caller looks at its links and its clock anyway. `None`
/// sleeps without limit.
///
/// # Errors
///
/// Only errors that `poll(2)` reports for exhausted memory or a broken descriptor.
pub fn wait(links: &[&dyn CanLink], clock: &Clock, until: Option<Instant>) -> std::io::Result<()> {
    let mut set = PollSet::default();
    let mut earliest = until;
    for link in links {
        link.register(&mut set);
        earliest = match (earliest, link.deadline()) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
    }
    if clock.is_manual() {
        let until = earliest.unwrap_or(Instant::FAR_FUTURE);
        // Each link in lock step gets it, also after the first.
        let others = links.iter().filter(|link| link.end_turn(until)).count() > 0;
        return wait_manually(&mut set, clock, earliest.filter(|_| !others));
    }
    let timeout = earliest.map(|until| {
        let span = clock.remaining(until);
        Timespec {
            tv_sec: i64::try_from(span.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: span.subsec_nanos().into(),
        }
    });
    match poll(&mut set.fds, timeout.as_ref()) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn wait_manually(set: &mut PollSet<'_>, clock: &Clock, until: Option<Instant>) -> std::io::Result<()> {
    // Whoever waits for others looks at its own business now and then.
    let timeout = Timespec { tv_sec: 0, tv_nsec: if until.is_some() { 0 } else { 100_000_000 } };
    match (poll(&mut set.fds, Some(&timeout)), until) {
        (Ok(0), Some(until)) => {
            clock.set(until);
            Ok(())
        }
        (Ok(_) | Err(Errno::INTR), _) => Ok(()),
        (Err(error), _) => Err(error.into()),
    }
}
