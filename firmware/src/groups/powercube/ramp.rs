//! Acceleration for the next period → ramp-extended command of a drive (pure).
//!
//! # What the drive does with a command
//!
//! A ramp motion has a target position p, a speed V and an acceleration A, both magnitudes. The
//! drive's generator, at velocity v, goes towards p: it changes v with A until it moves towards p at
//! V, and brakes with A from the point where the distance left is the braking distance v²/2A. A new
//! command replaces p, V and A in flight and keeps v.
//!
//! # How an acceleration a is said in these words
//!
//! With s the sign of a and v₁ = v + aT:
//!
//! 1. **Against the motion, or from rest** (s·v ≤ 0): target on the side of s, A = |a|. The generator has to
//!    turn round, so it brakes with exactly A and, if v crosses zero, goes on with exactly A the other
//!    way. The speed V does not matter as long as it is at least the new speed beyond zero.
//! 2. **With the motion, strongly** (the braking distance v₁²/2A of A = |a| fits into the way to the target):
//!    target ahead, A = |a|. The generator accelerates with exactly A; V must be at least |v₁|.
//! 3. **With the motion, weakly**: with A = |a| the target, 3 rad ahead at most, would be nearer than the
//!    braking distance and the generator would *brake*. The published rule "actual position ± 3 rad and
//!    |a|" has this fault for a < v²/6: at 2.5 rad/s below 1 rad/s², which is the last 60 ms before a
//!    release. So here the change of speed is said by the speed: V = |v₁| and an A that is large enough
//!    for the braking distance and for |a|. The generator reaches V within the period and keeps it: the
//!    mean acceleration is exact, the position at the end of the period is ahead by at most |a|T²/2.
//!
//! 4. **Against the motion, weakly**, after a command of case 3: the drive holds an A that is large enough for case 3. Then
//!    V = |v₁| brakes as well, and A stays. Without this case a joint at constant speed, whose wanted acceleration changes its
//!    sign from cycle to cycle, needs both writes in each cycle; with three such joints a cycle of 3 ms is too short.
//!
//! Cases 3 and 4 write V each cycle and leave A; cases 1 and 2 write A and leave V: one write and one motion
//! per cycle, as the bus allows. V stays low after a phase of case 3; it is raised again when it would
//! bind, or earlier when the schedule has a free slot ([`RampCommand::velocity_stale`]).
//!
//! # Limits
//!
//! The target never lies beyond the soft limits, so the drive's own ramp ends there. But a ramp with a small A
//! ends late: when the way to the limit gets as short as the braking distance with the full acceleration, the
//! command becomes full braking, whatever was asked for ([`RampCommand::position_limited`]).

use crate::joints::{at_least, at_most, clamp};
use crate::reach::SoftLimits;
use crate::settings::JointSettings;

/// Least acceleration that is commanded, rad/s². Over a period of 17 ms it is a change of speed of
/// 0.2 mrad/s; a generator with zero acceleration would never move again.
pub const A_RESOLUTION_RAD_S2: f32 = 0.01;
/// Margin on the braking distance that decides between case 2 and case 3.
const BRAKING_MARGIN: f32 = 1.25;
/// Smallest speed that counts as motion, rad/s.
const V_STANDING_RAD_S: f32 = 1e-4;

/// A joint that a plan holds on its soft limit moves at most this fast about it, rad/s, and this far from it, rad: the law answers
/// the resolution of the encoder. A throw may begin or end there.
const V_HELD_RAD_S: f32 = 0.02;
const WAY_HELD_RAD: f32 = 0.002;

/// What bounds the commands of a joint; joint side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RampLimits {
    /// Soft limits.
    pub soft: SoftLimits,
    /// Highest speed, rad/s.
    pub v_max_rad_s: f32,
    /// Highest acceleration, rad/s².
    pub a_max_rad_s2: f32,
    /// How far ahead the target lies at most, rad (the paper: 3).
    pub reach_rad: f32,
}

/// State of the drive's generator when the command starts to act.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RampState {
    /// Position, rad.
    pub q_rad: f32,
    /// Velocity, rad/s.
    pub v_rad_s: f32,
}

/// Ramp speed and acceleration the drive holds; `None` when not known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loaded {
    /// Last acknowledged speed, rad/s.
    pub v_rad_s: Option<f32>,
    /// Last acknowledged acceleration, rad/s².
    pub a_rad_s2: Option<f32>,
}

