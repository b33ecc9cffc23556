//! Objective and constraints of a throw as functions of the variables, with exact gradients.
//!
//! # Variables
//! `x = (q_r, q̇_r, F, h_a, h_b [, q̈_r] [, u])`: the joint state at the release, time of flight and the two phases,
//! in our form the joint acceleration, and, when the nearest reachable target is looked for, the shift `u` of the
//! target. Pose and twist of the release enter as equalities:
//!
//! ```text
//! J_v q̇ = v0(p(q), F)        the ball leaves with the velocity that reaches the target
//! x_RF · v = y_RF · v = 0    the throw is along z of the release frame
//! x_RF · ω = y_RF · ω = 0    the hand turns only about the throw   (8 parameters; dropped for free spin)
//! G_p v + G_v a = 0          a late gripper does not move the landing   (our form)
//! ```
//!
//! Why not the paper's `h` as variables: there, every evaluation solves the inverse kinematics, has eight branches
//! and no value where the pose is out of reach, and `q̇ = J⁻¹ [v0; ω]` blows up at the straight wrist on which the
//! best throws lie. Here all of (2) to (6) is polynomial, and infeasible points are just points.

use nalgebra::{Vector2, Vector3};

use super::cuts::{Cut, CutContext};
use super::problem::Problem;
use super::qp::{DIM, Row};
use super::throw::{JOINTS, Joints, Throw};

/// First index of each group of variables.
pub(crate) const Q: usize = 0;
pub(crate) const QD: usize = 6;
pub(crate) const F: usize = 12;
pub(crate) const HA: usize = 13;
pub(crate) const HB: usize = 14;
pub(crate) const QDD: usize = 15;

/// Numbers of equalities and inequalities; a row keeps its number from evaluation to evaluation.
pub(crate) const EQUALITIES: usize = 9;
pub(crate) const CUTS_MAX: usize = 48;
const RANGE: usize = 0;
const SPEED: usize = 24;
const ACC_START: usize = 36;
const ACC_STOP: usize = 48;
const ACC_RELEASE: usize = 60;
const JERK_A: usize = 72;
const JERK_B: usize = 84;
const PEAK: usize = 96;
const TURN: usize = 108;
const MOTOR: usize = 120;
const SUPPLY: usize = 126;
const POINT: usize = 130;
const TIMES: usize = 136;
const SPIN: usize = 142;
const ALONG: usize = 144;
const ARRIVAL: usize = 145;
const SHIFT: usize = 149;
const CUT: usize = 156;
/// Number of inequality numbers.
pub(crate) const INEQUALITIES: usize = CUT + CUTS_MAX;

/// Rows whose scaled value is above this cannot become active within one step and are left out.
const WINDOW: f64 = 0.8;
/// Currents are sums of absolute values; `√(x² + ε²)` has a gradient at zero, and over-estimates by at most ε.
const ABS_EPS: f64 = 1e-4;

/// Which variables a problem has beyond the first 15.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    pub(crate) n: usize,
    /// Whether q̈_r is free.
    pub(crate) qdd: bool,
    /// First index of the target's shift, if it is free, and which axes may shift.
    pub(crate) shift: Option<(usize, [bool; 3])>,
}

impl Layout {
    pub(crate) fn new(problem: &Problem<'_>, shift: Option<[bool; 3]>) -> Self {
        let qdd = problem.options.null_delay;
        let at = if qdd { QDD + JOINTS } else { QDD };
        let n = at + if shift.is_some() { 3 } else { 0 };
        Self { n, qdd, shift: shift.map(|axes| (at, axes)) }
    }

    pub(crate) fn throw(&self, x: &Row) -> Throw {
        Throw {
            q_rad: Joints::from_column_slice(&x[Q..Q + JOINTS]),
            qd_rad_s: Joints::from_column_slice(&x[QD..QD + JOINTS]),
            qdd_rad_s2: if self.qdd {
                Joints::from_column_slice(&x[QDD..QDD + JOINTS])
            } else {
                Joints::zeros()
            },
            flight_s: x[F],
            ha_s: x[HA],
            hb_s: x[HB],
        }
    }

