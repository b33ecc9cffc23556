//! Reference: piecewise cubic per joint on knots that all joints share (pure).
//!
//! # Why knots and not coefficients
//!
//! A segment is given by position and velocity at its two ends (cubic Hermite form). Every piecewise cubic with
//! continuous velocity has exactly one such form. It needs half the bytes of four coefficients per segment, and
//! position and velocity are always continuous, so this needs no check. Plans that need more freedom, such as a
//! motion that makes the error of a late release small, use more knots: one more knot gives each joint two more
//! numbers, where a quartic would give one.
//!
//! # Arithmetic
//!
//! Time is an integer (µs) up to the segment, then the normalised time τ = t / h in 0..=1. So rounding errors do
//! not grow with the length of a trajectory. Against double precision on the same knots, for |q| ≤ 2π rad and
//! |q̇|·h ≤ 8 rad: position to 8 µrad, velocity to 32 µrad / h, acceleration to 96 µrad / h².
//!
//! A control step evaluates each joint twice, nearly always on the segment of the last evaluation. The coefficients
//! of that segment are kept ([`Spline::at`]), so that a step searches and converts nothing.

use protocol::JointIndex;

use crate::joints::PerJoint;
use crate::retarget::{Course, Detour};
use crate::root::square_root;

/// Most knots of a trajectory: one more than segments. With more than six joints fewer fit ([`knots_max`]).
pub const KNOTS_MAX: usize = 256;
/// Words of all knots together: [`KNOTS_MAX`] knots of six joints.
pub const WORDS_MAX: usize = KNOTS_MAX * knot_words(6);
/// Shortest segment, µs. Shorter ones would turn the rounding of a position (0.2 µrad) into
/// noticeable acceleration, and no drive follows them.
pub const SEGMENT_MIN_US: u32 = 2_000;
/// Longest trajectory of one file, µs (about 17 minutes). A trajectory that goes on with segments ([`crate::segment`]) has no
/// limit.
pub const DURATION_MAX_US: u32 = 1_000_000_000;

/// Position, velocity and acceleration of one joint at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setpoint {
    /// Position, rad.
    pub q_rad: f32,
    /// Velocity, rad/s.
    pub qd_rad_s: f32,
    /// Acceleration, rad/s².
    pub qdd_rad_s2: f32,
}

/// One joint between two knots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic {
    /// Duration h, s; positive.
    pub h_s: f32,
    /// Position at τ = 0, rad.
    pub q0_rad: f32,
    /// Velocity at τ = 0, rad/s.
    pub qd0_rad_s: f32,
    /// Position at τ = 1, rad.
    pub q1_rad: f32,
    /// Velocity at τ = 1, rad/s.
    pub qd1_rad_s: f32,
}

/// Largest values of one joint on one segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes {
    /// Smallest position, rad.
    pub q_min_rad: f32,
    /// Largest position, rad.
    pub q_max_rad: f32,
    /// Largest magnitude of velocity, rad/s.
    pub qd_abs_rad_s: f32,
    /// Largest magnitude of acceleration, rad/s².
    pub qdd_abs_rad_s2: f32,
}

/// q(τ) = c0 + τ (c1 + τ (c2 + τ c3)), rad, over h seconds.
#[derive(Clone, Copy, Debug)]
struct Polynomial {
    h_s: f32,
    c: [f32; 4],
}

impl Polynomial {
    const ZERO: Self = Self { h_s: 0.0, c: [0.0; 4] };

    #[inline]
    fn at(&self, tau: f32) -> Setpoint {
        let [c0, c1, c2, c3] = self.c;
        Setpoint {
            q_rad: c0 + tau * (c1 + tau * (c2 + tau * c3)),
            qd_rad_s: (c1 + tau * (2.0 * c2 + tau * 3.0 * c3)) / self.h_s,
            qdd_rad_s2: (2.0 * c2 + tau * 6.0 * c3) / (self.h_s * self.h_s),
        }
    }
}

