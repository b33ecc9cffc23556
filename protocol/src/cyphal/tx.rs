//! Transmit queue: whole transfers wait; frames leave, the most urgent first.
//!
//! A transfer is cut into frames only when the next frame is requested. So a waiting transfer needs its bytes once,
//! and a more urgent transfer overtakes between two frames of a longer one (Cyphal specification v1.0, sections
//! 4.1.1.3 and 4.2.2.3). Frames of equal id keep their order.
//!
//! Must not: know what the bytes mean, or read a clock.

use core::fmt;

use super::bits::{BufferTooSmall, Encode, to_bytes};
use super::crc::Crc16;
use super::id::{Priority, Route, Tail, TransferId};
use crate::frame::{Frame, MAX_DATA_LEN};
use crate::id::ExtendedId;
use crate::time::Instant;

/// Payload bytes of one classical CAN frame: all but the tail byte.
pub const FRAME_PAYLOAD: usize = MAX_DATA_LEN - 1;
/// Bytes of the transfer CRC.
const CRC_LEN: usize = 2;

/// Why a transfer was not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    /// Every slot that this priority may use is taken; try again when frames have left.
    QueueFull {
        /// Slots of the queue.
        slots: usize,
    },
    /// The serialised value is longer than a slot.
    TooLong(BufferTooSmall),
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::QueueFull { slots } => write!(f, "all {slots} places of the transmit queue are taken"),
            Self::TooLong(e) => write!(f, "transfer longer than a place of the transmit queue: {e}"),
        }
    }
}

impl core::error::Error for SendError {}

/// Everything about an outgoing transfer but its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TxMeta {
    /// Who speaks to whom about what.
    pub route: Route,
    /// How urgent it is.
    pub priority: Priority,
    /// Number within the session.
    pub transfer_id: TransferId,
    /// Time from which the transfer is useless: an unsent rest is dropped then.
    pub deadline: Instant,
}

#[derive(Clone, Copy, Debug)]
struct Slot<const BYTES: usize> {
    /// `None` = free.
    id: Option<ExtendedId>,
    transfer_id: TransferId,
    toggle: bool,
    crc: Crc16,
    /// Payload bytes.
    len: usize,
    /// Bytes of payload and CRC that have left.
    sent: usize,
    /// Order of arrival, to keep the order of equal ids.
    order: u32,
    deadline: Instant,
    payload: [u8; BYTES],
}

impl<const BYTES: usize> Slot<BYTES> {
    const FREE: Self = Self {
        id: None,
        transfer_id: TransferId::ZERO,
        toggle: true,
        crc: Crc16::INITIAL,
        len: 0,
        sent: 0,
        order: 0,
        deadline: Instant::ZERO,
        payload: [0; BYTES],
    };

    /// Cuts off the next frame; frees the slot after the last one.
    fn next_frame(&mut self, id: ExtendedId) -> Option<Frame> {
        let total = if self.len <= FRAME_PAYLOAD { self.len } else { self.len + CRC_LEN };
        let left = total.saturating_sub(self.sent);
        let take = left.min(FRAME_PAYLOAD);
        let mut data = [0; MAX_DATA_LEN];
        let (start, end) = (self.sent == 0, left <= FRAME_PAYLOAD);

        let fresh = self.payload.get(self.sent..self.len.min(self.sent + take)).unwrap_or(&[]);
        self.crc.update(fresh);
        let crc = self.crc.get().to_be_bytes();
        let crc_from = self.sent.saturating_sub(self.len).min(CRC_LEN);
        let tail = Tail { start, end, toggle: self.toggle, transfer_id: self.transfer_id }.byte();
        let crc_bytes = crc.get(crc_from..).unwrap_or(&[]).iter().take(take - fresh.len());
        for (to, from) in data.iter_mut().zip(fresh.iter().chain(crc_bytes).chain([&tail])) {
            *to = *from;
        }

        self.sent += take;
        self.toggle = !self.toggle;
        if end {
            self.id = None;
        }
        data.get(..=take).and_then(|data| Frame::new(id, data).ok())
    }
}

/// Queue of `SLOTS` transfers of at most `BYTES` bytes of payload each.
///
/// * The last free slot is kept for [`Priority::Fast`] and above.
/// * An [`Priority::Exceptional`] transfer is never refused: if all slots are taken it replaces the
///   least urgent transfer, started or not (receivers drop the torso).
/// * A transfer past its deadline is dropped, started or not, by [`Self::expire`].
#[derive(Clone, Debug)]
pub struct TxQueue<const SLOTS: usize, const BYTES: usize> {
    slots: [Slot<BYTES>; SLOTS],
    order: u32,
    expired: u32,
    replaced: u32,
}

impl<const SLOTS: usize, const BYTES: usize> Default for TxQueue<SLOTS, BYTES> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const SLOTS: usize, const BYTES: usize> TxQueue<SLOTS, BYTES> {
    /// Empty queue.
    pub const fn new() -> Self {
        const { assert!(SLOTS >= 2, "one slot is reserved for urgent transfers") };
        Self { slots: [Slot::FREE; SLOTS], order: 0, expired: 0, replaced: 0 }
    }

