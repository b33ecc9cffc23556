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
//! best 24, in order: whole motion against limits, contacts, currents, ball     at most 6
//! ```

use nalgebra::{Matrix3, Vector3};
use robot_model::Branch;
use robot_model::collision::CollisionChecker;

use super::Joints;
use super::arm::CatchArm;
use super::forecast::{Forecast, Foreseen, across};
use super::law::{Fit, Limits, Pieces, State, least_peak, stopping_angle};
use super::motion::{CatchMotion, Fault, check, stopped};

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

/// What a matched catch is worth against one with the hand at rest, as a factor on the probability of the latter.
const HOLD_WORTH: f64 = 0.9;
const TIMES_MAX: usize = 24;
const SHORTLIST: usize = 24;
/// Whole motions that are checked for one decision: bounds its time.
const CHECKS_MAX: usize = 6;
/// Candidates that are this near in time fail alike, s.
const ALIKE_S: f64 = 0.05;
/// A correction moves the hand on a lever of this length about one axis, m: used for what corrections can reach.
const LEVER_M: f64 = 0.8;

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
    /// Where it could be caught, the arm could not stop inside its ranges.
    #[error("the arm could not stop inside its joint ranges after the catch")]
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
    late: usize,
    fast: usize,
    no_stop: usize,
}

#[derive(Clone, Copy)]
struct Candidate {
    ball: Foreseen,
    axis: Vector3<f64>,
    branch: Branch,
    mode: Mode,
    q: Joints,
    qd: Joints,
    fits: [Fit; 6],
    used: f64,
    probability: f64,
    relative_m_s: f64,
    score: f64,
}

/// What is the same for all candidates of one time.
struct Slot<'a> {
    ball: Foreseen,
    u: Vector3<f64>,
    speed: f64,
    left_s: f64,
    sigma_m: f64,
    sigma_end_m: f64,
    limits: &'a [Limits; 6],
    low: Joints,
    high: Joints,
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
    let mut count = Count::default();
    let limits = arm.limits(start.under_way.is_some());
    let slots = slots(arm, settings, start, forecast, limits);
    if slots.is_empty() {
        return (Err(Decline::OutOfReach), count);
    }
    let rings = directions(settings.cone_rad);
    let mut best: Vec<Candidate> = Vec::with_capacity(SHORTLIST + 1);
    for slot in &slots {
        let (a, b) = across(&slot.u);
        let kept =
            start.under_way.filter(|(t_s, ..)| (t_s - slot.ball.t_s).abs() < 0.02).map(|(_, axis, _)| *axis);
        let kept = kept.filter(|axis| -axis.dot(&slot.u) >= settings.cone_rad.cos());
        let axes = rings.iter().map(|[x, y, z]| a * *x + b * *y - slot.u * *z).chain(kept);
        for axis in axes {
            let p_b = arm.x_wb.inverse_transform_point(&slot.ball.p_m);
            let axis_b = arm.x_wb.rot.tr_mul(&axis);
            count.judged += Branch::COUNT;
            arm.model.ik_axis(&arm.tool, &p_b, &axis_b, (&slot.low, &slot.high), |branch, q| {
                count.posture += 1;
                for mode in [Mode::Matched, Mode::Hold] {
                    judge(arm, settings, start, slot, (&axis, branch, mode), q, &mut best, &mut count);
                }
            });
        }
    }
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

