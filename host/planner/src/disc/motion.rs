//! The motion of a catch: to the disc, with it, to rest, each joint by the [`MotionLaw`].

use robot_model::JointVec;

use super::Joints;
use crate::motion::{GripperEvent, Knot, Motion};
use crate::motion_law::{Limits, MotionLaw, Pieces, State};

/// Motion of all four joints.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscMotion {
    /// One per joint; all begin at `from_s`.
    joints: [Pieces; 4],
    /// When the arm first moves, s.
    pub from_s: f64,
    /// Interval in which the arm stands and waits before the run-up, s; empty if it does not wait.
    pub waits_s: (f64, f64),
}

/// Least time between two knots of a trajectory, s: the controller's, with a margin for its rounding to microseconds.
const KNOTS_APART_S: f64 = 2.1e-3;

impl DiscMotion {
    /// The motion as knots and cubics, with a gripper that opens at `open_s` and begins to close at `close_s`. It
    /// stands for `stand_s` before: everything in it is later by this time.
    ///
    /// A piece of constant jerk stays unchanged, unless pieces of two joints end within 2 ms of each other.
    /// There a cubic covers the step, with up to 1.5 times the acceleration.
    #[must_use]
    pub fn as_motion(&self, stand_s: f64, open_s: f64, close_s: f64) -> Motion {
        let ends = |pieces: &Pieces| {
            let mut end_s = self.from_s;
            let ends = pieces.iter().map(move |(h_s, ..)| {
                end_s += h_s;
                end_s
            });
            ends.collect::<Vec<_>>()
        };
        let mut ends: Vec<f64> = self.joints.iter().flat_map(ends).collect();
        ends.sort_by(f64::total_cmp);
        let mut times = vec![self.from_s];
        for end_s in ends {
            if end_s - times[times.len() - 1] >= KNOTS_APART_S {
                times.push(end_s);
            }
        }
        // The last end may have been too near to the knot before.
        let stop_s = self.end_s();
        match times.last_mut() {
            Some(last) if *last > self.from_s && stop_s - *last < KNOTS_APART_S => *last = stop_s,
            _ => times.push(stop_s),
        }
        let state = |t_s: f64| {
            let at: [State; 4] = std::array::from_fn(|j| self.at(j, t_s));
            (JointVec::from(at.map(|at| at.q)), JointVec::from(at.map(|at| at.v)))
        };
        let begin = Knot { t_s: 0.0, q_rad: state(self.from_s).0, qd_rad_s: JointVec::zeros(4) };
        let moving = times.into_iter().map(|t_s| {
            let (q_rad, qd_rad_s) = state(t_s);
            Knot { t_s: t_s - self.from_s + stand_s, q_rad, qd_rad_s }
        });
        let later = stand_s - self.from_s;
        Motion {
            knots: std::iter::once(begin).chain(moving).collect(),
            events: vec![(open_s + later, GripperEvent::Open), (close_s + later, GripperEvent::Close)],
        }
    }

    /// Joint angles at a time, rad.
    #[must_use]
    pub fn q(&self, t_s: f64) -> Joints {
        Joints::from_fn(|j, _| self.at(j, t_s).q)
    }

    /// State of a joint at a time; it stands before the motion and after it.
    #[must_use]
    pub fn at(&self, joint: usize, t_s: f64) -> State {
        let pieces = &self.joints[joint];
        if t_s < self.from_s { State::rest(pieces.at(0.0).q) } else { pieces.at(t_s - self.from_s) }
    }

    /// When the arm stands again, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.from_s + self.joints.iter().map(Pieces::duration_s).fold(0.0, f64::max)
    }

    /// Where the arm stands at the end.
    #[must_use]
    pub fn q_end(&self) -> Joints {
        Joints::from_fn(|j, _| self.joints[j].end().q)
    }
}

/// A catch in joint space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// When the hand meets the disc, s.
    pub t_s: f64,
    /// Angles there, rad.
    pub q: Joints,
    /// Speeds there, kept over the dwell, rad/s.
    pub v: Joints,
    /// Half of the dwell, s: speeds are constant from `t_s` minus this to `t_s` plus this.
    pub half_dwell_s: f64,
    /// Time before the dwell in which the speeds are constant, too, s.
    pub lead_s: f64,
}

