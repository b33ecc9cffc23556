//! A motion of all joints: knots, the cubic of each joint between two of them, and events at times.
//!
//! A cubic is given by position and speed at its two ends, so position and speed are continuous by construction.
//! Trial, simulation, analysis and report read a plan through this type. [`robot_model::cubic`] evaluates the
//! cubics and lists the other evaluators, with the reasons for them.

use robot_model::JointVec;
use robot_model::cubic::Cubic;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::throw::Throw;

/// State of the joints at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Knot {
    /// Time since the start, s.
    pub t_s: f64,
    /// Angles, rad.
    pub q_rad: JointVec,
    /// Speeds, rad/s.
    pub qd_rad_s: JointVec,
}

/// What happens to the gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperEvent {
    /// What it holds is free.
    Open,
    /// It begins to close.
    Close,
}

/// A motion of all joints.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Motion {
    /// At least two, times ascending from 0; empty if nothing moves.
    pub knots: Vec<Knot>,
    /// Events with their times, s since the start.
    pub events: Vec<(f64, GripperEvent)>,
}

/// Position, speed, acceleration and jerk of all joints at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// rad.
    pub q: JointVec,
    /// rad/s.
    pub qd: JointVec,
    /// rad/s².
    pub qdd: JointVec,
    /// rad/s³.
    pub jerk: JointVec,
}

impl Sample {
    fn standing(q: JointVec) -> Self {
        let zero = JointVec::zeros(q.len());
        Self { q, qd: zero, qdd: zero, jerk: zero }
    }
}

impl Motion {
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.t_s)
    }

    /// Pose at the start, rad.
    #[must_use]
    pub fn start_rad(&self) -> JointVec {
        self.knots.first().map_or_else(|| JointVec::zeros(0), |knot| knot.q_rad)
    }

    /// Pose at the end, rad.
    #[must_use]
    pub fn stop_rad(&self) -> JointVec {
        self.knots.last().map_or_else(|| JointVec::zeros(0), |knot| knot.q_rad)
    }

    /// When the ball in the gripper is free for the first time, s.
    #[must_use]
    pub fn release_s(&self) -> Option<f64> {
        self.events.iter().find(|(_, event)| *event == GripperEvent::Open).map(|(t_s, _)| *t_s)
    }

    /// An arm that stands.
    #[must_use]
    pub fn at_rest(q_rad: JointVec) -> Self {
        let knot = Knot { t_s: 0.0, q_rad, qd_rad_s: JointVec::zeros(q_rad.len()) };
        Self { knots: vec![knot], events: Vec::new() }
    }

    /// Goes on with another motion, which begins where this one ends.
    pub fn then(&mut self, next: Option<Self>) {
        let (begin_s, next) = (self.duration_s(), next.unwrap_or_default());
        self.knots
            .extend(next.knots.into_iter().skip(1).map(|knot| Knot { t_s: begin_s + knot.t_s, ..knot }));
        self.events.extend(next.events.into_iter().map(|(t_s, event)| (begin_s + t_s, event)));
    }

    /// The motion at `t_s`; at a knot by the cubic that ends there. It stands at its ends before and after.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Sample {
        if t_s < 0.0 {
            return Sample::standing(self.start_rad());
        }
        let end = self.knots.partition_point(|knot| knot.t_s < t_s).max(1);
        match self.knots.get(end - 1..=end) {
            Some([a, b]) => between(a, b, t_s),
            _ => Sample::standing(self.stop_rad()),
        }
    }

    /// Accelerations of the cubics at both of their ends, rad/s², with the times: where each is largest.
    pub fn accelerations(&self) -> impl Iterator<Item = ((f64, JointVec), (f64, JointVec))> + '_ {
        self.knots.windows(2).map(|pair| {
            let at = |t_s: f64| (t_s, between(&pair[0], &pair[1], t_s).qdd);
            (at(pair[0].t_s), at(pair[1].t_s))
        })
    }
}

/// The cubic from `a` to `b` at `t_s`.
fn between(a: &Knot, b: &Knot, t_s: f64) -> Sample {
    let cubic = Cubic::between(b.t_s - a.t_s, (a.q_rad, a.qd_rad_s), (b.q_rad, b.qd_rad_s));
    let t_s = t_s - a.t_s;
    Sample {
        q: cubic.position(t_s),
        qd: cubic.velocity(t_s),
        qdd: cubic.acceleration(t_s),
        jerk: cubic.jerk(),
    }
}

impl From<&Throw> for Motion {
    /// Start, release and end of a throw.
    fn from(throw: &Throw) -> Self {
        let knot = |t_s, sigma| {
            let state = throw.at_phase(sigma);
            Knot { t_s, q_rad: state.q, qd_rad_s: state.qd }
        };
        Self {
            knots: vec![knot(0.0, -1.0), knot(throw.ha_s, 0.0), knot(throw.duration_s(), 1.0)],
            events: vec![(throw.ha_s, GripperEvent::Open)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::throw::Joints;

    fn throw() -> Throw {
        Throw {
            q_rad: Joints::repeat(6, 0.3),
            qd_rad_s: Joints::repeat(6, 1.5),
            qdd_rad_s2: Joints::repeat(6, -2.0),
            flight_s: 0.5,
            ha_s: 0.56,
            hb_s: 0.36,
        }
    }

    #[test]
    fn knots_of_a_throw_give_its_states_everywhere() {
        let (throw, motion) = (throw(), Motion::from(&throw()));
        for k in 0..=920 {
            let t_s = 1e-3 * f64::from(k);
            let (got, wanted) = (motion.at(t_s), throw.at_time(t_s));
            assert!((got.q - wanted.q).amax() < 1e-14 && (got.qd - wanted.qd).amax() < 1e-13, "{t_s}");
            if k > 0 && k < 920 {
                assert!((got.qdd - wanted.qdd).amax() < 1e-11, "{t_s}");
            }
        }
        assert_eq!(motion.release_s(), Some(0.56));
    }

    #[test]
    fn jerk_is_the_slope_of_the_acceleration_and_the_ends_hold() {
        let motion = Motion::from(&throw());
        for (t_s, dt_s) in [(0.2, 1e-3), (0.7, 1e-3)] {
            let slope = (motion.at(t_s + dt_s).qdd - motion.at(t_s - dt_s).qdd) / (2.0 * dt_s);
            assert!((slope - motion.at(t_s).jerk).amax() < 1e-9);
        }
        assert_eq!(motion.at(-1.0), Sample::standing(motion.start_rad()));
        assert_eq!(motion.at(7.0), Sample::standing(motion.stop_rad()));
    }

    #[test]
    fn the_acceleration_is_continuous_at_the_release() {
        let motion = Motion::from(&throw());
        let ends: Vec<_> = motion.accelerations().collect();
        let ((_, before), (after, _)) = (ends[0], ends[1]);
        assert!((before.1 - after.1).amax() < 1e-11 && before.0 == after.0);
    }
}
