//! Where the axes should be: the set points behind dead time and first-order lag, and what the measurement says about it.
//!
//! ```text
//! T dy/dt = u(t - dead) - y         u: set points joined by straight lines, one per cycle
//! ```

use protocol::{Duration, JointIndex};

use super::packet::Options;
use crate::joints::PerJoint;
use crate::span;

/// Set points kept; the dead time is at most one cycle less.
pub(super) const KEPT_CYCLES: usize = 64;
/// Set points nearer than this are one, rad.
const SAME_RAD: f32 = 1e-6;
/// Time constants after which the lag has ended, within a thousandth.
const SETTLED: f32 = 7.0;
/// Weight of one telegram on the delay of the path.
const WEIGHT: f32 = 0.3;
/// Sum of squared speeds from which on the delay of the path can be measured, rad²/s².
const FAST_RAD2_S2: f32 = 0.05;

/// Model of the drives.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriveModel {
    /// Set points by cycle; `next` is the place of the next one.
    sent_rad: [PerJoint<f32>; KEPT_CYCLES],
    next: usize,
    q_rad: PerJoint<f32>,
    qd_rad_s: PerJoint<f32>,
    /// Cycles since a set point last changed.
    still_cycles: u32,
    residual_rad: f32,
    /// Axis with the largest residual.
    worst: Option<JointIndex>,
    delay_s: f32,
}

impl Default for DriveModel {
    fn default() -> Self {
        Self {
            sent_rad: [PerJoint::default(); KEPT_CYCLES],
            next: 0,
            q_rad: PerJoint::default(),
            qd_rad_s: PerJoint::default(),
            still_cycles: 0,
            residual_rad: 0.0,
            worst: None,
            delay_s: 0.0,
        }
    }
}

impl DriveModel {
    /// The axes rest at `q_rad`.
    pub(super) fn rest_at(&mut self, q_rad: PerJoint<f32>) {
        *self = Self { sent_rad: [q_rad; KEPT_CYCLES], q_rad, ..Self::default() };
    }

    fn sent(&self, back: usize) -> PerJoint<f32> {
        let place = (self.next + KEPT_CYCLES - 1 - back.min(KEPT_CYCLES - 1)) % KEPT_CYCLES;
        self.sent_rad.get(place).copied().unwrap_or_default()
    }

    /// One cycle in which `set_rad` comes into force.
    pub(super) fn step(&mut self, options: &Options, period: Duration, set_rad: &PerJoint<f32>) {
        let last = self.sent(0);
        let PerJoint(old) = last;
        let PerJoint(new) = *set_rad;
        let same = old.iter().zip(&new).all(|(old, new)| (old - new).abs() <= SAME_RAD);
        self.still_cycles = if same { self.still_cycles.saturating_add(1) } else { 0 };
        if let Some(place) = self.sent_rad.get_mut(self.next) {
            *place = *set_rad;
        }
        self.next = (self.next + 1) % KEPT_CYCLES;
        let (dt_s, lag_s) = (span::seconds(period), span::seconds(options.time_constant));
        let cycles = span::seconds(options.dead_time) / dt_s.max(1e-4);
        // A dead time between two cycles: the set points between which the delayed one lies.
        let whole = cycles as usize;
        let part = cycles - whole as f32;
        let (newer, older, oldest) = (self.sent(whole), self.sent(whole + 1), self.sent(whole + 2));
        let decay = if lag_s > 0.0 { libm::expf(-dt_s / lag_s) } else { 0.0 };
        for joint in JointIndex::first(protocol::JOINTS_MAX) {
            let to = newer.get(joint) * (1.0 - part) + older.get(joint) * part;
            let from = older.get(joint) * (1.0 - part) + oldest.get(joint) * part;
            let slope = (to - from) / dt_s;
            let transient = (self.q_rad.get(joint) - from + slope * lag_s) * decay;
            self.q_rad.set(joint, to - slope * lag_s + transient);
            self.qd_rad_s.set(joint, if lag_s > 0.0 { slope - transient / lag_s } else { slope });
        }
    }

    /// Where the axes should be.
    pub(super) const fn q_rad(&self) -> &PerJoint<f32> {
        &self.q_rad
    }

    /// How fast they should be.
    pub(super) const fn qd_rad_s(&self) -> &PerJoint<f32> {
        &self.qd_rad_s
    }