    /// Number of slots that a transfer of this priority may take now.
    pub fn room(&self, priority: Priority) -> usize {
        let free = self.slots.iter().filter(|slot| slot.id.is_none()).count();
        if priority <= Priority::Fast { free } else { free.saturating_sub(1) }
    }

    /// Serialises `payload` into a free slot, all or nothing.
    #[inline(never)]
    pub fn push(&mut self, meta: &TxMeta, payload: &dyn Encode) -> Result<(), SendError> {
        let full = SendError::QueueFull { slots: SLOTS };
        let slot = if self.room(meta.priority) > 0 {
            self.slots.iter_mut().find(|slot| slot.id.is_none())
        } else if meta.priority == Priority::Exceptional {
            self.replaced = self.replaced.saturating_add(1);
            self.slots.iter_mut().max_by_key(|slot| (slot.id, slot.order))
        } else {
            None
        };
        let slot = slot.ok_or(full)?;
        slot.id = None;
        slot.len = to_bytes(payload, &mut slot.payload).map_err(SendError::TooLong)?;
        slot.id = Some(meta.route.can_id(meta.priority));
        slot.transfer_id = meta.transfer_id;
        slot.toggle = true;
        slot.crc = Crc16::INITIAL;
        slot.sent = 0;
        slot.order = self.order;
        slot.deadline = meta.deadline;
        self.order = self.order.wrapping_add(1);
        Ok(())
    }

    /// The next frame: lowest id first, of equal ids the oldest transfer.
    pub fn pop(&mut self) -> Option<Frame> {
        let newest = self.order;
        let (id, slot) = self
            .slots
            .iter_mut()
            .filter_map(|slot| slot.id.map(|id| (id, slot)))
            // Age instead of the counter itself, so that its wrap does not reorder anything.
            .min_by_key(|(id, slot)| (*id, u32::MAX - newest.wrapping_sub(slot.order)))?;
        slot.next_frame(id)
    }

    /// Drops every transfer whose deadline is at or before `now`.
    pub fn expire(&mut self, now: Instant) {
        for slot in &mut self.slots {
            if slot.id.is_some() && slot.deadline <= now {
                slot.id = None;
                self.expired = self.expired.saturating_add(1);
            }
        }
    }

    /// Earliest deadline of a waiting transfer.
    pub fn next_deadline(&self) -> Option<Instant> {
        self.slots.iter().filter(|slot| slot.id.is_some()).map(|slot| slot.deadline).min()
    }

    /// True while no frame waits.
    pub fn is_empty(&self) -> bool {
        self.slots.iter().all(|slot| slot.id.is_none())
    }

    /// Transfers dropped because their deadline passed.
    pub const fn expired(&self) -> u32 {
        self.expired
    }

    /// Transfers dropped because an exceptional one needed their place.
    pub const fn replaced(&self) -> u32 {
        self.replaced
    }
}

#[cfg(test)]
mod tests {
    use super::super::bits::Writer;
    use super::super::id::{NodeId, ServiceId, SubjectId};
    use super::*;

