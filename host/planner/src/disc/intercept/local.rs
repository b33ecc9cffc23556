//! Catches between the places of the grid: differential evolution (Storn and Price 1997) over time, grip, tilt of the hand
//! against the disc and joint speeds.
//!
//! A place is a point in a box: where the disc lies in the gripper and how it moves there, not where the joints are.
//! Each place therefore holds the disc, and closed-form kinematics give the joints. There are eight kinds of
//! posture, each with populations of its own. A place without a catch has a measure of what is missing:
//! first by posture, speeds and the motion to it, then by where the disc touches something on its way in.

use nalgebra::Vector3;

use super::way::{WAY_STEP_S, too_near_m, touches_before};
use super::{Choice, Decline, Follow, Plan, Settings, gap_used, hand_rates, limits, relative, used};
use crate::disc::Joints;
use crate::disc::arm::DiscArm;
use crate::disc::flight::Path;
use crate::disc::motion::{self, Approach, DiscMotion, Impossible, Reach};
use crate::disc::witness::HALF_HEIGHT_M;
use crate::motion_law::{Limits, MotionLaw, State, steps};
use crate::plan::rng::SplitMix64;

/// How much is tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Populations of each kind of posture.
    pub populations: usize,
    /// Generations of each population at first. The better half gets as many again, and so on.
    pub generations: usize,
    pub seed: u64,
}

impl Effort {
    /// Before a refusal.
    pub const PLAN: Self = Self { populations: 4, generations: 60, seed: 1 };
    /// While the disc flies: the places of the grid alone.
    pub const NOT_AT_ALL: Self = Self { populations: 0, generations: 0, seed: 1 };
}

/// More than the dwell of the rule on each side, as the check of the way in has it, s.
const DWELL_MORE_S: f64 = 0.002;
/// Places of a population.
const PLACES: usize = 40;
/// Half the ranges of tilt (rad), disc into the hand and across the gap (m/s), rate of the hand's elevation (rad/s).
const TILT_RAD: f64 = 0.35;
const INTO_M_S: f64 = 3.0;
const UP_M_S: f64 = 1.0;
const TURN_RAD_S: f64 = 12.0;
const LEAD_MAX_S: f64 = 0.1;
/// Steepest disc along the hand, rad.
const STEEP_RAD: f64 = 0.8;
/// Misses of a motion that is planned, but touches something, are below the first; of a posture and speeds that can be had, but
/// without a motion to them, below the second; of a posture in reach below the third.
const MOTION: f64 = 2.0;
const POSTURE: f64 = 12.0;
const OUT_OF_REACH: f64 = 100.0;
/// Share of the coordinates that a new place has from others; how far it goes towards a better place and along a difference of
/// two: the least and the range.
const CROSSED: f64 = 0.9;
const STEP: (f64, f64) = (0.4, 0.5);
/// The better place is the best of this many.
const BEST_OF: usize = 4;

/// Coordinates of a place, each in 0 to 1: time, lateral, depth, height, tilt, lead, velocity into the hand, across the gap,
/// speed of the turntable, rate of the elevation.
type Place = [f64; 10];

/// A posture: turntable towards the disc or away, hand away from the turntable's axis or back, elbow.
#[derive(Debug, Clone, Copy)]
struct Kind {
    over_back: bool,
    backwards: bool,
    elbow_negative: bool,
}

struct Search<'a> {
    arm: &'a DiscArm,
    path: &'a Path,
    now: &'a [State; 4],
    settings: &'a Settings,
    law: MotionLaw,
    limits: [Limits; 4],
    /// In which the disc is in reach, s.
    times_s: (f64, f64),
}

fn over(x: f64) -> f64 {
    x.max(0.0)
}

fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

impl<'a> Search<'a> {
    fn new(arm: &'a DiscArm, path: &'a Path, now: &'a [State; 4], settings: &'a Settings) -> Option<Self> {
        let farthest = arm.size.reach_m() + arm.size.hand_m + arm.size.touch_m();
        let shoulder = Vector3::z() * arm.size.base_m;
        let steps = ((path.end_s() - settings.now_s) / WAY_STEP_S).max(0.0) as u32;
        let mut near = (0..=steps)
            .map(|k| settings.now_s + WAY_STEP_S * f64::from(k))
            .filter(|t_s| (path.at(*t_s).p_m - shoulder).norm() < farthest);
        let first = near.next()?;
        let times_s = (first, near.next_back().unwrap_or(first));
        Some(Self {
            arm,
            path,
            now,
            settings,
            law: MotionLaw::new(settings.jerk),
            limits: limits(arm, settings),
            times_s,
        })
    }

