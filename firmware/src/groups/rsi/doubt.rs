//! After a break: which correction is in force at the robot (pure).
//!
//! A new run begins with corrections of zero, in its start pose. The run of before goes on with the last correction that the robot
//! took. A wrong guess is a leap of the axes, so nothing is answered until the axes show which it is: a robot without an answer
//! holds its set points, and ends by itself when it has counted enough late answers.
//!
//! | given so far | axes | then |
//! |---|---|---|
//! | zero | at the start pose | a new run |
//! | unknown: this program has just begun | at the start pose, and the robot has missed no answer yet | a new run |
//! | unknown, or more than zero | at the start pose for as long as the lag takes | a new run |
//! | more | where the corrections lead, and not near the start pose; start pose as before | the run goes on |
//! | any | elsewhere | no answer |
//!
//! A robot that another program led until it ended has missed an answer since: the runner does not answer in the first cycle.

use super::link::is_same_pose;
use crate::joints::PerJoint;

/// Axes nearer to the start pose than this are there, rad: beyond the noise of one decimal of a degree. As a step of a set point
/// in one cycle of 12 ms it is below the cut-out of a robot.
pub const AT_START_RAD: f32 = 3.5e-3;
/// Axes nearer than this to where the corrections lead are there, rad.
pub(super) const NEAR_RAD: f32 = 0.05;
/// Axes farther than this from the start pose are not near it, rad.
pub(super) const AWAY_RAD: f32 = 0.15;

/// What is seen of the axes.
pub(super) struct Sight<'a> {
    pub(super) q_rad: &'a PerJoint<f32>,
    /// Start pose, as the telegram says.
    pub(super) start_rad: &'a PerJoint<f32>,
    /// Start pose before the break.
    pub(super) old_start_rad: Option<&'a PerJoint<f32>>,
    /// Set points given last.
    pub(super) set_rad: &'a PerJoint<f32>,
    /// Where these should have led the axes by now.
    pub(super) model_rad: &'a PerJoint<f32>,
    /// Late answers, as the robot counts them.
    pub(super) late: Option<u32>,
}

/// What follows from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    NewRun,
    OldRun,
    Nothing,
}

/// A break that is not explained yet.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Doubt {
    cycles: u32,
    at_start_cycles: u32,
}

/// Largest distance of two poses; infinite where one is no number.
pub(super) fn away_rad(PerJoint(a): &PerJoint<f32>, PerJoint(b): &PerJoint<f32>) -> f32 {
    a.iter().zip(b).fold(0.0, |most, (a, b)| {
        let away = (a - b).abs();
        if away <= most {
            most
        } else if away.is_finite() {
            away
        } else {
            f32::INFINITY
        }
    })
}

impl Doubt {
    /// Looks at one more telegram; the axes have followed a set point after `settling_cycles`.
    pub(super) fn look(&mut self, seen: &Sight<'_>, settling_cycles: u32) -> Found {
        self.cycles = self.cycles.saturating_add(1);
        let from_start_rad = away_rad(seen.q_rad, seen.start_rad);
        let is_at_start = from_start_rad <= AT_START_RAD;
        self.at_start_cycles = if is_at_start { self.at_start_cycles.saturating_add(1) } else { 0 };
        let given_rad = seen.old_start_rad.map(|old| away_rad(seen.set_rad, old));
        let is_zero =
            given_rad.map_or(self.cycles == 1 && seen.late == Some(0), |given| given <= AT_START_RAD);
        if is_at_start && (is_zero || self.at_start_cycles > settling_cycles) {
            return Found::NewRun;
        }
        let is_same = seen.old_start_rad.is_some_and(|old| is_same_pose(old, seen.start_rad));
        // The robot has held its set points for a cycle: they are continued from rest.
        let goes_on = self.cycles > 1
            && is_same
            && !is_zero
            && from_start_rad >= AWAY_RAD
            && away_rad(seen.q_rad, seen.model_rad) <= NEAR_RAD;
        if goes_on { Found::OldRun } else { Found::Nothing }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks at axes `q` with corrections given up to `set`, from a start pose of zero that is now `start`.
    fn look(doubt: &mut Doubt, q: f32, set: f32, start: f32) -> Found {
        let [q_rad, set_rad, start_rad, old] = [q, set, start, 0.0].map(PerJoint::splat);
        let seen = Sight {
            q_rad: &q_rad,
            start_rad: &start_rad,
            old_start_rad: Some(&old),
            set_rad: &set_rad,
            model_rad: &set_rad,
            late: Some(0),
        };
        doubt.look(&seen, 20)
    }

    #[test]
    fn axes_at_the_start_pose_are_a_new_run_at_once_only_if_nothing_was_given() {
        assert_eq!(look(&mut Doubt::default(), 0.001, 0.0, 0.0), Found::NewRun);
        let mut doubt = Doubt::default();
        for _ in 0..20 {
            assert_eq!(look(&mut doubt, 0.001, 1.5, 0.0), Found::Nothing, "the axes may pass there");
        }
        assert_eq!(look(&mut doubt, 0.001, 1.5, 0.0), Found::NewRun);
    }

    #[test]
    fn axes_of_a_robot_that_somebody_else_may_have_led_stand_at_the_start_for_the_lag() {
        let pose = PerJoint::splat(0.5);
        let (q_rad, start_rad, set_rad, model_rad) = (&pose, &pose, &pose, &pose);
        for (late, cycles) in [(Some(0), 1), (Some(1), 21), (None, 21)] {
            let seen = Sight { q_rad, start_rad, old_start_rad: None, set_rad, model_rad, late };
            let mut doubt = Doubt::default();
            let found = (1..).find(|_| doubt.look(&seen, 20) == Found::NewRun);
            assert_eq!(found, Some(cycles), "{late:?}");
        }
    }

    #[test]
    fn axes_where_the_corrections_lead_go_on_unless_the_start_pose_is_another() {
        let mut doubt = Doubt::default();
        assert_eq!(look(&mut doubt, 1.48, 1.5, 0.0), Found::Nothing, "not before a cycle without an answer");
        assert_eq!(look(&mut doubt, 1.48, 1.5, 0.0), Found::OldRun);
        assert_eq!(look(&mut doubt, 1.48, 1.5, 1.0), Found::Nothing);
        assert_eq!(look(&mut doubt, 0.7, 1.5, 0.0), Found::Nothing, "neither here nor there");
        assert_eq!(look(&mut doubt, f32::NAN, 1.5, 0.0), Found::Nothing);
    }

    #[test]
    fn axes_away_from_the_start_pose_of_a_robot_that_was_given_nothing_have_no_answer() {
        let mut doubt = Doubt::default();
        for _ in 0..100 {
            assert_eq!(look(&mut doubt, 0.5, 0.0, 0.0), Found::Nothing);
        }
    }
}
