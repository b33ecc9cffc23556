//! Curves of a tuned joint: its response to an error, its loop over the frequency, and its certificate.

use super::design::{Proof, Tuned};
use super::margins::sensitivity;
use super::saturated::row;
use crate::model::{StateVector, steady_state};

/// Trajectories of the phase plane.
const STARTS: usize = 12;
/// Points of a curve over the frequency.
const FREQUENCIES: usize = 240;
/// Bandwidths up to which the loop is drawn.
const BANDWIDTHS: f64 = 8.0;
/// Sides of an ellipse.
const SIDES: usize = 120;

/// Points (x, y).
pub type Points = Vec<(f64, f64)>;

#[derive(Clone, Debug, PartialEq)]
pub struct Curves {
    /// Position error over time from the initial position error, s and rad: nominal, then at each corner of periods and delays.
    pub answers: Vec<Points>,
    /// |S| and |T| over the frequency, Hz: nominal, then at each corner.
    pub loops: Vec<[Points; 2]>,
    /// Largest |S| of all of them.
    pub sensitivity_max: f64,
    /// Boundary of the certified region, position error rad and velocity error rad/s.
    pub region: Points,
    /// Boundary of the initial errors.
    pub initial: Points,
    /// From that boundary, (position, velocity): stretches and whether the command is clipped on them.
    pub stretches: Vec<(bool, Points)>,
    /// sqrt(V) over time, s: largest from the boundary of the initial errors, at each corner; empty for the paper's design.
    pub falls: Vec<Points>,
    pub proven: Points,
}

/// Curves of `tuned`; periods and delays are those of the certificate.
#[must_use]
pub fn curves(tuned: &Tuned) -> Curves {
    let problem = &tuned.problem;
    let (e0, v0) = problem.error_set();
    let horizon_s =
        tuned.evidence.map_or(4.0 / tuned.figures.decay_1_s.max(0.5), |e| 1.2 * e.settling_s).clamp(0.1, 4.0);
    let timings: Vec<(f64, f64)> = problem.grid(1).into_iter().chain(problem.corners()).collect();
    let around = |i: usize| {
        let (s, c) = (std::f64::consts::TAU * i as f64 / SIDES as f64).sin_cos();
        (e0 * c, v0 * s)
    };
    let at = |start: (f64, f64), timing| run(tuned, steady_state(start.0, start.1), timing, horizon_s);
    let answers = timings.iter().map(|&timing| {
        let run = at((e0, 0.0), timing);
        run.iter().enumerate().map(|(n, (x, _))| (n as f64 * timing.0, x[0])).collect()
    });
    let bandwidth_hz = f64::from(-tuned.gains[0]).max(0.0).sqrt() / std::f64::consts::TAU;
    let top_hz = (BANDWIDTHS * bandwidth_hz).min(0.5 / problem.period().high);
    let hz: Vec<f64> = (1..=FREQUENCIES).map(|i| top_hz * i as f64 / FREQUENCIES as f64).collect();
    let loops: Vec<[Points; 2]> = timings
        .iter()
        .map(|&(period_s, delay_s)| {
            let model = problem.sampled(period_s, delay_s);
            let both: Vec<(f64, f64)> =
                hz.iter().map(|hz| sensitivity(&model, tuned.gains, period_s, *hz)).collect();
            let of = |pick: fn(&(f64, f64)) -> f64| hz.iter().copied().zip(both.iter().map(pick)).collect();
            [of(|b| b.0), of(|b| b.1)]
        })
        .collect();
    let sensitivity_max = loops.iter().flat_map(|[s, _]| s).map(|p| p.1).fold(0.0, f64::max);
    let mut stretches: Vec<(bool, Points)> = Vec::new();
    for i in 0..STARTS {
        let states = at(around(i * SIDES / STARTS), timings[0]);
        let mut done = 0;
        for piece in states.chunk_by(|a, b| a.1 == b.1) {
            // To where the next one begins.
            let end = (done + piece.len() + 1).min(states.len());
            let points = states[done..end].iter().map(|(x, _)| (x[0], x[1] + x[4]));
            stretches.push((piece[0].1, points.collect()));
            done += piece.len();
        }
    }
    let (falls, proven) = certificate(tuned, &timings[1..], horizon_s, &around);
    Curves {
        answers: answers.collect(),
        loops,
        sensitivity_max,
        region: region(tuned),
        initial: (0..=SIDES).map(around).collect(),
        stretches,
        falls,
        proven,
    }
}