    pub(crate) fn variables(&self, throw: &Throw) -> Row {
        let mut x = [0.0; DIM];
        x[Q..Q + JOINTS].copy_from_slice(throw.q_rad.as_slice());
        x[QD..QD + JOINTS].copy_from_slice(throw.qd_rad_s.as_slice());
        x[F] = throw.flight_s;
        x[HA] = throw.ha_s;
        x[HB] = throw.hb_s;
        if self.qdd {
            x[QDD..QDD + JOINTS].copy_from_slice(throw.qdd_rad_s2.as_slice());
        }
        x
    }

    pub(crate) fn target(&self, problem: &Problem<'_>, x: &Row) -> Vector3<f64> {
        let mut target = problem.target;
        if let Some((at, _)) = self.shift {
            target += Vector3::new(x[at], x[at + 1], x[at + 2]);
        }
        target
    }
}

/// Where a row adds its gradient, times a factor.
pub(crate) struct Gradient<'a> {
    pub(crate) row: &'a mut Row,
    pub(crate) factor: f64,
}

impl Gradient<'_> {
    #[inline]
    pub(crate) fn add(&mut self, i: usize, value: f64) {
        self.row[i] += self.factor * value;
    }
}

/// Receives the rows of an evaluation. Inequalities mean `value ≥ 0`.
pub(crate) trait Sink {
    /// Whether this inequality is of interest; asked before costly rows.
    fn wants(&self, id: usize) -> bool;
    /// Whether this equality is of interest.
    fn wants_eq(&self, id: usize) -> bool;
    fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    fn eq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
}

/// Name of an inequality for people.
pub(crate) fn describe(problem: &Problem<'_>, id: usize, cuts: &[Cut]) -> String {
    let joint = |i: usize| problem.arm.joints()[i % JOINTS].name.clone();
    match id {
        RANGE..SPEED => {
            let at = if (id - RANGE) / 12 == 0 { "start" } else { "stop" };
            format!("range of {} at the {at}", joint((id - RANGE) / 2))
        }
        SPEED..ACC_START => format!("speed of {}", joint((id - SPEED) / 2)),
        ACC_START..ACC_STOP => format!("acceleration of {} at the start", joint((id - ACC_START) / 2)),
        ACC_STOP..ACC_RELEASE => format!("acceleration of {} at the stop", joint((id - ACC_STOP) / 2)),
        ACC_RELEASE..JERK_A => format!("acceleration of {} at the release", joint((id - ACC_RELEASE) / 2)),
        JERK_A..JERK_B => format!("jerk of {} before the release", joint((id - JERK_A) / 2)),
        JERK_B..PEAK => format!("jerk of {} after the release", joint((id - JERK_B) / 2)),
        PEAK..TURN => format!("speed of {} beside the release", joint(id - PEAK)),
        TURN..MOTOR => format!("range of {} where it turns round", joint(id - TURN)),
        MOTOR..SUPPLY => format!("current of {} at the release", joint(id - MOTOR)),
        SUPPLY..POINT => {
            let name = problem.arm.supplies().get(id - SUPPLY).map_or("?", |s| s.name.as_str());
            format!("current of supply \"{name}\" at the release")
        }
        POINT..TIMES => ["release radius", "release radius", "release elevation", "release elevation"]
            .get(id - POINT)
            .unwrap_or(&"release azimuth")
            .to_string(),
        TIMES..SPIN => {
            ["time of flight", "time of flight", "duration", "duration", "braking ratio", "braking ratio"]
                [id - TIMES]
                .to_string()
        }
        SPIN..ALONG => "spin of the hand".to_owned(),
        ALONG => "direction of the throw".to_owned(),
        ARRIVAL..SHIFT => "arrival".to_owned(),
        _ => cuts.get(id.wrapping_sub(CUT)).map_or_else(|| "target".to_owned(), |c| c.describe(problem)),
    }
}

fn abs_eps(x: f64) -> (f64, f64) {
    let r = (x * x + ABS_EPS * ABS_EPS).sqrt();
    (r, x / r)
}

/// Evaluates everything at `x`.
pub(crate) fn evaluate<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, cuts: &[Cut], sink: &mut S) {
    kinematic_rows(problem, layout, x, cuts, sink);
    spline_rows(problem, layout, x, sink);
}

