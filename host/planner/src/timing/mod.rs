//! Position of an arm on its way over time: from a path in joint space to a motion within limits of speed, acceleration and
//! jerk.
//!
//! ```text
//! points ──► Path (lines, rounded corners) ──► fastest (x = ṡ² over s) ──► Law (bounded jerk) ──► knots of cubics
//! two poses ──► seven pieces of constant jerk ───────────────────────────────────────────────────────▲
//! points with times ──► cubic spline through them ───────────────────────────────────────────────────┘
//! ```
//!
//! | module | holds |
//! |---|---|
//! | `straight` | from rest to rest on a line, time-optimal in closed form |
//! | `path` | lines through points with rounded corners, parameterised by their length |
//! | `fastest` | time-optimal speed along a path under limits of speed and acceleration |
//! | `law` | the same with bounded jerk: a moving average of it, slowed where that exceeds a limit |
//! | `given` | points that have their times already |
//! | `thinned` | the same motion with fewer knots |
//!
//! Angles are in rad, lengths of paths in rad too (Euclidean norm over the joints). Each entry point gives a [`Motion`], whose
//! cubics are what a controller runs; limits are checked on these cubics.

mod fastest;
mod given;
mod law;
mod path;
mod straight;
mod thinned;

pub use given::{GivenError, Row, motion_of_rows};
pub use law::along;
pub use path::{Path, PathError};
pub use straight::{Straight, straight};
pub use thinned::thinned;

use crate::motion::{Knot, Motion};
use robot_model::{JOINTS_MAX, JointVec, RobotModel};

/// One number per joint; zero from the last joint on.
pub(crate) type Row8 = [f64; JOINTS_MAX];

/// Largest speed (rad/s), acceleration (rad/s²) and jerk (rad/s³) of each joint. An infinite jerk is allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    pub(crate) n: usize,
    pub(crate) v: Row8,
    pub(crate) a: Row8,
    pub(crate) j: Row8,
}

impl Limits {
    /// From slices of equal length, 1 to [`JOINTS_MAX`]; `None` for other lengths or for numbers that are not positive.
    #[must_use]
    pub fn new(v_rad_s: &[f64], a_rad_s2: &[f64], j_rad_s3: &[f64]) -> Option<Self> {
        let n = v_rad_s.len();
        let lengths = [a_rad_s2.len(), j_rad_s3.len()] == [n, n] && (1..=JOINTS_MAX).contains(&n);
        let positive =
            |of: &[f64], infinite: bool| of.iter().all(|x| *x > 0.0 && (infinite || x.is_finite()));
        if !lengths || !positive(v_rad_s, false) || !positive(a_rad_s2, false) || !positive(j_rad_s3, true) {
            return None;
        }
        Some(Self { n, v: padded(v_rad_s), a: padded(a_rad_s2), j: padded(j_rad_s3) })
    }

    /// A share of those of an arm, above 0 and at most 1. Accelerations are those that a plan may use, and no more than a controller may
    /// command: it refuses a plan above that.
    #[must_use]
    pub fn of_arm(arm: &RobotModel, share: f64) -> Option<Self> {
        let of = |f: fn(&robot_model::JointLimits) -> f64| arm.limit(f);
        let v = of(|l| l.v_max_rad_s) * share;
        let a = (of(|l| l.a_max_rad_s2) * share).inf(&of(|l| l.a_control_max_rad_s2));
        let j = of(|l| l.j_max_rad_s3) * share;
        Self::new(v.as_slice(), a.as_slice(), j.as_slice())
    }

    /// The share of its limits that a state uses: largest of speed, acceleration and jerk over all joints.
    pub(crate) fn use_of(&self, qd: &Row8, qdd: &Row8, jerk: &Row8) -> Use {
        let most = |x: &Row8, limit: &Row8| {
            x.iter().zip(limit).take(self.n).map(|(x, limit)| x.abs() / limit).fold(0.0, f64::max)
        };
        Use { speed: most(qd, &self.v), acceleration: most(qdd, &self.a), jerk: most(jerk, &self.j) }
    }
}

/// Shares of the limits.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Use {
    pub(crate) speed: f64,
    pub(crate) acceleration: f64,
    pub(crate) jerk: f64,
}

