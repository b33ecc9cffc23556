//! The controller as a node of a simulated cell in virtual time, coupled through two named pipes of the host.
//!
//! A bridge (`tests/examples/board.rs`) writes one call into `cell.in`: a frame, or a deadline that is due. The
//! board executes the call and answers in `cell.out` with the frames that it sends and a last record: the time of
//! its next deadline, and the number of instructions of the call. Between two calls it waits in a read, and no time
//! passes.

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use firmware::settings::Settings;
use protocol::{Instant, Node as _};

use crate::Node;
use crate::lockstep::{DEADLINE, File, RECORD, emit, instructions, parse};

/// Control period, µs. At 8 ns per instruction a step and the frames between two steps take too long for 3 ms
/// (fault 713: 3.1 ms would be enough). The host brings the gains for this period.
const PERIOD_US: u32 = 5_000;

/// Settings of the arm at that period.
pub fn settings() -> Settings {
    let mut settings = Settings::POWERCUBE6;
    settings.cycle_period_us = PERIOD_US;
    settings
}

/// Both pipes.
pub struct Pipes {
    calls: File,
    answers: File,
}

impl Pipes {
    /// The pipes, if they are there. Opening waits for the bridge.
    pub fn open() -> Option<Self> {
        let calls = File::open(b"cell.in\0", 1)?;
        Some(Self { calls, answers: File::open(b"cell.out\0", 5)? })
    }

    /// Answers calls until the bridge closes its end; true if all could be read and answered.
    pub fn serve(self, node: &mut Node, mut clock: SYST) -> bool {
        clock.set_clock_source(SystClkSource::Core);
        clock.set_reload(0x00FF_FFFF);
        clock.clear_current();
        clock.enable_counter();
        let mut call = [0; RECORD];
        let mut fine = true;
        loop {
            match self.calls.read(&mut call) {
                0 => return fine,
                RECORD => {}
                _ => return false,
            }
            let Some((now, frame)) = parse(&call) else { return false };
            let before = SYST::get_current();
            match &frame {
                Some(frame) => node.handle_frame(now, frame),
                None => node.handle_timeout(now),
            }
            let ticks = before.wrapping_sub(SYST::get_current()) & 0x00FF_FFFF;
            while let Some(frame) = node.poll_frame() {
                fine &= self.answers.write(&emit(now, &frame));
            }
            let due = node.poll_timeout().unwrap_or(Instant::FAR_FUTURE);
            fine &= self.answers.write(&last(due, instructions(ticks)));
        }
    }
}

fn last(due: Instant, instructions: u32) -> [u8; RECORD] {
    let mut record = [0; RECORD];
    let head = due.as_micros().to_le_bytes().into_iter().chain(DEADLINE.to_le_bytes());
    let head = head.chain([0; 4]).chain(instructions.to_le_bytes());
    for (to, from) in record.iter_mut().zip(head) {
        *to = from;
    }
    record
}