/// The rows that need the arm's kinematics or dynamics.
pub(crate) fn kinematic_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    x: &Row,
    cuts: &[Cut],
    sink: &mut S,
) {
    let arm = problem.arm;
    let throw = layout.throw(x);
    let (q, qd) = (&throw.q_rad, &throw.qd_rad_s);
    let frames = arm.fk(q);
    let ball = arm.ball(&frames);
    let p = ball.pos;
    let jac = frames.jacobian(&p);
    let twist = jac * qd;
    let v = Vector3::new(twist[0], twist[1], twist[2]);
    let w = Vector3::new(twist[3], twist[4], twist[5]);
    let by_q = frames.twist_gradient(&jac, qd);
    let lin = |m: &robot_model::Jacobian<JOINTS>, k: usize| Vector3::new(m[(0, k)], m[(1, k)], m[(2, k)]);
    let ang = |m: &robot_model::Jacobian<JOINTS>, k: usize| Vector3::new(m[(3, k)], m[(4, k)], m[(5, k)]);
    let (x_rf, y_rf, z_rf): (Vector3<f64>, Vector3<f64>, Vector3<f64>) =
        (ball.rot.column(0).into(), ball.rot.column(1).into(), ball.rot.column(2).into());

    // Launch.
    let target = layout.target(problem, x);
    match problem.flight.launch(&p, &target, throw.flight_s) {
        Ok(launch) => {
            for i in 0..3 {
                if !sink.wants_eq(i) {
                    continue;
                }
                sink.eq(i, v[i] - launch.v0[i], |g| {
                    for k in 0..JOINTS {
                        g.add(Q + k, by_q[(i, k)] - launch.by_p0.row(i).transpose().dot(&lin(&jac, k)));
                        g.add(QD + k, jac[(i, k)]);
                    }
                    g.add(F, -(launch.by_flight_s[i]));
                    if let Some((at, axes)) = layout.shift {
                        for a in 0..3 {
                            if axes[a] {
                                g.add(at + a, launch.by_p0[(i, a)]);
                            }
                        }
                    }
                });
            }
        }
        Err(_) => {
            for i in 0..3 {
                sink.eq(i, 1e3, |_| {});
            }
        }
    }
    // Throw along z_RF, and in the paper's form spin about it only.
    let across = |sink: &mut S, id: usize, axis: &Vector3<f64>, vector: &Vector3<f64>, linear: bool| {
        if !sink.wants_eq(id) {
            return;
        }
        sink.eq(id, axis.dot(vector), |g| {
            for k in 0..JOINTS {
                let (change, column) =
                    if linear { (lin(&by_q, k), lin(&jac, k)) } else { (ang(&by_q, k), ang(&jac, k)) };
                g.add(Q + k, frames.axis(k).cross(axis).dot(vector) + axis.dot(&change));
                g.add(QD + k, axis.dot(&column));
            }
        });
    };
    across(sink, 3, &x_rf, &v, true);
    across(sink, 4, &y_rf, &v, true);
    if !problem.options.free_spin {
        across(sink, 5, &x_rf, &w, false);
        across(sink, 6, &y_rf, &w, false);
        let bounds = &problem.options.bounds.spin_rad_s;
        let spin = z_rf.dot(&w);
        for (id, value, sign) in [(SPIN, spin - bounds.start(), 1.0), (SPIN + 1, bounds.end() - spin, -1.0)] {
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| {
                    for k in 0..JOINTS {
                        g.add(Q + k, sign * (frames.axis(k).cross(&z_rf).dot(&w) + z_rf.dot(&ang(&by_q, k))));
                        g.add(QD + k, sign * z_rf.dot(&ang(&jac, k)));
                    }
                });
            }
        }
    }
    let along = z_rf.dot(&v);
    if along < 1.0 && sink.wants(ALONG) {
        sink.ineq(ALONG, along - 0.1, |g| {
            for k in 0..JOINTS {
                g.add(Q + k, frames.axis(k).cross(&z_rf).dot(&v) + z_rf.dot(&lin(&by_q, k)));
                g.add(QD + k, z_rf.dot(&lin(&jac, k)));
            }
        });
    }
    if problem.options.null_delay && (sink.wants_eq(7) || sink.wants_eq(8)) {
        delay_rows(problem, layout, &throw, &frames, &jac, &by_q, &v, sink);
    }
    point_rows(problem, &p, &jac, sink);
    arrival_rows(problem, &throw, &v, &by_q, &jac, sink);
    if !problem.options.current_over_motion {
        release_current_rows(problem, &throw, &frames, sink);
    }
    let wanted = |i: usize, sink: &S| sink.wants(CUT + i);
    if (0..cuts.len()).any(|i| wanted(i, sink)) {
        let context = CutContext { problem, throw: &throw, p0: p, v0: v, jac: &jac, by_q: &by_q };
        for (i, cut) in cuts.iter().enumerate().take(CUTS_MAX) {
            if wanted(i, sink) {
                let (value, gradient) = cut.evaluate(&context, layout);
                sink.ineq(CUT + i, value, |g| {
                    for (i, c) in gradient.iter().enumerate().take(layout.n) {
                        g.add(i, *c);
                    }
                });
            }
        }
    }
}

