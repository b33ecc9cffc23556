//! Electrical energy that the supplies give during a throw, with its gradient.
//!
//! `E = Σ_k U_k ∫ Σ_j I_j dt` over the joints j that supply k feeds, with the motor currents of the paper's eq. (9),
//! `I_j = k_b |q̇_j| + k_m |τ_j|`. Currents count as drawn also while a joint brakes: the drives do not feed back.

use robot_model::JointVec;

use super::layout::Layout;
use super::problem::Problem;
use crate::solve::{Row, WIDTH};
use crate::throw::{Basis, Throw};

/// Energy of a throw in J, and its derivatives by the variables of the planner.
pub(crate) struct Energy {
    pub(crate) joule: f64,
    pub(crate) gradient: Row,
}

/// Nodes and weights of the Gauss-Legendre rule of four points on [0, 1].
const NODES: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];
/// Panels per phase. Currents have kinks where a speed or a torque changes sign.
const PANELS: usize = 4;
/// Smooths the absolute values: far below any current of a throw, in rad/s and Nm.
const ABS_EPS: f64 = 1e-3;

fn abs_eps(x: f64) -> (f64, f64) {
    let r = (x * x + ABS_EPS * ABS_EPS).sqrt();
    (r, x / r)
}

/// Energy of a throw in J; `None` without current constants.
pub(crate) fn joule(problem: &Problem<'_>, throw: &Throw) -> Option<f64> {
    // The gradient is not used: this is called once per throw, not once per step.
    energy(problem, &Layout::new(problem, None), throw).map(|e| e.joule)
}

/// Energy of a throw; `None` without current constants.
pub(crate) fn energy(problem: &Problem<'_>, layout: &Layout, throw: &Throw) -> Option<Energy> {
    let (n, var) = (problem.joints(), problem.variables());
    let drives = problem.arm.drives()?;
    let volt = joint_volts(problem);
    let mut out = Energy { joule: 0.0, gradient: [0.0; WIDTH] };
    let (qd_r, qdd_r) = (&throw.qd_rad_s, &throw.qdd_rad_s2);
    for (side, h, h_index) in [(-1.0, throw.ha_s, var.ha), (1.0, throw.hb_s, var.hb)] {
        for panel in 0..PANELS {
            for (node, weight) in NODES {
                let sigma = side * (panel as f64 + node) / PANELS as f64;
                let weight = weight / PANELS as f64;
                let b = Basis::at(sigma, h);
                let q = throw.q_rad + qd_r * b.pos.0 + qdd_r * b.pos.1;
                let qd = qd_r * b.vel.0 + qdd_r * b.vel.1;
                let qdd = qd_r * b.acc.0 + qdd_r * b.acc.1;
                let d = problem.arm_at(sigma).inverse_dynamics_gradient(&q, &qd, &qdd);
                let (mut power_w, mut by_q, mut by_qd, mut by_qdd) =
                    (0.0, JointVec::zeros(n), JointVec::zeros(n), JointVec::zeros(n));
                for j in 0..n {
                    let (speed, torque) = (abs_eps(qd[j]), abs_eps(d.tau[j]));
                    let (kb, km) = (volt[j] * drives[j].k_b_a_s_rad, volt[j] * drives[j].k_m_a_nm);
                    power_w += kb * speed.0 + km * torque.0;
                    by_qd[j] += kb * speed.1;
                    let s = km * torque.1;
                    by_q += d.by_q.row(j) * s;
                    by_qd += d.by_qd.row(j) * s;
                    by_qdd += d.by_qdd.row(j) * s;
                }
                out.joule += weight * h * power_w;
                let g = &mut out.gradient;
                g[h_index] += weight * power_w;
                for k in 0..n {
                    let w = weight * h;
                    g[var.q + k] += w * by_q[k];
                    g[var.qd + k] += w * (by_q[k] * b.pos.0 + by_qd[k] * b.vel.0 + by_qdd[k] * b.acc.0);
                    if layout.qdd {
                        g[var.qdd + k] += w * (by_q[k] * b.pos.1 + by_qd[k] * b.vel.1 + by_qdd[k] * b.acc.1);
                    }
                    g[h_index] += w
                        * (by_q[k] * (qd_r[k] * b.pos_by_h.0 + qdd_r[k] * b.pos_by_h.1)
                            + by_qd[k] * (qd_r[k] * b.vel_by_h.0 + qdd_r[k] * b.vel_by_h.1)
                            + by_qdd[k] * (qd_r[k] * b.acc_by_h.0 + qdd_r[k] * b.acc_by_h.1));
                }
            }
        }
    }
    Some(out)
}

/// Voltage that feeds each joint; zero for a joint that no supply feeds.
fn joint_volts(problem: &Problem<'_>) -> JointVec {
    let supplies = problem.arm.supplies();
    JointVec::from_fn(problem.joints(), |j| supplies.iter().filter(|s| s.feeds[j]).map(|s| s.voltage_v).sum())
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::plan::paper::PaperParameters;
    use crate::plan::problem::Options;
    use crate::throw::{Arm, Joints};

    fn case(arm: &Arm) -> (Problem<'_>, Throw) {
        let problem = Problem::new(arm, Vector3::new(1.0, 1.0, -1.0), Options::best()).expect("valid");
        let h = PaperParameters::from_array([0.493, -0.465, 0.858, 0.583, -1.098, 0.586, 0.920, 0.06]);
        let mut throw = h.throws(&problem)[0].throw;
        throw.qdd_rad_s2 = Joints::from_slice(&[0.5, -1.0, 2.0, 0.3, -0.7, 1.1]);
        (problem, throw)
    }

    #[test]
    fn energy_is_the_integral_of_supply_power_over_the_motion() {
        let arm = Arm::load("powercube6").expect("built in");
        let (problem, throw) = case(&arm);
        let layout = Layout::new(&problem, None);
        let claimed = energy(&problem, &layout, &throw).expect("has currents").joule;
        // Midpoint sums over the time, through the robot model's own currents and supplies.
        let steps = 40_000;
        let dt = throw.duration_s() / f64::from(steps);
        let summed: f64 = (0..steps)
            .map(|i| {
                let s = throw.at_time((f64::from(i) + 0.5) * dt);
                let tau = arm.inverse_dynamics(&s.q, &s.qd, &s.qdd);
                let motor = arm.motor_currents(&s.qd, &tau).expect("has drives");
                let amperes = arm.supply_currents(&motor);
                arm.supplies().iter().zip(amperes).map(|(s, a)| s.voltage_v * a).sum::<f64>() * dt
            })
            .sum();
        assert!((claimed / summed - 1.0).abs() < 2e-3, "{claimed} J claimed, {summed} J summed");
    }

    #[test]
    fn the_gradient_of_the_energy_matches_differences() {
        let arm = Arm::load("powercube6").expect("built in");
        let (problem, throw) = case(&arm);
        let layout = Layout::new(&problem, None);
        let x: Row = layout.row(&throw);
        let at = |x: &Row| energy(&problem, &layout, &layout.throw(x)).expect("has currents");
        let claimed = at(&x).gradient;
        let largest = claimed.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        for k in 0..layout.n {
            let mut moved = x;
            let eps = 1e-6;
            moved[k] = x[k] + eps;
            let after = at(&moved).joule;
            moved[k] = x[k] - eps;
            let differenced = (after - at(&moved).joule) / (2.0 * eps);
            assert!(
                (claimed[k] - differenced).abs() < 1e-5 * largest,
                "variable {k}: {} claimed, {differenced} by differences",
                claimed[k]
            );
        }
    }
}
