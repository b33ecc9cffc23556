//! Joint motion under limits: polynomial pieces per joint, with closed-form times and peaks.
//!
//! Two laws. [`MotionLaw::Acceleration`] keeps speed and acceleration: pieces of constant acceleration, jerk unbounded.
//! [`MotionLaw::Jerk`] keeps the jerk as well: quintics and cubic speed ramps that start and end without acceleration.

use robot_model::JointVec;

use super::Joints;
use crate::motion::{GripperEvent, Knot, Motion};

/// Which limits the motion keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionLaw {
    /// Speed and acceleration.
    Acceleration,
    /// Speed, acceleration and jerk.
    Jerk,
}

/// Limits of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Speed, rad/s.
    pub v: f64,
    /// Acceleration, rad/s².
    pub a: f64,
    /// Jerk, rad/s³.
    pub j: f64,
}

/// Angle, speed, acceleration and jerk of one joint.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct At {
    /// rad.
    pub q: f64,
    /// rad/s.
    pub v: f64,
    /// rad/s².
    pub a: f64,
    /// rad/s³.
    pub j: f64,
}

/// A polynomial of degree 5 in the time since its start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Start, s.
    pub from_s: f64,
    /// Duration, s.
    pub lasts_s: f64,
    /// Coefficients of 1, t, t², ...
    pub c: [f64; 6],
}

impl Piece {
    fn at(&self, t_s: f64) -> At {
        let u = t_s - self.from_s;
        let horner = |c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * u + c);
        let c = &self.c;
        At {
            q: horner(c),
            v: horner(&[c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c[4], 5.0 * c[5]]),
            a: horner(&[2.0 * c[2], 6.0 * c[3], 12.0 * c[4], 20.0 * c[5]]),
            j: horner(&[6.0 * c[3], 24.0 * c[4], 60.0 * c[5]]),
        }
    }

    fn end_s(&self) -> f64 {
        self.from_s + self.lasts_s
    }
}

/// The motion of one joint; stands before its first and after its last piece.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Track {
    pieces: Vec<Piece>,
}

impl Track {
    /// Angle, speed, acceleration and jerk at a time.
    #[must_use]
    pub fn at(&self, t_s: f64) -> At {
        let (Some(first), Some(last)) = (self.pieces.first(), self.pieces.last()) else {
            return At::default();
        };
        if t_s < first.from_s {
            return At { q: first.c[0], ..At::default() };
        }
        if t_s >= last.end_s() {
            return At { q: last.at(last.end_s()).q, ..At::default() };
        }
        let after = self.pieces.partition_point(|p| p.from_s <= t_s);
        self.pieces[after.saturating_sub(1)].at(t_s)
    }

    /// End of the last piece, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.pieces.last().map_or(0.0, Piece::end_s)
    }

    fn push(&mut self, lasts_s: f64, c: [f64; 6]) {
        if lasts_s > 0.0 {
            let from_s = self.pieces.last().map_or(0.0, Piece::end_s);
            self.pieces.push(Piece { from_s, lasts_s, c });
        }
    }

    /// Starts at a time with the joint at rest or moving.
    fn start(from_s: f64, now: At) -> Self {
        Self { pieces: vec![Piece { from_s, lasts_s: 0.0, c: [now.q, now.v, 0.0, 0.0, 0.0, 0.0] }] }
    }

    fn last(&self) -> At {
        self.pieces.last().map_or(At::default(), |p| p.at(p.end_s()))
    }

    fn accelerate(&mut self, a: f64, lasts_s: f64) {
        let now = self.last();
        self.push(lasts_s, [now.q, now.v, 0.5 * a, 0.0, 0.0, 0.0]);
    }

    fn coast(&mut self, lasts_s: f64) {
        self.accelerate(0.0, lasts_s);
    }

    /// To a speed in a time; with `MotionLaw::Jerk` as a cubic in the speed.
    fn change_speed(&mut self, law: MotionLaw, to_v: f64, lasts_s: f64) {
        if lasts_s <= 0.0 {
            return;
        }
        let now = self.last();
        let (dv, t) = (to_v - now.v, lasts_s);
        match law {
            MotionLaw::Acceleration => self.accelerate(dv / t, t),
            // v = v0 + dv (3 s² - 2 s³), s = time / t.
            MotionLaw::Jerk => self.push(t, [now.q, now.v, 0.0, dv / (t * t), -0.5 * dv / (t * t * t), 0.0]),
        }
    }
}

