//! The whole motion in steps of the controller: ramps, window, ramps, and what is commanded for it.

use super::limits::{AXES, Axes, Limits};
use super::posture::Posture;
use super::ramp::{AxisState, Ramp, RampShape};

/// How the axes start and stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RampPlan {
    /// Blend and fade.
    pub shape: RampShape,
    /// 0: every axis takes its own shortest time; 1: all take the time of the slowest (synchronised); values between
    /// interpolate.
    pub together: f64,
}

/// The ramps of all axes on one side of the window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramps {
    axes: [Ramp; AXES],
    /// +1 after the window, -1 before.
    direction: f64,
}

impl Ramps {
    /// From rest to the first posture of the window.
    #[must_use]
    pub fn start(edge: &Posture, plan: RampPlan, limits: &Limits) -> Self {
        Self::new(edge, plan, limits, -1.0)
    }

    /// From the last posture of the window to rest.
    #[must_use]
    pub fn stop(edge: &Posture, plan: RampPlan, limits: &Limits) -> Self {
        Self::new(edge, plan, limits, 1.0)
    }

    fn new(edge: &Posture, plan: RampPlan, limits: &Limits, direction: f64) -> Self {
        let edges: [AxisState; AXES] =
            std::array::from_fn(|i| AxisState { q: edge.q[i], w: direction * edge.qd[i], a: edge.qdd[i] });
        let own: [f64; AXES] =
            std::array::from_fn(|i| Ramp::shortest_cruise_s(edges[i], plan.shape, limits.ramp_rad_s2[i]));
        let longest = own.iter().copied().fold(0.0, f64::max);
        let axes = std::array::from_fn(|i| {
            Ramp::new(edges[i], plan.shape, own[i] + plan.together.clamp(0.0, 1.0) * (longest - own[i]))
        });
        Self { axes, direction }
    }

    /// Joints `s` seconds away from the window.
    #[must_use]
    pub fn at(&self, s: f64) -> Posture {
        let states = self.axes.map(|r| r.at(s));
        Posture {
            q: Axes::from_fn(AXES, |i| states[i].q),
            qd: Axes::from_fn(AXES, |i| states[i].w * self.direction),
            qdd: Axes::from_fn(AXES, |i| states[i].a),
        }
    }

    /// Joint angles at rest.
    #[must_use]
    pub fn rest(&self) -> Axes {
        Axes::from_fn(AXES, |i| self.axes[i].rest_q())
    }

    /// Time until all axes rest, in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.axes.iter().map(Ramp::duration_s).fold(0.0, f64::max)
    }
}

/// Joints at every step of the controller.
#[derive(Debug, Clone, PartialEq)]
pub struct FollowMotion {
    /// Time between two steps in s.
    pub period_s: f64,
    /// Joints, one entry per step; at rest in the first and the last.
    pub states: Vec<Posture>,
    /// First step on the parabola.
    pub first: usize,
    /// Last step on the parabola.
    pub last: usize,
}

impl FollowMotion {
    /// Ramps around a window of one posture per period; the window must not be empty.
    #[must_use]
    pub fn around(window: &[Posture], start: &Ramps, stop: &Ramps, period_s: f64) -> Self {
        let steps = |ramps: &Ramps| ((ramps.duration_s() / period_s - 1e-9).ceil().max(0.0)) as usize + 1;
        let (before, after) = (steps(start), steps(stop));
        let mut states = Vec::with_capacity(before + window.len() + after);
        states.extend((1..=before).rev().map(|k| start.at(k as f64 * period_s)));
        states.extend_from_slice(window);
        states.extend((1..=after).map(|k| stop.at(k as f64 * period_s)));
        Self { period_s, states, first: before, last: before + window.len().max(1) - 1 }
    }

    /// Time of a step in s; zero at the first step on the parabola.
    #[must_use]
    pub fn time_s(&self, step: usize) -> f64 {
        (step as f64 - self.first as f64) * self.period_s
    }

    /// What is commanded so that a first-order lag of `lag_s` executes the motion: `q + lag q̇`.
    #[must_use]
    pub fn commands(&self, lag_s: f64) -> Vec<Axes> {
        self.states.iter().map(|s| s.q + s.qd * lag_s).collect()
    }
}

/// Largest finite differences of commanded set points; one value per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peaks {
    /// Speed in rad/s.
    pub v: Axes,
    /// Acceleration in rad/s².
    pub a: Axes,
    /// Jerk in rad/s³.
    pub j: Axes,
}

impl Peaks {
    /// Of set points that rest before the first and after the last.
    #[must_use]
    pub fn of(commands: &[Axes], period_s: f64) -> Self {
        let mut peaks = Self { v: Axes::zeros(AXES), a: Axes::zeros(AXES), j: Axes::zeros(AXES) };
        for k in -2..=commands.len() as isize {
            let [v, a, j] = differences(commands, k, period_s);
            peaks.v = peaks.v.sup(&v.abs());
            peaks.a = peaks.a.sup(&a.abs());
            peaks.j = peaks.j.sup(&j.abs());
        }
        peaks
    }

