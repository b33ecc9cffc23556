//! The frames of a session, kept in memory.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use protocol::{Frame, Instant};

use super::candump::Line;
use crate::tap::{Tap, Way};

/// Keeps the frames while it is on. Clones share them.
///
/// A second of a full bus is about half a megabyte: meant for a run, not for a day.
#[derive(Clone, Debug, Default)]
pub struct Keeper(Rc<RefCell<Kept>>);

#[derive(Debug, Default)]
struct Kept {
    on: bool,
    lines: Vec<Line>,
}

impl Keeper {
    /// Forgets everything, and keeps what passes from now on.
    pub fn start(&self) {
        *self.0.borrow_mut() = Kept { on: true, lines: Vec::new() };
    }

    /// Keeps no more, and hands over what it kept: numbered from 1, as lines of a log.
    #[must_use]
    pub fn stop(&self) -> Vec<Line> {
        std::mem::take(&mut *self.0.borrow_mut()).lines
    }

    /// Frames kept so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.0.borrow().lines.len()
    }
}

impl Tap for Keeper {
    fn frame(&mut self, at: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        let mut kept = self.0.borrow_mut();
        if kept.on {
            let number = kept.lines.len() + 1;
            kept.lines.push(Line { number, at, frame: *frame, sent: Some(way == Way::Sent) });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    #[test]
    fn only_what_passes_between_start_and_stop_is_kept() {
        let keeper = Keeper::default();
        let mut tap = keeper.clone();
        let frame = Frame::from_array(StandardId::from_low_bits(0x0A5), [8]);
        let mut pass = |us: u64, way| tap.frame(Instant::from_micros(us), way, &frame).unwrap();
        pass(1, Way::Sent);
        keeper.start();
        pass(2, Way::Sent);
        pass(3, Way::Received);
        assert_eq!(keeper.frames(), 2);
        let line = |number, us, sent| Line { number, at: Instant::from_micros(us), frame, sent: Some(sent) };
        assert_eq!(keeper.stop(), [line(1, 2, true), line(2, 3, false)]);
        pass(4, Way::Sent);
        assert_eq!(keeper.stop(), []);
    }
}
