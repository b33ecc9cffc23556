//! From set points to actual axes.
//!
//! Set points are averaged over some cycles (smoothing), delayed by the dead time, joined by straight lines and passed
//! through a first-order lag:
//!
//! ```text
//! T dy/dt = u(t) - y            on a piece u = a + b t:  y = a - b T + b t + c exp(-t / T)
//! ```
//!
//! Each piece is solved exactly, so the times of the calls do not matter. On a ramp the actual axes lag the set
//! points by the dead time plus T.

use std::collections::VecDeque;

use protocol::{Duration, Instant};

use super::options::LagOptions;

/// Position and velocity of all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisState {
    /// Positions, degrees.
    pub q_deg: [f64; 6],
    /// Velocities, degrees per second.
    pub qd_deg_s: [f64; 6],
}

/// The drives of six axes.
#[derive(Clone, Debug)]
pub struct Drives {
    options: LagOptions,
    /// Last set points, newest last, for the smoothing.
    recent: VecDeque<[f64; 6]>,
    /// Corners of the delayed input, ascending in time; the first is at or before `at`.
    corners: VecDeque<(Instant, [f64; 6])>,
    at: Instant,
    q_deg: [f64; 6],
}

impl Drives {
    /// At rest at `q_deg`.
    pub fn new(options: LagOptions, now: Instant, q_deg: [f64; 6]) -> Self {
        let recent = VecDeque::from(vec![q_deg; options.smoothing_cycles.max(1)]);
        Self { options, recent, corners: VecDeque::from([(now, q_deg)]), at: now, q_deg }
    }

    /// Takes the set point of the cycle that begins at `at`; up to `cycle` before it the last set point was in force.
    pub fn set_point(&mut self, at: Instant, cycle: Duration, q_deg: &[f64; 6]) {
        self.recent.pop_front();
        self.recent.push_back(*q_deg);
        let mut mean = [0.0; 6];
        for (axis, value) in mean.iter_mut().enumerate() {
            *value = self.recent.iter().map(|q| q[axis]).sum::<f64>() / self.recent.len() as f64;
        }
        let reached = at + self.options.dead_time;
        let from = reached.saturating_sub(cycle);
        // After a rest the line begins one cycle before its end, not at the end of the last motion.
        if let Some((last_at, last)) = self.corners.back().copied()
            && last_at < from
        {
            self.corners.push_back((from, last));
        }
        self.corners.push_back((reached, mean));
    }

    /// Moves the axes on to `to`.
    pub fn advance(&mut self, to: Instant) {
        if to <= self.at {
            return;
        }
        self.q_deg = self.state_at(to).q_deg;
        self.at = to;
        while self.corners.get(1).is_some_and(|(at, _)| *at <= to) {
            self.corners.pop_front();
        }
    }

    /// The axes at `at`, not before the last [`Drives::advance`]; later set points may still change the future.
    pub fn state_at(&self, at: Instant) -> AxisState {
        let mut now = self.at;
        let mut q = self.q_deg;
        let mut piece = 0;
        loop {
            let (input, slope, ends) = self.piece(piece, now);
            let until = ends.map_or(at, |end| end.min(at)).max(now);
            let state = self.solve(&q, &input, &slope, until.saturating_since(now).as_secs_f64());
            if until >= at {
                return state;
            }
            (q, now) = (state.q_deg, until);
            piece += 1;
        }
    }

    /// Input at `now` and slope on the line that starts at corner `index`, and where that line ends.
    fn piece(&self, index: usize, now: Instant) -> ([f64; 6], [f64; 6], Option<Instant>) {
        let still = |q| (q, [0.0; 6], None);
        let Some((from_at, from)) = self.corners.get(index) else {
            return still(self.corners.back().map_or(self.q_deg, |(_, q)| *q));
        };
        let Some((to_at, to)) = self.corners.get(index + 1) else { return still(*from) };
        let length_s = to_at.saturating_since(*from_at).as_secs_f64();
        let since_s = now.saturating_since(*from_at).as_secs_f64();
        let (mut input, mut slope) = (*to, [0.0; 6]);
        if length_s > 0.0 {
            for axis in 0..6 {
                slope[axis] = (to[axis] - from[axis]) / length_s;
                input[axis] = from[axis] + slope[axis] * since_s;
            }
        }
        (input, slope, Some(*to_at))
    }

    /// `t_s` after the state `q`, while the input runs from `input` with `slope`.
    fn solve(&self, q: &[f64; 6], input: &[f64; 6], slope: &[f64; 6], t_s: f64) -> AxisState {
        let lag_s = self.options.time_constant.as_secs_f64();
        let mut state = AxisState { q_deg: [0.0; 6], qd_deg_s: *slope };
        // Of libm: the same bits on every host.
        let decay = if lag_s > 0.0 { libm::exp(-t_s / lag_s) } else { 0.0 };
        for axis in 0..6 {
            let particular = input[axis] - slope[axis] * lag_s;
            let transient = (q[axis] - particular) * decay;
            state.q_deg[axis] = particular + slope[axis] * t_s + transient;
            if lag_s > 0.0 {
                state.qd_deg_s[axis] = slope[axis] - transient / lag_s;
            }
        }
        state
    }

    /// From the last set point to rest within a millionth of the way.
    pub fn settling_time(&self) -> Duration {
        self.options.dead_time + self.options.time_constant * 14
    }
}
