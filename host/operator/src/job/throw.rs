//! The judge of a throw with the release at one instant.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::order::Order;
use super::record::{BallOutcome, Landing, LandingSource, Record};
use super::verdict::Outcome;
use crate::analysis::{Run, RunAnalysis, analyse};
use crate::port::Operator;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;

/// Smallest default tolerance, m: the steps of encoders and clocks and the tracking of a healthy arm stay below it.
pub const TOLERANCE_MIN_M: f64 = 0.010;
/// Largest default tolerance, m: a ball farther off has missed its target, whatever noise the plan assumes.
/// `--tolerance-m` sets a larger one.
pub const TOLERANCE_MAX_M: f64 = 0.100;
/// Square of the Mahalanobis distance that holds 99 % of a normal distribution in two dimensions: -2 ln 0.01.
const CHI_SQUARE_99: f64 = 9.210_340_371_976_18;

/// Distance from the target within which 99 % of the landings of this motion are, m, from [`TOLERANCE_MIN_M`] to
/// [`TOLERANCE_MAX_M`]: the offset of the mean, and the longer half-axis of the 99 % ellipse. Both are computed
/// again with the noise of the plan; the values in the file are not used.
#[must_use]
pub fn default_tolerance_m(arm: &RobotModel, plan: &PlanFile) -> f64 {
    let Some(plan) = plan.computed_again(arm) else { return TOLERANCE_MIN_M };
    let offset = Vector2::from(plan.landing.mean_m) - plan.target.aim().centre();
    let [[xx, xy], [yx, yy]] = plan.landing.covariance_m2;
    let radius_m = offset.norm() + radius_99_m(&Matrix2::new(xx, xy, yx, yy));
    if radius_m.is_finite() { radius_m.clamp(TOLERANCE_MIN_M, TOLERANCE_MAX_M) } else { TOLERANCE_MIN_M }
}

/// Longer half-axis of the ellipse that holds 99 % of a normal distribution.
pub(super) fn radius_99_m(covariance_m2: &Matrix2<f64>) -> f64 {
    let symmetric = (covariance_m2 + covariance_m2.transpose()) * 0.5;
    (CHI_SQUARE_99 * symmetric.symmetric_eigenvalues().max().max(0.0)).sqrt()
}

/// Result of the samples of the throw, and where the ball landed.
pub(super) fn observe(operator: &mut dyn Operator, order: &Order<'_>, plan: &PlanFile, record: &mut Record) {
    record.analysis = operator.take_samples(order.arm, record.drives.clone()).and_then(|samples| {
        let run = Run {
            samples: &samples,
            motion: order.program.motion(),
            throw: Some(plan),
            arm: order.arm,
            start: None,
            gripper_opening: record.gripper_opening,
            certified: record.certified,
        };
        analyse(&run).ok()
    });
    // If the ball is not observed, it counts as released if the gripper was ordered to open.
    let release = record.analysis.as_ref().and_then(|analysis| analysis.release);
    let ordered = release.is_some_and(|release| release.gripper_ordered_t_s.is_some());
    if record.ball == BallOutcome::Released || (record.ball == BallOutcome::NotObserved && ordered) {
        record.landing = landing(operator, plan, record.analysis.as_ref());
    }
}

/// Where the ball landed: known by the cell, or computed from the measured motion.
fn landing(operator: &mut dyn Operator, plan: &PlanFile, analysis: Option<&RunAnalysis>) -> Option<Landing> {
    let target = Vector3::from(plan.meeting_m());
    if let Some(ball) = operator.ball() {
        let (_, position_m) = ball.landing?;
        let planned_log_s = analysis.map(|analysis| analysis.start_log_s + plan.release_time_s);
        return Some(Landing {
            source: LandingSource::Cell,
            position_m,
            error_m: (position_m - target).norm(),
            uncertainty_m: None,
            release_late_s: ball.released_at.zip(planned_log_s).map(|(free, s)| free.as_secs_f64() - s),
            touch_after_s: ball.touch_after_s,
        });
    }
    computed_landing(plan, analysis?)
}

/// Landing computed from the measured motion; `None` if it was not measured about the release, or the ball does not
/// come down on the plane of the target.
#[must_use]
pub fn computed_landing(plan: &PlanFile, analysis: &RunAnalysis) -> Option<Landing> {
    let release = analysis.release?;
    let position_m = Vector3::from(release.landing_m?);
    Some(Landing {
        source: LandingSource::Measured,
        position_m,
        error_m: release.landing_error_m?,
        uncertainty_m: release.landing_uncertainty_m,
        release_late_s: Some(release.t_s - plan.release_time_s),
        touch_after_s: None,
    })
}