    fn gap_m(&self) -> f64 {
        self.settings.gripper.half_gap_m - HALF_HEIGHT_M - self.settings.margin_m
    }

    /// The joints at a place, or how far it is out of reach, m.
    fn joints(&self, kind: Kind, at: &Place) -> Result<(Choice, Reach), f64> {
        let Self { arm, path, settings, .. } = *self;
        let size = &arm.size;
        let about_zero = |x: f64, most: f64| (2.0 * x - 1.0) * most;
        let t_s = self.times_s.0 + at[0] * (self.times_s.1 - self.times_s.0);
        let disc = path.at(t_s);
        let lateral_m = about_zero(at[1], settings.rule.lateral_max_m);
        let least = settings.rule.depth_min_m + settings.margin_m;
        let depth_m = least + at[2] * (size.gripper_m - settings.margin_m - least);
        // The arm's plane: the disc's centre is `lateral_m` beside it and `radial` along it.
        let rho = disc.p_m.xy().norm();
        if rho < lateral_m.abs() {
            return Err(lateral_m.abs() - rho);
        }
        let radial = (rho * rho - lateral_m * lateral_m).sqrt() * if kind.over_back { -1.0 } else { 1.0 };
        // Across is (sin, -cos) of the turntable's angle.
        let turn = disc.p_m.y.atan2(disc.p_m.x) - (-lateral_m).atan2(radial);
        let plane = Vector3::new(turn.cos(), turn.sin(), 0.0);
        let ahead = if kind.backwards { -plane } else { plane };
        let slope = (-disc.normal.dot(&ahead)).atan2(disc.normal.z);
        if slope.abs() > STEEP_RAD {
            return Err(slope.abs() - STEEP_RAD);
        }
        let upright = |slope: f64| if kind.backwards { std::f64::consts::PI - slope } else { slope };
        let half_chord = (size.disc_radius_m.powi(2) - lateral_m * lateral_m).sqrt();
        // The middle of the part of the disc that is between the fingers.
        let inwards = upright(slope);
        let from_center = 0.5 * depth_m - half_chord;
        let middle = (radial + inwards.cos() * from_center, disc.p_m.z + inwards.sin() * from_center);
        let hand = upright(slope + about_zero(at[4], TILT_RAD));
        let (sin, cos) = hand.sin_cos();
        let (back, below) = (size.gripper_m - 0.5 * depth_m, about_zero(at[3], self.gap_m()));
        let back = back + size.hand_m;
        let wrist = (middle.0 - cos * back + sin * below, middle.1 - sin * back - cos * below - size.base_m);
        let far = wrist.0.hypot(wrist.1);
        let (upper, fore) = (size.upper_m, size.fore_m);
        let cos_elbow = (far * far - upper * upper - fore * fore) / (2.0 * upper * fore);
        if cos_elbow.abs() > 1.0 {
            return Err(over(far - upper - fore).max((upper - fore).abs() - far));
        }
        let elbow = cos_elbow.acos() * if kind.elbow_negative { -1.0 } else { 1.0 };
        let first = wrist.1.atan2(wrist.0) - (fore * elbow.sin()).atan2(upper + fore * elbow.cos());
        let shoulder = wrapped(first - std::f64::consts::FRAC_PI_2);
        let q = Joints::new(wrapped(turn), shoulder, elbow, wrapped(hand - first - elbow));
        let held = plane * middle.0
            + Vector3::z() * middle.1
            + (disc.p_m - plane * radial).component_mul(&Vector3::new(1.0, 1.0, 0.0));
        let rates = hand_rates(arm, &held, &q);
        let follow = Follow::new(&rates).ok_or(0.0)?;
        let wanted = arm.hand_axes(&q).tr_mul(&disc.v_m_s);
        let turntable = about_zero(at[8], self.limits[0].v_rad_s);
        let v = follow.with_turntable(
            turntable,
            wanted.x - about_zero(at[6], INTO_M_S),
            wanted.y - about_zero(at[7], UP_M_S),
            about_zero(at[9], TURN_RAD_S),
        );
        let choice = Choice {
            t_s,
            depth_m,
            lateral_m,
            outwards: kind.over_back == kind.backwards,
            over_back: kind.over_back,
            elbow_negative: kind.elbow_negative,
            lead_s: at[5] * LEAD_MAX_S,
            approach: Approach::Direct,
        };
        let half_dwell_s = 0.5 * settings.rule.dwell_s + DWELL_MORE_S;
        Ok((choice, Reach { t_s, q, v, half_dwell_s, lead_s: choice.lead_s }))
    }

