//! Current constants of a drive (paper eq. 9): I = K_B |qd| + K_M |tau|, friction apart.
//!
//! Both experiments are regressed with signs, I = K x + I_c d + I_0, where d is the direction of the
//! motion: then Coulomb friction (I_c) and the offset of the current sensor (I_0) do not end up in K.

use super::regression::{Estimate, Fit, RegressionError, fit};
use nalgebra::{DMatrix, DVector};

/// Mean current at a steady speed without load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSample {
    /// Mean measured joint speed, signed, rad/s.
    pub speed_rad_s: f64,
    /// Mean current, signed like the speed, A.
    pub current_a: f64,
}

/// Holding current in a pose, approached from one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldSample {
    /// Load torque computed from the robot model, N m.
    pub torque_nm: f64,
    /// Mean current, A.
    pub current_a: f64,
    /// Side from which the pose was approached: +1 moving up, -1 down; friction acts against it.
    pub approach: f64,
}

/// A current constant with its by-products.
#[derive(Clone, Debug, PartialEq)]
pub struct CurrentConstant {
    /// K_B in A s/rad or K_M in A/(N m).
    pub k: Estimate,
    /// Current that overcomes Coulomb friction, A.
    pub friction_a: Estimate,
    /// Offset of the measurement, A.
    pub offset_a: Estimate,
    pub fit: Fit,
}

/// R^2 below which the straight line is not believed.
const R_SQUARED_MIN: f64 = 0.95;
/// Largest half width of K relative to K.
const RELATIVE_HALF_WIDTH_MAX: f64 = 0.25;

/// K_B from steady speeds in both directions.
///
/// `speed_max_rad_s`: largest speed of the joint; the samples must reach from a third to two thirds of it.
///
/// # Errors
/// [`RegressionError`]: too few samples, one direction only, too small a range of speeds (a blocked joint has no
/// range), a poor fit or an interval too wide to use.
pub fn k_b(
    samples: &[SpeedSample],
    speed_max_rad_s: f64,
    level: f64,
) -> Result<CurrentConstant, RegressionError> {
    let speeds = || samples.iter().map(|s| s.speed_rad_s);
    check_finite(samples.iter().map(|s| s.speed_rad_s + s.current_a))?;
    let fastest = speeds().map(f64::abs).fold(0.0, f64::max);
    let needed = 2.0 / 3.0 * speed_max_rad_s;
    if fastest < needed {
        let advice =
            "run up to at least two thirds of the top speed; a joint that does not move is blocked or braked";
        return Err(RegressionError::Range { what: "speed (rad/s)", found: fastest, needed, advice });
    }
    for sign in [1.0, -1.0] {
        let side: Vec<f64> = speeds().map(|v| sign * v).filter(|v| *v > 0.0).collect();
        let (low, high) =
            (side.iter().fold(f64::INFINITY, |a, b| a.min(*b)), side.iter().fold(0.0, |a: f64, b| a.max(*b)));
        let spread = if side.is_empty() { 0.0 } else { high - low };
        let needed = speed_max_rad_s / 3.0;
        if spread < needed {
            let advice =
                "take several speeds in each direction: one alone does not separate friction from K_B";
            return Err(RegressionError::Range {
                what: "speeds of one direction (rad/s)",
                found: spread,
                needed,
                advice,
            });
        }
    }
    let rows: Vec<[f64; 3]> = samples.iter().map(|s| [s.speed_rad_s, s.speed_rad_s.signum(), 1.0]).collect();
    conclude("K_B", &rows, samples.iter().map(|s| s.current_a), level)
}

/// K_M from holding currents in several poses, approached from both sides.
///
/// `torque_max_nm`: largest load the arm itself can put on the joint; the samples must span a third.
///
/// # Errors
/// [`RegressionError`], as [`k_b`].
pub fn k_m(
    samples: &[HoldSample],
    torque_max_nm: f64,
    level: f64,
) -> Result<CurrentConstant, RegressionError> {
    check_finite(samples.iter().map(|s| s.torque_nm + s.current_a + s.approach))?;
    let low = samples.iter().map(|s| s.torque_nm).fold(f64::INFINITY, f64::min);
    let high = samples.iter().map(|s| s.torque_nm).fold(f64::NEG_INFINITY, f64::max);
    let spread = if samples.is_empty() { 0.0 } else { high - low };
    let needed = torque_max_nm / 3.0;
    if spread < needed {
        let advice = "choose poses in which gravity loads the joint more differently";
        return Err(RegressionError::Range { what: "load torque (N m)", found: spread, needed, advice });
    }
    let rows: Vec<[f64; 3]> = samples.iter().map(|s| [s.torque_nm, s.approach.signum(), 1.0]).collect();
    conclude("K_M", &rows, samples.iter().map(|s| s.current_a), level)
}

fn check_finite(sums: impl Iterator<Item = f64>) -> Result<(), RegressionError> {
    match sums.enumerate().find(|(_, s)| !s.is_finite()) {
        Some((index, _)) => Err(RegressionError::NotFinite { index }),
        None => Ok(()),
    }
}

