//! Attitude of a thing at its arrival, by Euler's equations in small steps from the hand of the verifier's own chain.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::finding::Finding;
use crate::plan::file::{AttitudeInfo, DirectionInfo, PlanFile};

/// Step of the integration in s: Runge-Kutta of fourth order.
const STEP_S: f64 = 5e-4;
/// Distance in time of the two hands between which the angular velocity is the difference, in s.
const DIFFERENCE_S: f64 = 1e-5;

/// Overshoot of an angle that counts as kept, in rad, of a rate in rad/s; and difference of a told direction that counts as none.
const TOLERANCE: f64 = 1e-4;

/// A thing at its arrival.
#[derive(Debug, Clone, Copy)]
pub struct Arrival {
    /// Axis of symmetry, world.
    pub axis: Vector3<f64>,
    /// Angular momentum over the transverse moment of inertia in rad/s, world.
    pub momentum_rad_s: Vector3<f64>,
}

/// The thing `flight_s` after it has left a hand whose orientation at a time is `hand` (world).
#[must_use]
pub fn arrival(
    thing: &AttitudeInfo,
    hand: &dyn Fn(f64) -> Matrix3<f64>,
    release_s: f64,
    flight_s: f64,
) -> Arrival {
    let at = |t_s: f64| Rotation3::from_matrix_unchecked(hand(t_s));
    let (before, after) = (at(release_s - DIFFERENCE_S), at(release_s + DIFFERENCE_S));
    let omega_w = (after * before.inverse()).scaled_axis() / (2.0 * DIFFERENCE_S);
    // The body's frame: z is the axis of symmetry, x and y are any two across it.
    let axis_w = at(release_s) * Vector3::from(thing.axis_e);
    let across = if axis_w.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let body = UnitQuaternion::face_towards(&axis_w, &across);
    let (mut q, mut w) = (body.into_inner(), body.inverse() * omega_w);
    let steps = (flight_s / STEP_S).ceil().max(1.0);
    let h = flight_s / steps;
    for _ in 0..steps as usize {
        let a = rates(thing.inertia_ratio, &q, &w);
        let b = rates(thing.inertia_ratio, &(q + a.0 * (0.5 * h)), &(w + a.1 * (0.5 * h)));
        let c = rates(thing.inertia_ratio, &(q + b.0 * (0.5 * h)), &(w + b.1 * (0.5 * h)));
        let d = rates(thing.inertia_ratio, &(q + c.0 * h), &(w + c.1 * h));
        q += (a.0 + (b.0 + c.0) * 2.0 + d.0) * (h / 6.0);
        w += (a.1 + (b.1 + c.1) * 2.0 + d.1) * (h / 6.0);
    }
    let body = UnitQuaternion::new_normalize(q);
    let momentum = Vector3::new(w.x, w.y, thing.inertia_ratio * w.z);
    Arrival { axis: body * Vector3::z(), momentum_rad_s: body * momentum }
}

/// Change of orientation and angular velocity (body) per second: `q̇ = q ω / 2`, and Euler's equations without torque for the
/// moments of inertia 1, 1 and `ratio`.
fn rates(ratio: f64, q: &Quaternion<f64>, w: &Vector3<f64>) -> (Quaternion<f64>, Vector3<f64>) {
    let turning = q * Quaternion::from_imag(*w) * 0.5;
    (turning, Vector3::new((1.0 - ratio) * w.y * w.z, (ratio - 1.0) * w.z * w.x, 0.0))
}

/// Angle between a direction and the wanted one in rad; π for no direction.
#[must_use]
pub fn angle_rad(wanted: &DirectionInfo, direction: &Vector3<f64>) -> f64 {
    let length = direction.norm();
    if length < 1e-9 {
        return std::f64::consts::PI;
    }
    let cos = (direction.dot(&Vector3::from(wanted.direction_w)) / length).clamp(-1.0, 1.0);
    if wanted.either_sign { cos.abs().acos() } else { cos.acos() }
}

/// Whether the thing of a plan arrives as it was asked to, and as the plan tells. `flight_s` is the time of flight that the
/// verifier has found.
#[must_use]
pub fn findings(plan: &PlanFile, hand: &dyn Fn(f64) -> Matrix3<f64>, flight_s: Option<f64>) -> Vec<Finding> {
    let Some(thing) = &plan.target.attitude else { return Vec::new() };
    let Some(flight_s) = flight_s else {
        return vec![Finding::claimed(
            "attitude at the arrival",
            false,
            "the thing does not come down there".to_owned(),
        )];
    };
    let found = arrival(thing, hand, plan.release_time_s, flight_s);
    let mut findings = Vec::new();
    for (what, wanted, direction) in [
        ("arrival axis near its direction", &thing.axis, &found.axis),
        ("spin axis near its direction", &thing.spin, &found.momentum_rad_s),
    ] {
        let Some(wanted) = wanted else { continue };
        let angle = angle_rad(wanted, direction);
        findings.push(Finding::claimed(
            what,
            angle <= wanted.angle_max_rad + TOLERANCE,
            format!("{:.2} of {:.2} deg", angle.to_degrees(), wanted.angle_max_rad.to_degrees()),
        ));
    }
    if thing.spin.is_some() {
        let rate = found.momentum_rad_s.norm();
        findings.push(Finding::claimed(
            "rate of the spin",
            rate >= thing.spin_min_rad_s - TOLERANCE,
            format!("{rate:.3} of {:.3} rad/s", thing.spin_min_rad_s),
        ));
    }
    let told = &thing.arrival;
    let off = (Vector3::from(told.axis_w) - found.axis)
        .amax()
        .max((Vector3::from(told.momentum_rad_s) - found.momentum_rad_s).amax());
    findings.push(Finding::claimed(
        "attitude at the arrival is told as the motion has it",
        off <= TOLERANCE,
        format!("{off:.1e} (unit vector, rad/s) beside it"),
    ));
    findings
}