    /// By what grip, speeds, ranges and accelerations miss; zero or more.
    fn before_way(&self, reach: &Reach) -> f64 {
        let Self { arm, path, settings, .. } = *self;
        let rule = &settings.rule;
        let mut sum = 0.0;
        for dt in [-reach.half_dwell_s, reach.half_dwell_s] {
            let q = reach.q + reach.v * dt;
            let disc = path.at(reach.t_s + dt);
            let seen = arm.hand_axes(&q).tr_mul(&(disc.p_m - arm.terminal_point(&q)));
            let half_chord = over(arm.size.disc_radius_m.powi(2) - seen.z * seen.z).sqrt();
            let rim = seen.x - half_chord;
            let margin = settings.margin_m + 0.001;
            sum += over(rule.depth_min_m + margin - (arm.size.gripper_m - rim)) / 0.05;
            sum += over(margin - rim) / 0.05 + over(seen.z.abs() - rule.lateral_max_m) / 0.05;
        }
        let gap = self.gap_m();
        let before_s = reach.lead_s + reach.half_dwell_s;
        let (low, high) = gap_used(arm, path, reach.t_s, &reach.q, &reach.v, before_s, reach.half_dwell_s);
        sum += over(high - gap) / 0.02 + over(-gap - low) / 0.02;
        let has_s = reach.t_s - before_s - settings.now_s;
        sum += over(0.02 - has_s) / 0.05;
        for (j, limit) in self.limits.iter().enumerate() {
            let (q, v) = (reach.q[j], reach.v[j]);
            sum += over(v.abs() / limit.v_rad_s - 1.0);
            let stops_rad = v * reach.half_dwell_s + 0.5 * v * v.abs() / limit.a_rad_s2;
            for q in [q, q + stops_rad] {
                sum += over((limit.q_rad.0 - q).max(q - limit.q_rad.1)) / 0.2;
            }
            let (begin, v) = (q - v * before_s, v.clamp(-limit.v_rad_s, limit.v_rad_s));
            let late_s = (begin - self.now[j].q).abs() / limit.v_rad_s - has_s;
            sum += match steps(&self.now[j], begin, v, has_s, limit.v_rad_s) {
                Some((a, _)) => over(a / limit.a_rad_s2 - 1.0).min(10.0),
                None => 10.0 + over(late_s) * 10.0,
            };
        }
        sum
    }

    /// By what a place misses a catch, and the catch if it misses nothing.
    fn misses(&self, kind: Kind, at: &Place) -> (f64, Option<(Choice, Reach, DiscMotion)>) {
        let Self { arm, path, now, settings, .. } = *self;
        let (choice, reach) = match self.joints(kind, at) {
            Ok(joints) => joints,
            Err(by_m) => return (OUT_OF_REACH + by_m, None),
        };
        let before = self.before_way(&reach);
        if before > 0.0 {
            return ((POSTURE + before).min(OUT_OF_REACH), None);
        }
        let planned = motion::plan(&self.law, &self.limits, settings.now_s, now, &reach, Approach::Direct);
        let motion = match planned {
            Ok(motion) => motion,
            Err(Impossible::Limit(times)) => return ((MOTION - 1.0 + times).min(POSTURE), None),
            Err(Impossible::Late(by) | Impossible::Range(by)) => return ((MOTION + by).min(POSTURE), None),
        };
        if let Some(before_s) = touches_before(arm, path, &motion, choice.t_s, settings) {
            return (0.1 + WAY_STEP_S / (WAY_STEP_S + before_s), None);
        }
        // Coarse steps first: most motions that are too near are so for long.
        let too_near_m =
            [0.02, 0.005].iter().map(|step_s| too_near_m(arm, &motion, *step_s)).find(|by_m| *by_m > 0.0);
        match too_near_m {
            Some(by_m) => (by_m.min(0.1), None),
            None => (0.0, Some((choice, reach, motion))),
        }
    }

