//! The times of a search: the ball then, what each joint can reach by then, and how surely the ball is met.

use nalgebra::Vector3;

use super::Joints;
use super::arm::CatchArm;
use super::forecast::{Forecast, Foreseen};
use super::task::{Settings, Start, passes_rim};
use crate::motion_law::{Limits, stopping_angle};

const TIMES_MAX: usize = 24;
/// Moments of corrections, as shares of the time from the first samples that give a velocity to the last correction.
const CORRECTIONS: [f64; 5] = [0.0, 0.15, 0.4, 0.7, 1.0];
/// A correction moves the hand on a lever of this length about one axis, m: used for what corrections can reach.
const LEVER_M: f64 = 0.8;

/// What further samples will ask of the hand at one moment.
#[derive(Clone, Copy)]
pub(super) struct Correction {
    /// How far a correction that begins then moves the hand with an acceleration of 1 rad/s², m.
    pub(super) authority_m: f64,
    /// Standard deviation of what the samples since the moment before add, m.
    pub(super) sigma_m: f64,
}

/// What is the same for all candidates of one time.
#[derive(Clone)]
pub(super) struct Slot<'a> {
    pub(super) ball: Foreseen,
    pub(super) u: Vector3<f64>,
    pub(super) speed: f64,
    pub(super) left_s: f64,
    pub(super) sigma_end_m: f64,
    pub(super) corrections: [Correction; CORRECTIONS.len()],
    pub(super) limits: &'a [Limits; 6],
    pub(super) low: Joints,
    pub(super) high: Joints,
}

/// Each how many times of so many is looked at.
pub(super) fn stride(times: usize) -> usize {
    times.div_ceil(TIMES_MAX).max(1)
}

pub(super) fn slots<'a>(
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
    let stride = stride(all.len());
    let mut balls: Vec<Foreseen> = all.into_iter().step_by(stride).copied().collect();
    if let Some((t_s, ..)) = start.under_way {
        // The time under way and its neighbours, so that corrections stay small.
        balls.extend([-0.004, 0.0, 0.004].iter().filter_map(|d| forecast.at(t_s + d)).filter(|b| near(b)));
    }
    balls.into_iter().map(|ball| slot(arm, settings, start, forecast, limits, ball)).collect()
}

pub(super) fn slot<'a>(
    arm: &CatchArm,
    settings: &Settings,
    start: &Start<'_>,
    forecast: &Forecast,
    limits: &'a [Limits; 6],
    ball: Foreseen,
) -> Slot<'a> {
    let left_s = ball.t_s - start.at_s;
    let (mut low, mut high) = (Joints::zeros(6), Joints::zeros(6));
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
    let (corrections, sigma_m) = corrections(settings, start, forecast, &ball);
    let sigma_end_m = sigma_m.hypot(settings.tracking_sigma_m);
    Slot { u: ball.v_m_s / speed, speed, left_s, sigma_end_m, corrections, limits, low, high, ball }
}

/// Corrections until the catch at `ball`; and the standard deviation that is left after the last one, m.
fn corrections(
    settings: &Settings,
    start: &Start<'_>,
    forecast: &Forecast,
    ball: &Foreseen,
) -> ([Correction; CORRECTIONS.len()], f64) {
    let watch = &forecast.watch;
    // Three samples give a velocity.
    let first_s = (watch.first_s + watch.latency_s + 2.0 * watch.period_s).max(start.at_s);
    let last_s = (ball.t_s - settings.freeze_s - settings.actuation_s).max(first_s);
    let mut sigma_m = ball.lateral_sigma_m();
    let all = CORRECTIONS.map(|share| {
        let at_s = first_s + share * (last_s - first_s);
        let left_s = (ball.t_s - at_s).max(0.0);
        let then_m = sigma_m.min(watch.sigma_by_m(at_s, ball.t_s));
        let reported_m = (sigma_m * sigma_m - then_m * then_m).max(0.0).sqrt();
        sigma_m = then_m;
        Correction { authority_m: 0.25 * left_s * left_s * LEVER_M, sigma_m: reported_m }
    });
    (all, sigma_m)
}

/// Each correction still to come is within what is left of the accelerations then, and the ball passes the rim in the end.
pub(super) fn enters(arm: &CatchArm, slot: &Slot<'_>, used: f64) -> f64 {
    let spare_rad_s2 = arm.limits(true)[1].a_rad_s2 - used * slot.limits[1].a_rad_s2;
    let within = |c: &Correction| {
        passes_rim(c.authority_m * spare_rad_s2 + 0.5 * arm.cup.miss_max_m(), 0.0, c.sigma_m)
    };
    let correctable: f64 = slot.corrections.iter().map(within).product();
    correctable * passes_rim(arm.cup.miss_max_m(), 0.0, slot.sigma_end_m)
}