/// From `x` at the certified bound: states, and whether the command was clipped.
fn run(
    tuned: &Tuned,
    mut x: StateVector,
    (period, delay): (f64, f64),
    horizon_s: f64,
) -> Vec<(StateVector, bool)> {
    let model = tuned.problem.sampled(period, delay);
    let k = row(tuned.gains);
    let u_max = tuned.problem.phases()[0].u_max_rad_s2;
    let steps = (horizon_s / period).ceil() as usize;
    (0..=steps)
        .map(|_| {
            let wanted = (k * x)[0];
            let now = (x, wanted.abs() >= u_max);
            x = model.a * x + model.b * wanted.clamp(-u_max, u_max);
            now
        })
        .collect()
}

/// sqrt(V) of the first phase: the largest from the initial errors at each timing, and the proven decay from its start.
fn certificate(
    tuned: &Tuned,
    timings: &[(f64, f64)],
    horizon_s: f64,
    around: &dyn Fn(usize) -> (f64, f64),
) -> (Vec<Points>, Points) {
    let Proof::Saturated(certificate, _) = &tuned.proof else { return Default::default() };
    let Some(region) = certificate.regions.first() else { return Default::default() };
    let of_timing = |&timing: &(f64, f64)| {
        let mut largest = Points::new();
        // The loop is odd: half a circle.
        for i in 0..SIDES / 2 {
            let (e, v) = around(i);
            for (n, (x, _)) in run(tuned, steady_state(e, v), timing, horizon_s).iter().enumerate() {
                let root = region.value(x).sqrt();
                match largest.get_mut(n) {
                    Some(point) => point.1 = point.1.max(root),
                    None => largest.push((n as f64 * timing.0, root)),
                }
            }
        }
        largest
    };
    let falls: Vec<Points> = timings.iter().map(of_timing).collect();
    let proven = (0..=60).map(|i| horizon_s * f64::from(i) / 60.0);
    (falls, proven.map(|t_s| (t_s, (-region.decay_1_s * t_s).exp())).collect())
}

/// Boundary of the projection of the certified region on (position, velocity), or of the paper's ellipsoid.
fn region(tuned: &Tuned) -> Points {
    let c = match &tuned.proof {
        Proof::Saturated(certificate, _) => {
            let Some(region) = certificate.regions.first() else { return Vec::new() };
            let Some(inverse) = region.p.cholesky().map(|l| l.inverse()) else { return Vec::new() };
            // Velocity is w + p in the model's states.
            let s = region.scales;
            let rows = [(0, 1.0), (1, 1.0), (4, 1.0)];
            let at = |a: usize, b: usize| inverse[(rows[a].0, rows[b].0)] * s[rows[a].0] * s[rows[b].0];
            (at(0, 0), at(0, 1) + at(0, 2), at(1, 1) + 2.0 * at(1, 2) + at(2, 2))
        }
        Proof::Paper(certificate, _) => {
            let (e, v) = tuned.problem.error_set();
            let q = &certificate.q;
            (q[(0, 0)] * e * e, q[(0, 1)] * e * v, q[(1, 1)] * v * v)
        }
    };
    // Points of {z' C^-1 z = 1}: C = L L'.
    let l11 = c.0.max(0.0).sqrt();
    let l21 = c.1 / l11;
    let l22 = (c.2 - l21 * l21).max(0.0).sqrt();
    (0..=SIDES)
        .map(|i| {
            let (s, k) = (std::f64::consts::TAU * i as f64 / SIDES as f64).sin_cos();
            (l11 * k, l21 * k + l22 * s)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::design::{Design, tune};
    use super::super::problem::tests::joint_1;
    use super::*;

    #[test]
    fn what_is_drawn_as_proven_bounds_what_is_simulated() {
        let tuned = tune(&joint_1(0.017), Design::Saturated).unwrap();
        let drawn = curves(&tuned);
        assert_eq!(drawn.falls.len(), tuned.problem.corners().len());
        for (t_s, root) in drawn.falls.iter().flatten() {
            assert!(*root <= (-tuned.decay_1_s() * t_s).exp(), "{root} at {t_s} s");
        }
        // Neither sensitivity is below 1 everywhere, and far above the bandwidth the loop has no effect.
        assert!((1.0..2.0).contains(&drawn.sensitivity_max), "{}", drawn.sensitivity_max);
        let [_, from_reference] = &drawn.loops[0];
        assert!((from_reference[0].1 - 1.0).abs() < 0.1, "{:?}", from_reference[0]);
        // Every trajectory stays in the region: its largest position is larger than theirs.
        let largest = |points: &Points| points.iter().map(|p| p.0.abs()).fold(0.0, f64::max);
        assert!(drawn.stretches.iter().all(|(_, points)| largest(points) <= largest(&drawn.region)));
    }
}
