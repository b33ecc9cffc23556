//! Values of the joints of one arm: at most [`JOINTS_MAX`] of them, and how many there are.

use std::fmt;
use std::ops::{Add, AddAssign, Deref, DerefMut, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Most joints of an arm.
pub const JOINTS_MAX: usize = 8;

/// One value per joint, on the stack.
///
/// It derefs to a slice of as many values as there are joints. The values behind them are never read.
#[derive(Clone, Copy)]
pub struct PerJoint<T> {
    items: [T; JOINTS_MAX],
    n: usize,
}

/// One number per joint.
///
/// Sums, differences and multiples are computed on all [`JOINTS_MAX`] places: loops of a fixed length without a remainder.
pub type JointVec = PerJoint<f64>;

impl<T: Copy + Default> PerJoint<T> {
    /// The value `of` each of `n` joints.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] joints.
    #[must_use]
    #[inline]
    pub fn from_fn(n: usize, mut of: impl FnMut(usize) -> T) -> Self {
        let mut out = Self::default_of(n);
        for k in 0..n {
            out.items[k] = of(k);
        }
        out
    }

    /// The default value for each of `n` joints.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] joints.
    #[must_use]
    #[inline]
    pub fn default_of(n: usize) -> Self {
        assert!(n <= JOINTS_MAX, "{n} joints, an arm has at most {JOINTS_MAX}");
        Self { items: [T::default(); JOINTS_MAX], n }
    }

    /// The first `n` of eight values.
    #[inline]
    pub(crate) fn padded(items: [T; JOINTS_MAX], n: usize) -> Self {
        Self { items, n }
    }

    /// The values.
    #[must_use]
    #[inline]
    pub fn as_slice(&self) -> &[T] {
        self
    }

    /// The values of an arm of `N` joints, for code that is made for one number of joints.
    ///
    /// # Panics
    /// With another number of joints.
    #[must_use]
    pub fn array<const N: usize>(&self) -> [T; N] {
        match self[..].try_into() {
            Ok(array) => array,
            Err(_) => panic!("{N} joints are needed, there are {}", self.len()),
        }
    }

    /// The values of a slice.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] values.
    #[must_use]
    pub fn from_slice(values: &[T]) -> Self {
        Self::from_fn(values.len(), |k| values[k])
    }
}

impl<T> Deref for PerJoint<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        &self.items[..self.n.min(JOINTS_MAX)]
    }
}

impl<T> DerefMut for PerJoint<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items[..self.n.min(JOINTS_MAX)]
    }
}

impl<T: Copy + Default, const N: usize> From<[T; N]> for PerJoint<T> {
    fn from(values: [T; N]) -> Self {
        const { assert!(N <= JOINTS_MAX, "too many joints") };
        Self::from_slice(&values)
    }
}

impl<const N: usize> From<nalgebra::SVector<f64, N>> for JointVec {
    fn from(vector: nalgebra::SVector<f64, N>) -> Self {
        Self::from(<[f64; N]>::from(vector))
    }
}

impl<T: Copy + Default> FromIterator<T> for PerJoint<T> {
    /// # Panics
    /// With more than [`JOINTS_MAX`] values.
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut out = Self::default_of(0);
        for value in values {
            assert!(out.n < JOINTS_MAX, "an arm has at most {JOINTS_MAX} joints");
            out.items[out.n] = value;
            out.n += 1;
        }
        out
    }
}

impl<'a, T> IntoIterator for &'a PerJoint<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;
    #[inline]
    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: PartialEq> PartialEq for PerJoint<T> {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl<T: fmt::Debug> fmt::Debug for PerJoint<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self[..].fmt(f)
    }
}

impl fmt::Display for JointVec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self[..], f)
    }
}

impl JointVec {
    /// Zero for each of `n` joints.
    ///
    /// # Panics
    /// With more than [`JOINTS_MAX`] joints, as in every other constructor.
    #[must_use]
    #[inline]
    pub fn zeros(n: usize) -> Self {
        Self::default_of(n)
    }

    /// The same number for each of `n` joints.
    #[must_use]
    pub fn repeat(n: usize, value: f64) -> Self {
        Self::from_fn(n, |_| value)
    }

    /// A function of each number.
    #[must_use]
    #[inline]
    pub fn map(&self, of: impl Fn(f64) -> f64) -> Self {
        Self { items: self.items.map(of), n: self.n }
    }

    /// A function of each number and the one in the same place of `other`.
    #[must_use]
    #[inline]
    pub fn zip_map(&self, other: &Self, of: impl Fn(f64, f64) -> f64) -> Self {
        debug_assert_eq!(self.n, other.n, "vectors of different arms");
        Self { items: std::array::from_fn(|k| of(self.items[k], other.items[k])), n: self.n }
    }

