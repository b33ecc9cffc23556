//! Release and landing of one throw with deviations from the plan, and their derivatives by every variable.

use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};
use robot_model::{JOINTS_MAX, Jacobian, JointVec};

use super::layout::Layout;
use super::problem::Problem;
use crate::flight::{Aim, FlightModel};
use crate::solve::Gradient;
use crate::throw::Throw;

/// `M` numbers that follow from the ball at a release, by the variables of the planner.
#[derive(Debug, Clone, Copy)]
struct Moves<const M: usize> {
    joints: usize,
    by_q: [SVector<f64, M>; JOINTS_MAX],
    by_qd: [SVector<f64, M>; JOINTS_MAX],
    by_qdd: [SVector<f64, M>; JOINTS_MAX],
    by_h: SVector<f64, M>,
    /// Variable of the phase in which the release falls.
    h_index: usize,
}

impl<const M: usize> Moves<M> {
    /// Adds the gradient of `weight · numbers`.
    fn add_gradient(&self, g: &mut Gradient<'_>, layout: &Layout, weight: &SVector<f64, M>) {
        let var = layout.variables();
        for k in 0..self.joints {
            g.add(var.q + k, weight.dot(&self.by_q[k]));
            g.add(var.qd + k, weight.dot(&self.by_qd[k]));
            if layout.qdd {
                g.add(var.qdd + k, weight.dot(&self.by_qdd[k]));
            }
        }
        g.add(self.h_index, weight.dot(&self.by_h));
    }
}

/// A number and its derivative by the length of the phase.
type ByH = (f64, f64);

/// The ball at a release that is late or early.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Released {
    delay_s: f64,
    p: Vector3<f64>,
    v: Vector3<f64>,
    jac: Jacobian,
    by_q: Jacobian,
    qd_r: JointVec,
    qdd_r: JointVec,
    /// Factors of q̇_r and q̈_r in angle and speed at the release: `q = q_r + q̇_r p1 + q̈_r p2`, `q̇ = q̇_r v1 + q̈_r v2`.
    p1: ByH,
    p2: ByH,
    v1: ByH,
    v2: ByH,
    h_index: usize,
}

impl Released {
    /// The ball of a throw that is released `delay_s` late (early if negative).
    pub(crate) fn of(problem: &Problem<'_>, throw: &Throw, delay_s: f64) -> Self {
        let var = problem.variables();
        let arm = problem.arm;
        let (h, h_index) = if delay_s < 0.0 { (throw.ha_s, var.ha) } else { (throw.hb_s, var.hb) };
        // At a fixed time, not at a fixed phase: the derivatives by h differ from those of a cut. Beyond its phase the
        // arm stands.
        let (s, m) = (delay_s.clamp(-h, h), delay_s.abs().min(h));
        let (p1, p2) = (s - s * s * s / (3.0 * h * h), s * s / 2.0 - m * m * m / (3.0 * h));
        let (v1, v2) = (1.0 - s * s / (h * h), s - s * m / h);
        let (p1_h, p2_h) = (2.0 * s * s * s / (3.0 * h * h * h), m * m * m / (3.0 * h * h));
        let (v1_h, v2_h) = if m < h { (2.0 * s * s / (h * h * h), s * m / (h * h)) } else { (0.0, 0.0) };
        let (qd_r, qdd_r) = (throw.qd_rad_s, throw.qdd_rad_s2);
        let q = throw.q_rad + qd_r * p1 + qdd_r * p2;
        let qd = qd_r * v1 + qdd_r * v2;
        let frames = arm.fk(&q);
        let p = arm.ball(&frames).pos;
        let jac = frames.jacobian(&p);
        let by_q = frames.twist_gradient(&jac, &qd);
        let v = (jac * qd).fixed_rows::<3>(0).into_owned();
        let (p1, p2, v1, v2) = ((p1, p1_h), (p2, p2_h), (v1, v1_h), (v2, v2_h));
        Self { delay_s, p, v, jac, by_q, qd_r, qdd_r, p1, p2, v1, v2, h_index }
    }

