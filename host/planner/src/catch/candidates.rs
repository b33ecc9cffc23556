//! Candidates of a search: postures at a time with a cup direction, judged one after the other.

use nalgebra::Vector3;
use robot_model::Branch;

use super::Joints;
use super::arm::CatchArm;
use super::forecast::{Forecast, Foreseen, across};
use super::motion::looks_down;
use super::rates::Hand;
use super::slot::{Slot, enters, slot};
use super::task::{Allowed, Count, Mode, Settings, Start};
use crate::motion_law::{Fit, Limits, Pieces, State, least_peak, stopping_angle};

/// Candidates that are kept.
const SHORTLIST: usize = 24;
/// Of catches that are as likely the gentler one: what 1 m/s of relative speed costs, as a probability. Nobody knows a restitution as well as
/// a flight.
const GENTLE_S_M: f64 = 0.01;
/// The stop of the hand presses the ball to the bottom: its mean over this time, about that of the first bounce, counts, s.
const FIRST_BOUNCE_S: f64 = 0.06;
/// Steps of time (s) and of the cup's direction (rad) about a posture that is missed by little.
const NEARBY: [(f64, f64); 3] = [(0.01, 0.15), (0.005, 0.07), (0.0025, 0.035)];
/// Most looks, each about what the one before found.
const LOOKS_MAX: usize = 8;
/// The step stays as it is if a look leaves less than this share of the miss.
const LOOK_GAIN: f64 = 0.8;
const NEARBY_DIRECTIONS: u32 = 8;
/// About a catch is looked if a ball that enters its cup stays there with less chance than this: another tilt may keep it.
pub(super) const SURE_TO_STAY: f64 = 0.95;
/// The law finds no motion to a posture, and does not return how far the limits are: such a posture counts as missed by this share.
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
    /// Probability that the ball enters the cup.
    pub(super) enters: f64,
    /// Chance that it stays there then, by the table.
    pub(super) stays: f64,
    /// Standard deviation of the ball beside the axis at the catch, m.
    pub(super) sigma_m: f64,
    pub(super) relative_m_s: f64,
    pub(super) score: f64,
}

/// By how much a posture is no catch. One to which no motion leads is always worse than one where the cup looks down at the stop.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
enum Miss {
    /// By what the cup's axis is too low where the hand stops.
    CupDown(f64),
    /// By how much limits (share) and ranges (rad) are passed, in sum.
    NoMotion(f64),
}

impl Miss {
    /// Whether this is so much less than `before` that another look with the same step is worth it.
    fn gains(self, before: Self) -> bool {
        match (self, before) {
            (Self::CupDown(now), Self::CupDown(before)) | (Self::NoMotion(now), Self::NoMotion(before)) => {
                now < LOOK_GAIN * before
            }
            _ => self < before,
        }
    }
}

/// A posture that is judged.
struct Place<'a> {
    slot: &'a Slot<'a>,
    axis: Vector3<f64>,
    branch: Branch,
    mode: Mode,
    q: Joints,
}

/// The hand at a catch: joint rates, speed of the ball against it, chance that the ball stays.
struct Meeting {
    qd: Joints,
    relative_m_s: f64,
    stays: f64,
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
    let (s, c) = cone_rad.sin_cos();
    let into_cone = |d: Vector3<f64>| {
        let across = d.x.hypot(d.y);
        if d.z >= c * d.norm() { d.normalize() } else { Vector3::new(d.x * s / across, d.y * s / across, c) }
    };
    turned.chain([about]).map(into_cone).map(Into::into).collect()
}

/// Whether the settings allow a mode for a ball of this speed.
fn allows(settings: &Settings, slot: &Slot<'_>, mode: Mode) -> bool {
    // A ball slower than the relative speed allowed needs no hand that moves.
    if slot.speed <= settings.relative_m_s {
        return mode == Mode::Hold;
    }
    match settings.allowed {
        Allowed::Either => true,
        Allowed::Matched => mode == Mode::Matched,
        Allowed::Hold => mode == Mode::Hold,
    }
}

