//! The controller in a thread of this program, on a live link that it shares with the session.
//!
//! ```text
//!   bus ◀──▶ wire ─ Shared ◀── runner ──▶ controller        thread, raised priority
//!                     ▲
//!                     │ queues, one bell each way
//!                     ▼
//!                   SessionLink ◀── session ──▶ host node          the program's own thread
//! ```
//!
//! The thread owns the wire, so one opened adapter serves both; a frame that one of the two sends is a frame of the
//! bus for the other. A slow session (a log on a slow disk, a terminal) does not delay the controller: frames that
//! it does not fetch are dropped and counted.
//!
//! The queues are wait-free on both sides. In a channel of the standard library the reader spins while a writer is
//! in the middle of a write. If the controller's thread has interrupted the session's thread there, on the same
//! core and at a higher real-time priority, the writer cannot continue: the controller stands still until the
//! system takes the core away, on Linux after 0.95 s.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use can_link::{
    CanLink, Clock, Granted, Lateness, LinkError, LinkEvent, LinkStats, PollSet, Role, RunError, RunStats,
    Runner, SendError, Urgent,
};
use firmware::ControllerNode;
use firmware::authority::Seed;
use firmware::host_link::Identity;
use firmware::settings::Settings;
use firmware::store::RamStorage;
use protocol::{Frame, Node};
use rtrb::{Consumer, Producer, PushError, RingBuffer};

use super::entropy;
use super::failure::BusFailure;
use crate::drives::CanDrives;

/// Frames that wait for the session: two seconds of a busy bus.
const TO_SESSION_MAX: usize = 16_384;
/// Frames that wait for the thread.
const TO_BUS_MAX: usize = 1_024;

/// How a controller as a program kept time.
#[derive(Clone, Debug, Default)]
pub struct SoftReport {
    /// How late its deadlines were served.
    pub deadlines: Lateness,
    /// From the arrival of a frame until its consequences were handed to the link.
    pub answers: Lateness,
    /// Frames that the session did not fetch in time.
    pub unseen: u64,
    /// What the operating system granted.
    pub granted: Granted,
}

impl SoftReport {
    /// From what its runner counted.
    #[must_use]
    pub fn of(stats: &RunStats, unseen: u64, granted: Granted) -> Self {
        Self { deadlines: stats.deadlines.clone(), answers: stats.answers.clone(), unseen, granted }
    }
}

impl std::fmt::Display for SoftReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.granted)?;
        writeln!(f, "deadlines served late by: {}", self.deadlines)?;
        write!(f, "frames answered after:    {}", self.answers)
    }
}

/// Wakes the other side out of its sleep.
struct Bell(UnixStream);

impl Bell {
    fn pair() -> std::io::Result<(Self, Self)> {
        let (a, b) = UnixStream::pair()?;
        a.set_nonblocking(true)?;
        b.set_nonblocking(true)?;
        Ok((Self(a), Self(b)))
    }

    fn ring(&self) {
        // Full: it rings already.
        let _ = (&self.0).write(&[1]);
    }

    /// Silences it; true if it rang.
    fn hush(&self) -> bool {
        let (mut bytes, mut rang) = ([0; 64], false);
        while matches!((&self.0).read(&mut bytes), Ok(n) if n > 0) {
            rang = true;
        }
        rang
    }
}

/// Why the thread has ended.
type Ending = Arc<Mutex<Option<LinkError>>>;

/// The session's end.
pub(super) struct SessionLink {
    name: String,
    events: Consumer<LinkEvent>,
    frames: Producer<Frame>,
    bell: Bell,
    ending: Ending,
    stats: LinkStats,
}

impl SessionLink {
    fn gone(&self) -> LinkError {
        let ending = self.ending.lock().ok().and_then(|ending| ending.clone());
        ending.unwrap_or(LinkError::Closed { link: self.name.clone() })
    }
}

impl CanLink for SessionLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        if self.frames.is_abandoned() {
            return Err(self.gone().into());
        }
        match self.frames.push(*frame) {
            Ok(()) => {
                self.stats.frames_out += 1;
                self.bell.ring();
                Ok(())
            }
            Err(PushError::Full(_)) => {
                self.stats.dropped_out += 1;
                Err(SendError::QueueFull { link: self.name.clone() })
            }
        }
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        loop {
            // Read first: events that the thread pushed before it ended are in the queue then.
            let ended = self.events.is_abandoned();
            match self.events.pop() {
                Ok(event) => {
                    self.stats.frames_in += u64::from(matches!(event, LinkEvent::Frame { .. }));
                    return Ok(Some(event));
                }
                Err(_) if ended => return Err(self.gone()),
                // Events from before the bell are in the queue now.
                Err(_) if self.bell.hush() => {}
                Err(_) => return Ok(None),
            }
        }
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        set.add(&self.bell.0, false);
    }

    fn stats(&self) -> LinkStats {
        self.stats
    }
}

/// The thread's end: the wire, with the session as one more participant.
struct Shared {
    wire: Box<dyn CanLink + Send>,
    clock: Clock,
    /// The session has a connection of its own, and does not use this link.
    apart: bool,
    frames: Consumer<Frame>,
    events: Producer<LinkEvent>,
    bell: Bell,
    unseen: Arc<AtomicU64>,
}