/// Polynomial of a joint on the segment of the last evaluation.
#[derive(Clone, Copy, Debug)]
struct Active {
    from_us: u32,
    /// 0: no polynomial is kept.
    span_us: u32,
    polynomial: Polynomial,
}

impl Active {
    const NONE: Self = Self { from_us: 0, span_us: 0, polynomial: Polynomial::ZERO };

    /// Value at a time of the plan; `None` if it is not on this segment.
    #[inline]
    fn at(&self, t_us: i64) -> Option<Setpoint> {
        let into_us = u32::try_from(t_us).ok()?.wrapping_sub(self.from_us);
        // Computed in the same steps as in the check of the segment: microseconds, seconds, share of the duration.
        (into_us < self.span_us).then(|| self.polynomial.at(into_us as f32 * 1e-6 / self.polynomial.h_s))
    }
}

impl Cubic {
    fn polynomial(&self) -> Polynomial {
        let Self { h_s, q0_rad, qd0_rad_s, q1_rad, qd1_rad_s } = *self;
        let delta = q1_rad - q0_rad;
        let (p0, p1) = (h_s * qd0_rad_s, h_s * qd1_rad_s);
        Polynomial { h_s, c: [q0_rad, p0, 3.0 * delta - 2.0 * p0 - p1, p0 + p1 - 2.0 * delta] }
    }

    /// Value at normalised time `tau`; the caller keeps it within 0..=1.
    pub fn at(&self, tau: f32) -> Setpoint {
        self.polynomial().at(tau)
    }

    /// Exact extremes: position at the ends and where the velocity is zero, velocity at the ends and
    /// where the acceleration is zero, acceleration (linear) at the ends.
    pub fn extremes(&self) -> Extremes {
        let Polynomial { c: [_, c1, c2, c3], .. } = self.polynomial();
        let (a, b) = (self.at(0.0), self.at(1.0));
        let mut worst = Extremes {
            q_min_rad: self.q0_rad.min(self.q1_rad),
            q_max_rad: self.q0_rad.max(self.q1_rad),
            qd_abs_rad_s: self.qd0_rad_s.abs().max(self.qd1_rad_s.abs()),
            qdd_abs_rad_s2: a.qdd_rad_s2.abs().max(b.qdd_rad_s2.abs()),
        };
        let mut position_at = |tau: f32| {
            if tau > 0.0 && tau < 1.0 {
                let q_rad = self.at(tau).q_rad;
                worst.q_min_rad = worst.q_min_rad.min(q_rad);
                worst.q_max_rad = worst.q_max_rad.max(q_rad);
            }
        };
        // Zeros of c1 + 2 c2 τ + 3 c3 τ², in the form without cancellation.
        let root = square_root((c2 * c2 - 3.0 * c3 * c1).max(0.0));
        let w = -(c2 + if c2 < 0.0 { -root } else { root });
        if c3 != 0.0 {
            position_at(w / (3.0 * c3));
        }
        if w != 0.0 {
            position_at(c1 / w);
        }
        if c3 != 0.0 {
            let tau = -c2 / (3.0 * c3);
            if tau > 0.0 && tau < 1.0 {
                worst.qd_abs_rad_s = worst.qd_abs_rad_s.max(self.at(tau).qd_rad_s.abs());
            }
        }
        worst
    }
}

/// State of all joints at one time of the plan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knot {
    /// Time since the start of the plan, µs; modulo 2^32 in a segment.
    pub t_us: u32,
    /// Position and velocity per joint, rad and rad/s.
    pub state: PerJoint<(f32, f32)>,
}

