//! Time-optimal speed along a path under limits of speed and acceleration: reachability analysis of `x = ṡ²` (Pham, Pham, "A new
//! approach to time-optimal path parameterization based on reachability analysis", 2018).
//!
//! On a grid of lengths the path acceleration `u = s̈` is constant between two nodes, so `x' = x + 2 Δ u`, and joint limits are linear in
//! `(u, x)`: `|q' u + q'' x| ≤ a`, at both ends of an interval. A pass backwards gives the largest x from which the end can still be
//! reached, a pass forwards takes the largest u.

use super::Limits;
use super::path::{Path, Point};

/// Intervals of a line, and of a corner.
const ON_LINE: usize = 48;
const IN_CORNER: usize = 16;
/// Direction of a joint below which its path acceleration does not count.
const STILL: f64 = 1e-12;

/// A part of a path between two rests, with derivatives at the nodes of its grid.
pub(super) struct Grid {
    n: usize,
    /// Lengths of the nodes from the beginning of the path.
    pub(super) s: Vec<f64>,
    /// Derivatives at both ends of each interval: second derivatives jump nowhere, but lines and corners are evaluated each on its own.
    ends: Vec<[Point; 2]>,
}

/// Shares of the limits that a node may use, for slowing parts of a path down.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shares {
    pub(super) speed: Vec<f64>,
    pub(super) acceleration: Vec<f64>,
}

impl Grid {
    /// Of the part of `path` from `s0` to `s1`, where it rests.
    pub(super) fn new(path: &Path, s0: f64, s1: f64) -> Self {
        let mut s = vec![s0];
        for piece in path.pieces().iter().filter(|piece| piece.s0 < s1 && piece.s1 > s0) {
            let count = if piece.is_line() { ON_LINE } else { IN_CORNER };
            for i in 1..=count {
                s.push(piece.s0 + (piece.s1 - piece.s0) * i as f64 / count as f64);
            }
        }
        let ends = s.windows(2).map(|pair| [path.at(pair[0], true), path.at(pair[1], false)]).collect();
        Self { n: path.joints(), s, ends }
    }

    pub(super) fn whole(&self) -> Shares {
        Shares { speed: vec![1.0; self.s.len()], acceleration: vec![1.0; self.s.len()] }
    }

    /// Largest x at each node, from rest to rest.
    pub(super) fn fastest(&self, limits: &Limits, shares: &Shares) -> Vec<f64> {
        let nodes = self.s.len();
        let mut most = vec![0.0; nodes];
        for i in (0..nodes - 1).rev() {
            let lines = self.lines(i, limits, shares);
            most[i] = lines.largest_x(most[i + 1]).min(self.speed_limit(i, limits, shares));
        }
        most[0] = 0.0;
        let mut x = vec![0.0; nodes];
        for i in 0..nodes - 1 {
            let step = 2.0 * (self.s[i + 1] - self.s[i]);
            let u = self.lines(i, limits, shares).largest_u(x[i]).min((most[i + 1] - x[i]) / step);
            x[i + 1] = (x[i] + step * u).clamp(0.0, most[i + 1]);
        }
        x[nodes - 1] = 0.0;
        x
    }

    /// Largest x at a node by the speeds of the joints, and by the jerks `q''' ṡ³` of an even speed.
    fn speed_limit(&self, node: usize, limits: &Limits, shares: &Shares) -> f64 {
        let point = &self.ends[node.min(self.ends.len() - 1)][usize::from(node == self.ends.len())];
        let slowest = (0..self.n)
            .flat_map(|k| {
                let (d1, d3) = (point.d1[k].abs(), point.d3[k].abs());
                [limits.v[k] / d1.max(STILL), (limits.j[k] / d3.max(STILL)).cbrt()]
            })
            .fold(f64::INFINITY, f64::min);
        (slowest * shares.speed[node]).powi(2)
    }

    fn lines(&self, interval: usize, limits: &Limits, shares: &Shares) -> Lines {
        let step = 2.0 * (self.s[interval + 1] - self.s[interval]);
        let mut lines = Lines { upper: Vec::new(), lower: Vec::new(), x_max: f64::INFINITY, step };
        let [begin, end] = &self.ends[interval];
        let share = shares.acceleration[interval].min(shares.acceleration[interval + 1]);
        for k in 0..self.n {
            let a = limits.a[k] * share;
            lines.add(begin.d1[k], begin.d2[k], a);
            lines.add(end.d1[k] + step * end.d2[k], end.d2[k], a);
        }
        lines
    }
}

/// Bounds of u that are linear in x: `u ≤ c + m x` above, `u ≥ c + m x` below.
struct Lines {
    upper: Vec<(f64, f64)>,
    lower: Vec<(f64, f64)>,
    x_max: f64,
    /// `x' = x + step u`.
    step: f64,
}

impl Lines {
    /// `|p u + r x| ≤ a`.
    fn add(&mut self, p: f64, r: f64, a: f64) {
        if p.abs() <= STILL {
            if r.abs() > STILL {
                self.x_max = self.x_max.min(a / r.abs());
            }
            return;
        }
        let (bound, slope) = (a / p.abs(), -r / p);
        self.upper.push((bound, slope));
        self.lower.push((-bound, slope));
    }

    /// Largest x with a u that leads to an x' from 0 to `next`.
    fn largest_x(&self, next: f64) -> f64 {
        let to_next = (next / self.step, -1.0 / self.step);
        let to_rest = (0.0, -1.0 / self.step);
        let mut x_max = self.x_max;
        for (c, m) in self.upper.iter().chain([&to_next]) {
            for (c_low, m_low) in self.lower.iter().chain([&to_rest]) {
                // At x = 0 each pair leaves room.
                let (room, change) = (c - c_low, m - m_low);
                if change < 0.0 {
                    x_max = x_max.min(room / -change);
                }
            }
        }
        x_max
    }

    /// Largest u at `x`.
    fn largest_u(&self, x: f64) -> f64 {
        self.upper.iter().map(|(c, m)| c + m * x).fold(f64::INFINITY, f64::min)
    }
}
