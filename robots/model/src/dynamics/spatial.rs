//! Spatial vectors and inertias in world coordinates about the world origin.
//!
//! Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 2, with the angular part first. World coordinates
//! make composite quantities plain sums. The arm is small (about a metre), so the common origin loses no precision.

use nalgebra::{Matrix3, Vector3};

use crate::kinematics::Frames;
use crate::mat3;
use crate::model::LinkInertia;
use crate::pose::Pose;

/// Velocity-like: angular velocity and velocity of the body point at the origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct MotionVector {
    pub(super) w: Vector3<f64>,
    pub(super) v: Vector3<f64>,
}

/// Force-like: moment about the origin and force.
#[derive(Debug, Clone, Copy)]
pub(super) struct ForceVector {
    pub(super) n: Vector3<f64>,
    pub(super) f: Vector3<f64>,
}

impl MotionVector {
    #[inline]
    pub(super) fn zero() -> Self {
        Self { w: Vector3::zeros(), v: Vector3::zeros() }
    }

    /// Screw of joint `i` (index from 0).
    #[inline]
    pub(super) fn joint_axis(frames: &Frames, i: usize) -> Self {
        let z = frames.axis(i);
        Self { w: z, v: mat3::cross(&frames.origin(i), &z) }
    }

    #[inline]
    pub(super) fn plus(&self, other: &Self, times: f64) -> Self {
        Self { w: self.w + other.w * times, v: self.v + other.v * times }
    }

    /// `self × m`.
    #[inline]
    pub(super) fn cross(&self, m: &Self) -> Self {
        Self { w: mat3::cross(&self.w, &m.w), v: mat3::cross(&self.w, &m.v) + mat3::cross(&self.v, &m.w) }
    }

    /// `self ×* f`.
    #[inline]
    pub(super) fn cross_force(&self, f: &ForceVector) -> ForceVector {
        ForceVector {
            n: mat3::cross(&self.w, &f.n) + mat3::cross(&self.v, &f.f),
            f: mat3::cross(&self.w, &f.f),
        }
    }

    /// Power of a force along this motion.
    #[inline]
    pub(super) fn dot(&self, f: &ForceVector) -> f64 {
        self.w.dot(&f.n) + self.v.dot(&f.f)
    }
}

impl ForceVector {
    #[inline]
    pub(super) fn zero() -> Self {
        Self { n: Vector3::zeros(), f: Vector3::zeros() }
    }

    #[inline]
    pub(super) fn plus(&self, other: &Self) -> Self {
        Self { n: self.n + other.n, f: self.f + other.f }
    }
}

/// Inertia about the world origin: mass, first moment, second moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inertia {
    m: f64,
    h: Vector3<f64>,
    i: Matrix3<f64>,
}

impl Inertia {
    #[inline]
    pub(super) fn zero() -> Self {
        Self { m: 0.0, h: Vector3::zeros(), i: Matrix3::zeros() }
    }

    /// Inertia of a link whose joint frame is at `x_w`.
    #[inline]
    pub(super) fn of(link: &LinkInertia, x_w: &Pose) -> Self {
        let c = x_w.transform_point(link.com_m());
        let m = link.mass_kg();
        let about_com = mat3::mul(&mat3::mul(&x_w.rot, link.about_com_kg_m2()), &x_w.rot.transpose());
        let i = about_com + (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * m;
        Self { m, h: c * m, i }
    }

    #[inline]
    pub(super) fn plus(&self, other: &Self) -> Self {
        Self { m: self.m + other.m, h: self.h + other.h, i: self.i + other.i }
    }

    #[inline]
    pub(super) fn times(&self, a: &MotionVector) -> ForceVector {
        ForceVector {
            n: mat3::mul_v(&self.i, &a.w) + mat3::cross(&self.h, &a.v),
            f: a.v * self.m - mat3::cross(&self.h, &a.w),
        }
    }
}

/// Coriolis operator `B(I, v)` of Singh, Russo and Wensing 2022, eq. (7), with `B v = v ×* I v`.
///
/// About a fixed origin it has a short form: `B (w; u) = (D w; w × p)`, with the linear momentum `p = m v + ω × h` and
/// `D = -[ω×](½ tr(I) 1 - I) + (v·h) 1 - v hᵀ`; it does not depend on `u`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coriolis {
    d: Matrix3<f64>,
    p: Vector3<f64>,
}

impl Coriolis {
    #[inline]
    pub(super) fn zero() -> Self {
        Self { d: Matrix3::zeros(), p: Vector3::zeros() }
    }

    #[inline]
    pub(super) fn of(inertia: &Inertia, v: &MotionVector) -> Self {
        let second_moment = Matrix3::identity() * (0.5 * inertia.i.trace()) - inertia.i;
        let d = Matrix3::identity() * v.v.dot(&inertia.h)
            - v.v * inertia.h.transpose()
            - mat3::mul(&v.w.cross_matrix(), &second_moment);
        Self { d, p: v.v * inertia.m + mat3::cross(&v.w, &inertia.h) }
    }

    #[inline]
    pub(super) fn plus(&self, other: &Self) -> Self {
        Self { d: self.d + other.d, p: self.p + other.p }
    }

    /// `2 B m`.
    #[inline]
    pub(super) fn twice(&self, m: &MotionVector) -> ForceVector {
        ForceVector { n: mat3::mul_v(&self.d, &m.w) * 2.0, f: mat3::cross(&m.w, &self.p) * 2.0 }
    }

    /// `2 Bᵀ s`, of which only the angular part is not zero.
    #[inline]
    pub(super) fn twice_transposed(&self, s: &MotionVector) -> Vector3<f64> {
        (mat3::tr_mul_v(&self.d, &s.w) + mat3::cross(&self.p, &s.v)) * 2.0
    }
}
