//! Constraints that hold at every instant of the motion, at the instants where they matter.
//!
//! Collision and current over the motion are infinitely many constraints. The planner solves without them, searches
//! the motion for the worst instants ([`super::scan`]), adds those as ordinary rows (cuts) and solves again from
//! there. Few rounds are needed, because at the optimum only a handful can be active.

use nalgebra::{Matrix3, Vector3};
use robot_model::collision::{Obb, Proximity};
use robot_model::{Frames, Jacobian, JointVec, PerJoint};

use super::layout::Layout;
use super::options::HAND_CLEARANCE_M;
use super::problem::{CLEARANCE_EXTRA_M, Problem};

use crate::solve::{Row, WIDTH};
use crate::throw::{Basis, Throw};

/// What must hold at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CutKind {
    /// Two boxes of the arm keep their clearance; indices into the robot's boxes, nearer to the base first.
    Boxes(usize, usize),
    /// A box stays above the floor.
    Floor(usize),
    /// A box keeps clear of an obstacle: box, obstacle.
    Obstacle(usize, usize),
    /// The held ball keeps clear of a box.
    HeldBall(usize),
    /// The held ball keeps clear of an obstacle.
    HeldBallObstacle(usize),
    /// The held ball stays above the floor.
    HeldBallFloor,
    /// The flying ball keeps clear of a box.
    FlyingBall(usize),
    /// The flying ball keeps clear of an obstacle.
    FlyingBallObstacle(usize),
    /// Current of a motor.
    Motor(usize),
    /// Current of a supply.
    Supply(usize),
}

/// A constraint at one phase of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cut {
    pub(crate) kind: CutKind,
    /// Phase σ: -1 start, 0 release, 1 stop; above 1 the arm stands and only the ball moves.
    pub(crate) sigma: f64,
}

/// Intermediate results at the release that flying balls need.
pub(crate) struct CutContext<'a, 'p> {
    pub(crate) problem: &'a Problem<'p>,
    pub(crate) throw: &'a Throw,
    pub(crate) p0: Vector3<f64>,
    pub(crate) v0: Vector3<f64>,
    pub(crate) jac: &'a Jacobian,
    pub(crate) by_q: &'a Jacobian,
}

/// Clearances count in decimetres, so that they weigh like the other scaled rows.
pub(crate) const CLEARANCE_SCALE: f64 = 10.0;
/// Shortly after the release the ball moves away from the hand by `½ a t²` only, so their distance hardly changes
/// with the throw. Before this time the row is scaled up so that it changes like the other rows.
const PARTING_S: f64 = 0.1;
/// See [`CutKind::extra_m`].
const HAND_EXTRA_M: f64 = 1e-6;
/// Currents over the motion keep this share of the limit free for the same reason.
pub(crate) const CURRENT_EXTRA: f64 = 1e-3;

pub(crate) fn placed(problem: &Problem<'_>, frames: &Frames, index: usize) -> Obb {
    let body = &problem.arm.collision().boxes()[index];
    let pose = match body.link.checked_sub(1) {
        Some(i) => frames.x_w[i] * body.x_lb,
        None => body.x_lb,
    };
    Obb::new(pose, body.half_m)
}

impl CutKind {
    /// Clearance that is kept between the two bodies, in m.
    pub(crate) fn clearance_m(self, problem: &Problem<'_>) -> f64 {
        if self.is_hand(problem) { HAND_CLEARANCE_M } else { problem.options.clearance_m }
    }

    /// Distance of a row beyond the clearance, in m, so that the next scan finds nothing more. Right after the
    /// release the distance from the hand is half the squared time times their acceleration. There even 0.2 mm cost
    /// up to 12 %, and a throw that keeps them by chance must not be cheaper than one that keeps them by a row.
    fn extra_m(self, problem: &Problem<'_>) -> f64 {
        if self.is_hand(problem) { HAND_EXTRA_M } else { CLEARANCE_EXTRA_M }
    }

    /// Whether it is the released ball and the hand that threw it.
    fn is_hand(self, problem: &Problem<'_>) -> bool {
        matches!(self, Self::FlyingBall(k) if problem.arm.collision().boxes()[k].link == problem.joints())
    }
}

