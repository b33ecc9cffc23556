//! Where, when and how to catch: candidates, judged.
//!
//! ```text
//! times (up to 24) x cup directions (31 in a cone about -v) x postures (8)    judged: 5000 and more
//!   -> posture inside what every joint can reach by then                      intervals per time, no branch of the inverse
//!                                                                              kinematics is finished that is outside
//!   -> hand speed: at rest (hold), or v_ball - r u (matched), joint rates with the least use of the speed limits
//!   -> stop after the catch inside the ranges; least peak acceleration        closed forms
//!   -> predicted probability beats the worst of the best 24
//!   -> motion in exactly the time left, with jerk                             table of shapes
//!   -> way inside the joint ranges                                            exact extremes
//! best 24, in order: whole motion against limits, contacts, currents, ball     at most 6
//! ```

use nalgebra::Vector3;
use robot_model::Branch;
use robot_model::collision::CollisionChecker;

use super::Joints;
use super::arm::CatchArm;
use super::candidates::{Candidate, Search, directions};
use super::forecast::Forecast;
use super::law::{Limits, Pieces, State};
use super::motion::{CatchMotion, Fault, check, stopped};
use super::slot::{Slot, slots};

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
    /// Both; a matched one is worth more.
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

pub(super) const SHORTLIST: usize = 24;
/// Whole motions that are checked for one decision: bounds its time.
const CHECKS_MAX: usize = 6;
/// Candidates that are this near in time fail alike, s.
const ALIKE_S: f64 = 0.05;
/// A chosen catch.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// When the ball's centre is at the middle of the mouth, s.
    pub t_s: f64,
    /// Middle of the mouth then, m.
    pub p_m: Vector3<f64>,
    /// Direction of the cup.
    pub axis: Vector3<f64>,
    /// Hand at rest or moving with the ball.
    pub mode: Mode,
    /// Posture.
    pub branch: Branch,
    /// Joint angles and speeds at the catch.
    pub q: Joints,
    /// Joint speeds at the catch, rad/s.
    pub qd: Joints,
    /// Largest share of an acceleration or jerk limit that the motion uses.
    pub used: f64,
    /// Predicted probability of the catch.
    pub probability: f64,
    /// Ball against hand at the catch, m/s.
    pub relative_m_s: f64,
    /// The motion, with its stop.
    pub motion: CatchMotion,
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
    /// Contact with itself, the floor, the other arm.
    #[error("every motion touches the arm itself, the floor or the other arm")]
    Contact,
    /// The ball would hit a link first.
    #[error("the ball would hit the arm before it reaches the cup")]
    BallFirst,
    #[error("every motion asks for more current than the drives or supplies give")]
    Current,
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
pub fn passes_rim(radius_m: f64, off_m: f64, sigma_m: f64) -> f64 {
    let room = radius_m - off_m;
    if room <= 0.0 {
        return 0.0;
    }
    1.0 - (-0.5 * (room / sigma_m.max(1e-9)).powi(2)).exp()
}

/// The best catch.
///
/// # Errors
/// There is none: the reason of the candidates that came farthest.
pub fn search(
    arm: &CatchArm,
    settings: &Settings,
    start: &Start<'_>,
    forecast: &Forecast,
) -> (Result<Choice, Decline>, Count) {
    let limits = arm.limits(start.under_way.is_some());
    let slots = slots(arm, settings, start, forecast, limits);
    let best = Vec::with_capacity(SHORTLIST + 1);
    let mut search = Search { arm, settings, start, best, missed: None, count: Count::default() };
    if slots.is_empty() {
        return (Err(Decline::OutOfReach), search.count);
    }
    let rings = directions(settings.cone_rad);
    slots.iter().for_each(|slot| search.look(slot, &rings));
    if start.under_way.is_none() {
        search.look_nearby(forecast, limits);
    }
    let Search { best, mut count, .. } = search;
    if best.is_empty() {
        return (Err(why_none(arm, &slots, &count)), count);
    }
    if best[0].probability < settings.probability_min {
        return (Err(Decline::TooUncertain), count);
    }
    let mut checker = CollisionChecker::new(&arm.model, &arm.scene);
    let mut fault = None;
    let mut tried: Vec<(Branch, Mode, i64)> = Vec::with_capacity(SHORTLIST);
    // Different postures and times first: neighbours of one that fails fail as well.
    let (fresh, rest): (Vec<_>, Vec<_>) = best.iter().partition(|c| {
        let kind = (c.branch, c.mode, (c.ball.t_s / ALIKE_S) as i64);
        let new = !tried.contains(&kind);
        tried.push(kind);
        new
    });
    for candidate in fresh.into_iter().chain(rest).take(CHECKS_MAX) {
        count.checked += 1;
        let motion = motion_of(arm, limits, start, candidate);
        match check(arm, &mut checker, &motion, Some((forecast, candidate.ball.t_s))) {
            Ok(()) => return (Ok(choice_of(candidate, motion)), count),
            Err(why) => fault = fault.or(Some(why)),
        }
    }
    let why = match fault {
        Some(Fault::Range) => Decline::NoStop,
        Some(Fault::Limit) => Decline::TooLate,
        Some(Fault::Ball) => Decline::BallFirst,
        Some(Fault::Current) => Decline::Current,
        Some(Fault::Contact) | None => Decline::Contact,
    };
    (Err(why), count)
}

fn why_none(arm: &CatchArm, slots: &[Slot<'_>], count: &Count) -> Decline {
    if count.no_stop > 0 {
        return Decline::NoStop;
    }
    if count.late > 0 {
        return Decline::TooLate;
    }
    if count.fast > 0 {
        return Decline::TooFast;
    }
    // No posture in the windows: is there one in the ranges?
    let (low, high) = (arm.model.q_min(), arm.model.q_max());
    let mut any = false;
    for slot in slots {
        let p_b = arm.x_wb.inverse_transform_point(&slot.ball.p_m);
        let axis_b = arm.x_wb.rot.tr_mul(&-slot.u);
        arm.model.ik_axis(&arm.tool, &p_b, &axis_b, (&low, &high), |_, _| any = true);
    }
    if any { Decline::TooLate } else { Decline::NoPosture }
}

fn motion_of(arm: &CatchArm, limits: &[Limits; 6], start: &Start<'_>, candidate: &Candidate) -> CatchMotion {
    let left_s = candidate.ball.t_s - start.at_s;
    let mut joints: [Pieces; 6] = std::array::from_fn(|i| {
        let mut pieces = Pieces::starting(start.state[i]);
        arm.law.append(&candidate.fits[i], left_s, &mut pieces);
        pieces
    });
    stopped(arm, limits, &mut joints);
    CatchMotion { start_s: start.at_s, joints }
}

fn choice_of(candidate: &Candidate, motion: CatchMotion) -> Choice {
    Choice {
        t_s: candidate.ball.t_s,
        p_m: candidate.ball.p_m,
        axis: candidate.axis,
        mode: candidate.mode,
        branch: candidate.branch,
        q: candidate.q,
        qd: candidate.qd,
        used: candidate.used,
        probability: candidate.probability,
        relative_m_s: candidate.relative_m_s,
        motion,
    }
}
