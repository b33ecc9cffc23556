//! Linear least squares y = X b + noise, with what the data allow to conclude.

use super::student::two_sided;
use nalgebra::{DMatrix, DVector};

/// An estimate with its two-sided confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Half the width of the interval.
    pub half_width: f64,
}

impl Estimate {
    /// True if `truth` is inside.
    pub fn covers(&self, truth: f64) -> bool {
        (self.value - truth).abs() <= self.half_width
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// One per column of X.
    pub estimates: Vec<Estimate>,
    /// Share of the variance of y that is explained.
    pub r_squared: f64,
    /// Standard deviation of the residuals, unit of y.
    pub residual_std: f64,
    /// y - X b.
    pub residuals: Vec<f64>,
    /// Samples less unknowns.
    pub degrees_of_freedom: usize,
}

/// Why nothing is concluded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegressionError {
    /// NaN or infinity among the samples.
    #[error("sample {index} is not a finite number")]
    NotFinite {
        /// From 0.
        index: usize,
    },
    /// Not enough samples.
    #[error("{found} samples are too few for {unknowns} unknowns; take at least {needed}")]
    TooFew {
        found: usize,
        /// To be found.
        unknowns: usize,
        needed: usize,
    },
    /// The samples do not determine the unknowns separately.
    #[error("the samples do not determine the unknowns separately (condition {condition:.1e}): {advice}")]
    Rank {
        /// Condition number of the column-scaled X.
        condition: f64,
        /// What to vary.
        advice: &'static str,
    },
    /// The samples cover too little.
    #[error("{what} only covers {found:.4} of the {needed:.4} needed: {advice}")]
    Range {
        /// Quantity.
        what: &'static str,
        /// Covered.
        found: f64,
        needed: f64,
        /// What to do.
        advice: &'static str,
    },
    /// The model does not describe the data.
    #[error("the model explains only {r_squared:.4} of the variance ({needed:.4} needed): {advice}")]
    PoorFit {
        r_squared: f64,
        needed: f64,
        /// Next step.
        advice: &'static str,
    },
    /// The result is too uncertain to use.
    #[error("{what} = {value:.5} +- {half_width:.5} is too uncertain: {advice}")]
    Uncertain {
        /// Quantity.
        what: &'static str,
        /// Best value.
        value: f64,
        /// Half the interval.
        half_width: f64,
        /// What to do.
        advice: &'static str,
    },
}

/// Samples per unknown below which nothing is concluded.
const SAMPLES_PER_UNKNOWN: usize = 3;
/// Condition number of the column-scaled X above which unknowns count as not separable.
const CONDITION_MAX: f64 = 1e3;

