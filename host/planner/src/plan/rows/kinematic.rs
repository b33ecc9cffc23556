//! The rows that need the arm's kinematics: launch, direction of the throw, release point, arrival; limits at instants of the
//! motion.

use nalgebra::Vector3;
use robot_model::{Frames, Jacobian, Pose};

use super::WINDOW;
use super::arriving::Arriving;
use super::current::release_current_rows;
use super::opening::opening_rows;
use crate::flight::aim::Aim;
use crate::plan::cuts::{Cut, CutContext};
use crate::plan::layout::{ACROSS, CUTS_MAX, LAUNCH, Layout, TURNING, Variables};
use crate::plan::problem::Problem;
use crate::solve::{Gradient, Row, Sink};
use crate::throw::Throw;

/// The hand at the release.
struct Hand<'c> {
    frames: &'c Frames,
    /// Axes of the release frame in the world.
    axes: [Vector3<f64>; 3],
    /// Twist of the ball by joint speeds, and what joint angles change of it.
    jac: &'c Jacobian,
    by_q: &'c Jacobian,
    v: Vector3<f64>,
    w: Vector3<f64>,
}

impl Hand<'_> {
    /// Adds `sign` times the gradient of a component of the velocity along an axis of the hand.
    fn add_velocity_along(&self, g: &mut Gradient<'_>, axis: &Vector3<f64>, sign: f64) {
        let n = self.jac.n();
        let var = Variables::of(n);
        for k in 0..n {
            let turned = self.frames.axis(k).cross(axis).dot(&self.v);
            g.add(var.q + k, sign * (turned + axis.dot(&self.by_q.linear(k))));
            g.add(var.qd + k, sign * axis.dot(&self.jac.linear(k)));
        }
    }

    /// The same of the angular velocity.
    fn add_spin_along(&self, g: &mut Gradient<'_>, axis: &Vector3<f64>, sign: f64) {
        let n = self.jac.n();
        let var = Variables::of(n);
        for k in 0..n {
            let turned = self.frames.axis(k).cross(axis).dot(&self.w);
            g.add(var.q + k, sign * (turned + axis.dot(&self.by_q.angular(k))));
            g.add(var.qd + k, sign * axis.dot(&self.jac.angular(k)));
        }
    }
}

/// The arm and the ball at the release, for the rows at the release and for cuts.
pub(super) struct AtRelease {
    pub(super) throw: Throw,
    frames: Frames,
    ball: Pose,
    jac: Jacobian,
    /// What joint angles change of the twist.
    by_q: Jacobian,
    v: Vector3<f64>,
    w: Vector3<f64>,
}

impl AtRelease {
    pub(super) fn of(problem: &Problem<'_>, throw: &Throw) -> Self {
        let frames = problem.arm.fk(&throw.q_rad);
        let ball = problem.arm.ball(&frames);
        let jac = frames.jacobian(&ball.pos);
        let twist = jac * throw.qd_rad_s;
        let by_q = frames.twist_gradient(&jac, &throw.qd_rad_s);
        let (v, w) = (Vector3::new(twist[0], twist[1], twist[2]), Vector3::new(twist[3], twist[4], twist[5]));
        Self { throw: *throw, frames, ball, jac, by_q, v, w }
    }
}

/// The rows that need the arm's kinematics or dynamics at the release only.
pub(super) fn release_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    x: &Row,
    release: &AtRelease,
    sink: &mut S,
) {
    let AtRelease { throw, frames, ball, jac, by_q, v, w } = release;
    let (p, v, w) = (ball.pos, *v, *w);
    let axes = std::array::from_fn(|i| ball.rot.column(i).into());
    let aim = layout.aim(problem, x);
    let end = problem.flight.fly(&p, &v, throw.flight_s);
    let arriving = Arriving { end: &end, throw, by_q, jac };
    launch_rows(layout, &aim, &arriving, sink);
    direction_rows(problem, &Hand { frames, axes, jac, by_q, v, w }, sink);
    point_rows(problem, &p, jac, sink);
    arrival_rows(problem, &arriving, sink);
    opening_rows(problem, &aim, &arriving, sink);
    if !problem.options.current_over_motion {
        release_current_rows(problem, throw, frames, sink);
    }
}

