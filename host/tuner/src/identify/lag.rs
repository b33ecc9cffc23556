//! Delay and position loop of a drive from its response to a step of the commanded acceleration.
//!
//! From rest, acceleration a is commanded at time 0. The position follows
//! y(t) = g(t - delay; wn, zeta) with g the answer of wn^2 / (s^2 + 2 zeta wn s + wn^2) to a t^2 / 2.
//! Delay, wn and zeta are found by damped Gauss-Newton steps on the squared error.

use super::regression::{Estimate, RegressionError};
use super::student::two_sided;
use crate::model::DriveLag;
use nalgebra::{Matrix3, Vector3};

/// A measured position after the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepSample {
    /// Time since the command was sent, s, >= 0.
    pub t_s: f64,
    /// Position less the position at rest, rad.
    pub position_rad: f64,
}

/// Result of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveAnswer {
    /// From command to the begin of its effect, s.
    pub delay_s: Estimate,
    /// Natural frequency, rad/s.
    pub wn_rad_s: Estimate,
    /// Damping ratio.
    pub zeta: Estimate,
    /// Delay plus 2 zeta/wn, s: what a slow motion lags; known far better than its parts.
    pub total_lag_s: Estimate,
    /// Standard deviation of the residuals, rad.
    pub residual_std_rad: f64,
}

/// Samples below which nothing is concluded.
const SAMPLES_MIN: usize = 20;
/// Gauss-Newton steps.
const STEPS_MAX: usize = 100;

/// Position `t_s` after the effect begins: closed form of the second-order answer to a t^2 / 2.
pub fn answer(drive: &DriveLag, acceleration_rad_s2: f64, t_s: f64) -> f64 {
    if t_s <= 0.0 {
        return 0.0;
    }
    let (wn, zeta, t, lag) = (drive.wn_rad_s, drive.zeta, t_s, drive.lag_s());
    // Particular solution t^2/2 - L t + c; the homogeneous one makes y(0) = y'(0) = 0.
    let c = lag * lag - 1.0 / (wn * wn);
    let (sigma, squared) = (zeta * wn, wn * wn * (1.0 - zeta * zeta));
    let wd = squared.abs().sqrt();
    let (cosine, sine_over_wd) = if wd * t < 1e-6 {
        (1.0, t)
    } else if squared > 0.0 {
        ((wd * t).cos(), (wd * t).sin() / wd)
    } else {
        ((wd * t).cosh(), (wd * t).sinh() / wd)
    };
    let transient = (-sigma * t).exp() * (-c * cosine + (lag - sigma * c) * sine_over_wd);
    acceleration_rad_s2 * (0.5 * t * t - lag * t + c + transient)
}

fn model(p: &Vector3<f64>, acceleration_rad_s2: f64, t_s: f64) -> f64 {
    answer(&DriveLag { wn_rad_s: p[1], zeta: p[2] }, acceleration_rad_s2, t_s - p[0])
}

