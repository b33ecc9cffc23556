//! A change to a new end state in flight: the law, its check, and the pieces of the motion (pure).
//!
//! # The law
//!
//! A joint goes from (q₀, q̇₀) to (q₁, q̇₁) in exactly the time T and brakes to rest afterwards. Of all motions
//! that take this time, the one with the least peak acceleration has two pieces of constant acceleration, +a and
//! -a. With D = q₁ - q₀ - (q̇₀ + q̇₁) T / 2 and E = q̇₁ - q̇₀:
//!
//! ```text
//! a = (2 D + sgn(D) √(4 D² + T² E²)) / T²      switch at (T + E/a) / 2, with the speed (q̇₀ + q̇₁ + a T) / 2
//! ```
//!
//! A speed at the switch beyond the envelope is replaced by a piece at the highest speed q̇ᵥ, with
//! a = ((q̇ᵥ - q̇₀)² + (q̇ᵥ - q̇₁)²) / (2 |q̇ᵥ T - (q₁ - q₀)|) before and after it. After q₁ the joint brakes with the acceleration
//! of the envelope. Position and velocity are continuous; the acceleration steps, as it does at the ends of a plan.
//!
//! # Arithmetic
//!
//! Switch times are rounded to microseconds, and the speed between them is then computed again, so that both ends are met
//! exactly. No piece is shorter than [`PIECE_MIN_US`]; that raises the peak by at most 2 [`PIECE_MIN_US`] / T.
//! Positions are rounded to 0.24 µrad, which makes the acceleration of a piece of length h uncertain by 2 µrad / (T h): 0.02
//! rad/s² for 1 ms of 100 ms. The check takes the pieces as they are.
//!
//! # The check
//!
//! [`Course::check`] compares the exact extremes of position, speed and acceleration of all pieces, braking
//! included, with the envelope. [`crate::envelope`] limits how wide an envelope may be.

use protocol::JointIndex;

use crate::joints::PerJoint;
use crate::root::square_root;

/// Shortest time from the first open instant to the new end state, µs.
pub const REACH_MIN_US: u32 = 20_000;
/// Longest time to the new end state, µs: single precision is exact to a microsecond up to here.
pub const REACH_MAX_US: u32 = 10_000_000;
/// Shortest piece, µs.
pub const PIECE_MIN_US: u32 = 500;
/// Factor on a limit that allows for rounding to single precision.
const ROUNDING: f32 = 1.001;
/// Pieces of a course.
const COURSE: usize = 5;
/// Older pieces that are kept: measurements are compared with the motion in force before the newest course begins.
const HISTORY: usize = 4;

/// Limits of a joint for new end states and for the ways to them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointEnvelope {
    /// Smallest position, rad.
    pub q_min_rad: f32,
    /// Largest position, rad.
    pub q_max_rad: f32,
    /// Highest speed, rad/s.
    pub v_max_rad_s: f32,
    /// Highest acceleration, rad/s².
    pub a_max_rad_s2: f32,
}

/// Why a new end state is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutOfReach {
    /// A number is not finite, or the times are not [`REACH_MIN_US`] to [`REACH_MAX_US`] apart.
    Numbers,
    /// The way, or the braking after it, leaves the positions of the envelope.
    Position,
    /// It needs more speed than the envelope has.
    Velocity,
    /// It needs more acceleration than the envelope has.
    Acceleration,
}

/// Position and velocity of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EndState {
    /// Position, rad.
    pub q_rad: f32,
    /// Velocity, rad/s.
    pub qd_rad_s: f32,
}

/// Constant acceleration from a time on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Piece {
    /// Begin, µs of the plan.
    pub t_us: u32,
    /// Position at the begin, rad.
    pub q_rad: f32,
    /// Velocity at the begin, rad/s.
    pub qd_rad_s: f32,
    /// Acceleration, rad/s².
    pub qdd_rad_s2: f32,
}

/// The way of one joint to a new end state, braking and rest: five pieces, of which some may be empty.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Course {
    pieces: [Piece; COURSE],
}

const fn seconds(us: u32) -> f32 {
    us as f32 * 1e-6
}

fn microseconds(s: f32) -> u32 {
    // The cast saturates, and turns NaN into zero.
    (s * 1e6 + 0.5) as u32
}

