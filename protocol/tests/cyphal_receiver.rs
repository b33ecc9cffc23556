//! The receiver's rules, one test per stimulus; then transfers under loss, duplication and reordering.

use proptest::prelude::*;
use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::crc::Crc16;
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, SubjectId, TransferId};
use protocol::cyphal::rx::{Dropped, Port, Receiver, STALL, TRANSFER_ID_TIMEOUT};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::{Duration, ExtendedId, Frame, Id, Instant, StandardId};

const LOCAL: u8 = 42;
const PEER: u8 = 7;
const SERVICE: u16 = 384;
const SUBJECT: u16 = 1234;
const NOTHING: [Vec<u8>; 0] = [];

struct Bytes<'a>(&'a [u8]);
impl Encode for Bytes<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(self.0);
    }
}

fn node(id: u8) -> NodeId {
    NodeId::new(id).unwrap()
}

fn request_from(source: u8) -> Route {
    let service = ServiceId::new(SERVICE).unwrap();
    Route::Request { service, source: node(source), destination: node(LOCAL) }
}

fn message_from(source: u8) -> Route {
    Route::Message { subject: SubjectId::new(SUBJECT).unwrap(), source: node(source) }
}

/// Frames of one transfer.
fn frames(route: Route, transfer_id: u8, payload: &[u8]) -> Vec<Frame> {
    let mut queue = TxQueue::<2, 1024>::new();
    let meta = TxMeta {
        route,
        priority: Priority::Nominal,
        transfer_id: TransferId::new(transfer_id).unwrap(),
        deadline: Instant::FAR_FUTURE,
    };
    queue.push(&meta, &Bytes(payload)).unwrap();
    std::iter::from_fn(|| queue.pop()).collect()
}

fn ms(ms: u64) -> Instant {
    Instant::ZERO + Duration::from_millis(ms)
}

fn raw(id: u32, data: &[u8]) -> Frame {
    Frame::new(ExtendedId::new(id).unwrap(), data).unwrap()
}

/// Receiver of node 42 with small tables and its clock.
struct Rig {
    rx: Receiver<3, 2, 64>,
    now: Instant,
    ports: Vec<Port>,
}

impl Rig {
    fn new() -> Self {
        let service = ServiceId::new(SERVICE).unwrap();
        let subject = SubjectId::new(SUBJECT).unwrap();
        let ports = vec![Port::request(service, 64), Port::message(subject, 10).idempotent()];
        Self { rx: Receiver::new(), now: ms(1), ports }
    }

    /// Payload bytes of the transfer that the frame completes.
    fn take(&mut self, frame: &Frame) -> Option<Vec<u8>> {
        let transfer = self.rx.accept(self.now, Some(node(LOCAL)), frame, &[&self.ports])?;
        assert!(transfer.payload.iter().skip(transfer.len).all(|byte| *byte == 0), "zero extension");
        Some(transfer.payload[..transfer.len].to_vec())
    }

    fn take_all(&mut self, frames: &[Frame]) -> Vec<Vec<u8>> {
        frames.iter().filter_map(|frame| self.take(frame)).collect()
    }

    fn dropped(&self, cause: Dropped) -> u32 {
        self.rx.counters().dropped(cause)
    }

    /// Asserts that exactly these causes were counted.
    #[track_caller]
    fn assert_dropped(&self, expected: &[(Dropped, u32)]) {
        let counted: Vec<_> = Dropped::ALL
            .into_iter()
            .map(|cause| (cause, self.dropped(cause)))
            .filter(|(_, n)| *n > 0)
            .collect();
        assert_eq!(counted, expected);
    }
}

// ---- frames that are not for us ------------------------------------------------------------------