    fn plan(&self, choice: Choice, reach: Reach, motion: DiscMotion) -> Plan {
        let Self { arm, path, .. } = *self;
        let disc = path.at(reach.t_s);
        let seen = arm.hand_axes(&reach.q).tr_mul(&(disc.p_m - arm.terminal_point(&reach.q)));
        let half_chord = over(arm.size.disc_radius_m.powi(2) - seen.z * seen.z).sqrt();
        // Along the hand, which is tilted against the disc.
        let choice = Choice { depth_m: arm.size.gripper_m - (seen.x - half_chord), ..choice };
        let relative_m_s = relative(arm, &disc, &reach.q, &reach.v);
        let used = used(arm, &motion);
        Plan { choice, reach, motion, relative_m_s, used, looked_at: 0 }
    }
}

/// Places of one kind of posture, each with its misses.
struct Population {
    kind: Kind,
    places: Vec<(f64, Place)>,
    rng: SplitMix64,
}

impl Population {
    /// A generation; the catch, if there is one.
    fn next(&mut self, search: &Search) -> Option<Plan> {
        let (kind, rng) = (self.kind, &mut self.rng);
        if self.places.is_empty() {
            for _ in 0..PLACES {
                let place: Place = std::array::from_fn(|_| rng.unit());
                self.places.push((search.misses(kind, &place).0, place));
            }
        }
        for k in 0..PLACES {
            let mut any = || ((rng.unit() * PLACES as f64) as usize).min(PLACES - 1);
            let (b, c) = (self.places[any()].1, self.places[any()].1);
            let better = (0..BEST_OF).map(|_| self.places[any()]).min_by(|a, b| a.0.total_cmp(&b.0));
            let (misses, old) = self.places[k];
            let better = better.map_or(old, |place| place.1);
            let step = STEP.0 + STEP.1 * rng.unit();
            let place: Place = std::array::from_fn(|i| {
                let new = old[i] + step * (better[i] - old[i] + b[i] - c[i]);
                match new {
                    _ if rng.unit() > CROSSED => old[i],
                    // Half way to a face of the box instead of through it.
                    ..0.0 => 0.5 * old[i],
                    1.0.. => 0.5 * (old[i] + 1.0),
                    _ => new,
                }
            });
            let (new_misses, caught) = search.misses(kind, &place);
            if let Some((choice, reach, motion)) = caught {
                return Some(search.plan(choice, reach, motion));
            }
            if new_misses <= misses {
                self.places[k] = (new_misses, place);
            }
        }
        None
    }

    fn least(&self) -> f64 {
        self.places.iter().map(|place| place.0).fold(f64::INFINITY, f64::min)
    }
}

/// Searches between the places of the grid.
///
/// # Errors
/// No catch is found: [`Decline::NoWayIn`].
pub fn search(arm: &DiscArm, path: &Path, now: &[State; 4], settings: &Settings) -> Result<Plan, Decline> {
    let effort = settings.between;
    let search = Search::new(arm, path, now, settings).ok_or(Decline::NoWayIn)?;
    let mut all: Vec<Population> = (0..8 * effort.populations)
        .map(|k| {
            let kind = Kind { over_back: k & 1 > 0, backwards: k & 2 > 0, elbow_negative: k & 4 > 0 };
            Population { kind, places: Vec::new(), rng: SplitMix64::stream(effort.seed, k as u64) }
        })
        .collect();
    while !all.is_empty() {
        for _ in 0..effort.generations {
            if let Some(plan) = all.iter_mut().find_map(|population| population.next(&search)) {
                return Ok(plan);
            }
        }
        all.sort_by(|a, b| a.least().total_cmp(&b.least()));
        all.truncate(all.len() / 2);
    }
    Err(Decline::NoWayIn)
}
