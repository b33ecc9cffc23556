//! Where and when to catch under joint limits.
//!
//! Candidates: time on the path × way of the hand (outwards, or back over the base) × offset across × depth × reach
//! over front or back × elbow × how much of the disc's velocity the hand takes over. Each is checked in the order
//! of cost: pose in reach and range, relative motion slow enough for the gripper, motion within the limits, way of
//! the disc into the gripper free. The first one that passes all checks is the plan. Otherwise places between those
//! of the grid are searched (`local.rs`), and if there is no catch, the plan is declined with the check that
//! stopped the best candidate.
//!
//! The check of the way in (`way.rs`) uses a coarse disc and a margin. [`super::witness`] judges by other code.

pub mod local;
mod way;

use nalgebra::{Matrix3, Matrix4, Vector3};
use robot_model::Family;

use super::Joints;
use super::arm::DiscArm;
use super::flight::{DiscState, Path};
use super::motion::{self, Approach, DiscMotion, Impossible, Reach};
use super::witness::{Gripper, HALF_HEIGHT_M, Rule};
use crate::motion_law::{Limits, MotionLaw, State};
use way::{stays_clear, way_is_free};

/// What the planner may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// The jerk is limited, too.
    pub jerk: bool,
    /// Share of the limits that is used.
    pub share: f64,
    /// The arm may move from then on, s.
    pub now_s: f64,
    /// Distance that the disc keeps from fingers on its way in, m.
    pub margin_m: f64,
    pub gripper: Gripper,
    /// When the disc counts as caught.
    pub rule: Rule,
    /// Factor on speed, acceleration and jerk limits: 1 is the robot file's.
    pub limit_scale: f64,
    /// The search between the places of the grid, if the grid has no catch.
    pub between: local::Effort,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            jerk: false,
            share: 0.95,
            now_s: 0.0,
            margin_m: 0.002,
            gripper: Gripper::default(),
            rule: Rule::default(),
            limit_scale: 1.0,
            between: local::Effort::PLAN,
        }
    }
}

/// How the hand holds the disc at the catch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Middle of the dwell, s.
    pub t_s: f64,
    /// Tip inside the rim, m.
    pub depth_m: f64,
    /// Disc's centre beside the hand's plane, m.
    pub lateral_m: f64,
    /// The hand points away from the base; otherwise back over it.
    pub outwards: bool,
    /// The turntable faces away from the hand: the arm reaches over its back.
    pub over_back: bool,
    /// Elbow, as [`robot_model::Branch::elbow_negative`].
    pub elbow_negative: bool,
    /// Constant joint speeds before the dwell, s: while the disc comes between the fingers.
    pub lead_s: f64,
    pub approach: Approach,
}

/// A catch within the limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    pub choice: Choice,
    /// Joint state at the catch.
    pub reach: Reach,
    pub motion: DiscMotion,
    /// Velocity of the disc relative to the hand at the catch: along the hand, up, across, m/s.
    pub relative_m_s: Vector3<f64>,
    /// Largest share of the speed and acceleration limits of the robot file.
    pub used: (f64, f64),
    /// Candidates that were looked at.
    pub looked_at: usize,
}

/// Why no catch is planned: the check that stopped the candidate that came farthest.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Decline {
    /// Nothing in reach.
    #[error("the gripper reaches no point of the disc's path with a hand that fits the disc")]
    OutOfReach,
    /// Reach, not in the joint ranges.
    #[error("the gripper reaches the disc's path only beyond the joint ranges")]
    Range,
    /// Too fast to follow, or it does not fit between the fingers on its way in.
    #[error(
        "at the best place looked at the hand would need {0:.2} times its joint speeds to keep the disc between the \
         fingers while it comes in and they close"
    )]
    TooFast(f64),
    /// It cannot be followed at any speed.
    #[error("no motion is found that keeps the disc between the fingers while it comes in and they close")]
    NoWayIn,
    #[error("the arm comes {:.0} ms too late for the best place looked at", .0 * 1e3)]
    TooLate(f64),
    /// Limits on the way.
    #[error(
        "the way to the best place looked at takes {0:.2} times the acceleration allowed, or leaves the joint ranges"
    )]
    Limits(f64),
    /// The way in.
    #[error(
        "at every place looked at the disc would touch the arm or a finger before it is between the fingers"
    )]
    Touches,
}