    struct Bytes<'a>(&'a [u8]);
    impl Encode for Bytes<'_> {
        fn encode(&self, out: &mut Writer<'_>) {
            out.bytes(self.0);
        }
    }

    fn message(subject: u16, priority: Priority, transfer_id: u8) -> TxMeta {
        TxMeta {
            route: Route::Message {
                subject: SubjectId::new(subject).unwrap(),
                source: NodeId::new(42).unwrap(),
            },
            priority,
            transfer_id: TransferId::new(transfer_id).unwrap(),
            deadline: Instant::FAR_FUTURE,
        }
    }

    fn drain<const S: usize, const B: usize>(queue: &mut TxQueue<S, B>) -> Vec<String> {
        std::iter::from_fn(|| queue.pop()).map(|frame| frame.to_string()).collect()
    }

    #[test]
    fn heartbeat_of_the_specification_is_one_frame() {
        let mut queue = TxQueue::<2, 8>::new();
        queue.push(&message(7509, Priority::Nominal, 1), &Bytes(&[1, 0, 0, 0, 0, 1, 0xA1])).unwrap();
        assert_eq!(drain(&mut queue), ["107D552A#010000000001A1E1"]);
    }

    #[test]
    fn node_info_of_the_specification_has_its_crc_across_two_frames() {
        // Section 4.2.3, response of node 42 to node 123.
        let mut payload = vec![1, 0, 0, 0, 1, 0];
        payload.extend([0; 24]);
        payload.extend([0x24]);
        payload.extend(b"org.uavcan.pyuavcan.demo.basic_usage");
        payload.extend([0, 0]);
        let meta = TxMeta {
            route: Route::Response {
                service: ServiceId::new(430).unwrap(),
                source: NodeId::new(42).unwrap(),
                destination: NodeId::new(123).unwrap(),
            },
            ..message(0, Priority::Nominal, 1)
        };
        let mut queue = TxQueue::<2, 400>::new();
        queue.push(&meta, &Bytes(&payload)).unwrap();
        let data: Vec<String> = drain(&mut queue)
            .iter()
            .map(|frame| frame.strip_prefix("126BBDAA#").expect("one id for all frames").to_string())
            .collect();
        assert_eq!(
            data,
            [
                "01000000010000A1",
                "0000000000000001",
                "0000000000000021",
                "0000000000000001",
                "0000246F72672E21",
                "75617663616E2E01",
                "7079756176636121",
                "6E2E64656D6F2E01",
                "62617369635F7521",
                "7361676500009A01",
                "E761",
            ]
        );
    }

    #[test]
    fn seven_bytes_are_one_frame_and_eight_are_two() {
        let mut queue = TxQueue::<3, 16>::new();
        queue.push(&message(1, Priority::Nominal, 0), &Bytes(&[0; 7])).unwrap();
        queue.push(&message(2, Priority::Nominal, 0), &Bytes(&[0; 8])).unwrap();
        let lens: Vec<usize> = std::iter::from_fn(|| queue.pop()).map(|frame| frame.dlc()).collect();
        assert_eq!(lens, [8, 8, 4]);
    }

    #[test]
    fn empty_payload_is_a_lone_tail_byte() {
        let mut queue = TxQueue::<2, 8>::new();
        queue.push(&message(1, Priority::Nominal, 5), &()).unwrap();
        assert_eq!(drain(&mut queue), ["1060012A#E5"]);
    }

    #[test]
    fn urgent_transfer_overtakes_between_frames_and_equal_ids_keep_their_order() {
        let mut queue = TxQueue::<5, 16>::new();
        queue.push(&message(9, Priority::Low, 0), &Bytes(&[1; 10])).unwrap();
        queue.push(&message(9, Priority::Low, 1), &Bytes(&[2; 10])).unwrap();
        let first = queue.pop().unwrap();
        queue.push(&message(9, Priority::Exceptional, 0), &Bytes(&[3])).unwrap();
        assert_eq!(first.data().first(), Some(&1));
        let heads: Vec<u8> =
            std::iter::from_fn(|| queue.pop()).filter_map(|frame| frame.data().first().copied()).collect();
        assert_eq!(heads, [3, 1, 2, 2]);
    }

    #[test]
    fn last_slot_is_kept_for_urgent_transfers_and_stop_is_never_refused() {
        let mut queue = TxQueue::<3, 8>::new();
        queue.push(&message(1, Priority::Nominal, 0), &Bytes(&[1])).unwrap();
        queue.push(&message(2, Priority::Optional, 0), &Bytes(&[2])).unwrap();
        let refused = queue.push(&message(3, Priority::High, 0), &Bytes(&[3]));
        assert_eq!(refused, Err(SendError::QueueFull { slots: 3 }));
        queue.push(&message(4, Priority::Fast, 0), &Bytes(&[4])).unwrap();
        assert!(queue.push(&message(5, Priority::Immediate, 0), &Bytes(&[5])).is_err());
        queue.push(&message(6, Priority::Exceptional, 0), &Bytes(&[6])).unwrap();
        assert_eq!(queue.replaced(), 1);
        let sent: Vec<u8> = std::iter::from_fn(|| queue.pop()).map(|frame| frame.data()[0]).collect();
        assert_eq!(sent, [6, 4, 1], "the least urgent one made room");
    }

    #[test]
    fn a_transfer_longer_than_a_slot_is_refused_with_its_size_and_leaves_the_slot_free() {
        let mut queue = TxQueue::<2, 8>::new();
        let refused = queue.push(&message(1, Priority::Nominal, 0), &Bytes(&[0; 9]));
        assert_eq!(refused, Err(SendError::TooLong(BufferTooSmall { needed: 9, available: 8 })));
        assert!(queue.is_empty());
    }

    #[test]
    fn what_is_late_is_dropped_even_when_it_has_begun() {
        let mut queue = TxQueue::<3, 16>::new();
        let late = TxMeta { deadline: Instant::from_micros(10), ..message(1, Priority::Nominal, 0) };
        queue.push(&late, &Bytes(&[0; 10])).unwrap();
        assert_eq!(queue.next_deadline(), Some(Instant::from_micros(10)));
        queue.pop().unwrap();
        queue.expire(Instant::from_micros(9));
        assert!(!queue.is_empty());
        queue.expire(Instant::from_micros(10));
        assert!(queue.is_empty());
        assert_eq!(queue.expired(), 1);
    }

    #[test]
    fn order_counter_wrap_keeps_the_order() {
        let mut queue = TxQueue::<4, 8>::new();
        queue.order = u32::MAX;
        for n in 0..3 {
            queue.push(&message(1, Priority::Fast, 0), &Bytes(&[n])).unwrap();
        }
        let sent: Vec<u8> = std::iter::from_fn(|| queue.pop()).map(|frame| frame.data()[0]).collect();
        assert_eq!(sent, [0, 1, 2]);
    }
}
