//! Design B: discrete time at the real period, delay and drive lag as states, saturation allowed
//! and certified.
//!
//! The command is u = sat(K x), |u| <= umax(t), where umax(t) is what the reference leaves at that
//! moment and never less than the phase's `u_max`. If |H x| <= u_max for some row H, then sat(K x)
//! lies between K x and H x whatever the bound is at the moment (T. Hu, Z. Lin, "Control Systems with
//! Actuator Saturation", 2001, lemma 7.3.1; a bound that varies or differs by sign is covered as long as it
//! stays above |H x|). So for V(x) = x' P x the inequalities, for F in {K, H} and each (period, delay)
//!
//! ```text
//!   e^(-2 beta h) P - (A + B F)' P (A + B F) >= t h (W + r F'F)      h = period / time unit
//!   [[P, H'], [H, 1]] >= 0                             |H x| <= u_max on {V <= 1}
//!   I - G' P G >= 0                                    initial errors {G z, |z| <= 1} inside
//! ```
//!
//! prove: from every initial error the saturated loop stays in {V <= 1}, V falls in every step, and
//! the cost sum h (x' W x + r u^2) is at most 1/t. All in coordinates scaled by [`scales`], u by u_max.
//! t is maximised for given K and H, which is a small semidefinite program in P and t.
//!
//! K is searched for in the two-parameter family of a double integrator whose state is predicted
//! over the delay ([`Family`]): the damping with which the simulated loop settles first, and along it the largest
//! bandwidth for which the inequalities hold; H is a slow member of the same family acting on the drive's target.
//!
//! A plan whose braking is harder than its start leaves less for corrections later on, when the errors are long
//! gone. So each phase has its own certificate; the initial set of the next one is the ellipsoid {V <= sigma^2}
//! that the decay e^(-beta) per time unit leaves.

use super::certificate::{Region, SaturatedCertificate};
use super::evidence::settling_s;
pub use super::law::{Family, Gains, Weights, row, scales, time_unit_s};
use super::law::{certified_radius_rad, horizon_s};
use super::problem::Problem;
use super::region::{Ask, region};
use crate::model::{STATES, StateMatrix};
use nalgebra::DMatrix;

/// Why no saturated design exists for the data.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SaturatedError {
    /// Even the gentlest gains worth having are not certified.
    #[error(
        "joint {joint}: saturation binds: {u_max:.3} rad/s2 are left in phase {phase}, and no gains faster than \
         {omega_min} rad/s are certified for initial errors of {radius_rad} rad. Shrink the initial error to \
         {feasible_radius_rad:.4} rad, or leave {feasible_u_max:.3} rad/s2 (reference acceleration at most \
         {feasible_reference:.3} rad/s2)"
    )]
    SaturationBinds {
        joint: usize,
        /// Phase, from 1.
        phase: usize,
        /// Left for control, rad/s2.
        u_max: f64,
        /// Slowest bandwidth tried, rad/s.
        omega_min: f64,
        /// Requested radius, rad.
        radius_rad: f64,
        /// Largest radius that is certified (relaxed problem solved).
        feasible_radius_rad: f64,
        /// Smallest bound that certifies the requested radius (the problem is homogeneous).
        feasible_u_max: f64,
        /// What the reference may use then, rad/s2 (0 if the drive cannot give the bound at all).
        feasible_reference: f64,
    },
    /// The delay forbids even slow gains.
    #[error(
        "joint {joint}: delay binds: with {delay_s} s delay, a period of {period_s} s and {lag_s} s drive lag no \
         gains faster than {omega_min} rad/s are stable; shorten the period or the delay"
    )]
    DelayBinds {
        joint: usize,
        /// Largest delay.
        delay_s: f64,
        /// Nominal period.
        period_s: f64,
        lag_s: f64,
        /// Slowest bandwidth tried, rad/s.
        omega_min: f64,
    },
}

