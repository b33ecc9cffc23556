//! Delays of a measured gripper, as a few nodes with weights.
//!
//! A Gauss rule of the measured distribution: `n` nodes integrate every polynomial of degree `2 n - 1` in the delay
//! as the mean over all measured delays does (Golub and Welsch 1969, by the recurrence of Stieltjes). So a gripper
//! that is mostly quick and sometimes late is represented exactly, not as a normal distribution with its standard
//! deviation.

use nalgebra::DMatrix;

/// Nodes at most.
const NODES: usize = 7;
/// Delays that are needed at least, and used at most.
pub(crate) const DELAYS_MIN: usize = 8;
/// See [`DELAYS_MIN`].
pub(crate) const DELAYS_MAX: usize = 1_000_000;
/// Largest distance of a delay from the mean of all, s.
pub(crate) const OFF_MAX_S: f64 = 0.05;

/// Release delays about their mean: nodes with weights. Unused ones have the weight zero.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReleaseNodes {
    /// Delays against the mean in s.
    pub delay_s: [f64; NODES],
    /// Weights; their sum is one.
    pub weight: [f64; NODES],
}

/// Why measured delays are refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DelaysRefused {
    #[error("{count} release delays: {DELAYS_MIN} to {DELAYS_MAX} are needed")]
    Count { count: usize },
    #[error("release delay {number} is {:.3} ms from the mean of all: at most {:.0} ms", 1e3 * off_s, 1e3 * OFF_MAX_S)]
    Off { number: usize, off_s: f64 },
}

impl ReleaseNodes {
    /// Mean of measured delays in s, and the nodes about it.
    ///
    /// # Errors
    /// [`DelaysRefused`]: fewer than 8 or more than a million, or one that is not a number or more than 50 ms from the mean.
    pub fn of(delays_s: &[f64]) -> Result<(f64, Self), DelaysRefused> {
        let count = delays_s.len();
        if !(DELAYS_MIN..=DELAYS_MAX).contains(&count) {
            return Err(DelaysRefused::Count { count });
        }
        let mean_s = delays_s.iter().sum::<f64>() / count as f64;
        let off_s: Vec<f64> = delays_s.iter().map(|delay| delay - mean_s).collect();
        let near = |off: &f64| off.abs() <= OFF_MAX_S;
        if let Some(at) = off_s.iter().position(|off| !near(off)) {
            return Err(DelaysRefused::Off { number: at + 1, off_s: off_s[at] });
        }
        Ok((mean_s, gauss_rule(&off_s)))
    }

    /// Delay in s and weight of each node that counts.
    pub fn iter(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.delay_s.iter().copied().zip(self.weight).filter(|(_, weight)| *weight > 0.0)
    }

    /// Standard deviation in s.
    #[must_use]
    pub fn sigma_s(&self) -> f64 {
        let mean: f64 = self.iter().map(|(delay, weight)| delay * weight).sum();
        self.iter().map(|(delay, weight)| weight * (delay - mean).powi(2)).sum::<f64>().sqrt()
    }

    /// Whether the numbers are delays within [`OFF_MAX_S`] with weights that add up to one.
    #[must_use]
    pub(crate) fn is_valid(&self) -> bool {
        let weights: f64 = self.weight.iter().sum();
        self.delay_s.iter().all(|delay| delay.abs() <= OFF_MAX_S)
            && self.weight.iter().all(|weight| (0.0..=1.0 + 1e-9).contains(weight))
            && (weights - 1.0).abs() < 1e-9
    }
}