fn slots<'a>(
    arm: &CatchArm,
    settings: &Settings,
    start: &Start<'_>,
    forecast: &Forecast,
    limits: &'a [Limits; 6],
) -> Vec<Slot<'a>> {
    let reach = arm.reach_m();
    let shoulder = arm.shoulder_m();
    let near = |ball: &Foreseen| {
        ball.t_s > start.at_s + settings.freeze_s
            && (ball.p_m - shoulder).norm() < reach
            && ball.v_m_s.norm() > 0.1
    };
    let all: Vec<&Foreseen> = forecast.points.iter().filter(|ball| near(ball)).collect();
    let stride = all.len().div_ceil(TIMES_MAX).max(1);
    let mut balls: Vec<Foreseen> = all.into_iter().step_by(stride).copied().collect();
    if let Some((t_s, ..)) = start.under_way {
        // The time under way and its neighbours, so that corrections stay small.
        balls.extend([-0.004, 0.0, 0.004].iter().filter_map(|d| forecast.at(t_s + d)).filter(|b| near(b)));
    }
    let slot = |ball: Foreseen| {
        let left_s = ball.t_s - start.at_s;
        let (mut low, mut high) = (Joints::zeros(), Joints::zeros());
        for (i, (limit, state)) in limits.iter().zip(start.state).enumerate() {
            let most = limit.v_rad_s * left_s;
            let push = 0.5 * limit.a_rad_s2 * left_s * left_s;
            let drift = state.v * left_s;
            low[i] = limit.q_rad.0.max(state.q + (drift - push).max(-most));
            high[i] = limit.q_rad.1.min(state.q + (drift + push).min(most));
        }
        // The roll stays: it stops from what it does now.
        let roll = &start.state[5];
        low[5] = roll.q + stopping_angle(&limits[5], arm.law.limits_jerk(), roll.v);
        high[5] = low[5];
        let speed = ball.v_m_s.norm();
        let sigma_m = ball.lateral_sigma_m();
        let seen = forecast.watch.sigma_by_m(ball.t_s - settings.freeze_s - settings.actuation_s, ball.t_s);
        Slot {
            u: ball.v_m_s / speed,
            speed,
            left_s,
            sigma_m,
            sigma_end_m: sigma_m.min(seen).hypot(settings.tracking_sigma_m),
            limits,
            low,
            high,
            ball,
        }
    };
    balls.into_iter().map(slot).collect()
}

/// Unit vectors about (0, 0, 1): one in the middle, three rings.
fn directions(cone_rad: f64) -> Vec<[f64; 3]> {
    let mut all = vec![[0.0, 0.0, 1.0]];
    for (share, number) in [(0.33, 6), (0.67, 10), (1.0, 14)] {
        let (s, c) = (cone_rad * share).sin_cos();
        all.extend((0..number).map(|k| {
            let (y, x) = (std::f64::consts::TAU * (f64::from(k) + share) / f64::from(number)).sin_cos();
            [s * x, s * y, c]
        }));
    }
    all
}

/// The mode in which the hand catches, and what it is worth; `None` if the settings do not allow it.
fn allowed_mode(settings: &Settings, slot: &Slot<'_>, mode: Mode) -> Option<(Mode, f64)> {
    // A ball slower than the relative speed allowed needs no hand that moves.
    if slot.speed <= settings.relative_m_s {
        return Some((Mode::Hold, 1.0));
    }
    let allowed = match settings.allowed {
        Allowed::Either => true,
        Allowed::Matched => mode == Mode::Matched,
        Allowed::Hold => mode == Mode::Hold,
    };
    allowed.then_some((mode, if mode == Mode::Matched { 1.0 } else { HOLD_WORTH }))
}

/// Largest share of an acceleration limit that no motion to this state can go below; `None` if it is above 1, or the arm could not
/// stop inside its ranges.
fn least_share(
    arm: &CatchArm,
    start: &Start<'_>,
    slot: &Slot<'_>,
    q: &Joints,
    qd: &Joints,
    count: &mut Count,
) -> Option<f64> {
    let mut peak = 0.0_f64;
    for i in 0..6 {
        let limit = &slot.limits[i];
        let stop = q[i] + stopping_angle(limit, arm.law.limits_jerk(), qd[i]);
        if stop < limit.q_rad.0 || stop > limit.q_rad.1 {
            count.no_stop += 1;
            return None;
        }
        peak = peak.max(least_peak(&start.state[i], q[i], qd[i], slot.left_s) / limit.a_rad_s2);
    }
    if peak > 1.0 {
        count.late += 1;
        return None;
    }
    Some(peak)
}

/// The motion of each joint and the largest share of a limit that they use; `None` if a joint has none.
fn fit_all(
    arm: &CatchArm,
    start: &Start<'_>,
    slot: &Slot<'_>,
    q: &Joints,
    qd: &Joints,
) -> Option<([Fit; 6], f64)> {
    let fit = |i: usize| arm.law.fit(&slot.limits[i], &start.state[i], q[i], qd[i], slot.left_s);
    let fits = [fit(0)?, fit(1)?, fit(2)?, fit(3)?, fit(4)?, fit(5)?];
    Some((fits, fits.iter().map(|fit| fit.used).fold(0.0, f64::max)))
}

