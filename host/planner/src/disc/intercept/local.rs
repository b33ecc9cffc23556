//! Catches between the places of the grid: time, posture (with the tilt of the hand against the disc) and joint speeds are continuous
//! variables.
//!
//! A place without a catch has a measure of what is missing: first by its posture and speeds at the catch, then by
//! the motion that leads there, then by where the disc touches something on its way in. From the best postures,
//! random changes that become smaller lead to better places; the best of them are followed longest.

use super::way::{WAY_STEP_S, stays_clear, touches_before};
use super::{
    Choice, DEPTHS_M, Decline, Follow, Plan, Settings, entry_s, gap_used, hand_rates, limits, poses,
    relative, used,
};
use crate::disc::Joints;
use crate::disc::arm::DiscArm;
use crate::disc::flight::Path;
use crate::disc::motion::{self, Approach, At, DiscMotion, Impossible, Limit, Reach};
use crate::disc::witness::HALF_HEIGHT_M;
use crate::plan::rng::SplitMix64;

/// How much is tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// Postures from which the search starts.
    pub starts: usize,
    /// Changes that are tried from each start at first. The best quarter of the starts gets four times as many, and
    /// so on.
    pub changes: usize,
    pub seed: u64,
}

impl Effort {
    /// Before a refusal.
    pub const PLAN: Self = Self { starts: 720, changes: 100, seed: 1 };
    /// While the disc flies: the places of the grid alone.
    pub const NOT_AT_ALL: Self = Self { starts: 0, changes: 0, seed: 1 };
}

/// The search ends when fewer than this many starts are left: they would have led to a catch before.
const FOLLOWED_MIN: usize = 8;
/// More than the dwell of the rule on each side, as the check of the way in has it, s.
const DWELL_MORE_S: f64 = 0.002;
/// Starts are looked for this far apart in time, s.
const START_STEP_S: f64 = 0.01;
/// Starts that differ by less in time and are alike otherwise lead to the same catch, s.
const ALIKE_S: f64 = 0.04;
/// Standard deviations of the first changes: time (s), place (m), tilt (rad), velocity (m/s), rate of the tilt (rad/s), lead (s).
const CHANGES: [f64; 6] = [0.012, 0.02, 0.12, 0.4, 1.0, 0.01];
/// A change that helps makes the next ones larger, another one makes them smaller; down to a share of the first.
const LARGER: f64 = 1.6;
const SMALLER: f64 = 0.94;
const SMALLEST: f64 = 0.02;
const CHANGED_SHARE: f64 = 0.4;
const LEAD_MAX_S: f64 = 0.1;
/// Errors of posture and speeds count more than any error of the motion, and those more than any of the way in.
const MOTION: f64 = 2.0;
const POSTURE: f64 = 20.0;
const MOST: f64 = 10.0;

/// A hand at the catch.
#[derive(Debug, Clone, Copy)]
struct Place {
    choice: Choice,
    q: Joints,
    v: Joints,
}

/// A place on its way to a catch.
struct Descent {
    place: Place,
    misses: f64,
    motion: Option<DiscMotion>,
    /// Of the first changes, for the next one.
    share: f64,
}

struct Search<'a> {
    arm: &'a DiscArm,
    path: &'a Path,
    now: &'a [At; 4],
    settings: &'a Settings,
    limits: [Limit; 4],
    range: (Joints, Joints),
}

impl<'a> Search<'a> {
    fn new(arm: &'a DiscArm, path: &'a Path, now: &'a [At; 4], settings: &'a Settings) -> Self {
        let range = (arm.model.q_min().array().into(), arm.model.q_max().array().into());
        Self { arm, path, now, settings, limits: limits(arm, settings), range }
    }

    fn reach(&self, place: &Place) -> Reach {
        let half_dwell_s = 0.5 * self.settings.rule.dwell_s + DWELL_MORE_S;
        Reach { t_s: place.choice.t_s, q: place.q, v: place.v, half_dwell_s, lead_s: place.choice.lead_s }
    }

