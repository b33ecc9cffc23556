//! The controller on an STM32F405. Wiring only: clock, CAN, time, watchdog, gripper output.
//!
//! | signal | pin | to |
//! |---|---|---|
//! | CAN1 RX, TX | PB8, PB9 | transceiver of the drives' bus, 120 Ω at both ends |
//! | gripper | PC1, high = open unless `gripper.inverted` | valve driver |
//! | crystal | PH0, PH1 | 8 MHz |
//!
//! * Received frames are taken by interrupt into a ring: the peripheral holds three, a control step lasts longer than that.
//! * The independent watchdog (100 ms) is fed only while deadlines are served in time; a loop that hangs resets the
//!   board, and the drives stop by their own watchdogs.
//! * Tokens and challenges are drawn from the chip's random number generator. A generator that fails keeps the board from
//!   starting: the drives get no sign of life.
//! * Trajectory, settings and key live in RAM: erasing the chip's flash stalls the processor for up to two seconds, longer than
//!   the drives' watchdogs wait. After power on there is no trajectory and no
//!   key, and the settings are the built-in ones.
//!
//! It has never run on hardware. What is known is that it builds, that the same core runs bit for bit on the emulated
//! processor, and what the reference manual (RM0090) says about the registers used here.
#![no_std]
#![no_main]

mod can;
mod chip;

use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use firmware::ControllerNode;
use firmware::host_link::Identity;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use protocol::{Duration, Instant, Node as _};

type Node = ControllerNode<&'static mut RamStorage, &'static mut Spline>;

/// A deadline served later than this is no healthy loop. A commit of the longest file takes about 10 ms.
const HEALTHY: Duration = Duration::from_millis(25);

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    // The watchdog resets the board.
    loop {
        cortex_m::asm::nop();
    }
}

#[entry]
fn main() -> ! {
    static mut STORAGE: RamStorage = RamStorage::new();
    static mut SPLINE: Spline = Spline::empty();
    // Uninitialised: an `Option` would be 12 KB of initial values in flash.
    static mut NODE: MaybeUninit<Node> = MaybeUninit::uninit();
    chip::start_clocks();
    chip::start_gripper();
    chip::start_timer();
    let mut bus = can::Bus::start();
    let identity = Identity { unique_id: chip::unique_id(), hardware: (1, 0) };
    let mut clock = chip::Clock::default();
    let node = NODE.write(Node::asleep(clock.now(), STORAGE, SPLINE, identity, chip::seed()));
    node.wake(&Settings::POWERCUBE6);
    chip::start_watchdog();
    let mut last = Instant::ZERO;
    loop {
        let now = clock.now().max(last);
        last = now;
        let due = node.poll_timeout().filter(|due| *due <= now);
        if due.is_none_or(|due| now.saturating_since(due) < HEALTHY) {
            chip::feed_watchdog();
        }
        if due.is_some() {
            node.handle_timeout(now);
        } else if let Some(frame) = can::receive() {
            node.handle_frame(now, &frame);
        }
        // One frame is held while the mailboxes are full; the rest waits in the node.
        while bus.is_free()
            && let Some(frame) = node.poll_frame()
        {
            bus.send(&frame);
        }
        bus.retry();
        if let Some(level) = node.take_gripper_level() {
            chip::set_gripper(level);
        }
    }
}