/// Knots in ascending time; empty until a plan is loaded.
///
/// Before the first knot the reference stands at the position of that knot, after the last knot at the position of
/// the last. Knots are stored one after the other, each as long as its joints need: they take most of a
/// controller's RAM. They are a ring: while a plan runs, knots that are past make room for those of the next
/// segment.
#[derive(Clone, Debug)]
pub struct Spline {
    /// Per knot: time, then position and velocity of each joint as the bits of their floats.
    words: [u32; WORDS_MAX],
    /// Most knots, by the number of joints.
    knots_max: usize,
    /// Place of the first knot.
    first: usize,
    count: usize,
    /// From the start of the plan to where the times of the knots begin, µs.
    base_us: i64,
    /// Time of the last knot, µs, because each control step needs it.
    knots_us: u32,
    joints: usize,
    /// Knots were forgotten or added while the plan ran.
    is_altered: bool,
    /// Segment of the last search; the next time is usually close.
    cursor: usize,
    active: PerJoint<Active>,
    detour: Detour,
}

/// Time of the first knot from which the times of all knots are counted anew, µs.
const REBASE_US: u32 = 1_000_000_000;

/// Words of one knot.
const fn knot_words(joints: usize) -> usize {
    1 + 2 * joints
}

/// Most knots of a trajectory, by its number of joints.
pub const fn knots_max(joints: usize) -> usize {
    let fit = WORDS_MAX / knot_words(joints);
    if fit < KNOTS_MAX { fit } else { KNOTS_MAX }
}

impl Spline {
    /// A spline without knots.
    pub const fn empty() -> Self {
        // Zeros only, so that it takes no space in the start-up data of a board.
        Self {
            words: [0; WORDS_MAX],
            knots_max: 0,
            first: 0,
            count: 0,
            base_us: 0,
            knots_us: 0,
            joints: 0,
            is_altered: false,
            cursor: 0,
            active: PerJoint::splat(Active::NONE),
            detour: Detour::NONE,
        }
    }

    /// Forgets all knots; the next ones are for this many joints.
    pub fn clear(&mut self, joints: usize) {
        (self.first, self.count, self.base_us, self.knots_us) = (0, 0, 0, 0);
        (self.cursor, self.is_altered) = (0, false);
        (self.joints, self.knots_max) = (joints, knots_max(joints));
        self.follow_knots();
    }

    /// Forgets all new end states: the knots are followed again.
    pub fn follow_knots(&mut self) {
        self.active = PerJoint::splat(Active::NONE);
        self.detour.clear();
    }

    /// Follows the courses from their begin, instead of the present reference.
    pub(crate) fn follow(&mut self, courses: &PerJoint<Course>) {
        self.active = PerJoint::splat(Active::NONE);
        self.detour.take(JointIndex::first(self.joints), courses);
    }

    /// Appends a knot; false (and nothing changed) if there is no room or time does not grow.
    #[must_use]
    pub fn push(&mut self, knot: &Knot) -> bool {
        let grows = self.is_empty() || knot.t_us > self.knots_us;
        if !grows || self.room() == 0 {
            return false;
        }
        let start = self.word_of(self.count);
        let Some((time, states)) =
            self.words.get_mut(start..start + knot_words(self.joints)).and_then(|row| row.split_first_mut())
        else {
            return false;
        };
        *time = knot.t_us;
        for (place, (q_rad, qd_rad_s)) in states.as_chunks_mut::<2>().0.iter_mut().zip(knot.state.0) {
            *place = [q_rad.to_bits(), qd_rad_s.to_bits()];
        }
        self.count += 1;
        self.knots_us = knot.t_us;
        true
    }

    /// Appends a knot to the plan that runs; its time is that of the plan modulo 2^32 µs. False (and nothing
    /// changed) if there is no room or time does not grow.
    #[must_use]
    pub fn extend(&mut self, knot: &Knot) -> bool {
        let is_taken = self.push(&Knot { t_us: self.since_base_us(knot.t_us), ..*knot });
        self.is_altered |= is_taken;
        is_taken
    }

    /// Time of a knot since the base, µs, from its time of the plan modulo 2^32 µs.
    pub const fn since_base_us(&self, t_us: u32) -> u32 {
        t_us.wrapping_sub(self.base_us as u32)
    }

