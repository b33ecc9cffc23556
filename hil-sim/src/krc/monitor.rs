//! What the drives do not follow.

use super::event::FaultCause;
use super::options::CutOut;

/// Watches the set points of all axes by differences over one cycle.
#[derive(Clone, Debug)]
pub struct Monitor {
    velocity_deg_s: [f64; 6],
    limits: CutOut,
    range_deg: [(f64, f64); 6],
    cycle_s: f64,
    q_deg: [f64; 6],
    qd_deg_s: [f64; 6],
    qdd_deg_s2: [f64; 6],
}

/// Share by which a value may exceed its limit: differences of decimals on the wire are not exact.
const ROUNDING: f64 = 1e-9;

impl Monitor {
    /// At rest at `q_deg`.
    pub fn new(
        limits: CutOut,
        velocity_deg_s: [f64; 6],
        range_deg: [(f64, f64); 6],
        cycle_s: f64,
        q_deg: [f64; 6],
    ) -> Self {
        let velocity_deg_s = limits.velocity_deg_s.unwrap_or(velocity_deg_s);
        Self { velocity_deg_s, limits, range_deg, cycle_s, q_deg, qd_deg_s: [0.0; 6], qdd_deg_s2: [0.0; 6] }
    }

    /// Velocity of the last set point that passed.
    pub fn qd_deg_s(&self) -> [f64; 6] {
        self.qd_deg_s
    }

    /// Takes the set point of the next cycle, or says why the robot stops. A refused set point is not taken.
    ///
    /// # Errors
    /// The first limit that it breaks: range, velocity, acceleration, jerk, each over all axes.
    pub fn check(&mut self, q_deg: &[f64; 6]) -> Result<(), FaultCause> {
        let h = self.cycle_s;
        let difference = |new: &[f64; 6], old: &[f64; 6]| -> [f64; 6] {
            let mut out = [0.0; 6];
            for (d, (n, o)) in out.iter_mut().zip(new.iter().zip(old)) {
                *d = (n - o) / h;
            }
            out
        };
        let qd = difference(q_deg, &self.q_deg);
        let qdd = difference(&qd, &self.qd_deg_s);
        let qddd = difference(&qdd, &self.qdd_deg_s2);
        for (axis, (q, (low, high))) in q_deg.iter().zip(self.range_deg).enumerate() {
            if !(low..=high).contains(q) {
                return Err(FaultCause::AxisRange { axis, q_deg: *q });
            }
        }
        if let Some((axis, value)) = beyond(&qd, &self.velocity_deg_s) {
            return Err(FaultCause::Velocity { axis, deg_s: value });
        }
        if let Some((axis, value)) = beyond(&qdd, &self.limits.acceleration_deg_s2) {
            return Err(FaultCause::Acceleration { axis, deg_s2: value });
        }
        if let Some((axis, value)) = beyond(&qddd, &self.limits.jerk_deg_s3) {
            return Err(FaultCause::Jerk { axis, deg_s3: value });
        }
        (self.q_deg, self.qd_deg_s, self.qdd_deg_s2) = (*q_deg, qd, qdd);
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