impl RampLimits {
    /// Limits of a joint for targets within `soft` and at most `reach_rad` away.
    pub(super) const fn of(joint: &JointSettings, soft: SoftLimits, reach_rad: f32) -> Self {
        Self { soft, v_max_rad_s: joint.v_max_rad_s, a_max_rad_s2: joint.a_max_rad_s2, reach_rad }
    }
}

/// A ramp-extended command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RampCommand {
    /// Target of the motion, rad, within the soft limits; of a stop outside of them see [`crate::reach`].
    pub target_rad: f32,
    /// Speed to write before, rad/s; `None`: the drive holds a suitable one.
    pub velocity_rad_s: Option<f32>,
    /// Acceleration to write before, rad/s²; `None`: the drive holds a suitable one.
    pub acceleration_rad_s2: Option<f32>,
    /// Mean acceleration over the period that the command amounts to, signed, rad/s².
    pub qdd_rad_s2: f32,
    /// Speed at the end of the period, signed, rad/s.
    pub v_end_rad_s: f32,
    /// The speed limit took part of the wanted acceleration.
    pub speed_limited: bool,
    /// The nearness of a soft limit turned the command into braking, of a joint that is not just held on it.
    pub position_limited: bool,
    /// The drive keeps a speed below the joint's highest; raising it costs one more write.
    pub velocity_stale: bool,
}

/// Command that changes the velocity by `qdd_rad_s2 · period_s` in one period.
///
/// Inputs that are not numbers give a braking command. `period_s` is positive.
pub fn realise(
    qdd_rad_s2: f32,
    period_s: f32,
    state: RampState,
    limits: &RampLimits,
    loaded: &Loaded,
) -> RampCommand {
    let RampState { q_rad, v_rad_s } = state;
    let a_max = limits.a_max_rad_s2;
    let mut wanted = if qdd_rad_s2.is_finite() { clamp(qdd_rad_s2, -a_max, a_max) } else { 0.0 };

    let brakes = must_brake(wanted, period_s, state, limits);
    let position_limited =
        brakes && !is_held_on_limit(v_rad_s, v_rad_s + wanted * period_s, q_rad, limits.soft);
    if brakes {
        // Not through zero: the period that stops the joint must not send it back.
        wanted = -v_rad_s.signum() * at_most(v_rad_s.abs() / period_s, a_max);
    }
    // The speed limit brakes a joint that is too fast, with no more than it has.
    let v_wanted = v_rad_s + wanted * period_s;
    let v_end_limited = clamp(v_wanted, -limits.v_max_rad_s, limits.v_max_rad_s);
    let speed_limited = v_end_limited != v_wanted;
    if speed_limited {
        wanted = clamp((v_end_limited - v_rad_s) / period_s, -a_max, a_max);
    }
    let v_end = v_rad_s + wanted * period_s;

    let standing = v_rad_s.abs() < V_STANDING_RAD_S;
    let a_wanted = clamp(wanted.abs(), A_RESOLUTION_RAD_S2, at_least(a_max, A_RESOLUTION_RAD_S2));
    // The target on a side, and the least acceleration with which the generator does not brake before it.
    let ahead = |side: f32| {
        let target_rad = clamp(q_rad + side * limits.reach_rad, limits.soft.q_min_rad, limits.soft.q_max_rad);
        let way_rad = at_least((target_rad - q_rad).abs() - 0.5 * (v_rad_s + v_end).abs() * period_s, 1e-3);
        (target_rad, BRAKING_MARGIN * v_end * v_end / (2.0 * way_rad))
    };
    let forward = v_rad_s.signum();
    let brakes_weakly = !standing && !brakes && wanted * v_rad_s < 0.0 && v_end * v_rad_s > 0.0 && {
        let (_, a_floor) = ahead(forward);
        a_wanted < a_floor && loaded.a_rad_s2.is_some_and(|a| a >= a_floor && a <= a_max)
    };
    let side = if brakes_weakly || (wanted == 0.0 && !standing) { forward } else { wanted.signum() };
    let (target_rad, a_floor) = ahead(side);
    let with_motion = !standing && side * v_rad_s > 0.0;
    let (velocity, acceleration) = if with_motion && a_wanted < a_floor {
        // Case 3.
        let a_needed = at_most(at_least(a_floor, a_wanted), a_max);
        let a_holds = loaded.a_rad_s2.is_some_and(|a| a >= a_needed && a <= a_max);
        let acceleration = if a_holds { None } else { Some(at_most(1.5 * a_needed, a_max)) };
        (Some(v_end.abs()), acceleration)
    } else {
        let v_needed = if side * v_end > 0.0 { v_end.abs() } else { 0.0 };
        let v_holds = loaded.v_rad_s.is_some_and(|v| v >= v_needed);
        match loaded.a_rad_s2 {
            // The speed binds, but the acceleration in the drive suffices: one write does, as in case 3.
            Some(a) if !v_holds && with_motion && a >= at_least(a_floor, a_wanted) && a <= a_max => {
                (Some(v_end.abs()), None)
            }
            _ => (if v_holds { None } else { Some(limits.v_max_rad_s) }, Some(a_wanted)),
        }
    };
    let kept = velocity.or(loaded.v_rad_s);
    RampCommand {
        target_rad,
        velocity_rad_s: velocity,
        acceleration_rad_s2: acceleration,
        qdd_rad_s2: wanted,
        v_end_rad_s: v_end,
        speed_limited,
        position_limited,
        velocity_stale: kept.is_some_and(|v| v < 0.99 * limits.v_max_rad_s) && !with_motion,
    }
}