/// Slowest bandwidth worth tuning: at 3 rad/s an error halves in about half a second.
const OMEGA_MIN_RAD_S: f64 = 3.0;
/// Step of the search along the bandwidth.
const OMEGA_RATIO: f64 = 0.96;
/// Damping ratios tried.
const ZETAS: [f64; 3] = [0.65, 0.7, 0.8];
/// beta: range of the guaranteed decay per time unit of a phase. A clipped double integrator cannot decay faster
/// than its slow row; below the lower end the decay is negligible.
const DECAY: (f64, f64) = (0.06, 0.2);
/// A faster step takes about a tenth off the proven cost rate, per time unit: below this value no faster step can
/// be proven. Over 180 designs (standing and moving, three radii, five periods) the lowest rate with a provable
/// step above it was 0.094.
const LAST_COST_RATE: f64 = 0.09;
/// Errors can be so small that delay and lag take most of their time unit, at the latest when they have shrunk in a
/// phase. Decay and cost per time unit are then too large to prove, although nothing is clipped. Such errors are
/// certified as part of a set in whose time unit delay and lag take this share. Measured at 3 and 17 ms: with 0.36
/// some plans still cannot be certified, with 0.2 the gains are a quarter less stiff.
const HORIZON_SHARE_MAX: f64 = 0.28;
/// Factor by which a region has to be smaller than the bounds of a weaker phase require.
const SHRINK_SPARE: f64 = 1.2;

/// The decay of each phase: it shrinks the region in time for the phases with less acceleration for corrections.
pub(crate) fn decays(problem: &Problem) -> Vec<f64> {
    let phases = problem.phases();
    let (radius, first) = (problem.error_set().0, phases[0].u_max_rad_s2);
    let mut shrunk = 0.0f64;
    let decays = phases.iter().enumerate().map(|(i, phase)| {
        let Some(duration_s) = phase.duration_s else { return DECAY.0 };
        let certified_rad = certified_radius_rad(problem, radius * (-shrunk).exp(), phase.u_max_rad_s2);
        let units = duration_s / time_unit_s(certified_rad, phase.u_max_rad_s2);
        let weakest = phases[i + 1..].iter().map(|p| p.u_max_rad_s2).fold(f64::INFINITY, f64::min);
        let needed = ((SHRINK_SPARE * first / weakest).ln() - shrunk) / units;
        let decay = needed.clamp(DECAY.0, DECAY.1);
        shrunk += decay * units;
        decay
    });
    decays.collect()
}

/// Designs the gains of one joint and certifies them.
///
/// The gains are rounded to f32 before anything is proven: the certificate covers the numbers that the firmware
/// holds.
///
/// # Errors
/// [`SaturatedError`] with the binding condition and what to relax.
pub fn design(problem: &Problem) -> Result<SaturatedCertificate, SaturatedError> {
    attempt(problem, OMEGA_RATIO).ok_or_else(|| diagnose(problem))
}

/// For the errors as given, else for larger ones that hold them: [`HORIZON_SHARE_MAX`].
fn attempt(problem: &Problem, ratio: f64) -> Option<SaturatedCertificate> {
    let attempt = |problem: &Problem| search(problem, Weights::DEFAULT, ratio);
    attempt(problem).or_else(|| attempt(&problem.with_horizon_share_max(HORIZON_SHARE_MAX)))
}

/// Certifies given gains for the problem, e.g. those in a controller; `None` if not provable here.
pub fn certify(problem: &Problem, gains: Gains) -> Option<SaturatedCertificate> {
    certify_with(problem, gains, Weights::DEFAULT, &decays(problem))
}

/// Members of the family from the fastest down, in steps of `ratio`.
struct FrequencyGrid {
    omega_top: f64,
    ratio: f64,
    /// Number of the slowest.
    last: i32,
    horizon_s: f64,
}

impl FrequencyGrid {
    /// `None` if not even the slowest useful bandwidth is stable.
    fn new(problem: &Problem, ratio: f64) -> Option<Self> {
        let horizon_s = horizon_s(problem);
        // Beyond one radian of phase over the delay no member is stable.
        let omega_top = 1.0 / horizon_s;
        let last = ((omega_top / OMEGA_MIN_RAD_S).ln() / -ratio.ln()).floor();
        (last >= 0.0).then_some(Self { omega_top, ratio, last: last as i32, horizon_s })
    }

    fn gains(&self, step: i32, zeta: f64) -> Gains {
        let omega = self.omega_top * self.ratio.powi(step);
        Family { omega, zeta }.gains(self.horizon_s).map(|k| k as f32)
    }

