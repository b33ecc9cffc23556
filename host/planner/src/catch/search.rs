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
//!   -> cup looks up where the hand stops                                      closed form
//! best 24, in order: whole motion against limits, contacts, currents, ball     at most 6
//! chance that the ball stays in the cup of that hand: it bounces 12 times       one whose ball is sure to stay ends the search
//! the same of the chosen one, with 12 flights between these                    this chance is the predicted one
//! of a first decision: share of the flights that it can still catch             12 flights about the mean
//! ```

use nalgebra::Vector3;
use robot_model::Branch;
use robot_model::collision::CollisionChecker;

use super::Joints;
use super::arm::CatchArm;
use super::bounce::{CupPath, Flights, chance_to_stay};
use super::candidates::{Candidate, SURE_TO_STAY, Search, directions};
use super::edge::share_in_reach;
use super::forecast::{Forecast, Foreseen, across};
use super::motion::{CatchMotion, Fault, check, stopped};
use super::slot::{slots, stride};
use super::task::{Count, Decline, Mode, Settings, Start};
use crate::motion_law::{Limits, Pieces};

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
    /// Predicted probability of the catch: that the ball enters the cup and stays.
    pub probability: f64,
    /// Chance that a ball that enters the cup stays in it.
    pub stays: f64,
    /// Ball against hand at the catch, m/s.
    pub relative_m_s: f64,
    /// The motion, with its stop.
    pub motion: CatchMotion,
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
    let mut search = Search::new(arm, settings, start);
    let rings = directions(settings.cone_rad);
    if slots.is_empty() {
        return (Err(why_none(arm, &rings, forecast, &search.count)), search.count);
    }
    slots.iter().for_each(|slot| search.look(slot, &rings));
    if start.under_way.is_none() {
        search.look_nearby(forecast, limits);
    }
    let Search { best, mut count, .. } = search;
    if best.is_empty() {
        return (Err(why_none(arm, &rings, forecast, &count)), count);
    }
    let most = |chance: &dyn Fn(&Candidate) -> f64| best.iter().map(chance).fold(0.0, f64::max);
    if most(&|c| c.enters * c.stays) < settings.probability_min {
        let enters = most(&|c| c.enters) >= settings.probability_min;
        return (Err(if enters { Decline::BouncesOut } else { Decline::TooUncertain }), count);
    }
    let mut checker = CollisionChecker::new(&arm.model, &arm.scene);
    let mut faults: Vec<Fault> = Vec::with_capacity(CHECKS_MAX);
    let mut chosen: Option<(f64, &Candidate, CatchMotion)> = None;
    let mut tried: Vec<(Branch, Mode, i64)> = Vec::with_capacity(best.len());
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
            Ok(()) => {
                let stays = stays(arm, &motion, candidate, Flights::Choosing);
                if chosen
                    .as_ref()
                    .is_none_or(|(most, other, _)| candidate.enters * stays > other.enters * most)
                {
                    chosen = Some((stays, candidate, motion));
                }
                if stays >= SURE_TO_STAY {
                    break;
                }
            }
            Err(why) => faults.push(why),
        }
    }
    if let Some((_, candidate, motion)) = chosen {
        let stays = stays(arm, &motion, candidate, Flights::Judging);
        let mut enters = candidate.enters;
        if start.under_way.is_none() {
            enters *= share_in_reach(arm, settings, start, forecast, candidate, &rings);
        }
        let why = match (enters >= settings.probability_min, enters * stays >= settings.probability_min) {
            (_, true) => return (Ok(choice_of(candidate, motion, enters, stays)), count),
            (true, false) => Decline::BouncesOut,
            (false, false) => Decline::TooUncertain,
        };
        return (Err(why), count);
    }
    // What is wrong with most of them.
    let often = |why: &Fault| faults.iter().filter(|fault| *fault == why).count();
    let why = match faults.iter().rev().max_by_key(|why| often(why)) {
        Some(Fault::Range) => Decline::NoStop,
        Some(Fault::Limit) => Decline::TooLate,
        Some(Fault::CupDown) => Decline::CupDown,
        Some(Fault::Ball) => Decline::BallFirst,
        Some(Fault::Current) => Decline::Current,
        Some(Fault::Contact) | None => Decline::Contact,
    };
    (Err(why), count)
}

fn why_none(arm: &CatchArm, rings: &[[f64; 3]], forecast: &Forecast, count: &Count) -> Decline {
    if count.cup_down > 0 {
        return Decline::CupDown;
    }
    if count.no_stop > 0 {
        return Decline::NoStop;
    }
    if count.late > 0 {
        return Decline::TooLate;
    }
    if count.fast > 0 {
        return Decline::TooFast;
    }
    // No posture that the joints reach in time: is there one in the ranges, for an arm that knew earlier?
    let shoulder = arm.shoulder_m();
    let near: Vec<&Foreseen> =
        forecast.points.iter().filter(|ball| (ball.p_m - shoulder).norm() < arm.reach_m()).collect();
    if near.is_empty() {
        return Decline::OutOfReach;
    }
    let range = (arm.model.q_min(), arm.model.q_max());
    let in_ranges = |ball: &Foreseen| {
        let p_b = arm.x_wb.inverse_transform_point(&ball.p_m);
        let u = ball.v_m_s.normalize();
        let (a, b) = across(&u);
        rings.iter().any(|[x, y, z]| {
            let axis_b = arm.x_wb.rot.tr_mul(&(a * *x + b * *y - u * *z));
            let mut any = false;
            arm.model.ik_axis(&arm.tool, &p_b, &axis_b, (&range.0, &range.1), |_, _| any = true);
            any
        })
    };
    if near.iter().step_by(stride(near.len())).any(|ball| in_ranges(ball)) {
        Decline::TooLate
    } else {
        Decline::NoPosture
    }
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

/// Chance that a ball that enters the cup stays in it, with the motion of the hand.
fn stays(arm: &CatchArm, motion: &CatchMotion, candidate: &Candidate, flights: Flights) -> f64 {
    let path = CupPath::of(arm, motion, candidate.ball.t_s);
    chance_to_stay(&arm.cup, &path, (Vector3::zeros(), &candidate.ball.v_m_s), candidate.sigma_m, flights)
}

fn choice_of(candidate: &Candidate, motion: CatchMotion, enters: f64, stays: f64) -> Choice {
    Choice {
        t_s: candidate.ball.t_s,
        p_m: candidate.ball.p_m,
        axis: candidate.axis,
        mode: candidate.mode,
        branch: candidate.branch,
        q: candidate.q,
        qd: candidate.qd,
        used: candidate.used,
        probability: enters * stays,
        stays,
        relative_m_s: candidate.relative_m_s,
        motion,
    }
}