#[test]
fn frames_of_other_protocols_are_counted_and_ignored() {
    let mut rig = Rig::new();
    let cube = Frame::new(StandardId::new(0x0E1).unwrap(), &[0x0B, 0x0E, 0, 0]).unwrap();
    let remote = Frame::remote(request_from(PEER).can_id(Priority::Nominal), 8).unwrap();
    assert_eq!(rig.take_all(&[cube, remote]), NOTHING);
    rig.assert_dropped(&[(Dropped::OtherProtocol, 2)]);
}

#[test]
fn uavcan_v0_frames_are_counted_and_never_misread() {
    let mut rig = Rig::new();
    // NodeStatus, a request and the first frame of several, all of v0: they start with a zero toggle.
    let status = raw(0x1001_5507, &[1, 0, 0, 0, 0, 0, 0, 0xC0]);
    let get_info = raw(0x1001_AA87, &[0xC1]);
    let first = raw(0x1001_AA87, &[1, 2, 3, 4, 5, 6, 7, 0x80]);
    // The same start on an id that is also a v1 request to us, and the frame after it.
    let id = request_from(PEER).can_id(Priority::Nominal).get();
    let ambiguous = raw(id, &[1, 2, 3, 4, 5, 6, 7, 0x80]);
    let middle = raw(id, &[1, 2, 3, 4, 5, 6, 7, 0x20]);
    assert_eq!(rig.take_all(&[status, get_info, first, ambiguous, middle]), NOTHING);
    rig.assert_dropped(&[(Dropped::OldProtocol, 4), (Dropped::MissedStart, 1)]);
}

#[test]
fn malformed_frames_are_counted() {
    let mut rig = Rig::new();
    let id = request_from(PEER).can_id(Priority::Nominal).get();
    let bad = [
        raw(id, &[]),
        raw(id | 1 << 23, &[0xE0]),
        raw(message_from(PEER).can_id(Priority::Nominal).get() | 1 << 7, &[0xE0]),
        // A first frame that is not the last must be full.
        raw(id, &[1, 2, 0xA0]),
        // The frames after it must carry something.
        raw(id, &[0x41]),
    ];
    assert_eq!(rig.take_all(&bad), NOTHING);
    rig.assert_dropped(&[(Dropped::Malformed, 5)]);
}

#[test]
fn requests_to_others_and_unknown_ports_are_not_for_us() {
    let mut rig = Rig::new();
    let service = ServiceId::new(SERVICE).unwrap();
    let other = Route::Request { service, source: node(PEER), destination: node(43) };
    let response = Route::Response { service, source: node(PEER), destination: node(LOCAL) };
    let unknown = Route::Message { subject: SubjectId::new(99).unwrap(), source: node(PEER) };
    for route in [other, response, unknown] {
        assert_eq!(rig.take(&frames(route, 0, &[1])[0]), None);
    }
    rig.assert_dropped(&[(Dropped::NotForUs, 3)]);
}

#[test]
fn a_node_that_uses_our_address_is_noticed() {
    let mut rig = Rig::new();
    assert_eq!(rig.take(&frames(message_from(LOCAL), 0, &[1])[0]), None);
    rig.assert_dropped(&[(Dropped::OurAddress, 1)]);
}

#[test]
fn without_an_address_messages_are_heard_and_services_are_not() {
    let mut rig = Rig::new();
    let request = &frames(request_from(PEER), 0, &[1])[0];
    assert_eq!(rig.rx.accept(ms(1), None, request, &[&rig.ports]), None);
    let message = &frames(message_from(PEER), 0, &[1])[0];
    assert!(rig.rx.accept(ms(1), None, message, &[&rig.ports]).is_some());
}

// ---- single frames -------------------------------------------------------------------------------

#[test]
fn single_frame_transfer_is_delivered_once_and_again_after_the_timeout() {
    let mut rig = Rig::new();
    let frame = frames(request_from(PEER), 3, &[1, 2])[0];
    assert_eq!(rig.take(&frame), Some(vec![1, 2]));
    assert_eq!(rig.take(&frame), None);
    rig.now = ms(1) + TRANSFER_ID_TIMEOUT;
    assert_eq!(rig.take(&frame), None, "at the timeout it is still a duplicate");
    rig.now += Duration::from_micros(1);
    assert_eq!(rig.take(&frame), Some(vec![1, 2]));
    rig.assert_dropped(&[(Dropped::DuplicateTransfer, 2)]);
}

