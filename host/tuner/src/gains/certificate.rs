//! Claims of a saturated design, with the numbers that prove them, and their check.
//!
//! The check shares with the design only the sampled model; definiteness is proven by
//! [`super::rigor`], on the gains as rounded to f32.

use super::law::{Gains, Weights, row, scaled_loop, time_unit_s};
use super::problem::Problem;
use super::rigor::{min_eigenvalue_bound, min_eigenvalue_bound_below, product_error};
use crate::model::{STATES, Sampled, StateMatrix, StateRow, StateVector};
use nalgebra::{DMatrix, SMatrix};

/// Certified ellipsoid {x : x' S^-1 P S^-1 x <= 1} of one phase.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Bound of the correcting acceleration it holds for, rad/s2.
    pub u_max_rad_s2: f64,
    /// S: scale of each state, in the unit of the state.
    pub scales: StateVector,
    /// H: the row that stays within the bound on the ellipsoid, unscaled.
    pub slow: StateRow,
    /// P, scaled.
    pub p: StateMatrix,
    /// t: the cost over the ellipsoid is at most 1/t (time units).
    pub cost_rate: f64,
    /// Decay rate: sqrt(V) falls at least like e^(-decay t) from sample to sample, saturated or not, 1/s.
    pub decay_1_s: f64,
}

/// Gains of one joint with a region per phase of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct SaturatedCertificate {
    /// As the firmware holds them.
    pub gains: Gains,
    /// Weights of the certified cost.
    pub weights: Weights,
    /// One per phase of the problem, in order.
    pub regions: Vec<Region>,
}

/// Proven lower bounds of the smallest eigenvalues, scaled coordinates; the worst over all regions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SaturatedMargins {
    /// e^(-2 decay T) P - (A+BF)'P(A+BF) - t h (W + r F'F), over K and H and a grid of periods and delays.
    pub decay: f64,
    /// [[P, H'], [H, 1]].
    pub input: f64,
    /// Initial set inside the ellipsoid.
    pub initial_set: f64,
}

/// Which claim is not proven.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SaturatedRefusal {
    /// An inequality.
    #[error("certificate refused: {inequality} of phase {phase} is only proven down to {margin:.3e}")]
    NotProven {
        inequality: &'static str,
        /// Phase, from 1.
        phase: usize,
        /// Proven bound of its smallest eigenvalue.
        margin: f64,
    },
    /// Certificate and problem differ in shape or bound.
    #[error("certificate refused: {what} of phase {phase} does not belong to this problem")]
    Foreign {
        what: &'static str,
        /// Phase, from 1.
        phase: usize,
    },
}

/// Points per axis of the grid of periods and delays on which the check evaluates.
const GRID: usize = 9;

impl Region {
    /// Factor by which the ellipsoid has shrunk after `duration_s`: the decay over the part of it that certainly is
    /// between samples (not a delay and two periods).
    pub fn shrinkage(&self, problem: &Problem, duration_s: f64) -> f64 {
        let sure = duration_s - problem.delay().high - 2.0 * problem.period().high;
        (-self.decay_1_s * sure.max(0.0)).exp()
    }

    /// Largest |x_i| in the ellipsoid, in the unit of the state.
    pub fn extent(&self, i: usize) -> Option<f64> {
        let inverse = self.p.cholesky()?.inverse();
        Some(inverse[(i, i)].sqrt() * self.scales[i])
    }

    /// V(x) for an unscaled state.
    pub fn value(&self, x: &StateVector) -> f64 {
        let z = x.component_div(&self.scales);
        z.dot(&(self.p * z))
    }
}

impl SaturatedCertificate {
    /// Smallest cost rate of all regions, per time unit.
    pub fn cost_rate(&self) -> f64 {
        self.regions.iter().map(|region| region.cost_rate).fold(f64::INFINITY, f64::min)
    }

