//! The frames of a run in memory.

use protocol::{Frame, Instant};

use crate::world::Observer;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceEntry {
    /// When nodes saw it.
    pub at: Instant,
    /// Index of the sender.
    pub from: Option<u8>,
    pub frame: Frame,
}

/// Frames in order, up to a limit; later ones are only counted.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    entries: Vec<TraceEntry>,
    capacity: usize,
    left_out: u64,
}

impl Trace {
    /// Empty trace for at most `capacity` frames; memory is taken as it fills.
    pub fn new(capacity: usize) -> Self {
        Self { entries: Vec::new(), capacity, left_out: 0 }
    }

    pub fn entries(&self) -> &[TraceEntry] {
        &self.entries
    }

    /// Frames that came after the bound was reached.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }
}

impl Observer for Trace {
    fn on_frame(&mut self, at: Instant, from: Option<usize>, frame: &Frame) {
        if self.entries.len() < self.capacity {
            let from = from.and_then(|from| u8::try_from(from).ok());
            self.entries.push(TraceEntry { at, from, frame: *frame });
        } else {
            self.left_out += 1;
        }
    }
}
