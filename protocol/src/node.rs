//! The contract of everything that sits on the bus.

use crate::frame::Frame;
use crate::time::Instant;

/// A participant of the bus without IO: frames and times go in, frames and deadlines come out.
///
/// # Calling order
///
/// A runner repeats one loop: take the earliest of (next received frame, [`poll_timeout`]), make one
/// `handle_*` call with the time at which it happens, then call [`poll_frame`] until it returns
/// `None`, then ask [`poll_timeout`] again.
///
/// * `now` never decreases from call to call.
/// * [`handle_timeout`] may be called late, early or more often than requested: a call before the
///   deadline does nothing.
/// * A frame that is not for this node is ignored; every frame of the bus may be offered.
/// * A node never receives its own transmitted frames; a runner on a loop-back medium filters them.
/// * After a deadline was served, [`poll_timeout`] moves past it: a runner may treat a deadline that
///   stays at or before `now` after [`handle_timeout`] as a defect.
///
/// [`poll_frame`]: Node::poll_frame
/// [`poll_timeout`]: Node::poll_timeout
/// [`handle_timeout`]: Node::handle_timeout
pub trait Node {
    /// Takes one received frame at time `now`.
    fn handle_frame(&mut self, now: Instant, frame: &Frame);

    /// Does what is due at or before `now`.
    fn handle_timeout(&mut self, now: Instant);

    /// Next frame to transmit, in order; drained after every `handle_*` call.
    fn poll_frame(&mut self) -> Option<Frame>;

    /// Earliest time at which the node needs [`Node::handle_timeout`]; `None` while only a frame can change
    /// anything.
    fn poll_timeout(&self) -> Option<Instant>;
}