/// Estimates delay, natural frequency and damping, starting from `guess` (delay s, drive).
///
/// # Errors
/// [`RegressionError`]: too few samples, no motion, parameters that the samples do not determine, or
/// residuals that the model does not explain.
pub fn identify(
    samples: &[StepSample],
    acceleration_rad_s2: f64,
    guess: (f64, DriveLag),
    level: f64,
) -> Result<DriveAnswer, RegressionError> {
    if samples.len() < SAMPLES_MIN {
        return Err(RegressionError::TooFew { found: samples.len(), unknowns: 3, needed: SAMPLES_MIN });
    }
    if let Some(index) = samples.iter().position(|s| !(s.t_s + s.position_rad).is_finite()) {
        return Err(RegressionError::NotFinite { index });
    }
    let last = samples.iter().map(|s| s.t_s).fold(0.0, f64::max);
    let moved = samples.iter().map(|s| s.position_rad.abs()).fold(0.0, f64::max);
    let needed = 0.25 * acceleration_rad_s2.abs() * (0.5 * last).powi(2);
    if moved < needed || needed == 0.0 {
        let advice = "the joint hardly moved: blocked, braked or not armed";
        return Err(RegressionError::Range { what: "position (rad)", found: moved, needed, advice });
    }
    let cost = |p: &Vector3<f64>| -> f64 {
        samples.iter().map(|s| (s.position_rad - model(p, acceleration_rad_s2, s.t_s)).powi(2)).sum()
    };
    let mut p = Vector3::new(guess.0, guess.1.wn_rad_s, guess.1.zeta);
    let mut best = cost(&p);
    let mut damping = 1e-3;
    let mut normal = Matrix3::zeros();
    for _ in 0..STEPS_MAX {
        let (jtj, jtr) = linearise(samples, acceleration_rad_s2, &p);
        normal = jtj;
        let mut damped = jtj;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(step) = damped.lu().solve(&jtr) else { break };
        let candidate = p + step;
        let sensible = candidate[0] > -last && candidate[1] > 1.0 && candidate[2] > 0.05;
        let found = if sensible { cost(&candidate) } else { f64::INFINITY };
        if found < best {
            let gain = (best - found) / best;
            (p, best) = (candidate, found);
            damping = (damping * 0.3).max(1e-12);
            if gain < 1e-12 {
                break;
            }
        } else {
            damping *= 4.0;
            if damping > 1e12 {
                break;
            }
        }
    }
    conclude(samples, &p, best, &normal, level)
}

/// J'J and J'r with central differences.
fn linearise(samples: &[StepSample], a: f64, p: &Vector3<f64>) -> (Matrix3<f64>, Vector3<f64>) {
    let h = Vector3::new(1e-6, 1e-4 * p[1], 1e-4 * p[2]);
    let (mut jtj, mut jtr) = (Matrix3::zeros(), Vector3::zeros());
    for s in samples {
        let row = Vector3::from_fn(|i, _| {
            let (mut up, mut down) = (*p, *p);
            up[i] += h[i];
            down[i] -= h[i];
            (model(&up, a, s.t_s) - model(&down, a, s.t_s)) / (2.0 * h[i])
        });
        jtj += row * row.transpose();
        jtr += row * (s.position_rad - model(p, a, s.t_s));
    }
    (jtj, jtr)
}

