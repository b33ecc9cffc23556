//! The release from the measured motion: where the ball leaves the hand, where it lands, and with which uncertainty.

use nalgebra::{Matrix2, Vector2, Vector3};
use serde::Serialize;

use super::Run;
use super::collect::{Heard, Reading};
use super::tracking::{HALF_WINDOW_S, JointTracking, SIDE_MIN, Sample, line};
use planner::flight::FlightModel;
use planner::motion::Motion;
use planner::plan::file::PlanFile;
use planner::throw::Joints;

/// Standard deviations of a normal distribution within which 99 % lie.
const SIGMAS_99: f64 = 2.575_829_303_548_901;
/// Square of the same distance in two dimensions.
const CHI_SQUARE_99: f64 = 9.210_340_371_976_18;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReleaseMotion {
    /// When the ball was free, in time of the plan, s.
    pub t_s: f64,
    /// Ball in the hand, m.
    pub position_m: [f64; 3],
    pub velocity_m_s: [f64; 3],
    /// Where a ball released so lands, m.
    pub landing_m: Option<[f64; 3]>,
    /// Distance of that point from the target, m.
    pub landing_error_m: Option<f64>,
    /// 99 % of the balls with such a release land within this distance of that point, m: gripper time and drag vary
    /// as in the plan, joints and speeds by the scatter of their readings.
    pub landing_uncertainty_m: Option<f64>,
    /// When the gripper was ordered to open, in time of the plan, s; `None` if the order is not on the bus.
    pub gripper_ordered_t_s: Option<f64>,
}

/// Ball and landing from the measured motion; `None` if nothing is thrown or a joint was not heard on both sides of the release.
///
/// The ball is free the gripper's opening time after the order on the bus; if one of them is not known, at the planned time.
#[must_use]
pub fn release(run: &Run<'_>, joints: &[JointTracking], heard: &Heard) -> Option<ReleaseMotion> {
    let plan = run.throw?;
    let gripper_ordered_t_s = heard
        .gripper_ordered_t_s
        .iter()
        .copied()
        .filter(|t_s| (0.0..=plan.end_time_s).contains(t_s))
        .min_by(|a, b| (a - plan.release_time_s).abs().total_cmp(&(b - plan.release_time_s).abs()));
    let t_s = gripper_ordered_t_s
        .zip(run.gripper_opening)
        .map_or(plan.release_time_s, |(ordered, opening)| ordered + opening.as_secs_f64());
    let (state, scatter) = state_at(run.motion, joints, t_s)?;
    let (p, v) = hand(run, &state);
    let landing = land(run, &state, t_s, 0.0);
    let aim = plan.target.aim();
    Some(ReleaseMotion {
        t_s,
        position_m: p.into(),
        velocity_m_s: v.into(),
        landing_m: landing.map(|(p, _)| p.into()),
        landing_error_m: landing.map(|(_, at)| (at - aim.centre()).norm()),
        landing_uncertainty_m: landing
            .and_then(|(_, at)| uncertainty_m(run, joints, (t_s, &state, &scatter), at)),
        gripper_ordered_t_s,
    })
}

/// Angles and speeds of all joints.
#[derive(Clone, Copy)]
struct State {
    q_rad: Joints,
    qd_rad_s: Joints,
}

/// Measured state at `t_s`, and its standard errors.
fn state_at(motion: &Motion, joints: &[JointTracking], t_s: f64) -> Option<(State, State)> {
    let reference = motion.at(t_s);
    let zero = Joints::zeros(reference.q.len());
    let zero = State { q_rad: zero, qd_rad_s: zero };
    let (mut state, mut scatter) = (zero, zero);
    for (j, joint) in joints.iter().enumerate() {
        let error = error_at(&joint.samples, t_s)?;
        state.q_rad[j] = reference.q[j] - error.rad;
        state.qd_rad_s[j] = reference.qd[j] - error.rad_s;
        scatter.q_rad[j] = error.sigma_rad;
        scatter.qd_rad_s[j] = error.sigma_rad_s;
    }
    Some((state, scatter))
}

/// Point and velocity of the ball in the hand.
fn hand(run: &Run<'_>, state: &State) -> (Vector3<f64>, Vector3<f64>) {
    let frames = run.arm.fk(&state.q_rad);
    let p = run.arm.ball(&frames).pos;
    let twist = frames.jacobian(&p) * state.qd_rad_s;
    (p, Vector3::new(twist[0], twist[1], twist[2]))
}

/// Landing of a ball that is released in `state` at `t_s`, with `more_drag_per_m` beside the plan's: the point, and its
/// coordinates on the plane of the target.
fn land(
    run: &Run<'_>,
    state: &State,
    t_s: f64,
    more_drag_per_m: f64,
) -> Option<(Vector3<f64>, Vector2<f64>)> {
    let (p, v) = hand(run, state);
    let plan = run.throw?;
    let flight = flight(plan)?;
    let flight = flight.with_drag(flight.drag_per_m() + more_drag_per_m).ok()?;
    let (aim, since_s) = (plan.target.aim(), t_s - plan.release_time_s);
    let landing = flight.meet(&p, &v, &aim, since_s)?;
    Some((landing.p, aim.coordinates(&landing.p, since_s + landing.time_s)))
}

