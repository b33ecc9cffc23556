//! From rest to rest on a straight line in joint space: seven pieces of constant jerk, time-optimal in closed form.
//!
//! With the line `q(s) = from + (to - from) s`, `s` from 0 to 1, the limits of the joint that needs most time are those of `s`:
//! `v = min v_j / |d_j|`, likewise for acceleration and jerk. All joints start, cruise and stop together, so the motion stays on
//! the line. Where limits of different joints bind, a motion off the line can be shorter.

use robot_model::JOINTS_MAX;

use super::{At, KNOT_MIN_S, Limits, motion_of, padded, stretch_within};
use crate::motion::Motion;

/// Times of a rest-to-rest motion with bounded speed, acceleration and jerk.
///
/// ```text
///  a ^    ______
///    |   /      \            jerk ─ level ─ jerk   cruise   the same braking
///    |__/        \_________
///       tj       ta        \______/
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straight {
    /// Length of each piece with jerk, s.
    pub jerk_s: f64,
    /// From rest to the highest speed, s.
    pub accelerate_s: f64,
    /// At the highest speed, s.
    pub cruise_s: f64,
    /// Largest acceleration.
    acceleration: f64,
}

impl Straight {
    /// Fastest motion over `way`, at least 0, with largest speed `v`, acceleration `a` and jerk `j`, all above 0; `j` may be infinite.
    #[must_use]
    pub fn new(way: f64, v: f64, a: f64, j: f64) -> Self {
        let jerk_to_a = a / j;
        // Up to the highest speed.
        let (mut jerk_s, mut accelerate_s) = if v * j < a * a {
            ((v / j).sqrt(), 2.0 * (v / j).sqrt())
        } else {
            (jerk_to_a, jerk_to_a + v / a)
        };
        let cruise_s = way / v - accelerate_s;
        if cruise_s < 0.0 {
            // The highest speed is not reached: way = (level + jerk_s) (level + 2 jerk_s) a.
            let level = -1.5 * jerk_to_a + (0.25 * jerk_to_a * jerk_to_a + way / a).sqrt();
            if level >= 0.0 {
                (jerk_s, accelerate_s) = (jerk_to_a, level + 2.0 * jerk_to_a);
            } else {
                jerk_s = (0.5 * way / j).cbrt();
                accelerate_s = 2.0 * jerk_s;
            }
        }
        let acceleration = if jerk_s > 0.0 && jerk_s < jerk_to_a { j * jerk_s } else { a };
        Self { jerk_s, accelerate_s, cruise_s: cruise_s.max(0.0), acceleration }
    }

    /// Duration in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        2.0 * self.accelerate_s + self.cruise_s
    }

    /// Times in s, places and speeds at the ends of the pieces; pieces without length are left out.
    fn ends(&self) -> Vec<(f64, f64, f64)> {
        let level_s = self.accelerate_s - 2.0 * self.jerk_s;
        let a = self.acceleration;
        let j = if self.jerk_s > 0.0 { a / self.jerk_s } else { 0.0 };
        let pieces = [
            (self.jerk_s, 0.0, j),
            (level_s, a, 0.0),
            (self.jerk_s, a, -j),
            (self.cruise_s, 0.0, 0.0),
            (self.jerk_s, 0.0, -j),
            (level_s, -a, 0.0),
            (self.jerk_s, -a, j),
        ];
        let (mut t, mut s, mut v) = (0.0, 0.0, 0.0);
        let mut ends = vec![(t, s, v)];
        for (h, a0, jerk) in pieces {
            // A piece of rounding errors is left out.
            if h > 1e-9 {
                s += h * (v + h * (0.5 * a0 + h * jerk / 6.0));
                v += h * (a0 + 0.5 * h * jerk);
                t += h;
                ends.push((t, s, v));
            }
        }
        ends
    }
}

/// The knots without those that end a piece too short for a controller. What the longer pieces exceed is stretched.
fn without_short_pieces(knots: Vec<At>) -> Vec<At> {
    let (last, mut kept) = (knots.len() - 1, Vec::with_capacity(knots.len()));
    for (index, knot) in knots.into_iter().enumerate() {
        let is_short = |before: &At| knot.t_s - before.t_s < KNOT_MIN_S;
        if kept.last().is_some_and(is_short) {
            // Both ends stay.
            match index < last {
                true => continue,
                false if kept.len() > 1 => drop(kept.pop()),
                false => {}
            }
        }
        kept.push(knot);
    }
    kept
}

/// Motion on the straight line from `from` to `to` (rad), at rest at both ends; `None` where they are the same or a number is not
/// finite.
#[must_use]
pub fn straight(from: &[f64], to: &[f64], limits: &Limits) -> Option<Motion> {
    let (from, to) = (padded(from), padded(to));
    let mut way = [0.0; JOINTS_MAX];
    for k in 0..limits.n {
        way[k] = to[k] - from[k];
    }
    if !way.iter().all(|d| d.is_finite()) || way.iter().all(|d| *d == 0.0) {
        return None;
    }
    let least = |limit: &[f64; JOINTS_MAX]| {
        (0..limits.n)
            .filter(|k| way[*k] != 0.0)
            .map(|k| limit[k] / way[k].abs())
            .fold(f64::INFINITY, f64::min)
    };
    let profile = Straight::new(1.0, least(&limits.v), least(&limits.a), least(&limits.j));
    let ends = profile.ends();
    let last = ends.len() - 1;
    let knots = ends.into_iter().enumerate().map(|(i, (t_s, s, v))| {
        // The ends are exact.
        let (s, v) = if i == last { (1.0, 0.0) } else { (s, v) };
        let (mut q, mut qd) = ([0.0; JOINTS_MAX], [0.0; JOINTS_MAX]);
        for k in 0..limits.n {
            q[k] = if i == last { to[k] } else { from[k] + way[k] * s };
            qd[k] = way[k] * v;
        }
        At { t_s, q, qd }
    });
    let mut knots = without_short_pieces(knots.collect());
    stretch_within(&mut knots, limits);
    Some(motion_of(&knots, limits.n))
}