#[expect(clippy::too_many_arguments, reason = "one candidate of one search")]
fn judge(
    arm: &CatchArm,
    settings: &Settings,
    start: &Start<'_>,
    slot: &Slot<'_>,
    (axis, branch, mode): (&Vector3<f64>, Branch, Mode),
    q: Joints,
    best: &mut Vec<Candidate>,
    count: &mut Count,
) {
    let Some((mode, worth)) = allowed_mode(settings, slot, mode) else { return };
    let bound = if best.len() < SHORTLIST { 0.0 } else { best[best.len() - 1].score };
    let mut qd = Joints::zeros();
    let mut relative_m_s = slot.speed;
    if mode == Mode::Matched {
        relative_m_s = settings.relative_m_s;
        let hand = slot.u * (slot.speed - relative_m_s);
        match joint_rates(arm, slot.limits, &q, &hand) {
            Some(rates) => qd = rates,
            None => {
                count.fast += 1;
                return;
            }
        }
    }
    let Some(least) = least_share(arm, start, slot, &q, &qd, count) else { return };
    let kept = start.under_way.map_or(0.0, |(t_s, under_way, was)| {
        let same = was == mode && (t_s - slot.ball.t_s).abs() < 0.006 && (under_way - axis).norm() < 1e-6;
        if same { settings.hysteresis } else { 0.0 }
    });
    let score = |used: f64| {
        let probability = probability(arm, slot, used);
        (probability, worth * probability + kept + 0.01 * (1.0 - used))
    };
    if score(least).1 <= bound {
        return;
    }
    let Some((fits, used)) = fit_all(arm, start, slot, &q, &qd) else {
        count.late += 1;
        return;
    };
    count.motion += 1;
    let (probability, score) = score(used);
    if score <= bound {
        return;
    }
    let place = best.partition_point(|other| other.score >= score);
    best.truncate(SHORTLIST - 1);
    let place = place.min(best.len());
    let (ball, axis) = (slot.ball, *axis);
    let found = Candidate { ball, axis, branch, mode, q, qd, fits, used, probability, relative_m_s, score };
    best.insert(place, found);
}

/// The corrections still needed are within what is left of the accelerations, and the ball passes the rim in the end.
fn probability(arm: &CatchArm, slot: &Slot<'_>, used: f64) -> f64 {
    let spare = (1.0 - used) * slot.limits[1].a_rad_s2;
    let authority_m = 0.25 * spare * slot.left_s * slot.left_s * LEVER_M;
    let correctable = passes_rim(authority_m + 0.5 * arm.cup.miss_max_m, 0.0, slot.sigma_m);
    correctable * passes_rim(arm.cup.miss_max_m, 0.0, slot.sigma_end_m)
}

/// Joint rates that move the middle of the mouth with `hand` (m/s, world) and use the speed limits least: min sum (qd_j / v_j)². `None`
/// if a joint is too slow, or near a singularity.
#[must_use]
pub fn joint_rates(arm: &CatchArm, limits: &[Limits; 6], q: &Joints, hand: &Vector3<f64>) -> Option<Joints> {
    let frames = arm.model.fk(q);
    let x_be = arm.model.ee(&frames);
    let p = x_be.pos + x_be.rot.column(2) * arm.cup.mouth_m;
    let hand_b = arm.x_wb.rot.tr_mul(hand);
    let columns: [Vector3<f64>; 6] = std::array::from_fn(|i| frames.axis(i).cross(&(p - frames.origin(i))));
    let mut m = Matrix3::zeros();
    for (column, limit) in columns.iter().zip(limits) {
        m += column * column.transpose() * (limit.v_rad_s * limit.v_rad_s);
    }
    let lambda = m.cholesky()?.solve(&hand_b);
    let rates = Joints::from_fn(|i, _| columns[i].dot(&lambda) * limits[i].v_rad_s * limits[i].v_rad_s);
    rates.iter().zip(limits).all(|(rate, limit)| rate.abs() <= limit.v_rad_s).then_some(rates)
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
