//! What the drives do not follow.

use std::collections::VecDeque;

use protocol::Duration;

use super::event::FaultCause;
use super::options::CutOut;

/// Longest base, cycles.
const MAX_BASE: u64 = 1000;

/// Watches the set points of all axes by differences over a base of one or more cycles.
#[derive(Clone, Debug)]
pub struct Monitor {
    velocity_deg_s: [f64; 6],
    limits: CutOut,
    range_deg: [(f64, f64); 6],
    cycle_s: f64,
    /// Cycles of the base.
    base: usize,
    /// Set points, newest last: three bases back.
    recent: VecDeque<[f64; 6]>,
}

/// Share by which a value may exceed its limit: differences of decimals on the wire are not exact.
const ROUNDING: f64 = 1e-9;

impl Monitor {
    /// At rest at `q_deg`.
    pub fn new(
        limits: CutOut,
        velocity_deg_s: [f64; 6],
        range_deg: [(f64, f64); 6],
        cycle: Duration,
        q_deg: [f64; 6],
    ) -> Self {
        let base = (limits.base.as_micros() / cycle.as_micros().max(1)).clamp(1, MAX_BASE) as usize;
        Self {
            velocity_deg_s: limits.velocity_deg_s.unwrap_or(velocity_deg_s),
            limits,
            range_deg,
            cycle_s: cycle.as_secs_f64(),
            base,
            recent: VecDeque::from(vec![q_deg; 3 * base]),
        }
    }

    /// Velocity between the last two set points that passed.
    pub fn qd_deg_s(&self) -> [f64; 6] {
        let ago = |cycles: usize| self.recent.iter().rev().nth(cycles).copied().unwrap_or_default();
        let (last, before) = (ago(0), ago(1));
        std::array::from_fn(|axis| (last[axis] - before[axis]) / self.cycle_s)
    }

    /// Takes the set point of the next cycle, or returns why the robot stops. A refused set point is not taken.
    ///
    /// # Errors
    /// The first limit that is exceeded: range, velocity, acceleration, jerk, each over all axes.
    pub fn check(&mut self, q_deg: &[f64; 6]) -> Result<(), FaultCause> {
        for (axis, (q, (low, high))) in q_deg.iter().zip(self.range_deg).enumerate() {
            if !(low..=high).contains(q) {
                return Err(FaultCause::AxisRange { axis, q_deg: *q });
            }
        }
        // The new set point and those one, two and three bases before it.
        let ago = |bases: usize| self.recent.get((3 - bases) * self.base).copied().unwrap_or(*q_deg);
        let (one, two, three) = (ago(1), ago(2), ago(3));
        let h = self.base as f64 * self.cycle_s;
        let qd = std::array::from_fn(|i| (q_deg[i] - one[i]) / h);
        let qdd = std::array::from_fn(|i| (q_deg[i] - 2.0 * one[i] + two[i]) / (h * h));
        let qddd = std::array::from_fn(|i| (q_deg[i] - 3.0 * one[i] + 3.0 * two[i] - three[i]) / (h * h * h));
        if let Some((axis, value)) = beyond(&qd, &self.velocity_deg_s) {
            return Err(FaultCause::Velocity { axis, deg_s: value });
        }
        if let Some((axis, value)) = beyond(&qdd, &self.limits.acceleration_deg_s2) {
            return Err(FaultCause::Acceleration { axis, deg_s2: value });
        }
        if let Some((axis, value)) = beyond(&qddd, &self.limits.jerk_deg_s3) {
            return Err(FaultCause::Jerk { axis, deg_s3: value });
        }
        self.recent.pop_front();
        self.recent.push_back(*q_deg);
        Ok(())
    }
}

/// The first axis whose magnitude is beyond its limit; NaN is beyond every limit.
fn beyond(values: &[f64; 6], limits: &[f64; 6]) -> Option<(usize, f64)> {
    let within = |value: f64, limit: f64| value.abs() <= limit * (1.0 + ROUNDING) + ROUNDING;
    let pairs = values.iter().zip(limits).enumerate();
    pairs
        .filter(|(_, (value, limit))| !within(**value, **limit))
        .map(|(axis, (value, _))| (axis, *value))
        .next()
}
