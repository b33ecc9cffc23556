//! Candidates of a search: postures at a time with a cup direction, judged one after the other.

use nalgebra::Vector3;
use robot_model::Branch;

use super::Joints;
use super::arm::CatchArm;
use super::forecast::{Forecast, Foreseen, across};
use super::law::{Fit, Limits, Pieces, State, least_peak, stopping_angle};
use super::motion::looks_down;
use super::rates::Hand;
use super::slot::{Slot, probability, slot};
use super::task::{Allowed, Count, Mode, Settings, Start};

/// Candidates that are kept.
const SHORTLIST: usize = 24;
/// What a matched catch is worth against one with the hand at rest, as a factor on the probability of the latter.
const HOLD_WORTH: f64 = 0.9;
/// Steps of time (s) and of the cup's direction (rad) about a posture that is missed by little.
const NEARBY: [(f64, f64); 3] = [(0.01, 0.15), (0.005, 0.07), (0.0025, 0.035)];
const NEARBY_DIRECTIONS: u32 = 8;
/// The law finds no motion to a posture, and does not tell how far the limits are: such a posture counts as missed by this share.
const UNKNOWN_MISS: f64 = 0.05;

/// A posture that can be reached, with its motion.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub(super) ball: Foreseen,
    pub(super) axis: Vector3<f64>,
    pub(super) branch: Branch,
    pub(super) mode: Mode,
    pub(super) q: Joints,
    pub(super) qd: Joints,
    pub(super) fits: [Fit; 6],
    pub(super) used: f64,
    pub(super) probability: f64,
    pub(super) relative_m_s: f64,
    pub(super) score: f64,
}

/// Why a posture is no catch. What is missed by least is kept for each, because their amounts cannot be compared.
#[derive(Clone, Copy)]
enum Miss {
    /// No motion leads there: share of a limit, or rad beyond a range.
    Motion,
    /// The cup looks down where the hand stops: by what its axis is too low.
    CupDown,
}

/// A posture that is judged.
struct Place<'a> {
    slot: &'a Slot<'a>,
    axis: Vector3<f64>,
    branch: Branch,
    mode: Mode,
    worth: f64,
    q: Joints,
}