    /// Absolute values.
    #[must_use]
    #[inline]
    pub fn abs(&self) -> Self {
        self.map(f64::abs)
    }

    /// The larger of two numbers in each place.
    #[must_use]
    #[inline]
    pub fn sup(&self, other: &Self) -> Self {
        self.zip_map(other, f64::max)
    }

    /// The smaller of two numbers in each place.
    #[must_use]
    #[inline]
    pub fn inf(&self, other: &Self) -> Self {
        self.zip_map(other, f64::min)
    }

    /// Products place by place.
    #[must_use]
    #[inline]
    pub fn component_mul(&self, other: &Self) -> Self {
        self.zip_map(other, |a, b| a * b)
    }

    /// Quotients place by place.
    #[must_use]
    #[inline]
    pub fn component_div(&self, other: &Self) -> Self {
        self.zip_map(other, |a, b| a / b)
    }

    /// Scalar product.
    #[must_use]
    #[inline]
    pub fn dot(&self, other: &Self) -> f64 {
        debug_assert_eq!(self.n, other.n, "vectors of different arms");
        self.iter().zip(other).fold(0.0, |sum, (a, b)| sum + a * b)
    }

    /// Length squared.
    #[must_use]
    #[inline]
    pub fn norm_squared(&self) -> f64 {
        self.dot(self)
    }

    /// Length.
    #[must_use]
    pub fn norm(&self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// Sum of all numbers.
    #[must_use]
    pub fn sum(&self) -> f64 {
        self.iter().sum()
    }

    /// The largest absolute value; 0 without joints.
    #[must_use]
    pub fn amax(&self) -> f64 {
        self.iter().fold(0.0, |most, x| most.max(x.abs()))
    }

    /// The place of the largest number; 0 without joints.
    #[must_use]
    pub fn imax(&self) -> usize {
        (1..self.len()).fold(0, |best, k| if self[k] > self[best] { k } else { best })
    }

    /// The place of the largest absolute value; 0 without joints.
    #[must_use]
    pub fn iamax(&self) -> usize {
        self.abs().imax()
    }

    /// The largest number; minus infinity without joints.
    #[must_use]
    pub fn max(&self) -> f64 {
        self.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// The smallest number; infinity without joints.
    #[must_use]
    pub fn min(&self) -> f64 {
        self.iter().copied().fold(f64::INFINITY, f64::min)
    }
}

/// An operator between two vectors, by value and by reference.
macro_rules! place_by_place {
    ($($trait:ident $method:ident $assign:ident $assign_method:ident $op:tt)*) => {$(
        impl $trait<&JointVec> for &JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, other: &JointVec) -> JointVec {
                self.zip_map(other, |a, b| a $op b)
            }
        }
        impl $trait<JointVec> for &JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, other: JointVec) -> JointVec {
                self $op &other
            }
        }
        impl $trait<&JointVec> for JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, other: &JointVec) -> JointVec {
                &self $op other
            }
        }
        impl $trait for JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, other: JointVec) -> JointVec {
                &self $op &other
            }
        }
        impl $assign<&JointVec> for JointVec {
            #[inline]
            fn $assign_method(&mut self, other: &JointVec) {
                *self = &*self $op other;
            }
        }
        impl $assign for JointVec {
            #[inline]
            fn $assign_method(&mut self, other: JointVec) {
                *self = &*self $op &other;
            }
        }
    )*};
}
place_by_place!(Add add AddAssign add_assign + Sub sub SubAssign sub_assign -);

/// An operator between a vector and a number.
macro_rules! by_number {
    ($($trait:ident $method:ident $assign:ident $assign_method:ident $op:tt)*) => {$(
        impl $trait<f64> for &JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, number: f64) -> JointVec {
                self.map(|a| a $op number)
            }
        }
        impl $trait<f64> for JointVec {
            type Output = JointVec;
            #[inline]
            fn $method(self, number: f64) -> JointVec {
                &self $op number
            }
        }
        impl $assign<f64> for JointVec {
            #[inline]
            fn $assign_method(&mut self, number: f64) {
                *self = &*self $op number;
            }
        }
    )*};
}
by_number!(Mul mul MulAssign mul_assign * Div div DivAssign div_assign /);

impl Mul<JointVec> for f64 {
    type Output = JointVec;
    #[inline]
    fn mul(self, vector: JointVec) -> JointVec {
        vector * self
    }
}

impl Neg for JointVec {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

impl Neg for &JointVec {
    type Output = JointVec;
    #[inline]
    fn neg(self) -> JointVec {
        -*self
    }
}
