//! The transport against pycyphal: the frames that pycyphal makes of a transfer, and how it reads frames on a bus
//! that loses and doubles some of them (`tests/interop/cyphal/make_transport_vectors.py`).

use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::{ExtendedId, Frame, Instant};

const VECTORS: &str = include_str!("cyphal_transport_vectors.txt");

struct Bytes<'a>(&'a [u8]);
impl Encode for Bytes<'_> {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(self.0);
    }
}

fn unhex(text: &str) -> Vec<u8> {
    let digits = text.trim_start_matches('-').as_bytes();
    digits.chunks(2).map(|d| u8::from_str_radix(str::from_utf8(d).unwrap(), 16).unwrap()).collect()
}

#[test]
fn transfers_are_cut_into_the_frames_that_pycyphal_sends() {
    let mut checked = 0;
    for line in VECTORS.lines().filter_map(|line| line.strip_prefix("tx ")) {
        let mut words = line.split(' ');
        let mut next = || words.next().unwrap();
        let id = ExtendedId::new(u32::from_str_radix(next(), 16).unwrap()).unwrap();
        let transfer_id = TransferId::new(next().parse().unwrap()).unwrap();
        let payload = unhex(next());
        let (priority, route) = Route::parse(id).unwrap();
        let meta = TxMeta { route, priority, transfer_id, deadline: Instant::FAR_FUTURE };
        let mut queue = TxQueue::<2, 400>::new();
        queue.push(&meta, &Bytes(&payload)).unwrap();
        let sent: Vec<Frame> = std::iter::from_fn(|| queue.pop()).collect();
        let expected: Vec<Frame> = words.map(|data| Frame::new(id, &unhex(data)).unwrap()).collect();
        assert_eq!(sent, expected, "{} bytes", payload.len());
        checked += 1;
    }
    assert_eq!(checked, 33);
}

#[test]
fn what_arrives_after_losses_and_repetitions_is_what_arrives_at_pycyphal() {
    let service = ServiceId::new(384).unwrap();
    let (peer, local) = (NodeId::new(7).unwrap(), NodeId::new(42).unwrap());
    let id = Route::Request { service, source: peer, destination: local }.can_id(Priority::Nominal);
    let mut receiver = Receiver::<4, 2, 80>::new();
    let mut port = Port::request(service, 0);
    let mut arrived: Option<(u8, Vec<u8>)> = None;
    let (mut scripts, mut transfers) = (0, 0);
    for line in VECTORS.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match *words.as_slice() {
            ["rx", extent] => {
                receiver = Receiver::new();
                port.extent = extent.parse().unwrap();
                scripts += 1;
            }
            ["frame", us, data] => {
                assert_eq!(arrived.take(), None, "before {line}: more than pycyphal received");
                let now = Instant::from_micros(us.parse().unwrap());
                let frame = Frame::new(id, &unhex(data)).unwrap();
                arrived = receiver
                    .accept(now, Some(local), &frame, &[&[port]])
                    .map(|transfer| (transfer.transfer_id.get(), transfer.payload[..transfer.len].to_vec()));
            }
            ["got", transfer_id, payload] => {
                let expected = (transfer_id.parse().unwrap(), unhex(payload));
                assert_eq!(arrived.take(), Some(expected), "script {scripts}");
                transfers += 1;
            }
            _ => {}
        }
    }
    assert_eq!(arrived, None);
    assert_eq!(scripts, 40);
    // Of 560 sent; most of the rest lost a frame.
    assert!((350..560).contains(&transfers), "{transfers}");
}
