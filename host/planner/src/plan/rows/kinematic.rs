//! The rows that need the arm's kinematics: launch, direction of the throw, release point, arrival.

use nalgebra::Vector3;
use robot_model::Jacobian;

use super::WINDOW;
use super::arriving::Arriving;
use super::current::release_current_rows;
use super::delay::delay_rows;
use super::opening::opening_rows;
use crate::plan::cuts::{Cut, CutContext};
use crate::plan::layout::{ACROSS, CUTS_MAX, LAUNCH, Layout, TURNING};
use crate::plan::problem::Problem;
use crate::solve::{Row, Sink};

/// The rows that need the arm's kinematics or dynamics.
pub(crate) fn kinematic_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    layout: &Layout<N>,
    x: &Row<D>,
    cuts: &[Cut],
    sink: &mut S,
) {
    let var = Layout::<N>::VARIABLES;
    let number = Layout::<N>::NUMBERS;
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
    let lin = |m: &Jacobian<N>, k: usize| Vector3::new(m[(0, k)], m[(1, k)], m[(2, k)]);
    let ang = |m: &Jacobian<N>, k: usize| Vector3::new(m[(3, k)], m[(4, k)], m[(5, k)]);
    let (x_rf, y_rf, z_rf): (Vector3<f64>, Vector3<f64>, Vector3<f64>) =
        (ball.rot.column(0).into(), ball.rot.column(1).into(), ball.rot.column(2).into());

    // Launch: where the ball is after the time of flight, over that time. In vacuum it is the velocity in excess of the
    // one that reaches the target.
    let aim = layout.aim(problem, x);
    let flight_s = throw.flight_s;
    let end = problem.flight.fly(&p, &v, flight_s);
    let miss = (end.p - aim.point_at(flight_s)) / flight_s;
    let towards = end.v - aim.course().velocity_m_s(flight_s);
    for i in 0..3 {
        if !sink.wants_eq(LAUNCH + i) {
            continue;
        }
        if !miss[i].is_finite() {
            sink.eq(LAUNCH + i, 1e3, |_| {});
            continue;
        }
        let by_v0 = end.p_by_v0.row(i).transpose() / flight_s;
        sink.eq(LAUNCH + i, miss[i], |g| {
            for k in 0..N {
                let column = lin(&jac, k);
                g.add(var.q + k, column[i] / flight_s + by_v0.dot(&lin(&by_q, k)));
                g.add(var.qd + k, by_v0.dot(&column));
            }
            g.add(var.f, (towards[i] - miss[i]) / flight_s);
            if let Some((at, axes)) = layout.shift
                && axes[i]
            {
                g.add(at + i, -1.0 / flight_s);
            }
        });
    }
    // Throw along z_RF, and in the paper's form spin about it only.
    let across = |sink: &mut S, id: usize, axis: &Vector3<f64>, vector: &Vector3<f64>, linear: bool| {
        if !sink.wants_eq(id) {
            return;
        }
        sink.eq(id, axis.dot(vector), |g| {
            for k in 0..N {
                let (change, column) =
                    if linear { (lin(&by_q, k), lin(&jac, k)) } else { (ang(&by_q, k), ang(&jac, k)) };
                g.add(var.q + k, frames.axis(k).cross(axis).dot(vector) + axis.dot(&change));
                g.add(var.qd + k, axis.dot(&column));
            }
        });
    };
    across(sink, ACROSS, &x_rf, &v, true);
    across(sink, ACROSS + 1, &y_rf, &v, true);
    if !problem.options.free_spin {
        across(sink, TURNING, &x_rf, &w, false);
        across(sink, TURNING + 1, &y_rf, &w, false);
        let bounds = &problem.bounds.spin_rad_s;
        let spin = z_rf.dot(&w);
        for (id, value, sign) in
            [(number.spin, spin - bounds.start(), 1.0), (number.spin + 1, bounds.end() - spin, -1.0)]
        {
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| {
                    for k in 0..N {
                        g.add(
                            var.q + k,
                            sign * (frames.axis(k).cross(&z_rf).dot(&w) + z_rf.dot(&ang(&by_q, k))),
                        );
                        g.add(var.qd + k, sign * z_rf.dot(&ang(&jac, k)));
                    }
                });
            }
        }
    }
    let along = z_rf.dot(&v);
    if along < 1.0 && sink.wants(number.along) {
        sink.ineq(number.along, along - 0.1, |g| {
            for k in 0..N {
                g.add(var.q + k, frames.axis(k).cross(&z_rf).dot(&v) + z_rf.dot(&lin(&by_q, k)));
                g.add(var.qd + k, z_rf.dot(&lin(&jac, k)));
            }
        });
    }
    delay_rows(problem, layout, x, &throw, sink);
    point_rows(problem, &p, &jac, sink);
    let arriving = Arriving { end: &end, throw: &throw, by_q: &by_q, jac: &jac };
    arrival_rows(problem, &arriving, sink);
    opening_rows(problem, &aim, &arriving, sink);
    if !problem.options.current_over_motion {
        release_current_rows(problem, &throw, &frames, sink);
    }
    let wanted = |i: usize, sink: &S| sink.wants(number.cut + i);
    if (0..cuts.len()).any(|i| wanted(i, sink)) {
        let context = CutContext { problem, throw: &throw, p0: p, v0: v, jac: &jac, by_q: &by_q };
        for (i, cut) in cuts.iter().enumerate().take(CUTS_MAX) {
            if wanted(i, sink) {
                let (value, gradient): (f64, Row<D>) = cut.evaluate(&context, layout);
                sink.ineq(number.cut + i, value, |g| {
                    for (i, c) in gradient.iter().enumerate().take(layout.n) {
                        g.add(i, *c);
                    }
                });
            }
        }
    }
}

