//! What a drive should do with its commands, and how far its answers are from it (pure).
//!
//! # Model
//!
//! A drive has a ramp generator (speed V, acceleration A, target) and a position loop behind it. The position follows
//! the generator by a lag of 2ζ/ω: a first-order lag of the same time differs from the real loop by less than
//! 1e-5 s² of the acceleration, 0.2 mrad. A drive takes over a command at the moment at which it measures the position that
//! it answers with, so one time serves for both. The model takes V and A from acknowledged writes and the target from answered
//! motions; it never sees the law, so a law that is misled by a wrong position does not mislead the model.
//!
//! # Residual
//!
//! ```text
//! r  = q_measured - q_model                              position residual, rad
//! q_generator += 2κ r,  v_generator += κ² r / dt         κ = dt / 0.1 s: a slow observer; r limited to its bound
//! d' = κ² r / dt - d / 0.3 s                             speed residual, rad/s: recent corrections of the observer
//! ```
//!
//! The observer removes errors that accumulate: a command begins some tenths of a millisecond earlier or later than its answer
//! says, which leaves a speed error of that time times the change of acceleration.
//!
//! # Gate
//!
//! ```text
//! |r| <= R0 + |v| T_J + loose · 0.05 s       in two answers in a row; otherwise the group stops
//! |d| <= D0 + loose                          in each answer
//! |m| <= R0 + |v| T_J + loose · 0.05 s + L   in each answer; m: way by commands since the answer last changed; only half of
//!                                            R0 while |v| < D0; L: way since then of a speed of `loose` at its
//!                                            beginning, a step of the encoder, and what late answers make it wrong
//! ```
//!
//! `loose` is the uncertainty of the speed after an unanswered motion command: the drive may or may not have taken it. Its size
//! is the difference of the two accelerations times the time until the next answer, and it decays as `d` does. An answer later
//! than the bus load explains is ignored: its time of measurement is unknown, and with the time of reception a healthy joint
//! would first seem slower, then faster than commanded.
//!
//! # What follows from the gate
//!
//! A drive whose answers stand still, run backwards or ignore the commands is found at the second answer after its model has
//! moved by `R0 + |v| T_J`, two cycles. [`excursion_max_rad`] bounds how far the joint moves from the moment its answers
//! stand still until it is at rest. A deviation that grows more slowly than `D0` is not found here. If the positions are true,
//! the control law corrects it; if they are false, one encoder cannot tell. Nor can it tell a drive that froze at an unanswered
//! motion from one that stands, until commands have changed the speed by more than `loose`.

use protocol::Instant;

use crate::fault::Cause;
use crate::groups::powercube::generator::after;
use crate::groups::powercube::ramp::RampState;
use crate::joints::{at_least, at_most, clamp};
use crate::root::square_root;
use crate::span;

/// Largest position residual of a drive at rest, rad: eight and a half steps of the encoder (0.35 mrad). Healthy drives of 200
/// perturbed arms use a quarter of the gate (`tests/suites/controller/residual.rs`); the rest is for drives whose position
/// loop is not the one in the settings: one without lag reaches three quarters.
pub const R0_RAD: f32 = 3e-3;
/// Uncertainty of the time of an answer, s: it waits for the bus up to five answers of other drives and a frame of Cyphal.
pub const T_JITTER_S: f32 = 0.8e-3;
/// Largest speed residual, rad/s.
pub const D0_RAD_S: f32 = 0.06;
/// Speed that one step of the encoder (0.35 mrad) leaves in the observer at most, rad/s: step / (e · 0.1 s), a tenth more.
const STEP_RAD_S: f32 = 1.4e-3;
/// Late answers make the speed wrong by as many times the root of the sum of their squares at most.
const TIMING_SIGMAS: f32 = 2.0;
/// Position residuals above the bound in a row that stop the group: one may be an answer that was mixed up on the bus.
pub const OVER_ROW: u8 = 2;

/// Time constant of the observer, s.
const OBSERVER_S: f32 = 0.1;
/// Time over which the speed residual is looked at, s.
const DRIFT_S: f32 = 0.3;

