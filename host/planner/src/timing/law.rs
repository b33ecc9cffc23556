//! Place along a path over time, with bounded jerk.
//!
//! The time-optimal law has jumps of the acceleration. Its moving average over a window T has none: the average of s over T is as
//! smooth as s and one derivative more,
//!
//! ```text
//! s̄(t) = 1/T ∫ s,   s̄' = (s(t) - s(t-T)) / T,   s̄'' = (ṡ(t) - ṡ(t-T)) / T,   s̄''' = (s̈(t) - s̈(t-T)) / T
//! ```
//!
//! and takes T longer. On a line with a cruise of at least T it is the time-optimal law with bounded jerk. Elsewhere the limits of the
//! path law are lowered where the averaged motion exceeds one, until none is exceeded; what then is left is taken up by stretching
//! the time.

use super::fastest::{Grid, Shares};
use super::given::smooth;
use super::path::Path;
use robot_model::JOINTS_MAX;

use super::{At, KNOT_MIN_S, Limits, Row8, Use, motion_of, stretch_within};
use crate::motion::Motion;

/// Rounds of lowering limits, and those without a shorter motion after which there are no more.
const ROUNDS: usize = 24;
const VAIN_ROUNDS: usize = 3;
/// Windows that are tried, as shares of the longest time from no acceleration to the largest.
const WINDOWS: [f64; 4] = [1.0, 0.6, 0.35, 1.5];
/// Places at which a law is looked at.
const LOOKS: usize = 400;
/// Shortest times between two knots that are tried, s. Near ones follow the law closely; far ones lose less to single precision, which
/// rounds the acceleration of a short piece by a share of it.
const KNOTS_APART_S: [f64; 2] = [KNOT_MIN_S, 2.0 * KNOT_MIN_S];
/// Largest distance of the cubics from the law, rad, and of their accelerations from its, as a share of the limits.
const OFF_RAD: f64 = 2e-5;
const OFF_SHARE: f64 = 0.01;
/// A jump of the path acceleration by this share of the largest one is an end of a cubic.
const JUMP_SHARE: f64 = 0.02;
/// More knots than this, which a controller has room for with eight joints, are avoided by cubics that are farther from the law, at
/// most by this factor.
const KNOTS_WANTED: usize = 190;
const OFF_MOST: f64 = 8.0;
/// Share of the limits that counts as used up.
const FULL: f64 = 1.0 + 1e-6;

/// Fastest motion along `path`, at rest at its ends and at each corner that is not rounded, with speeds, accelerations and jerks of all
/// joints within `limits`; `None` for a path that is so long or so fine that its time is not a number.
///
/// Where a rest at each corner takes less time than the roundings, which is so for small ones, the corners are not rounded.
/// Near-optimal: on a line the duration is the optimum if there is a cruise, in corners it is above it by some per cent.
#[must_use]
pub fn along(path: &Path, limits: &Limits) -> Option<Motion> {
    let rounded = knots(path, limits)?;
    let duration_s = |knots: &[At]| knots.last().map_or(0.0, |at| at.t_s);
    let rests = path.resting().and_then(|path| knots(&path, limits));
    let best = match rests {
        Some(rests) if duration_s(&rests) < duration_s(&rounded) => rests,
        _ => rounded,
    };
    Some(motion_of(&best, limits.n))
}

/// Knots of all parts of a path, stretched in time so that the cubics between them keep the limits.
fn knots(path: &Path, limits: &Limits) -> Option<Vec<At>> {
    let mut knots: Vec<At> = Vec::new();
    let sections = path.rests().len() - 1;
    for ends in path.rests().windows(2) {
        let (begin, end) = (ends[0], ends[1]);
        let section = Section { path, limits, grid: Grid::new(path, begin.0, end.0) };
        let law = section.law()?;
        let made = KNOTS_APART_S.map(|apart_s| {
            let knots = |off| section.knots(&law, (begin.1, end.1), (apart_s, off));
            let mut off = 1.0;
            let mut made = knots(off);
            while made.len() * sections > KNOTS_WANTED && off < OFF_MOST {
                off *= 2.0;
                made = knots(off);
            }
            stretch_within(&mut made, limits);
            made
        });
        let duration_s = |knots: &Vec<At>| knots.last().map_or(0.0, |at| at.t_s);
        let made =
            made.into_iter().min_by(|a, b| duration_s(a).total_cmp(&duration_s(b))).unwrap_or_default();
        let begun_s = knots.last().map_or(0.0, |at| at.t_s);
        let skipped = usize::from(!knots.is_empty());
        knots.extend(made.into_iter().skip(skipped).map(|at| At { t_s: at.t_s + begun_s, ..at }));
    }
    Some(knots)
}

/// A part of a path between two rests.
struct Section<'a> {
    path: &'a Path,
    limits: &'a Limits,
    grid: Grid,
}