impl Course {
    /// The course from `start` at `from_us` to `end` at `to_us`, both µs of the plan, [`REACH_MIN_US`] to [`REACH_MAX_US`]
    /// apart.
    ///
    /// # Errors
    ///
    /// [`OutOfReach::Numbers`]; [`OutOfReach::Velocity`] if no motion within the speed of the envelope arrives in time.
    pub fn solve(
        (from_us, start): (u32, EndState),
        (to_us, end): (u32, EndState),
        envelope: &JointEnvelope,
    ) -> Result<Self, OutOfReach> {
        let total_us = to_us.saturating_sub(from_us);
        let (v0, v1) = (start.qd_rad_s, end.qd_rad_s);
        let is_finite = [start.q_rad, v0, end.q_rad, v1].iter().all(|number| number.is_finite());
        if !is_finite || !(REACH_MIN_US..=REACH_MAX_US).contains(&total_us) {
            return Err(OutOfReach::Numbers);
        }
        let (v_max, t) = (envelope.v_max_rad_s, seconds(total_us));
        if v1.abs() > ROUNDING * v_max {
            return Err(OutOfReach::Velocity);
        }
        let way = end.q_rad - start.q_rad;
        let (excess, change) = (way - 0.5 * (v0 + v1) * t, v1 - v0);
        let root = square_root(4.0 * excess * excess + t * t * change * change);
        let a = (2.0 * excess + root.copysign(excess)) / (t * t);
        let v_switch = 0.5 * (v0 + v1 + a * t);
        let (t1, t2) = if v_switch.abs() <= v_max {
            let switch = if a == 0.0 { 0.5 * t } else { 0.5 * (t + change / a) };
            (switch, switch)
        } else {
            let v = v_max.copysign(v_switch);
            let (before, after, room) = (v - v0, v - v1, v * t - way);
            let a = (before * before + after * after) / (2.0 * room.abs());
            // False for NaN.
            let fits = room * v > 0.0 && a > 0.0;
            if !fits {
                return Err(OutOfReach::Velocity);
            }
            (before.abs() / a, t - after.abs() / a)
        };
        let t1_us = microseconds(t1).max(PIECE_MIN_US).min(total_us - PIECE_MIN_US);
        let t2_us = microseconds(t2).max(t1_us).min(total_us - PIECE_MIN_US);
        let (h1, h2, h3) = (seconds(t1_us), seconds(t2_us - t1_us), seconds(total_us - t2_us));
        let v = (way - 0.5 * (v0 * h1 + v1 * h3)) / (0.5 * (h1 + h3) + h2);
        let brake_us = (v1.abs() / envelope.a_max_rad_s2 * 1e6) as u32;
        let brake_us = brake_us.saturating_add(1);
        let h4 = seconds(brake_us);
        let piece = |after_us: u32, q_rad: f32, qd_rad_s: f32, qdd_rad_s2: f32| Piece {
            t_us: from_us.saturating_add(after_us),
            q_rad,
            qd_rad_s,
            qdd_rad_s2,
        };
        Ok(Self {
            pieces: [
                piece(0, start.q_rad, v0, (v - v0) / h1),
                piece(t1_us, start.q_rad + 0.5 * (v0 + v) * h1, v, 0.0),
                piece(t2_us, end.q_rad - 0.5 * (v + v1) * h3, v, (v1 - v) / h3),
                piece(total_us, end.q_rad, v1, -v1 / h4),
                piece(total_us.saturating_add(brake_us), end.q_rad + 0.5 * v1 * h4, 0.0, 0.0),
            ],
        })
    }