#[test]
fn sender_that_restarts_its_numbers_is_heard_at_once_unless_they_coincide() {
    let mut rig = Rig::new();
    for transfer_id in [9, 0, 31, 30, 0] {
        let frame = frames(request_from(PEER), transfer_id, &[transfer_id])[0];
        assert_eq!(rig.take(&frame), Some(vec![transfer_id]));
    }
}

#[test]
fn idempotent_port_takes_each_single_frame_also_from_nodes_without_address() {
    let mut rig = Rig::new();
    let frame = frames(message_from(PEER), 3, &[1])[0];
    assert_eq!(rig.take_all(&[frame, frame]), [vec![1], vec![1]]);
    let subject = SubjectId::new(SUBJECT).unwrap();
    let anonymous = Route::Anonymous { subject, pseudo_id: 0x55 };
    assert_eq!(rig.take_all(&frames(anonymous, 0, &[2])), [[2]]);
    // Several frames are refused there: with and without an address.
    assert_eq!(rig.take_all(&frames(message_from(PEER), 0, &[3; 8])), NOTHING);
    assert_eq!(rig.take_all(&frames(anonymous, 0, &[3; 8])), NOTHING);
    rig.assert_dropped(&[(Dropped::Malformed, 2), (Dropped::TooLong, 2)]);
}

#[test]
fn short_payload_is_extended_with_zeros_and_long_payload_is_cut_at_the_extent() {
    let mut rig = Rig::new();
    // Old contents of the buffer must not shine through.
    rig.take_all(&frames(request_from(PEER), 9, &[0xFF; 64]));
    let short = &frames(request_from(PEER), 0, &[1, 2, 3, 4, 5])[0];
    let transfer = rig.rx.accept(ms(1), Some(node(LOCAL)), short, &[&rig.ports]).unwrap();
    let mut expected = [0; 64];
    expected[..5].copy_from_slice(&[1, 2, 3, 4, 5]);
    assert_eq!((transfer.payload, transfer.len), (&expected[..], 5));
    for len in 63..70 {
        let payload: Vec<u8> = (1..=len).collect();
        let got = rig.take_all(&frames(request_from(PEER), len % 32, &payload));
        assert_eq!(got, [payload[..payload.len().min(64)].to_vec()], "{len} bytes");
    }
}

// ---- several frames ------------------------------------------------------------------------------

#[test]
fn multi_frame_transfers_of_every_length_arrive() {
    let mut rig = Rig::new();
    for len in 0..=64_u8 {
        let payload: Vec<u8> = (0..len).map(|i| i ^ 0x5A).collect();
        let got = rig.take_all(&frames(request_from(PEER), len % 32, &payload));
        assert_eq!(got, [payload], "{len} bytes");
    }
    rig.assert_dropped(&[]);
}

#[test]
fn transfer_carries_the_time_of_its_first_frame() {
    let mut rig = Rig::new();
    let all = frames(request_from(PEER), 0, &[0; 20]);
    let (last, head) = all.split_last().unwrap();
    for (i, frame) in head.iter().enumerate() {
        assert!(rig.rx.accept(ms(10 + i as u64), Some(node(LOCAL)), frame, &[&rig.ports]).is_none());
    }
    let transfer = rig.rx.accept(ms(99), Some(node(LOCAL)), last, &[&rig.ports]).unwrap();
    assert_eq!(transfer.at, ms(10));
}

#[test]
fn each_frame_repeated_gives_the_transfer_once() {
    let mut rig = Rig::new();
    let payload: Vec<u8> = (0..40).collect();
    let all = frames(request_from(PEER), 4, &payload);
    let twice: Vec<Frame> = all.iter().flat_map(|frame| [*frame, *frame]).collect();
    assert_eq!(rig.take_all(&twice), [payload]);
    rig.assert_dropped(&[(Dropped::DuplicateFrame, all.len() as u32)]);
}

