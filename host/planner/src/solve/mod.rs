//! Local solver: the best motion near a start, for any [`Task`].
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | here | the task: variables, objective, constraints |
//! | `qp` | small dense quadratic programs |
//! | `rows` | rows of one evaluation, and multipliers |
//! | `curvature` | the Hessian of the Lagrangian, and a positive definite matrix in its place |
//! | `sqp` | sequential quadratic programming |
//!
//! A task gives its rows with exact gradients; the solver knows nothing else about it. Rows are [`WIDTH`] wide, so
//! that they stay on the stack; work is done up to the number of variables.
//!
//! The throw of this package is one task. A task of your own needs no change here: the example `own_task` finds the posture
//! that holds a point with the least torque.

#[expect(clippy::needless_range_loop, reason = "matrix code reads like its formulas with indices")]
mod curvature;
#[expect(clippy::needless_range_loop, reason = "matrix code reads like its formulas with indices")]
mod qp;
mod rows;
#[expect(clippy::needless_range_loop, reason = "matrix code reads like its formulas with indices")]
pub mod sqp;

use std::ops::Range;

pub use self::qp::{Row, WIDTH};

/// Where a row adds its gradient, times a factor.
pub struct Gradient<'a> {
    pub(crate) row: &'a mut Row,
    pub(crate) factor: f64,
}

impl Gradient<'_> {
    /// Adds `value` to the derivative by variable `i`.
    #[inline]
    pub fn add(&mut self, i: usize, value: f64) {
        self.row[i] += self.factor * value;
    }
}

/// Receives the rows of an evaluation. Inequalities mean `value ≥ 0`.
pub trait Sink {
    /// True if this inequality is needed; called before costly rows.
    fn wants(&self, id: usize) -> bool;
    /// Whether this equality is of interest.
    fn wants_eq(&self, id: usize) -> bool;
    /// A summand of the objective.
    fn objective(&mut self, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    /// Equality number `id`: its value is to be 0.
    fn eq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
    /// Inequality number `id`: its value is to be at least 0. Values of different rows should be of one size.
    fn ineq(&mut self, id: usize, value: f64, gradient: impl FnOnce(&mut Gradient<'_>));
}

/// Objective of the local solver, and its constraints.
///
/// The Hessian is made by differences of the gradient, part by part, along the variables that a part of the rows bends
/// with; the other entries follow from symmetry.
pub trait Task {
    /// A group of rows that bend with the same variables.
    type Part: Copy;

    /// Number of variables, at most [`WIDTH`].
    fn variables(&self) -> usize;
    /// How many equalities and inequalities there can be; a row keeps its number from evaluation to evaluation.
    fn numbers(&self) -> (usize, usize);
    /// The variables that are joint angles in rad: the solver bounds their steps.
    fn angles(&self) -> Range<usize>;
    /// Whether `x` is a motion at all (all its times are positive), so that rows can be evaluated.
    fn is_motion(&self, x: &Row) -> bool;
    /// All rows at `x`.
    fn rows<S: Sink>(&self, x: &Row, sink: &mut S);
    /// The parts of the rows that have second derivatives.
    fn parts(&self) -> impl Iterator<Item = (Self::Part, When)>;
    /// The rows of a part at `x`.
    fn part_rows<S: Sink>(&self, part: Self::Part, x: &Row, sink: &mut S);
    /// Whether the gradient of a part is differenced along variable `k`.
    fn bends(&self, part: Self::Part, k: usize) -> bool;
    /// Whether differencing gives the second derivative (k, i), with [`Self::bends`] true for k, again as (i, k) or as zero.
    /// Then each of the two entries counts half.
    fn twice(&self, part: Self::Part, i: usize) -> bool;
}

/// When a part has second derivatives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// At every point.
    Always,
    /// Only if an equality has a multiplier.
    WithMultipliers,
}