impl Shared {
    fn forward(&mut self, event: LinkEvent) {
        if self.apart {
            return;
        }
        if self.events.push(event).is_err() {
            self.unseen.fetch_add(1, Ordering::Relaxed);
        }
        self.bell.ring();
    }
}

impl CanLink for Shared {
    fn name(&self) -> &str {
        self.wire.name()
    }

    /// What the controller sends.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.wire.send(frame)?;
        self.forward(LinkEvent::Frame { at: self.clock.now(), stamp: None, frame: *frame });
        Ok(())
    }

    /// What the controller sees: the session's frames on their way to the bus, and those from the bus.
    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        self.bell.hush();
        if let Ok(frame) = self.frames.pop() {
            match self.wire.send(&frame) {
                // The wire counts a full queue; a lost frame of the host is sent again on request.
                Ok(()) | Err(SendError::QueueFull { .. }) => {}
                Err(SendError::Link(error)) => return Err(error),
                Err(_) => {}
            }
            return Ok(Some(LinkEvent::Frame { at: self.clock.now(), stamp: None, frame }));
        }
        let event = self.wire.receive()?;
        if let Some(event) = event {
            self.forward(event);
        }
        Ok(event)
    }

    fn takes_fd(&self) -> Result<(), LinkError> {
        self.wire.takes_fd()
    }

    fn register<'a>(&'a self, set: &mut PollSet<'a>) {
        self.wire.register(set);
        if !self.apart {
            set.add(&self.bell.0, false);
        }
    }

    fn end_turn(&self, until: protocol::Instant) -> bool {
        self.wire.end_turn(until)
    }

    fn deadline(&self) -> Option<protocol::Instant> {
        self.wire.deadline()
    }

    fn stats(&self) -> LinkStats {
        self.wire.stats()
    }
}

pub(super) struct SoftController {
    off: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SoftReport>>,
}

impl SoftController {
    /// Starts the controller on `wire`; the returned link is the session's from now on. In lock step the
    /// thread has its own turns, and the session a connection of its own: the returned link is then unused.
    ///
    /// # Errors
    /// The operating system gives no thread, no pipe or no random bytes.
    pub(super) fn start(
        wire: Box<dyn CanLink + Send>,
        clock: Clock,
        settings: Settings,
        drives: CanDrives,
    ) -> Result<(Self, SessionLink), BusFailure> {
        let seed = entropy::seed(clock)?;
        let (ours, theirs) = Bell::pair().map_err(BusFailure::Wait)?;
        let (to_session, events) = RingBuffer::new(TO_SESSION_MAX);
        let (to_bus, frames) = RingBuffer::new(TO_BUS_MAX);
        let ending: Ending = Arc::default();
        let name = wire.name().to_owned();
        let session_link = SessionLink {
            name: name.clone(),
            events,
            frames: to_bus,
            bell: ours,
            ending: Arc::clone(&ending),
            stats: LinkStats::default(),
        };
        let mut this = Self { off: Arc::default(), stop: Arc::default(), thread: None };
        let (off, stop) = (Arc::clone(&this.off), Arc::clone(&this.stop));
        let apart = clock.is_manual();
        let work = move || {
            let unseen = Arc::new(AtomicU64::new(0));
            let counter = Arc::clone(&unseen);
            let mut shared =
                Shared { wire, clock, apart, frames, events: to_session, bell: theirs, unseen: counter };
            let urgent = Urgent::request(Role::Controller);
            let (result, stats) = serve(&mut shared, clock, (&settings, drives, seed), &off, &stop);
            if let (Err(error), Ok(mut place)) = (result, ending.lock()) {
                *place = Some(match error {
                    RunError::Link(error) => error,
                    other => LinkError::Io {
                        link: name,
                        kind: std::io::ErrorKind::Other,
                        reason: format!("the soft controller ended: {other}"),
                    },
                });
            }
            SoftReport::of(&stats, unseen.load(Ordering::Relaxed), urgent.granted())
        };
        let thread = std::thread::Builder::new().name("controller".to_owned()).spawn(work);
        this.thread = Some(thread.map_err(BusFailure::Wait)?);
        Ok((this, session_link))
    }

    /// Takes the controller off the bus; the link stays. Drives that move are stopped by their watchdogs.
    pub(super) fn switch_off(&self) {
        self.off.store(true, Ordering::Relaxed);
    }

    /// The thread ends at its next check.
    pub(super) fn ask_to_end(&self) {
        self.off.store(true, Ordering::Relaxed);
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Ends the thread and returns its report; `None` at the second call.
    pub(super) fn finish(&mut self) -> Option<SoftReport> {
        self.ask_to_end();
        self.thread.take()?.join().ok()
    }
}

impl Drop for SoftController {
    fn drop(&mut self) {
        self.finish();
    }
}

fn serve(
    shared: &mut Shared,
    clock: Clock,
    (settings, drives, seed): (&Settings, CanDrives, Seed),
    off: &AtomicBool,
    stop: &AtomicBool,
) -> (Result<(), RunError>, RunStats) {
    let (storage, identity) = (RamStorage::new(), Identity::default());
    let mut controller = ControllerNode::with_group(clock.now(), storage, drives, settings, identity, seed);
    let mut runner = Runner::new(shared, clock);
    let mut nodes: [&mut dyn Node; 1] = [&mut controller];
    let mut result = runner.run(&mut nodes, off, None);
    let stats = runner.stats().clone();
    if result.is_ok() {
        result = runner.run(&mut [], stop, None);
    }
    (result, stats)
}
