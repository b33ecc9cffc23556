//! Accelerations that the controller commanded, for each interval between two orders, and those of the reference.
//!
//! A drive turns orders into motion by its ramp generator: towards the target with at most the ramp's speed,
//! changing its speed by the ramp's acceleration (PowerCube manual, ramp motion). The generator is computed here
//! from order to order. So `v` of the law (paper 002, eq. 11 and 12) is known at each interval, also where no
//! telemetry was sent:
//!
//! ```text
//! v = Δ(speed of the generator) / Δt        commanded, |v| <= v_max
//! u = v - Δ(q̇_ref) / Δt                     what the feedback adds; left for it: ±v_max - q̈_ref
//! ```

use super::collect::{Commanded, Reading};
use planner::motion::Motion;

/// Mean accelerations between two orders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Control {
    /// Time of the plan at the middle of the interval, s.
    pub t_s: f64,
    /// Commanded, v of the law, rad/s².
    pub qdd_rad_s2: f64,
    /// Of the reference, rad/s².
    pub qdd_ref_rad_s2: f64,
}

impl Control {
    /// What the feedback adds, u of the law, rad/s².
    #[must_use]
    pub fn u_rad_s2(&self) -> f64 {
        self.qdd_rad_s2 - self.qdd_ref_rad_s2
    }
}

/// Accelerations between the orders to joint `j`, which stands before the first one. Empty if no order contains
/// speed and acceleration.
#[must_use]
pub fn controls(motion: &Motion, j: usize, orders: &[Commanded], positions: &[Reading]) -> Vec<Control> {
    let mut v_rad_s = 0.0;
    let mut all = Vec::with_capacity(orders.len());
    for pair in orders.windows(2) {
        let (order, next) = (&pair[0], &pair[1]);
        let dt_s = next.t_s - order.t_s;
        let before = positions.partition_point(|reading| reading.t_s <= order.t_s);
        let at = before.checked_sub(1).and_then(|i| positions.get(i)).or_else(|| positions.first());
        let (Some(a_rad_s2), Some(v_ramp_rad_s), Some(at), true) =
            (order.a_rad_s2, order.v_rad_s, at, dt_s > 0.0)
        else {
            continue;
        };
        let v_next = after(v_rad_s, order.target_rad - at.value, v_ramp_rad_s, a_rad_s2, dt_s);
        let speed_ref = |t_s: f64| motion.at(t_s).qd[j];
        all.push(Control {
            t_s: 0.5 * (order.t_s + next.t_s),
            qdd_rad_s2: (v_next - v_rad_s) / dt_s,
            qdd_ref_rad_s2: (speed_ref(next.t_s) - speed_ref(order.t_s)) / dt_s,
        });
        v_rad_s = v_next;
    }
    all
}

/// Speed of a generator `dt_s` later that has `way_rad` to go.
fn after(v_rad_s: f64, way_rad: f64, v_ramp_rad_s: f64, a_rad_s2: f64, dt_s: f64) -> f64 {
    let side = way_rad.signum();
    let brakes = v_rad_s * side > 0.0 && v_rad_s * v_rad_s >= 2.0 * a_rad_s2 * way_rad.abs();
    let aim = if brakes { 0.0 } else { side * v_ramp_rad_s };
    v_rad_s + (aim - v_rad_s).clamp(-a_rad_s2 * dt_s, a_rad_s2 * dt_s)
}

#[cfg(test)]
mod tests {
    use planner::motion::Knot;
    use robot_model::JointVec;

    use super::*;

    fn standing() -> Motion {
        let knot = |t_s| Knot { t_s, q_rad: JointVec::zeros(6), qd_rad_s: JointVec::zeros(6) };
        Motion { knots: vec![knot(0.0), knot(1.0)], events: Vec::new() }
    }

    fn order(t_s: f64, target_rad: f64, v_rad_s: f64, a_rad_s2: f64) -> Commanded {
        Commanded { t_s, target_rad, v_rad_s: Some(v_rad_s), a_rad_s2: Some(a_rad_s2) }
    }

    #[test]
    fn accelerations_follow_the_ramps_and_stop_at_their_speed() {
        let still = standing();
        let orders = [
            order(0.00, 3.0, 1.0, 2.0),
            order(0.01, 3.0, 1.0, 4.0),
            // Against the motion: brakes, then would turn back.
            order(0.02, -3.0, 1.0, 3.0),
            // The ramp's speed is reached within the interval: 0.03 rad/s in all, of which 0.01 are missing.
            order(0.03, 3.0, 0.04, 5.0),
            order(0.04, 3.0, 0.04, 5.0),
        ];
        let positions = [Reading { t_s: 0.0, value: 0.0 }];
        let reported: Vec<f64> =
            controls(&still, 0, &orders, &positions).iter().map(|c| c.qdd_rad_s2).collect();
        for (got, want) in reported.iter().zip([2.0, 4.0, -3.0, 1.0]) {
            assert!((got - want).abs() < 1e-9, "{reported:?}");
        }
        assert_eq!(reported.len(), 4);
    }

    #[test]
    fn a_generator_brakes_before_its_target() {
        assert_eq!(after(1.0, 0.1, 2.0, 5.0, 0.01), 0.95);
        assert_eq!(after(1.0, 0.2, 2.0, 5.0, 0.01), 1.05);
        assert_eq!(after(-1.0, -0.1, 2.0, 5.0, 0.01), -0.95);
    }

    #[test]
    fn orders_without_a_ramp_give_no_accelerations() {
        let order = |t_s| Commanded { t_s, target_rad: 1.0, v_rad_s: None, a_rad_s2: None };
        assert!(controls(&standing(), 0, &[order(0.0), order(0.1)], &[]).is_empty());
    }
}