    /// Derivatives by the variables, from those by the position (`by_p`) and the velocity (`by_v`) of the ball.
    fn moves<const M: usize>(&self, by_p: &SMatrix<f64, M, 3>, by_v: &SMatrix<f64, M, 3>) -> Moves<M> {
        let zero = [SVector::zeros(); JOINTS_MAX];
        let joints = self.jac.n();
        let (h_index, by_h) = (self.h_index, SVector::zeros());
        let mut out = Moves { joints, by_q: zero, by_qd: zero, by_qdd: zero, by_h, h_index };
        for k in 0..joints {
            let column = self.jac.linear(k);
            let (a, b) = (by_p * column + by_v * self.by_q.linear(k), by_v * column);
            out.by_q[k] = a;
            out.by_qd[k] = a * self.p1.0 + b * self.v1.0;
            out.by_qdd[k] = a * self.p2.0 + b * self.v2.0;
            out.by_h += a * (self.qd_r[k] * self.p1.1 + self.qdd_r[k] * self.p2.1)
                + b * (self.qd_r[k] * self.v1.1 + self.qdd_r[k] * self.v2.1);
        }
        out
    }

    /// Square of the speed in m²/s² with which the ball would meet the plane of an aim under gravity alone; negative if it does
    /// not get there.
    pub(crate) fn through_m2_s2(&self, flight: &FlightModel, aim: &Aim) -> f64 {
        let along = aim.normal().dot(&self.against(aim));
        along * along + 2.0 * Self::pull_m_s2(flight, aim) * aim.above_m(&self.p, self.delay_s)
    }

    /// Adds the gradient of [`Released::through_m2_s2`].
    pub(crate) fn add_through_gradient(
        &self,
        g: &mut Gradient<'_>,
        layout: &Layout,
        flight: &FlightModel,
        aim: &Aim,
    ) {
        let normal = aim.normal();
        let by_p = normal.transpose() * (2.0 * Self::pull_m_s2(flight, aim));
        let by_v = normal.transpose() * (2.0 * normal.dot(&self.against(aim)));
        self.moves(&by_p, &by_v).add_gradient(g, layout, &SVector::from([1.0]));
        if let Some((at, axes)) = layout.shift {
            for a in (0..3).filter(|a| axes[*a]) {
                g.add(at + a, -by_p[a]);
            }
        }
    }

    /// Velocity of the ball against the target.
    fn against(&self, aim: &Aim) -> Vector3<f64> {
        self.v - aim.course().velocity_m_s(self.delay_s)
    }

    /// Gravity against the normal of the plane.
    fn pull_m_s2(flight: &FlightModel, aim: &Aim) -> f64 {
        flight.gravity_m_s2() * aim.normal().z
    }
}

/// A landing and its derivatives by the variables of the planner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Landed {
    /// Coordinates on the plane of the target, in m.
    pub(crate) xy: Vector2<f64>,
    moves: Moves<2>,
    /// Speed through the plane against its normal, in m/s.
    pub(crate) through_m_s: f64,
    /// By the place of the plane along its normal.
    pub(crate) by_plane: Vector2<f64>,
}

impl Landed {
    /// Landing on the plane of an aim of a release `delay_s` late (early if negative) through a given flight.
    ///
    /// `None` if the ball does not meet it.
    pub(crate) fn of(
        problem: &Problem<'_>,
        flight: &FlightModel,
        throw: &Throw,
        aim: &Aim,
        delay_s: f64,
    ) -> Option<Self> {
        Self::after(&Released::of(problem, throw, delay_s), flight, aim)
    }

    /// Landing of a released ball; `None` if it does not meet the plane.
    pub(crate) fn after(released: &Released, flight: &FlightModel, aim: &Aim) -> Option<Self> {
        let delay_s = released.delay_s;
        let landed = flight.meet(&released.p, &released.v, aim, delay_s)?;
        let approach = aim.approach(&landed, delay_s);
        let g = aim.jacobian(&landed, delay_s);
        let (g_p, g_v): (Matrix2x3<f64>, Matrix2x3<f64>) =
            (g.fixed_columns::<3>(0).into_owned(), g.fixed_columns::<3>(3).into_owned());
        Some(Self {
            xy: aim.coordinates(&landed.p, delay_s + landed.time_s),
            moves: released.moves(&g_p, &g_v),
            through_m_s: -aim.normal().dot(&approach),
            by_plane: aim.by_offset(&approach),
        })
    }

    /// Adds the gradient of `weight · xy` by the variables of the throw.
    pub(crate) fn add_gradient(&self, g: &mut Gradient<'_>, layout: &Layout, weight: &Vector2<f64>) {
        self.moves.add_gradient(g, layout, weight);
    }
}
