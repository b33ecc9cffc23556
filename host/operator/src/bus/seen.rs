//! What a bus saw during one step of a session.

use std::io;

use can_link::BusError;
use protocol::{Frame, Instant};

use crate::tap::{Tap, Way};

/// Most bus errors that are kept for a report; more are only counted by the link.
const BUS_ERRORS_MAX: usize = 10_000;

/// Where a medium puts what it saw during one step.
pub(super) struct Seen<'a> {
    pub(super) taps: &'a mut [Box<dyn Tap>],
    pub(super) errors: &'a mut Vec<(Instant, BusError)>,
    /// First error of a tap.
    pub(super) failed: Option<io::Error>,
}

impl Seen<'_> {
    pub(super) fn frame(&mut self, at: Instant, way: Way, frame: &Frame) {
        for tap in &mut *self.taps {
            if let Err(error) = tap.frame(at, way, frame) {
                self.failed.get_or_insert(error);
            }
        }
    }

    pub(super) fn bus_error(&mut self, at: Instant, error: &BusError) {
        if self.errors.len() < BUS_ERRORS_MAX {
            self.errors.push((at, *error));
        }
        for tap in &mut *self.taps {
            if let Err(error) = tap.bus_error(at, error) {
                self.failed.get_or_insert(error);
            }
        }
    }
}
