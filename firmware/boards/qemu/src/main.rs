//! The controller on an emulated Cortex-M4F. Wiring only: time, frames, storage.
//!
//! * **Lockstep**, if the folder QEMU was started in holds `script.bin` (see `firmware/examples/record_throw.rs`): plays
//!   the calls of the script, writes the frames sent to `frames.bin`, prints instructions per call and the deepest stack,
//!   and ends.
//! * **Live** otherwise: SLCAN on the first UART, a timer for time, as a board at the end of a serial line.
#![no_std]
#![no_main]

mod live;
mod lockstep;
mod serial;
mod stack;

use cortex_m_rt::entry;
use firmware::ControllerNode;
use firmware::host_link::Identity;
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use protocol::Instant;

/// Core clock of the machine, MHz.
pub const CORE_MHZ: u32 = 168;

/// The controller with storage in a place of its own: flash on a real board.
pub type Node = ControllerNode<&'static mut RamStorage, &'static mut Spline>;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m_semihosting::debug::exit(cortex_m_semihosting::debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::bkpt();
    }
}

#[entry]
fn main() -> ! {
    static mut STORAGE: RamStorage = RamStorage::new();
    static mut SPLINE: Spline = Spline::empty();
    stack::paint();
    #[cfg(feature = "planted-panic")]
    assert!(core::hint::black_box(false), "planted");
    let Some(peripherals) = cortex_m::Peripherals::take() else { exit(false) };
    // On the stack of a function that does not return: in a static place it would be made on the stack first and copied, and
    // RAM for both would be needed.
    match lockstep::Script::open() {
        Some(script) => play(script, node(STORAGE, SPLINE, &Settings::POWERCUBE6), peripherals),
        None => live::run(node(STORAGE, SPLINE, &live::SETTINGS), peripherals),
    }
}

#[inline(never)]
fn node(storage: &'static mut RamStorage, spline: &'static mut Spline, settings: &Settings) -> Node {
    let identity = Identity { unique_id: *b"emulated-board\0\0", hardware: (0, 1) };
    Node::with_spline(Instant::ZERO, storage, spline, settings, identity)
}

fn play(script: lockstep::Script, mut node: Node, peripherals: cortex_m::Peripherals) -> ! {
    exit(script.play(&mut node, peripherals.SYST))
}

/// Ends the emulator.
pub fn exit(success: bool) -> ! {
    use cortex_m_semihosting::debug;
    debug::exit(if success { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}
