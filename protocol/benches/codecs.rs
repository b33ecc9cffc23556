//! What each codec costs per frame: `cargo bench -p protocol`.
//!
//! Every line is the median over many samples of the time per item, in nanoseconds, with the fastest
//! sample beside it (the two are close on a quiet machine). Items are drawn from a table of different
//! frames, so that branch prediction does not learn one frame by heart. Nothing is asserted.

use std::hint::black_box;
use std::time::{Duration, Instant as Clock};

use protocol::bits;
use protocol::cyphal::bits::{Encode, Writer};
use protocol::cyphal::id::{NodeId, Priority, Route, SubjectId, TransferId};
use protocol::cyphal::rx::{Port, Receiver};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::powercube::{MotionCommand, MotionRequest, Parameter, Reply, Request, Value};
use protocol::text::candump::Record;
use protocol::text::{BusName, slcan, socketcand};
use protocol::units::Radians;
use protocol::{ExtendedId, Frame, Id, Instant, ModuleId, StandardId};

const SAMPLES: usize = 41;
const SAMPLE_TIME: Duration = Duration::from_millis(4);

/// Prints the time of `work` on one item, in the median over the samples.
fn bench<T>(name: &str, items: &[T], mut work: impl FnMut(&T)) {
    let mut pass = || items.iter().for_each(|item| work(black_box(item)));
    // How many passes fill a sample.
    let (start, mut passes) = (Clock::now(), 0_u32);
    while start.elapsed() < SAMPLE_TIME {
        pass();
        passes += 1;
    }
    let mut ns: Vec<f64> = (0..SAMPLES)
        .map(|_| {
            let start = Clock::now();
            (0..passes).for_each(|_| pass());
            start.elapsed().as_secs_f64() * 1e9 / f64::from(passes) / items.len() as f64
        })
        .collect();
    ns.sort_by(f64::total_cmp);
    println!("{name:<52} {:8.1} ns   fastest {:8.1} ns", ns[SAMPLES / 2], ns[0]);
}

/// Numbers that look random and are the same in every run (xorshift).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

/// 256 frames of both formats and all lengths.
fn mixed_frames() -> Vec<Frame> {
    let mut numbers = Numbers(0x9E37_79B9_7F4A_7C15);
    (0..256)
        .map(|index| {
            let raw = numbers.next() as u32;
            let id = if index % 2 == 0 {
                Id::Standard(StandardId::from_low_bits(raw as u16))
            } else {
                Id::Extended(ExtendedId::from_low_bits(raw))
            };
            Frame::new(id, &numbers.next().to_le_bytes()[..index % 9]).unwrap()
        })
        .collect()
}

/// The commands and answers of a control cycle of six modules.
#[derive(Default)]
struct Cycle {
    requests: Vec<(ModuleId, Request)>,
    replies: Vec<(ModuleId, Reply)>,
}

fn cycle() -> Cycle {
    let mut cycle = Cycle::default();
    for (index, module) in ModuleId::all().take(6).enumerate() {
        let target = 0.1 * index as f32;
        let motion = MotionCommand::Ramp { target: Radians::new(target) };
        for request in [
            Request::Set(Parameter::TargetVel, Value::F32(0.5)),
            Request::Set(Parameter::TargetAcc, Value::F32(2.0)),
            Request::Move(MotionRequest::extended(motion)),
            Request::Get(Parameter::ActPos),
        ] {
            cycle.requests.push((module, request));
        }
        let frame = |text: &str| {
            let line = format!("(0) can0 {:03X}#{text}", 0x0A0 + u16::from(module.get()));
            Reply::decode(&Record::parse(line.as_bytes()).unwrap().frame).unwrap()
        };
        cycle.replies.extend(["084F64", "085064", "0B0E0000803E0104", "0A3C0000803E"].map(frame));
    }
    cycle
}

