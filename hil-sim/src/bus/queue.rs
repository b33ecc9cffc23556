//! Frames waiting in a node for the bus.

use std::collections::VecDeque;

use protocol::Frame;

/// In which order a node offers its waiting frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TxOrder {
    /// First in, first out: one mailbox, or a driver that keeps the order.
    #[default]
    Fifo,
    /// Lowest id first, equal ids in order: mailboxes that arbitrate inside the node.
    Priority,
}

#[derive(Clone, Copy, Debug)]
pub struct Waiting {
    pub frame: Frame,
    pub key: u32,
    /// When it was queued, nanoseconds.
    pub since_ns: u64,
    /// Attempts that ended in an error so far.
    pub failed: u32,
}

/// Bounded queue of one node.
#[derive(Clone, Debug)]
pub struct TxQueue {
    frames: VecDeque<Waiting>,
    depth: usize,
    order: TxOrder,
    dropped: u64,
    peak: usize,
}

impl TxQueue {
    /// Empty queue for `depth` frames, at least one.
    pub fn new(depth: usize, order: TxOrder) -> Self {
        let depth = depth.max(1);
        Self { frames: VecDeque::with_capacity(depth), depth, order, dropped: 0, peak: 0 }
    }

    /// Frames that can wait.
    pub const fn depth(&self) -> usize {
        self.depth
    }

    /// Drops a frame that the node cannot send, and counts it.
    pub fn refuse(&mut self) -> bool {
        self.dropped += 1;
        false
    }

    /// Queues a frame; a full queue drops and counts the *new* frame, as a full mailbox does.
    pub fn push(&mut self, frame: Frame, now_ns: u64) -> bool {
        if self.frames.len() >= self.depth {
            return self.refuse();
        }
        let key = frame.arbitration_key();
        self.frames.push_back(Waiting { frame, key, since_ns: now_ns, failed: 0 });
        self.peak = self.peak.max(self.frames.len());
        true
    }

    /// Index of the frame to offer next.
    pub fn head(&self) -> Option<usize> {
        match self.order {
            TxOrder::Fifo => (!self.frames.is_empty()).then_some(0),
            // `min_by_key` returns the first of equal keys, which is the oldest.
            TxOrder::Priority => (0..self.frames.len()).min_by_key(|i| self.frames[*i].key),
        }
    }

    /// The frame at an index that [`TxQueue::head`] gave; later pushes do not move it.
    pub fn get(&self, index: usize) -> Option<&Waiting> {
        self.frames.get(index)
    }

    /// The same, to count attempts.
    pub fn get_mut(&mut self, index: usize) -> Option<&mut Waiting> {
        self.frames.get_mut(index)
    }

    /// Takes out a frame that was transmitted.
    pub fn remove(&mut self, index: usize) -> Option<Waiting> {
        self.frames.remove(index)
    }

    /// Throws away what waits (power off) and returns how many frames that were.
    pub fn clear(&mut self) -> usize {
        let count = self.frames.len();
        self.frames.clear();
        count
    }

    /// Changes the number of frames that fit, at least one; what waits already stays.
    pub fn set_depth(&mut self, depth: usize) {
        self.depth = depth.max(1);
    }

    /// Number of waiting frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True if nothing waits.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Frames that found the queue full, or that the node cannot send.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Most frames that ever waited at once.
    pub fn peak(&self) -> usize {
        self.peak
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::StandardId;

    fn frame(id: u16, byte: u8) -> Frame {
        Frame::from_array(StandardId::new(id).unwrap(), [byte])
    }

    fn drain(order: TxOrder) -> Vec<(u32, u8)> {
        let mut queue = TxQueue::new(8, order);
        for (id, byte) in [(3, 0), (1, 1), (2, 2), (1, 3)] {
            assert!(queue.push(frame(id, byte), 0));
        }
        std::iter::from_fn(|| {
            let index = queue.head()?;
            queue.remove(index).map(|w| (w.frame.id().raw(), w.frame.data()[0]))
        })
        .collect()
    }

    #[test]
    fn fifo_keeps_the_order_and_priority_sorts_by_id_with_equal_ids_in_order() {
        assert_eq!(drain(TxOrder::Fifo), [(3, 0), (1, 1), (2, 2), (1, 3)]);
        assert_eq!(drain(TxOrder::Priority), [(1, 1), (1, 3), (2, 2), (3, 0)]);
    }

    #[test]
    fn full_queue_drops_the_new_frame_and_counts_it() {
        let mut queue = TxQueue::new(2, TxOrder::Fifo);
        assert!(queue.push(frame(1, 0), 0) && queue.push(frame(2, 0), 0));
        assert!(!queue.push(frame(0, 0), 0));
        assert_eq!((queue.dropped(), queue.len(), queue.peak()), (1, 2, 2));
        assert_eq!(queue.clear(), 2);
    }
}