#[test]
fn transfer_repeated_under_its_number_is_dropped() {
    let mut rig = Rig::new();
    let all = frames(request_from(PEER), 4, &[7; 20]);
    assert_eq!(rig.take_all(&all), [[7; 20]]);
    assert_eq!(rig.take_all(&all), NOTHING);
    assert_eq!(rig.dropped(Dropped::DuplicateTransfer), 1);
}

#[test]
fn a_missing_frame_loses_the_transfer_and_a_retransmission_with_the_same_id_is_accepted() {
    let payload: Vec<u8> = (0..50).collect();
    let all = frames(request_from(PEER), 4, &payload);
    for missing in 0..all.len() {
        let mut rig = Rig::new();
        let mut holed = all.clone();
        holed.remove(missing);
        assert_eq!(rig.take_all(&holed), NOTHING, "without frame {missing}");
        assert_eq!(rig.take_all(&all), vec![payload.clone()], "after the loss of frame {missing}");
    }
}

#[test]
fn two_missing_frames_keep_the_toggle_right_and_are_caught_by_the_crc() {
    let mut rig = Rig::new();
    let mut all = frames(request_from(PEER), 4, &[9; 50]);
    all.drain(2..4);
    assert_eq!(rig.take_all(&all), NOTHING);
    rig.assert_dropped(&[(Dropped::BadCrc, 1)]);
}

#[test]
fn a_flipped_bit_in_any_frame_is_caught_by_the_crc() {
    let all = frames(request_from(PEER), 4, &[0x33; 30]);
    for i in 0..all.len() {
        let mut rig = Rig::new();
        let mut broken = all.clone();
        let mut data = broken[i].data().to_vec();
        data[0] ^= 0x10;
        broken[i] = Frame::new(broken[i].id(), &data).unwrap();
        assert_eq!(rig.take_all(&broken), NOTHING);
        assert_eq!(rig.dropped(Dropped::BadCrc), 1);
    }
}

#[test]
fn transfers_of_two_frames_that_hold_hardly_more_than_a_crc_are_survived() {
    let mut rig = Rig::new();
    // Hostile: eight bytes in all, two of them a wrong CRC.
    let id = request_from(PEER).can_id(Priority::Nominal).get();
    assert_eq!(rig.take_all(&[raw(id, &[0, 0, 0, 0, 0, 0, 0, 0xA0]), raw(id, &[0, 0x40])]), NOTHING);
    rig.assert_dropped(&[(Dropped::BadCrc, 1)]);
    // The right CRC over six bytes: what fits one frame must not be split, but it is harmless.
    let mut crc = Crc16::INITIAL;
    crc.update(&[1, 2, 3, 4, 5, 6]);
    let [high, low] = crc.get().to_be_bytes();
    let split = [raw(id, &[1, 2, 3, 4, 5, 6, high, 0xA1]), raw(id, &[low, 0x41])];
    assert_eq!(rig.take_all(&split), [[1, 2, 3, 4, 5, 6]]);
}

#[test]
fn new_start_gives_up_the_unfinished_transfer() {
    let mut rig = Rig::new();
    let old = frames(request_from(PEER), 4, &[1; 30]);
    let new = frames(request_from(PEER), 5, &[2; 30]);
    assert_eq!(rig.take_all(&old[..3]), NOTHING);
    assert_eq!(rig.take_all(&new), [[2; 30]]);
    assert_eq!(rig.rx.counters().abandoned, 1);
    assert_eq!(rig.take_all(&old[3..]), NOTHING);
    assert_eq!(rig.dropped(Dropped::MissedStart), (old.len() - 3) as u32);
}