/// Unit vectors about (0, 0, 1): one in the middle, three rings.
pub(super) fn directions(cone_rad: f64) -> Vec<[f64; 3]> {
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

/// `axis` and directions `step_rad` about it, in the cone about the reverse of the ball's velocity and in its coordinates.
fn about(slot: &Slot<'_>, axis: &Vector3<f64>, step_rad: f64, cone_rad: f64) -> Vec<[f64; 3]> {
    let (a, b) = across(&slot.u);
    let about = Vector3::new(axis.dot(&a), axis.dot(&b), -axis.dot(&slot.u));
    let (c, d) = across(&about);
    let turned = (0..NEARBY_DIRECTIONS).map(|k| {
        let (y, x) = (std::f64::consts::TAU * f64::from(k) / f64::from(NEARBY_DIRECTIONS)).sin_cos();
        about + (c * x + d * y) * step_rad
    });
    turned
        .chain([about])
        .map(|direction| direction.normalize())
        .filter(|direction| direction.z >= cone_rad.cos())
        .map(Into::into)
        .collect()
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

/// Largest share of an acceleration limit that no motion to this state can go below.
///
/// # Errors
/// It is above 1, or the arm could not stop inside its ranges: by what share of the limit, or by what angle (rad).
fn least_share(
    arm: &CatchArm,
    start: &Start<'_>,
    slot: &Slot<'_>,
    q: &Joints,
    qd: &Joints,
    count: &mut Count,
) -> Result<f64, f64> {
    let mut peak = 0.0_f64;
    for i in 0..6 {
        let limit = &slot.limits[i];
        let stop = q[i] + stopping_angle(limit, arm.law.limits_jerk(), qd[i]);
        let beyond = (limit.q_rad.0 - stop).max(stop - limit.q_rad.1);
        if beyond > 0.0 {
            count.no_stop += 1;
            return Err(beyond);
        }
        peak = peak.max(least_peak(&start.state[i], q[i], qd[i], slot.left_s) / limit.a_rad_s2);
    }
    if peak > 1.0 {
        count.late += 1;
        return Err(peak - 1.0);
    }
    Ok(peak)
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

/// How far joints leave their ranges on the way to the catch, rad; zero or less if none does.
fn beyond_ranges_rad(arm: &CatchArm, start: &Start<'_>, slot: &Slot<'_>, fits: &[Fit; 6]) -> f64 {
    let beyond = |((fit, state), limits): ((&Fit, &State), &Limits)| {
        let mut way = Pieces::starting(*state);
        arm.law.append(fit, slot.left_s, &mut way);
        let (low, high) = way.extremes();
        (limits.q_rad.0 - low).max(high - limits.q_rad.1)
    };
    fits.iter().zip(start.state).zip(slot.limits).map(beyond).fold(f64::NEG_INFINITY, f64::max)
}

/// A search under way.
pub(super) struct Search<'a> {
    pub(super) arm: &'a CatchArm,
    pub(super) settings: &'a Settings,
    pub(super) start: &'a Start<'a>,
    /// Best first.
    pub(super) best: Vec<Candidate>,
    /// What is missed by least, for each [`Miss`]: by how much, its time (s), its cup direction.
    missed: [Option<(f64, f64, Vector3<f64>)>; 2],
    pub(super) count: Count,
}

impl<'a> Search<'a> {
    pub(super) fn new(arm: &'a CatchArm, settings: &'a Settings, start: &'a Start<'a>) -> Self {
        let best = Vec::with_capacity(SHORTLIST + 1);
        Self { arm, settings, start, best, missed: [None; 2], count: Count::default() }
    }

    /// All postures at one time with these cup directions, given about the reverse of the ball's velocity.
    pub(super) fn look(&mut self, slot: &Slot<'_>, directions: &[[f64; 3]]) {
        let Self { arm, settings, start, .. } = *self;
        let (a, b) = across(&slot.u);
        let kept = start
            .under_way
            .filter(|(t_s, ..)| (t_s - slot.ball.t_s).abs() < 0.02)
            .map(|(_, axis, _)| *axis)
            .filter(|axis| -axis.dot(&slot.u) >= settings.cone_rad.cos());
        let axes = directions.iter().map(|[x, y, z]| a * *x + b * *y - slot.u * *z).chain(kept);
        for axis in axes {
            let p_b = arm.x_wb.inverse_transform_point(&slot.ball.p_m);
            let axis_b = arm.x_wb.rot.tr_mul(&axis);
            self.count.judged += Branch::COUNT;
            arm.model.ik_axis(&arm.tool, &p_b, &axis_b, (&slot.low, &slot.high), |branch, q| {
                self.count.posture += 1;
                for mode in [Mode::Matched, Mode::Hold] {
                    self.judge(slot, (&axis, branch, mode), q);
                }
            });
        }
    }

    /// As long as there is no catch: looks about the postures that missed one by least, nearer and nearer.
    pub(super) fn look_nearby(&mut self, forecast: &Forecast, limits: &[Limits; 6]) {
        let Self { arm, settings, start, .. } = *self;
        for (step_s, step_rad) in NEARBY {
            for kind in [Miss::Motion, Miss::CupDown] {
                let Some((_, t_s, axis)) = self.missed[kind as usize].filter(|_| self.best.is_empty()) else {
                    continue;
                };
                for shift in [-1.0, 0.0, 1.0] {
                    let Some(ball) = forecast.at(t_s + shift * step_s) else { continue };
                    if ball.t_s <= start.at_s + settings.freeze_s {
                        continue;
                    }
                    let slot = slot(arm, settings, start, forecast, limits, ball);
                    self.look(&slot, &about(&slot, &axis, step_rad, settings.cone_rad));
                }
            }
        }
    }

    /// Notes a posture that is no catch, and by how much.
    fn miss(&mut self, place: &Place<'_>, kind: Miss, by: f64) {
        let missed = &mut self.missed[kind as usize];
        if missed.is_none_or(|(least, ..)| by < least) {
            *missed = Some((by, place.slot.ball.t_s, place.axis));
        }
    }

    /// Judges a posture `q` of one time, cup direction and branch in one mode.
    fn judge(&mut self, slot: &Slot<'_>, (axis, branch, mode): (&Vector3<f64>, Branch, Mode), q: Joints) {
        let Some((mode, worth)) = allowed_mode(self.settings, slot, mode) else { return };
        let place = Place { slot, axis: *axis, branch, mode, worth, q };
        if mode == Mode::Hold {
            self.judge_rates(&place, Joints::zeros(6), slot.speed);
            return;
        }
        let relative_m_s = self.settings.relative_m_s;
        let hand = Hand::at(self.arm, slot.limits, &q);
        // Least speed of the hand: straight with the ball. Else the ball comes straight along the cup's axis.
        for hand_m_s in [slot.u * (slot.speed - relative_m_s), slot.ball.v_m_s + axis * relative_m_s] {
            match hand.rates(&hand_m_s) {
                Some(qd) if self.judge_rates(&place, qd, relative_m_s) => return,
                Some(_) => {}
                None => self.count.fast += 1,
            }
        }
    }

    /// Judges a posture with joint rates; false if no motion leads there.
    fn judge_rates(&mut self, place: &Place<'_>, qd: Joints, relative_m_s: f64) -> bool {
        let Self { arm, settings, start, .. } = *self;
        let Place { slot, axis, branch, mode, worth, q } = *place;
        let bound = if self.best.len() < SHORTLIST { 0.0 } else { self.best[self.best.len() - 1].score };
        let least = match least_share(arm, start, slot, &q, &qd, &mut self.count) {
            Ok(least) => least,
            Err(by) => {
                self.miss(place, Miss::Motion, by);
                return false;
            }
        };
        let kept = start.under_way.map_or(0.0, |(t_s, under_way, was)| {
            let same = was == mode && (t_s - slot.ball.t_s).abs() < 0.006 && (under_way - axis).norm() < 1e-6;
            if same { settings.hysteresis } else { 0.0 }
        });
        let score = |used: f64| {
            let probability = probability(arm, slot, used);
            (probability, worth * probability + kept + 0.01 * (1.0 - used))
        };
        if score(least).1 <= bound {
            return true;
        }
        let Some((fits, used)) = fit_all(arm, start, slot, &q, &qd) else {
            self.count.late += 1;
            self.miss(place, Miss::Motion, UNKNOWN_MISS);
            return false;
        };
        self.count.motion += 1;
        let (probability, score) = score(used);
        if score <= bound {
            return true;
        }
        let beyond_rad = beyond_ranges_rad(arm, start, slot, &fits);
        if beyond_rad > 0.0 {
            self.count.no_stop += 1;
            self.miss(place, Miss::Motion, beyond_rad);
            return false;
        }
        let stop =
            Joints::from_fn(6, |i| q[i] + stopping_angle(&slot.limits[i], arm.law.limits_jerk(), qd[i]));
        let down = looks_down(arm, &stop);
        if down > 0.0 {
            self.count.cup_down += 1;
            self.miss(place, Miss::CupDown, down);
            return false;
        }
        let at = self.best.partition_point(|other| other.score >= score);
        self.best.truncate(SHORTLIST - 1);
        let at = at.min(self.best.len());
        let ball = slot.ball;
        let found =
            Candidate { ball, axis, branch, mode, q, qd, fits, used, probability, relative_m_s, score };
        self.best.insert(at, found);
        true
    }
}
