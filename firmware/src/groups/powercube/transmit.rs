//! Frames on their way out: a short queue, and one place before it for the halt.

use heapless::Deque;
use protocol::Frame;
use protocol::powercube::Broadcast;

/// Frames that wait at most: one per drive in flight, side lane, watchdog, reset.
pub const QUEUE_LEN: usize = 24;

/// Queue of the group's own frames.
#[derive(Clone, Debug, Default)]
pub struct TransmitQueue {
    frames: Deque<Frame, QUEUE_LEN>,
    halt: bool,
    dropped: u16,
}

impl TransmitQueue {
    /// Appends a frame; false (and counted) if the queue is full.
    pub fn push(&mut self, frame: &Frame) -> bool {
        let taken = self.frames.push_back(*frame).is_ok();
        if !taken {
            self.dropped = self.dropped.saturating_add(1);
        }
        taken
    }

    /// The halt broadcast goes out next, and what waits is dropped: no motion leaves after it.
    pub fn halt(&mut self) {
        self.frames.clear();
        self.halt = true;
    }

    /// Next frame.
    pub fn pop(&mut self) -> Option<Frame> {
        if self.halt {
            self.halt = false;
            return Some(Broadcast::Halt.encode());
        }
        self.frames.pop_front()
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
        assert!(queue.push(&Broadcast::Watchdog.encode()) && queue.push(&Broadcast::Reset.encode()));
        queue.halt();
        assert!(queue.push(&Broadcast::Watchdog.encode()));
        assert_eq!(queue.pop(), Some(Broadcast::Halt.encode()));
        assert_eq!(queue.pop(), Some(Broadcast::Watchdog.encode()));
        assert_eq!(queue.pop(), None);
    }

    #[test]
    fn full_queue_drops_the_new_frame_and_counts_it() {
        let mut queue = TransmitQueue::default();
        for _ in 0..QUEUE_LEN {
            assert!(queue.push(&Broadcast::Watchdog.encode()));
        }
        assert!(!queue.push(&Broadcast::Reset.encode()));
        assert_eq!(queue.dropped(), 1);
        for _ in 0..QUEUE_LEN {
            assert_eq!(queue.pop(), Some(Broadcast::Watchdog.encode()));
        }
        assert_eq!(queue.pop(), None);
    }
}