/// A drive as its commands should have left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DriveModel {
    /// Generator at `at`.
    generator: RampState,
    target_rad: f32,
    v_ramp_rad_s: f32,
    a_ramp_rad_s2: f32,
    at: Instant,
    /// How far the position is behind the generator, rad.
    behind_rad: f32,
    r_rad: f32,
    drift_rad_s: f32,
    /// Acceleration by which the two possible motions differ after a motion without an answer, rad/s².
    doubt_rad_s2: f32,
    loose_rad_s: f32,
    /// Measured position when the residual was last small, and how far the model has moved since, rad.
    calm_rad: f32,
    moved_rad: f32,
    /// Last answer, and how far commands alone have moved the model while the answers were this one, rad.
    answer_rad: f32,
    still_rad: f32,
    /// Generator since the answer last changed, by commands alone; its position then, and how far the position was behind it.
    alone: RampState,
    alone_from_rad: f32,
    behind_from_rad: f32,
    /// Sum of the squares of what late answers make the speed wrong, rad²/s²: each on its own, so they seldom add up.
    timing_rad2_s2: f32,
    /// How wrong the speed of `alone` may be: a step of the encoder and a motion that was taken or not, rad/s; late answers,
    /// rad²/s²; and the way by now, rad.
    alone_loose_rad_s: f32,
    alone_timing_rad2_s2: f32,
    alone_loose_rad: f32,
    /// The first residual above the bound came in one step of this size, rad.
    step_rad: f32,
    over: u8,
    /// Answers are compared.
    watching: bool,
}

impl DriveModel {
    /// A drive that stands at the measured position.
    pub fn at_rest(at: Instant, q_rad: f32) -> Self {
        Self {
            generator: RampState { q_rad, v_rad_s: 0.0 },
            target_rad: q_rad,
            at,
            calm_rad: q_rad,
            answer_rad: q_rad,
            alone: RampState { q_rad, v_rad_s: 0.0 },
            alone_from_rad: q_rad,
            alone_loose_rad_s: STEP_RAD_S,
            watching: true,
            ..Self::default()
        }
    }

    /// The drive got a command that is not modelled (a halt), or it was found wrong: no answer is compared until the next
    /// [`Self::at_rest`].
    pub const fn stop_watching(&mut self) {
        self.watching = false;
    }

    /// Last position residual, rad.
    pub const fn r_rad(&self) -> f32 {
        self.r_rad
    }

    /// Last speed residual, rad/s.
    pub const fn drift_rad_s(&self) -> f32 {
        self.drift_rad_s
    }

    /// Largest position residual of a healthy drive at present, rad.
    pub fn r_max_rad(&self) -> f32 {
        R0_RAD + self.generator.v_rad_s.abs() * T_JITTER_S + 0.5 * OBSERVER_S * self.loose_rad_s
    }

    /// Largest speed residual of a healthy drive at present, rad/s.
    pub const fn drift_max_rad_s(&self) -> f32 {
        D0_RAD_S + self.loose_rad_s
    }

    /// Way of the model by commands alone since the answer last changed, rad.
    pub const fn still_rad(&self) -> f32 {
        self.still_rad
    }

    /// Largest [`Self::still_rad`] of a healthy drive. The observer follows answers that stand still, so a slow command never makes
    /// a large residual, but what the command amounts to is not corrected. At low speed half of
    /// [`R0_RAD`] is four encoder steps, and an answer that comes twice is far less. What is not known of the motion stays whole,
    /// and nothing corrects the speed that was not known when the answers began to stand still.
    pub fn still_max_rad(&self) -> f32 {
        let slow_command = self.generator.v_rad_s.abs() < D0_RAD_S;
        let known_rad = if slow_command { self.r_max_rad() - 0.5 * R0_RAD } else { self.r_max_rad() };
        known_rad + self.alone_loose_rad
    }

    /// The generator at a time after the last answer.
    pub fn generator_at(&self, t: Instant) -> RampState {
        self.ramp(self.generator, span::seconds(t.saturating_since(self.at)))
    }

    /// What the last command makes of a generator.
    fn ramp(&self, from: RampState, dt_s: f32) -> RampState {
        after(from, self.target_rad, self.v_ramp_rad_s, self.a_ramp_rad_s2, dt_s)
    }