fn conclude(
    samples: &[StepSample],
    p: &Vector3<f64>,
    cost: f64,
    normal: &Matrix3<f64>,
    level: f64,
) -> Result<DriveAnswer, RegressionError> {
    let advice = "sample faster and longer, or use a larger acceleration";
    let Some(inverse) = normal.try_inverse() else {
        return Err(RegressionError::Rank { condition: f64::INFINITY, advice });
    };
    let dof = samples.len() - 3;
    let variance = cost / dof as f64;
    let mean = samples.iter().map(|s| s.position_rad).sum::<f64>() / samples.len() as f64;
    let total: f64 = samples.iter().map(|s| (s.position_rad - mean).powi(2)).sum();
    let r_squared = 1.0 - cost / total;
    if r_squared.is_nan() || r_squared < 0.99 {
        let advice = "the step is not that of a second-order position loop; look for a limit or a collision";
        return Err(RegressionError::PoorFit { r_squared, needed: 0.99, advice });
    }
    let t = two_sided(level, dof);
    let estimate = |gradient: Vector3<f64>, value: f64| Estimate {
        value,
        half_width: t * (variance * gradient.dot(&(inverse * gradient))).max(0.0).sqrt(),
    };
    let [delay_s, wn_rad_s, zeta] = [0, 1, 2].map(|i| {
        let mut e = Vector3::zeros();
        e[i] = 1.0;
        estimate(e, p[i])
    });
    if wn_rad_s.half_width.is_nan() || wn_rad_s.half_width >= 0.5 * wn_rad_s.value {
        let what = "natural frequency (rad/s)";
        return Err(RegressionError::Uncertain {
            what,
            value: p[1],
            half_width: wn_rad_s.half_width,
            advice,
        });
    }
    let total_lag_s =
        estimate(Vector3::new(1.0, -2.0 * p[2] / (p[1] * p[1]), 2.0 / p[1]), p[0] + 2.0 * p[2] / p[1]);
    Ok(DriveAnswer { delay_s, wn_rad_s, zeta, total_lag_s, residual_std_rad: variance.sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Estimator;
    use crate::noise::Noise;

    const TRUE: (f64, DriveLag) = (0.0021, DriveLag { wn_rad_s: 320.0, zeta: 0.8 });
    const GUESS: (f64, DriveLag) = (0.0, DriveLag { wn_rad_s: 200.0, zeta: 1.0 });

    /// Samples every 0.25 ms over 60 ms at 30 rad/s2 with noise in rad.
    fn step(noise_rad: f64, seed: u64) -> Vec<StepSample> {
        let mut noise = Noise::new(seed);
        (0..240)
            .map(|i| {
                let t_s = 2.5e-4 * f64::from(i);
                StepSample {
                    t_s,
                    position_rad: answer(&TRUE.1, 30.0, t_s - TRUE.0) + noise_rad * noise.normal(),
                }
            })
            .collect()
    }

    #[test]
    fn closed_form_equals_the_sampled_model() {
        for zeta in [0.3, 0.8, 1.0, 1.7] {
            let drive = DriveLag { wn_rad_s: 320.0, zeta };
            for t in [1e-4, 0.003, 0.02, 0.1] {
                let model = crate::model::sampled(&drive, &Estimator::PLAIN, t, 0.0);
                let want = model.b[0] * 30.0;
                let found = answer(&drive, 30.0, t);
                assert!((found - want).abs() < 1e-12 + 1e-9 * want.abs(), "{zeta} {t}: {found} {want}");
            }
        }
    }

    #[test]
    fn clean_step_gives_the_drive_back() {
        let found = identify(&step(0.0, 1), 30.0, GUESS, 0.95).unwrap();
        assert!((found.delay_s.value - TRUE.0).abs() < 1e-6, "{found:?}");
        assert!(
            (found.wn_rad_s.value - 320.0).abs() < 0.1 && (found.zeta.value - 0.8).abs() < 1e-3,
            "{found:?}"
        );
    }

    #[test]
    fn intervals_cover_as_often_as_they_say() {
        let (mut delay, mut lag, mut concluded) = (0, 0, 0);
        for seed in 0..100 {
            if let Ok(found) = identify(&step(2e-5, seed), 30.0, GUESS, 0.9) {
                concluded += 1;
                delay += usize::from(found.delay_s.covers(TRUE.0));
                lag += usize::from(found.total_lag_s.covers(TRUE.0 + TRUE.1.lag_s()));
            }
        }
        assert_eq!(concluded, 100);
        assert!((81..=98).contains(&delay) && (81..=98).contains(&lag), "{delay} {lag}");
    }

    #[test]
    fn blocked_joint_short_data_and_odd_motion_are_refused() {
        let blocked: Vec<_> = step(0.0, 1).iter().map(|s| StepSample { position_rad: 1e-6, ..*s }).collect();
        assert!(matches!(identify(&blocked, 30.0, GUESS, 0.95), Err(RegressionError::Range { .. })));
        assert!(matches!(
            identify(&step(0.0, 1)[..10], 30.0, GUESS, 0.95),
            Err(RegressionError::TooFew { .. })
        ));
        let wrong_way: Vec<_> = step(0.0, 1)
            .iter()
            .map(|s| StepSample {
                position_rad: 2e-3 * (400.0 * s.t_s).sin() + 0.03 * f64::from(u8::from(s.t_s > 0.03)),
                ..*s
            })
            .collect();
        assert!(identify(&wrong_way, 30.0, GUESS, 0.95).is_err());
    }
}