    /// Checks every claim for `problem`, with bounds on all rounding, for numbers from any source.
    ///
    /// Periods and delays: a grid of 9 x 9 over the stated box, corners included, with an allowance for the values
    /// between its points.
    ///
    /// # Errors
    /// [`SaturatedRefusal`] names the first claim that is not proven.
    pub fn check(&self, problem: &Problem) -> Result<SaturatedMargins, SaturatedRefusal> {
        let foreign = |what, phase| Err(SaturatedRefusal::Foreign { what, phase });
        if self.regions.len() != problem.phases().len() {
            return foreign("the number of regions", self.regions.len());
        }
        let mut worst =
            SaturatedMargins { decay: f64::INFINITY, input: f64::INFINITY, initial_set: f64::INFINITY };
        let g = problem.error_generators();
        let mut inside = Inside::Generators(g);
        let models: Vec<Model> = problem
            .grid(GRID)
            .into_iter()
            .map(|(period_s, delay_s)| Model { period_s, sampled: problem.sampled(period_s, delay_s) })
            .collect();
        for (i, (region, phase)) in self.regions.iter().zip(problem.phases()).enumerate() {
            let number = i + 1;
            // A region for a smaller bound also holds for a larger one, not the other way round.
            if region.u_max_rad_s2.is_nan() || region.u_max_rad_s2 > phase.u_max_rad_s2 * (1.0 + 1e-12) {
                return foreign("the acceleration bound", number);
            }
            if region.scales.iter().any(|s| s.is_nan() || *s <= 0.0) {
                return foreign("the ellipsoid", number);
            }
            let refuse =
                |inequality, margin| Err(SaturatedRefusal::NotProven { inequality, phase: number, margin });
            if !(region.decay_1_s > 0.0 && region.cost_rate > 0.0) {
                return refuse("a falling V", f64::NAN);
            }
            let initial_set = inside.margin(region);
            if !proven(initial_set) {
                return refuse("the initial set inside the ellipsoid", initial_set);
            }
            let input = self.input_margin(region);
            if !proven(input) {
                return refuse("the bound of the slow row", input);
            }
            let decay = self.decay_margin(&models, region);
            if !proven(decay) {
                return refuse("the decay", decay);
            }
            worst.decay = worst.decay.min(decay);
            worst.input = worst.input.min(input);
            worst.initial_set = worst.initial_set.min(initial_set);
            if let Some(duration) = phase.duration_s {
                inside = Inside::Ellipsoid(Box::new(region.clone()), region.shrinkage(problem, duration));
            }
        }
        Ok(worst)
    }

    fn input_margin(&self, region: &Region) -> f64 {
        let h = region.slow.transpose().component_mul(&region.scales) / region.u_max_rad_s2;
        let mut block = SMatrix::<f64, { STATES + 1 }, { STATES + 1 }>::identity();
        block.fixed_view_mut::<STATES, STATES>(0, 0).copy_from(&region.p);
        block.fixed_view_mut::<STATES, 1>(0, STATES).copy_from(&h);
        block.fixed_view_mut::<1, STATES>(STATES, 0).copy_from(&h.transpose());
        min_eigenvalue_bound(&block, 4.0 * f64::EPSILON * h.amax())
    }

    /// Proven margin of the decay over the grid, less the allowance between its points.
    fn decay_margin(&self, models: &[Model], region: &Region) -> f64 {
        let unit = time_unit_s(region.scales[0], region.u_max_rad_s2);
        let w = self.weights.state();
        let mut worst = f64::INFINITY;
        for f in [&row(self.gains), &region.slow] {
            let mut falls: Vec<StateMatrix> = Vec::with_capacity(models.len());
            let mut margin = f64::INFINITY;
            for Model { period_s, sampled } in models {
                let (closed, fs) = scaled_loop(sampled, f, &region.scales, region.u_max_rad_s2);
                // Scaling and the product B F each round once more on top of the model's own error.
                let e_closed = (sampled.relative_error + 8.0 * f64::EPSILON) * closed.amax().max(1.0);
                let pc = region.p * closed;
                let e_pc = product_error((&region.p, 0.0), (&closed, e_closed));
                let image = closed.transpose() * pc;
                let e_image = product_error((&closed.transpose(), e_closed), (&pc, e_pc));
                let stage =
                    (w + fs.transpose() * fs * self.weights.input) * (period_s / unit * region.cost_rate);
                let keep = (-2.0 * region.decay_1_s * period_s).exp();
                let error = e_image + 8.0 * f64::EPSILON * (region.p.amax() + stage.amax() + image.amax());
                let fall = region.p * keep - image - stage;
                margin = min_eigenvalue_bound_below(margin, &fall, error);
                falls.push(fall);
            }
            // NaN must not pass: `min` would drop it, and the eigenvalue iteration must not meet it.
            if !margin.is_finite() {
                return f64::NEG_INFINITY;
            }
            worst = worst.min(margin - between_points(&falls));
        }
        worst
    }
}