    /// The drive has answered a motion: this is what it does from the last compared answer on. The answer came `late_s` later than usual, so
    /// the motion may have begun so much earlier.
    pub fn command(&mut self, target_rad: f32, v_ramp_rad_s: f32, a_ramp_rad_s2: f32, late_s: f32) {
        let before_rad_s2 = self.acceleration_rad_s2();
        (self.target_rad, self.v_ramp_rad_s, self.a_ramp_rad_s2) = (target_rad, v_ramp_rad_s, a_ramp_rad_s2);
        let wrong_rad_s = (self.acceleration_rad_s2() - before_rad_s2) * late_s;
        self.timing_rad2_s2 += wrong_rad_s * wrong_rad_s;
        self.alone_timing_rad2_s2 += wrong_rad_s * wrong_rad_s;
        self.doubt_rad_s2 = 0.0;
    }

    /// Acceleration towards the target, rad/s².
    fn acceleration_rad_s2(&self) -> f32 {
        libm::copysignf(self.a_ramp_rad_s2, self.target_rad - self.generator.q_rad)
    }

    /// A motion was not answered: the drive may have taken it or not.
    pub fn doubt(&mut self, a_rad_s2: f32) {
        self.doubt_rad_s2 = at_least(self.a_ramp_rad_s2 + a_rad_s2.abs(), self.doubt_rad_s2);
    }

    /// Compares an answer with the model: the cause, if the drive does not do what it should.
    pub fn compare(&mut self, at: Instant, q_rad: f32, lag_s: f32) -> Option<Cause> {
        if !self.watching {
            return None;
        }
        let dt_s = span::seconds(at.saturating_since(self.at));
        let moved_rad = self.advance(at, dt_s, lag_s);
        let r_before = self.r_rad;
        self.r_rad = q_rad - (self.generator.q_rad - self.behind_rad);
        self.correct(dt_s);

        let r_max_rad = self.r_max_rad();
        // Each comparison is false for NaN, so NaN is a fault.
        let near = self.r_rad.abs() <= r_max_rad;
        let slow = self.drift_rad_s.abs() <= self.drift_max_rad_s();
        if self.r_rad.abs() <= 0.25 * r_max_rad {
            (self.calm_rad, self.moved_rad) = (q_rad, 0.0);
        } else {
            self.moved_rad += moved_rad;
        }
        if q_rad != self.answer_rad {
            (self.answer_rad, self.alone, self.alone_from_rad) =
                (q_rad, self.generator, self.generator.q_rad);
            self.behind_from_rad = self.behind_rad;
            (self.alone_loose_rad_s, self.alone_loose_rad) = (STEP_RAD_S + self.loose_rad_s, 0.0);
            self.alone_timing_rad2_s2 = self.timing_rad2_s2;
        }
        self.still_rad = (self.alone.q_rad - self.alone_from_rad) - (self.behind_rad - self.behind_from_rad);
        if near {
            self.over = 0;
        } else {
            if self.over == 0 {
                self.step_rad = self.r_rad - r_before;
            }
            self.over = self.over.saturating_add(1);
        }
        let answers_move = self.still_rad.abs() <= self.still_max_rad();
        if self.over < OVER_ROW && slow && answers_move {
            return None;
        }
        let stepped = self.over > 0
            && self.step_rad.abs() > 0.7 * r_max_rad
            && (self.r_rad - r_before).abs() < 0.5 * self.step_rad.abs();
        self.watching = false;
        Some(self.name(q_rad, r_max_rad, stepped))
    }

    fn name(&self, q_rad: f32, r_max_rad: f32, stepped: bool) -> Cause {
        let (measured_rad, modelled_rad) = (q_rad - self.calm_rad, self.moved_rad);
        let modelled = modelled_rad.abs() > 0.5 * r_max_rad;
        if self.still_rad.abs() > 0.25 * r_max_rad {
            Cause::PositionFrozen
        } else if stepped {
            Cause::PositionJumped
        } else if !modelled && self.generator.v_rad_s.abs() < D0_RAD_S {
            Cause::MovesUnordered
        } else if measured_rad * modelled_rad < 0.0 {
            Cause::MotionReversed
        } else {
            Cause::MotionNotFollowed
        }
    }