/// 99 % radius about the computed landing. The gripper's time is not small compared with the curvature of the path,
/// so the largest shift between its 99 % bounds counts; the other sources are linear.
fn uncertainty_m(
    run: &Run<'_>,
    joints: &[JointTracking],
    (t_s, state, scatter): (f64, &State, &State),
    landing: Vector2<f64>,
) -> Option<f64> {
    let noise = &run.throw?.landing.noise;
    let shift = |moved: Option<(Vector3<f64>, Vector2<f64>)>| moved.map(|(_, at)| at - landing);
    let mut by_time_m = 0.0_f64;
    for steps in -2..=2 {
        let t_s = t_s + 0.5 * f64::from(steps) * SIGMAS_99 * noise.release_time_s;
        let (moved, _) = state_at(run.motion, joints, t_s)?;
        by_time_m = by_time_m.max(shift(land(run, &moved, t_s, 0.0))?.norm());
    }
    let mut covariance_m2 = Matrix2::zeros();
    let mut add = |off: Vector2<f64>| covariance_m2 += off * off.transpose();
    for j in 0..joints.len() {
        let mut moved = *state;
        moved.q_rad[j] += scatter.q_rad[j];
        add(shift(land(run, &moved, t_s, 0.0))?);
        let mut moved = *state;
        moved.qd_rad_s[j] += scatter.qd_rad_s[j];
        add(shift(land(run, &moved, t_s, 0.0))?);
    }
    add(shift(land(run, state, t_s, noise.drag_per_m))?);
    let others_m = (CHI_SQUARE_99 * covariance_m2.symmetric_eigenvalues().max().max(0.0)).sqrt();
    Some(by_time_m.hypot(others_m))
}

/// Error of a joint and its rate, with their standard errors.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ErrorAt {
    rad: f64,
    rad_s: f64,
    sigma_rad: f64,
    sigma_rad_s: f64,
}

/// Error and its rate at `t_s` on the least-squares line through the samples around: finer than the steps of a
/// drive. `None` unless there are [`SIDE_MIN`] samples on both sides.
fn error_at(samples: &[Sample], t_s: f64) -> Option<ErrorAt> {
    let middle = samples.partition_point(|sample| sample.t_s < t_s);
    let near = |sample: &&Sample| (sample.t_s - t_s).abs() <= HALF_WINDOW_S;
    let before = samples[..middle].iter().rev().take_while(near).count().max(SIDE_MIN);
    let after = samples[middle..].iter().take_while(near).count().max(SIDE_MIN);
    let window = samples.get(middle.checked_sub(before)?..middle + after)?;
    let readings: Vec<Reading> =
        window.iter().map(|sample| Reading { t_s: sample.t_s, value: sample.error_rad }).collect();
    let (mean_t_s, mean, slope) = line(&readings)?;
    let n = readings.len() as f64;
    let square = |r: &Reading| (r.value - mean - slope * (r.t_s - mean_t_s)).powi(2);
    let variance = readings.iter().map(square).sum::<f64>() / (n - 2.0).max(1.0);
    let tt: f64 = readings.iter().map(|r| (r.t_s - mean_t_s).powi(2)).sum();
    Some(ErrorAt {
        rad: mean + slope * (t_s - mean_t_s),
        rad_s: slope,
        sigma_rad: (variance / n).sqrt(),
        sigma_rad_s: (variance / tt).sqrt(),
    })
}

/// The flight that the plan reckons with.
#[must_use]
pub fn flight(plan: &PlanFile) -> Option<FlightModel> {
    FlightModel::vacuum(plan.landing.gravity_m_s2)
        .and_then(|f| f.with_drag(plan.landing.drag_per_m))
        .and_then(|f| f.with_magnus(Vector3::from(plan.landing.magnus_rad_s)))
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_between_samples_is_finer_than_the_steps_in_which_it_is_measured() {
        let step = 0.02_f64.to_radians();
        let reading = |t_s: f64| {
            let q_rad = ((1.0 + 2.0 * t_s) / step).round() * step;
            let (q_ref_rad, qd_ref_rad_s) = (1.002 + 2.01 * t_s, 2.01);
            let error_rad = q_ref_rad - q_rad;
            Sample { t_s, q_rad, qd_rad_s: 2.0, q_ref_rad, qd_ref_rad_s, error_rad, error_rad_s: 0.0 }
        };
        let samples: Vec<Sample> = (0..300).map(|i| reading(0.003 * f64::from(i))).collect();
        let error = error_at(&samples, 0.4).unwrap();
        assert!((error.rad - 6e-3).abs() < 1e-4, "{error:?}");
        assert!((error.rad_s - 0.01).abs() < 4e-3, "{error:?}");
        // Steps of 0.02° scatter with 0.02° / √12; 16 readings over 50 ms remain.
        assert!((1e-5..6e-5).contains(&error.sigma_rad), "{error:?}");
        assert!((1e-3..4e-3).contains(&error.sigma_rad_s), "{error:?}");
        // One sample before, or none after, is too little.
        assert_eq!(error_at(&samples, 0.002), None);
        assert_eq!(error_at(&samples, 9.0), None);
    }
}