/// Shortest time for a change of speed within acceleration (and jerk).
#[must_use]
pub(crate) fn speed_change_s(law: MotionLaw, limit: &Limit, dv: f64) -> f64 {
    let dv = dv.abs();
    match law {
        MotionLaw::Acceleration => dv / limit.a,
        MotionLaw::Jerk => (1.5 * dv / limit.a).max((6.0 * dv / limit.j).sqrt()),
    }
}

/// Shortest time from rest to rest over a distance, rad.
#[must_use]
pub(crate) fn rest_to_rest_s(law: MotionLaw, limit: &Limit, distance: f64) -> f64 {
    let d = distance.abs();
    match law {
        MotionLaw::Acceleration if d * limit.a <= limit.v * limit.v => 2.0 * (d / limit.a).sqrt(),
        MotionLaw::Acceleration => d / limit.v + limit.v / limit.a,
        // Quintic: peaks 15/8, 10/√3, 60.
        MotionLaw::Jerk => (1.875 * d / limit.v)
            .max((10.0 / 3.0_f64.sqrt() * d / limit.a).sqrt())
            .max((60.0 * d / limit.j).cbrt()),
    }
}

/// From (q0, v0) to (q1, v1) in exactly a time, with the least peak acceleration and within the speed limit
/// (catching notes, section 3: two pieces of ±a; with a cruise at the speed limit between them where two pieces would
/// pass it). Returns the pieces as (acceleration, duration).
#[must_use]
pub fn fixed_time(from: At, to: At, time_s: f64, v_max: f64) -> Option<[(f64, f64); 3]> {
    let (t, e) = (time_s, to.v - from.v);
    let big_d = (to.q - from.q) - 0.5 * (from.v + to.v) * t;
    if t <= 0.0 {
        return None;
    }
    let a = (2.0 * big_d + big_d.signum() * (4.0 * big_d * big_d + t * t * e * e).sqrt()) / (t * t);
    if a.abs() < 1e-12 {
        return Some([(0.0, t), (0.0, 0.0), (0.0, 0.0)]);
    }
    let first = (0.5 * (t + e / a)).clamp(0.0, t);
    let peak = from.v + a * first;
    if peak.abs() <= v_max {
        return Some([(a, first), (0.0, 0.0), (-a, t - first)]);
    }
    let w = v_max.copysign(peak);
    let room = (w * t - (to.q - from.q)) * w.signum();
    if room <= 0.0 || from.v.abs() > v_max || to.v.abs() > v_max {
        return None;
    }
    let a = ((w - from.v).powi(2) + (w - to.v).powi(2)) / (2.0 * room) * w.signum();
    let (t1, t3) = ((w - from.v) / a, (w - to.v) / a);
    (t1 + t3 <= t + 1e-12).then_some([(a, t1), (0.0, (t - t1 - t3).max(0.0)), (-a, t3)])
}

/// Motion of all four joints.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscMotion {
    /// One track per joint.
    pub tracks: [Track; 4],
    /// When the arm first moves, s.
    pub from_s: f64,
    /// Interval in which the arm stands and waits before the run-up, s; empty if it does not wait.
    pub waits_s: (f64, f64),
}

/// Least time between two knots of a trajectory, s: the controller's, with a margin for its rounding to microseconds.
const KNOTS_APART_S: f64 = 2.1e-3;
/// Longest time between two knots, s: a quintic piece is then a chain of cubics with an error below 10 µrad.
const KNOTS_MOST_S: f64 = 1e-2;

impl DiscMotion {
    /// The motion as knots and cubics, with a gripper that opens at `open_s` and begins to close at `close_s`. It
    /// stands for `stand_s` before: everything in it is later by this time.
    ///
    /// A piece of constant acceleration stays unchanged, unless pieces of two joints end within 2 ms of each other.
    /// There a cubic covers the step, with up to 1.5 times the acceleration.
    #[must_use]
    pub fn as_motion(&self, stand_s: f64, open_s: f64, close_s: f64) -> Motion {
        let ends = self.tracks.iter().flat_map(|track| track.pieces.iter().map(Piece::end_s));
        let mut ends: Vec<f64> = ends.filter(|t_s| *t_s > self.from_s).collect();
        ends.sort_by(f64::total_cmp);
        let mut times = vec![self.from_s];
        for end_s in ends {
            let last_s = times[times.len() - 1];
            if end_s - last_s < KNOTS_APART_S {
                continue;
            }
            let parts = ((end_s - last_s) / KNOTS_MOST_S).ceil().max(1.0);
            let count = if self.is_quintic() { parts as u32 } else { 1 };
            times.extend((1..=count).map(|k| last_s + (end_s - last_s) * f64::from(k) / f64::from(count)));
        }
        // The last end may have been too near to the knot before.
        let stop_s = self.end_s();
        match times.last_mut() {
            Some(last) if *last > self.from_s && stop_s - *last < KNOTS_APART_S => *last = stop_s,
            _ => times.push(stop_s),
        }
        let state = |t_s: f64| {
            let at: [At; 4] = std::array::from_fn(|j| self.tracks[j].at(t_s));
            (JointVec::from(at.map(|at| at.q)), JointVec::from(at.map(|at| at.v)))
        };
        let begin = Knot { t_s: 0.0, q_rad: state(self.from_s).0, qd_rad_s: JointVec::zeros(4) };
        let moving = times.into_iter().map(|t_s| {
            let (q_rad, qd_rad_s) = state(t_s);
            Knot { t_s: t_s - self.from_s + stand_s, q_rad, qd_rad_s }
        });
        let later = stand_s - self.from_s;
        Motion {
            knots: std::iter::once(begin).chain(moving).collect(),
            events: vec![(open_s + later, GripperEvent::Open), (close_s + later, GripperEvent::Close)],
        }
    }

