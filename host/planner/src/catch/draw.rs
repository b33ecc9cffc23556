//! Throws that come by an arm, at random: free-spin releases of a thrower inside its limits.
//!
//! A point in the window, a flight time, a place of the release and a turn of the hand about the throw are drawn evenly. They give the
//! pose of the hand; a posture, joint rates (least use of the speed limits), run-up and stop of the two-cubic form follow. What
//! leaves a range, passes a limit, touches something or whose hand meets the ball again is drawn again.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector3};
use robot_model::collision::{CollisionChecker, Scene};
use robot_model::{Branch, Pose, RobotModel};

use super::Joints;
use crate::flight::FlightModel;
use crate::plan::rng::SplitMix64;
use crate::throw::Throw;

/// Where the ball passes, in the base frame of the arm that catches, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Distance before the base, m.
    pub x_m: f64,
    /// Most to both sides, m.
    pub y_m: f64,
    /// Lowest and highest, m.
    pub z_m: (f64, f64),
    /// Shortest and longest flight, s.
    pub flight_s: (f64, f64),
}

impl Default for Window {
    /// 0.65 m before the base, 0.3 m to both sides, up to 0.7 m high, 0.4 to 0.9 s.
    fn default() -> Self {
        Self { x_m: 0.65, y_m: 0.3, z_m: (0.0, 0.7), flight_s: (0.4, 0.9) }
    }
}

impl Window {
    /// The same place, for throws that fly for at least 0.55 s: those of a partner.
    pub fn high() -> Self {
        Self { flight_s: (0.55, 0.9), ..Self::default() }
    }
}

/// A throw of another arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aimed {
    /// The thrower's motion.
    pub throw: Throw,
    /// Centre of the ball at the release in the world, m.
    pub p_m: Vector3<f64>,
    /// Its velocity, m/s.
    pub v_m_s: Vector3<f64>,
    /// Time from the release to the window, s.
    pub flight_s: f64,
}

/// Share of the speed, acceleration and current limits that a throw uses at most.
const SHARE: (f64, f64, f64) = (0.95, 0.8, 0.95);
const STEP_S: f64 = 0.005;

/// Draws releases until one passes the window; `None` after `tries` of them.
pub fn draw(
    thrower: &RobotModel,
    x_wb: &Pose,
    catcher: &Pose,
    flight: &FlightModel,
    window: &Window,
    rng: &mut SplitMix64,
    tries: usize,
) -> Option<Aimed> {
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(thrower, &scene);
    let x_bw = x_wb.inverse();
    let x_cw = catcher.inverse();
    let shoulder = thrower.fk(&Joints::zeros(6)).origin(1);
    let x_be = thrower.gripper().x_eb.inverse();
    let gravity = flight.gravity_m_s2();
    for _ in 0..tries {
        let mut even = |low: f64, high: f64| low + (high - low) * rng.unit();
        let target_c =
            Vector3::new(window.x_m, even(-window.y_m, window.y_m), even(window.z_m.0, window.z_m.1));
        let target = x_bw.transform_point(&catcher.transform_point(&target_c));
        let flight_s = even(window.flight_s.0, window.flight_s.1);
        let ahead = (target.y - shoulder.y).atan2(target.x - shoulder.x);
        let (theta, phi, r) = (ahead + even(-1.4, 1.4), even(-1.2, 1.5), even(0.4, 1.05));
        let turn = even(-PI, PI);
        let which = (even(0.0, Branch::COUNT as f64)) as usize;
        let at = Vector3::new(phi.cos() * theta.cos(), phi.cos() * theta.sin(), phi.sin());
        let p = shoulder + at * r;
        let v = (target - p) / flight_s + Vector3::z() * (0.5 * gravity * flight_s);
        let (azimuth, polar) = (v.y.atan2(v.x), v.x.hypot(v.y).atan2(v.z));
        let turned = Pose::rot_z(azimuth) * Pose::rot_y(polar) * Pose::rot_z(turn);
        let x_bh = Pose::new(turned.rot, p);
        let Ok(solutions) = thrower.ik(&(x_bh * x_be)) else { return None };
        let Some(q) = Branch::from_index(which).and_then(|branch| solutions.get(branch)) else { continue };
        if !q.in_range {
            continue;
        }
        let frames = thrower.fk(&q.q);
        let Some((rates, most)) = fastest(thrower, &frames, &p, &(v / v.norm())) else { continue };
        if most < v.norm() {
            continue;
        }
        let (p_m, v_m_s) = (x_wb.transform_point(&p), x_wb.rot * v);
        let Some(flight_s) = passes(flight, &p_m, &v_m_s, &x_cw, window) else { continue };
        let Some(throw) = run_up(thrower, q.q, rates * v.norm(), flight_s) else { continue };
        if keeps_clear(thrower, &mut checker, &throw, flight, &p, &v) {
            return Some(Aimed { throw, p_m, v_m_s, flight_s });
        }
    }
    None
}