/// The sampled loop at one point of the grid.
struct Model {
    period_s: f64,
    sampled: Sampled,
}

/// Whether a proven bound of an eigenvalue is one to rely on; NaN is not.
fn proven(margin: f64) -> bool {
    margin >= 0.0
}

/// Allowance for periods and delays between the points of the grid.
///
/// A function on a cell differs from its bilinear interpolant by at most an eighth of the second
/// differences along both axes (largest second derivative times squared spacing), and only upward
/// curvature brings it below the interpolant. The differences are taken from the grid itself, their
/// largest eigenvalue, and doubled for their variation within a cell. A grid that collapsed to a
/// line has the second difference along it only.
fn between_points(falls: &[StateMatrix]) -> f64 {
    let largest = |stride: usize, starts: &mut dyn Iterator<Item = usize>| {
        starts.fold(0.0f64, |largest, a| {
            let difference = falls[a] - falls[a + stride] * 2.0 + falls[a + 2 * stride];
            // No eigenvalue exceeds the norm, nor the largest value so far by a completed Cholesky run: few differences need
            // eigenvalues.
            if difference.norm() <= largest {
                return largest;
            }
            let difference = (difference + difference.transpose()) * 0.5;
            if (StateMatrix::from_diagonal_element(largest) - difference).cholesky().is_some() {
                return largest;
            }
            largest.max(difference.symmetric_eigenvalues().max())
        })
    };
    let sum = if falls.len() == GRID * GRID {
        largest(1, &mut (0..falls.len()).filter(|a| a % GRID + 2 < GRID))
            + largest(GRID, &mut (0..falls.len() - 2 * GRID))
    } else if falls.len() > 2 {
        largest(1, &mut (0..falls.len() - 2))
    } else {
        0.0
    };
    2.0 * sum / 8.0
}

/// The set a region has to contain.
enum Inside {
    /// {G z, |z| <= 1}, unscaled.
    Generators(DMatrix<f64>),
    /// The ellipsoid of the phase before, shrunk by a factor.
    Ellipsoid(Box<Region>, f64),
}

impl Inside {
    /// Proven margin of the containment.
    fn margin(&self, region: &Region) -> f64 {
        match self {
            Self::Generators(g) => {
                let g = DMatrix::from_fn(STATES, g.ncols(), |i, j| g[(i, j)] / region.scales[i]);
                let m = g.ncols();
                let pg = DMatrix::from_column_slice(STATES, STATES, region.p.as_slice()) * &g;
                let error =
                    product_error((&g.transpose(), f64::EPSILON * g.amax()), (&pg, 1e-14 * pg.amax()));
                min_eigenvalue_bound(&(DMatrix::identity(m, m) - g.transpose() * pg), error)
            }
            Self::Ellipsoid(before, sigma) => {
                // P_before / sigma^2 >= P in common coordinates: those of the new region.
                let d: Vec<f64> = (0..STATES).map(|i| region.scales[i] / before.scales[i]).collect();
                let outer = StateMatrix::from_fn(|i, j| before.p[(i, j)] * d[i] * d[j] / (sigma * sigma));
                let error = 16.0 * f64::EPSILON * outer.amax();
                min_eigenvalue_bound(&(outer - region.p), error)
            }
        }
    }
}
