//! How a thing with an axis of symmetry arrives: where its axis points then, and about what it rotates.
//!
//! It leaves with the attitude and the angular velocity of the hand, and turns without torque until it is at the target.

use nalgebra::Vector3;
use robot_model::{Frames, RobotModel};

use super::disturbed::{Disturbed, drawn_flight};
use super::options::{Attitude, Cone, Noise};
use super::problem::Problem;
use super::rng::SplitMix64;
use super::spread::{DragFlights, THREE, release_delays};
use crate::flight::{FlightModel, Precession};
use crate::throw::{JointState, Throw};

/// A thing at its arrival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrived {
    /// Axis of symmetry, unit vector, world.
    pub axis_w: Vector3<f64>,
    /// Angular momentum over the transverse moment of inertia in rad/s, world; as at the release.
    pub momentum_rad_s: Vector3<f64>,
}

impl Arrived {
    /// Direction of the angular momentum, world; `None` for a thing that does not rotate.
    #[must_use]
    pub fn spin_axis_w(&self) -> Option<Vector3<f64>> {
        self.momentum_rad_s.try_normalize(1e-9)
    }

    /// Angles between what is asked for and what is, in rad: of the axis, and of the angular momentum.
    #[must_use]
    pub fn angles_rad(&self, attitude: &Attitude) -> [Option<f64>; 2] {
        let spin_axis = self.spin_axis_w();
        [
            attitude.axis.map(|cone| angle_to(&cone, &self.axis_w).0),
            attitude.spin.map(|cone| spin_axis.map_or(std::f64::consts::PI, |axis| angle_to(&cone, &axis).0)),
        ]
    }