/// Joint rates for 1 m/s along `direction`, and the largest speed inside the limits.
fn fastest(
    arm: &RobotModel,
    frames: &robot_model::Frames,
    p: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<(Joints, f64)> {
    let limit = arm.limit(|l| l.v_max_rad_s);
    let columns: [Vector3<f64>; 6] = std::array::from_fn(|i| frames.axis(i).cross(&(p - frames.origin(i))));
    let mut m = Matrix3::zeros();
    for (column, v) in columns.iter().zip(limit.iter()) {
        m += column * column.transpose() * (v * v);
    }
    let lambda = m.cholesky()?.solve(direction);
    let rates = Joints::from_fn(6, |i| columns[i].dot(&lambda) * limit[i] * limit[i]);
    let most = rates.iter().zip(limit.iter()).map(|(r, v)| (r / v).abs()).fold(0.0, f64::max);
    (most > 1e-6).then(|| (rates, SHARE.0 / most))
}

/// When the ball passes the window.
fn passes(
    flight: &FlightModel,
    p_m: &Vector3<f64>,
    v_m_s: &Vector3<f64>,
    x_cw: &Pose,
    window: &Window,
) -> Option<f64> {
    let (when, at) = crosses(flight, p_m, v_m_s, x_cw, window)?;
    let inside = at.y.abs() <= window.y_m && at.z >= window.z_m.0 && at.z <= window.z_m.1;
    (inside && when >= window.flight_s.0 && when <= window.flight_s.1).then_some(when)
}

/// When (s after the release) and where (in the base frame of the catcher, m) a ball crosses the plane of the window first; `x_cw` is the
/// pose of the world in that frame. `None` if it does not before the longest flight ends.
#[must_use]
pub fn crosses(
    flight: &FlightModel,
    p_m: &Vector3<f64>,
    v_m_s: &Vector3<f64>,
    x_cw: &Pose,
    window: &Window,
) -> Option<(f64, Vector3<f64>)> {
    let (mut p, mut v) = (*p_m, *v_m_s);
    let mut before = x_cw.transform_point(&p);
    let mut t_s = 0.0;
    while t_s < window.flight_s.1 {
        (p, v) = flight.coast(&p, &v, STEP_S);
        let now = x_cw.transform_point(&p);
        if before.x > window.x_m && now.x <= window.x_m {
            let share = (before.x - window.x_m) / (before.x - now.x);
            return Some((t_s + STEP_S * share, before.lerp(&now, share)));
        }
        before = now;
        t_s += STEP_S;
    }
    None
}

/// Run-up and stop as short as accelerations and jerks allow; `None` if they leave a range.
fn run_up(arm: &RobotModel, q: Joints, qd: Joints, flight_s: f64) -> Option<Throw> {
    let mut phase_s = 0.1_f64;
    for (joint, rate) in arm.joints().iter().zip(qd.iter()) {
        let l = &joint.limits;
        phase_s = phase_s.max(2.0 * rate.abs() / (SHARE.1 * l.a_max_rad_s2.min(l.a_control_max_rad_s2)));
        phase_s = phase_s.max((2.0 * rate.abs() / l.j_max_rad_s3).sqrt());
    }
    let throw = Throw {
        q_rad: q,
        qd_rad_s: qd,
        qdd_rad_s2: Joints::zeros(6),
        flight_s,
        ha_s: phase_s,
        hb_s: phase_s,
    };
    let inside = arm.in_range(&throw.start(), -0.01) && arm.in_range(&throw.stop(), -0.01);
    inside.then_some(throw)
}

fn keeps_clear(
    arm: &RobotModel,
    checker: &mut CollisionChecker<'_>,
    throw: &Throw,
    flight: &FlightModel,
    p_b: &Vector3<f64>,
    v_b: &Vector3<f64>,
) -> bool {
    let steps = (throw.duration_s() / 0.01).ceil() as usize;
    let radius_m = arm.gripper().ball_radius_m;
    let (mut p, mut v) = (*p_b, *v_b);
    let mut since_s = 0.0;
    for k in 0..=steps {
        let t_s = throw.duration_s() * k as f64 / steps as f64;
        let at = throw.at_time(t_s);
        let frames = arm.fk(&at.q);
        if checker.collides(&frames) {
            return false;
        }
        let tau = arm.inverse_dynamics(&at.q, &at.qd, &at.qdd);
        let (Some(drives), Some(motor_a)) = (arm.drives(), arm.motor_currents(&at.qd, &tau)) else {
            return false;
        };
        let too_much = drives.iter().zip(motor_a.iter()).any(|(d, a)| a.abs() > d.current_max_a * SHARE.2)
            || arm
                .supplies()
                .iter()
                .zip(arm.supply_currents(&motor_a))
                .any(|(s, a)| a > s.current_max_a * SHARE.2);
        if too_much {
            return false;
        }
        let after_s = t_s - throw.ha_s;
        if after_s > 0.02 && after_s < 0.3 {
            (p, v) = flight.coast(&p, &v, after_s - since_s);
            since_s = after_s;
            let near =
                checker.placed_boxes().iter().any(|b| (b.nearest_point(&p) - p).norm() < radius_m + 0.003);
            if near {
                return false;
            }
        }
    }
    true
}

/// The release of a throw that opens `late_s` after its time.
#[must_use]
pub fn released(arm: &RobotModel, x_wb: &Pose, throw: &Throw, late_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let at = throw.at_time(throw.ha_s + late_s);
    let frames = arm.fk(&at.q);
    let p = arm.ball(&frames).pos;
    let v: Vector3<f64> = (0..6).map(|i| frames.axis(i).cross(&(p - frames.origin(i))) * at.qd[i]).sum();
    (x_wb.transform_point(&p), x_wb.rot * v)
}

/// Covariance of position and velocity at the plan's release time if the ball leaves with a standard deviation of `delay_s` in time and `share` of
/// its speed in each direction: 6×6, position first.
#[must_use]
pub fn scatter(
    arm: &RobotModel,
    x_wb: &Pose,
    throw: &Throw,
    delay_s: f64,
    share: f64,
    hand_m: f64,
) -> nalgebra::SMatrix<f64, 6, 6> {
    let step_s = 1e-3;
    let (p0, v0) = released(arm, x_wb, throw, -step_s);
    let (p1, v1) = released(arm, x_wb, throw, step_s);
    let g = Vector3::new(0.0, 0.0, -arm.world().gravity_m_s2);
    // A ball that leaves dt later flies with the hand's velocity of then, seen back at the plan's time.
    let dv = (v1 - v0) / (2.0 * step_s) - g;
    let dp = (p1 - p0) / (2.0 * step_s) - 0.5 * (v0 + v1);
    let mut by_delay = nalgebra::SVector::<f64, 6>::zeros();
    by_delay.fixed_rows_mut::<3>(0).copy_from(&dp);
    by_delay.fixed_rows_mut::<3>(3).copy_from(&dv);
    let mut out = by_delay * by_delay.transpose() * (delay_s * delay_s);
    let speed = 0.5 * (v0 + v1).norm() * share;
    for i in 0..3 {
        out[(i, i)] += hand_m * hand_m;
        out[(i + 3, i + 3)] += speed * speed;
    }
    out
}

#[cfg(test)]
mod tests {
    use robot_model::RobotModel;

    use super::*;

    #[test]
    fn drawn_throws_pass_the_window_and_keep_the_throwers_limits() {
        let arm = RobotModel::load("powercube6").unwrap();
        let catcher = Pose::from_rpy([0.0, 0.0, PI], Vector3::new(2.5, 0.0, 0.0));
        let flight = FlightModel::vacuum(9.81).unwrap().with_drag(0.0284).unwrap();
        let window = Window::default();
        let mut rng = SplitMix64::new(1);
        for _ in 0..5 {
            let aimed = draw(&arm, &Pose::identity(), &catcher, &flight, &window, &mut rng, 300_000).unwrap();
            let (p, v) = released(&arm, &Pose::identity(), &aimed.throw, 0.0);
            assert!((p - aimed.p_m).norm() < 1e-9 && (v - aimed.v_m_s).norm() < 1e-9);
            let (at, _) = flight.coast(&p, &v, aimed.flight_s);
            assert!((at.x - 1.85).abs() < 2e-3 && at.y.abs() < 0.3 && (-0.01..0.71).contains(&at.z), "{at}");
            for k in 0..=400 {
                let state = aimed.throw.at_time(aimed.throw.duration_s() * f64::from(k) / 400.0);
                for (i, joint) in arm.joints().iter().enumerate() {
                    let l = &joint.limits;
                    assert!(state.q[i] >= l.q_min_rad && state.q[i] <= l.q_max_rad);
                    assert!(state.qd[i].abs() <= l.v_max_rad_s && state.qdd[i].abs() <= l.a_max_rad_s2);
                }
            }
        }
    }

    /// A ball let go late leaves elsewhere: the covariance of a delay is that of the differences.
    #[test]
    fn scatter_of_the_delay_is_that_of_late_releases() {
        let arm = RobotModel::load("powercube6").unwrap();
        let catcher = Pose::from_rpy([0.0, 0.0, PI], Vector3::new(2.5, 0.0, 0.0));
        let flight = FlightModel::vacuum(9.81).unwrap();
        let mut rng = SplitMix64::new(2);
        let world = Pose::identity();
        let aimed = draw(&arm, &world, &catcher, &flight, &Window::default(), &mut rng, 300_000).unwrap();
        let covariance = scatter(&arm, &world, &aimed.throw, 0.005, 0.0, 0.0);
        let (p, v) = released(&arm, &world, &aimed.throw, 0.005);
        let back = flight.coast(&p, &v, -0.005);
        let off = back.0 - aimed.p_m;
        let off_v = back.1 - aimed.v_m_s;
        for i in 0..3 {
            assert!((covariance[(i, i)].sqrt() - off[i].abs()).abs() < 4e-4, "{covariance} {off}");
            assert!(
                (covariance[(i + 3, i + 3)].sqrt() - off_v[i].abs()).abs() < 1e-2,
                "{covariance} {off_v}"
            );
        }
    }
}
