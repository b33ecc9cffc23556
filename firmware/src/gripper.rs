//! Gripper output, and the release as an event at an exact time.
//!
//! The ball is free some time after the output is switched (valve, jaws). So the output is switched that much
//! before the release of the plan, at its own deadline, between control cycles if needed: half a 17 ms period late
//! would be 30 mm on the floor.

use protocol::{Duration, Instant};

use crate::events::{Action, EVENTS_MAX};

/// A switching of the output that is to come.
#[derive(Clone, Copy, Debug)]
struct Switching {
    at: Instant,
    open: bool,
}

/// The gripper.
#[derive(Clone, Debug, Default)]
pub struct Gripper {
    open: bool,
    /// Ascending in time.
    planned: heapless::Vec<Switching, EVENTS_MAX>,
    /// Time of the first one, because each control step needs it.
    next_at: Option<Instant>,
    board: Option<bool>,
}

impl Gripper {
    /// Last set position of the output.
    pub const fn is_open(&self) -> bool {
        self.open
    }

    /// Plans an action. The output opens `opening` before the time, so that the ball is free at that time. False
    /// (and nothing changed) if the list is full.
    #[must_use]
    pub fn plan(&mut self, action: Action, at: Instant, opening: Duration) -> bool {
        let switching = match action {
            Action::Open => Switching { at: at.saturating_sub(opening), open: true },
            Action::Close => Switching { at, open: false },
        };
        let place = self.planned.iter().position(|other| other.at > switching.at);
        let taken = self.planned.insert(place.unwrap_or(self.planned.len()), switching).is_ok();
        self.look_ahead();
        taken
    }

    /// Forgets all planned actions: after a stop the gripper keeps the ball.
    pub fn cancel(&mut self) {
        self.planned.clear();
        self.next_at = None;
    }

    fn look_ahead(&mut self) {
        self.next_at = self.planned.first().map(|next| next.at);
    }

    /// When the output is to be switched next.
    #[inline]
    pub const fn next_at(&self) -> Option<Instant> {
        self.next_at
    }

    /// The position to switch to if the next planned time has come; this action is then removed.
    #[inline]
    pub fn take_due(&mut self, now: Instant) -> Option<bool> {
        if self.next_at.is_some_and(|at| at <= now) { self.take_next() } else { None }
    }

    #[inline(never)]
    fn take_next(&mut self) -> Option<bool> {
        let open = self.planned.first()?.open;
        self.planned.remove(0);
        self.look_ahead();
        Some(open)
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
        let (us, opening) = (Instant::from_micros, Duration::from_micros(23_456));
        let mut gripper = Gripper::default();
        assert!(gripper.plan(Action::Open, us(560_000), opening));
        assert_eq!(gripper.next_at(), Some(us(536_544)));
        assert_eq!(gripper.take_due(us(536_543)), None);
        assert_eq!(gripper.take_due(us(536_544)), Some(true));
        assert_eq!(gripper.take_due(us(536_545)), None, "once");
    }

    #[test]
    fn events_come_in_the_order_of_their_switching_and_no_more_than_fit() {
        let (us, opening) = (Instant::from_micros, Duration::from_micros(100));
        let mut gripper = Gripper::default();
        assert!(gripper.plan(Action::Close, us(950), opening));
        // Switched at 900, although it is due later.
        assert!(gripper.plan(Action::Open, us(1_000), opening));
        assert!(gripper.plan(Action::Close, us(500), opening));
        let taken: Vec<_> = core::iter::from_fn(|| gripper.take_due(us(2_000))).collect();
        assert_eq!(taken, [false, true, false]);
        for _ in 0..EVENTS_MAX {
            assert!(gripper.plan(Action::Close, us(1), opening));
        }
        assert!(!gripper.plan(Action::Close, us(1), opening));
        gripper.cancel();
        assert_eq!(gripper.next_at(), None);
    }

    #[test]
    fn board_output_is_handed_over_once_per_change() {
        let mut gripper = Gripper::default();
        gripper.set_board(true);
        assert_eq!((gripper.take_board_level(), gripper.take_board_level()), (Some(true), None));
    }
}
