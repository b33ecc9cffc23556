//! Mean and covariance of the landing as functions of the throw, with exact gradients.
//!
//! The sources of error are independent and normal. Each alone is set to the nodes of a Gauss-Hermite rule, and the
//! full model gives the landing: no linearisation, so that curvature counts (a nulled release delay leaves only
//! second and third order). Joint effects of two sources are left out; they are of fourth order in their standard
//! deviations. Drag is an exception: its mean is above its planned value, and the other sources are varied at the
//! mean. The Monte Carlo in [`super::statistics`] has everything at once.

use nalgebra::{Matrix2, Vector2};

use super::landed::Landed;
use super::layout::Layout;
use super::options::Noise;
use super::problem::Problem;
use crate::flight::{Aim, FlightModel};
use crate::solve::Gradient;
use crate::throw::Throw;

/// Nodes and weights of the 7-point Gauss-Hermite rule for the standard normal, without its centre: exact to the 13th
/// power of the delay.
pub(super) const SEVEN: [(f64, f64); 6] = [
    (-3.750_439_717_725_742, 5.482_688_559_722_184e-4),
    (-2.366_759_410_734_541, 0.030_757_123_967_586_5),
    (-1.154_405_394_739_968, 0.240_123_178_605_012_7),
    (1.154_405_394_739_968, 0.240_123_178_605_012_7),
    (2.366_759_410_734_541, 0.030_757_123_967_586_5),
    (3.750_439_717_725_742, 5.482_688_559_722_184e-4),
];
/// The same of the 3-point rule, exact to the fifth power; enough for what is nearly linear.
pub(super) const THREE: [(f64, f64); 2] = [(-THREE_NODE, 1.0 / 6.0), (THREE_NODE, 1.0 / 6.0)];
const THREE_NODE: f64 = 1.732_050_807_568_877_2;

/// One source of error at its nodes: weight and landing.
type Source = Vec<(f64, Landed)>;

/// Landing of a throw with noise.
#[derive(Debug, Clone)]
pub(crate) struct Spread {
    centre: Landed,
    sources: Vec<Source>,
    /// What each source moves the mean by, in m.
    shifts: Vec<Vector2<f64>>,
    /// Mean in m, in the coordinates of the aim.
    pub(crate) mean_m: Vector2<f64>,
    pub(crate) covariance_m2: Matrix2<f64>,
}

impl Spread {
    /// Of a throw at an aim; `None` if the ball does not meet its plane at some node.
    pub(crate) fn of(problem: &Problem<'_>, throw: &Throw, aim: &Aim, noise: &Noise) -> Option<Self> {
        // An unknown drag is not zero on average: the effects of the other sources are computed at the mean drag.
        let DragFlights { mean: flight, nodes: drag } = &DragFlights::of(&problem.flight, noise)?;
        let centre = Landed::of(problem, flight, throw, aim, 0.0)?;
        let mut sources: Vec<Source> = Vec::with_capacity(2 + 2 * problem.joints());
        let delays = release_delays(noise);
        if !delays.is_empty() {
            sources.push(at_nodes(&delays, |delay_s| Landed::of(problem, flight, throw, aim, delay_s))?);
        }
        for j in 0..problem.joints() {
            let of = |moved: Throw| Landed::of(problem, flight, &moved, aim, 0.0);
            if noise.position_rad > 0.0 {
                sources.push(at_nodes(&THREE, |node| {
                    let mut moved = *throw;
                    moved.q_rad[j] += node * noise.position_rad;
                    of(moved)
                })?);
            }
            if noise.speed_rad_s > 0.0 {
                sources.push(at_nodes(&THREE, |node| {
                    let mut moved = *throw;
                    moved.qd_rad_s[j] += node * noise.speed_rad_s;
                    of(moved)
                })?);
            }
        }
        if !drag.is_empty() {
            let source: Option<Source> = drag
                .iter()
                .map(|(weight, flight)| Some((*weight, Landed::of(problem, flight, throw, aim, 0.0)?)))
                .collect();
            sources.push(source?);
        }
        let (mut mean_m, mut covariance_m2) = (centre.xy, Matrix2::zeros());
        let mut shifts = Vec::with_capacity(sources.len());
        for source in &sources {
            let (mut shift, mut second) = (Vector2::zeros(), Matrix2::zeros());
            for (weight, landed) in source {
                let off = landed.xy - centre.xy;
                shift += off * *weight;
                second += off * off.transpose() * *weight;
            }
            mean_m += shift;
            covariance_m2 += second - shift * shift.transpose();
            shifts.push(shift);
        }
        Some(Self { centre, sources, shifts, mean_m, covariance_m2 })
    }

