//! Products of 3 × 3 matrices and 3-vectors, written out.
//!
//! nalgebra's general products do not inline to straight code for these sizes; written out, forward kinematics and
//! inverse dynamics take about half the time (`cargo bench -p robot-model`).

use nalgebra::{Matrix3, Vector3};

/// `a b`.
#[inline(always)]
pub(crate) fn mul(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    let [a0, a1, a2] = &a.data.0;
    Matrix3::from_data(nalgebra::ArrayStorage(
        b.data.0.map(|b| std::array::from_fn(|i| a0[i] * b[0] + a1[i] * b[1] + a2[i] * b[2])),
    ))
}

/// `a v`.
#[inline(always)]
pub(crate) fn mul_v(a: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let [a0, a1, a2] = &a.data.0;
    Vector3::new(
        a0[0] * v.x + a1[0] * v.y + a2[0] * v.z,
        a0[1] * v.x + a1[1] * v.y + a2[1] * v.z,
        a0[2] * v.x + a1[2] * v.y + a2[2] * v.z,
    )
}

/// `aᵀ v`.
#[inline(always)]
pub(crate) fn tr_mul_v(a: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let [a0, a1, a2] = &a.data.0;
    Vector3::new(
        a0[0] * v.x + a0[1] * v.y + a0[2] * v.z,
        a1[0] * v.x + a1[1] * v.y + a1[2] * v.z,
        a2[0] * v.x + a2[1] * v.y + a2[2] * v.z,
    )
}

/// `aᵀ b`.
#[inline(always)]
pub(crate) fn tr_mul(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    let [a0, a1, a2] = &a.data.0;
    let dot = |x: &[f64; 3], y: &[f64; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    Matrix3::from_data(nalgebra::ArrayStorage(b.data.0.map(|b| [dot(a0, &b), dot(a1, &b), dot(a2, &b)])))
}

/// `u × v`.
#[inline(always)]
pub(crate) fn cross(u: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_the_library() {
        let a = Matrix3::new(1.0, -2.0, 3.0, 0.5, 4.0, -1.0, 2.5, 0.0, 7.0);
        let b = Matrix3::new(0.3, 1.0, -5.0, 2.0, -0.7, 1.5, 3.0, 0.1, 0.9);
        let (u, v) = (Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.3, 4.0, -1.0));
        assert!((mul(&a, &b) - a * b).amax() < 1e-15);
        assert!((tr_mul(&a, &b) - a.transpose() * b).amax() < 1e-14);
        assert!((mul_v(&a, &v) - a * v).amax() < 1e-15);
        assert!((tr_mul_v(&a, &v) - a.transpose() * v).amax() < 1e-15);
        assert_eq!(cross(&u, &v), u.cross(&v));
    }
}