    /// The step nearest to a bandwidth.
    fn step_of(&self, omega: f64) -> i32 {
        (((omega / self.omega_top).ln() / self.ratio.ln()).round() as i32).clamp(0, self.last)
    }

    /// The fastest step for which `proven` returns a result, searched from `guess` on with strides that double,
    /// then by bisection; it ends early with a result after which nothing is left.
    fn fastest<T>(
        &self,
        guess: i32,
        mut proven: impl FnMut(i32) -> Option<T>,
        is_last: impl Fn(&T) -> bool,
    ) -> Option<(i32, T)> {
        let (mut unproven, mut best, mut stride) = (-1, None, 1);
        let mut step = guess;
        // Downwards to something that is proven; upwards from there until nothing is.
        while best.is_none() && step <= self.last {
            match proven(step) {
                Some(found) => best = Some((step, found)),
                None => {
                    unproven = step;
                    step = if step < self.last { (step + stride).min(self.last) } else { step + 1 };
                    stride *= 2;
                }
            }
        }
        let mut best = best?;
        // The guess is seldom more than two steps too slow, and steps that cannot be proven cost most: two single steps first.
        let mut stride = 1;
        for strides in 0.. {
            if unproven >= 0 || best.0 == 0 || is_last(&best.1) {
                break;
            }
            let step = (best.0 - stride).max(0);
            match proven(step) {
                Some(found) => best = (step, found),
                None => unproven = step,
            }
            stride = if strides == 0 { 1 } else { 2 * stride };
        }
        while best.0 - unproven > 1 && !is_last(&best.1) {
            let middle = (best.0 + unproven).div_euclid(2);
            match proven(middle) {
                Some(found) => best = (middle, found),
                None => unproven = middle,
            }
        }
        Some(best)
    }
}

/// Square of a provable bandwidth over u_max / error radius: without delay, and what each time unit of
/// prediction takes away. Observed over joints and periods; only where the search begins.
const GUESS: (f64, f64) = (5.1, 9.5);

/// The fastest certified member along one damping ratio.
///
/// The damping is chosen by simulation at a bandwidth that is likely to be provable: the one with which the worst
/// initial error settles first. If nothing is provable along it, the next one is tried.
fn search(problem: &Problem, weights: Weights, ratio: f64) -> Option<SaturatedCertificate> {
    let grid = FrequencyGrid::new(problem, ratio)?;
    let u_max = problem.phases()[0].u_max_rad_s2;
    let radius = certified_radius_rad(problem, problem.error_set().0, u_max);
    let decays = decays(problem);
    let late = grid.horizon_s / time_unit_s(radius, u_max);
    let share = (GUESS.0 - GUESS.1 * late).max(1.0);
    let guess = grid.step_of((share * u_max / radius).sqrt());
    // Only the steps of the full search are what the rate was observed for.
    let last = if ratio == OMEGA_RATIO { LAST_COST_RATE } else { 0.0 };
    let sized = problem.with_scaled_error_set(radius / problem.error_set().0);
    let mut dampings = ZETAS.map(|zeta| (settling_s(&sized, grid.gains(guess, zeta), u_max), zeta));
    dampings.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    dampings.into_iter().find_map(|(_, zeta)| {
        let proven = |step| certify_with(problem, grid.gains(step, zeta), weights, &decays);
        grid.fastest(guess, proven, |found| found.cost_rate() < last).map(|(_, certificate)| certificate)
    })
}

/// One region per phase, each starting where the contraction of the one before has led; only what the
/// check proves over the whole box of periods and delays counts.
///
/// The inequalities are posed at the corners of the box. Two opposite ones suffice for a jitter of a few percent; at 20 % their
/// certificates often failed the check in between.
pub(crate) fn certify_with(
    problem: &Problem,
    gains: Gains,
    weights: Weights,
    decays: &[f64],
) -> Option<SaturatedCertificate> {
    let points = problem.corners();
    let regions = regions(problem, gains, (weights, decays), &points)?;
    let certificate = SaturatedCertificate { gains, weights, regions };
    certificate.check(problem).is_ok().then_some(certificate)
}