#[test]
fn restarted_sender_with_the_same_number_begins_anew() {
    let mut rig = Rig::new();
    let before = frames(request_from(PEER), 0, &[1; 30]);
    let after = frames(request_from(PEER), 0, &[2; 30]);
    // Broken off after one, two, three frames: the new start never counts as a repetition.
    for broken_off in 1..4 {
        rig.take_all(&before[..broken_off]);
        assert_eq!(rig.take_all(&after), [[2; 30]]);
        rig.now += TRANSFER_ID_TIMEOUT + Duration::from_micros(1);
    }
}

#[test]
fn priority_that_changes_within_a_transfer_loses_it() {
    let mut rig = Rig::new();
    let all = frames(request_from(PEER), 4, &[1; 20]);
    let changed = Frame::new(request_from(PEER).can_id(Priority::High), all[1].data()).unwrap();
    assert_eq!(rig.take_all(&[all[0], changed, all[2]]), NOTHING);
    rig.assert_dropped(&[(Dropped::MissedStart, 1), (Dropped::LostFrame, 1)]);
}

#[test]
fn transfer_that_pauses_longer_than_the_timeout_is_given_up() {
    let mut rig = Rig::new();
    let all = frames(request_from(PEER), 4, &[1; 20]);
    rig.take_all(&all[..2]);
    rig.now += TRANSFER_ID_TIMEOUT + Duration::from_micros(1);
    assert_eq!(rig.take_all(&all[2..]), NOTHING);
    assert_eq!(rig.rx.counters().abandoned, 1);
}

#[test]
fn endless_transfer_is_given_up_and_costs_no_memory() {
    let mut rig = Rig::new();
    let id = request_from(PEER).can_id(Priority::Nominal).get();
    rig.take(&raw(id, &[1, 2, 3, 4, 5, 6, 7, 0xA0]));
    for i in 0_u32..2000 {
        let toggle = if i % 2 == 0 { 0x00 } else { 0x20 };
        rig.take(&raw(id, &[1, 2, 3, 4, 5, 6, i as u8, toggle]));
    }
    assert_eq!(rig.dropped(Dropped::TooLong), 1);
    assert_eq!(rig.take_all(&frames(request_from(PEER), 9, &[5; 20])), [[5; 20]]);
}

// ---- limits --------------------------------------------------------------------------------------

#[test]
fn fourth_node_takes_the_place_of_the_one_quiet_longest() {
    let mut rig = Rig::new();
    for source in [1, 2, 3, 4] {
        rig.now += Duration::from_millis(1);
        assert_eq!(rig.take(&frames(request_from(source), 0, &[source])[0]), Some(vec![source]));
    }
    // Nodes 2, 3 and 4 are remembered; node 1 is not.
    for (source, known) in [(2, true), (3, true), (4, true), (1, false)] {
        let taken = rig.take(&frames(request_from(source), 0, &[source])[0]);
        assert_eq!(taken.is_none(), known, "node {source}");
    }
}

#[test]
fn sessions_in_mid_transfer_are_not_thrown_out_until_they_are_stuck() {
    let mut rig = Rig::new();
    let all: Vec<_> = (1..=3).map(|source| frames(request_from(source), 0, &[source; 20])).collect();
    rig.take(&all[0][0]);
    rig.take(&all[1][0]);
    // Two buffers: the third multi-frame transfer finds none, a single frame still passes.
    assert_eq!(rig.take_all(&all[2]), NOTHING);
    assert!(rig.dropped(Dropped::NoRoom) >= 1);
    assert_eq!(rig.take(&frames(request_from(9), 0, &[9])[0]), Some(vec![9]));
    // The others go on undisturbed.
    assert_eq!(rig.take_all(&all[0][1..]), [[1; 20]]);
    // Node 2 stays silent: its buffer is reused only after STALL.
    rig.now += Duration::from_millis(1);
    rig.take(&frames(request_from(3), 1, &[3; 20])[0]);
    let refused = rig.dropped(Dropped::NoRoom);
    rig.take(&frames(request_from(5), 0, &[5; 20])[0]);
    assert_eq!(rig.dropped(Dropped::NoRoom), refused + 1);
    rig.now += STALL;
    assert_eq!(rig.take_all(&frames(request_from(5), 1, &[5; 20])), [[5; 20]]);
    assert_eq!(rig.take_all(&all[1][1..]), NOTHING);
}

