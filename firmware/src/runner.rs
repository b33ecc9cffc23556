//! The controller on a board: one loop over the traits of embedded Rust.
//!
//! A board gives a CAN controller ([`embedded_can::nb::Can`]), output pins ([`embedded_hal::digital::OutputPin`]) and a
//! [`Clock`], and calls [`Runner::turn`] for ever. The rest of its program is start-up, sleep and watchdog.
//!
//! # A turn
//!
//! A turn passes one received frame or one deadline to the node, then passes to the CAN controller what the node
//! wants to send, then sets the pins. Received frames go first, so that an answer which waits in the receive queue
//! is not counted as missed. After [`FRAMES_BEFORE_DEADLINE`] of them a due deadline is served, so that a flooded
//! bus cannot delay a control step. A turn never waits.
//!
//! # Pins
//!
//! | pin | high |
//! |---|---|
//! | `gripper` | open, unless `gripper.inverted` is set |
//! | `enable` | the group may move: Armed, Homing, Jogging, Running, Stopping; after a fault until its joints stand. For drives or valves with an enable input |
//! | `lamp` | the group may move; in Fault it blinks, half a second on and half a second off |
//!
//! A pin that the board does not have is a [`NoPin`].

use core::borrow::BorrowMut;
use core::convert::Infallible;

use embedded_can::nb::Can;
use embedded_hal::digital::{ErrorType, OutputPin, PinState};
use protocol::{Duration, Frame, Instant, Node as _};

use crate::group::DriveGroup;
use crate::host_link::ControllerNode;
use crate::spline::Spline;
use crate::state::StateKind;
use crate::store::Storage;

/// Received frames that may go before a deadline that is due: one control cycle of eight joints.
pub const FRAMES_BEFORE_DEADLINE: u8 = 8;
/// A deadline served later than this counts as a fault of the loop. A commit of the longest trajectory takes about 10 ms.
pub const LATE_MAX: Duration = Duration::from_millis(25);
/// Frames handed to the CAN controller in one turn: more than a node sends in one.
const FRAMES_PER_TURN: u8 = 64;
/// Half a blink: 2^19 µs, 0.52 s. A power of two, because a 64-bit division is 800 bytes of flash.
const BLINK_SHIFT: u32 = 19;

/// A clock that never goes back.
pub trait Clock {
    /// Time since an origin of the board's choice, usually its start.
    fn now(&mut self) -> Instant;
}

/// Stands for a pin that the board does not have: accepts any level.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoPin;

impl ErrorType for NoPin {
    type Error = Infallible;
}

impl OutputPin for NoPin {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Outputs of a board.
#[derive(Clone, Copy, Debug)]
pub struct Pins<G, E, L> {
    /// Valve of the gripper.
    pub gripper: G,
    /// Enable input of drives or valves.
    pub enable: E,
    /// Warning lamp.
    pub lamp: L,
}

/// Result of a turn: what the board does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use = "a board sleeps and feeds its watchdog by this"]
pub struct Turn {
    /// `Some`: nothing to do before this time, unless a frame is received or a frame has left and made room for the
    /// next ([`Runner::waits_for_room`]). `None`: call again at once.
    pub idle_until: Option<Instant>,
    /// False after a deadline that was served more than [`LATE_MAX`] late, until one is served in time. Feed the
    /// watchdog only if it is true.
    pub healthy: bool,
}

/// Errors on the board since start-up; counts saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardCounters {
    /// Errors that the CAN controller reported while receiving or sending.
    pub can_errors: u32,
    /// Frames that the driver of the CAN controller refused to build: they are lost.
    pub frames_refused: u32,
    /// Pins that could not be set; they are set again in the next turn.
    pub pin_errors: u32,
    /// Deadlines served more than [`LATE_MAX`] late.
    pub late: u32,
}

/// An output and the level it has.
#[derive(Debug)]
struct Output<P> {
    pin: P,
    level: Option<bool>,
}

impl<P: OutputPin> Output<P> {
    /// Puts the level on the pin if it differs; false if the pin refuses it.
    fn put(&mut self, high: bool) -> bool {
        if self.level != Some(high) {
            self.level = self.pin.set_state(PinState::from(high)).is_ok().then_some(high);
        }
        self.level.is_some()
    }
}

/// Result of a read from the CAN controller.
enum Received {
    Frame(Frame),
    /// An error, or a frame that is not a frame of classical CAN.
    Unusable,
    Nothing,
}

/// Runs a [`ControllerNode`] on the parts of a board; see the module.
pub struct Runner<C: Can, K, G = NoPin, E = NoPin, L = NoPin> {
    can: C,
    clock: K,
    gripper: Output<G>,
    /// Level the controller wants; `None` until the first one.
    gripper_wanted: Option<bool>,
    enable: Output<E>,
    lamp: Output<L>,
    /// A frame that the node gave and the CAN controller has not accepted yet.
    held: Option<C::Frame>,
    /// Received frames passed to the node since a deadline was due.
    frames_in_a_row: u8,
    now: Instant,
    healthy: bool,
    counters: BoardCounters,
}

