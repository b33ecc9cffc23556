//! What a person or a program that leads the arm needs beside jobs.

use firmware::fault::Refusal;
use protocol::cyphal::cubecell::command::Trajectory;
use protocol::{Duration, Instant};

use super::Operator;
use crate::dialogue::online::EndStates;
use crate::dialogue::operator::OperatorError;

/// An operator that also accepts end states in flight, and continues after a stop.
pub trait Interactive: Operator {
    /// Time from sending an end state to the earliest time at which it can be reached, with a margin for a host that is late.
    fn lead(&self) -> Duration;

    /// Begins the armed trajectory and returns as soon as it runs.
    ///
    /// # Errors
    /// [`OperatorError::Refused`], and those of the link.
    fn start(&mut self, name: &Trajectory) -> Result<(), OperatorError>;

    /// Compares the clocks anew, before [`Interactive::start`].
    fn read_clock(&mut self) -> Result<(), OperatorError> {
        Ok(())
    }

    /// Time of the controller less ours at a time of ours, µs; `None` before [`Interactive::read_clock`].
    fn clock_offset_us(&mut self, ours: Instant) -> Option<f64>;

    /// Compares the clocks again; every few seconds.
    fn look_at_clock(&mut self) -> Result<(), OperatorError> {
        Ok(())
    }

    /// Sends a new end state and does not wait for the answer.
    ///
    /// # Errors
    /// [`OperatorError::TargetNotSaid`]: nothing was sent.
    fn send_target(&mut self, sequence: u8, end: &EndStates) -> Result<(), OperatorError>;

    /// Why end states were not taken, since the last call.
    fn refused_targets(&mut self) -> Vec<Refusal>;

    /// Lets time pass; true if the program was ordered to end before.
    ///
    /// # Errors
    /// As [`Operator::heed_stops`], and those of the link.
    fn run_until(&mut self, until: Instant) -> Result<bool, OperatorError>;

    /// The arm rests after [`Interactive::start`]: leaving it needs no halt.
    fn release_motion(&mut self) {}

    fn is_interrupted(&self) -> bool;

    /// True if time passes only while this program waits for it: then a command needs its time.
    fn needs_times(&self) -> bool;

    /// Clears the latched fault of the controller; nothing without one.
    fn clear_fault(&mut self) -> Result<(), OperatorError>;

    /// Stops that others gave before are over; the next one ends a job again.
    fn heed_stops_from_now(&mut self);
}