/// All joints at one time.
struct Moving {
    q: Row8,
    qd: Row8,
    qdd: Row8,
    jerk: Row8,
}

impl Section<'_> {
    /// The law with the shortest stretched duration of those that are tried.
    fn law(&self) -> Option<Law> {
        let to_most = |k: usize| self.limits.a[k] / self.limits.j[k];
        let longest = (0..self.limits.n).map(to_most).fold(0.0, f64::max);
        let windows: &[f64] = if longest > 0.0 { &WINDOWS } else { &[0.0] };
        let mut best: Option<Law> = None;
        for share in windows {
            let mut shares = self.grid.whole();
            let (mut shortest_s, mut vain) = (f64::INFINITY, 0);
            for _ in 0..ROUNDS {
                let mut law =
                    Law::new(&self.grid, &self.grid.fastest(self.limits, &shares), share * longest)?;
                let excess = self.lower(&law, &mut shares);
                law.stretch = excess.stretch().max(1.0);
                vain = if law.duration_s() < shortest_s { 0 } else { vain + 1 };
                shortest_s = shortest_s.min(law.duration_s());
                if best.as_ref().is_none_or(|best| law.duration_s() < best.duration_s()) {
                    best = Some(law);
                }
                if excess.stretch() <= FULL || vain == VAIN_ROUNDS {
                    break;
                }
            }
        }
        best
    }

    /// Lowers the limits where the motion exceeds them; the largest use of limits.
    fn lower(&self, law: &Law, shares: &mut Shares) -> Use {
        let mut most = Use::default();
        let mut factor = vec![(1.0_f64, 1.0_f64); self.grid.s.len()];
        for i in 0..=LOOKS {
            let t = law.unstretched_s() * i as f64 / LOOKS as f64;
            let at = self.moving(law, t, 1.0);
            let used = self.limits.use_of(&at.qd, &at.qdd, &at.jerk);
            most = most.most(used);
            if used.stretch() <= FULL {
                continue;
            }
            // All that the average is made of.
            let (from, to) = (law.raw(t - law.window_s).0, law.raw(t).0);
            let first = self.grid.s.partition_point(|s| *s < from).saturating_sub(1);
            let past = (self.grid.s.partition_point(|s| *s <= to) + 1).min(self.grid.s.len());
            let by_speed = 1.0 / used.speed.max(1.0);
            // A jump of the acceleration is half as high if the speed has a plateau there, so both are lowered.
            let by_acceleration = 1.0 / used.acceleration.max(used.jerk.sqrt()).max(1.0);
            let by_jerk = 1.0 / used.jerk.max(1.0).powf(0.25);
            for node in &mut factor[first..past] {
                node.0 = node.0.min(by_speed).min(by_jerk);
                node.1 = node.1.min(by_acceleration);
            }
        }
        for (i, (speed, acceleration)) in factor.into_iter().enumerate() {
            shares.speed[i] *= speed;
            shares.acceleration[i] *= acceleration;
        }
        most
    }

    /// The joints `t` seconds after the start of the unstretched law, in a time that is stretched.
    fn moving(&self, law: &Law, t: f64, stretch: f64) -> Moving {
        let [s, s1, s2, s3] = law.at(t);
        let (s1, s2, s3) = (s1 / stretch, s2 / stretch.powi(2), s3 / stretch.powi(3));
        let p = self.path.at(s, false);
        let of = |f: &dyn Fn(usize) -> f64| -> Row8 {
            let mut row = [0.0; JOINTS_MAX];
            row.iter_mut().enumerate().take(self.limits.n).for_each(|(k, x)| *x = f(k));
            row
        };
        Moving {
            q: p.q,
            qd: of(&|k| p.d1[k] * s1),
            qdd: of(&|k| p.d1[k] * s2 + p.d2[k] * s1 * s1),
            jerk: of(&|k| p.d1[k] * s3 + 3.0 * p.d2[k] * s1 * s2 + p.d3[k] * s1.powi(3)),
        }
    }

    /// Knots whose cubics follow the law, as few as that takes, at least `apart_s` from each other.
    fn knots(&self, law: &Law, (begin, finish): (Row8, Row8), (apart_s, off): (f64, f64)) -> Vec<At> {
        let (end, stretch) = (law.unstretched_s(), law.stretch);
        let at = |t: f64| {
            let moving = self.moving(law, t, stretch);
            At { t_s: t * stretch, q: moving.q, qd: moving.qd }
        };
        let mut knots = vec![at(0.0)];
        let least = apart_s / stretch;
        let (mut t, mut step) = (0.0, end);
        // Each cubic ends where the jerk jumps, at the latest.
        for until in law.breaks(least, off * JUMP_SHARE) {
            while t < until {
                let left = until - t;
                step = (2.0 * step).min(left);
                while step > least && !self.is_near(law, (t, t + step), off) {
                    step *= 0.5;
                }
                step = step.max(least);
                // No rest that is shorter than a step.
                t = if left - step < least { until } else { t + step };
                knots.push(at(t));
            }
        }
        let last = knots.len() - 1;
        for (knot, q) in [(0, begin), (last, finish)] {
            (knots[knot].q, knots[knot].qd) = (q, [0.0; JOINTS_MAX]);
        }
        if law.window_s > 0.0 {
            smooth(&mut knots, self.limits.n);
        }
        knots
    }

    /// Whether the cubic from `t0` to `t1` follows the law; `off` times as far from it as usual is near.
    fn is_near(&self, law: &Law, (t0, t1): (f64, f64), off: f64) -> bool {
        let (a, b) = (self.moving(law, t0, 1.0), self.moving(law, t1, 1.0));
        let h = t1 - t0;
        [0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0].into_iter().all(|x| {
            let at = self.moving(law, t0 + x * h, 1.0);
            (0..self.limits.n).all(|k| {
                let way = b.q[k] - a.q[k];
                let (p0, p1) = (a.qd[k] * h, b.qd[k] * h);
                let (c2, c3) = (3.0 * way - 2.0 * p0 - p1, p0 + p1 - 2.0 * way);
                let q = a.q[k] + x * (p0 + x * (c2 + x * c3));
                let qdd = (2.0 * c2 + 6.0 * c3 * x) / (h * h);
                (q - at.q[k]).abs() <= off * OFF_RAD
                    && (qdd - at.qdd[k]).abs() <= off * OFF_SHARE * self.limits.a[k]
            })
        })
    }
}

