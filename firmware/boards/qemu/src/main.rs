//! The controller on an emulated Cortex-M4F. Wiring only: time, frames, storage.
//!
//! * **Live**: SLCAN on the first UART, a timer for time, as a board at the end of a serial line.
//! * **Coupled**, with the feature `script` and if that folder holds the pipes `cell.in` and `cell.out`: a node of a
//!   simulated cell in virtual time.
//! * **Lockstep**, with the feature `script` and if the folder QEMU was started in holds `script.bin` (see
//!   `firmware/examples/record_throw.rs`): plays the calls of the script, writes the frames sent to `frames.bin`, prints
//!   instructions per call and the deepest stack, and ends.
#![no_std]
#![no_main]

#[cfg(feature = "script")]
mod coupled;
mod live;
#[cfg(feature = "script")]
mod lockstep;
mod serial;
#[cfg(feature = "script")]
mod stack;

use cortex_m_rt::entry;
use firmware::ControllerNode;
use firmware::authority::Seed;
#[cfg(feature = "cia402")]
use firmware::groups::cia402::Cia402 as Drives;
#[cfg(feature = "mit")]
use firmware::groups::mit::Mit as Drives;
#[cfg(feature = "odrive")]
use firmware::groups::odrive::Odrive as Drives;
#[cfg(not(any(feature = "mit", feature = "cia402", feature = "odrive")))]
use firmware::groups::powercube::PowerCubes as Drives;
use firmware::host_link::Identity;
#[cfg(feature = "script")]
use firmware::settings::Settings;
use firmware::spline::Spline;
use firmware::store::RamStorage;
use protocol::Instant;

/// Core clock of the machine, MHz.
pub const CORE_MHZ: u32 = 168;

/// The controller with storage in a place of its own: flash on a real board.
pub type Node = ControllerNode<&'static mut RamStorage, &'static mut Spline, Drives>;

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
    #[cfg(feature = "script")]
    stack::paint();
    #[cfg(feature = "planted-panic")]
    assert!(core::hint::black_box(false), "planted");
    let Some(peripherals) = cortex_m::Peripherals::take() else { exit(false) };
    let identity = Identity { unique_id: *b"emulated-board\0\0", hardware: (0, 1) };
    // On the stack of a function that does not return, in two steps: built in its final place, and never moved.
    // The emulated chip has no random number generator, and a script must play the same way each time.
    let mut node = Node::blank(Instant::ZERO, STORAGE, SPLINE, identity, Seed::FORESEEABLE);
    #[cfg(feature = "script")]
    if let Some(pipes) = coupled::Pipes::open() {
        node.restore(&coupled::settings());
        exit(pipes.serve(&mut node, peripherals.SYST))
    }
    #[cfg(feature = "script")]
    if let Some(script) = lockstep::Script::open() {
        node.restore(&Settings::POWERCUBE6);
        exit(script.play(&mut node, peripherals.SYST))
    }
    node.restore(&live::settings());
    live::run(&mut node, peripherals)
}

/// Ends the emulator.
pub fn exit(success: bool) -> ! {
    use cortex_m_semihosting::debug;
    debug::exit(if success { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}