/// What no motion to a state can do better.
struct Least {
    /// Largest share of an acceleration limit.
    peak: f64,
    /// By how much the joints pass their limits of acceleration: sum of the shares above 1.
    late: f64,
    /// By how much the stops of all joints after the catch leave their ranges, rad.
    beyond_rad: f64,
}

impl Least {
    fn of(start: &Start<'_>, slot: &Slot<'_>, q: &Joints, stop: &Joints, qd: &Joints) -> Self {
        let mut least = Self { peak: 0.0, late: 0.0, beyond_rad: 0.0 };
        for i in 0..6 {
            let limit = &slot.limits[i];
            least.beyond_rad += (limit.q_rad.0 - stop[i]).max(stop[i] - limit.q_rad.1).max(0.0);
            let peak = least_peak(&start.state[i], q[i], qd[i], slot.left_s) / limit.a_rad_s2;
            least.peak = least.peak.max(peak);
            least.late += (peak - 1.0).max(0.0);
        }
        least
    }
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
    /// What is missed by least: by how much, its time (s), its cup direction.
    missed: Option<(Miss, f64, Vector3<f64>)>,
    pub(super) count: Count,
}

impl<'a> Search<'a> {
    pub(super) fn new(arm: &'a CatchArm, settings: &'a Settings, start: &'a Start<'a>) -> Self {
        let best = Vec::with_capacity(SHORTLIST + 1);
        Self { arm, settings, start, best, missed: None, count: Count::default() }
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
        let gravity_m_s2 = arm.gravity_m_s2();
        let hold = allows(settings, slot, Mode::Hold);
        let matched = allows(settings, slot, Mode::Matched);
        for axis in axes {
            let stays = if hold { arm.stays.chance(&slot.ball.v_m_s, &axis, &gravity_m_s2) } else { 0.0 };
            let p_b = arm.x_wb.inverse_transform_point(&slot.ball.p_m);
            let axis_b = arm.x_wb.rot.tr_mul(&axis);
            self.count.judged += Branch::COUNT;
            arm.model.ik_axis(&arm.tool, &p_b, &axis_b, (&slot.low, &slot.high), |branch, q| {
                self.count.posture += 1;
                let place = |mode| Place { slot, axis, branch, mode, q };
                if matched {
                    self.judge_matched(&place(Mode::Matched));
                }
                if hold {
                    let meeting = Meeting { qd: Joints::zeros(6), relative_m_s: slot.speed, stays };
                    self.judge(&place(Mode::Hold), &meeting);
                }
            });
        }
    }

    /// As long as there is no catch: looks about the posture that missed one by least, and about what is found there, with smaller
    /// steps where a look gains little. Then about the best catch, as long as the ball may bounce out of its cup.
    pub(super) fn look_nearby(&mut self, forecast: &Forecast, limits: &[Limits; 6]) {
        let mut scale = 0;
        for _ in 0..LOOKS_MAX {
            let Some((by, t_s, axis)) = self.missed.filter(|_| self.best.is_empty()) else { break };
            let Some(step) = NEARBY.get(scale) else { break };
            self.look_about(forecast, limits, t_s, &axis, *step);
            if self.missed.is_some_and(|(now, ..)| !now.gains(by)) {
                scale += 1;
            }
        }
        for step in NEARBY {
            if let Some(best) = self.best.first().filter(|best| best.stays < SURE_TO_STAY) {
                let (t_s, axis) = (best.ball.t_s, best.axis);
                self.look_about(forecast, limits, t_s, &axis, step);
            }
        }
    }

    /// At a time and a step before and after it, with a cup direction and others a step about it.
    fn look_about(
        &mut self,
        forecast: &Forecast,
        limits: &[Limits; 6],
        t_s: f64,
        axis: &Vector3<f64>,
        (step_s, step_rad): (f64, f64),
    ) {
        let Self { arm, settings, start, .. } = *self;
        for shift in [-1.0, 0.0, 1.0] {
            let Some(ball) = forecast.at(t_s + shift * step_s) else { continue };
            if ball.t_s > start.at_s + settings.freeze_s {
                let slot = slot(arm, settings, start, forecast, limits, ball);
                self.look(&slot, &about(&slot, axis, step_rad, settings.cone_rad));
            }
        }
    }