    /// Largest use of the limits of speed, acceleration and jerk; 1 is the limit.
    #[must_use]
    pub fn use_of(&self, limits: &Limits) -> [f64; 3] {
        [
            self.v.component_div(&limits.v_max_rad_s).amax(),
            self.a.component_div(&limits.a_max_rad_s2).amax(),
            self.j.component_div(&limits.j_max_rad_s3).amax(),
        ]
    }
}

/// Speed, acceleration and jerk of set points by differences of the steps `k - 1` to `k + 2`.
#[must_use]
pub fn differences(commands: &[Axes], k: isize, period_s: f64) -> [Axes; 3] {
    let end = commands.len() as isize - 1;
    let at = |k: isize| commands[k.clamp(0, end) as usize];
    let [before, here, next, after] = [at(k - 1), at(k), at(k + 1), at(k + 2)];
    let v = (next - here) / period_s;
    let a = (next - here * 2.0 + before) / period_s.powi(2);
    let j = (after - next * 3.0 + here * 3.0 - before) / period_s.powi(3);
    [v, a, j]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits {
            q_min_rad: Axes::repeat(AXES, -9.0),
            q_max_rad: Axes::repeat(AXES, 9.0),
            v_max_rad_s: Axes::repeat(AXES, 3.0),
            ramp_rad_s2: Axes::repeat(AXES, 2.0),
            a_max_rad_s2: Axes::repeat(AXES, 30.0),
            j_max_rad_s3: Axes::repeat(AXES, 2000.0),
        }
    }

    fn edge() -> Posture {
        Posture {
            q: Axes::from([0.0, 1.0, -1.0, 0.5, 2.0, 0.0]),
            qd: Axes::from([2.0, -1.0, 0.5, 0.0, -3.0, 1.0]),
            qdd: Axes::zeros(AXES),
        }
    }

    #[test]
    fn synchronised_ramps_start_together_and_own_ramps_take_their_own_time() {
        let sharp = RampShape { blend_s: 0.0, fade_s: 0.0 };
        let together = Ramps::start(&edge(), RampPlan { shape: sharp, together: 1.0 }, &limits());
        let own = Ramps::start(&edge(), RampPlan { shape: sharp, together: 0.0 }, &limits());
        // The fifth axis is the slowest to get its 3 rad/s: 1.5 s with 2 rad/s².
        assert!((together.duration_s() - 1.5).abs() < 1e-12 && (own.duration_s() - 1.5).abs() < 1e-12);
        for i in 0..AXES {
            // Average speed is half of the last one.
            let rest = edge().q[i] - 0.75 * edge().qd[i];
            assert!((together.rest()[i] - rest).abs() < 1e-12, "axis {i}");
            let rest = edge().q[i] - 0.25 * edge().qd[i] * edge().qd[i].abs();
            assert!((own.rest()[i] - rest).abs() < 1e-12, "axis {i}");
        }
        assert!((together.at(0.75).qd - edge().qd * 0.5).amax() < 1e-12);
        assert!((own.at(0.5).qd[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_motion_starts_and_ends_at_rest_and_its_differences_are_its_rates() {
        let shape = RampShape { blend_s: 0.03, fade_s: 0.05 };
        let plan = RampPlan { shape, together: 0.4 };
        let (start, stop) = (Ramps::start(&edge(), plan, &limits()), Ramps::stop(&edge(), plan, &limits()));
        let motion = FollowMotion::around(&[edge()], &start, &stop, 0.012);
        assert_eq!(motion.first, motion.last);
        assert_eq!(motion.states[motion.first], edge());
        for end in [motion.states.first(), motion.states.last()] {
            assert_eq!(end.expect("not empty").qd.amax(), 0.0);
        }
        let commands = motion.commands(0.0);
        for k in 1..commands.len() - 2 {
            let [v, a, _] = differences(&commands, k as isize, 0.012);
            let mean = (motion.states[k].qd + motion.states[k + 1].qd) * 0.5;
            assert!((v - mean).amax() < 2e-3, "step {k}: {v:?}");
            assert!((a - motion.states[k].qdd).amax() < 0.5, "step {k}: {a:?} {:?}", motion.states[k].qdd);
        }
        let peaks = Peaks::of(&commands, 0.012);
        assert!(peaks.v[4] <= 3.0 && peaks.v[4] > 2.98, "{}", peaks.v);
    }

    #[test]
    fn the_command_leads_by_the_lag_times_the_speed() {
        let plan = RampPlan { shape: RampShape { blend_s: 0.0, fade_s: 0.0 }, together: 1.0 };
        let (start, stop) = (Ramps::start(&edge(), plan, &limits()), Ramps::stop(&edge(), plan, &limits()));
        let motion = FollowMotion::around(&[edge()], &start, &stop, 0.012);
        let ahead = motion.commands(0.024)[motion.first] - edge().q;
        assert!((ahead - edge().qd * 0.024).amax() < 1e-15);
    }
}
