//! Gripper output and the release as an event at a time, not at a sample.
//!
//! The ball is free some time after the output is switched (valve, jaws). So the output is switched that much
//! before the release of the plan, at its own deadline, between control cycles if need be: half a 17 ms period
//! late would be 30 mm on the floor.

use protocol::powercube::{Dio, Parameter, Request, Value};
use protocol::{Duration, Instant};

use crate::settings::Settings;

/// Where the gripper is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Own output of the board.
    Board,
    /// Output of a drive module, by its address.
    Module(u32),
}

/// The gripper.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gripper {
    open: bool,
    release_at: Option<Instant>,
    board: Option<bool>,
}

impl Gripper {
    /// Last set position of the output.
    pub const fn is_open(&self) -> bool {
        self.open
    }

    /// Plans the release: the ball shall be free at `free_at`.
    pub fn plan(&mut self, free_at: Instant, opening: Duration) {
        self.release_at = Some(free_at.saturating_sub(opening));
    }

    /// Forgets a planned release: after a stop the ball is kept.
    pub const fn cancel(&mut self) {
        self.release_at = None;
    }

    /// When the output is to be switched.
    pub const fn release_at(&self) -> Option<Instant> {
        self.release_at
    }

    /// True once the planned release is due; it is then forgotten.
    pub fn take_due(&mut self, now: Instant) -> bool {
        let due = self.release_at.is_some_and(|at| at <= now);
        if due {
            self.release_at = None;
        }
        due
    }

    /// Sets the position; for a board's own output the level is handed over by [`Self::take_board_level`].
    pub fn set(&mut self, open: bool, settings: &Settings) {
        self.open = open;
        if output(settings) == Output::Board {
            self.board = Some(open != settings.gripper_inverted);
        }
    }

    /// Level that the board has to put on its output, once per change.
    pub const fn take_board_level(&mut self) -> Option<bool> {
        self.board.take()
    }
}

/// Where the gripper is.
pub const fn output(settings: &Settings) -> Output {
    match settings.gripper_address {
        0 => Output::Board,
        address => Output::Module(address),
    }
}

/// Write that sets the gripper's line of a module and leaves its other outputs as last seen.
pub fn write(open: bool, seen: Dio, settings: &Settings) -> Request {
    let line = 1u8 << (settings.gripper_line & 3);
    let level = open != settings.gripper_inverted;
    let outputs = if level { seen.outputs() | line } else { seen.outputs() & !line };
    // Outputs are bits 4 to 7 of the word; inputs are not written.
    Request::Set(Parameter::DioData, Value::U32(u32::from(outputs) << 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_is_switched_before_the_release_by_the_opening_time() {
        let mut gripper = Gripper::default();
        gripper.plan(Instant::from_micros(560_000), Duration::from_micros(23_456));
        assert_eq!(gripper.release_at(), Some(Instant::from_micros(536_544)));
        assert!(!gripper.take_due(Instant::from_micros(536_543)));
        assert!(gripper.take_due(Instant::from_micros(536_544)));
        assert!(!gripper.take_due(Instant::from_micros(536_545)), "once");
    }

    #[test]
    fn module_output_keeps_the_other_lines() {
        let mut settings = Settings::powercube6();
        settings.gripper_line = 2;
        let seen = Dio::new(0b0000, 0b1001);
        assert_eq!(write(true, seen, &settings), Request::Set(Parameter::DioData, Value::U32(0b1101_0000)));
        settings.gripper_inverted = true;
        assert_eq!(write(true, seen, &settings), Request::Set(Parameter::DioData, Value::U32(0b1001_0000)));
    }

    #[test]
    fn board_output_is_handed_over_once_per_change() {
        let (mut gripper, mut settings) = (Gripper::default(), Settings::powercube6());
        settings.gripper_address = 0;
        gripper.set(true, &settings);
        assert_eq!((gripper.take_board_level(), gripper.take_board_level()), (Some(true), None));
    }
}
