//! What Cyphal costs per frame and per message: `cargo bench -p protocol --bench cyphal`.
//!
//! Prints the median over batches in ns; compare figures of one run only. The first line is a
//! reference (CRC-16 of seven bytes) that shows the machine's speed.

use std::hint::black_box;
use std::time::Instant as Wall;

use protocol::cyphal::bits::{Decode, Encode, Writer};
use protocol::cyphal::crc::Crc16;
use protocol::cyphal::cubecell::joint_state::{JointSample, JointState};
use protocol::cyphal::id::{NodeId, Priority, Route, ServiceId, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::server::{Application, ControllerCore, NodeStatus};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::file::{FileError, WRITE, WRITE_REQUEST_EXTENT, WriteRequest};
use protocol::cyphal::uavcan::heartbeat::Heartbeat;
use protocol::cyphal::uavcan::info::NodeInfo;
use protocol::cyphal::uavcan::register::AccessRequest;
use protocol::cyphal::uavcan::value::ValueBuf;
use protocol::{Frame, Instant};

const BATCHES: usize = 101;
const CALLS: usize = 400;

/// Median ns per `units` things done by one call of `op`.
fn bench<T>(name: &str, units: usize, mut op: impl FnMut(usize) -> T) {
    let mut ns: Vec<f64> = (0..BATCHES)
        .map(|_| {
            let start = Wall::now();
            for call in 0..CALLS {
                black_box(op(black_box(call)));
            }
            start.elapsed().as_nanos() as f64 / (CALLS * units) as f64
        })
        .collect();
    ns.sort_by(f64::total_cmp);
    println!("{name:<58} {:9.1} ns", ns[BATCHES / 2]);
}

struct Sink;

impl Application for Sink {
    fn info(&self) -> NodeInfo<'_> {
        NodeInfo::default()
    }
    fn status(&self) -> NodeStatus {
        NodeStatus::default()
    }
    fn file_write(&mut self, _: Instant, _: NodeId, _: &[u8], _: u64, data: &[u8]) -> Result<(), FileError> {
        black_box(data);
        Ok(())
    }
}

fn meta(service: ServiceId, transfer_id: u8) -> TxMeta {
    TxMeta {
        route: Route::Request {
            service,
            source: NodeId::from_low_bits(7),
            destination: NodeId::from_low_bits(42),
        },
        priority: Priority::Nominal,
        transfer_id: TransferId::from_low_bits(transfer_id),
        deadline: Instant::FAR_FUTURE,
    }
}

fn frames(transfer_id: u8, request: &dyn Encode) -> Vec<Frame> {
    let mut queue = TxQueue::<2, 600>::new();
    queue.push(&meta(WRITE, transfer_id), request).expect("fits");
    std::iter::from_fn(|| queue.pop()).collect()
}

fn bytes_of(value: &dyn Encode) -> Vec<u8> {
    let mut buffer = [0; 600];
    let mut out = Writer::new(&mut buffer);
    value.encode(&mut out);
    let len = out.finish().expect("fits");
    buffer[..len].to_vec()
}

fn main() {
    bench("reference: CRC-16 of seven bytes", 1, |n| {
        let mut crc = Crc16::INITIAL;
        crc.update(&[n as u8, 1, 2, 3, 4, 5, 6]);
        crc
    });

    let heartbeat = Heartbeat { uptime_s: 1, ..Heartbeat::default() };
    let joints = JointState::new(1, 2, &[JointSample { q_rad: 0.5, qd_rad_s: 0.1, ..Default::default() }; 6]);
    let value = ValueBuf::try_from([0.5_f32; 6].as_slice()).expect("fits");
    let access = AccessRequest { name: b"control.gain_row", value: value.as_value() };
    let mut buffer = [0; 600];
    bench("encode heartbeat (7 bytes)", 1, |_| black_box(&heartbeat).to_bytes(&mut buffer));
    bench("encode joint state of six joints (106 bytes)", 1, |_| black_box(&joints).to_bytes(&mut buffer));
    bench("encode register.Access of six reals (43 bytes)", 1, |_| black_box(&access).to_bytes(&mut buffer));
    let bytes = bytes_of(&heartbeat);
    bench("decode heartbeat", 1, |_| Heartbeat::from_bytes(black_box(&bytes)));
    let bytes = bytes_of(&joints);
    bench("decode joint state of six joints", 1, |_| JointState::from_bytes(black_box(&bytes)));
    let bytes = bytes_of(&access);
    bench("decode register.Access of six reals", 1, |_| AccessRequest::from_bytes(black_box(&bytes)).is_ok());

    let request = WriteRequest { offset: 0, path: b"trajectory", data: &[0x5A; 256] };
    let transfers: Vec<Vec<Frame>> = (0..32).map(|tid| frames(tid, &request)).collect();
    let per_transfer = transfers[0].len();
    let ports = [Port::request(WRITE, WRITE_REQUEST_EXTENT)];
    let local = Some(NodeId::from_low_bits(42));

    let mut queue = TxQueue::<6, 600>::new();
    bench("transmit, per frame of a 274-byte transfer", per_transfer, |_| {
        queue.push(&meta(WRITE, 0), &request).expect("room");
        while let Some(frame) = queue.pop() {
            black_box(frame);
        }
    });
    let mut rx = Receiver::<8, 3, 520>::new();
    let mut arrived = 0;
    bench("receive, per frame of a 274-byte transfer", per_transfer, |n| {
        for frame in &transfers[n % 32] {
            arrived += u32::from(rx.accept(Instant::ZERO, local, frame, &[&ports]).is_some());
        }
    });
    assert_eq!(arrived as usize, BATCHES * CALLS, "every transfer arrived");
    let single: Vec<Frame> = (0..32).map(|tid| frames(tid, &heartbeat)[0]).collect();
    bench("receive, single-frame transfer", 1, |n| {
        rx.accept(Instant::ZERO, local, &single[n % 32], &[&ports]).is_some()
    });
    let foreign = Frame::from_array(protocol::StandardId::from_low_bits(0xA1), [0x0B; 8]);
    bench("receive, frame of a drive (ignored)", 1, |_| {
        rx.accept(Instant::ZERO, local, black_box(&foreign), &[&ports]).is_some()
    });
    let mut core = ControllerCore::new(Instant::ZERO, NodeId::from_low_bits(42));
    bench("node core, file.Write of 256 bytes with answer, per frame", per_transfer, |n| {
        for frame in &transfers[n % 32] {
            core.handle_frame(Instant::ZERO, frame, &mut Sink);
        }
        core.poll_frame().expect("an answer")
    });
}