    /// By what posture and speeds at the catch miss, zero or more.
    fn posture_misses(&self, place: &Place) -> f64 {
        let Self { arm, settings, .. } = *self;
        let rule = &settings.rule;
        let t_s = place.choice.t_s;
        let half_dwell_s = 0.5 * rule.dwell_s + DWELL_MORE_S;
        let over = |x: f64, unit: f64| x.max(0.0) / unit;
        let mut sum = over(settings.now_s + 0.02 - t_s, 0.05) + over(t_s + 0.05 - self.path.end_s(), 0.05);
        for j in 0..4 {
            sum += over(place.v[j].abs() / self.limits[j].v - 1.0, 1.0);
            sum += over((self.range.0[j] - place.q[j]).max(place.q[j] - self.range.1[j]) + 0.005, 0.2);
        }
        for dt in [-half_dwell_s, half_dwell_s] {
            let q = place.q + place.v * dt;
            let disc = self.path.at(t_s + dt);
            let seen = arm.hand_axes(&q).tr_mul(&(disc.p_m - arm.terminal_point(&q)));
            let half_chord = (arm.size.disc_radius_m.powi(2) - seen.z * seen.z).max(0.0).sqrt();
            let depth = arm.size.gripper_m - (seen.x - half_chord);
            let margin = settings.margin_m + 0.001;
            sum += over(rule.depth_min_m + margin - depth, 0.05);
            sum += over(margin - (seen.x - half_chord), 0.05);
            sum += over(seen.z.abs() - rule.lateral_max_m, 0.05);
        }
        let gap = settings.gripper.half_gap_m - HALF_HEIGHT_M - settings.margin_m;
        let (low, high) = gap_used(
            arm,
            self.path,
            t_s,
            &place.q,
            &place.v,
            place.choice.lead_s + half_dwell_s,
            half_dwell_s,
        );
        sum + over(high - gap, 0.02) + over(-gap - low, 0.02)
    }

    /// By what a place misses a catch, and the motion if it misses nothing.
    fn misses(&self, place: &Place) -> (f64, Option<DiscMotion>) {
        let posture = self.posture_misses(place);
        if posture > 0.0 {
            return (POSTURE + posture, None);
        }
        let Self { arm, path, now, settings, .. } = *self;
        let reach = self.reach(place);
        let motion = motion::plan(
            settings.law,
            &self.limits,
            &self.range,
            settings.now_s,
            now,
            &reach,
            Approach::Direct,
        );
        let motion = match motion {
            Ok(motion) => motion,
            Err(Impossible::Late(by_s)) => return (MOTION + MOST.min(1.0 + 10.0 * by_s), None),
            Err(Impossible::Limit(times)) => return (MOTION + MOST.min(times), None),
            Err(Impossible::Range(by_rad)) => return (MOTION + MOST.min(by_rad), None),
        };
        if let Some(before_s) = touches_before(arm, path, &motion, place.choice.t_s, settings) {
            return (0.1 + WAY_STEP_S / (WAY_STEP_S + before_s), None);
        }
        if stays_clear(arm, &motion) { (0.0, Some(motion)) } else { (0.1, None) }
    }

    /// The posture changed at random, by `share` of the first changes.
    fn changed(&self, place: &Place, share: f64, rng: &mut SplitMix64) -> Option<Place> {
        let follow = Follow::new(&hand_rates(self.arm, &self.path.at(place.choice.t_s).p_m, &place.q))?;
        // Change some variables at a time: most changes of all of them help one limit and violate another.
        let mut by = |what: usize| {
            let some = rng.unit() < CHANGED_SHARE;
            if some { share * CHANGES[what] * rng.normal() } else { 0.0 }
        };
        let dt_s = by(0);
        let dq = follow.speeds(by(1), by(1), by(1), by(2));
        let dv = follow.speeds(by(3), by(3), by(3), by(4));
        let lead_s = (place.choice.lead_s + by(5)).clamp(0.0, LEAD_MAX_S);
        // The hand moves on with the time, so that it stays with the disc.
        let choice = Choice { t_s: place.choice.t_s + dt_s, lead_s, ..place.choice };
        let most = Joints::from_fn(|j, _| self.limits[j].v);
        let v = (place.v + dv).zip_map(&most, |v, most| v.clamp(-most, most));
        Some(Place { choice, q: place.q + place.v * dt_s + dq, v })
    }

    fn descent(&self, place: Place) -> Descent {
        let (misses, motion) = self.misses(&place);
        Descent { place, misses, motion, share: 1.0 }
    }

    /// Tries changes until there is a catch.
    fn descend(&self, at: &mut Descent, changes: usize, rng: &mut SplitMix64) {
        for _ in 0..changes {
            if at.motion.is_some() {
                return;
            }
            let Some(next) = self.changed(&at.place, at.share, rng) else { return };
            let (misses, motion) = self.misses(&next);
            at.share = if misses < at.misses {
                (at.share * LARGER).min(1.0)
            } else {
                (at.share * SMALLER).max(SMALLEST)
            };
            if misses <= at.misses {
                (at.place, at.misses, at.motion) = (next, misses, motion);
            }
        }
    }