fn regions(
    problem: &Problem,
    gains: Gains,
    (weights, decays): (Weights, &[f64]),
    points: &[(f64, f64)],
) -> Option<Vec<Region>> {
    let mut regions: Vec<Region> = Vec::new();
    let mut generators = problem.error_generators();
    for (phase, &decay) in problem.phases().iter().zip(decays) {
        let region = region(problem, gains, *phase, &generators, &Ask { weights, decay, points })?;
        if let Some(duration) = phase.duration_s {
            let sigma = region.shrinkage(problem, duration);
            // {V <= sigma^2} = {S L^-T z sigma, |z| <= 1} with P = L L' in scaled coordinates.
            let l = region.p.cholesky()?.l();
            let back = StateMatrix::from_diagonal(&region.scales) * l.transpose().try_inverse()? * sigma;
            generators = DMatrix::from_column_slice(STATES, STATES, back.as_slice());
        }
        regions.push(region);
    }
    Some(regions)
}

/// Precision of the largest feasible error, as a ratio.
const NEAREST_RATIO: f64 = 1.01;

/// Finds the limiting condition by solving relaxed problems: without saturation first, then smaller sets. The
/// radius that it names is that of a finished design, as [`design`] makes it.
fn diagnose(problem: &Problem) -> SaturatedError {
    let joint = problem.joint();
    let feasible = |factor: f64| attempt(&problem.with_scaled_error_set(factor), OMEGA_RATIO).is_some();
    // Errors a thousandth of the size never saturate: what fails then is the delay.
    let tiny = 1e-3;
    if !feasible(tiny) {
        return SaturatedError::DelayBinds {
            joint,
            delay_s: problem.delay().high,
            period_s: problem.period_s(),
            lag_s: problem.drive().lag_s(),
            omega_min: OMEGA_MIN_RAD_S,
        };
    }
    let mut low: f64 = 0.5;
    while low > tiny && !feasible(low) {
        low *= 0.5;
    }
    let (mut low, mut high) = (low.max(tiny), 2.0 * low);
    while high > NEAREST_RATIO * low {
        let middle = (low * high).sqrt();
        *(if feasible(middle) { &mut low } else { &mut high }) = middle;
    }
    let (radius, _) = problem.error_set();
    let (phase, u_max) = problem
        .phases()
        .iter()
        .enumerate()
        .map(|(i, p)| (i + 1, p.u_max_rad_s2))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or((1, 0.0));
    // The loop is homogeneous: errors c times smaller need bounds c times smaller.
    let feasible_u_max = u_max / low;
    SaturatedError::SaturationBinds {
        joint,
        phase,
        u_max,
        omega_min: OMEGA_MIN_RAD_S,
        radius_rad: radius,
        feasible_radius_rad: radius * low,
        feasible_u_max,
        feasible_reference: (problem.acceleration_max_rad_s2() - feasible_u_max).max(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Result of the search over a list of steps of which those from `limit` down are proven, and the number of steps that it
    /// tried.
    fn found(limit: i32, guess: i32, ends: bool) -> (Option<i32>, usize) {
        let grid = FrequencyGrid { omega_top: 100.0, ratio: OMEGA_RATIO, last: 60, horizon_s: 0.01 };
        let mut asked = 0;
        let proven = |step| {
            asked += 1;
            (step >= limit).then_some(step)
        };
        let best = grid.fastest(guess, proven, |found| ends && *found == limit);
        (best.map(|(step, _)| step), asked)
    }

    #[test]
    fn fastest_proven_step_is_found_from_any_guess() {
        for limit in 0..=60 {
            for guess in 0..=60 {
                for ends in [false, true] {
                    assert_eq!(found(limit, guess, ends).0, Some(limit), "{limit} from {guess}");
                }
            }
        }
        assert_eq!(found(61, 30, false).0, None);
    }

    #[test]
    fn step_known_to_be_the_last_asks_no_further() {
        assert_eq!(found(30, 30, true).1, 1);
        assert_eq!(found(30, 30, false).1, 2);
        assert_eq!(found(29, 30, true).1, 2);
        // From an unproven guess the next slower step is already between two answers.
        assert_eq!(found(31, 30, true).1, 2);
    }
}