    /// Lets the time up to an answer pass; returns how far the position has moved.
    fn advance(&mut self, at: Instant, dt_s: f32, lag_s: f32) -> f32 {
        let before = self.generator;
        self.generator = self.generator_at(at);
        self.at = at;
        self.alone = self.ramp(self.alone, dt_s);
        let behind_before = self.behind_rad;
        if lag_s > 0.0 && dt_s > 0.0 {
            let (v0, v1) = (before.v_rad_s, self.generator.v_rad_s);
            let bend = lag_s * lag_s * (v1 - v0) / dt_s;
            let x = dt_s / lag_s;
            // e^-x, good to 7 % of it at one period of 17 ms, better below.
            let left = 1.0 / (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))));
            self.behind_rad = lag_s * v1 - bend + (behind_before - lag_s * v0 + bend) * left;
        }
        let more_rad_s = self.doubt_rad_s2 * dt_s;
        self.loose_rad_s += more_rad_s;
        self.alone_loose_rad_s += more_rad_s;
        let timing_rad_s = TIMING_SIGMAS * square_root(self.alone_timing_rad2_s2);
        self.alone_loose_rad += (self.alone_loose_rad_s + timing_rad_s) * dt_s;
        self.generator.q_rad - before.q_rad - self.behind_rad + behind_before
    }

    fn correct(&mut self, dt_s: f32) {
        let k = at_most(dt_s / OBSERVER_S, 0.5);
        // One answer that was mixed up on the bus does not lead the model away.
        let r_max_rad = self.r_max_rad();
        let r_rad = clamp(self.r_rad, -r_max_rad, r_max_rad);
        let dv_rad_s = k * k * r_rad / at_least(dt_s, 1e-4);
        self.generator.q_rad += 2.0 * k * r_rad;
        self.generator.v_rad_s += dv_rad_s;
        let fade = 1.0 - at_most(dt_s / DRIFT_S, 1.0);
        self.drift_rad_s = self.drift_rad_s * fade + dv_rad_s;
        // As slowly as what it explains.
        self.loose_rad_s *= fade;
        self.timing_rad2_s2 *= fade * fade;
    }
}