    fn plan(&self, place: &Place, motion: DiscMotion) -> Plan {
        let Self { arm, path, .. } = *self;
        let disc = path.at(place.choice.t_s);
        let seen = arm.hand_axes(&place.q).tr_mul(&(disc.p_m - arm.terminal_point(&place.q)));
        let half_chord = (arm.size.disc_radius_m.powi(2) - seen.z * seen.z).max(0.0).sqrt();
        let depth_m = arm.size.gripper_m - (seen.x - half_chord);
        let choice = Choice { depth_m, lateral_m: seen.z, approach: Approach::Direct, ..place.choice };
        let relative_m_s = relative(arm, &disc, &place.q, &place.v);
        let used = used(arm, &motion);
        Plan { choice, reach: self.reach(place), motion, relative_m_s, used, looked_at: 0 }
    }

    /// The postures that miss by least, of each kind, way in and time one.
    fn starts(&self, count: usize) -> Vec<Place> {
        if count == 0 {
            return Vec::new();
        }
        let Self { arm, path, now, settings, .. } = *self;
        let q_now = Joints::from_fn(|j, _| now[j].q);
        let farthest = arm.size.reach_m() + arm.size.hand_m + arm.size.touch_m();
        let steps = ((path.end_s() - settings.now_s) / START_STEP_S).max(0.0) as u32;
        let mut all: Vec<(f64, usize, Place)> = Vec::new();
        for t_s in (1..=steps).map(|k| settings.now_s + START_STEP_S * f64::from(k)) {
            let disc = path.at(t_s);
            if (disc.p_m.z - arm.size.base_m).hypot(disc.p_m.xy().norm()) > farthest {
                continue;
            }
            for (choice, q) in poses(arm, &disc, t_s, &q_now) {
                if choice.depth_m != DEPTHS_M[1] {
                    continue;
                }
                let Some(follow) = Follow::new(&hand_rates(arm, &disc.p_m, &q)) else { continue };
                let wanted = arm.hand_axes(&q).tr_mul(&disc.v_m_s);
                let entries = [(1.0, 0.0), (1.0, wanted.z), (0.0, 1.5_f64.copysign(wanted.z))];
                for (entry, (along, across)) in entries.into_iter().enumerate() {
                    let v = follow.speeds(wanted.x + along, wanted.y, wanted.z - across, 0.0);
                    let most = Joints::from_fn(|j, _| self.limits[j].v);
                    let v = v.zip_map(&most, |v, most| v.clamp(-most, most));
                    let rest = relative(arm, &disc, &q, &v);
                    let lead_s = entry_s(arm, &choice, &rest, settings).min(0.5 * LEAD_MAX_S);
                    let place = Place { choice: Choice { lead_s, ..choice }, q, v };
                    // The time that the way takes at the speed limits counts, too.
                    let late_s = (0..4)
                        .map(|j| (q[j] - q_now[j]).abs() / self.limits[j].v - (t_s - settings.now_s))
                        .fold(0.0, f64::max);
                    all.push((self.posture_misses(&place) + 10.0 * late_s, entry, place));
                }
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut kept: Vec<(usize, Place)> = Vec::new();
        for (_, entry, place) in all {
            let kind = |c: &Choice| (c.outwards, c.over_back, c.elbow_negative, c.lateral_m.to_bits());
            let alike = |(its_entry, other): &(usize, Place)| {
                *its_entry == entry
                    && kind(&other.choice) == kind(&place.choice)
                    && (other.choice.t_s - place.choice.t_s).abs() < ALIKE_S
            };
            if !kept.iter().any(alike) {
                kept.push((entry, place));
            }
            if kept.len() == count {
                break;
            }
        }
        kept.into_iter().map(|(_, place)| place).collect()
    }
}

/// Searches between the places of the grid.
///
/// # Errors
/// No catch is found: [`Decline::NoWayIn`].
pub fn search(arm: &DiscArm, path: &Path, now: &[At; 4], settings: &Settings) -> Result<Plan, Decline> {
    let effort = settings.between;
    let search = Search::new(arm, path, now, settings);
    let mut rng = SplitMix64::stream(effort.seed, 0x6469_7363);
    let mut all: Vec<Descent> =
        search.starts(effort.starts).into_iter().map(|start| search.descent(start)).collect();
    let mut changes = effort.changes;
    while all.len() >= FOLLOWED_MIN {
        for at in &mut all {
            search.descend(at, changes, &mut rng);
            if let Some(motion) = at.motion.take() {
                return Ok(search.plan(&at.place, motion));
            }
        }
        all.sort_by(|a, b| a.misses.total_cmp(&b.misses));
        all.truncate(all.len() / 4);
        changes *= 4;
    }
    Err(Decline::NoWayIn)
}