    /// Compares with what was measured. What all axes have in common is a delay of the path; the rest is the residual.
    pub(super) fn compare(&mut self, joints: usize, measured_rad: &PerJoint<f32>) {
        let behind = |joint| self.q_rad.get(joint) - measured_rad.get(joint);
        let (mut along, mut square) = (0.0, 0.0);
        for joint in JointIndex::first(joints) {
            let qd = self.qd_rad_s.get(joint);
            along += behind(joint) * qd;
            square += qd * qd;
        }
        let is_fast = square >= FAST_RAD2_S2;
        let delay_s = if is_fast { along / square } else { 0.0 };
        let (mut residual_rad, mut worst) = (0.0, None);
        for joint in JointIndex::first(joints) {
            let beside = (behind(joint) - delay_s * self.qd_rad_s.get(joint)).abs();
            // Written so that NaN counts as the largest.
            let is_small = beside <= residual_rad;
            if !is_small {
                (residual_rad, worst) = (beside, Some(joint));
            }
        }
        (self.residual_rad, self.worst) = (residual_rad, worst);
        if is_fast {
            self.delay_s += WEIGHT * (delay_s - self.delay_s);
        }
    }

    /// Largest distance of a measured axis from the delayed path, rad, and its axis.
    pub(super) const fn residual_rad(&self) -> (f32, Option<JointIndex>) {
        (self.residual_rad, self.worst)
    }

    /// How much later than the model the axes pass the path, s; negative: earlier.
    pub(super) const fn delay_s(&self) -> f32 {
        self.delay_s
    }

    /// Forgets the delay of the last path.
    pub(super) const fn forget_delay(&mut self) {
        self.delay_s = 0.0;
    }

    /// True once the axes have followed the last change of a set point.
    pub(super) fn is_settled(&self, options: &Options, period: Duration) -> bool {
        span::seconds(period) * self.still_cycles as f32 >= Self::settling_s(options)
    }

    /// From the last change of a set point to rest, s.
    pub(super) fn settling_s(options: &Options) -> f32 {
        span::seconds(options.dead_time) + SETTLED * span::seconds(options.time_constant)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::JOINTS_MAX;

    const PERIOD: Duration = Duration::from_millis(12);

    /// The ramp response in closed form: u = v t, y = v (t - dead - T + T exp(-(t - dead) / T)).
    #[test]
    fn model_follows_the_closed_form_of_a_ramp() {
        let options = Options { dead_time: Duration::from_millis(90), ..Options::default() };
        let mut model = DriveModel::default();
        model.rest_at(PerJoint::splat(0.0));
        let v = 0.7f64;
        for k in 1..80u32 {
            let t = 0.012 * f64::from(k);
            model.step(&options, PERIOD, &PerJoint::splat((v * t) as f32));
            let since = t - 0.090;
            // The delayed input has its corner between two cycles, where the model takes the mean: less than a tenth of
            // a cycle's way.
            let expected =
                if since > 0.0 { v * (since - 0.024 + 0.024 * (-since / 0.024).exp()) } else { 0.0 };
            let away = (f64::from(model.q_rad.0[0]) - expected).abs();
            assert!(away < 0.1 * v * 0.012, "{t}: {away}");
        }
    }

    #[test]
    fn axes_that_run_later_than_the_model_are_reported_as_a_delay_of_the_path() {
        let options = Options::default();
        let mut model = DriveModel::default();
        model.rest_at(PerJoint::splat(0.0));
        for k in 1..100u32 {
            model.step(&options, PERIOD, &PerJoint::splat(0.01 * k as f32));
            let PerJoint(mut late) = model.q_rad;
            for (q, qd) in late.iter_mut().zip(model.qd_rad_s.0) {
                *q -= 0.015 * qd;
            }
            model.compare(JOINTS_MAX, &PerJoint(late));
        }
        assert!((model.delay_s() - 0.015).abs() < 1e-4, "{}", model.delay_s());
        assert!(model.residual_rad().0 < 1e-5, "{:?}", model.residual_rad());
        // One axis alone that stays behind is no delay of the path.
        let PerJoint(mut stuck) = model.q_rad;
        stuck[2] -= 0.1;
        model.compare(JOINTS_MAX, &PerJoint(stuck));
        let (residual, worst) = model.residual_rad();
        assert!(residual > 0.08 && worst == JointIndex::new(2).ok(), "{residual} {worst:?}");
    }
}