/// Tally of the checks.
#[derive(Debug, Clone, Copy)]
struct Tally {
    reached: bool,
    in_range: bool,
    slow_enough: bool,
    least_share: f64,
    least_late_s: f64,
    least_over: f64,
    timed: bool,
}

impl Tally {
    fn reason(&self) -> Decline {
        match self {
            Self { timed: true, .. } => Decline::Touches,
            Self { slow_enough: true, least_late_s, .. } if least_late_s.is_finite() => {
                Decline::TooLate(*least_late_s)
            }
            Self { slow_enough: true, least_over, .. } => Decline::Limits(*least_over),
            Self { in_range: true, least_share, .. } if least_share.is_finite() => {
                Decline::TooFast(*least_share)
            }
            Self { in_range: true, .. } => Decline::NoWayIn,
            Self { reached: true, .. } => Decline::Range,
            _ => Decline::OutOfReach,
        }
    }
}

/// One candidate before its motion is planned.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    choice: Choice,
    q: Joints,
    v: Joints,
    relative: Vector3<f64>,
    cost: f64,
}

/// Velocities of the disc into the hand, m/s; the hand at rest along itself is tried as well.
const INTO_M_S: [f64; 5] = [0.0, -0.5, -1.0, -1.6, -2.3];
/// Velocities of the disc across the hand, m/s, in its direction of flight; the turntable at rest is tried as well.
const ACROSS_M_S: [f64; 5] = [0.0, 0.8, 1.6, 2.4, 3.2];
/// Velocities across the gap, m/s; the bends at rest are tried as well.
const UP_M_S: [f64; 3] = [0.0, 0.3, -0.3];
/// Rates of elevation with the fall, rad/s.
const ELEVATION_RATES: [f64; 4] = [0.0, 1.5, 3.0, 5.0];
/// Times the speed limit that candidates are looked at for the reason of a refusal.
const SHARE_MAX: f64 = 4.0;
/// Longest time for the disc to come between the fingers, s.
const ENTRY_MAX_S: f64 = 0.08;
const DEPTHS_M: [f64; 4] = [0.10, 0.08, 0.065, 0.05];
const LATERALS_M: [f64; 3] = [0.0, 0.03, -0.03];
const RUN_UPS_S: [f64; 4] = [0.06, 0.10, 0.15, 0.25];
/// Grid of catch times, s.
const TIME_STEP_S: f64 = 0.005;
/// Candidates whose way in is looked at.
const WAYS_MAX: usize = 1500;

