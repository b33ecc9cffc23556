//! Records a whole throw of the bench (start-up, upload, arming, run) as a script of calls, and the frames that the
//! library answers with: the emulated board plays the same script and must send the same frames.
//!
//! `record_throw DIR` writes `DIR/script.bin` and `DIR/expected.bin`, 24 bytes per record, little endian:
//! time in µs (u64); id (u32: bit 31 extended, bit 30 remote, bit 29 no frame but a deadline); DLC (u8); three zeros;
//! eight data bytes.

#[path = "../tests/bench/mod.rs"]
mod bench;
#[path = "../tests/bench/host.rs"]
mod host;

use std::path::PathBuf;

use protocol::cyphal::cubecell::command;
use protocol::{Frame, Id, Instant};

fn record(at: Instant, frame: Option<&Frame>) -> [u8; 24] {
    let mut bytes = [0; 24];
    bytes[..8].copy_from_slice(&at.as_micros().to_le_bytes());
    let Some(frame) = frame else {
        bytes[8..12].copy_from_slice(&(1u32 << 29).to_le_bytes());
        return bytes;
    };
    let id = match frame.id() {
        Id::Standard(id) => u32::from(id.get()),
        Id::Extended(id) => id.get() | 1 << 31,
    };
    bytes[8..12].copy_from_slice(&(id | u32::from(frame.is_remote()) << 30).to_le_bytes());
    bytes[12] = frame.dlc() as u8;
    bytes[16..16 + frame.data().len()].copy_from_slice(frame.data());
    bytes
}

fn main() -> std::io::Result<()> {
    let dir = PathBuf::from(std::env::args().nth(1).expect("usage: record_throw DIR"));
    let mut host = host::Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.run(1_400_000, |_, _| {});
    assert!(host.bench.distance_from_path() < 1e-3, "the throw itself must work");
    let recorder = &host.bench.controller;
    let script: Vec<u8> =
        recorder.calls.iter().flat_map(|call| record(call.at, call.input.as_ref())).collect();
    let expected: Vec<u8> = recorder.frames.iter().flat_map(|(at, frame)| record(*at, Some(frame))).collect();
    std::fs::create_dir_all(&dir)?;
    std::fs::write(dir.join("script.bin"), &script)?;
    std::fs::write(dir.join("expected.bin"), &expected)?;
    println!("{} calls, {} frames", script.len() / 24, expected.len() / 24);
    Ok(())
}
