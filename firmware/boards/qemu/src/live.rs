//! Live: frames as SLCAN lines on the UART, time from a free-running timer; the loop is
//! [`firmware::runner`].
//!
//! The other end is an SLCAN adapter (the simulated bus) or a client of one: both send frames as the same lines. As client
//! of an adapter the board opens the channel; commands of a client are acknowledged.
//!
//! # Time
//!
//! Without `-icount` the emulator's timers follow the clock of its machine, so the board runs in real time like the
//! other nodes on the simulated bus, and the duration of an instruction depends on the machine. With `-icount` time
//! would follow the instructions: right for a repeatable script, wrong for a live bus. Timer 2 is read, not counted
//! by interrupts: if the machine stops for a while, no time is lost, only calls come late. SysTick only ends a
//! sleep at the next deadline.
//!
//! # Period
//!
//! A control cycle of six joints is 530 bytes on the UART, which carries 20 to 55 kB/s: the emulated receiver holds one
//! byte, and each byte is handed from one thread of the emulator to another. That is 10 to 26 ms, without telemetry. So the
//! period here is twice the paper's, and a machine at the slow end homes the arm but cannot throw: cycles overrun, and the
//! controller stops with fault 401. Sent bytes are a segment each: QEMU needs `nodelay=on` on its TCP port, or they wait
//! 40 ms for each other.

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;
use embedded_can::nb::Can;
use firmware::Runner;
use firmware::groups::powercube::settings::{IN_FLIGHT_MAX, MONITORING};
use firmware::runner::{Clock, NoPin, Pins};
use firmware::settings::Settings;
use protocol::text::slcan::{Assembled, Assembler, CR, Reply};
use protocol::{Duration, Frame, Instant};

use crate::{CORE_MHZ, Node, serial};

/// Timer 2: control, prescaler, count.
const TIMER: usize = 0x4000_0000;
const TIMER_CONTROL: *mut u32 = TIMER as *mut u32;
const TIMER_COUNT: *mut u32 = (TIMER + 0x24) as *mut u32;
const TIMER_PRESCALER: *mut u32 = (TIMER + 0x28) as *mut u32;
/// Control period.
const PERIOD_US: u32 = 34_000;
/// The emulated timer is fed with 1 GHz whatever the clock tree says; one count is a microsecond.
const PRESCALE: u32 = 1_000 - 1;

/// Longest sleep: fits the 24 bits of SysTick.
const SLEEP_MAX: Duration = Duration::from_millis(50);

/// End of a sleep.
#[exception]
fn SysTick() {}

/// Microseconds since the start; the count wraps after 71 minutes and is read far more often.
struct TimerClock {
    last: u32,
    wraps: u32,
}

impl TimerClock {
    fn start() -> Self {
        // SAFETY: nothing else uses timer 2.
        unsafe {
            TIMER_PRESCALER.write_volatile(PRESCALE);
            // What was counted before had another unit.
            TIMER_COUNT.write_volatile(0);
            TIMER_CONTROL.write_volatile(1);
        }
        Self { last: 0, wraps: 0 }
    }
}

impl Clock for TimerClock {
    fn now(&mut self) -> Instant {
        // SAFETY: reading the count has no effect.
        let count = unsafe { TIMER_COUNT.read_volatile() };
        if count < self.last {
            self.wraps += 1;
        }
        self.last = count;
        Instant::from_micros(u64::from(self.wraps) << 32 | u64::from(count))
    }
}

/// Settings for an arm at the end of a UART: a reply takes about a millisecond on it, and the replies of a cycle
/// wait for each other and for telemetry.
///
/// Gains and certificate: `host/tuner/gains/powercube6-34ms.toml`, made by `host/tuner/gains/make`.
#[inline(never)]
pub fn settings() -> Settings {
    const GAINS: [(f32, f32, f32); 6] = {
        let pr = (-86.03724, -16.195065, -0.54422456);
        [pr, pr, pr, pr, (-152.3664, -25.433151, -0.84266365), (-194.6533, -29.583483, -0.9680543)]
    };
    // Changed here, not in a constant of its own: that would be 700 bytes more of flash.
    let mut settings = Settings::POWERCUBE6;
    (settings.estimator_alpha, settings.estimator_beta) = (1.0, 1.0);
    settings.gains_certificate_crc32 = 0xC0F0_2CB7;
    settings.cycle_period_us = PERIOD_US;
    settings.gains_period_us = PERIOD_US;
    (settings.gains_delay_min_us, settings.gains_delay_max_us) = (30_600, PERIOD_US);
    MONITORING.set(&mut settings, false);
    settings.reply_age_us = 1_500;
    // One at a time: several replies would wait for each other on the line, and look older than they are.
    IN_FLIGHT_MAX.set(&mut settings, 1);
    // The write to the gripper's drive also takes time on the UART.
    settings.gripper_opening_us += 1_500;
    settings.reply_deadline_us = 16_000;
    settings.monitor_period_us = 40_000;
    settings.telemetry_period_us = 500_000;
    for (joint, gains) in settings.joint.0.iter_mut().zip(GAINS) {
        (joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last) = gains;
    }
    settings
}

/// Runs the node for ever.
pub fn run(node: &mut Node, mut peripherals: Peripherals) -> ! {
    peripherals.SYST.set_clock_source(SystClkSource::Core);
    peripherals.SYST.enable_interrupt();
    let mut runner =
        Runner::new(Line::open(), TimerClock::start(), Pins { gripper: NoPin, enable: NoPin, lamp: NoPin });
    loop {
        if let Some(until) = runner.turn(node).idle_until {
            let span = until.saturating_since(runner.now());
            sleep(&mut peripherals.SYST, span);
        }
    }
}

/// Sleeps for the given time, or until a byte comes. It must sleep: polling a register keeps the emulator from
/// moving bytes.
fn sleep(timer: &mut SYST, span: Duration) {
    let us = u32::try_from(span.min(SLEEP_MAX).as_micros()).unwrap_or(0).max(1);
    timer.set_reload(us * CORE_MHZ);
    timer.clear_current();
    timer.enable_counter();
    serial::sleep_unless_received();
    timer.disable_counter();
}

/// A CAN controller at the end of the UART.
struct Line {
    lines: Assembler,
}

impl Line {
    /// Opens the channel at 1 Mbit/s.
    fn open() -> Self {
        serial::start();
        serial::send(b"S8\rO\r");
        Self { lines: Assembler::new() }
    }
}

impl Can for Line {
    type Frame = Frame;
    type Error = embedded_can::ErrorKind;

    /// Waits until the line has taken the frame.
    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, Self::Error> {
        serial::send(Reply::Frame { frame: *frame, timestamp_ms: None }.encode().as_bytes());
        Ok(None)
    }

    /// Next whole frame of the UART; set-up commands of a client are acknowledged on the way.
    fn receive(&mut self) -> nb::Result<Frame, Self::Error> {
        while let Some(byte) = serial::receive() {
            let Some(Assembled::Line(line)) = self.lines.push(byte) else { continue };
            match (Reply::parse(line), line.first()) {
                (Ok(Reply::Frame { frame, .. }), _) => return Ok(frame),
                (_, Some(b'S' | b'O' | b'C' | b'L' | b'Z')) => serial::send(&[CR]),
                _ => {}
            }
        }
        Err(nb::Error::WouldBlock)
    }
}