fn main() {
    let frames = mixed_frames();
    println!("per frame (median of {SAMPLES} samples)");

    println!("\nbits on the wire, frames of both formats and all lengths");
    bench("exact length", &frames, |frame| {
        black_box(bits::length(frame));
    });
    bench("CRC alone", &frames, |frame| {
        black_box(bits::crc(frame));
    });

    println!("\nPowerCube, the frames of a control cycle of six modules");
    let Cycle { requests, replies } = cycle();
    bench("request, encode", &requests, |(module, request)| {
        black_box(request.encode(*module));
    });
    let wire: Vec<_> = requests.iter().map(|(module, request)| request.encode(*module)).collect();
    bench("request, decode", &wire, |frame| {
        black_box(protocol::powercube::AddressedRequest::decode(frame).is_ok());
    });
    bench("reply, encode", &replies, |(module, reply)| {
        black_box(reply.encode(*module));
    });
    let wire: Vec<_> = replies.iter().map(|(module, reply)| reply.encode(*module)).collect();
    bench("reply, decode", &wire, |frame| {
        black_box(Reply::decode(frame).is_ok());
    });

    cyphal();

    println!("\ntext, frames of both formats and all lengths");
    let bus = BusName::new("can0").unwrap();
    let at = Instant::from_micros(1_700_000_000_123_456);
    let records: Vec<_> =
        frames.iter().map(|frame| Record { at, bus, frame: *frame, direction: None }).collect();
    let lines: Vec<_> = records.iter().map(Record::encode).collect();
    bench("candump line, encode", &records, |record| {
        black_box(record.encode());
    });
    bench("candump line, decode", &lines, |line| {
        black_box(Record::parse(line.as_bytes()).is_ok());
    });
    let lines: Vec<_> = frames.iter().map(|frame| slcan::Command::Send(*frame).encode()).collect();
    bench("SLCAN line, encode", &frames, |frame| {
        black_box(slcan::Command::Send(*frame).encode());
    });
    let mut assembler = slcan::Assembler::new();
    bench("SLCAN line, assemble and decode", &lines, |line| {
        for byte in line.as_bytes() {
            if let Some(slcan::Assembled::Line(line)) = assembler.push(*byte) {
                black_box(slcan::Command::parse(line).is_ok());
            }
        }
    });
    let messages: Vec<_> =
        frames.iter().map(|frame| socketcand::Message::Frame { at, frame: *frame }).collect();
    let texts: Vec<_> = messages.iter().map(socketcand::Message::encode).collect();
    bench("socketcand message, encode", &messages, |message| {
        black_box(message.encode());
    });
    let mut assembler = socketcand::Assembler::new();
    bench("socketcand message, assemble and decode", &texts, |text| {
        for byte in text.as_bytes() {
            if let Some(socketcand::Assembled::Message(text)) = assembler.push(*byte) {
                black_box(socketcand::Message::parse(text).is_ok());
            }
        }
    });
}

struct Bytes(Vec<u8>);

impl Encode for Bytes {
    fn encode(&self, out: &mut Writer<'_>) {
        out.bytes(&self.0);
    }
}

fn cyphal() {
    println!("\nCyphal, eight senders in turn");
    let subject = SubjectId::new(1234).unwrap();
    let ports: [&[Port]; 1] = [&[Port::message(subject, 320)]];
    for (name, len) in [("single-frame transfers", 7), ("transfers of 258 bytes", 258)] {
        let payload = Bytes((0..len).map(|index| index as u8).collect());
        // 32 transfer numbers per sender: the table can be replayed without repeating one too soon.
        let transfers: Vec<TxMeta> = (0..32)
            .flat_map(|number| (1..=8).map(move |source| (number, source)))
            .map(|(number, source)| TxMeta {
                route: Route::Message { subject, source: NodeId::new(source).unwrap() },
                priority: Priority::Nominal,
                transfer_id: TransferId::new(number).unwrap(),
                deadline: Instant::FAR_FUTURE,
            })
            .collect();
        let mut queue = TxQueue::<2, 320>::new();
        let mut wire = Vec::new();
        for meta in &transfers {
            queue.push(meta, &payload).unwrap();
            wire.extend(std::iter::from_fn(|| queue.pop()));
        }
        let per_transfer = wire.len() / transfers.len();
        let mut receiver = Receiver::<8, 8, 320>::new();
        let now = Instant::from_micros(1);
        bench(&format!("{name}, receive"), &wire, |frame| {
            black_box(receiver.accept(now, None, frame, &ports).is_some());
        });
        let lost = receiver.counters();
        assert!(lost.transfers as usize >= transfers.len(), "the benchmark receives nothing: {lost:?}");
        // One item is one frame here too: the queue gives out a frame per call.
        let mut next = transfers.iter().cycle();
        bench(&format!("{name}, queue and send"), &wire, |_| {
            if queue.is_empty() {
                queue.push(next.next().unwrap(), &payload).unwrap();
            }
            black_box(queue.pop());
        });
        println!("{:<52} {per_transfer:8} frames each", "");
    }
}