/// How far a joint moves from the moment its answers stand still until it rests, at most, rad.
///
/// The joint has the speed `v_rad_s` then, and the worst command accelerates it with `a_max` until the gate has seen
/// enough. Way until the gate acts: its bound, a half more for what the observer takes out meanwhile, two answers and one
/// more period until all drives have their stop. Then a ramp to rest with `a_max`.
pub fn excursion_max_rad(v_rad_s: f32, v_max_rad_s: f32, a_max_rad_s2: f32, period_s: f32) -> f32 {
    let wait_s = (f32::from(OVER_ROW) + 1.0) * period_s;
    // Speed after a way w from v with a: sqrt(v² + 2 a w).
    let way_rad = 1.5 * (R0_RAD + v_max_rad_s * T_JITTER_S);
    let v_gate = at_most(libm::sqrtf(v_rad_s * v_rad_s + 2.0 * a_max_rad_s2 * way_rad), v_max_rad_s);
    let v_stop = at_most(v_gate + a_max_rad_s2 * wait_s, v_max_rad_s);
    way_rad + v_stop * wait_s + 0.5 * v_stop * v_stop / a_max_rad_s2
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Duration;

    /// A joint on a ramp of 2 rad/s2 to 1 rad/s, answers every 3 ms; the reported position is what `report` makes of the
    /// true one. The time at which the model objects, and how.
    fn watched(report: impl Fn(f32, f32) -> f32) -> Option<(u64, Cause)> {
        let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
        model.command(3.0, 1.0, 2.0, 0.0);
        let start = RampState { q_rad: 0.0, v_rad_s: 0.0 };
        for k in 1..300u64 {
            let t = k as f32 * 0.003;
            // The loop's lag after its transient.
            let truth = after(start, 3.0, 1.0, 2.0, (t - 0.005).max(0.0)).q_rad;
            let step = 0.02f32.to_radians();
            let reported = (report(t, truth) / step).round() * step;
            if let Some(cause) = model.compare(Instant::from_micros(3_000 * k), reported, 0.005) {
                return Some((3 * k, cause));
            }
        }
        None
    }

    /// Against the differential equation `lag dy/dt = u - y` in small steps, with u on a ramp of 2 rad/s2.
    #[test]
    fn position_is_behind_the_generator_like_the_output_of_a_first_order_lag() {
        for dt_s in [1e-3f32, 3e-3] {
            let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
            model.command(3.0, 1.0, 2.0, 0.0);
            let (mut y, mut moved_rad) = (0.0f64, 0.0f32);
            for k in 1..=300 {
                let t = dt_s * k as f32;
                moved_rad += model.advance(Instant::from_micros((t * 1e6).round() as u64), dt_s, 5e-3);
                for i in 0..1_000 {
                    let s = f64::from(dt_s) * (f64::from(k - 1) + (f64::from(i) + 0.5) / 1_000.0);
                    let u = if s < 0.5 { s * s } else { 0.25 + (s - 0.5) };
                    y += (u - y) / 5e-3 * f64::from(dt_s) / 1_000.0;
                }
                let behind_rad = f64::from(model.generator.q_rad) - y;
                // A series stands for the exponential function.
                let away = (f64::from(model.behind_rad) - behind_rad).abs();
                assert!(away < 2e-5, "{t}: {away}");
                assert!((f64::from(moved_rad) - y).abs() < 3e-5, "{t}: {moved_rad} {y}");
            }
        }
    }

    #[test]
    fn drive_that_begins_to_move_at_any_time_and_place_is_not_objected_to() {
        let begin = Instant::from_micros(5_000_000);
        let mut model = DriveModel::at_rest(begin, -1.5);
        model.command(0.5, 1.0, 2.0, 0.0);
        let start = RampState { q_rad: -1.5, v_rad_s: 0.0 };
        for k in 1..200u64 {
            let q_rad = after(start, 0.5, 1.0, 2.0, 3e-3 * k as f32).q_rad;
            assert_eq!(model.compare(begin + Duration::from_millis(3) * k, q_rad, 0.0), None, "{k}");
            assert!(model.r_rad().abs() < 1e-5 && model.drift_rad_s().abs() < 1e-3, "{model:?}");
        }
        assert!(
            (model.r_max_rad() - (R0_RAD + T_JITTER_S)).abs() < 1e-6,
            "at 1 rad/s: {}",
            model.r_max_rad()
        );
    }

    #[test]
    fn nothing_is_compared_after_a_halt_until_the_drive_stands_again() {
        let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
        model.stop_watching();
        for k in 1..20u64 {
            assert_eq!(model.compare(Instant::from_micros(3_000 * k), 0.1 * k as f32, 0.0), None);
        }
        let mut model = DriveModel::at_rest(Instant::from_micros(60_000), 1.9);
        let found =
            (1..20u64).find_map(|k| model.compare(Instant::from_micros(60_000 + 3_000 * k), 2.0, 0.0));
        assert!(found.is_some());
    }

    #[test]
    fn healthy_drive_is_never_objected_to() {
        assert_eq!(watched(|_, q| q), None);
    }

    #[test]
    fn each_way_to_be_wrong_has_its_name_and_is_found_in_its_time() {
        let frozen_at = |t: f32, q: f32, from: f32, kept: f32| if t > from { kept } else { q };
        // From 0.3 s on with 0.6 rad/s: 5 mrad are gone in 8 ms, two answers more.
        let (at, cause) = watched(|t, q| frozen_at(t, q, 0.3, 0.087)).unwrap();
        assert!((303..=318).contains(&at) && cause == Cause::PositionFrozen, "{at} {cause:?}");
        let (at, cause) = watched(|t, q| if t > 0.3 { 2.0 * 0.087 - q } else { q }).unwrap();
        assert!((303..=315).contains(&at) && cause == Cause::MotionReversed, "{at} {cause:?}");
        let (at, cause) = watched(|t, q| if t > 0.6 { q + 0.012 } else { q }).unwrap();
        assert!((603..=609).contains(&at) && cause == Cause::PositionJumped, "{at} {cause:?}");
        let (at, cause) = watched(|_, q| 0.4 * q).unwrap();
        assert!((60..=150).contains(&at) && cause == Cause::MotionNotFollowed, "{at} {cause:?}");
        let (at, cause) = watched(|_, q| 0.0 * q).unwrap();
        assert!((60..=100).contains(&at) && cause == Cause::PositionFrozen, "{at} {cause:?}");
        assert!(watched(|t, q| if t > 0.3 { f32::NAN } else { q }).is_some());
    }

    #[test]
    fn drive_that_moves_while_it_is_commanded_to_rest_is_found() {
        for speed in [0.2f32, -0.5, 1.5] {
            let mut model = DriveModel::at_rest(Instant::ZERO, 1.0);
            model.command(1.0, 0.5, 1.0, 0.0);
            let found = (1..200u64).find_map(|k| {
                let q_rad = 1.0 + speed * k as f32 * 0.003;
                Some((k, model.compare(Instant::from_micros(3_000 * k), q_rad, 0.005)?))
            });
            let (cycle, cause) = found.unwrap();
            assert_eq!(cause, Cause::MovesUnordered, "{speed}");
            let bound = (1.3 * R0_RAD / (speed.abs() * 0.003)) as u64 + 3;
            assert!((2..=bound).contains(&cycle), "{speed}: {cycle} of {bound}");
        }
    }

    /// The law answers a frozen position with a small acceleration that never ends; the observer follows the answers.
    #[test]
    fn answers_that_stand_still_under_a_slow_command_are_found_within_a_hundredth_of_a_radian() {
        const STEP_RAD: f32 = 3.5e-4;
        for (a, frozen) in [(0.02f32, true), (0.1, true), (0.02, false), (0.1, false)] {
            let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
            let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
            let mut found = None;
            for k in 1..400u64 {
                model.command(3.0, 0.02, a, 0.0);
                truth = after(truth, 3.0, 0.02, a, 3e-3);
                let q_rad = if frozen { 0.0 } else { (truth.q_rad / STEP_RAD).round() * STEP_RAD };
                found = model.compare(Instant::from_micros(3_000 * k), q_rad, 0.0);
                if found.is_some() {
                    break;
                }
            }
            assert_eq!(found, frozen.then_some(Cause::PositionFrozen), "{a} rad/s2, frozen {frozen}");
            assert!(!frozen || (1e-3..0.01).contains(&truth.q_rad), "{}", truth.q_rad);
        }
    }

    /// The position of a joint that stands is up to half an encoder step beside its target, and a loop with friction leaves more.
    /// What the observer adds because of it is no command.
    #[test]
    fn drive_that_stands_beside_its_target_for_seconds_is_not_taken_for_a_frozen_one() {
        for period_us in [3_000u64, 17_000] {
            for beside_rad in [1.7e-4, -1.7e-4, 6e-4, -2e-3] {
                let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
                model.command(0.01, 0.25, 1.0, 0.0);
                let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
                for k in 1..2_000u64 {
                    truth = after(truth, 0.01, 0.25, 1.0, period_us as f32 * 1e-6);
                    let at = Instant::from_micros(period_us * k);
                    let cause = model.compare(at, truth.q_rad + beside_rad * truth.q_rad / 0.01, 0.0);
                    assert_eq!(cause, None, "{beside_rad} rad, {period_us} us, answer {k}: {model:?}");
                }
            }
        }
    }

    /// Whether the drive has taken the motion that it did not answer, or not: no objection.
    #[test]
    fn motion_without_an_answer_is_no_reason_to_object() {
        for period_us in [3_000u64, 17_000] {
            for (taken, a) in [(true, 10.0), (false, 10.0), (true, 2.0), (false, 2.0)] {
                let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
                let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
                let dt = period_us as f32 * 1e-6;
                let (mut believed, mut real) = (3.0f32, 3.0f32);
                model.command(believed, 2.0, a, 0.0);
                for k in 1..100u64 {
                    truth = after(truth, real, 2.0, a, dt);
                    let lost = k == 10;
                    let next = if (k / 10) % 2 == 0 { 3.0 } else { -3.0 };
                    if lost {
                        model.doubt(a);
                        real = if taken { next } else { real };
                        continue;
                    }
                    let q_rad = truth.q_rad - 0.005 * truth.v_rad_s;
                    let cause = model.compare(Instant::from_micros(period_us * k), q_rad, 0.005);
                    assert_eq!(
                        cause, None,
                        "{period_us} us, taken {taken}, {a} rad/s2, answer {k}: {model:?}"
                    );
                    (believed, real) = (next, next);
                    model.command(believed, 2.0, a, 0.0);
                }
            }
        }
    }

    /// Found on a machine that held up the bus: answers of unknown time, then a joint that is held. Its answers stand still because
    /// it does; only the speed of the model was wrong.
    #[test]
    fn joint_that_is_held_after_a_motion_without_an_answer_is_not_taken_for_a_frozen_drive() {
        const STEP_RAD: f32 = 3.5e-4;
        for period_us in [3_000u64, 10_000, 17_000] {
            for a in [0.5f32, 2.0, 6.0] {
                let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
                let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
                let (mut target, mut a_real) = (3.0f32, 0.01);
                for k in 1..4_000u64 {
                    truth = after(truth, target, 2.0, a_real, period_us as f32 * 1e-6);
                    let q_rad = (truth.q_rad / STEP_RAD).round() * STEP_RAD;
                    if k != 11 {
                        let cause = model.compare(Instant::from_micros(period_us * k), q_rad, 0.0);
                        assert_eq!(cause, None, "{period_us} us, {a} rad/s2, answer {k}: {model:?}");
                    }
                    // A start, the end of it, and then as much to one side as to the other.
                    (target, a_real) = match k {
                        10 => (3.0, a),
                        11 => (-3.0, a),
                        _ => (-target, 0.01),
                    };
                    if k == 11 { model.doubt(a) } else { model.command(target, 2.0, a_real, 0.0) }
                }
            }
        }
    }

    /// An answer that is late by less than what counts as held up is timed when it comes.
    #[test]
    fn joint_that_is_held_after_a_late_answer_is_not_taken_for_a_frozen_drive() {
        const STEP_RAD: f32 = 3.5e-4;
        for (period_us, a) in [(3_000u64, 10.0f32), (10_000, 6.0), (17_000, 3.0)] {
            for late_us in [400u64, 800, 1_600] {
                let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
                let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
                let (mut target, mut a_real) = (3.0f32, 0.01);
                for k in 1..2_000u64 {
                    truth = after(truth, target, 2.0, a_real, period_us as f32 * 1e-6);
                    let q_rad = (truth.q_rad / STEP_RAD).round() * STEP_RAD;
                    let late_us = if k == 11 { late_us } else { 0 };
                    let cause = model.compare(Instant::from_micros(period_us * k + late_us), q_rad, 0.0);
                    assert_eq!(
                        cause, None,
                        "{period_us} us, {a} rad/s2, {late_us} us late, answer {k}: {model:?}"
                    );
                    (target, a_real) = match k {
                        10 => (3.0, a),
                        11 => (-3.0, a),
                        _ => (-target, 0.01),
                    };
                    model.command(target, 2.0, a_real, late_us as f32 * 1e-6);
                }
            }
        }
    }

    /// The doubt is about the speed at one time. What is commanded later is known.
    #[test]
    fn drive_that_freezes_after_a_motion_without_an_answer_is_found_when_it_is_commanded() {
        let period_s = 3e-3;
        let mut model = DriveModel::at_rest(Instant::ZERO, 0.0);
        let mut truth = RampState { q_rad: 0.0, v_rad_s: 0.0 };
        model.command(3.0, 2.0, 6.0, 0.0);
        let mut found = None;
        for k in 1..400u64 {
            truth = after(truth, 3.0, 2.0, 0.5, period_s);
            match k {
                1 => model.doubt(6.0),
                _ => found = model.compare(Instant::from_micros(3_000 * k), 0.0, 0.0),
            }
            if found.is_some() {
                break;
            }
            model.command(3.0, 2.0, 0.5, 0.0);
        }
        assert_eq!(found, Some(Cause::PositionFrozen), "{model:?}");
        assert!((1e-3..0.02).contains(&truth.q_rad), "{}", truth.q_rad);
    }

    #[test]
    fn excursion_grows_with_speed_and_stays_below_a_tenth_of_a_turn() {
        let bound = |v| excursion_max_rad(v, 2.6, 10.4, 0.003);
        assert!(bound(0.0) < bound(1.0) && bound(1.0) < bound(2.6));
        assert!((0.01..0.03).contains(&bound(0.0)), "{}", bound(0.0));
        assert!((0.33..0.40).contains(&bound(2.6)), "{}", bound(2.6));
    }
}