impl<C, K, G, E, L> Runner<C, K, G, E, L>
where
    C: Can,
    K: Clock,
    G: OutputPin,
    E: OutputPin,
    L: OutputPin,
{
    /// A runner over the parts of a board. The CAN controller is on the bus, or joins it by itself, also after bus-off.
    pub fn new(can: C, clock: K, pins: Pins<G, E, L>) -> Self {
        let Pins { gripper, enable, lamp } = pins;
        Self {
            can,
            clock,
            gripper: Output { pin: gripper, level: None },
            gripper_wanted: None,
            enable: Output { pin: enable, level: None },
            lamp: Output { pin: lamp, level: None },
            held: None,
            frames_in_a_row: 0,
            now: Instant::ZERO,
            healthy: true,
            counters: BoardCounters { can_errors: 0, frames_refused: 0, pin_errors: 0, late: 0 },
        }
    }

    /// Time of the clock, never before the last one.
    pub fn now(&mut self) -> Instant {
        self.now = self.now.max(self.clock.now());
        self.now
    }

    /// Errors on the board since start-up.
    pub const fn counters(&self) -> BoardCounters {
        self.counters
    }

    /// A frame waits for room in the CAN controller: call [`Runner::turn`] again when one has left.
    pub const fn waits_for_room(&self) -> bool {
        self.held.is_some()
    }

    /// The CAN controller, for functions that its trait does not have.
    pub const fn can(&mut self) -> &mut C {
        &mut self.can
    }

    /// One turn of the loop, see the module. Never waits.
    pub fn turn<S, M, D>(&mut self, node: &mut ControllerNode<S, M, D>) -> Turn
    where
        S: Storage,
        M: BorrowMut<Spline>,
        D: DriveGroup<Packet = Frame>,
    {
        let now = self.now();
        let due = node.poll_timeout().filter(|due| *due <= now);
        let late = due.is_some_and(|due| now.saturating_since(due) > LATE_MAX);
        if late {
            self.counters.late = self.counters.late.saturating_add(1);
        }
        let deadline_first = due.is_some() && self.frames_in_a_row >= FRAMES_BEFORE_DEADLINE;
        let received = if deadline_first { Received::Nothing } else { self.receive() };
        let worked = due.is_some() || !matches!(received, Received::Nothing);
        self.frames_in_a_row = match received {
            Received::Nothing => 0,
            _ if due.is_none() => 0,
            _ => self.frames_in_a_row.saturating_add(1),
        };
        match received {
            Received::Frame(frame) => node.handle_frame(now, &frame),
            Received::Nothing if due.is_some() => {
                self.healthy = !late;
                node.handle_timeout(now);
            }
            Received::Nothing | Received::Unusable => {}
        }
        self.send(node);
        let brakes = node.controller().is_braking(now);
        let blink_at =
            self.put_pins(now, node.controller().state().kind(), brakes, node.take_gripper_level());
        let idle_until = if worked {
            None
        } else {
            Some(node.poll_timeout().unwrap_or(Instant::FAR_FUTURE).min(blink_at))
        };
        Turn { idle_until, healthy: self.healthy && !late }
    }

    fn receive(&mut self) -> Received {
        let frame = match self.can.receive() {
            Ok(frame) => Frame::from_embedded_can(&frame).ok(),
            Err(nb::Error::WouldBlock) => return Received::Nothing,
            Err(nb::Error::Other(_)) => None,
        };
        frame.map_or_else(
            || {
                self.counters.can_errors = self.counters.can_errors.saturating_add(1);
                Received::Unusable
            },
            Received::Frame,
        )
    }

    /// Hands over frames until the CAN controller is full or the node has no more.
    fn send<S, M, D>(&mut self, node: &mut ControllerNode<S, M, D>)
    where
        S: Storage,
        M: BorrowMut<Spline>,
        D: DriveGroup<Packet = Frame>,
    {
        for _ in 0..FRAMES_PER_TURN {
            if self.held.is_none() {
                let Some(frame) = node.poll_frame() else { return };
                self.held = frame.to_embedded_can();
            }
            let Some(frame) = self.held.take() else {
                self.counters.frames_refused = self.counters.frames_refused.saturating_add(1);
                continue;
            };
            match self.can.transmit(&frame) {
                // A frame of lower priority that lost its mailbox is sent next.
                Ok(displaced) => {
                    self.held = displaced;
                    if self.held.is_some() {
                        return;
                    }
                }
                Err(error) => {
                    self.held = Some(frame);
                    if !matches!(error, nb::Error::WouldBlock) {
                        self.counters.can_errors = self.counters.can_errors.saturating_add(1);
                    }
                    return;
                }
            }
        }
    }

    /// Puts the levels on the pins; the time at which the lamp changes next.
    fn put_pins(&mut self, now: Instant, state: StateKind, brakes: bool, gripper: Option<bool>) -> Instant {
        self.gripper_wanted = gripper.or(self.gripper_wanted);
        let may_move = matches!(
            state,
            StateKind::Armed
                | StateKind::Homing
                | StateKind::Jogging
                | StateKind::Running
                | StateKind::Stopping
        );
        let blinks = state == StateKind::Fault;
        let half = now.as_micros() >> BLINK_SHIFT;
        let lit = may_move || blinks && half & 1 == 0;
        let gripper = self.gripper_wanted.is_none_or(|level| self.gripper.put(level));
        // Drives that brake need the enable output; but the output never rises for that reason.
        let enable = may_move || (brakes && self.enable.level == Some(true));
        for fine in [gripper, self.enable.put(enable), self.lamp.put(lit)] {
            if !fine {
                self.counters.pin_errors = self.counters.pin_errors.saturating_add(1);
            }
        }
        if blinks { Instant::from_micros((half + 1) << BLINK_SHIFT) } else { Instant::FAR_FUTURE }
    }
}
