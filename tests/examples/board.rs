//! Puts an emulated board into a simulated cell, in lock step: `board SPEC DIR`.
//!
//! `SPEC` is the bus (`lockstep://127.0.0.1:29536/can0`), `DIR` holds the named pipes `cell.in` and `cell.out` of the
//! board's program (`firmware/boards/qemu/src/coupled.rs`). The emulator counts instructions (`-icount shift=3`): what a
//! call sends leaves as much later as its instructions take, and calls meanwhile wait. Neither the emulator's speed
//! nor the machine's load changes anything.
//!
//! Ends when the cell ends, and prints the calls and the most instructions that one took.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use can_link::{BusSpec, Runner};
use protocol::{Duration, ExtendedId, Frame, Id, Instant, Node, StandardId};

const RECORD: usize = 24;
/// A record without a frame: a deadline that is due, or the last of an answer.
const NO_FRAME: u32 = 1 << 29;
/// Time of an instruction at `-icount shift=3`, ns.
const INSTRUCTION_NS: u64 = 8;

struct Board {
    calls: File,
    answers: File,
    due: Instant,
    /// The last call takes until then.
    busy_until: Instant,
    /// Frames that came while it was busy.
    waiting: VecDeque<Frame>,
    /// Frames with the times at which they leave.
    out: VecDeque<(Instant, Frame)>,
    now: Instant,
    count: u64,
    worst: u32,
}

impl Board {
    fn open(dir: &Path) -> std::io::Result<Self> {
        // Each waits for the board to open the other end, in this order.
        let calls = OpenOptions::new().write(true).open(dir.join("cell.in"))?;
        let answers = File::open(dir.join("cell.out"))?;
        let (due, busy_until, now) = (Instant::ZERO, Instant::ZERO, Instant::ZERO);
        let (waiting, out) = (VecDeque::new(), VecDeque::new());
        Ok(Self { calls, answers, due, busy_until, waiting, out, now, count: 0, worst: 0 })
    }

    fn call(&mut self, frame: Option<&Frame>) {
        let mut record = [0; RECORD];
        record[..8].copy_from_slice(&self.now.as_micros().to_le_bytes());
        let id = match frame.map(Frame::id) {
            None => NO_FRAME,
            Some(Id::Standard(id)) => id.get().into(),
            Some(Id::Extended(id)) => id.get() | 1 << 31,
        };
        record[8..12].copy_from_slice(&id.to_le_bytes());
        if let Some(frame) = frame {
            record[12] = frame.dlc() as u8;
            record[16..16 + frame.data().len()].copy_from_slice(frame.data());
        }
        self.calls.write_all(&record).expect("the board takes the call");
        let mut sent = Vec::new();
        let instructions = loop {
            self.answers.read_exact(&mut record).expect("the board answers");
            let word = |at: usize| u32::from_le_bytes(record[at..at + 4].try_into().expect("four bytes"));
            let id = word(8);
            if id == NO_FRAME {
                self.due =
                    Instant::from_micros(u64::from_le_bytes(record[..8].try_into().expect("eight bytes")));
                break word(16);
            }
            let can_id = if id >> 31 == 1 {
                Id::Extended(ExtendedId::from_low_bits(id))
            } else {
                Id::Standard(StandardId::from_low_bits(id as u16))
            };
            let data = &record[16..16 + usize::from(record[12]).min(8)];
            sent.push(Frame::new(can_id, data).expect("at most eight bytes"));
        };
        self.count += 1;
        self.worst = self.worst.max(instructions);
        let took_us = (u64::from(instructions) * INSTRUCTION_NS).div_ceil(1_000).max(1);
        self.busy_until = self.now + Duration::from_micros(took_us);
        self.out.extend(sent.into_iter().map(|frame| (self.busy_until, frame)));
    }

    fn work(&mut self) {
        if self.now < self.busy_until {
            return;
        }
        if let Some(frame) = self.waiting.pop_front() {
            self.call(Some(&frame));
        } else if self.due <= self.now {
            self.call(None);
        }
    }
}

impl Node for Board {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.now = now;
        // Remote frames mean nothing to a controller.
        if !frame.is_remote() {
            self.waiting.push_back(*frame);
        }
        self.work();
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        self.work();
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front_if(|(at, _)| *at <= self.now).map(|(_, frame)| frame)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let next_call = if self.waiting.is_empty() { self.due.max(self.busy_until) } else { self.busy_until };
        Some(self.out.front().map_or(next_call, |(at, _)| next_call.min(*at)))
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(spec), Some(dir)) = (words.next(), words.next().map(PathBuf::from)) else {
        return Err("usage: board SPEC DIR".into());
    };
    let spec: BusSpec = spec.parse()?;
    if !matches!(spec, BusSpec::Lockstep { .. }) {
        return Err("the bus must be in lock step: lockstep://127.0.0.1:29536/can0".into());
    }
    let mut board = Board::open(&dir)?;
    let clock = spec.clock();
    let mut link = can_link::open(&spec, clock)?;
    println!("the board is in the cell");
    let ended = Runner::new(&mut *link, clock).run(&mut [&mut board], &AtomicBool::new(false), None);
    println!("{} calls, {} instructions in the longest", board.count, board.worst);
    match ended {
        Err(can_link::RunError::Link(_)) | Ok(()) => Ok(()),
        Err(other) => Err(other.into()),
    }
}