    /// Adds the gradient of a function of mean and covariance, given its derivatives by both:
    /// `df = by_mean · dμ + tr(by_covariance dC)`, `by_covariance` symmetric.
    pub(crate) fn add_gradient(
        &self,
        g: &mut Gradient<'_>,
        layout: &Layout,
        by_mean: &Vector2<f64>,
        by_covariance: &Matrix2<f64>,
    ) {
        // Every node contributes with its own weight; the sum of all contributions is taken from the centre.
        let mut rest = *by_mean;
        for (source, shift) in self.sources.iter().zip(&self.shifts) {
            for (weight, landed) in source {
                let off = landed.xy - self.centre.xy - shift;
                let pull = (by_mean + by_covariance * off * 2.0) * *weight;
                landed.add_gradient(g, layout, &pull);
                rest -= pull;
            }
        }
        self.centre.add_gradient(g, layout, &rest);
    }
}

/// Release delays in s with their weights; empty for an exact gripper.
pub(super) fn release_delays(noise: &Noise) -> Vec<(f64, f64)> {
    match &noise.release_nodes {
        Some(nodes) => nodes.iter().collect(),
        None if noise.release_time_s > 0.0 => {
            SEVEN.iter().map(|(node, weight)| (node * noise.release_time_s, *weight)).collect()
        }
        None => Vec::new(),
    }
}

/// Flights with a drag that is not known: with its mean, and at its nodes with their weights.
pub(super) struct DragFlights {
    pub(super) mean: FlightModel,
    /// Empty if the drag is known.
    pub(super) nodes: Vec<(f64, FlightModel)>,
}

impl DragFlights {
    /// `None` if no flight has so much drag.
    pub(super) fn of(flight: &FlightModel, noise: &Noise) -> Option<Self> {
        if noise.drag_per_m <= 0.0 {
            return Some(Self { mean: *flight, nodes: Vec::new() });
        }
        let nodes = drag_nodes(flight.drag_per_m(), noise.drag_per_m);
        let mean = flight.with_drag(nodes.iter().map(|(k, weight)| k * weight).sum()).ok()?;
        let nodes = nodes.into_iter().map(|(k, weight)| Some((weight, flight.with_drag(k).ok()?)));
        Some(Self { mean, nodes: nodes.collect::<Option<_>>()? })
    }
}

/// Nodes and weights for a drag constant `|k + σ n|`, n standard normal: drag is never negative.
///
/// Two nodes with the mean, variance and skewness of the folded normal distribution.
fn drag_nodes(drag_per_m: f64, sigma_per_m: f64) -> [(f64, f64); 2] {
    let (m, s) = (drag_per_m, sigma_per_m);
    let bell = (2.0 / std::f64::consts::PI).sqrt() * s * (-0.5 * (m / s).powi(2)).exp();
    let both = libm::erf(m / (s * std::f64::consts::SQRT_2));
    let first = bell + m * both;
    let variance = m * m + s * s - first * first;
    let third = (m * m * m + 3.0 * m * s * s) * both + (m * m + 2.0 * s * s) * bell;
    let deviation = variance.sqrt();
    let skew = (third - 3.0 * first * variance - first.powi(3)) / (variance * deviation);
    let half = 0.5 * skew;
    let root = (1.0 + half * half).sqrt();
    [
        (first + deviation * (half - root), 0.5 * (1.0 + half / root)),
        (first + deviation * (half + root), 0.5 * (1.0 - half / root)),
    ]
}

fn at_nodes(rule: &[(f64, f64)], landing: impl Fn(f64) -> Option<Landed>) -> Option<Source> {
    rule.iter().map(|(node, weight)| Some((*weight, landing(*node)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::rng::SplitMix64;

    #[test]
    fn drag_nodes_have_the_moments_of_drawn_drag_and_are_not_negative() {
        let mut rng = SplitMix64::new(4);
        for (k, sigma) in [(0.0, 5e-3), (2e-3, 5e-3), (0.05, 5e-3)] {
            let nodes = drag_nodes(k, sigma);
            assert!(nodes.iter().all(|(k, w)| *k > 0.0 && *w > 0.0), "{nodes:?}");
            let draws = 200_000;
            for power in [0, 1, 2, 3] {
                let of_nodes: f64 = nodes.iter().map(|(k, w)| w * k.powi(power)).sum();
                let drawn = (0..draws).map(|_| (k + sigma * rng.normal()).abs().powi(power)).sum::<f64>()
                    / f64::from(draws);
                assert!((of_nodes / drawn - 1.0).abs() < 0.02, "{k} {power}: {of_nodes}, drawn {drawn}");
            }
        }
    }

    #[test]
    fn rules_integrate_moments_of_the_normal() {
        for (rule, powers) in [(&SEVEN[..], &[2, 4, 6, 8, 10, 12][..]), (&THREE[..], &[2, 4][..])] {
            for power in powers {
                let moment: f64 = (1..*power).step_by(2).map(f64::from).product();
                let sum: f64 = rule.iter().map(|(x, w)| w * x.powi(*power)).sum();
                assert!((sum - moment).abs() < 1e-9 * moment, "{power}: {sum}");
            }
        }
    }
}