#[test]
fn stop_passes_while_every_session_and_buffer_is_taken() {
    let mut rig = Rig::new();
    for source in 1..=6 {
        rig.take(&frames(request_from(source), 0, &[0; 20])[0]);
    }
    assert!(rig.dropped(Dropped::NoRoom) > 0);
    for source in (1..=126_u8).filter(|source| *source != LOCAL) {
        assert_eq!(rig.take(&frames(message_from(source), 0, &[1])[0]), Some(vec![1]));
    }
}

// ---- random traffic ------------------------------------------------------------------------------

/// What happens to a frame on its way.
#[derive(Clone, Copy, Debug)]
enum Fate {
    Passes,
    Lost,
    Doubled,
    Swapped,
}

fn fate() -> impl Strategy<Value = Fate> {
    prop_oneof![
        20 => Just(Fate::Passes),
        2 => Just(Fate::Lost),
        2 => Just(Fate::Doubled),
        1 => Just(Fate::Swapped),
    ]
}

/// Payloads that all differ: the last byte is the number of the transfer.
fn payloads(lens: &[usize]) -> Vec<Vec<u8>> {
    let body = |n: u8, len| (0..len as u8).map(move |i| i.wrapping_mul(31) ^ n).chain([n]);
    lens.iter().enumerate().map(|(n, len)| body(n as u8, *len).collect()).collect()
}