    /// By how much the angles are larger than asked for, in rad: the larger excess; below zero if none is.
    #[must_use]
    pub fn excess_rad(&self, attitude: &Attitude) -> f64 {
        let cones = [attitude.axis, attitude.spin];
        let angles = self.angles_rad(attitude);
        let over = angles.iter().zip(cones).filter_map(|(angle, cone)| Some((*angle)? - cone?.angle_max_rad));
        over.fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Angle in rad between a direction and the wanted one, or its opposite if that is as good and nearer; and the one of the two
/// that is taken, a unit vector.
pub(crate) fn angle_to(cone: &Cone, direction: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let wanted = cone.direction_w.normalize();
    let wanted = if cone.either_sign && wanted.dot(direction) < 0.0 { -wanted } else { wanted };
    (angle_between(&wanted, direction), wanted)
}

fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// Rotation of the thing from its release on, out of a hand at `frames` that rotates with `omega_rad_s` (world).
pub(crate) fn release_rotation<const N: usize>(
    arm: &RobotModel<N>,
    attitude: &Attitude,
    frames: &Frames<N>,
    omega_rad_s: &Vector3<f64>,
) -> Precession {
    let axis_w = arm.ee(frames).rot * attitude.axis_e.normalize();
    Precession::new(&axis_w, omega_rad_s, attitude.inertia_ratio)
}

/// The thing of a throw whose release is `delay_s` late (early if negative), where it meets the plane of the target; `None`
/// if no attitude is known of it, or it does not meet that plane.
#[must_use]
pub fn arrived_with_delay<const N: usize>(
    problem: &Problem<'_, N>,
    throw: &Throw<N>,
    delay_s: f64,
) -> Option<Arrived> {
    arrived(problem, &problem.flight, &throw.at_time(throw.ha_s + delay_s), delay_s)
}

/// The thing at the target, released in a joint state `delay_s` after the planned release.
fn arrived<const N: usize>(
    problem: &Problem<'_, N>,
    flight: &FlightModel,
    state: &JointState<N>,
    delay_s: f64,
) -> Option<Arrived> {
    let attitude = problem.options.attitude.as_ref()?;
    let arm = problem.arm;
    let frames = arm.fk(&state.q);
    let p = arm.ball(&frames).pos;
    let twist = frames.jacobian(&p) * state.qd;
    let (v, omega) = (Vector3::new(twist[0], twist[1], twist[2]), Vector3::new(twist[3], twist[4], twist[5]));
    let landed = flight.meet(&p, &v, &problem.aim, delay_s)?;
    let released = release_rotation(arm, attitude, &frames, &omega);
    Some(Arrived { axis_w: released.axis_at(landed.time_s), momentum_rad_s: released.momentum_rad_s })
}

/// How far axis and axis of rotation are turned at the arrival when the release is late or early, in rad: the larger of the two
/// sides. The second is `None` for a thing that does not rotate.
#[must_use]
pub fn turn_by_delay<const N: usize>(
    problem: &Problem<'_, N>,
    throw: &Throw<N>,
    delay_s: f64,
) -> Option<(f64, Option<f64>)> {
    let on_time = arrived_with_delay(problem, throw, 0.0)?;
    let sides = [arrived_with_delay(problem, throw, delay_s)?, arrived_with_delay(problem, throw, -delay_s)?];
    let axis = sides.iter().map(|side| angle_between(&side.axis_w, &on_time.axis_w)).fold(0.0, f64::max);
    let spin = sides.iter().map(|side| Some(angle_between(&side.spin_axis_w()?, &on_time.spin_axis_w()?)));
    Some((axis, spin.collect::<Option<Vec<f64>>>().map(|turns| turns.into_iter().fold(0.0, f64::max))))
}

/// Spread of the arrival: root mean square angle in rad between a direction and its mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeSpread {
    /// Of the axis of symmetry.
    pub axis_rad: f64,
    /// Of the axis of rotation; `None` for a thing that does not rotate.
    pub spin_rad: Option<f64>,
}

/// Predicts the spread from the noise of a throw, as the landing's is predicted: every source alone at the nodes of an
/// integration rule. Angles are taken as small. `None` if the thing does not meet the plane of the target at some node.
#[must_use]
pub fn predict_attitude<const N: usize>(
    problem: &Problem<'_, N>,
    throw: &Throw<N>,
    noise: &Noise,
) -> Option<AttitudeSpread> {
    let flight = &problem.flight;
    let release = throw.at_time(throw.ha_s);
    let centre = arrived(problem, flight, &release, 0.0)?;
    let mut sources: Vec<Vec<(f64, Arrived)>> = Vec::with_capacity(2 + 2 * N);
    let delays = release_delays(noise);
    if !delays.is_empty() {
        let nodes = delays
            .into_iter()
            .map(|(delay_s, weight)| Some((weight, arrived_with_delay(problem, throw, delay_s)?)));
        sources.push(nodes.collect::<Option<_>>()?);
    }
    for j in 0..N {
        for (q_rad, qd_rad_s) in [(noise.position_rad, 0.0), (0.0, noise.speed_rad_s)] {
            let nodes = THREE.iter().map(|(node, weight)| {
                let mut moved = release;
                moved.q[j] += node * q_rad;
                moved.qd[j] += node * qd_rad_s;
                Some((*weight, arrived(problem, flight, &moved, 0.0)?))
            });
            sources.push(nodes.collect::<Option<_>>()?);
        }
    }
    let drag = DragFlights::of(flight, noise)?.nodes;
    if !drag.is_empty() {
        let nodes =
            drag.iter().map(|(weight, flight)| Some((*weight, arrived(problem, flight, &release, 0.0)?)));
        sources.push(nodes.collect::<Option<_>>()?);
    }
    // The spread about the mean: second moment less the square of the shift.
    let variance = |direction: &dyn Fn(&Arrived) -> Option<Vector3<f64>>| -> Option<f64> {
        let middle = direction(&centre)?;
        let mut sum = 0.0;
        for source in &sources {
            let (mut shift, mut second) = (Vector3::zeros(), 0.0);
            for (weight, arrived) in source {
                let off = direction(arrived)? - middle;
                shift += off * *weight;
                second += weight * off.norm_squared();
            }
            sum += (second - shift.norm_squared()).max(0.0);
        }
        Some(sum)
    };
    Some(AttitudeSpread {
        axis_rad: variance(&|a| Some(a.axis_w))?.sqrt(),
        spin_rad: variance(&Arrived::spin_axis_w).map(f64::sqrt),
    })
}

/// Arrivals of `draws` disturbed throws: the full model. The oracle of [`predict_attitude`].
#[must_use]
pub fn monte_carlo_attitude<const N: usize>(
    problem: &Problem<'_, N>,
    throw: &Throw<N>,
    noise: &Noise,
    draws: usize,
    seed: u64,
) -> Vec<Arrived> {
    let mut rng = SplitMix64::new(seed);
    (0..draws)
        .filter_map(|_| {
            let off = Disturbed::drawn(noise, &mut rng);
            let flight = drawn_flight(&problem.flight, noise, &mut rng)?;
            arrived(problem, &flight, &off.at_release(throw), off.delay_s)
        })
        .collect()
}
