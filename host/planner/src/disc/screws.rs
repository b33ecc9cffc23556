//! Kinematics by product of exponentials, from the unit twists that section 2.1 of paper 001 prints.
//!
//! Shares nothing with the DH table: joint axes as screws in the base frame, motion by matrix exponentials. The screws
//! bend the arm about x where the DH table at θ1 = 0 bends it about -y, so θ1 of the DH table is θ1 of the screws plus
//! 90°; [`pose`] and [`jacobian`] take angles of the DH table.

use nalgebra::{Matrix3, Matrix4, Vector3};

use super::arm::Size;
use super::{HandJacobian, Joints};

/// A unit twist (ω, v) of pitch zero: axis direction and velocity of the point at the origin, m/rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Screw {
    /// Direction of the axis.
    pub omega: Vector3<f64>,
    /// `-ω × p` for a point p on the axis.
    pub v: Vector3<f64>,
}

/// The four printed twists: (0,0,1,0,0,0) and (1,0,0,0,h,0) at the heights h of the axes.
#[must_use]
pub fn printed(size: &Size) -> [Screw; 4] {
    let level = |height_m: f64| Screw { omega: Vector3::x(), v: Vector3::new(0.0, height_m, 0.0) };
    let base = size.base_m;
    [
        Screw { omega: Vector3::z(), v: Vector3::zeros() },
        level(base),
        level(base + size.upper_m),
        level(base + size.upper_m + size.fore_m),
    ]
}

/// Rigid motion by an angle about a screw (Rodrigues).
#[must_use]
pub fn exponential(screw: &Screw, angle_rad: f64) -> Matrix4<f64> {
    let (s, c) = angle_rad.sin_cos();
    let hat = screw.omega.cross_matrix();
    let rot = Matrix3::identity() + hat * s + hat * hat * (1.0 - c);
    let left = Matrix3::identity() * angle_rad + hat * (1.0 - c) + hat * hat * (angle_rad - s);
    let mut out: Matrix4<f64> = Matrix4::identity();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(&rot);
    out.fixed_view_mut::<3, 1>(0, 3).copy_from(&(left * screw.v));
    out
}

fn angles(q: &Joints) -> [f64; 4] {
    [q[0] - std::f64::consts::FRAC_PI_2, q[1], q[2], q[3]]
}

/// Pose of the terminal frame in the world.
#[must_use]
pub fn pose(size: &Size, q: &Joints) -> Matrix4<f64> {
    let mut out: Matrix4<f64> = Matrix4::identity();
    for (screw, angle) in printed(size).iter().zip(angles(q)) {
        out *= exponential(screw, angle);
    }
    // Straight up at zero; the frame's x is up, its z is the axis of the bends.
    let top = size.base_m + size.upper_m + size.fore_m + size.hand_m;
    #[rustfmt::skip]
    let rest = Matrix4::new(
        0.0,  0.0, 1.0, 0.0,
        0.0, -1.0, 0.0, 0.0,
        1.0,  0.0, 0.0, top,
        0.0,  0.0, 0.0, 1.0,
    );
    out * rest
}

/// Jacobian of the terminal point: twists carried along by the joints before them, then moved from the origin to the
/// point.
#[must_use]
pub fn jacobian(size: &Size, q: &Joints) -> HandJacobian {
    let point: Vector3<f64> = pose(size, q).fixed_view::<3, 1>(0, 3).into_owned();
    let mut carried: Matrix4<f64> = Matrix4::identity();
    let mut out = HandJacobian::zeros();
    for (i, (screw, angle)) in printed(size).iter().zip(angles(q)).enumerate() {
        let rot: Matrix3<f64> = carried.fixed_view::<3, 3>(0, 0).into_owned();
        let pos: Vector3<f64> = carried.fixed_view::<3, 1>(0, 3).into_owned();
        let omega = rot * screw.omega;
        let v = rot * screw.v + pos.cross(&omega);
        out.fixed_view_mut::<3, 1>(0, i).copy_from(&(v + omega.cross(&point)));
        out.fixed_view_mut::<3, 1>(3, i).copy_from(&omega);
        carried *= exponential(screw, angle);
    }
    out
}