/// The ball of a throw that was stopped: observed, or computed from the measured motion if the release was ordered.
pub(super) fn ball_after_stop(record: &Record) -> String {
    match (record.ball, record.landing) {
        (BallOutcome::Released, Some(landing)) => {
            format!("; the ball left the hand and landed {:.1} mm from the target", 1e3 * landing.error_m)
        }
        (BallOutcome::NotObserved, Some(landing)) => {
            let [x, y, z] = landing.position_m.into();
            format!(
                "; the gripper was ordered to open before, and with the measured motion the ball lands at ({x:.3}, {y:.3}, {z:.3}) m, \
                 {:.1} mm from the target; nobody watched the ball",
                1e3 * landing.error_m
            )
        }
        (BallOutcome::Released, None) => "; the ball left the hand".to_owned(),
        (BallOutcome::InHand, _) => "; the ball is still in the hand".to_owned(),
        (BallOutcome::NotObserved, None) => String::new(),
    }
}

pub(super) fn verdict(record: &Record, tolerance_m: f64) -> (Outcome, String) {
    let tolerance = format!("the tolerance is {:.1} mm", 1e3 * tolerance_m);
    let release = record.analysis.as_ref().and_then(|analysis| analysis.release);
    let ordered_t_s = release.and_then(|release| release.gripper_ordered_t_s);
    let ordered = match ordered_t_s {
        Some(t_s) => format!("the gripper was ordered to open at {t_s:.3} s of the plan"),
        None => "no order to open the gripper was seen".to_owned(),
    };
    if record.ball == BallOutcome::InHand {
        return (Outcome::NotReleased, format!("not released: {ordered}; the ball is still in the hand"));
    }
    let Some(landing) = record.landing else {
        return match (record.ball, ordered_t_s, release) {
            (BallOutcome::Released, ..) => (
                Outcome::Missed,
                "missed: the ball left the hand and does not come down on the plane of the target".to_owned(),
            ),
            (_, None, Some(_)) => {
                (Outcome::NotReleased, format!("not released: the arm followed the plan, but {ordered}"))
            }
            _ => (
                Outcome::NotObserved,
                "thrown, not observed: the controller followed the plan to its end; the recording does not suffice to \
                 compute the landing, and nobody watched the ball"
                    .to_owned(),
            ),
        };
    };
    let (error_mm, [x, y, z]) = (1e3 * landing.error_m, landing.position_m.into());
    let place = format!("at ({x:.4}, {y:.4}, {z:.4}) m");
    let near = landing.error_m <= tolerance_m;
    match (landing.source, landing.touch_after_s) {
        (LandingSource::Cell, Some(after_s)) => {
            (Outcome::Missed, format!("missed: the ball touched the arm {after_s:.3} s after the release"))
        }
        (LandingSource::Cell, None) if near => (
            Outcome::Landed,
            format!("landed {error_mm:.1} mm from the target, {place} (the simulated ball; {tolerance})"),
        ),
        (LandingSource::Cell, None) => (
            Outcome::Missed,
            format!("missed: the ball landed {error_mm:.1} mm from the target, {place}; {tolerance}"),
        ),
        (LandingSource::Measured, _) if ordered_t_s.is_none() => {
            (Outcome::NotReleased, format!("not released: the arm followed the plan, but {ordered}"))
        }
        (LandingSource::Measured, _) => {
            let within = landing
                .uncertainty_m
                .map_or_else(String::new, |m| format!(", 99 % within {:.1} mm of that point", 1e3 * m));
            let known = format!(
                "{ordered}; with the measured motion the ball lands {error_mm:.1} mm from the target, {place}{within}; \
                 nobody watched the ball; {tolerance}"
            );
            if near {
                (Outcome::NotObserved, format!("thrown, not observed: {known}"))
            } else {
                (Outcome::Missed, format!("missed, as far as is known: {known}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_99_percent_radius_of_a_round_distribution_is_3_035_sigma() {
        let radius = radius_99_m(&(Matrix2::identity() * 0.004_f64.powi(2)));
        assert!((radius - 0.004 * 3.034_854_259).abs() < 1e-9, "{radius}");
        // The longer axis counts, in any direction.
        let turned = radius_99_m(&Matrix2::new(2.0, 1.0, 1.0, 2.0));
        assert!((turned - (CHI_SQUARE_99 * 3.0).sqrt()).abs() < 1e-12, "{turned}");
    }
}