impl Use {
    /// By how much the time must be stretched so that no limit is exceeded; below 1: it may be compressed.
    pub(crate) fn stretch(self) -> f64 {
        self.speed.max(self.acceleration.sqrt()).max(self.jerk.cbrt())
    }

    pub(crate) fn most(self, other: Self) -> Self {
        Self {
            speed: self.speed.max(other.speed),
            acceleration: self.acceleration.max(other.acceleration),
            jerk: self.jerk.max(other.jerk),
        }
    }
}

pub(crate) fn padded(values: &[f64]) -> Row8 {
    let mut row = [0.0; JOINTS_MAX];
    for (to, from) in row.iter_mut().zip(values) {
        *to = *from;
    }
    row
}

/// A knot before it is one of a motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct At {
    pub(crate) t_s: f64,
    pub(crate) q: Row8,
    pub(crate) qd: Row8,
}

/// The largest use of limits by the cubics between knots.
pub(crate) fn use_of_cubics(knots: &[At], limits: &Limits) -> Use {
    let mut most = Use::default();
    for pair in knots.windows(2) {
        let h = pair[1].t_s - pair[0].t_s;
        let (mut v, mut a, mut j) = ([0.0; JOINTS_MAX], [0.0; JOINTS_MAX], [0.0; JOINTS_MAX]);
        for k in 0..limits.n {
            let way = pair[1].q[k] - pair[0].q[k];
            let (v0, v1) = (pair[0].qd[k], pair[1].qd[k]);
            let a0 = (6.0 * way / h - 4.0 * v0 - 2.0 * v1) / h;
            let a1 = (-6.0 * way / h + 2.0 * v0 + 4.0 * v1) / h;
            j[k] = (a1 - a0) / h;
            a[k] = a0.abs().max(a1.abs());
            v[k] = v0.abs().max(v1.abs());
            if a0 * a1 < 0.0 {
                v[k] = v[k].max((v0 - 0.5 * a0 * a0 / j[k]).abs());
            }
        }
        most = most.most(limits.use_of(&v, &a, &j));
    }
    most
}

/// Shortest time between two knots, s; a controller accepts no time below 2 ms.
const KNOT_MIN_S: f64 = 4e-3;

/// Factor on its limits that a motion may use in the numbers of a controller, which allows twice the excess.
const ROUNDED: f64 = 1.0005;
/// Rounding is another one after each stretching.
const STRETCHES_MAX: usize = 16;

/// Stretches the time of the knots so that the cubics between them keep the limits, also as a controller has them: in single precision
/// and whole microseconds. Two angles near 3 rad and 5 ms apart are rounded by half a per cent of the acceleration between them.
pub(crate) fn stretch_within(knots: &mut [At], limits: &Limits) {
    // Knots that use less than their limits stay as they are.
    stretch_by(knots, use_of_cubics(knots, limits).stretch());
    for _ in 0..STRETCHES_MAX {
        let sent: Vec<At> = knots.iter().map(as_sent).collect();
        // Controllers do not check the jerk.
        let used = Use { jerk: 0.0, ..use_of_cubics(&sent, limits) };
        if used.stretch() <= ROUNDED.sqrt() {
            break;
        }
        stretch_by(knots, used.stretch());
    }
}

fn stretch_by(knots: &mut [At], stretch: f64) {
    if stretch > 1.0 {
        let stretch = stretch * (1.0 + 1e-9);
        for knot in knots {
            knot.t_s *= stretch;
            knot.qd = knot.qd.map(|v| v / stretch);
        }
    }
}

fn as_sent(knot: &At) -> At {
    let single = |row: Row8| row.map(|x| f64::from(x as f32));
    At { t_s: (knot.t_s * 1e6).round() * 1e-6, q: single(knot.q), qd: single(knot.qd) }
}

pub(crate) fn motion_of(knots: &[At], n: usize) -> Motion {
    let row = |row: &Row8| JointVec::from_slice(&row[..n]);
    let knots = knots.iter().map(|at| Knot { t_s: at.t_s, q_rad: row(&at.q), qd_rad_s: row(&at.qd) });
    Motion { knots: knots.collect(), events: Vec::new() }
}
