//! Live: frames as SLCAN lines on the UART, time from SysTick.
//!
//! The other end is an SLCAN adapter (the simulated bus) or a client of one: both send frames as the same lines. As client
//! of an adapter the board opens the channel; commands of a client are acknowledged.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;
use protocol::text::slcan::{Assembled, Assembler, CR, Reply};
use protocol::{Instant, Node as _};

use crate::{CORE_MHZ, Node, serial};

/// SysTick runs once per millisecond.
const RELOAD: u32 = CORE_MHZ * 1_000 - 1;
/// Wraps after 49 days; `now` counts the wraps.
static MILLIS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    MILLIS.store(MILLIS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

struct Clock {
    last_ms: u32,
    wraps: u32,
}

impl Clock {
    fn now(&mut self) -> Instant {
        // Read twice: the counter may wrap between the two reads.
        let (ms, ticks) = loop {
            let before = MILLIS.load(Ordering::Relaxed);
            let ticks = RELOAD - SYST::get_current();
            if MILLIS.load(Ordering::Relaxed) == before {
                break (before, ticks);
            }
        };
        if ms < self.last_ms {
            self.wraps += 1;
        }
        self.last_ms = ms;
        let ms = u64::from(self.wraps) << 32 | u64::from(ms);
        Instant::from_micros(ms * 1_000 + u64::from(ticks / CORE_MHZ))
    }
}

/// The loop of the node contract, for ever.
pub fn run(node: &mut Node, mut peripherals: Peripherals) -> ! {
    peripherals.SYST.set_clock_source(SystClkSource::Core);
    peripherals.SYST.set_reload(RELOAD);
    peripherals.SYST.clear_current();
    peripherals.SYST.enable_counter();
    peripherals.SYST.enable_interrupt();
    serial::start();
    // 1 Mbit/s, open.
    serial::send(b"S8\rO\r");
    let (mut clock, mut lines, mut last) = (Clock { last_ms: 0, wraps: 0 }, Assembler::new(), Instant::ZERO);
    loop {
        // Time never goes back, not even by the microsecond of a counter that wraps.
        let now = clock.now().max(last);
        last = now;
        if node.poll_timeout().is_some_and(|due| due <= now) {
            node.handle_timeout(now);
        } else if let Some(byte) = serial::receive() {
            take_byte(node, &mut lines, now, byte);
        } else {
            // SysTick wakes at the latest after a millisecond; deadlines in between are waited for awake.
            let soon = node.poll_timeout().is_some_and(|due| due.saturating_since(now).as_micros() < 1_000);
            if !soon {
                cortex_m::asm::wfi();
            }
            continue;
        }
        while let Some(frame) = node.poll_frame() {
            serial::send(Reply::Frame { frame, timestamp_ms: None }.encode().as_bytes());
        }
        let _ = node.take_gripper_level();
    }
}

fn take_byte(node: &mut Node, lines: &mut Assembler, now: Instant, byte: u8) {
    let Some(Assembled::Line(line)) = lines.push(byte) else { return };
    match (Reply::parse(line), line.first()) {
        (Ok(Reply::Frame { frame, .. }), _) => node.handle_frame(now, &frame),
        // Set-up commands of a client.
        (_, Some(b'S' | b'O' | b'C' | b'L' | b'Z')) => serial::send(&[CR]),
        _ => {}
    }
}