fn conclude(
    what: &'static str,
    rows: &[[f64; 3]],
    currents: impl Iterator<Item = f64>,
    level: f64,
) -> Result<CurrentConstant, RegressionError> {
    let x = DMatrix::from_fn(rows.len(), 3, |i, j| rows[i][j]);
    let y = DVector::from_iterator(rows.len(), currents);
    let fit = fit(&x, &y, level, "take samples in both directions and with different speeds or loads")?;
    if fit.r_squared < R_SQUARED_MIN {
        let advice = "look for a rubbing cable, a load that was not expected, or a current that is cut off";
        return Err(RegressionError::PoorFit { r_squared: fit.r_squared, needed: R_SQUARED_MIN, advice });
    }
    let [k, friction_a, offset_a] = [fit.estimates[0], fit.estimates[1], fit.estimates[2]];
    if !(k.value > 0.0 && k.half_width < RELATIVE_HALF_WIDTH_MAX * k.value) {
        let advice = "take more samples or average longer";
        return Err(RegressionError::Uncertain { what, value: k.value, half_width: k.half_width, advice });
    }
    Ok(CurrentConstant { k, friction_a, offset_a, fit })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Noise;

    /// Table III of the paper with the top speeds of Table II: (K_B, K_M, rad/s, load N m).
    const DRIVES: [(f64, f64, f64, f64); 4] = [
        (2.9116, 0.1419, 2.6, 30.0),
        (0.7347, 0.0567, 2.6, 15.0),
        (0.4871, 0.013, 4.33, 8.0),
        (0.1572, 0.025, 5.58, 5.0),
    ];

    fn speeds(k_b: f64, top: f64, noise_a: f64, seed: u64) -> Vec<SpeedSample> {
        let mut noise = Noise::new(seed);
        let shares = [0.25, 0.4, 0.55, 0.7, 0.85, 1.0];
        let both = shares.iter().flat_map(|s| [*s, -*s]);
        both.map(|share| {
            let v: f64 = share * top;
            SpeedSample {
                speed_rad_s: v,
                current_a: k_b * v + 0.3 * v.signum() + 0.05 + noise_a * noise.normal(),
            }
        })
        .collect()
    }

    fn holds(k_m: f64, load: f64, noise_a: f64, seed: u64) -> Vec<HoldSample> {
        let mut noise = Noise::new(seed);
        let shares = [-1.0, -0.6, -0.2, 0.2, 0.6, 1.0];
        let both = shares.iter().flat_map(|s| [(*s, 1.0), (*s, -1.0)]);
        both.map(|(share, approach)| {
            let torque_nm = share * load;
            let current_a = k_m * torque_nm + 0.02 * approach - 0.01 + noise_a * noise.normal();
            HoldSample { torque_nm, current_a, approach }
        })
        .collect()
    }

    #[test]
    fn the_confidence_intervals_contain_the_constants_of_the_paper_as_often_as_they_claim() {
        for (k_b_true, k_m_true, top, load) in DRIVES {
            let (mut covered_b, mut covered_m, mut concluded) = (0, 0, 0);
            for seed in 0..100 {
                let b = k_b(&speeds(k_b_true, top, 0.05 * k_b_true * top, seed), top, 0.9);
                let m = k_m(&holds(k_m_true, load, 0.05 * k_m_true * load, 1000 + seed), load, 0.9);
                if let (Ok(b), Ok(m)) = (b, m) {
                    concluded += 1;
                    covered_b += usize::from(b.k.covers(k_b_true));
                    covered_m += usize::from(m.k.covers(k_m_true));
                }
            }
            assert_eq!(concluded, 100);
            // 90 expected, standard deviation 3; an interval that always covers is as wrong as one that seldom does.
            assert!((81..=98).contains(&covered_b), "K_B {k_b_true}: {covered_b}");
            assert!((81..=98).contains(&covered_m), "K_M {k_m_true}: {covered_m}");
        }
    }

    #[test]
    fn friction_and_offset_do_not_end_up_in_k() {
        let found = k_b(&speeds(2.9116, 2.6, 0.0, 1), 2.6, 0.95).unwrap();
        assert!((found.k.value - 2.9116).abs() < 1e-9);
        assert!((found.friction_a.value - 0.3).abs() < 1e-9 && (found.offset_a.value - 0.05).abs() < 1e-9);
    }

    #[test]
    fn blocked_joint_and_other_poor_data_are_refused() {
        // Blocked: full current, no speed.
        let blocked: Vec<_> =
            (0..12).map(|i| SpeedSample { speed_rad_s: 1e-4, current_a: 0.5 * f64::from(i) }).collect();
        assert!(matches!(
            k_b(&blocked, 2.6, 0.95),
            Err(RegressionError::Range { what: "speed (rad/s)", .. })
        ));
        let one_way: Vec<_> = speeds(2.9, 2.6, 0.0, 1).into_iter().filter(|s| s.speed_rad_s > 0.0).collect();
        assert!(matches!(k_b(&one_way, 2.6, 0.95), Err(RegressionError::Range { .. })));
        let noisy = speeds(2.9116, 2.6, 6.0, 3);
        assert!(matches!(k_b(&noisy, 2.6, 0.95), Err(RegressionError::PoorFit { .. })));
        let mut lost = speeds(2.9116, 2.6, 0.0, 1);
        lost[3].current_a = f64::NAN;
        assert_eq!(k_b(&lost, 2.6, 0.95), Err(RegressionError::NotFinite { index: 3 }));
        assert!(matches!(k_b(&[], 2.6, 0.95), Err(RegressionError::Range { .. })));
        let narrow: Vec<_> = holds(0.14, 30.0, 0.0, 1).into_iter().filter(|s| s.torque_nm > 20.0).collect();
        assert!(matches!(k_m(&narrow, 30.0, 0.95), Err(RegressionError::Range { .. })));
        // Approached from one side only: friction and offset are the same column.
        let one_side: Vec<_> =
            holds(0.14, 30.0, 0.0, 1).into_iter().map(|s| HoldSample { approach: 1.0, ..s }).collect();
        assert!(matches!(k_m(&one_side, 30.0, 0.95), Err(RegressionError::Rank { .. })));
        let backwards: Vec<_> = speeds(-2.9116, 2.6, 0.0, 1);
        assert!(matches!(k_b(&backwards, 2.6, 0.95), Err(RegressionError::Uncertain { .. })));
    }
}