/// Launch: where the ball is after the time of flight, over that time. In vacuum it is the velocity in excess of the one that
/// reaches the target.
fn launch_rows<S: Sink>(layout: &Layout, aim: &Aim, arriving: &Arriving<'_>, sink: &mut S) {
    let var = layout.variables();
    let Arriving { end, throw, by_q, jac } = arriving;
    let flight_s = throw.flight_s;
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
            for k in 0..jac.n() {
                let column = jac.linear(k);
                g.add(var.q + k, column[i] / flight_s + by_v0.dot(&by_q.linear(k)));
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
}

/// Throw along z of the release frame, and in the paper's form spin about it only.
fn direction_rows<S: Sink>(problem: &Problem<'_>, hand: &Hand<'_>, sink: &mut S) {
    let number = problem.numbers();
    let [x_rf, y_rf, z_rf] = &hand.axes;
    for (id, axis) in [(ACROSS, x_rf), (ACROSS + 1, y_rf)] {
        if sink.wants_eq(id) {
            sink.eq(id, axis.dot(&hand.v), |g| hand.add_velocity_along(g, axis, 1.0));
        }
    }
    if !problem.options.free_spin {
        for (id, axis) in [(TURNING, x_rf), (TURNING + 1, y_rf)] {
            if sink.wants_eq(id) {
                sink.eq(id, axis.dot(&hand.w), |g| hand.add_spin_along(g, axis, 1.0));
            }
        }
        let bounds = &problem.bounds.spin_rad_s;
        let spin = z_rf.dot(&hand.w);
        for (id, value, sign) in
            [(number.spin, spin - bounds.start(), 1.0), (number.spin + 1, bounds.end() - spin, -1.0)]
        {
            if value < WINDOW && sink.wants(id) {
                sink.ineq(id, value, |g| hand.add_spin_along(g, z_rf, sign));
            }
        }
    }
    let along = z_rf.dot(&hand.v);
    if along < 1.0 && sink.wants(number.along) {
        sink.ineq(number.along, along - 0.1, |g| hand.add_velocity_along(g, z_rf, 1.0));
    }
}

/// Limits where a scan of the motion has found them broken.
pub(super) fn cut_rows<S: Sink>(
    problem: &Problem<'_>,
    layout: &Layout,
    cuts: &[Cut],
    release: &AtRelease,
    sink: &mut S,
) {
    let AtRelease { throw, ball, jac, by_q, v, .. } = release;
    let context = CutContext { problem, throw, p0: ball.pos, v0: *v, jac, by_q };
    for (i, cut) in cuts.iter().enumerate().take(CUTS_MAX) {
        let id = problem.numbers().cut + i;
        if sink.wants(id) {
            let (value, gradient): (f64, Row) = cut.evaluate(&context, layout);
            sink.ineq(id, value, |g| {
                for (i, c) in gradient.iter().enumerate().take(layout.n) {
                    g.add(i, *c);
                }
            });
        }
    }
}

/// Spherical bounds of the release point.
fn point_rows<S: Sink>(problem: &Problem<'_>, p: &Vector3<f64>, jac: &Jacobian, sink: &mut S) {
    let var = problem.variables();
    let number = problem.numbers();
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
                for k in 0..jac.n() {
                    g.add(var.q + k, by_p.dot(&jac.linear(k)));
                }
            });
        }
    }
}

/// Window of arrival speed and steepness.
fn arrival_rows<S: Sink>(problem: &Problem<'_>, arriving: &Arriving<'_>, sink: &mut S) {
    let number = problem.numbers();
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