    /// Forgets the knots whose segments end before `t_us` of the plan.
    pub fn forget_before(&mut self, t_us: i64) {
        let Ok(before_us) = u32::try_from(t_us.saturating_sub(self.base_us)) else { return };
        while self.count > 2 && self.t_us(1).is_some_and(|end_us| end_us < before_us) {
            self.first = self.place_of(1);
            self.count -= 1;
            self.cursor = self.cursor.saturating_sub(1);
            self.is_altered = true;
        }
        if let Some(first_us) = self.t_us(0).filter(|first_us| *first_us > REBASE_US) {
            self.rebase(first_us);
        }
    }

    /// Counts the times of the knots anew from the first one, so that they do not overflow.
    #[inline(never)]
    fn rebase(&mut self, first_us: u32) {
        for index in 0..self.count {
            let place = self.word_of(index);
            if let Some(time) = self.words.get_mut(place) {
                *time = time.saturating_sub(first_us);
            }
        }
        self.base_us = self.base_us.saturating_add(first_us.into());
        self.knots_us = self.knots_us.saturating_sub(first_us);
        self.active = PerJoint::splat(Active::NONE);
    }

    /// Knots that can still be appended.
    pub const fn room(&self) -> usize {
        self.knots_max.saturating_sub(self.count)
    }

    /// True if these are not exactly the knots that were loaded.
    pub const fn is_altered(&self) -> bool {
        self.is_altered
    }

    /// Place of a knot in the ring.
    const fn place_of(&self, index: usize) -> usize {
        let place = self.first + index;
        if place < self.knots_max { place } else { place - self.knots_max }
    }

    /// First word of a knot.
    const fn word_of(&self, index: usize) -> usize {
        self.place_of(index) * knot_words(self.joints)
    }

    /// Number of knots.
    pub const fn len(&self) -> usize {
        self.count
    }

    /// True if there are no knots.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Joints described.
    pub const fn joints(&self) -> usize {
        self.joints
    }

    fn row(&self, index: usize) -> Option<(&u32, &[u32])> {
        if index >= self.count {
            return None;
        }
        let start = self.word_of(index);
        self.words.get(start..start + knot_words(self.joints))?.split_first()
    }

    fn t_us(&self, index: usize) -> Option<u32> {
        self.row(index).map(|(time, _)| *time)
    }

    /// Position (rad) and velocity (rad/s) of a joint at a knot.
    fn state(&self, index: usize, joint: JointIndex) -> Option<(f32, f32)> {
        let (_, states) = self.row(index)?;
        let [q, qd] = *states.as_chunks::<2>().0.get(joint.get())?;
        Some((f32::from_bits(q), f32::from_bits(qd)))
    }

    /// Knot `index`, counted from 0; joints that are not described are at zero.
    pub fn knot(&self, index: usize) -> Option<Knot> {
        let (time, states) = self.row(index)?;
        let mut knot = Knot { t_us: *time, ..Knot::default() };
        for (place, [q, qd]) in knot.state.0.iter_mut().zip(states.as_chunks::<2>().0) {
            *place = (f32::from_bits(*q), f32::from_bits(*qd));
        }
        Some(knot)
    }

    /// The last knot.
    pub fn last(&self) -> Option<Knot> {
        self.knot(self.count.checked_sub(1)?)
    }

    /// Time of the plan at the last knot, or at the rest after a new end state, µs.
    pub fn end_us(&self) -> i64 {
        self.base_us.saturating_add(self.detour.end_us().unwrap_or(self.knots_us).into())
    }

    /// Position of a joint at the first knot, rad.
    pub fn start_rad(&self, joint: JointIndex) -> f32 {
        self.state(0, joint).map_or(0.0, |(q_rad, _)| q_rad)
    }

    /// Position of a joint at the last knot, or at rest after a new end state, rad.
    pub fn end_rad(&self, joint: JointIndex) -> f32 {
        self.detour.end_rad(joint).unwrap_or_else(|| self.knots_end_rad(joint))
    }

    fn knots_end_rad(&self, joint: JointIndex) -> f32 {
        self.count.checked_sub(1).and_then(|last| self.state(last, joint)).map_or(0.0, |(q_rad, _)| q_rad)
    }

