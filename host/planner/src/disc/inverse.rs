//! Levenberg-Marquardt inverse kinematics of paper 001.
//!
//! Lengths are centimetres here: the paper starts with λ0 = 100 and stops at 10⁻³, and λ has the unit of the
//! Jacobian. Eq. (11) lacks the inverse: δq = (JᵀJ + λ²I)⁻¹ Jᵀ e. λ falls by β while the error falls; if the error
//! rises, the step is undone and λ rises by β (the usual rule; the paper only says that λ stops falling).

use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector3};

use super::Joints;
use super::arm::DiscArm;

/// Parameters of the iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// First penalty λ0, cm/rad.
    pub lambda0: f64,
    /// Factor β between penalties.
    pub beta: f64,
    /// Largest pose error that ends the iteration, cm (radians count as cm in the full form).
    pub tolerance: f64,
    /// Largest number of iterations.
    pub iterations_max: u32,
}

impl Default for Settings {
    /// The paper's λ0 = 100, β = 2, tolerance 10⁻³; it names no largest number of iterations.
    fn default() -> Self {
        Self { lambda0: 100.0, beta: 2.0, tolerance: 1e-3, iterations_max: 400 }
    }
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ended<const N: usize> {
    /// Angles of the joints that were solved for, rad.
    pub q: SVector<f64, N>,
    /// Iterations used.
    pub iterations: u32,
    /// Norm of the pose error at the end, cm.
    pub error: f64,
    /// Whether the error is within the tolerance; otherwise `q` is the best that was found.
    pub reached: bool,
}

/// Minimises |error(q)| by eq. (11) from `q`; `step` solves `(JᵀJ + λ²I) δ = Jᵀ e`.
fn iterate<const N: usize, const M: usize>(
    settings: &Settings,
    mut q: SVector<f64, N>,
    error: impl Fn(&SVector<f64, N>) -> SVector<f64, M>,
    step: impl Fn(&SVector<f64, N>, &SVector<f64, M>, f64) -> Option<SVector<f64, N>>,
) -> Ended<N> {
    let mut lambda = settings.lambda0;
    let mut e = error(&q);
    let mut iterations = 0;
    while e.norm() > settings.tolerance && iterations < settings.iterations_max {
        iterations += 1;
        let next = step(&q, &e, lambda).map(|delta| q + delta);
        let better = next.map(|q| (q, error(&q))).filter(|(_, n)| n.norm() < e.norm());
        match better {
            Some(better) => {
                (q, e) = better;
                lambda /= settings.beta;
            }
            // The best point is reached to rounding, or a penalty is needed that no step passes.
            None if lambda > 1e9 => break,
            None => lambda *= settings.beta,
        }
    }
    Ended { q: q.map(wrapped), iterations, error: e.norm(), reached: e.norm() <= settings.tolerance }
}

/// The angle in [-π, π], to which the paper constrains its result.
#[must_use]
pub fn wrapped(angle_rad: f64) -> f64 {
    let turned = angle_rad - (angle_rad / std::f64::consts::TAU).round() * std::f64::consts::TAU;
    turned.clamp(-std::f64::consts::PI, std::f64::consts::PI)
}

/// Position and roll, pitch, yaw of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandPose {
    /// Terminal point, m.
    pub point_m: Vector3<f64>,
    /// Fixed-axis roll, pitch, yaw, rad.
    pub rpy_rad: [f64; 3],
}

/// Full form, eq. (6)-(11): all four joints to a pose of the hand.
///
/// Four joints cannot reach every pose; `reached` is then false.
#[must_use]
pub fn full(arm: &DiscArm, wanted: &HandPose, from: &Joints, settings: &Settings) -> Ended<4> {
    let to_cm = SMatrix::<f64, 6, 6>::from_diagonal(&SVector::from([100.0, 100.0, 100.0, 1.0, 1.0, 1.0]));
    iterate(
        settings,
        *from,
        |q| {
            let off = (wanted.point_m - arm.terminal_point(q)) * 100.0;
            let rpy = arm.rpy_rad(q);
            let turn = |k: usize| wrapped(wanted.rpy_rad[k] - rpy[k]);
            SVector::<f64, 6>::from([off.x, off.y, off.z, turn(0), turn(1), turn(2)])
        },
        |q, e, lambda| {
            let j = to_cm * arm.rpy_jacobian(q)?;
            let normal: Matrix4<f64> = j.tr_mul(&j) + Matrix4::identity() * (lambda * lambda);
            normal.cholesky().map(|c| c.solve(&j.tr_mul(e)))
        },
    )
}

/// Reduced form, eq. (12)-(13): θ2 and θ3 to a place of axis 4, which is `(out, up)` from axis 2, in m.
#[must_use]
pub fn reduced(arm: &DiscArm, wanted_m: &Vector2<f64>, from: &Vector2<f64>, settings: &Settings) -> Ended<2> {
    let (upper, fore) = (arm.size.upper_m * 100.0, arm.size.fore_m * 100.0);
    let place = |q: &Vector2<f64>| {
        let (s2, c2) = q[0].sin_cos();
        let (s23, c23) = (q[0] + q[1]).sin_cos();
        Vector2::new(-upper * s2 - fore * s23, upper * c2 + fore * c23)
    };
    iterate(
        settings,
        *from,
        |q| wanted_m * 100.0 - place(q),
        |q, e, lambda| {
            let j = reduced_jacobian(upper, fore, q);
            let normal: Matrix2<f64> = j.tr_mul(&j) + Matrix2::identity() * (lambda * lambda);
            normal.cholesky().map(|c| c.solve(&j.tr_mul(e)))
        },
    )
}

/// Eq. (13): rates of θ2, θ3 to the rate of axis 4 outwards and upwards; unit of the lengths.
#[must_use]
pub fn reduced_jacobian(upper: f64, fore: f64, q: &Vector2<f64>) -> Matrix2<f64> {
    let (s2, c2) = q[0].sin_cos();
    let (s23, c23) = (q[0] + q[1]).sin_cos();
    Matrix2::new(-upper * c2 - fore * c23, -fore * c23, -upper * s2 - fore * s23, -fore * s23)
}