/// Length along the path over time.
struct Law {
    /// Times, lengths, speeds, accelerations and integrals of the length at the nodes.
    nodes: Vec<[f64; 5]>,
    window_s: f64,
    /// Times are longer by this.
    stretch: f64,
}

impl Law {
    fn new(grid: &Grid, x: &[f64], window_s: f64) -> Option<Self> {
        let mut nodes = Vec::with_capacity(x.len());
        let (mut t, mut integral) = (0.0, 0.0);
        for i in 0..x.len() {
            let (s, v) = (grid.s[i], x[i].sqrt());
            let Some(next) = x.get(i + 1) else {
                nodes.push([t, s, v, 0.0, integral]);
                break;
            };
            let way = grid.s[i + 1] - s;
            let u = (next - x[i]) / (2.0 * way);
            nodes.push([t, s, v, u, integral]);
            let h = 2.0 * way / (v + next.sqrt());
            t += h;
            integral += h * (s + h * (0.5 * v + h * u / 6.0));
        }
        t.is_finite().then_some(Self { nodes, window_s, stretch: 1.0 })
    }

    fn unstretched_s(&self) -> f64 {
        self.nodes.last().map_or(0.0, |node| node[0]) + self.window_s
    }

    fn duration_s(&self) -> f64 {
        self.unstretched_s() * self.stretch
    }

    /// Times at which the averaged law has jumps of its jerk, or without an average of its acceleration, above a share of the largest
    /// acceleration, at least `least` apart; and the end.
    fn breaks(&self, least: f64, jump_share: f64) -> Vec<f64> {
        let most = self.nodes.iter().map(|node| node[3].abs()).fold(0.0, f64::max);
        let (mut before, mut times) = (0.0, Vec::new());
        for node in &self.nodes {
            if (node[3] - before).abs() > jump_share * most {
                times.push(node[0]);
                times.push(node[0] + self.window_s);
            }
            before = node[3];
        }
        let end = self.unstretched_s();
        times.sort_by(f64::total_cmp);
        times.retain(|t| *t > least && *t < end - least);
        times.dedup_by(|late, early| *late - *early < least);
        times.push(end);
        times
    }

    /// Length, speed, acceleration and integral of the length of the law before it is averaged.
    fn raw(&self, t: f64) -> (f64, f64, f64, f64) {
        let (first, last) = (self.nodes[0], self.nodes[self.nodes.len() - 1]);
        if t < 0.0 {
            return (first[1], 0.0, 0.0, first[1] * t);
        }
        if t >= last[0] {
            return (last[1], 0.0, 0.0, last[4] + last[1] * (t - last[0]));
        }
        let [t0, s, v, u, integral] = self.nodes[self.nodes.partition_point(|node| node[0] <= t) - 1];
        let h = t - t0;
        (s + h * (v + 0.5 * h * u), v + h * u, u, integral + h * (s + h * (0.5 * v + h * u / 6.0)))
    }

    /// Length and its three derivatives by the unstretched time, averaged.
    fn at(&self, t: f64) -> [f64; 4] {
        let now = self.raw(t);
        if self.window_s == 0.0 {
            return [now.0, now.1, now.2, 0.0];
        }
        let (before, w) = (self.raw(t - self.window_s), self.window_s);
        [(now.3 - before.3) / w, (now.0 - before.0) / w, (now.1 - before.1) / w, (now.2 - before.2) / w]
    }
}
