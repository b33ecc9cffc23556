//! Frames on their way out: a short queue, and one place before it for the halt.

use protocol::Frame;
use protocol::powercube::Broadcast;

/// Frames that wait at most: one per drive in flight, side lane, watchdog, reset.
pub const QUEUE_LEN: usize = 24;

/// Queue of the controller's own frames.
#[derive(Clone, Debug)]
pub struct TransmitQueue {
    frames: [Option<Frame>; QUEUE_LEN],
    first: usize,
    count: usize,
    halt: bool,
    dropped: u16,
}

impl Default for TransmitQueue {
    fn default() -> Self {
        Self { frames: [None; QUEUE_LEN], first: 0, count: 0, halt: false, dropped: 0 }
    }
}

impl TransmitQueue {
    /// Appends a frame; false (and counted) if the queue is full.
    pub fn push(&mut self, frame: Frame) -> bool {
        let place = self.frames.get_mut((self.first + self.count) % QUEUE_LEN);
        match place {
            Some(place) if self.count < QUEUE_LEN => {
                *place = Some(frame);
                self.count += 1;
                true
            }
            _ => {
                self.dropped = self.dropped.saturating_add(1);
                false
            }
        }
    }

    /// The halt broadcast goes out next, and what waits is dropped: no motion leaves after it.
    pub fn halt(&mut self) {
        (self.count, self.halt) = (0, true);
    }

    /// Next frame.
    pub fn pop(&mut self) -> Option<Frame> {
        if self.halt {
            self.halt = false;
            return Some(Broadcast::Halt.encode());
        }
        if self.count == 0 {
            return None;
        }
        let frame = self.frames.get_mut(self.first).and_then(Option::take);
        self.first = (self.first + 1) % QUEUE_LEN;
        self.count -= 1;
        frame
    }

    /// Frames that found no place since start-up.
    pub const fn dropped(&self) -> u16 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halt_goes_first_and_drops_what_waited() {
        let mut queue = TransmitQueue::default();
        assert!(queue.push(Broadcast::Watchdog.encode()) && queue.push(Broadcast::Reset.encode()));
        queue.halt();
        assert!(queue.push(Broadcast::Watchdog.encode()));
        assert_eq!(queue.pop(), Some(Broadcast::Halt.encode()));
        assert_eq!(queue.pop(), Some(Broadcast::Watchdog.encode()));
        assert_eq!(queue.pop(), None);
    }

    #[test]
    fn full_queue_drops_the_new_frame_and_counts_it() {
        let mut queue = TransmitQueue::default();
        for _ in 0..QUEUE_LEN {
            assert!(queue.push(Broadcast::Watchdog.encode()));
        }
        assert!(!queue.push(Broadcast::Reset.encode()));
        assert_eq!(queue.dropped(), 1);
        for _ in 0..QUEUE_LEN {
            assert_eq!(queue.pop(), Some(Broadcast::Watchdog.encode()));
        }
        assert_eq!(queue.pop(), None);
    }
}
