//! `hil-sim faults`: what can go wrong, and how to write it.

use super::exit::Failure;

pub(super) fn run() -> Result<(), Failure> {
    console::text!("{}", hil_sim::scenario::faults::HELP);
    Ok(())
}