    /// True if a piece is not a parabola.
    fn is_quintic(&self) -> bool {
        self.tracks.iter().flat_map(|track| &track.pieces).any(|piece| piece.c[3..].iter().any(|c| *c != 0.0))
    }

    /// Joint angles at a time, rad.
    #[must_use]
    pub fn q(&self, t_s: f64) -> Joints {
        Joints::from_fn(|j, _| self.tracks[j].at(t_s).q)
    }

    /// State of a joint at a time.
    #[must_use]
    pub fn at(&self, joint: usize, t_s: f64) -> At {
        self.tracks[joint].at(t_s)
    }

    /// When the arm stands again, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.tracks.iter().map(Track::end_s).fold(0.0, f64::max)
    }

    /// Where the arm stands at the end.
    #[must_use]
    pub fn q_end(&self) -> Joints {
        self.q(self.end_s())
    }
}

/// A catch in joint space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// When the hand meets the disc, s.
    pub t_s: f64,
    /// Angles there, rad.
    pub q: Joints,
    /// Speeds there, kept over the dwell, rad/s.
    pub v: Joints,
    /// Half of the dwell, s: speeds are constant from `t_s` minus this to `t_s` plus this.
    pub half_dwell_s: f64,
    /// Time before the dwell in which the speeds are constant, too, s.
    pub lead_s: f64,
}

/// How the arm gets to the catch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Approach {
    /// To a waiting pose as soon as possible, wait, run up in this time.
    Staged {
        /// Time of the run-up, s.
        run_up_s: f64,
    },
    /// Straight from where it is.
    Direct,
}

/// Why a motion is not possible.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Impossible {
    /// The joints need this much more time, s.
    Late(f64),
    /// A joint would pass the end of its range, rad beyond it.
    Range(f64),
    /// A speed, acceleration or jerk limit; how many times the limit.
    Limit(f64),
}

/// Plans approach, dwell and stop within the limits.
///
/// # Errors
/// [`Impossible`].
pub fn plan(
    law: MotionLaw,
    limits: &[Limit; 4],
    range: &(Joints, Joints),
    now_s: f64,
    now: &[At; 4],
    reach: &Reach,
    approach: Approach,
) -> Result<DiscMotion, Impossible> {
    let before_s = reach.half_dwell_s + reach.lead_s;
    let meets_s = reach.t_s - before_s;
    let dwell_from = reach.q - reach.v * before_s;
    let over: f64 = (0..4).map(|j| reach.v[j].abs() / limits[j].v).fold(0.0, f64::max);
    if over > 1.0 {
        return Err(Impossible::Limit(over));
    }
    let mut tracks: [Track; 4] = std::array::from_fn(|j| Track::start(now_s, now[j]));
    let mut waits_s = (meets_s, meets_s);
    match approach {
        Approach::Staged { run_up_s } => {
            // From rest to the speed of the dwell; the mean speed is half of it for both laws.
            let wait_at = dwell_from - reach.v * (0.5 * run_up_s);
            for (limit, v) in limits.iter().zip(reach.v.iter()) {
                let needs = speed_change_s(law, limit, *v);
                if needs > run_up_s + 1e-12 {
                    return Err(Impossible::Limit(needs / run_up_s));
                }
            }
            let moving = now.iter().any(|at| at.v.abs() > 1e-9);
            let needs =
                (0..4).map(|j| rest_to_rest_s(law, &limits[j], wait_at[j] - now[j].q)).fold(0.0, f64::max);
            let has = meets_s - run_up_s - now_s;
            if needs > has || has <= 0.0 || moving {
                return Err(Impossible::Late((needs - has).max(0.0)));
            }
            // Not at full speed if there is time: half as long again, if it still waits then.
            let takes = (1.5 * needs).min(has);
            for (j, track) in tracks.iter_mut().enumerate() {
                rest_to_rest(track, law, limits[j].v, wait_at[j], takes)?;
                track.coast(has - takes);
                track.change_speed(law, reach.v[j], run_up_s);
            }
            waits_s = (now_s + takes, meets_s - run_up_s);
        }
        Approach::Direct => {
            let has = meets_s - now_s;
            for (j, track) in tracks.iter_mut().enumerate() {
                let to = At { q: dwell_from[j], v: reach.v[j], ..At::default() };
                direct(track, law, &limits[j], &now[j], &to, has)?;
            }
        }
    }
    for (j, track) in tracks.iter_mut().enumerate() {
        track.coast(before_s + reach.half_dwell_s);
        track.change_speed(law, 0.0, speed_change_s(law, &limits[j], reach.v[j]));
    }
    let motion = DiscMotion { tracks, from_s: now_s, waits_s };
    within(&motion, range)?;
    Ok(motion)
}

