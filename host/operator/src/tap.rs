//! Who sees what passes on a bus: recorders, the analysis of a run, tests.

use std::io;

use can_link::BusError;
use protocol::{Frame, Instant};

/// Which way a frame went, seen from this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// This program sent it.
    Sent,
    /// It came from the bus.
    Received,
}

/// Sees everything that passes, in order.
pub trait Tap {
    /// A frame. An error ends the session after the arm was stopped.
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()>;

    fn bus_error(&mut self, at: Instant, error: &BusError) -> io::Result<()> {
        let _ = (at, error);
        Ok(())
    }

    /// All events up to `now` were reported: later ones have this time or a later one.
    fn time(&mut self, now: Instant) -> io::Result<()> {
        let _ = now;
        Ok(())
    }

    /// The session ends: everything must be on the disk when this returns.
    fn finish(&mut self) -> io::Result<()> {
        Ok(())
    }
}