/// Release-delay nulling: `L' = w_xy - (v_F,xy / v_F,z) w_z` with `w = v + Φ a`, Φ = ∂p(F)/∂v0.
#[expect(clippy::too_many_arguments, reason = "intermediate results of one evaluation")]
fn delay_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    throw: &Throw,
    frames: &robot_model::Frames<JOINTS>,
    jac: &robot_model::Jacobian<JOINTS>,
    by_q: &robot_model::Jacobian<JOINTS>,
    v: &Vector3<f64>,
    sink: &mut S,
) {
    let arm = problem.arm;
    let rate = frames.jacobian_rate(jac, &throw.qd_rad_s);
    let bias = rate * throw.qd_rad_s;
    let push = jac * throw.qdd_rad_s2;
    let a = Vector3::new(bias[0] + push[0], bias[1] + push[1], bias[2] + push[2]);
    let shift = |v: &Vector3<f64>, f: f64| -> (Vector2<f64>, nalgebra::Matrix2x3<f64>) {
        let end = problem.flight.fly(&Vector3::zeros(), v, f);
        let slope = Vector2::new(end.v.x, end.v.y) / end.v.z;
        let onto = nalgebra::Matrix2x3::new(1.0, 0.0, -slope.x, 0.0, 1.0, -slope.y);
        let by_a = onto * end.p_by_v0;
        (onto * v + by_a * a, by_a)
    };
    let f = throw.flight_s;
    let (value, by_a) = shift(v, f);
    // By v and F: differences of the closed form (or of the flight), which are exact to 1e-9.
    let eps = 1e-6;
    let mut by_v = nalgebra::Matrix2x3::zeros();
    for axis in 0..3 {
        let (mut hi, mut lo) = (*v, *v);
        hi[axis] += eps;
        lo[axis] -= eps;
        by_v.set_column(axis, &((shift(&hi, f).0 - shift(&lo, f).0) / (2.0 * eps)));
    }
    let by_f = (shift(v, f + eps).0 - shift(v, f - eps).0) / (2.0 * eps);
    // ∂a/∂q: the part of J̇ q̇ by differences, the part of J q̈ in closed form.
    let push_by_q = frames.twist_gradient(jac, &throw.qdd_rad_s2);
    let a_by_q: [Vector3<f64>; JOINTS] = std::array::from_fn(|k| {
        let at = |e: f64| {
            let mut q = throw.q_rad;
            q[k] += e;
            let frames = arm.fk(&q);
            let jac = frames.jacobian(&arm.ball(&frames).pos);
            frames.bias_acceleration(&jac, &throw.qd_rad_s)
        };
        let d = (at(eps) - at(-eps)) / (2.0 * eps);
        Vector3::new(d[0] + push_by_q[(0, k)], d[1] + push_by_q[(1, k)], d[2] + push_by_q[(2, k)])
    });
    for i in 0..2 {
        sink.eq(7 + i, value[i], |g| {
            let (row_v, row_a) = (by_v.row(i).transpose(), by_a.row(i).transpose());
            for k in 0..JOINTS {
                let v_by_q = Vector3::new(by_q[(0, k)], by_q[(1, k)], by_q[(2, k)]);
                let column = Vector3::new(jac[(0, k)], jac[(1, k)], jac[(2, k)]);
                let rate_column = Vector3::new(rate[(0, k)], rate[(1, k)], rate[(2, k)]);
                g.add(Q + k, row_v.dot(&v_by_q) + row_a.dot(&a_by_q[k]));
                g.add(QD + k, row_v.dot(&column) + row_a.dot(&(rate_column + v_by_q)));
                if layout.qdd {
                    g.add(QDD + k, row_a.dot(&column));
                }
            }
            g.add(F, by_f[i]);
        });
    }
}