/// Nodes and weights of the Gauss rule for the mean over `off_s`.
fn gauss_rule(off_s: &[f64]) -> ReleaseNodes {
    let scale_s = off_s.iter().fold(0.0_f64, |most, off| most.max(off.abs()));
    let mut rule = ReleaseNodes { delay_s: [0.0; NODES], weight: [0.0; NODES] };
    rule.weight[0] = 1.0;
    if scale_s == 0.0 {
        return rule;
    }
    let x: Vec<f64> = off_s.iter().map(|off| off / scale_s).collect();
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / x.len() as f64;
    // Monic orthogonal polynomials at the measured points: p_(k+1) = (x - a_k) p_k - b_k p_(k-1).
    let (mut before, mut now) = (vec![0.0; x.len()], vec![1.0; x.len()]);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    let mut norm_before = 1.0;
    for k in 0..NODES {
        let norm = mean(&mut now.iter().map(|p| p * p));
        // As many nodes as there are different delays, at most.
        if k > 0 && norm <= 1e-24 {
            break;
        }
        let a_k = mean(&mut now.iter().zip(&x).map(|(p, x)| x * p * p)) / norm;
        let b_k = if k == 0 { 0.0 } else { norm / norm_before };
        let next: Vec<f64> = (0..x.len()).map(|i| (x[i] - a_k) * now[i] - b_k * before[i]).collect();
        a.push(a_k);
        b.push(b_k);
        norm_before = norm;
        before = std::mem::replace(&mut now, next);
    }
    let n = a.len();
    let mut jacobi = DMatrix::zeros(n, n);
    for k in 0..n {
        jacobi[(k, k)] = a[k];
        if k > 0 {
            jacobi[(k, k - 1)] = b[k].sqrt();
            jacobi[(k - 1, k)] = b[k].sqrt();
        }
    }
    let eigen = jacobi.symmetric_eigen();
    let mut nodes: Vec<(f64, f64)> =
        (0..n).map(|k| (eigen.eigenvalues[k] * scale_s, eigen.eigenvectors[(0, k)].powi(2))).collect();
    nodes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let sum: f64 = nodes.iter().map(|(_, weight)| weight).sum();
    for (k, (delay_s, weight)) in nodes.into_iter().enumerate() {
        (rule.delay_s[k], rule.weight[k]) = (delay_s, weight / sum);
    }
    rule
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gripper that is quick nine times of ten, and 8 ms late else.
    fn skewed() -> Vec<f64> {
        (0..200)
            .map(|k| {
                let spread = 1e-3 * (f64::from(k) * 0.618_034 % 1.0 - 0.5);
                0.020 + spread + if k % 10 == 0 { 0.008 } else { 0.0 }
            })
            .collect()
    }

    #[test]
    fn nodes_have_all_moments_of_the_measured_delays_to_the_thirteenth() {
        let delays = skewed();
        let (mean_s, nodes) = ReleaseNodes::of(&delays).unwrap();
        assert!(nodes.is_valid() && nodes.iter().count() == NODES);
        for power in 0..=13 {
            let measured =
                delays.iter().map(|d| ((d - mean_s) / 0.005).powi(power)).sum::<f64>() / delays.len() as f64;
            let of_nodes: f64 = nodes.iter().map(|(d, w)| w * (d / 0.005).powi(power)).sum();
            assert!((measured - of_nodes).abs() < 1e-9 * measured.abs().max(1.0), "{power}: {of_nodes}");
        }
        let inside = delays.iter().fold((f64::MAX, f64::MIN), |(l, h), d| (l.min(*d), h.max(*d)));
        assert!(nodes.iter().all(|(d, _)| (inside.0..=inside.1).contains(&(d + mean_s))));
    }

    #[test]
    fn few_different_delays_are_nodes_themselves() {
        let (mean_s, nodes) = ReleaseNodes::of(&[0.02, 0.02, 0.02, 0.024, 0.02, 0.02, 0.02, 0.024]).unwrap();
        let found: Vec<(f64, f64)> = nodes.iter().collect();
        assert_eq!(found.len(), 2);
        assert!((found[0].0 + mean_s - 0.02).abs() < 1e-12 && (found[0].1 - 0.75).abs() < 1e-12);
        assert!((found[1].0 + mean_s - 0.024).abs() < 1e-12);
        let (_, same) = ReleaseNodes::of(&[0.02; 9]).unwrap();
        assert_eq!((same.sigma_s(), same.iter().count()), (0.0, 1));
    }

    #[test]
    fn lists_that_are_no_measurement_are_refused() {
        assert_eq!(ReleaseNodes::of(&[0.02; 7]), Err(DelaysRefused::Count { count: 7 }));
        let mut delays = vec![0.02; 20];
        delays[4] = f64::NAN;
        assert!(matches!(ReleaseNodes::of(&delays), Err(DelaysRefused::Off { .. })));
        delays[4] = 0.2;
        assert!(matches!(ReleaseNodes::of(&delays), Err(DelaysRefused::Off { number: 5, .. })));
    }
}
