//! Padded vectors and matrices of any number of joints against nalgebra's of a fixed size.

use nalgebra::{SMatrix, SVector};
use proptest::prelude::*;
use robot_model::linalg::{Cholesky, Lu, SquareMatrix};
use robot_model::{JOINTS_MAX, JointVec};

/// Sums run in the order of the joints; nalgebra sums eight at a time.
const ROUNDING: f64 = 1e-13;

fn same<const N: usize>(ours: &JointVec, fixed: &SVector<f64, N>) -> bool {
    ours[..] == *fixed.as_slice()
}

fn near<const N: usize>(ours: &JointVec, fixed: &SVector<f64, N>, tolerance: f64) -> bool {
    ours.len() == N
        && ours.iter().zip(fixed.iter()).all(|(a, b)| (a - b).abs() <= tolerance * (1.0 + b.abs()))
}

/// Everything that vectors and matrices of `N` joints can do, for numbers from `at`.
fn agree<const N: usize>(at: &[f64; 100]) -> Result<(), TestCaseError> {
    let (a, b) = (SVector::<f64, N>::from_fn(|k, _| at[k]), SVector::<f64, N>::from_fn(|k, _| at[N + k]));
    let (x, y) = (JointVec::from(a), JointVec::from(b));
    let by = at[99];
    prop_assert_eq!(x.len(), N);
    prop_assert!(same(&(x + y), &(a + b)) && same(&(x - y), &(a - b)) && same(&-x, &-a));
    prop_assert!(same(&(x * by), &(a * by)) && same(&(by * x), &(a * by)) && same(&(x / by), &(a / by)));
    prop_assert!(same(&x.abs(), &a.abs()) && same(&x.sup(&y), &a.sup(&b)) && same(&x.inf(&y), &a.inf(&b)));
    prop_assert!(same(&x.component_mul(&y), &a.component_mul(&b)));
    prop_assert!(same(&x.component_div(&y), &a.component_div(&b)));
    prop_assert!(same(&x.map(f64::sin), &a.map(f64::sin)));
    prop_assert!(same(&x.zip_map(&y, f64::atan2), &a.zip_map(&b, f64::atan2)));
    let (mut sum, mut fixed) = (x, a);
    sum += y;
    sum -= x * 2.0;
    sum *= by;
    sum /= 3.0;
    fixed += b;
    fixed -= a * 2.0;
    fixed *= by;
    fixed /= 3.0;
    prop_assert!(same(&sum, &fixed));
    prop_assert_eq!((x.amax(), x.max(), x.min()), (a.amax(), a.max(), a.min()));
    prop_assert_eq!((x.imax(), x.iamax()), (a.imax(), a.iamax()));
    prop_assert!(
        (x.dot(&y) - a.dot(&b)).abs() <= ROUNDING * 100.0 && (x.norm() - a.norm()).abs() <= ROUNDING * 10.0
    );
    prop_assert!((x.sum() - a.sum()).abs() <= ROUNDING * 10.0);

    // A symmetric positive definite matrix, and one that is not symmetric.
    let m = SMatrix::<f64, N, N>::from_fn(|i, k| at[2 * N + (i * N + k) % 80]);
    let (positive, skew) = (m * m.transpose() + SMatrix::identity(), m + SMatrix::identity() * 40.0);
    let padded = |m: &SMatrix<f64, N, N>| SquareMatrix::from_fn(N, |i, k| m[(i, k)]);
    prop_assert!(near(&(padded(&m) * x), &(m * a), 100.0 * ROUNDING));
    prop_assert_eq!(padded(&m).amax(), m.amax());
    let solved = Cholesky::new(&padded(&positive)).expect("positive definite").solve(&x);
    prop_assert!(near(&(padded(&positive) * solved), &a, 1e-9));
    let lu = Lu::new(&padded(&skew)).expect("regular");
    prop_assert!(near(&(padded(&skew) * lu.solve(&x)), &a, 1e-10));
    prop_assert!(near(&(padded(&skew.transpose()) * lu.solve_transposed(&x)), &a, 1e-10));
    Ok(())
}

proptest! {
    #[test]
    fn padded_arithmetic_equals_that_with_fixed_sizes(at in prop::array::uniform::<_, 100>(-9.0..9.0_f64)) {
        prop_assume!(at.iter().all(|x| x.abs() > 1e-3));
        agree::<1>(&at)?;
        agree::<2>(&at)?;
        agree::<3>(&at)?;
        agree::<4>(&at)?;
        agree::<5>(&at)?;
        agree::<6>(&at)?;
        agree::<7>(&at)?;
        agree::<8>(&at)?;
    }
}

#[test]
fn what_is_beyond_the_last_joint_is_never_seen() {
    // Padding of a quotient by zero is not a number.
    let zero = JointVec::zeros(5);
    let odd =
        JointVec::repeat(5, 1.0).component_div(&JointVec::repeat(5, 2.0)) + zero / 1.0 - zero * f64::INFINITY;
    assert_eq!(odd.len(), 5);
    assert!(odd.iter().all(|x| x.is_nan()), "0 times infinity in the five joints themselves");
    let half = JointVec::repeat(5, 1.0) / 2.0;
    let again = half.component_div(&half);
    assert_eq!((again.amax(), again.sum(), again.dot(&half)), (1.0, 5.0, 2.5));
    assert_eq!(again, JointVec::repeat(5, 1.0));
    assert_ne!(JointVec::zeros(4), JointVec::zeros(5));
}

#[test]
#[should_panic(expected = "at most 8")]
fn more_joints_than_there_is_room_for_are_refused() {
    let _ = JointVec::zeros(JOINTS_MAX + 1);
}