/// Spherical bounds of the release point.
fn point_rows<S: Sink>(
    problem: &Problem<'_>,
    p: &Vector3<f64>,
    jac: &robot_model::Jacobian<JOINTS>,
    sink: &mut S,
) {
    let b = &problem.options.bounds;
    let d = p - problem.shoulder;
    let r = d.norm();
    let unit = d / r;
    // The sine of the elevation: monotone where the bounds are, and smooth at the pole.
    let sin = unit.z;
    let by_sin = (Vector3::z() - unit * sin) / r;
    let half_turn = std::f64::consts::FRAC_PI_2;
    let mut rows: [(usize, f64, Vector3<f64>); 6] = [(0, f64::INFINITY, Vector3::zeros()); 6];
    rows[0] = (POINT, r - b.radius_m.start(), unit);
    rows[1] = (POINT + 1, b.radius_m.end() - r, -unit);
    if *b.elevation_rad.start() > -half_turn {
        rows[2] = (POINT + 2, sin - b.elevation_rad.start().sin(), by_sin);
    }
    if *b.elevation_rad.end() < half_turn {
        rows[3] = (POINT + 3, b.elevation_rad.end().sin() - sin, -by_sin);
    }
    if let Some(azimuth) = &b.azimuth_rad {
        let flat = (d.x * d.x + d.y * d.y).max(1e-12);
        let by_p = Vector3::new(-d.y, d.x, 0.0) / flat;
        let theta = d.y.atan2(d.x);
        rows[4] = (POINT + 4, theta - azimuth.start(), by_p);
        rows[5] = (POINT + 5, azimuth.end() - theta, -by_p);
    }
    for (id, value, by_p) in rows {
        if value < WINDOW && sink.wants(id) {
            sink.ineq(id, value, |g| {
                for k in 0..JOINTS {
                    g.add(Q + k, by_p.x * jac[(0, k)] + by_p.y * jac[(1, k)] + by_p.z * jac[(2, k)]);
                }
            });
        }
    }
}

/// Window of arrival speed and steepness.
fn arrival_rows<S: Sink>(
    problem: &Problem<'_>,
    throw: &Throw,
    v: &Vector3<f64>,
    by_q: &robot_model::Jacobian<JOINTS>,
    jac: &robot_model::Jacobian<JOINTS>,
    sink: &mut S,
) {
    let arrival = &problem.options.arrival;
    if arrival.speed_m_s.is_none() && arrival.descent_rad.is_none() {
        return;
    }
    let end = problem.flight.fly(&Vector3::zeros(), v, throw.flight_s);
    let by_time = problem.flight.acceleration(&end.v);
    let speed = end.v.norm();
    let unit = end.v / speed;
    // sin(descent) = -v_z/|v|.
    let sin = -unit.z;
    let by_sin = -(Vector3::z() - unit * unit.z) / speed;
    let mut row = |id: usize, value: f64, by: Vector3<f64>| {
        if value < WINDOW && sink.wants(id) {
            sink.ineq(id, value, |g| {
                let by_v0 = end.v_by_v0.tr_mul(&by);
                for k in 0..JOINTS {
                    g.add(Q + k, by_v0.x * by_q[(0, k)] + by_v0.y * by_q[(1, k)] + by_v0.z * by_q[(2, k)]);
                    g.add(QD + k, by_v0.x * jac[(0, k)] + by_v0.y * jac[(1, k)] + by_v0.z * jac[(2, k)]);
                }
                g.add(F, by.dot(&by_time));
            });
        }
    };
    if let Some(range) = &arrival.speed_m_s {
        row(ARRIVAL, speed - range.start(), unit);
        row(ARRIVAL + 1, range.end() - speed, -unit);
    }
    if let Some(range) = &arrival.descent_rad {
        row(ARRIVAL + 2, sin - range.start().sin(), by_sin);
        row(ARRIVAL + 3, range.end().sin() - sin, -by_sin);
    }
}