/// How the arm gets to the catch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Approach {
    /// To a waiting pose as soon as possible, wait, run up in this time.
    Staged {
        /// Time of the run-up, s.
        run_up_s: f64,
    },
    /// Straight from where it is.
    Direct,
}

/// Why a motion is not possible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Impossible {
    /// The joints need this much more time, s.
    Late(f64),
    /// A joint would pass the end of its range, rad beyond it.
    Range(f64),
    /// A speed, acceleration or jerk limit; how many times the limit.
    Limit(f64),
}

/// Plans approach, dwell and stop within the limits.
///
/// # Errors
/// [`Impossible`].
pub fn plan(
    law: &MotionLaw,
    limits: &[Limits; 4],
    now_s: f64,
    now: &[State; 4],
    reach: &Reach,
    approach: Approach,
) -> Result<DiscMotion, Impossible> {
    let before_s = reach.half_dwell_s + reach.lead_s;
    let has_s = reach.t_s - before_s - now_s;
    let dwell_from = reach.q - reach.v * before_s;
    let over: f64 = (0..4).map(|j| reach.v[j].abs() / limits[j].v_rad_s).fold(0.0, f64::max);
    if over > 1.0 {
        return Err(Impossible::Limit(over));
    }
    let mut joints = now.map(Pieces::starting);
    let mut waits_s = (reach.t_s - before_s, reach.t_s - before_s);
    match approach {
        Approach::Staged { run_up_s } => {
            // From rest to the speed of the dwell; the mean speed is half of it.
            let wait_at = dwell_from - reach.v * (0.5 * run_up_s);
            let ways = (0..4).map(|j| law.rest_to_rest_s(&limits[j], wait_at[j] - now[j].q));
            let (needs_s, has_s) = (ways.fold(0.0, f64::max), has_s - run_up_s);
            if needs_s > has_s || has_s <= 0.0 || now.iter().any(|at| at.v.abs() > 1e-9) {
                return Err(Impossible::Late((needs_s - has_s).max(0.0)));
            }
            // Not at full speed if there is time: half as long again, if it still waits then.
            let takes_s = (1.5 * needs_s).min(has_s);
            for (j, pieces) in joints.iter_mut().enumerate() {
                go(law, &limits[j], pieces, State::rest(wait_at[j]), takes_s)?;
                pieces.coast(has_s - takes_s);
                go(law, &limits[j], pieces, State { q: dwell_from[j], v: reach.v[j], a: 0.0 }, run_up_s)?;
            }
            waits_s = (now_s + takes_s, now_s + has_s);
        }
        Approach::Direct if has_s <= 0.0 => return Err(Impossible::Late(-has_s)),
        Approach::Direct => {
            for (j, pieces) in joints.iter_mut().enumerate() {
                go(law, &limits[j], pieces, State { q: dwell_from[j], v: reach.v[j], a: 0.0 }, has_s)?;
            }
        }
    }
    let mut beyond = f64::NEG_INFINITY;
    for (pieces, limits) in joints.iter_mut().zip(limits) {
        pieces.coast(before_s + reach.half_dwell_s);
        law.append_stop(limits, pieces);
        let (low, high) = pieces.extremes();
        beyond = beyond.max(limits.q_rad.0 - low).max(high - limits.q_rad.1);
    }
    let motion = DiscMotion { joints, from_s: now_s, waits_s };
    if beyond > 0.0 { Err(Impossible::Range(beyond)) } else { Ok(motion) }
}

/// Appends the way to a state without acceleration in a time.
fn go(
    law: &MotionLaw,
    limits: &Limits,
    pieces: &mut Pieces,
    to: State,
    time_s: f64,
) -> Result<(), Impossible> {
    let from = pieces.end();
    let Some(fit) = law.fit(limits, &from, to.q, to.v, time_s) else {
        return Err(Impossible::Limit(law.needed(limits, &from, to.q, to.v, time_s)));
    };
    law.append(&fit, time_s, pieces);
    Ok(())
}
