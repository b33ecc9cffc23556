//! Records a script of calls: a whole throw of the bench (start-up, upload, arming, run), then a run with new end
//! states at 120 Hz. Also records the frames that the library answers with: the emulated board plays the same
//! script and must send the same frames.
//!
//! `record_throw DIR` writes `DIR/script.bin` and `DIR/expected.bin`, 24 bytes per record, little endian:
//! time in µs (u64); id (u32: bit 31 extended, bit 30 remote, bit 29 no frame but a deadline); DLC (u8); three zeros;
//! eight data bytes.

#[path = "../tests/bench/mod.rs"]
#[allow(dead_code, unused_imports, reason = "made for the tests")]
mod bench;
#[path = "lockstep/record.rs"]
mod record;

use std::path::PathBuf;

use firmware::envelope::Envelope;
use firmware::joints::PerJoint;
use firmware::settings::Settings;
use firmware::trajectory_format::{Header, rest};
use protocol::cyphal::cubecell::command;
use record::record;

/// Waits where the throw ended, and goes to an end state that moves.
fn take_end_states(host: &mut bench::host::Host) {
    let stands: [f64; 6] = std::array::from_fn(|i| host.bench.drives[i].q);
    let mut q_rad = PerJoint::default();
    for (i, q) in stands.into_iter().enumerate() {
        q_rad.set(bench::joint(i), q as f32);
    }
    let envelope = Some(Envelope::widest(&Settings::powercube6()));
    let header = Header { joints: 6, period_us: 3_000, envelope, ..Header::default() };
    let name = host.arm(&bench::file(&header, &rest(q_rad, 5_000_000)));
    host.command(command::RUN, &name);
    host.run(100_000, |_, _| {});
    let arrive_us = host.bench.now + 400_000;
    for update in 0..36u8 {
        let wave = |i: usize| 0.02 * (f64::from(update) + i as f64).sin();
        // Towards the middle of the ranges.
        let state = std::array::from_fn(|i| {
            let way = -0.2 * stands[i].signum();
            (stands[i] + way + wave(i), 2.0 * way + wave(i + 6))
        });
        host.send_target(update, arrive_us, state);
        host.run(8_333, |_, _| {});
    }
    host.run(800_000, |_, _| {});
    let taken = host.bench.controller.node.controller().targets_taken();
    assert!(taken >= 34, "{taken} of 36 end states taken");
}

fn main() -> std::io::Result<()> {
    let dir = PathBuf::from(std::env::args().nth(1).expect("usage: record_throw DIR"));
    let mut host = bench::host::Host::new();
    let name = host.armed();
    host.command(command::RUN, &name);
    host.run(1_400_000, |_, _| {});
    assert!(host.bench.distance_from_path() < 1e-3, "the throw itself must work");
    take_end_states(&mut host);
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