/// Currents (7) and (8) at the release with the paper's simplification `τ(q_r, q̇_r, 0)`.
fn release_current_rows<S: Sink>(
    problem: &Problem<'_>,
    throw: &Throw,
    frames: &robot_model::Frames<JOINTS>,
    sink: &mut S,
) {
    let arm = problem.arm;
    let Some(drives) = arm.drives() else { return };
    let supplies = arm.supplies();
    if !(MOTOR..SUPPLY + supplies.len().min(POINT - SUPPLY)).any(|id| sink.wants(id)) {
        return;
    }
    let (q, qd) = (&throw.q_rad, &throw.qd_rad_s);
    let tau = arm.bias_torques(q, qd);
    let motor: [f64; JOINTS] = std::array::from_fn(|j| {
        drives[j].k_b_a_s_rad * abs_eps(qd[j]).0 + drives[j].k_m_a_nm * abs_eps(tau[j]).0
    });
    let near_motor = |j: usize| 1.0 - motor[j] / drives[j].current_max_a;
    let near_supply = |k: usize| {
        let sum: f64 = (0..JOINTS).filter(|j| supplies[k].feeds[*j]).map(|j| motor[j]).sum();
        1.0 - sum / supplies[k].current_max_a
    };
    const NEAR: f64 = 0.25;
    let supplies_used = supplies.len().min(POINT - SUPPLY);
    let any = (0..JOINTS).any(|j| near_motor(j) < NEAR) || (0..supplies_used).any(|k| near_supply(k) < NEAR);
    if !any {
        return;
    }
    let gradient = arm.inverse_dynamics_gradient_at(frames, qd, &Joints::zeros());
    let add = |g: &mut Gradient<'_>, j: usize, scale: f64| {
        let by_tau = scale * drives[j].k_m_a_nm * abs_eps(tau[j]).1;
        for k in 0..JOINTS {
            g.add(Q + k, by_tau * gradient.by_q[(j, k)]);
            g.add(QD + k, by_tau * gradient.by_qd[(j, k)]);
        }
        g.add(QD + j, scale * drives[j].k_b_a_s_rad * abs_eps(qd[j]).1);
    };
    for j in 0..JOINTS {
        if near_motor(j) < NEAR && sink.wants(MOTOR + j) {
            sink.ineq(MOTOR + j, near_motor(j), |g| add(g, j, -1.0 / drives[j].current_max_a));
        }
    }
    for k in 0..supplies_used {
        if near_supply(k) < NEAR && sink.wants(SUPPLY + k) {
            sink.ineq(SUPPLY + k, near_supply(k), |g| {
                for j in (0..JOINTS).filter(|j| supplies[k].feeds[*j]) {
                    add(g, j, -1.0 / supplies[k].current_max_a);
                }
            });
        }
    }
}

