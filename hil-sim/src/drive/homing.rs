//! Search for the zero position.
//!
//! ```text
//!            switch active at start              edge                     standing
//!   start ───────────────► Leave ──► Search ───────────────► Stop ───────────────► done
//!     └──────────────────────────────►│  ▲                          (zero move if configured)
//!              limit switch: once ────┘──┘  twice: failed
//! ```
//!
//! A limit switch in Search means that the joint started beyond the home switch: the drive moves back across the
//! switch (Leave) and searches again. So it uses the same edge from every start position.
//!
//! The direction is the sign of HomeVel. The switch itself latches the counter, so the result does not depend on
//! the speed. The reading at the edge is HomeOffset (not stated by any source; it makes the factory offset the
//! place of the edge in joint coordinates).

use protocol::powercube::Config;

/// How far homing got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HomingPhase {
    /// Off the switch, or back across it from a limit, against the search direction.
    Leave,
    /// Towards the edge.
    Search,
    /// Edge latched, coming to rest.
    Stop,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Homing {
    pub(super) phase: HomingPhase,
    /// Search direction, +1 or -1.
    pub(super) direction: f64,
    turned: bool,
    was_active: bool,
    falling_edge: bool,
}

/// What the module has to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HomingEvent {
    /// No change of stage.
    Continue,
    /// Drive in the direction of `travel` from now on.
    Turn,
    /// The edge was passed: latch the counter and stop.
    Edge,
    /// Both limit switches seen and no edge: give up.
    Failed,
}

impl Homing {
    /// Starts a run; `active` is the home switch now.
    pub(super) fn new(direction: f64, active: bool, config: Config) -> Self {
        let falling_edge = config.contains(Config::SWR_AT_FALLING_EDGE);
        let phase = if active && !falling_edge { HomingPhase::Leave } else { HomingPhase::Search };
        Self { phase, direction, turned: false, was_active: active, falling_edge }
    }

    /// Direction of travel now.
    pub(super) fn travel(&self) -> f64 {
        if self.phase == HomingPhase::Leave { -self.direction } else { self.direction }
    }

    /// Reads the switches: home switch, and the limit switch in the direction of travel.
    pub(super) fn read_switch(&mut self, active: bool, limit_ahead: bool) -> HomingEvent {
        let rising = active && !self.was_active;
        let falling = !active && self.was_active;
        self.was_active = active;
        match self.phase {
            HomingPhase::Stop => HomingEvent::Continue,
            HomingPhase::Leave if falling => {
                self.phase = HomingPhase::Search;
                HomingEvent::Turn
            }
            HomingPhase::Search if (rising && !self.falling_edge) || (falling && self.falling_edge) => {
                self.phase = HomingPhase::Stop;
                HomingEvent::Edge
            }
            HomingPhase::Leave | HomingPhase::Search if limit_ahead => {
                if self.turned {
                    return HomingEvent::Failed;
                }
                self.turned = true;
                self.phase =
                    if self.phase == HomingPhase::Leave { HomingPhase::Search } else { HomingPhase::Leave };
                HomingEvent::Turn
            }
            HomingPhase::Leave | HomingPhase::Search => HomingEvent::Continue,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rising_edge_is_found_from_outside_the_cam() {
        let mut homing = Homing::new(-1.0, false, Config::EMPTY);
        assert_eq!(homing.read_switch(false, false), HomingEvent::Continue);
        assert_eq!(homing.read_switch(true, false), HomingEvent::Edge);
        assert_eq!(homing.read_switch(true, false), HomingEvent::Continue);
    }

    #[test]
    fn from_inside_the_cam_it_leaves_first_and_comes_back() {
        let mut homing = Homing::new(-1.0, true, Config::EMPTY);
        assert_eq!(homing.travel(), 1.0);
        assert_eq!(homing.read_switch(false, false), HomingEvent::Turn);
        assert_eq!(homing.travel(), -1.0);
        assert_eq!(homing.read_switch(true, false), HomingEvent::Edge);
    }

    #[test]
    fn falling_edge_is_taken_when_configured() {
        let mut homing = Homing::new(1.0, true, Config::SWR_AT_FALLING_EDGE);
        assert_eq!((homing.travel(), homing.read_switch(false, false)), (1.0, HomingEvent::Edge));
    }

    #[test]
    fn a_limit_switch_turns_it_once_and_the_second_ends_it() {
        let mut homing = Homing::new(-1.0, false, Config::EMPTY);
        assert_eq!(homing.read_switch(false, true), HomingEvent::Turn);
        assert_eq!(homing.travel(), 1.0);
        assert_eq!(homing.read_switch(false, true), HomingEvent::Failed);
    }

    #[test]
    fn from_beyond_the_cam_it_takes_the_same_edge_as_from_before_it() {
        let mut homing = Homing::new(-1.0, false, Config::EMPTY);
        assert_eq!(homing.read_switch(false, true), HomingEvent::Turn);
        // Onto the cam and off it again, away from the limit.
        assert_eq!((homing.read_switch(true, false), homing.travel()), (HomingEvent::Continue, 1.0));
        assert_eq!((homing.read_switch(false, false), homing.travel()), (HomingEvent::Turn, -1.0));
        assert_eq!(homing.read_switch(true, false), HomingEvent::Edge);
    }

    #[test]
    fn a_limit_met_while_leaving_turns_it_back_into_the_cam() {
        let mut homing = Homing::new(-1.0, true, Config::EMPTY);
        assert_eq!(homing.read_switch(true, true), HomingEvent::Turn);
        assert_eq!((homing.phase, homing.travel()), (HomingPhase::Search, -1.0));
    }
}
