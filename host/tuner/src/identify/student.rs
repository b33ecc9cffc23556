//! Student's t distribution: the width of a confidence interval from few samples.

/// t with P(|T| <= t) = `level` for `dof` degrees of freedom.
///
/// 0 < level < 1 and dof >= 1; anything else gives infinity, which makes every interval useless
/// rather than wrong.
pub(super) fn two_sided(level: f64, dof: usize) -> f64 {
    if !(level > 0.0 && level < 1.0) || dof == 0 {
        return f64::INFINITY;
    }
    let (mut low, mut high) = (0.0, 1.0);
    while inside(high, dof) < level {
        high *= 2.0;
        if high > 1e12 {
            return f64::INFINITY;
        }
    }
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if inside(middle, dof) < level {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// P(|T| <= t), by the finite trigonometric series for whole degrees of freedom.
///
/// M. Abramowitz, I. Stegun, "Handbook of Mathematical Functions", 26.7.3 and 26.7.4.
fn inside(t: f64, dof: usize) -> f64 {
    let theta = (t / (dof as f64).sqrt()).atan();
    let (s, c) = theta.sin_cos();
    let series = |first: usize| {
        // 1 + (first/first+1) c^2 + ...: ratios of neighbouring integers, steps of two.
        let (mut sum, mut term, mut k) = (1.0, 1.0, first);
        while k + 3 <= dof {
            term *= k as f64 / (k + 1) as f64 * c * c;
            sum += term;
            k += 2;
        }
        sum
    };
    if dof == 1 {
        theta / std::f64::consts::FRAC_PI_2
    } else if dof % 2 == 1 {
        (theta + s * c * series(2)) / std::f64::consts::FRAC_PI_2
    } else {
        s * series(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_equal_the_printed_table() {
        // Two-sided 90, 95, 99 % (any statistics text).
        let table = [
            (1, 6.3138, 12.7062, 63.6567),
            (2, 2.9200, 4.3027, 9.9248),
            (3, 2.3534, 3.1824, 5.8409),
            (4, 2.1318, 2.7764, 4.6041),
            (7, 1.8946, 2.3646, 3.4995),
            (10, 1.8125, 2.2281, 3.1693),
            (30, 1.6973, 2.0423, 2.7500),
            (120, 1.6577, 1.9799, 2.6174),
        ];
        for (dof, p90, p95, p99) in table {
            for (level, want) in [(0.90, p90), (0.95, p95), (0.99, p99)] {
                let found = two_sided(level, dof);
                assert!((found - want).abs() < 6e-5 * want, "{dof} {level}: {found}");
            }
        }
    }

    #[test]
    fn impossible_levels_give_no_interval() {
        assert_eq!(two_sided(0.95, 0), f64::INFINITY);
        assert_eq!(two_sided(1.0, 5), f64::INFINITY);
        assert_eq!(two_sided(f64::NAN, 5), f64::INFINITY);
    }
}