/// Objective and the limits (2) to (6) of the spline: closed forms of the variables.
pub(crate) fn spline_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    let l = &problem.limits;
    let w = &problem.options.weights;
    let (ha, hb) = (x[HA], x[HB]);
    let acc = |j: usize| if layout.qdd { x[QDD + j] } else { 0.0 };

    // Objective: q⃛ is constant in each phase, so its squared integral is 4 Σ(q̈h ∓ q̇)²/h³.
    let (mut sa, mut sb, mut sa_h, mut sb_h) = (0.0, 0.0, 0.0, 0.0);
    for j in 0..JOINTS {
        let (qd, qdd) = (x[QD + j], acc(j));
        let (ea, eb) = (qd - qdd * ha, qd + qdd * hb);
        sa += ea * ea;
        sb += eb * eb;
        sa_h -= 2.0 * ea * qdd;
        sb_h += 2.0 * eb * qdd;
    }
    let k = 4.0 * w.k_j;
    let total = ha + hb;
    let (ia, ib) = (1.0 / (ha * ha * ha), 1.0 / (hb * hb * hb));
    let mut value = w.k_t * total + w.k_b * hb / total + k * (sa * ia + sb * ib);
    if let Some((at, _)) = layout.shift {
        let u = Vector3::new(x[at], x[at + 1], x[at + 2]);
        value = value * SHIFT_COST_SHARE + SHIFT_WEIGHT * u.norm_squared();
    }
    sink.objective(value, |g| {
        let share = if layout.shift.is_some() { SHIFT_COST_SHARE } else { 1.0 };
        g.add(HA, share * (w.k_t - w.k_b * hb / (total * total) + k * (sa_h * ia - 3.0 * sa * ia / ha)));
        g.add(HB, share * (w.k_t + w.k_b * ha / (total * total) + k * (sb_h * ib - 3.0 * sb * ib / hb)));
        for j in 0..JOINTS {
            let (qd, qdd) = (x[QD + j], acc(j));
            let (ea, eb) = (qd - qdd * ha, qd + qdd * hb);
            g.add(QD + j, share * 2.0 * k * (ea * ia + eb * ib));
            if layout.qdd {
                g.add(QDD + j, share * 2.0 * k * (eb * hb * ib - ea * ha * ia));
            }
        }
        if let Some((at, axes)) = layout.shift {
            for a in 0..3 {
                if axes[a] {
                    g.add(at + a, 2.0 * SHIFT_WEIGHT * x[at + a]);
                }
            }
        }
    });

    for j in 0..JOINTS {
        let (q, qd, qdd) = (x[Q + j], x[QD + j], acc(j));
        // Both outer ends inside the range (2), (3).
        let start = q - qd * ha * (2.0 / 3.0) + qdd * ha * ha / 6.0;
        let stop = q + qd * hb * (2.0 / 3.0) + qdd * hb * hb / 6.0;
        for (base, at, h_index, sign_h, h) in [(RANGE, start, HA, -1.0, ha), (RANGE + 12, stop, HB, 1.0, hb)]
        {
            for (id, value, sign) in
                [(base + 2 * j, at - l.q_min[j], 1.0), (base + 2 * j + 1, l.q_max[j] - at, -1.0)]
            {
                if value < WINDOW && sink.wants(id) {
                    sink.ineq(id, value, |g| {
                        g.add(Q + j, sign);
                        g.add(QD + j, sign * sign_h * h * (2.0 / 3.0));
                        g.add(h_index, sign * (sign_h * qd * (2.0 / 3.0) + qdd * h / 3.0));
                        if layout.qdd {
                            g.add(QDD + j, sign * h * h / 6.0);
                        }
                    });
                }
            }
        }
        for (s, sign) in [(0, 1.0), (1, -1.0)] {
            // Speed at the release (4).
            let value = 1.0 - sign * qd / l.v[j];
            if value < WINDOW && sink.wants(SPEED + 2 * j + s) {
                sink.ineq(SPEED + 2 * j + s, value, |g| g.add(QD + j, -(sign / l.v[j])));
            }
            // Acceleration (5), times h so that it stays linear: A h ∓ (2 q̇ - q̈ h) ≥ 0.
            let scale = 1.0 / (2.0 * l.v[j]);
            for (id, h_index, h, dir) in
                [(ACC_START + 2 * j + s, HA, ha, -1.0), (ACC_STOP + 2 * j + s, HB, hb, 1.0)]
            {
                let demand = 2.0 * qd + dir * qdd * h;
                let value = (l.a[j] * h - sign * demand) * scale;
                if value < WINDOW && sink.wants(id) {
                    sink.ineq(id, value, |g| {
                        g.add(h_index, (l.a[j] - sign * dir * qdd) * scale);
                        g.add(QD + j, -(2.0 * sign * scale));
                        if layout.qdd {
                            g.add(QDD + j, -(sign * dir * h * scale));
                        }
                    });
                }
            }
            // Jerk (6), times h²/2.
            for (id, h_index, h, dir) in
                [(JERK_A + 2 * j + s, HA, ha, -1.0), (JERK_B + 2 * j + s, HB, hb, 1.0)]
            {
                let value = (l.j[j] * h * h * 0.5 - sign * (qd + dir * qdd * h)) / l.v[j];
                if value < WINDOW && sink.wants(id) {
                    sink.ineq(id, value, |g| {
                        g.add(h_index, (l.j[j] * h - sign * dir * qdd) / l.v[j]);
                        g.add(QD + j, -(sign / l.v[j]));
                        if layout.qdd {
                            g.add(QDD + j, -(sign * dir * h / l.v[j]));
                        }
                    });
                }
            }
            if layout.qdd {
                let value = 1.0 - sign * qdd / l.a[j];
                if value < WINDOW && sink.wants(ACC_RELEASE + 2 * j + s) {
                    sink.ineq(ACC_RELEASE + 2 * j + s, value, |g| g.add(QDD + j, -(sign / l.a[j])));
                }
            }
        }
    }
    if layout.qdd {
        extreme_rows(problem, layout, x, sink);
    }
    time_rows(problem, x, sink);
}

