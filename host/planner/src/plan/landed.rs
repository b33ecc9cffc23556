//! Landing of one throw that is not quite as planned, and how that point moves with every variable.

use nalgebra::{Matrix2x3, Vector2};

use super::layout::Layout;
use super::problem::Problem;
use crate::flight::{Aim, FlightModel};
use crate::solve::Gradient;
use crate::throw::Throw;

/// A landing and its derivatives by the variables of the planner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Landed<const N: usize> {
    /// Coordinates on the plane of the target, in m.
    pub(crate) xy: Vector2<f64>,
    by_q: [Vector2<f64>; N],
    by_qd: [Vector2<f64>; N],
    by_qdd: [Vector2<f64>; N],
    by_h: Vector2<f64>,
    /// Variable of the phase in which the release falls.
    h_index: usize,
    /// Speed through the plane against its normal, in m/s.
    pub(crate) through_m_s: f64,
    /// By the place of the plane along its normal.
    pub(crate) by_plane: Vector2<f64>,
}

impl<const N: usize> Landed<N> {
    /// Landing on the plane of an aim of a release `delay_s` late (early if negative) through a given flight.
    ///
    /// `None` if the ball does not meet it.
    pub(crate) fn of(
        problem: &Problem<'_, N>,
        flight: &FlightModel,
        throw: &Throw<N>,
        aim: &Aim,
        delay_s: f64,
    ) -> Option<Self> {
        let var = Layout::<N>::VARIABLES;
        let arm = problem.arm;
        let (h, h_index) = if delay_s < 0.0 { (throw.ha_s, var.ha) } else { (throw.hb_s, var.hb) };
        // At a fixed time, not at a fixed phase: the derivatives by h differ from those of a cut. Beyond its phase the
        // arm stands.
        let (s, m) = (delay_s.clamp(-h, h), delay_s.abs().min(h));
        let (p1, p2) = (s - s * s * s / (3.0 * h * h), s * s / 2.0 - m * m * m / (3.0 * h));
        let (v1, v2) = (1.0 - s * s / (h * h), s - s * m / h);
        let (p1_h, p2_h) = (2.0 * s * s * s / (3.0 * h * h * h), m * m * m / (3.0 * h * h));
        let (v1_h, v2_h) = if m < h { (2.0 * s * s / (h * h * h), s * m / (h * h)) } else { (0.0, 0.0) };
        let (qd_r, qdd_r) = (&throw.qd_rad_s, &throw.qdd_rad_s2);
        let q = throw.q_rad + qd_r * p1 + qdd_r * p2;
        let qd = qd_r * v1 + qdd_r * v2;
        let frames = arm.fk(&q);
        let p = arm.ball(&frames).pos;
        let jac = frames.jacobian(&p);
        let by_q = frames.twist_gradient(&jac, &qd);
        let v = (jac * qd).fixed_rows::<3>(0).into_owned();
        let landed = flight.meet(&p, &v, aim, delay_s)?;
        let approach = aim.approach(&landed, delay_s);
        let g = aim.jacobian(&landed, delay_s);
        let (g_p, g_v): (Matrix2x3<f64>, Matrix2x3<f64>) =
            (g.fixed_columns::<3>(0).into_owned(), g.fixed_columns::<3>(3).into_owned());
        let columns: [(Vector2<f64>, Vector2<f64>); N] = std::array::from_fn(|k| {
            let column = jac.fixed_view::<3, 1>(0, k);
            (g_p * column + g_v * by_q.fixed_view::<3, 1>(0, k), g_v * column)
        });
        let mut by_h = Vector2::zeros();
        for (k, (a, b)) in columns.iter().enumerate() {
            by_h += a * (qd_r[k] * p1_h + qdd_r[k] * p2_h) + b * (qd_r[k] * v1_h + qdd_r[k] * v2_h);
        }
        Some(Self {
            xy: aim.coordinates(&landed.p, delay_s + landed.time_s),
            by_q: columns.map(|(a, _)| a),
            by_qd: columns.map(|(a, b)| a * p1 + b * v1),
            by_qdd: columns.map(|(a, b)| a * p2 + b * v2),
            by_h,
            h_index,
            through_m_s: -aim.normal().dot(&approach),
            by_plane: aim.by_offset(&approach),
        })
    }

    /// Adds the gradient of `weight · xy` by the variables of the throw.
    pub(crate) fn add_gradient<const D: usize>(
        &self,
        g: &mut Gradient<'_, D>,
        layout: &Layout<N>,
        weight: &Vector2<f64>,
    ) {
        let var = Layout::<N>::VARIABLES;
        for k in 0..N {
            g.add(var.q + k, weight.dot(&self.by_q[k]));
            g.add(var.qd + k, weight.dot(&self.by_qd[k]));
            if layout.qdd {
                g.add(var.qdd + k, weight.dot(&self.by_qdd[k]));
            }
        }
        g.add(self.h_index, weight.dot(&self.by_h));
    }
}