impl Cut {
    pub(crate) fn describe(&self, problem: &Problem<'_>) -> String {
        let name = |k: usize| problem.arm.collision().boxes()[k].name.as_str();
        let obstacle = |k: usize| problem.options.obstacles[k].name.as_str();
        match self.kind {
            CutKind::Boxes(a, b) => format!("collision of \"{}\" with \"{}\"", name(a), name(b)),
            CutKind::Floor(a) => format!("collision of \"{}\" with the floor", name(a)),
            CutKind::Obstacle(a, o) => {
                format!("collision of \"{}\" with obstacle \"{}\"", name(a), obstacle(o))
            }
            CutKind::HeldBall(a) => format!("collision of the held ball with \"{}\"", name(a)),
            CutKind::HeldBallObstacle(o) => {
                format!("collision of the held ball with obstacle \"{}\"", obstacle(o))
            }
            CutKind::HeldBallFloor => "collision of the held ball with the floor".to_owned(),
            CutKind::FlyingBall(a) => format!("contact of the released ball with \"{}\"", name(a)),
            CutKind::FlyingBallObstacle(o) => {
                format!("contact of the released ball with obstacle \"{}\"", obstacle(o))
            }
            CutKind::Motor(j) => format!("current of {} during the motion", problem.arm.joints()[j].name),
            CutKind::Supply(k) => {
                format!("current of supply \"{}\" during the motion", problem.arm.supplies()[k].name)
            }
        }
    }

    /// Value (≥ 0 wanted) and gradient by the variables.
    pub(crate) fn evaluate(&self, c: &CutContext<'_, '_>, layout: &Layout) -> (f64, Row) {
        let var = c.problem.variables();
        let phase = self.sigma.min(1.0);
        let h_index = if self.sigma < 0.0 { var.ha } else { var.hb };
        let basis = Basis::at(phase, c.throw.phase_s(phase));
        let mut g = [0.0; WIDTH];
        let value = match self.kind {
            CutKind::Motor(_) | CutKind::Supply(_) => self.current(c, &basis, h_index, layout, &mut g),
            _ => self.clearance(c, &basis, h_index, layout, &mut g),
        };
        (value, g)
    }

    fn clearance(
        &self,
        c: &CutContext<'_, '_>,
        basis: &Basis,
        h_index: usize,
        layout: &Layout,
        g: &mut Row,
    ) -> f64 {
        let (n, var) = (c.problem.joints(), c.problem.variables());
        let problem = c.problem;
        let arm = problem.arm;
        let (qd, qdd) = (&c.throw.qd_rad_s, &c.throw.qdd_rad_s2);
        let q = c.throw.q_rad + qd * basis.pos.0 + qdd * basis.pos.1;
        let frames = arm.fk(&q);
        let radius_m = arm.gripper().ball_radius_m;
        let link = |k: usize| arm.collision().boxes()[k].link;
        let obb = |k: usize| placed(problem, &frames, k);
        let obstacle = |k: usize| {
            let o = &problem.options.obstacles[k];
            Obb::new(o.x_wo, o.half_m)
        };
        let floor = arm.world().floor_z_m;
        let held = arm.ball(&frames).pos;
        // Proximity, and the links of first and second body; past the last link: the ball in the hand; `None`: the flying ball.
        let flight_s = self.sigma * c.throw.hb_s;
        let flown = || problem.flight.fly(&c.p0, &c.v0, flight_s);
        let (near, first, second): (Proximity, usize, Option<usize>) = match self.kind {
            CutKind::Boxes(a, b) => (obb(a).proximity(&obb(b)), link(a), Some(link(b))),
            CutKind::Floor(b) => (obb(b).proximity_to_floor(floor), 0, Some(link(b))),
            CutKind::Obstacle(b, o) => (obstacle(o).proximity(&obb(b)), 0, Some(link(b))),
            CutKind::HeldBall(a) => (obb(a).proximity_to_sphere(&held, radius_m), link(a), Some(n)),
            CutKind::HeldBallObstacle(o) => (obstacle(o).proximity_to_sphere(&held, radius_m), 0, Some(n)),
            CutKind::HeldBallFloor => {
                let point = held - Vector3::z() * radius_m;
                (Proximity { distance_m: point.z - floor, normal: Vector3::z(), point }, 0, Some(n))
            }
            CutKind::FlyingBall(a) => (obb(a).proximity_to_sphere(&flown().p, radius_m), link(a), None),
            CutKind::FlyingBallObstacle(o) => {
                (obstacle(o).proximity_to_sphere(&flown().p, radius_m), 0, None)
            }
            CutKind::Motor(_) | CutKind::Supply(_) => return 0.0,
        };
        // d(distance) = n · (v_second - v_first) at the nearest point: joints between the two bodies move the second,
        // a flying ball moves by itself and joints up to the first body move the first.
        let scale = match self.kind {
            kind if kind.is_hand(problem) => CLEARANCE_SCALE * (PARTING_S / flight_s).powi(2).max(1.0),
            _ => CLEARANCE_SCALE,
        };
        let normal = near.normal * scale;
        let mut by_angle = JointVec::zeros(n);
        let (from, to, sign) = match second {
            Some(last) => (first, last, 1.0),
            None => (0, first, -1.0),
        };
        for k in from..to {
            by_angle[k] = sign * normal.dot(&frames.axis(k).cross(&(near.point - frames.origin(k))));
        }
        for k in 0..n {
            g[var.q + k] += by_angle[k];
            g[var.qd + k] += basis.pos.0 * by_angle[k];
            if layout.qdd {
                g[var.qdd + k] += basis.pos.1 * by_angle[k];
            }
        }
        if self.sigma <= 1.0 {
            g[h_index] += by_angle.dot(&(qd * basis.pos_by_h.0 + qdd * basis.pos_by_h.1));
        } else {
            // The arm stands at its stop: its phase stays 1 for every h_b.
            g[var.hb] += by_angle.dot(&(qd * basis.pos_by_h.0 + qdd * basis.pos_by_h.1));
        }
        if second.is_none() {
            let state = flown();
            let by_v0: Matrix3<f64> = state.p_by_v0;
            let nv = by_v0.tr_mul(&normal);
            for k in 0..n {
                let (column, v_by_q) = (c.jac.linear(k), c.by_q.linear(k));
                g[var.q + k] += normal.dot(&column) + nv.dot(&v_by_q);
                g[var.qd + k] += nv.dot(&column);
            }
            g[var.hb] += normal.dot(&state.v) * self.sigma;
        }
        assert!(g[var.f] == 0.0);
        (near.distance_m - self.kind.clearance_m(problem) - self.kind.extra_m(problem)) * scale
    }

