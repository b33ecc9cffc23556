//! How a throw ended: what is known of the ball, and the verdict.
//!
//! | outcome | JSON | known from |
//! |---|---|---|
//! | [`Outcome::Landed`] | `landed` | an observer watched the ball land within the tolerance |
//! | [`Outcome::NotObserved`] | `not_observed` | the arm followed the plan and the release was ordered; nobody watched the ball |
//! | [`Outcome::Missed`] | `missed` | the ball landed beyond the tolerance, or touched the arm; or the measured motion sends it beyond |
//! | [`Outcome::NotReleased`] | `not_released` | the ball is still in the hand, or the release was never ordered |
//! | [`Outcome::Stopped`] | `stopped` | the arm was stopped while it moved, or by somebody else at any time |
//! | [`Outcome::NotThrown`] | `not_thrown` | the job ended before the throw, with the arm at rest |
//!
//! Only the simulated cell inside the program tells where its ball is. On every other bus nobody watches the ball, so
//! the outcome is never [`Outcome::Landed`] there.

use nalgebra::{Matrix2, Vector2};

pub use super::record::{BallOutcome, Landing, LandingSource};
use super::record::{Job, JobError, Record, Step};
use crate::dialogue::operator::OperatorError;
use planner::plan::file::PlanFile;
use robot_model::RobotModel;

/// Smallest default tolerance, m: the steps of encoders and clocks and the tracking of a healthy arm stay below it.
pub const TOLERANCE_MIN_M: f64 = 0.010;
/// Largest default tolerance, m: whatever noise a plan is made for, a ball farther off is beside its target. `--tolerance` asks for
/// more.
pub const TOLERANCE_MAX_M: f64 = 0.100;
/// Square of the Mahalanobis distance that holds 99 % of a normal distribution in two dimensions: -2 ln 0.01.
const CHI_SQUARE_99: f64 = 9.210_340_371_976_18;

/// How a throw ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Outcome {
    /// The ball was seen to land within the tolerance.
    Landed,
    /// The arm followed the plan and the release was ordered; nobody watched the ball.
    NotObserved,
    /// The ball landed beyond the tolerance or touched the arm, or the measured motion sends it beyond.
    Missed,
    /// The ball is still in the hand, or the release was never ordered.
    NotReleased,
    /// The arm was stopped while it moved, or by somebody else at any time.
    Stopped,
    /// The job ended before the throw, with the arm at rest.
    NotThrown,
}

impl Outcome {
    pub const ALL: [Self; 6] =
        [Self::Landed, Self::NotObserved, Self::Missed, Self::NotReleased, Self::Stopped, Self::NotThrown];

    /// Field `outcome` of `summary.json`.
    #[must_use]
    pub const fn json_name(self) -> &'static str {
        match self {
            Self::Landed => "landed",
            Self::NotObserved => "not_observed",
            Self::Missed => "missed",
            Self::NotReleased => "not_released",
            Self::Stopped => "stopped",
            Self::NotThrown => "not_thrown",
        }
    }

    /// The outcome with this JSON name.
    #[must_use]
    pub fn from_json_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|outcome| outcome.json_name() == name)
    }

    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Landed => "landed",
            Self::NotObserved => "thrown, not observed",
            Self::Missed => "missed",
            Self::NotReleased => "not released",
            Self::Stopped => "stopped",
            Self::NotThrown => "not thrown",
        }
    }
}

/// How a throw ended, and what a person reads about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    pub outcome: Outcome,
    /// What is known, in one sentence or two.
    pub text: String,
    /// A landing farther from the target than this counts as missed, m.
    pub tolerance_m: f64,
}

/// Distance from the target within which 99 % of the landings of this motion lie, m, from [`TOLERANCE_MIN_M`] to
/// [`TOLERANCE_MAX_M`]: the offset of the mean, and the longer half-axis of the 99 % ellipse. Both are computed again with the
/// noise of the plan; what the file says of them counts for nothing.
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

/// The verdict about a job that ended with `ended`.
#[must_use]
pub fn judge(job: &Job<'_>, record: &Record, ended: Result<(), &JobError>) -> Verdict {
    let tolerance_m = job.tolerance_m;
    let (outcome, text) = match ended {
        Err(error) => {
            let outcome = if was_stopped(record, error) { Outcome::Stopped } else { Outcome::NotThrown };
            let (words, step) = (outcome.words(), record.at_work.map_or("throw", |(step, _)| step.name()));
            let told = error.to_string();
            let first = told.lines().next().unwrap_or_default();
            (outcome, format!("{words} in the step \"{step}\": {first}{}", ball_after_stop(record)))
        }
        Ok(()) => ball_verdict(record, tolerance_m),
    };
    Verdict { outcome, text, tolerance_m }
}

/// What became of the ball of a throw that was stopped: seen, or computed from the measured motion if the release was ordered.
fn ball_after_stop(record: &Record) -> String {
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

/// The arm was stopped: by somebody else at any time, or by the controller or this program while it moved.
fn was_stopped(record: &Record, error: &JobError) -> bool {
    if matches!(error, JobError::Operator(error) if error.is_stop_by_other()) {
        return true;
    }
    let Some((step, _)) = record.at_work else { return false };
    // After the throw the ball is gone: "not thrown" would be wrong.
    if matches!(step, Step::Flight | Step::Return) {
        return true;
    }
    let moves = matches!(step, Step::Home | Step::Approach | Step::Throw);
    // An order that was refused moved nothing.
    moves && matches!(error, JobError::Operator(error) if !matches!(error, OperatorError::Refused { .. }))
}

fn ball_verdict(record: &Record, tolerance_m: f64) -> (Outcome, String) {
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
    fn every_outcome_has_its_own_json_name() {
        for (i, outcome) in Outcome::ALL.into_iter().enumerate() {
            assert_eq!(Outcome::from_json_name(outcome.json_name()), Some(outcome));
            assert!(Outcome::ALL[..i].iter().all(|other| other.json_name() != outcome.json_name()));
        }
        assert_eq!(Outcome::from_json_name("Landed"), None);
    }

    #[test]
    fn the_99_percent_radius_of_a_round_distribution_is_3_035_sigma() {
        let radius = radius_99_m(&(Matrix2::identity() * 0.004_f64.powi(2)));
        assert!((radius - 0.004 * 3.034_854_259).abs() < 1e-9, "{radius}");
        // The longer axis counts, whatever its direction.
        let turned = radius_99_m(&Matrix2::new(2.0, 1.0, 1.0, 2.0));
        assert!((turned - (CHI_SQUARE_99 * 3.0).sqrt()).abs() < 1e-12, "{turned}");
    }
}
