//! Gripper output and the release as an event at a time, not at a sample.
//!
//! The ball is free some time after the output is switched (valve, jaws). So the output is switched that much
//! before the release of the plan, at its own deadline, between control cycles if need be: half a 17 ms period
//! late would be 30 mm on the floor.

use protocol::{Duration, Instant};

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

    /// Remembers the position.
    pub const fn set(&mut self, open: bool) {
        self.open = open;
    }

    /// Sets the board's own output, for [`Self::take_board_level`].
    pub const fn set_board(&mut self, level: bool) {
        self.board = Some(level);
    }

    /// Level that the board has to put on its output, once per change.
    pub const fn take_board_level(&mut self) -> Option<bool> {
        self.board.take()
    }
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
    fn board_output_is_handed_over_once_per_change() {
        let mut gripper = Gripper::default();
        gripper.set_board(true);
        assert_eq!((gripper.take_board_level(), gripper.take_board_level()), (Some(true), None));
    }
}