/// Searches for a catch of the disc on `path`, from an arm in the state `now`.
///
/// # Errors
/// [`Decline`] with the reason.
pub fn plan(arm: &DiscArm, path: &Path, now: &[State; 4], settings: &Settings) -> Result<Plan, Decline> {
    let limits = limits(arm, settings);
    let mut tally = Tally {
        reached: false,
        in_range: false,
        slow_enough: false,
        least_share: f64::INFINITY,
        least_late_s: f64::INFINITY,
        least_over: f64::INFINITY,
        timed: false,
    };
    let times: Vec<f64> = (1..=((path.end_s() - settings.now_s) / TIME_STEP_S).max(0.0) as u32)
        .map(|k| settings.now_s + TIME_STEP_S * f64::from(k))
        .collect();
    let mut found = Vec::new();
    for t_s in &times {
        candidates(arm, path, *t_s, now, settings, &limits, 1.0, &mut tally, &mut found);
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let looked_at = found.len();
    let law = MotionLaw::new(settings.jerk);
    let mut ways = 0;
    for candidate in &found {
        if ways >= WAYS_MAX {
            break;
        }
        let staged = RUN_UPS_S.map(|run_up_s| Approach::Staged { run_up_s });
        let reach = reach_of(candidate, settings);
        for approach in staged.into_iter().chain([Approach::Direct]) {
            let motion = match motion::plan(&law, &limits, settings.now_s, now, &reach, approach) {
                Ok(motion) => motion,
                Err(why) => {
                    match why {
                        Impossible::Late(by) => tally.least_late_s = tally.least_late_s.min(by),
                        Impossible::Limit(over) if approach == Approach::Direct => {
                            tally.least_over = tally.least_over.min(over);
                        }
                        _ => {}
                    }
                    continue;
                }
            };
            tally.timed = true;
            ways += 1;
            if way_is_free(arm, path, &motion, candidate.choice.t_s, settings) && stays_clear(arm, &motion) {
                let used = used(arm, &motion);
                let choice = Choice { approach, ..candidate.choice };
                return Ok(Plan { choice, reach, motion, relative_m_s: candidate.relative, used, looked_at });
            }
        }
    }
    if let Ok(plan) = local::search(arm, path, now, settings) {
        return Ok(Plan { looked_at, ..plan });
    }
    if tally.in_range && !tally.slow_enough {
        // How fast the joints would have to be.
        for t_s in &times {
            candidates(arm, path, *t_s, now, settings, &limits, SHARE_MAX, &mut tally, &mut found);
        }
        tally.slow_enough = false;
    }
    Err(tally.reason())
}

/// The same catch for a path that is known better: place and time follow the disc, everything else of the choice stays.
///
/// # Errors
/// [`Decline`] if the catch is no longer possible so; then the present motion is the better one.
pub fn refine(
    arm: &DiscArm,
    path: &Path,
    now: &[State; 4],
    plan: &Plan,
    settings: &Settings,
) -> Result<Plan, Decline> {
    // At the same time if that is possible, else a little earlier or later.
    let shifts = [0.0, 0.005, -0.005, 0.01, -0.01, 0.02, -0.02];
    let times = shifts.map(|shift| plan.choice.t_s + shift);
    let law = MotionLaw::new(settings.jerk);
    times.iter().find_map(|t_s| refine_at(arm, path, now, plan, settings, &law, *t_s)).ok_or(Decline::Touches)
}

fn refine_at(
    arm: &DiscArm,
    path: &Path,
    now: &[State; 4],
    plan: &Plan,
    settings: &Settings,
    law: &MotionLaw,
    t_s: f64,
) -> Option<Plan> {
    let limits = limits(arm, settings);
    let state = path.at(t_s);
    let v = plan.reach.v;
    let mut best: Option<Plan> = None;
    for (choice, q) in poses(arm, &state, t_s, &plan.reach.q) {
        let c = &plan.choice;
        let same = choice.outwards == c.outwards
            && choice.over_back == c.over_back
            && choice.elbow_negative == c.elbow_negative
            && choice.depth_m == c.depth_m
            && (choice.lateral_m - c.lateral_m).abs() < 0.06;
        if !same || !arm.model.in_range(&q.into(), 0.0) {
            continue;
        }
        let choice = Choice { lead_s: c.lead_s, approach: Approach::Direct, ..choice };
        let Some(follow) = Follow::new(&hand_rates(arm, &state.p_m, &q)) else { continue };
        let half_dwell = 0.5 * settings.rule.dwell_s;
        let (low, high) = gap_used(arm, path, t_s, &q, &v, c.lead_s + half_dwell, half_dwell);
        let q = q + follow.speeds(0.0, 0.5 * (low + high), 0.0, 0.0);
        let candidate = Candidate { choice, q, v, relative: relative(arm, &state, &q, &v), cost: 0.0 };
        let reach = reach_of(&candidate, settings);
        let planned = motion::plan(law, &limits, settings.now_s, now, &reach, Approach::Direct);
        let Ok(motion) = planned else { continue };
        let nearer =
            best.as_ref().is_none_or(|b| (q - plan.reach.q).amax() < (b.reach.q - plan.reach.q).amax());
        if nearer && way_is_free(arm, path, &motion, t_s, settings) && stays_clear(arm, &motion) {
            let used = used(arm, &motion);
            best = Some(Plan { choice, reach, motion, relative_m_s: candidate.relative, used, looked_at: 1 });
        }
    }
    best
}

fn limits(arm: &DiscArm, settings: &Settings) -> [Limits; 4] {
    let s = settings.share * settings.limit_scale;
    std::array::from_fn(|k| {
        let l = arm.model.joints()[k].limits;
        Limits {
            q_rad: (l.q_min_rad, l.q_max_rad),
            v_rad_s: l.v_max_rad_s * s,
            a_rad_s2: l.a_max_rad_s2 * s,
            j_rad_s3: l.j_max_rad_s3 * s,
        }
    })
}

fn reach_of(candidate: &Candidate, settings: &Settings) -> Reach {
    // The dwell of the rule with 10 ms to spare, half before and half after.
    let half_dwell_s = 0.5 * (settings.rule.dwell_s + 0.01);
    let lead_s = candidate.choice.lead_s;
    Reach { t_s: candidate.choice.t_s, q: candidate.q, v: candidate.v, half_dwell_s, lead_s }
}

/// All hand poses that hold the disc of `state`, with the joint angles that reach them, in range or not.
fn poses(arm: &DiscArm, state: &DiscState, t_s: f64, q_ref: &Joints) -> Vec<(Choice, Joints)> {
    let mut out = Vec::new();
    let Family::TurntablePlanar(plane) = arm.model.family() else { return out };
    let center = state.p_m;
    let (rho, azimuth) = (center.xy().norm(), center.y.atan2(center.x));
    let mut yaws: Vec<(f64, f64)> =
        LATERALS_M.iter().filter(|l| l.abs() < rho).map(|l| (azimuth - (l / rho).asin(), *l)).collect();
    if rho <= 0.04 {
        // Over the axis every direction will do.
        yaws.extend((0..16).map(|k| {
            let yaw = f64::from(k) * std::f64::consts::TAU / 16.0;
            (yaw, center.y * yaw.cos() - center.x * yaw.sin())
        }));
    }
    for (yaw, lateral_m) in yaws {
        let toward = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
        let across = Vector3::new(-yaw.sin(), yaw.cos(), 0.0);
        for sign in [1.0, -1.0] {
            let hand = toward * sign;
            // Along the hand the disc's plane rises by this.
            let elevation = (-state.normal.dot(&hand)).atan2(state.normal.z);
            if elevation.abs() > 0.8 {
                continue;
            }
            let along = hand * elevation.cos() + Vector3::z() * elevation.sin();
            for depth_m in DEPTHS_M {
                let half_chord = (arm.size.disc_radius_m.powi(2) - lateral_m * lateral_m).max(0.0).sqrt();
                let terminal =
                    center - across * lateral_m - along * (arm.size.gripper_m - depth_m + half_chord);
                let outwards = hand.dot(&terminal) > 0.0;
                let aimed = if outwards { elevation } else { std::f64::consts::PI - elevation };
                for (over_back, pose) in plane.aim(&terminal, aimed).into_iter().enumerate() {
                    let Some(solutions) =
                        pose.and_then(|pose| arm.model.ik_near(&pose, &(*q_ref).into()).ok())
                    else {
                        continue;
                    };
                    out.extend(solutions.iter().map(|s| {
                        let choice = Choice {
                            t_s,
                            depth_m,
                            lateral_m,
                            outwards,
                            over_back: over_back == 1,
                            elbow_negative: s.branch.elbow_negative(),
                            lead_s: 0.0,
                            approach: Approach::Direct,
                        };
                        (choice, s.q.array().into())
                    }));
                }
            }
        }
    }
    out
}

/// Maps joint speeds to the velocity of the point of the hand at the disc's centre along the hand's axes (along, up,
/// across) and to the rate of its elevation.
fn hand_rates(arm: &DiscArm, center: &Vector3<f64>, q: &Joints) -> Matrix4<f64> {
    let axes = arm.hand_axes(q);
    let jacobian = arm.jacobian(q);
    let lever = center - arm.terminal_point(q);
    let mut out = Matrix4::zeros();
    for j in 0..4 {
        let v = jacobian.fixed_view::<3, 1>(0, j).into_owned();
        let omega: Vector3<f64> = jacobian.fixed_view::<3, 1>(3, j).into_owned();
        let at_disc = axes.tr_mul(&(v + omega.cross(&lever)));
        out.fixed_view_mut::<3, 1>(0, j).copy_from(&at_disc);
        out[(3, j)] = if j == 0 { 0.0 } else { 1.0 };
    }
    out
}

/// Joint speeds for a velocity of the hand at the disc (along, up, across) and a rate of its elevation, as linear maps.
///
/// The bends do not move the hand across; near the axis the turntable hardly does, and stays at rest there.
struct Follow {
    bends: Matrix3<f64>,
    turn: Vector3<f64>,
    per_across: f64,
}

impl Follow {
    fn new(rates: &Matrix4<f64>) -> Option<Self> {
        let bends = Matrix3::from_fn(|r, c| rates[(if r < 2 { r } else { 3 }, c + 1)]).try_inverse()?;
        let across = rates[(2, 0)];
        let per_across = if across.abs() > 0.06 { 1.0 / across } else { 0.0 };
        Some(Self { bends, turn: Vector3::new(rates[(0, 0)], rates[(1, 0)], 0.0), per_across })
    }

    fn speeds(&self, along: f64, up: f64, across: f64, elevation_rate: f64) -> Joints {
        self.with_turntable(across * self.per_across, along, up, elevation_rate)
    }

    fn with_turntable(&self, turn: f64, along: f64, up: f64, elevation_rate: f64) -> Joints {
        let bends = self.bends * (Vector3::new(along, up, elevation_rate) - self.turn * turn);
        Joints::from([turn, bends[0], bends[1], bends[2]])
    }
}

/// Velocity of the disc relative to the hand: along it, up, across.
fn relative(arm: &DiscArm, state: &DiscState, q: &Joints, v: &Joints) -> Vector3<f64> {
    let hand = hand_rates(arm, &state.p_m, q) * v;
    arm.hand_axes(q).tr_mul(&state.v_m_s) - hand.xyz()
}

#[allow(clippy::too_many_arguments)]
fn candidates(
    arm: &DiscArm,
    path: &Path,
    t_s: f64,
    now: &[State; 4],
    settings: &Settings,
    limits: &[Limits; 4],
    share_max: f64,
    tally: &mut Tally,
    out: &mut Vec<Candidate>,
) {
    let state = path.at(t_s);
    let q_now = Joints::from_fn(|j, _| now[j].q);
    let farthest = arm.size.reach_m() + arm.size.hand_m + arm.size.touch_m();
    if (state.p_m - Vector3::z() * arm.size.base_m).norm() > farthest {
        return;
    }
    let gap = settings.gripper.half_gap_m - HALF_HEIGHT_M - settings.margin_m;
    let half_dwell = 0.5 * (settings.rule.dwell_s + 0.004);
    for (choice, q) in poses(arm, &state, t_s, &q_now) {
        tally.reached = true;
        if !arm.model.in_range(&q.into(), -0.01) {
            continue;
        }
        tally.in_range = true;
        let rates = hand_rates(arm, &state.p_m, &q);
        let Some(follow) = Follow::new(&rates) else { continue };
        let wanted = arm.hand_axes(&q).tr_mul(&state.v_m_s);
        let sense = 1.0_f64.copysign(wanted.z);
        let vertical = UP_M_S.into_iter().chain([wanted.y]);
        for (up, turning) in vertical.flat_map(|up| ELEVATION_RATES.map(|rate| (up, rate))) {
            // A hand that turns with the fall needs less of its joints; the disc stays level meanwhile.
            let turning = turning * wanted.y.signum();
            for along in INTO_M_S.into_iter().chain([wanted.x]) {
                for across in ACROSS_M_S.into_iter().map(|u| u * sense).chain([wanted.z]) {
                    let v = follow.speeds(wanted.x - along, wanted.y - up, wanted.z - across, turning);
                    let share = (0..4).map(|j| v[j].abs() / limits[j].v_rad_s).fold(0.0, f64::max);
                    if share > share_max {
                        continue;
                    }
                    let rest = wanted - (rates * v).xyz();
                    // Along and across the disc may slide while the fingers close, but not out of them.
                    if rest.x.abs() * half_dwell > 0.03
                        || rest.z.abs() * half_dwell + choice.lateral_m.abs() > settings.rule.lateral_max_m
                    {
                        continue;
                    }
                    let entry = entry_s(arm, &choice, &rest, settings);
                    if entry > ENTRY_MAX_S {
                        continue;
                    }
                    let (low, high) = gap_used(arm, path, t_s, &q, &v, entry + half_dwell, half_dwell);
                    if high - low > 2.0 * gap {
                        continue;
                    }
                    tally.least_share = tally.least_share.min(share);
                    if share > 1.0 {
                        continue;
                    }
                    // In the middle of the gap, not at one end of it.
                    let q = q + follow.speeds(0.0, 0.5 * (low + high), 0.0, 0.0);
                    tally.slow_enough = true;
                    let travel = (0..4)
                        .map(|j| (q[j] - q_now[j]).abs() / limits[j].v_rad_s / (t_s - settings.now_s))
                        .fold(0.0, f64::max);
                    if travel > 1.0 {
                        let late = (0..4)
                            .map(|j| (q[j] - q_now[j]).abs() / limits[j].v_rad_s - (t_s - settings.now_s))
                            .fold(0.0, f64::max);
                        tally.least_late_s = tally.least_late_s.min(late);
                        continue;
                    }
                    let cost = share
                        + travel
                        + 0.2 * rest.norm()
                        + 0.5 * (high - low) / gap
                        + 5.0 * (0.08 - choice.depth_m).abs()
                        + 5.0 * choice.lateral_m.abs();
                    let choice = Choice { lead_s: entry + 0.004, ..choice };
                    out.push(Candidate { choice, q, v, relative: rest, cost });
                }
            }
        }
    }
}

/// Time that the disc needs to come between the fingers at a constant velocity relative to the hand, until it is as deep
/// as chosen: over the tips or from the side, whichever is shorter. s
fn entry_s(arm: &DiscArm, choice: &Choice, rest: &Vector3<f64>, settings: &Settings) -> f64 {
    let radius = arm.size.disc_radius_m;
    let over_tips = if rest.x < 0.0 { choice.depth_m / -rest.x } else { f64::INFINITY };
    let beyond_tips = radius - choice.depth_m;
    let half_chord = (radius * radius - beyond_tips * beyond_tips).max(0.0).sqrt();
    let from_side = half_chord + settings.gripper.half_width_m + choice.lateral_m.abs();
    over_tips.min(from_side / rest.z.abs().max(1e-9))
}

/// Lowest and highest place of the disc's points across the gap, from `before_s` before the catch to `after_s` after it,
/// with constant joint speeds.
fn gap_used(
    arm: &DiscArm,
    path: &Path,
    t_s: f64,
    q: &Joints,
    v: &Joints,
    before_s: f64,
    after_s: f64,
) -> (f64, f64) {
    let mut out = (f64::INFINITY, f64::NEG_INFINITY);
    for dt in [-before_s, -0.5 * before_s, 0.0, after_s] {
        let q = q + v * dt;
        let disc = path.at(t_s + dt);
        let axes = arm.hand_axes(&q);
        let height = axes.column(1).dot(&(disc.p_m - arm.terminal_point(&q)));
        // The rim that is between the fingers is nearer to the hand than the centre, by the radius at most.
        let slope = axes.column(0).dot(&disc.normal) * arm.size.disc_radius_m;
        out = (out.0.min(height.min(height + slope)), out.1.max(height.max(height + slope)));
    }
    out
}

/// Largest shares of the robot file's speed and acceleration limits over a motion.
fn used(arm: &DiscArm, motion: &DiscMotion) -> (f64, f64) {
    let steps = ((motion.end_s() - motion.from_s) / 0.001).ceil() as u32;
    let mut out = (0.0_f64, 0.0_f64);
    for (j, joint) in arm.model.joints().iter().enumerate() {
        for k in 0..steps {
            let at = motion.at(j, motion.from_s + 0.001 * f64::from(k));
            out.0 = out.0.max(at.v.abs() / joint.limits.v_max_rad_s);
            out.1 = out.1.max(at.a.abs() / joint.limits.a_max_rad_s2);
        }
    }
    out
}
