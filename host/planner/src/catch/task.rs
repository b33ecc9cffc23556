//! What is looked for, and how it is judged.

use nalgebra::Vector3;

use crate::motion_law::State;

/// How the hand moves at the catch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// With the ball: relative speed at most [`Settings::relative_m_s`].
    Matched,
    /// At rest.
    Hold,
}

/// Which catches are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Allowed {
    /// Only matched ones.
    Matched,
    /// Only those with the hand at rest.
    Hold,
    /// Both: the one that is more likely to keep the ball.
    Either,
}

/// What counts as a catch, and how it is chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Which catches.
    pub allowed: Allowed,
    /// Relative speed of a matched catch, m/s.
    pub relative_m_s: f64,
    /// Largest angle between the cup's axis and the reverse of the relative velocity, rad.
    pub cone_rad: f64,
    /// From the decision to the first motion, s.
    pub actuation_s: f64,
    /// No correction in the last time before the catch, s.
    pub freeze_s: f64,
    /// Standard deviation of the hand's own place at the catch, m.
    pub tracking_sigma_m: f64,
    /// Below this probability a catch is not begun.
    pub probability_min: f64,
    /// A change of the plan must be better by this probability.
    pub hysteresis: f64,
    /// Move out of the way of a ball that will not be caught.
    pub keep_clear: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            allowed: Allowed::Either,
            relative_m_s: 1.8,
            cone_rad: 26.0_f64.to_radians(),
            actuation_s: 0.008,
            freeze_s: 0.04,
            tracking_sigma_m: 0.002,
            probability_min: 0.05,
            hysteresis: 0.02,
            keep_clear: true,
        }
    }
}

/// Why there is no catch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Decline {
    /// The ball never comes near enough.
    #[error("the ball does not come within the arm's reach")]
    OutOfReach,
    /// It comes near enough, but no posture points the cup at it.
    #[error("no posture inside the joint ranges points the cup at the ball")]
    NoPosture,
    /// Postures exist, but not in the time that is left.
    #[error("the time left is too short for the joints' speed and acceleration")]
    TooLate,
    /// The hand cannot move with the ball.
    #[error("the joints are too slow to move with the ball")]
    TooFast,
    /// The way to where it could be caught, or the stop after it, leaves a range.
    #[error("every motion leaves a joint range, on its way to the catch or in its stop after it")]
    NoStop,
    /// The cup would look down where the hand stops after the catch.
    #[error("where the hand stops after every catch, the cup looks down and loses the ball")]
    CupDown,
    /// Contact with itself, the floor, the other arm.
    #[error("every motion touches the arm itself, the floor or the other arm")]
    Contact,
    /// The ball would hit a link first.
    #[error("the ball would hit the arm before it reaches the cup")]
    BallFirst,
    #[error("every motion asks for more current than the drives or supplies give")]
    Current,
    /// A motion leads to the ball, but whatever the hand does, the ball would leave the cup again.
    #[error("the ball would bounce out of the cup")]
    BouncesOut,
    /// Where the ball comes is known too badly.
    #[error("the flight is not known well enough for a catch to be likely")]
    TooUncertain,
}

/// How many candidates were judged, and how far they came.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Count {
    /// Time, direction and posture.
    pub judged: usize,
    /// With a posture inside what the joints can reach.
    pub posture: usize,
    /// With a motion inside the limits of speed, acceleration and jerk.
    pub motion: usize,
    /// Whole motions checked.
    pub checked: usize,
    pub(super) late: usize,
    pub(super) fast: usize,
    pub(super) no_stop: usize,
    pub(super) cup_down: usize,
}

/// The state that a search starts from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start<'a> {
    /// When the new motion begins, s.
    pub at_s: f64,
    /// State of the joints then.
    pub state: &'a [State; 6],
    /// The catch under way.
    pub under_way: Option<(f64, &'a Vector3<f64>, Mode)>,
}

/// Probability that the ball, normally distributed across with `sigma_m` about a point `off_m` beside the axis, passes the rim. A
/// bound from below: the circle about that point that fits in.
#[must_use]
pub(crate) fn passes_rim(radius_m: f64, off_m: f64, sigma_m: f64) -> f64 {
    let room = radius_m - off_m;
    if room <= 0.0 {
        return 0.0;
    }
    1.0 - (-0.5 * (room / sigma_m.max(1e-9)).powi(2)).exp()
}
