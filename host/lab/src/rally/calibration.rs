//! Predicted probabilities against what came of them.

use serde::Serialize;

/// Upper ends of the bins of the predicted probability; the last one holds the rest.
const ENDS: [f64; 6] = [0.5, 0.7, 0.8, 0.9, 0.97, 1.0];

/// Catches whose predicted probability lies in one bin.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct CalibrationBin {
    /// Upper end of the bin.
    pub up_to: f64,
    /// Mean of the predictions; zero without any.
    pub predicted: f64,
    pub caught: usize,
    pub of: usize,
}

/// Bins of pairs (predicted probability, caught).
pub fn calibration(predictions: &[(f64, bool)]) -> Vec<CalibrationBin> {
    let mut bins = ENDS.map(|up_to| CalibrationBin { up_to, ..CalibrationBin::default() });
    for (predicted, caught) in predictions {
        let at = ENDS.iter().position(|end| predicted < end).unwrap_or(ENDS.len() - 1);
        bins[at].predicted += predicted;
        bins[at].caught += usize::from(*caught);
        bins[at].of += 1;
    }
    for bin in &mut bins {
        bin.predicted /= bin.of.max(1) as f64;
    }
    bins.to_vec()
}

/// Mean squared difference of prediction and result (Brier score); NaN without predictions.
pub fn brier(predictions: &[(f64, bool)]) -> f64 {
    let off = |(predicted, caught): &(f64, bool)| (predicted - f64::from(u8::from(*caught))).powi(2);
    predictions.iter().map(off).sum::<f64>() / predictions.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_mean_prediction_and_catches() {
        let bins = calibration(&[(0.1, false), (0.3, true), (0.95, true), (1.0, true)]);
        let held: Vec<_> = bins.iter().map(|bin| (bin.up_to, bin.caught, bin.of)).collect();
        assert_eq!(held, [(0.5, 1, 2), (0.7, 0, 0), (0.8, 0, 0), (0.9, 0, 0), (0.97, 1, 1), (1.0, 1, 1)]);
        assert!((bins[0].predicted - 0.2).abs() < 1e-12);
    }

    #[test]
    fn a_prediction_of_one_half_scores_one_quarter() {
        assert!((brier(&[(0.5, true), (0.5, false)]) - 0.25).abs() < 1e-12);
        assert!(brier(&[]).is_nan());
    }
}