proptest! {
    #[test]
    fn what_arrives_was_sent_and_arrives_once_whatever_happens_to_the_frames(
        lens in proptest::collection::vec(0_usize..60, 1..30),
        fates in proptest::collection::vec(fate(), 200),
    ) {
        let mut rig = Rig::new();
        let sent = payloads(&lens);
        let mut line: Vec<Frame> = sent
            .iter()
            .enumerate()
            .flat_map(|(n, payload)| frames(request_from(PEER), n as u8 % 32, payload))
            .collect();
        let mut delivered = Vec::new();
        for i in 0..line.len() {
            match fates[i % fates.len()] {
                Fate::Lost => continue,
                Fate::Doubled => delivered.extend(rig.take(&line[i])),
                Fate::Swapped if i + 1 < line.len() => line.swap(i, i + 1),
                _ => {}
            }
            delivered.extend(rig.take(&line[i]));
        }
        for payload in &delivered {
            prop_assert!(sent.contains(payload));
        }
        // CAN keeps the order of frames of one id; without swaps the sequence is strictly rising.
        if !fates.iter().any(|fate| matches!(fate, Fate::Swapped)) {
            prop_assert!(delivered.windows(2).all(|pair| pair[0].last() < pair[1].last()));
        }
        if fates.iter().all(|fate| matches!(fate, Fate::Passes | Fate::Doubled)) {
            prop_assert_eq!(delivered, sent);
        }
    }

    #[test]
    fn interleaved_transfers_of_several_nodes_all_arrive(
        lens in proptest::collection::vec(1_usize..64, 2),
        order in proptest::collection::vec(any::<bool>(), 40),
    ) {
        let mut rig = Rig::new();
        let sent = payloads(&lens);
        let mut lines: Vec<_> = (0..2_u8)
            .map(|n| frames(request_from(n + 1), 3, &sent[usize::from(n)]).into_iter().peekable())
            .collect();
        let mut delivered = Vec::new();
        let mut order = order.into_iter().cycle();
        while lines.iter_mut().any(|line| line.peek().is_some()) {
            let turn = usize::from(order.next() == Some(true));
            let turn = if lines[turn].peek().is_some() { turn } else { 1 - turn };
            delivered.extend(lines[turn].next().and_then(|frame| rig.take(&frame)));
        }
        delivered.sort_by_key(|payload| payload.last().copied());
        prop_assert_eq!(delivered, sent);
        rig.assert_dropped(&[]);
    }

    #[test]
    fn frames_leave_the_queue_by_priority_and_each_transfer_in_its_order(
        urgencies in proptest::collection::vec((0_usize..8, 0_usize..40), 1..6),
    ) {
        let mut queue = TxQueue::<8, 64>::new();
        for (n, (urgency, len)) in urgencies.iter().enumerate() {
            let meta = TxMeta {
                route: message_from(n as u8 + 1),
                priority: Priority::ALL[*urgency],
                transfer_id: TransferId::ZERO,
                deadline: Instant::FAR_FUTURE,
            };
            queue.push(&meta, &Bytes(&vec![n as u8; *len])).unwrap();
        }
        let ids: Vec<Id> = std::iter::from_fn(|| queue.pop()).map(|frame| frame.id()).collect();
        prop_assert!(ids.is_sorted());
        let expected: usize = urgencies.iter().map(|(_, len)| if *len <= 7 { 1 } else { (len + 2).div_ceil(7) }).sum();
        prop_assert_eq!(ids.len(), expected);
    }

    #[test]
    fn duplication_alone_never_changes_what_arrives(
        lens in proptest::collection::vec(0_usize..60, 1..20),
        doubled in proptest::collection::vec(any::<bool>(), 97),
    ) {
        let mut rig = Rig::new();
        let sent = payloads(&lens);
        let mut delivered = Vec::new();
        let mut doubled = doubled.into_iter().cycle();
        for (n, payload) in sent.iter().enumerate() {
            for frame in frames(request_from(PEER), n as u8 % 32, payload) {
                delivered.extend(rig.take(&frame));
                if doubled.next() == Some(true) {
                    delivered.extend(rig.take(&frame));
                }
            }
        }
        prop_assert_eq!(delivered, sent);
    }

    #[test]
    fn any_frames_at_any_time_are_survived_and_what_comes_out_fits_its_port(
        script in proptest::collection::vec(
            (
                0_u64..3_000_000,
                prop_oneof![Just(0_u32), 0_u32..=0x1FFF_FFFF],
                proptest::collection::vec(any::<u8>(), 0..=8),
                any::<u8>(),
            ),
            0..200,
        ),
    ) {
        let mut rig = Rig::new();
        for (pause_us, id, data, salt) in script {
            rig.now += Duration::from_micros(pause_us);
            // Half of the frames go to our ports, so that sessions are really exercised.
            let id = if id == 0 {
                request_from(salt % 4).can_id(Priority::Nominal)
            } else {
                ExtendedId::from_low_bits(id)
            };
            let frame = Frame::new(Id::Extended(id), &data).unwrap();
            if let Some(transfer) = rig.rx.accept(rig.now, Some(node(LOCAL)), &frame, &[&rig.ports]) {
                prop_assert!(transfer.len <= transfer.payload.len());
                prop_assert!(transfer.payload.len() == 64 || transfer.payload.len() == 10);
                prop_assert!(transfer.at <= rig.now);
            }
        }
    }

    #[test]
    fn hostile_tail_bytes_never_block_the_good_transfers_that_follow(
        tails in proptest::collection::vec((any::<u8>(), 0_usize..=7), 0..60),
    ) {
        let mut rig = Rig::new();
        let id = request_from(PEER).can_id(Priority::Nominal);
        for (tail, len) in tails {
            let mut data = vec![0xEE; len];
            data.push(tail);
            rig.take(&Frame::new(id, &data).unwrap());
        }
        // At most one of two numbers can be the last one seen.
        let delivered: usize =
            [3, 4].map(|tid| rig.take_all(&frames(request_from(PEER), tid, &[8; 30])).len()).iter().sum();
        prop_assert!(delivered >= 1);
    }
}