    fn current(
        &self,
        c: &CutContext<'_, '_>,
        basis: &Basis,
        h_index: usize,
        layout: &Layout,
        g: &mut Row,
    ) -> f64 {
        let (n, var) = (c.problem.joints(), c.problem.variables());
        let arm = c.problem.arm;
        let Some(drives) = arm.drives() else { return 1.0 };
        let (qd_r, qdd_r) = (&c.throw.qd_rad_s, &c.throw.qdd_rad_s2);
        let q = c.throw.q_rad + qd_r * basis.pos.0 + qdd_r * basis.pos.1;
        let qd = qd_r * basis.vel.0 + qdd_r * basis.vel.1;
        let qdd = qd_r * basis.acc.0 + qdd_r * basis.acc.1;
        let d = c.problem.arm_at(self.sigma).inverse_dynamics_gradient(&q, &qd, &qdd);
        let (limit_a, feeds) = match self.kind {
            CutKind::Motor(j) => (drives[j].current_max_a, PerJoint::from_fn(n, |k| k == j)),
            CutKind::Supply(k) => (arm.supplies()[k].current_max_a, arm.supplies()[k].feeds),
            _ => return 1.0,
        };
        let (mut sum, mut by_q, mut by_qd, mut by_qdd) =
            (0.0, JointVec::zeros(n), JointVec::zeros(n), JointVec::zeros(n));
        for j in (0..n).filter(|j| feeds[*j]) {
            let (kb, km) = (drives[j].k_b_a_s_rad, drives[j].k_m_a_nm);
            sum += kb * qd[j].abs() + km * d.tau[j].abs();
            by_qd[j] += kb * qd[j].signum();
            let s = km * d.tau[j].signum();
            by_q += d.by_q.row(j) * s;
            by_qd += d.by_qd.row(j) * s;
            by_qdd += d.by_qdd.row(j) * s;
        }
        let scale = -1.0 / limit_a;
        for k in 0..n {
            g[var.q + k] += scale * by_q[k];
            g[var.qd + k] +=
                scale * (by_q[k] * basis.pos.0 + by_qd[k] * basis.vel.0 + by_qdd[k] * basis.acc.0);
            if layout.qdd {
                g[var.qdd + k] +=
                    scale * (by_q[k] * basis.pos.1 + by_qd[k] * basis.vel.1 + by_qdd[k] * basis.acc.1);
            }
            g[h_index] += scale
                * (by_q[k] * (qd_r[k] * basis.pos_by_h.0 + qdd_r[k] * basis.pos_by_h.1)
                    + by_qd[k] * (qd_r[k] * basis.vel_by_h.0 + qdd_r[k] * basis.vel_by_h.1)
                    + by_qdd[k] * (qd_r[k] * basis.acc_by_h.0 + qdd_r[k] * basis.acc_by_h.1));
        }
        1.0 - CURRENT_EXTRA - sum / limit_a
    }
}