/// Fits y = X b by QR; intervals hold with probability `level` if the noise is normal, independent
/// and of equal variance.
///
/// `advice` is what to vary if the unknowns cannot be separated.
///
/// # Errors
/// [`RegressionError::NotFinite`], [`RegressionError::TooFew`], [`RegressionError::Rank`].
///
/// # Panics
/// If X and y have different numbers of rows.
pub fn fit(
    x: &DMatrix<f64>,
    y: &DVector<f64>,
    level: f64,
    advice: &'static str,
) -> Result<Fit, RegressionError> {
    assert_eq!(x.nrows(), y.len(), "one row of X per sample");
    let (m, n) = x.shape();
    if let Some(index) = (0..m).find(|&i| !y[i].is_finite() || x.row(i).iter().any(|v| !v.is_finite())) {
        return Err(RegressionError::NotFinite { index });
    }
    let needed = SAMPLES_PER_UNKNOWN * n;
    if m < needed {
        return Err(RegressionError::TooFew { found: m, unknowns: n, needed });
    }
    // Unit columns: the condition number is then about directions, not about units.
    let norms: Vec<f64> = (0..n).map(|j| x.column(j).norm()).collect();
    let scaled = DMatrix::from_fn(m, n, |i, j| if norms[j] > 0.0 { x[(i, j)] / norms[j] } else { 0.0 });
    let singular = scaled.clone().singular_values();
    let (largest, smallest) = (singular.max(), singular.min());
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    if condition.is_nan() || condition > CONDITION_MAX {
        return Err(RegressionError::Rank { condition, advice });
    }
    let rank = || RegressionError::Rank { condition, advice };
    let qr = scaled.qr();
    let r = qr.r();
    let b = r.solve_upper_triangular(&(qr.q().transpose() * y)).ok_or_else(rank)?;
    let b = DVector::from_fn(n, |j, _| b[j] / norms[j]);
    let residuals = y - x * &b;
    let degrees_of_freedom = m - n;
    let variance = residuals.norm_squared() / degrees_of_freedom as f64;
    // (X'X)^-1 = D^-1 R^-1 R^-T D^-1 with the column norms D.
    let r_inverse = r.try_inverse().ok_or_else(rank)?;
    let t = two_sided(level, degrees_of_freedom);
    let estimates = (0..n)
        .map(|j| {
            let std_error = (variance * r_inverse.row(j).norm_squared()).sqrt() / norms[j];
            Estimate { value: b[j], half_width: t * std_error }
        })
        .collect();
    let mean = y.mean();
    let total: f64 = y.iter().map(|v| (v - mean).powi(2)).sum();
    let r_squared = if total > 0.0 { 1.0 - residuals.norm_squared() / total } else { 0.0 };
    Ok(Fit {
        estimates,
        r_squared,
        residual_std: variance.sqrt(),
        residuals: residuals.iter().copied().collect(),
        degrees_of_freedom,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    #[test]
    fn worked_example_of_a_straight_line() {
        // x 1..5, y = 2.1, 3.9, 6.2, 7.8, 10.1 (and once more): slope 1.99, intercept 0.05 by hand.
        let xs = [1.0, 2.0, 3.0, 4.0, 5.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        let ys = [2.1, 3.9, 6.2, 7.8, 10.1, 2.1, 3.9, 6.2, 7.8, 10.1];
        let x = DMatrix::from_fn(10, 2, |i, j| if j == 0 { xs[i] } else { 1.0 });
        let found = fit(&x, &DVector::from_row_slice(&ys), 0.95, "").unwrap();
        assert!((found.estimates[0].value - 1.99).abs() < 1e-12);
        assert!((found.estimates[1].value - 0.05).abs() < 1e-12);
        // Residual sum of squares 2 * 0.107, 8 degrees of freedom, Sxx = 20.
        let want = 2.306_004 * (0.214f64 / 8.0 / 20.0).sqrt();
        assert!((found.estimates[0].half_width - want).abs() < 1e-6);
        assert_eq!(found.degrees_of_freedom, 8);
    }

    #[test]
    fn interval_covers_as_often_as_it_says() {
        let mut covered = 0;
        for seed in 0..400 {
            let mut noise = Noise::new(seed);
            let x = DMatrix::from_fn(12, 2, |i, j| if j == 0 { i as f64 } else { 1.0 });
            let y = DVector::from_fn(12, |i, _| 0.3 * i as f64 + 1.0 + 0.2 * noise.normal());
            covered += usize::from(fit(&x, &y, 0.9, "").unwrap().estimates[0].covers(0.3));
        }
        // 360 expected, standard deviation 6: four of them on each side.
        assert!((336..=384).contains(&covered), "{covered}");
    }

    #[test]
    fn poor_data_are_refused() {
        let line = |n: usize| DMatrix::from_fn(n, 2, |i, j| if j == 0 { i as f64 } else { 1.0 });
        let few = fit(&line(5), &DVector::zeros(5), 0.95, "");
        assert!(matches!(few, Err(RegressionError::TooFew { found: 5, needed: 6, .. })));
        let same = DMatrix::from_element(9, 2, 1.0);
        assert!(matches!(fit(&same, &DVector::zeros(9), 0.95, "vary it"), Err(RegressionError::Rank { .. })));
        let mut y = DVector::zeros(9);
        y[4] = f64::NAN;
        assert_eq!(fit(&line(9), &y, 0.95, ""), Err(RegressionError::NotFinite { index: 4 }));
    }
}
