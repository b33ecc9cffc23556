//! The controller on an STM32F405. Wiring only: clock, CAN, time, watchdog, outputs; the loop is
//! [`firmware::runner`].
//!
//! | signal | pin | to |
//! |---|---|---|
//! | CAN1 RX, TX | PB8, PB9 | transceiver of the drives' bus, 120 Ω at both ends |
//! | gripper | PC1, high = open unless `gripper.inverted` | valve driver |
//! | enable | PC2, high = the group may move, or brakes after a fault | enable input of drives or valves |
//! | lamp | PC3, high = on | warning lamp |
//! | crystal | PH0, PH1 | 8 MHz |
//!
//! * Received frames are taken by interrupt into a ring: the peripheral holds three, and a control step lasts longer.
//! * The independent watchdog (100 ms) is fed only while deadlines are served in time; a loop that hangs resets the
//!   board, and the drives stop by their own watchdogs.
//! * Tokens and challenges are drawn from the chip's random number generator. If the generator fails, the board does not
//!   start, and the drives get no sign of life.
//! * Trajectory, settings and key are kept in RAM: erasing the chip's flash stalls the processor for up to two seconds,
//!   longer than the time-out of the drives' watchdogs. After power on there is no trajectory and no key, and the settings
//!   are the built-in ones.
//!
//! It has never run on hardware. What is known is that it builds, that the same core runs bit for bit on the emulated
//! processor, and what the reference manual (RM0090) says about the registers used here.
#![no_std]
#![no_main]

mod can;
mod chip;

use core::mem::MaybeUninit;

use cortex_m_rt::entry;
use firmware::groups::powercube::PowerCubes;
use firmware::host_link::Identity;
use firmware::runner::{Clock as _, Pins};
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use firmware::{ControllerNode, Runner};

use chip::Output;

type Node = ControllerNode<&'static mut RamStorage, &'static mut Spline, PowerCubes>;

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
    let pins = Pins { gripper: Output::start(1), enable: Output::start(2), lamp: Output::start(3) };
    chip::start_timer();
    let mut clock = chip::Clock::default();
    let identity = Identity { unique_id: chip::unique_id(), hardware: (1, 0) };
    let node = NODE.write(Node::blank(clock.now(), STORAGE, SPLINE, identity, chip::seed()));
    node.restore(&Settings::POWERCUBE6);
    let mut runner = Runner::new(can::Bus::start(), clock, pins);
    chip::start_watchdog();
    loop {
        if runner.turn(node).healthy {
            chip::feed_watchdog();
        }
    }
}