/// Weight of the squared shift of the target against the objective when the nearest reachable target is looked for.
const SHIFT_WEIGHT: f64 = 1e3;
const SHIFT_COST_SHARE: f64 = 1e-3;

/// With joint acceleration at the release, speed and position can peak inside a phase.
fn extreme_rows<S: Sink>(problem: &Problem<'_>, layout: &Layout, x: &Row, sink: &mut S) {
    use super::throw::Basis;
    let l = &problem.limits;
    let throw = layout.throw(x);
    for j in 0..JOINTS {
        for (k, side) in [(0, -1.0), (1, 1.0)] {
            let h_index = if side < 0.0 { HA } else { HB };
            let (qd, qdd) = (throw.qd_rad_s[j], throw.qdd_rad_s2[j]);
            if let Some(sigma) = throw.speed_peak_phase(j, side) {
                let b = Basis::at(sigma, throw.phase_s(side));
                let peak = qd * b.vel.0 + qdd * b.vel.1;
                let sign = peak.signum();
                let value = 1.0 - sign * peak / l.v[j];
                let id = PEAK + 6 * k + j;
                if value < WINDOW && sink.wants(id) {
                    // The phase of the peak is stationary, so only the direct dependence counts.
                    sink.ineq(id, value, |g| {
                        g.add(QD + j, -(sign * b.vel.0 / l.v[j]));
                        g.add(QDD + j, -(sign * b.vel.1 / l.v[j]));
                        g.add(h_index, -(sign * (qd * b.vel_by_h.0 + qdd * b.vel_by_h.1) / l.v[j]));
                    });
                }
            }
            if let Some(sigma) = throw.turning_phase(j, side) {
                let b = Basis::at(sigma, throw.phase_s(side));
                let at = throw.q_rad[j] + qd * b.pos.0 + qdd * b.pos.1;
                let (lower, upper) = (at - l.q_min[j], l.q_max[j] - at);
                let (value, sign) = if lower < upper { (lower, 1.0) } else { (upper, -1.0) };
                let id = TURN + 6 * k + j;
                if value < WINDOW && sink.wants(id) {
                    sink.ineq(id, value, |g| {
                        g.add(Q + j, sign);
                        g.add(QD + j, sign * b.pos.0);
                        g.add(QDD + j, sign * b.pos.1);
                        g.add(h_index, sign * (qd * b.pos_by_h.0 + qdd * b.pos_by_h.1));
                    });
                }
            }
        }
    }
}

/// Bounds of times, braking ratio and the shift of the target; all linear.
fn time_rows<S: Sink>(problem: &Problem<'_>, x: &Row, sink: &mut S) {
    let b = &problem.options.bounds;
    let (ha, hb) = (x[HA], x[HB]);
    let total = ha + hb;
    let (r_min, r_max) = (*b.braking_ratio.start(), *b.braking_ratio.end());
    let rows: [(f64, f64, f64, f64); 6] = [
        // value, and its derivative by F, h_a, h_b
        (x[F] - b.flight_s.start(), 1.0, 0.0, 0.0),
        (b.flight_s.end() - x[F], -1.0, 0.0, 0.0),
        (total - b.duration_s.start(), 0.0, 1.0, 1.0),
        (b.duration_s.end() - total, 0.0, -1.0, -1.0),
        (hb - r_min * total, 0.0, -r_min, 1.0 - r_min),
        (r_max * total - hb, 0.0, r_max, r_max - 1.0),
    ];
    for (i, (value, by_f, by_ha, by_hb)) in rows.into_iter().enumerate() {
        if value < WINDOW && sink.wants(TIMES + i) {
            sink.ineq(TIMES + i, value, |g| {
                g.add(F, by_f);
                g.add(HA, by_ha);
                g.add(HB, by_hb);
            });
        }
    }
}