    /// Checks the exact extremes of all pieces against the envelope.
    ///
    /// # Errors
    ///
    /// The first limit that is exceeded.
    pub fn check(&self, envelope: &JointEnvelope) -> Result<(), OutOfReach> {
        let inside = |q_rad: f32| q_rad >= envelope.q_min_rad && q_rad <= envelope.q_max_rad;
        for (piece, next) in self.pieces.iter().zip(self.pieces.iter().skip(1)) {
            let (v, v_next, a) = (piece.qd_rad_s, next.qd_rad_s, piece.qdd_rad_s2);
            let turns = v * v_next < 0.0;
            let turn_rad = if turns { piece.q_rad - 0.5 * v * v / a } else { next.q_rad };
            if !(inside(piece.q_rad) && inside(turn_rad)) {
                return Err(OutOfReach::Position);
            }
            // The speed of the first piece is that of the old motion.
            let slow_enough = v_next.abs() <= ROUNDING * envelope.v_max_rad_s;
            if !slow_enough {
                return Err(OutOfReach::Velocity);
            }
            let gentle_enough = a.abs() <= ROUNDING * envelope.a_max_rad_s2;
            if !gentle_enough {
                return Err(OutOfReach::Acceleration);
            }
        }
        let [.., rest] = self.pieces;
        if inside(rest.q_rad) { Ok(()) } else { Err(OutOfReach::Position) }
    }

    /// The pieces in ascending time; a piece lasts until the next one, the last one is rest.
    pub const fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// When the joint rests, µs of the plan.
    pub const fn end_us(&self) -> u32 {
        let [.., rest] = self.pieces;
        rest.t_us
    }
}

/// Replacement of a plan from a time on: the newest course of each joint, and the earlier pieces that may still be
/// needed.
#[derive(Clone, Debug)]
pub struct Detour {
    /// Begin of the first course, µs of the plan, with all bits inverted: 0 stands for a time that never comes. Before it the
    /// plan itself is followed.
    since_inverted_us: u32,
    /// End of the newest course; 0: there is no course.
    end_us: u32,
    joint: PerJoint<heapless::Vec<Piece, { HISTORY + COURSE }>>,
}

impl Detour {
    /// No course: the plan is followed. All zeros, so that it takes no space in the start-up data of a board.
    pub const NONE: Self = Self {
        since_inverted_us: 0,
        end_us: 0,
        joint: PerJoint([const { heapless::Vec::new() }; protocol::JOINTS_MAX]),
    };

    /// Time from which the plan is no longer followed, µs of the plan; `u32::MAX` if it is followed to its end.
    #[inline]
    pub const fn since_us(&self) -> u32 {
        !self.since_inverted_us
    }

    /// End of the newest course, µs of the plan.
    pub const fn end_us(&self) -> Option<u32> {
        if self.end_us == 0 { None } else { Some(self.end_us) }
    }

    /// Where a joint comes to rest, rad.
    pub fn end_rad(&self, joint: JointIndex) -> Option<f32> {
        self.joint.at(joint).last().map(|rest| rest.q_rad)
    }

    /// Forgets all courses.
    pub fn clear(&mut self) {
        (self.since_inverted_us, self.end_us) = (0, 0);
        for pieces in &mut self.joint.0 {
            pieces.clear();
        }
    }

    /// Takes over a course for each of the joints, from its begin on.
    pub(crate) fn take(&mut self, joints: impl Iterator<Item = JointIndex>, courses: &PerJoint<Course>) {
        let (is_first, mut end_us) = (self.end_us == 0, 0);
        for joint in joints {
            let course = courses.at(joint);
            let pieces = self.joint.at_mut(joint);
            let [first, ..] = course.pieces;
            if is_first {
                self.since_inverted_us = !first.t_us;
            }
            while pieces.last().is_some_and(|last| last.t_us >= first.t_us) {
                pieces.pop();
            }
            while pieces.len() > HISTORY {
                pieces.remove(0);
            }
            // There is room: the history was cut to its length.
            let _ = pieces.extend_from_slice(&course.pieces);
            end_us = end_us.max(course.end_us());
        }
        self.end_us = end_us;
    }

    /// The piece of a joint at a time of the plan, and how long it lasts, µs; for a time before the oldest piece that is kept,
    /// that piece.
    pub(crate) fn piece(&self, joint: JointIndex, t_us: u32) -> (Piece, u32) {
        let pieces = self.joint.at(joint);
        let mut found = (pieces.first().copied().unwrap_or_default(), 0);
        for (index, piece) in pieces.iter().enumerate() {
            if index == 0 || piece.t_us <= t_us {
                let ends = pieces.get(index + 1).map_or(u32::MAX, |next| next.t_us);
                found = (*piece, ends.saturating_sub(piece.t_us));
            }
        }
        found
    }
}
