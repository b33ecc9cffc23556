//! The flag that Ctrl-C, SIGTERM and SIGHUP set in a program that talks to an arm: see [`console::interrupt`](mod@console::interrupt).

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a process that a later signal ends.
pub const INTERRUPTED: u8 = 6;

/// The flag of the process.
pub fn interrupt() -> Arc<AtomicBool> {
    console::interrupt::interrupt(INTERRUPTED)
}