/// True for a joint at rest on a soft limit, as its speeds now and at the end of the period say.
const fn is_held_on_limit(v_rad_s: f32, v_end_rad_s: f32, q_rad: f32, soft: SoftLimits) -> bool {
    at_least(v_rad_s.abs(), v_end_rad_s.abs()) <= V_HELD_RAD_S
        && soft.way_to_nearest_rad(q_rad) <= WAY_HELD_RAD
}

/// True if obeying `qdd_rad_s2` for a period would leave less way to the soft limit ahead than the
/// joint needs to stop.
fn must_brake(qdd_rad_s2: f32, period_s: f32, state: RampState, limits: &RampLimits) -> bool {
    let v_end = state.v_rad_s + qdd_rad_s2 * period_s;
    let v = if state.v_rad_s.abs() > v_end.abs() { state.v_rad_s } else { v_end };
    let room = limits.soft.room_rad(state.q_rad, v);
    // One more period passes before the next command can correct this one.
    let braking = v * v / (2.0 * at_least(limits.a_max_rad_s2, A_RESOLUTION_RAD_S2)) + v.abs() * period_s;
    // A joint outside its limits may move back in, and so may one that stands exactly on them.
    let outward = v * state.v_rad_s >= 0.0 && v.abs() > V_STANDING_RAD_S;
    let fits = braking <= room;
    outward && !fits
}