/// Spherical bounds of the release point.
fn point_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    p: &Vector3<f64>,
    jac: &Jacobian<N>,
    sink: &mut S,
) {
    let var = Layout::<N>::VARIABLES;
    let number = Layout::<N>::NUMBERS;
    let b = &problem.bounds;
    let d = p - problem.shoulder;
    let r = d.norm();
    let unit = d / r;
    // The sine of the elevation: monotone where the bounds are, and smooth at the pole.
    let sin = unit.z;
    let by_sin = (Vector3::z() - unit * sin) / r;
    let half_turn = std::f64::consts::FRAC_PI_2;
    let mut rows: [(usize, f64, Vector3<f64>); 6] = [(0, f64::INFINITY, Vector3::zeros()); 6];
    rows[0] = (number.point, r - b.radius_m.start(), unit);
    rows[1] = (number.point + 1, b.radius_m.end() - r, -unit);
    if *b.elevation_rad.start() > -half_turn {
        rows[2] = (number.point + 2, sin - b.elevation_rad.start().sin(), by_sin);
    }
    if *b.elevation_rad.end() < half_turn {
        rows[3] = (number.point + 3, b.elevation_rad.end().sin() - sin, -by_sin);
    }
    if let Some(azimuth) = &b.azimuth_rad {
        let flat = (d.x * d.x + d.y * d.y).max(1e-12);
        let by_p = Vector3::new(-d.y, d.x, 0.0) / flat;
        let theta = d.y.atan2(d.x);
        rows[4] = (number.point + 4, theta - azimuth.start(), by_p);
        rows[5] = (number.point + 5, azimuth.end() - theta, -by_p);
    }
    for (id, value, by_p) in rows {
        if value < WINDOW && sink.wants(id) {
            sink.ineq(id, value, |g| {
                for k in 0..N {
                    g.add(var.q + k, by_p.x * jac[(0, k)] + by_p.y * jac[(1, k)] + by_p.z * jac[(2, k)]);
                }
            });
        }
    }
}

/// Window of arrival speed and steepness.
fn arrival_rows<S: Sink<D>, const N: usize, const D: usize>(
    problem: &Problem<'_, N>,
    arriving: &Arriving<'_, N>,
    sink: &mut S,
) {
    let number = Layout::<N>::NUMBERS;
    let arrival = &problem.options.arrival;
    let v = &arriving.end.v;
    let speed = v.norm();
    let unit = v / speed;
    // sin(descent) = -v_z/|v|.
    let sin = -unit.z;
    let by_sin = -(Vector3::z() - unit * unit.z) / speed;
    let mut row = |id: usize, value: f64, by: Vector3<f64>| {
        if value < WINDOW && sink.wants(id) {
            sink.ineq(id, value, |g| arriving.add_gradient(problem, g, &by, 0.0));
        }
    };
    if let Some(range) = &arrival.speed_m_s {
        row(number.arrival, speed - range.start(), unit);
        row(number.arrival + 1, range.end() - speed, -unit);
    }
    if let Some(range) = &arrival.descent_rad {
        row(number.arrival + 2, sin - range.start().sin(), by_sin);
        row(number.arrival + 3, range.end().sin() - sin, -by_sin);
    }
}