    fn miss(&mut self, place: &Place<'_>, by: Miss) {
        if self.missed.is_none_or(|(least, ..)| by < least) {
            self.missed = Some((by, place.slot.ball.t_s, place.axis));
        }
    }

    /// Judges a posture with a hand that moves with the ball.
    fn judge_matched(&mut self, place: &Place<'_>) {
        let (arm, relative_m_s) = (self.arm, self.settings.relative_m_s);
        let Place { slot, axis, q, .. } = place;
        let hand = Hand::at(arm, slot.limits, q);
        // Least speed of the hand: straight with the ball. Else the ball comes straight along the cup's axis.
        for hand_m_s in [slot.u * (slot.speed - relative_m_s), slot.ball.v_m_s + axis * relative_m_s] {
            let Some(qd) = hand.rates(&hand_m_s) else {
                self.count.fast += 1;
                continue;
            };
            let pressing_m_s2 = arm.gravity_m_s2() + hand.stop_m_s2(&qd, FIRST_BOUNCE_S);
            let stays = arm.stays.chance(&(slot.ball.v_m_s - hand_m_s), axis, &pressing_m_s2);
            if self.judge(place, &Meeting { qd, relative_m_s, stays }) {
                return;
            }
        }
    }

    /// Judges a posture with joint rates; false if no motion leads there.
    fn judge(&mut self, place: &Place<'_>, meeting: &Meeting) -> bool {
        let Self { arm, settings, start, .. } = *self;
        let Place { slot, axis, branch, mode, q } = *place;
        let Meeting { qd, relative_m_s, stays } = *meeting;
        let bound = if self.best.len() < SHORTLIST {
            f64::NEG_INFINITY
        } else {
            self.best[self.best.len() - 1].score
        };
        let stop =
            Joints::from_fn(6, |i| q[i] + stopping_angle(&slot.limits[i], arm.law.limits_jerk(), qd[i]));
        let least = Least::of(start, slot, &q, &stop, &qd);
        if least.beyond_rad > 0.0 || least.late > 0.0 {
            self.count.no_stop += usize::from(least.beyond_rad > 0.0);
            self.count.late += usize::from(least.late > 0.0);
            if self.best.is_empty() {
                self.miss(place, Miss::NoMotion(least.late + least.beyond_rad));
            }
            return false;
        }
        let kept = start.under_way.map_or(0.0, |(t_s, under_way, was)| {
            let same = was == mode && (t_s - slot.ball.t_s).abs() < 0.006 && (under_way - axis).norm() < 1e-6;
            if same { settings.hysteresis } else { 0.0 }
        });
        let score = |used: f64| {
            let enters = enters(arm, slot, used);
            (enters, enters * stays + kept + 0.01 * (1.0 - used) - GENTLE_S_M * relative_m_s)
        };
        if score(least.peak).1 <= bound {
            return true;
        }
        let Some((fits, used)) = fit_all(arm, start, slot, &q, &qd) else {
            self.count.late += 1;
            self.miss(place, Miss::NoMotion(UNKNOWN_MISS));
            return false;
        };
        self.count.motion += 1;
        let (enters, score) = score(used);
        if score <= bound {
            return true;
        }
        let beyond_rad = beyond_ranges_rad(arm, start, slot, &fits);
        if beyond_rad > 0.0 {
            self.count.no_stop += 1;
            self.miss(place, Miss::NoMotion(beyond_rad));
            return false;
        }
        let down = looks_down(arm, &stop);
        if down > 0.0 {
            self.count.cup_down += 1;
            self.miss(place, Miss::CupDown(down));
            return false;
        }
        self.best.truncate(SHORTLIST - 1);
        let at = self.best.partition_point(|other| other.score >= score);
        let (ball, sigma_m) = (slot.ball, slot.sigma_end_m);
        let found = Candidate {
            ball,
            axis,
            branch,
            mode,
            q,
            qd,
            fits,
            used,
            enters,
            stays,
            sigma_m,
            relative_m_s,
            score,
        };
        self.best.insert(at, found);
        true
    }
}