/// Acceleration of a ramp to rest, rad/s²: as asked, more where a soft limit is near. Where it ends follows when it leaves
/// ([`rest_rad`](crate::reach::rest_rad)).
pub fn stop_rad_s2(state: RampState, a_rad_s2: f32, limits: &RampLimits) -> f32 {
    let room = limits.soft.room_rad(state.q_rad, state.v_rad_s);
    let a_needed = at_least(0.5 * state.v_rad_s * state.v_rad_s / at_least(room, 1e-3), a_rad_s2);
    clamp(a_needed, A_RESOLUTION_RAD_S2, at_least(limits.a_max_rad_s2, A_RESOLUTION_RAD_S2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reach;
    use proptest::prelude::*;

    const LIMITS: RampLimits = RampLimits {
        soft: SoftLimits { q_min_rad: -3.0, q_max_rad: 3.0 },
        v_max_rad_s: 2.6,
        a_max_rad_s2: 10.4,
        reach_rad: 3.0,
    };

    /// Generator as described above, in steps of 5 µs in double precision: an oracle, not our code.
    #[derive(Clone, Copy, Debug)]
    struct ReferenceRamp {
        q: f64,
        v: f64,
        v_ramp: f64,
        a_ramp: f64,
        target: f64,
    }

    impl ReferenceRamp {
        fn at(q: f64, v: f64) -> Self {
            Self { q, v, v_ramp: LIMITS.v_max_rad_s.into(), a_ramp: LIMITS.a_max_rad_s2.into(), target: q }
        }

        fn loaded(&self) -> Loaded {
            Loaded { v_rad_s: Some(self.v_ramp as f32), a_rad_s2: Some(self.a_ramp as f32) }
        }

        fn take(&mut self, command: &RampCommand) {
            if let Some(v) = command.velocity_rad_s {
                self.v_ramp = v.into();
            }
            if let Some(a) = command.acceleration_rad_s2 {
                self.a_ramp = a.into();
            }
            self.target = command.target_rad.into();
        }

        fn run(&mut self, us: u32) {
            const DT: f64 = 5e-6;
            for _ in 0..us / 5 {
                let d = self.target - self.q;
                let towards = d * self.v > 0.0;
                let wanted = if towards && self.v * self.v / (2.0 * self.a_ramp) >= d.abs() {
                    0.0
                } else {
                    d.signum() * self.v_ramp
                };
                let dv = (wanted - self.v).clamp(-self.a_ramp * DT, self.a_ramp * DT);
                self.q += DT * (self.v + 0.5 * dv);
                self.v += dv;
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]
        /// Far from the limits the generator ends the period at exactly the wanted speed, in all
        /// three cases, from any speed, with whatever it held before.
        #[test]
        fn generator_makes_the_wanted_change_of_speed(
            v in -2.5f64..2.5, a in -10.4f32..10.4, weak in -0.5f32..0.5, use_weak: bool,
            held_v in 0.1f64..2.6, held_a in 0.05f64..10.4, long: bool,
        ) {
            let a = if use_weak { weak } else { a };
            let period_us = if long { 17_000 } else { 3_000 };
            let period_s = period_us as f32 * 1e-6;
            let mut drive = ReferenceRamp { v_ramp: held_v.max(v.abs()), a_ramp: held_a, ..ReferenceRamp::at(0.0, v) };
            let state = RampState { q_rad: 0.0, v_rad_s: v as f32 };
            let command = realise(a, period_s, state, &LIMITS, &drive.loaded());
            drive.take(&command);
            drive.run(period_us);
            let floor = f64::from(A_RESOLUTION_RAD_S2 * period_s);
            prop_assert!((drive.v - f64::from(command.v_end_rad_s)).abs() <= floor + 2e-5, "{command:?} {drive:?}");
            if !command.speed_limited {
                prop_assert!((command.qdd_rad_s2 - a).abs() < 1e-3);
                let ideal = v * f64::from(period_s) + 0.5 * f64::from(a) * f64::from(period_s * period_s);
                let ahead = 0.5 * f64::from(a.abs() + A_RESOLUTION_RAD_S2) * f64::from(period_s * period_s);
                prop_assert!((drive.q - ideal).abs() <= ahead + 1e-6, "{} {ideal}", drive.q);
            }
            prop_assert!(command.acceleration_rad_s2.is_some() || command.velocity_rad_s.is_some(), "one write each cycle");
        }

        /// Whatever is asked for, cycle after cycle, the joint stays within its soft limits, its
        /// speed and its acceleration.
        #[test]
        fn no_sequence_of_wishes_leaves_the_limits(
            wishes in proptest::collection::vec(prop_oneof![-30f32..30.0, Just(10.4), Just(-10.4), Just(f32::NAN)], 300),
            hold in 1usize..60, long: bool,
        ) {
            let period_us = if long { 17_000 } else { 3_000 };
            let hold = if long { hold / 4 + 1 } else { hold };
            let mut drive = ReferenceRamp::at(2.0, 0.0);
            let mut loaded = Loaded::default();
            for k in 0..300 {
                let a = wishes[(k / hold) % wishes.len()];
                let state = RampState { q_rad: drive.q as f32, v_rad_s: drive.v as f32 };
                let command = realise(a, period_us as f32 * 1e-6, state, &LIMITS, &loaded);
                prop_assert!(command.target_rad.abs() <= 3.0);
                prop_assert!(command.acceleration_rad_s2.is_none_or(|a| (0.0..=10.4).contains(&a)));
                prop_assert!(command.velocity_rad_s.is_none_or(|v| (0.0..=2.6).contains(&v)));
                drive.take(&command);
                loaded = drive.loaded();
                drive.run(period_us / 10);
                drive.run(period_us - period_us / 10);
                prop_assert!(drive.q.abs() <= 3.0 + 1e-3, "{} at cycle {k}", drive.q);
                prop_assert!(drive.v.abs() <= 2.6 + 1e-3);
            }
        }

        /// Generators differ in rounding, so a stop may creep the last hair's breadth.
        #[test]
        fn stop_ends_within_the_stated_way(v in -2.6f64..2.6, a in 1f32..10.4) {
            let mut drive = ReferenceRamp::at(0.2, v);
            let (q_rad, v_rad_s) = (0.2, v as f32);
            let a_rad_s2 = stop_rad_s2(RampState { q_rad, v_rad_s }, a, &LIMITS);
            let target_rad = reach::rest_rad(q_rad, v_rad_s, a_rad_s2, LIMITS.soft);
            let command =
                RampCommand { target_rad, acceleration_rad_s2: Some(a_rad_s2), ..RampCommand::default() };
            drive.take(&command);
            drive.run((1.2e6 * v.abs() / f64::from(a)) as u32 + 20_000);
            prop_assert!(drive.v.abs() < 0.02, "{drive:?}");
            prop_assert!((drive.q - f64::from(command.target_rad)).abs() < 2e-3, "{drive:?}");
        }
    }

    #[test]
    fn published_rule_brakes_where_it_should_accelerate_and_ours_does_not() {
        let (v, a, period_us) = (2.5, 0.5, 3_000);
        let mut published = ReferenceRamp { a_ramp: a, target: 3.0, ..ReferenceRamp::at(0.0, v) };
        published.run(period_us);
        assert!(published.v < v, "the braking distance is longer than 3 rad");
        let mut ours = ReferenceRamp::at(0.0, v);
        let state = RampState { q_rad: 0.0, v_rad_s: v as f32 };
        ours.take(&realise(a as f32, 0.003, state, &LIMITS, &ours.loaded()));
        ours.run(period_us);
        assert!((ours.v - (v + a * 0.003)).abs() < 1e-6, "{}", ours.v);
    }

    #[test]
    fn weak_acceleration_writes_the_speed_only() {
        let loaded = Loaded { v_rad_s: Some(2.6), a_rad_s2: Some(3.0) };
        let state = RampState { q_rad: 0.0, v_rad_s: 2.0 };
        let command = realise(0.1, 0.003, state, &LIMITS, &loaded);
        assert_eq!(command.acceleration_rad_s2, None);
        assert!((command.velocity_rad_s.unwrap() - 2.0003).abs() < 1e-6);
    }

    #[test]
    fn weak_braking_after_weak_acceleration_writes_the_speed_only() {
        let state = RampState { q_rad: 0.0, v_rad_s: 2.0 };
        let cruising = Loaded { v_rad_s: Some(2.0), a_rad_s2: Some(3.0) };
        let command = realise(-0.1, 0.003, state, &LIMITS, &cruising);
        assert_eq!((command.acceleration_rad_s2, command.target_rad), (None, 3.0));
        assert!((command.velocity_rad_s.unwrap() - 1.9997).abs() < 1e-6);
        // An acceleration that is too low for the way ahead says the braking itself.
        let low = Loaded { v_rad_s: Some(2.0), a_rad_s2: Some(0.2) };
        assert_eq!(realise(-0.1, 0.003, state, &LIMITS, &low).acceleration_rad_s2, Some(0.1));
    }

    #[test]
    fn speed_is_written_again_only_when_it_binds() {
        let state = RampState { q_rad: 0.0, v_rad_s: 1.0 };
        let low = Loaded { v_rad_s: Some(1.0), a_rad_s2: Some(2.0) };
        let braking = realise(-5.0, 0.003, state, &LIMITS, &low);
        assert_eq!((braking.velocity_rad_s, braking.acceleration_rad_s2), (None, Some(5.0)));
        assert!(braking.velocity_stale);
        let faster = realise(5.0, 0.003, state, &LIMITS, &low);
        assert_eq!((faster.velocity_rad_s, faster.acceleration_rad_s2), (Some(2.6), Some(5.0)));
    }

    #[test]
    fn joint_outside_its_limits_may_come_back() {
        let state = RampState { q_rad: 3.05, v_rad_s: 0.0 };
        let inward = realise(-2.0, 0.003, state, &LIMITS, &Loaded::default());
        assert!(!inward.position_limited && inward.qdd_rad_s2 == -2.0 && inward.target_rad < 3.0);
        let outward = realise(2.0, 0.003, state, &LIMITS, &Loaded::default());
        assert!(outward.position_limited && outward.target_rad <= 3.0);
    }

    #[test]
    fn joint_that_is_held_on_its_limit_is_braked_and_not_reported() {
        let at = |q_rad: f32, v_rad_s: f32| {
            realise(1.0, 0.003, RampState { q_rad, v_rad_s }, &LIMITS, &Loaded::default())
        };
        let held = at(3.0 - 1e-5, 0.004);
        assert!(!held.position_limited && held.qdd_rad_s2 < 0.0 && held.target_rad <= 3.0);
        assert!(at(3.0 - 1e-5, 0.1).position_limited, "it comes fast");
        assert!(at(3.003, 0.004).position_limited, "it is beyond");
    }
}
