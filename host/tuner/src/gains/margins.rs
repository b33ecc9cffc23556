//! Linear figures of a loop: how fast it decays unsaturated, and how much more delay it bears.

use super::problem::Problem;
use super::saturated::{Gains, row};
use crate::model::{STATES, Sampled};
use nalgebra::{Complex, SMatrix};

/// Figures at the nominal period and delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearFigures {
    /// Largest eigenvalue magnitude per period; below 1 for a stable loop.
    pub spectral_radius: f64,
    /// Decay of the slowest mode, 1/s (negative: unstable).
    pub decay_1_s: f64,
    /// Additional delay at which the loop becomes unstable, s (0 for an unstable loop).
    pub delay_margin_s: f64,
}

/// Computes them.
pub(super) fn linear_figures(problem: &Problem, gains: Gains) -> LinearFigures {
    let (period, delay) = problem.grid(1)[0];
    let model = problem.sampled(period, delay);
    let k = row(gains);
    let radius = (model.a + model.b * k).complex_eigenvalues().iter().map(|z| z.norm()).fold(0.0, f64::max);
    let delay_margin_s = if radius < 1.0 { delay_margin(&model, gains, period) } else { 0.0 };
    LinearFigures { spectral_radius: radius, decay_1_s: -radius.ln() / period, delay_margin_s }
}

/// Loop gain -K (zI - A)^-1 B at `omega`, rad/s.
fn loop_gain(model: &Sampled, gains: Gains, period: f64, omega: f64) -> Complex<f64> {
    let complex = |x: f64| Complex::new(x, 0.0);
    let (k, a, b) = (row(gains).map(complex), model.a.map(complex), model.b.map(complex));
    let z = Complex::from_polar(1.0, omega * period);
    match (SMatrix::<Complex<f64>, STATES, STATES>::from_diagonal_element(z) - a).lu().solve(&b) {
        Some(x) => -(k * x)[0],
        None => complex(f64::INFINITY),
    }
}

/// Sensitivity |1 / (1 + L)| and complementary sensitivity |L / (1 + L)| at a frequency.
pub(super) fn sensitivity(model: &Sampled, gains: Gains, period: f64, hz: f64) -> (f64, f64) {
    let l = loop_gain(model, gains, period, std::f64::consts::TAU * hz);
    let s = (l + 1.0).norm().recip();
    (s, s * l.norm())
}

/// Smallest (phase margin / frequency) over the crossings |L| = 1 of the loop.
fn delay_margin(model: &Sampled, gains: Gains, period: f64) -> f64 {
    let loop_gain = |omega: f64| loop_gain(model, gains, period, omega);
    let nyquist = std::f64::consts::PI / period;
    let points = 1000;
    // Logarithmic from a thousandth of Nyquist: crossings are around the bandwidth.
    let omega = |i: i32| nyquist * 10f64.powf(-3.0 * (1.0 - f64::from(i) / f64::from(points)));
    let mut margin = f64::INFINITY;
    let mut previous = loop_gain(omega(0));
    for i in 1..=points {
        let (w, now) = (omega(i), loop_gain(omega(i)));
        if (previous.norm() - 1.0) * (now.norm() - 1.0) <= 0.0 {
            // Phase above -180 degrees; more delay turns it clockwise until it gets there.
            let phase = (now.arg() + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU);
            margin = margin.min(phase / w);
        }
        previous = now;
    }
    margin
}

#[cfg(test)]
mod tests {
    use super::super::problem::tests::joint_1;
    use super::*;

    /// Delay up to the period is in the model itself, so the predicted margin can be walked up to.
    #[test]
    fn delay_margin_predicts_where_the_sampled_loop_turns_unstable() {
        // Feedback of error and rate only: the term of the last command counts on a delay and needs one.
        let period_s = 0.02;
        let mut input = joint_1(period_s);
        let gains = [-417.0, -38.8, 0.0];
        let radius = |delay: f64, input: &mut crate::gains::problem::JointInput| {
            input.delay_s = (delay, delay);
            linear_figures(&Problem::new(input).unwrap(), gains)
        };
        assert!(radius(0.0, &mut input).spectral_radius < 1.0, "unstable without any delay");
        assert!(radius(period_s, &mut input).spectral_radius > 1.0, "stable at a delay of a whole period");
        // The largest delay that is still stable, by bisection on the eigenvalues.
        let (mut stable, mut unstable) = (0.0, period_s);
        for _ in 0..40 {
            let middle = 0.5 * (stable + unstable);
            if radius(middle, &mut input).spectral_radius < 1.0 { stable = middle } else { unstable = middle }
        }
        for share in [0.8, 0.9, 0.95] {
            let margin = radius(share * stable, &mut input).delay_margin_s;
            let left = (1.0 - share) * stable;
            // A pure delay of a sampled loop is not a shift of its hold; close by they agree.
            assert!((0.5 * left..1.5 * left).contains(&margin), "{margin} {left}");
        }
        assert_eq!(radius(period_s, &mut input).delay_margin_s, 0.0);
    }
}
