//! Collision of a whole motion, also between the samples.
//!
//! Sampling a motion finely can miss a thin box. Here an interval of the motion is *proven* free: the distance of a
//! pair in the middle of the interval must exceed what the two bodies can have moved towards each other until its
//! ends. That bound follows from the joint travel and from how far a link can be from each joint axis. Pairs
//! that are proven are dropped, the interval is halved for the rest (Schwarzer, Saha, Latombe, "Adaptive dynamic
//! collision checking for single and multiple articulated robots in complex environments", 2005).

use super::checker::{Body, Clearance, CollisionChecker, Pair};
use crate::per_joint::JointVec;

/// A motion in the form that the collision checker needs.
///
/// `s` is any parameter (usually the time in s). If joints move monotonically over an interval, as in the
/// two-segment cubics of the throwing paper, [`Travel::path_length`] is the difference of the ends.
pub trait Travel {
    /// Configuration at `s`.
    fn at(&self, s: f64) -> JointVec;

    /// Upper bound of the way each joint goes between `s0` and `s1 ≥ s0`, in rad.
    fn path_length(&self, s0: f64, s1: f64) -> JointVec;
}

/// A straight line in joint space: `from` at s = 0, `to` at s = 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StraightMove {
    /// Configuration at s = 0, in rad.
    pub from: JointVec,
    /// Configuration at s = 1, in rad.
    pub to: JointVec,
}

impl Travel for StraightMove {
    fn at(&self, s: f64) -> JointVec {
        self.from + (self.to - self.from) * s
    }

    fn path_length(&self, s0: f64, s1: f64) -> JointVec {
        (self.to - self.from).abs() * (s1 - s0)
    }
}

/// Outcome of checking a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionVerdict {
    /// Proven free over the whole interval.
    Free {
        /// Number of configurations that were evaluated.
        evaluations: usize,
    },
    /// Two bodies overlap, touch, or come nearer than the tolerance.
    Contact {
        /// Where on the motion this happens first, to within the way that the tolerance stands for.
        s: f64,
        /// The bodies and their distance there.
        clearance: Clearance,
    },
}

impl MotionVerdict {
    /// Whether the motion was proven free.
    #[must_use]
    pub fn is_free(&self) -> bool {
        matches!(self, Self::Free { .. })
    }
}

/// Intervals deeper than this (a 2⁻³² part of the motion) count as contacts; reached only if the travel bound does
/// not shrink with the interval.
const DEPTH_MAX: u32 = 32;

struct Interval {
    s0: f64,
    s1: f64,
    depth: u32,
    /// Start of this interval's pairs in the shared list.
    pairs_from: usize,
}

impl CollisionChecker<'_> {
    /// Checks the motion from `s0` to `s1`: everything that [`CollisionChecker::collides`] tests, at every instant.
    ///
    /// Intervals in which bodies move towards each other by less than `tolerance_m` but which are not proven free
    /// count as contact; 0.1 mm is a good tolerance. If a motion is not finite somewhere, it has a contact there.
    pub fn check_motion(
        &mut self,
        motion: &impl Travel,
        s0: f64,
        s1: f64,
        tolerance_m: f64,
    ) -> MotionVerdict {
        // Pairs of all pending intervals, one slice after the other; intervals are handled last in, first out.
        let mut open: Vec<Pair> = self.pairs.clone();
        let mut intervals = vec![Interval { s0, s1, depth: 0, pairs_from: 0 }];
        let mut evaluations = 0;
        let mut earliest = None;
        let mut todo = Vec::new();
        let mut unproven = Vec::new();
        while let Some(Interval { s0, s1, depth, pairs_from }) = intervals.pop() {
            let s = 0.5 * (s0 + s1);
            let before = motion.path_length(s0, s);
            let after = motion.path_length(s, s1);
            let travel = before.zip_map(&after, f64::max);
            let frames = self.model.fk(&motion.at(s));
            self.place(&frames);
            evaluations += 1;
            todo.clear();
            todo.extend(open.drain(pairs_from..));
            unproven.clear();
            let mut contact = false;
            for pair in &todo {
                let approach_m = self.approach(pair, &travel);
                if self.sphere_gap(pair) > approach_m + self.keeps_m {
                    continue;
                }
                let separation_m = self.separation(pair) - self.keeps_m;
                if separation_m > approach_m {
                    continue;
                }
                // A distance that is not a number must not pass for a free one.
                let apart = separation_m > 0.0;
                let fine = approach_m <= tolerance_m || depth == DEPTH_MAX;
                if !apart || fine {
                    let distance_m = self.proximity(pair).distance_m;
                    let clearance = Clearance { distance_m, a: pair.a, b: pair.b };
                    earliest = Some(MotionVerdict::Contact { s, clearance });
                    // Only what is before this contact still matters.
                    intervals.clear();
                    open.clear();
                    contact = true;
                }
                if !fine {
                    unproven.push(*pair);
                }
            }
            if !unproven.is_empty() {
                // Earlier half last onto the stack: it is handled first.
                for (s0, s1) in [(s, s1), (s0, s)].into_iter().skip(usize::from(contact)) {
                    intervals.push(Interval { s0, s1, depth: depth + 1, pairs_from: open.len() });
                    open.extend_from_slice(&unproven);
                }
            }
        }
        earliest.unwrap_or(MotionVerdict::Free { evaluations })
    }

    /// How far a pair can have approached after the joints have travelled this much.
    fn approach(&self, pair: &Pair, travel: &JointVec) -> f64 {
        let (from, to) = (pair.link_a.min(pair.link_b), pair.link_a.max(pair.link_b));
        if pair.b == Body::Ball {
            let collision = self.model.collision();
            (from..to).map(|k| collision.ball_swing_m(k) * travel[k]).sum()
        } else {
            self.swept(to, from, travel)
        }
    }

    /// Longest way of a point of link `to` seen from link `from`: only the joints between them count.
    fn swept(&self, to: usize, from: usize, travel: &JointVec) -> f64 {
        let collision = self.model.collision();
        (from..to).map(|k| collision.swing_m(k, to) * travel[k]).sum()
    }
}