fn rest_to_rest(
    track: &mut Track,
    law: MotionLaw,
    v_max: f64,
    to: f64,
    time_s: f64,
) -> Result<(), Impossible> {
    let from = track.last();
    let d = to - from.q;
    match law {
        MotionLaw::Acceleration => {
            let to = At { q: to, ..At::default() };
            let pieces = fixed_time(from, to, time_s, v_max).ok_or(Impossible::Late(0.0))?;
            for (a, t) in pieces {
                track.accelerate(a, t);
            }
        }
        MotionLaw::Jerk => {
            let t3 = time_s.powi(3);
            let c = [
                from.q,
                0.0,
                0.0,
                10.0 * d / t3,
                -15.0 * d / (t3 * time_s),
                6.0 * d / (t3 * time_s * time_s),
            ];
            track.push(time_s, c);
        }
    }
    Ok(())
}

fn direct(
    track: &mut Track,
    law: MotionLaw,
    limit: &Limit,
    from: &At,
    to: &At,
    time_s: f64,
) -> Result<(), Impossible> {
    if time_s <= 0.0 {
        return Err(Impossible::Late(-time_s));
    }
    match law {
        MotionLaw::Acceleration => {
            let pieces = fixed_time(*from, *to, time_s, limit.v).ok_or(Impossible::Limit(f64::INFINITY))?;
            let over = pieces[0].0.abs() / limit.a;
            if over > 1.0 {
                return Err(Impossible::Limit(over));
            }
            for (a, t) in pieces {
                track.accelerate(a, t);
            }
        }
        MotionLaw::Jerk => {
            let c = quintic(from, to, time_s);
            let piece = Piece { from_s: 0.0, lasts_s: time_s, c };
            let over =
                (0..=100).map(|k| piece.at(time_s * f64::from(k) / 100.0)).fold(0.0_f64, |over, at| {
                    over.max(at.v.abs() / limit.v).max(at.a.abs() / limit.a).max(at.j.abs() / limit.j)
                });
            if over > 1.0 {
                return Err(Impossible::Limit(over));
            }
            track.push(time_s, c);
        }
    }
    Ok(())
}

/// Polynomial with given angle, speed and acceleration at both ends.
fn quintic(from: &At, to: &At, t: f64) -> [f64; 6] {
    let (t2, t3) = (t * t, t * t * t);
    let d = to.q - from.q - from.v * t - 0.5 * from.a * t2;
    let e = (to.v - from.v - from.a * t) * t;
    let f = (to.a - from.a) * t2;
    [
        from.q,
        from.v,
        0.5 * from.a,
        (10.0 * d - 4.0 * e + 0.5 * f) / t3,
        (-15.0 * d + 7.0 * e - f) / (t3 * t),
        (6.0 * d - 3.0 * e + 0.5 * f) / (t3 * t2),
    ]
}

/// Ranges over the whole motion, at 2 ms and at the ends of the pieces.
fn within(motion: &DiscMotion, range: &(Joints, Joints)) -> Result<(), Impossible> {
    let mut beyond = f64::NEG_INFINITY;
    for (j, track) in motion.tracks.iter().enumerate() {
        let steps = ((track.end_s() - motion.from_s) / 0.002).ceil().max(1.0) as u32;
        let times = (0..=steps).map(|k| motion.from_s + f64::from(k) * 0.002);
        for t in times.chain(track.pieces.iter().map(Piece::end_s)) {
            let q = track.at(t).q;
            beyond = beyond.max(range.0[j] - q).max(q - range.1[j]);
        }
    }
    if beyond > 0.0 { Err(Impossible::Range(beyond)) } else { Ok(()) }
}