    /// Cubic of a joint on segment `index`, counted from 0.
    pub fn segment(&self, index: usize, joint: JointIndex) -> Option<Cubic> {
        let h_us = self.t_us(index + 1)?.saturating_sub(self.t_us(index)?);
        let (q0_rad, qd0_rad_s) = self.state(index, joint)?;
        let (q1_rad, qd1_rad_s) = self.state(index + 1, joint)?;
        Some(Cubic { h_s: h_us as f32 * 1e-6, q0_rad, qd0_rad_s, q1_rad, qd1_rad_s })
    }

    /// Reference of a joint at `t_us` since the start of the plan; negative times are before it.
    ///
    /// Takes `&mut self` only to keep the segment of the last evaluation. At a knot the acceleration is that of the
    /// segment that begins there.
    #[inline]
    pub fn at(&mut self, joint: JointIndex, t_us: i64) -> Setpoint {
        let t_us = t_us.saturating_sub(self.base_us);
        match self.active.at(joint).at(t_us) {
            Some(setpoint) => setpoint,
            None => self.at_another(joint, t_us),
        }
    }

    /// [`Self::at`] for a time outside the segment of the last evaluation.
    #[inline(never)]
    fn at_another(&mut self, joint: JointIndex, t_us: i64) -> Setpoint {
        let standing = |q_rad| Setpoint { q_rad, qd_rad_s: 0.0, qdd_rad_s2: 0.0 };
        // In 32 bits from here on: this is the longest way through a control step.
        let Ok(t_us) = u32::try_from(t_us) else {
            return standing(if t_us < 0 { self.start_rad(joint) } else { self.end_rad(joint) });
        };
        let since_us = self.detour.since_us();
        if t_us >= since_us {
            return self.at_detour(joint, t_us);
        }
        if self.t_us(0).is_none_or(|first_us| t_us < first_us) {
            return standing(self.start_rad(joint));
        }
        if t_us >= self.knots_us {
            return standing(self.knots_end_rad(joint));
        }
        self.seek(t_us);
        let ends = (self.t_us(self.cursor), self.t_us(self.cursor + 1));
        let ((Some(from_us), Some(to_us)), Some(cubic)) = (ends, self.segment(self.cursor, joint)) else {
            return Setpoint::default();
        };
        let active = Active {
            from_us,
            span_us: to_us.min(since_us).saturating_sub(from_us),
            polynomial: cubic.polynomial(),
        };
        self.active.set(joint, active);
        active.at(t_us.into()).unwrap_or_default()
    }

    /// [`Self::at`] on the way to a new end state.
    fn at_detour(&mut self, joint: JointIndex, t_us: u32) -> Setpoint {
        let (piece, span_us) = self.detour.piece(joint, t_us);
        let polynomial =
            Polynomial { h_s: 1.0, c: [piece.q_rad, piece.qd_rad_s, 0.5 * piece.qdd_rad_s2, 0.0] };
        let active = Active { from_us: piece.t_us, span_us, polynomial };
        self.active.set(joint, active);
        // A time before the oldest piece that is kept: that piece continued backwards.
        let before_us = piece.t_us.saturating_sub(t_us);
        active.at(t_us.into()).unwrap_or_else(|| polynomial.at(before_us as f32 * -1e-6))
    }

    /// Moves the cursor to the segment that holds `t_us`; at most [`KNOTS_MAX`] steps each way.
    fn seek(&mut self, t_us: u32) {
        let starts_at = |index: usize| self.t_us(index);
        let mut cursor = self.cursor;
        for _ in 0..KNOTS_MAX {
            match (starts_at(cursor), starts_at(cursor + 1)) {
                (Some(from), _) if t_us < from && cursor > 0 => cursor -= 1,
                (_, Some(to)) if t_us >= to => cursor += 1,
                (None, _) if cursor > 0 => cursor -= 1,
                _ => break,
            }
        }
        self.cursor = cursor;
    }
}

#[cfg(test)]
mod tests;
