//! Ramp profiles in closed form: position or velocity as target, velocity and acceleration as maxima.
//!
//! A ramp has at most three parts of constant acceleration (to the cruising velocity, cruise, to the end). All of
//! them are computed when it is made, and evaluated exactly at any time: nothing is integrated, so a ramp does not
//! depend on how often it is evaluated.
//!
//! ```text
//! s     direction of travel, +1 or -1: sign of (target - position reached by braking at once)
//! D     s (target - q0)                distance in that direction, rad
//! u     s v0                           present velocity in that direction, rad/s
//! w     min(V, sqrt(A D + u²/2))       velocity at the end of the first stretch, rad/s       (u <= V)
//! w     V, reached by braking          when V was lowered below the present velocity         (u > V)
//! ```

/// Input of the position loop at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setpoint {
    pub q_rad: f64,
    pub v_rad_s: f64,
    /// Acceleration, rad/s²; at a corner the one after it.
    pub a_rad_s2: f64,
}

impl Setpoint {
    /// Standing at `q_rad`.
    pub const fn standing(q_rad: f64) -> Self {
        Self { q_rad, v_rad_s: 0.0, a_rad_s2: 0.0 }
    }
}

/// Part of a ramp, as the state word shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RampPhase {
    Accelerating,
    /// The speed is constant and not zero.
    Steady,
    Decelerating,
    /// Standing at the target.
    Ended,
}

/// A stretch of constant acceleration that begins at `t_s` in (`q_rad`, `v_rad_s`).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stretch {
    t_s: f64,
    q_rad: f64,
    v_rad_s: f64,
    a_rad_s2: f64,
}

impl Stretch {
    fn at(&self, t_s: f64) -> Setpoint {
        let dt = t_s - self.t_s;
        Setpoint {
            q_rad: self.q_rad + dt * (self.v_rad_s + 0.5 * dt * self.a_rad_s2),
            v_rad_s: self.v_rad_s + dt * self.a_rad_s2,
            a_rad_s2: self.a_rad_s2,
        }
    }

    /// The stretch that follows this one after `duration_s`.
    fn then(&self, duration_s: f64, a_rad_s2: f64) -> Self {
        let t_s = self.t_s + duration_s;
        let end = self.at(t_s);
        Self { t_s, q_rad: end.q_rad, v_rad_s: end.v_rad_s, a_rad_s2 }
    }
}

/// A ramp to a position, or to a velocity which is then held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    stretches: [Stretch; 3],
    /// Where and when a ramp to a position ends; `None` for a velocity that is held.
    end: Option<(f64, f64)>,
}

impl Ramp {
    /// Ramp from (`q_rad`, `v_rad_s`) to rest at `target_rad`, with speed up to `v_max_rad_s` and acceleration
    /// `a_max_rad_s2` (both positive and finite; smaller values count as 1e-9).
    ///
    /// A speed above `v_max_rad_s` at the start is braked with `a_max_rad_s2` to it; if the target cannot be
    /// reached without overshoot, the ramp overshoots and comes back.
    pub fn to_position(
        q_rad: f64,
        v_rad_s: f64,
        target_rad: f64,
        v_max_rad_s: f64,
        a_max_rad_s2: f64,
    ) -> Self {
        let (v_max, a) = (v_max_rad_s.max(1e-9), a_max_rad_s2.max(1e-9));
        let braked_q = q_rad + v_rad_s * v_rad_s.abs() / (2.0 * a);
        let s = match target_rad - braked_q {
            rest if rest > 0.0 => 1.0,
            rest if rest < 0.0 => -1.0,
            // Braking at once ends exactly at the target.
            _ => 1.0_f64.copysign(v_rad_s),
        };
        let (d, u) = (s * (target_rad - q_rad), s * v_rad_s);
        let (w, a_first, to_w) = if u > v_max {
            (v_max, -a, (u - v_max) / a)
        } else {
            let w = (a * d + 0.5 * u * u).max(0.0).sqrt().min(v_max);
            (w, a, ((w - u) / a).max(0.0))
        };
        let way_to_w = 0.5 * (u + w) * to_w;
        let way_to_rest = 0.5 * w * w / a;
        let cruise = if w > 0.0 { ((d - way_to_w - way_to_rest) / w).max(0.0) } else { 0.0 };

        let first = Stretch { t_s: 0.0, q_rad, v_rad_s, a_rad_s2: s * a_first };
        let second = first.then(to_w, 0.0);
        let third = second.then(cruise, -s * a);
        let end_s = third.t_s + w / a;
        Self { stretches: [first, second, third], end: Some((end_s, target_rad)) }
    }

    /// Ramp from (`q_rad`, `v_rad_s`) to the velocity `v_target_rad_s` with `a_max_rad_s2`, held from then on.
    ///
    /// A target of zero ends where the braking ends.
    pub fn to_velocity(q_rad: f64, v_rad_s: f64, v_target_rad_s: f64, a_max_rad_s2: f64) -> Self {
        let a = a_max_rad_s2.max(1e-9);
        let change = v_target_rad_s - v_rad_s;
        let first = Stretch { t_s: 0.0, q_rad, v_rad_s, a_rad_s2: a.copysign(change) };
        let mut held = first.then(change.abs() / a, 0.0);
        held.v_rad_s = v_target_rad_s;
        let end = (v_target_rad_s == 0.0).then_some((held.t_s, held.q_rad));
        Self { stretches: [first, held, held], end }
    }

    /// Set-point `t_s` seconds after the start; before the start the first velocity backwards, after the end
    /// standing at the target exactly.
    pub fn at(&self, t_s: f64) -> Setpoint {
        match self.end {
            Some((end_s, target_rad)) if t_s >= end_s => Setpoint::standing(target_rad),
            _ if t_s < 0.0 => {
                let Stretch { q_rad, v_rad_s, .. } = self.stretches[0];
                Setpoint { q_rad: q_rad + v_rad_s * t_s, v_rad_s, a_rad_s2: 0.0 }
            }
            _ => self.stretch(t_s).at(t_s),
        }
    }

    /// Part of the ramp at `t_s`.
    pub fn phase(&self, t_s: f64) -> RampPhase {
        if self.end.is_some_and(|(end_s, _)| t_s >= end_s) {
            return RampPhase::Ended;
        }
        let Setpoint { v_rad_s, a_rad_s2, .. } = self.stretch(t_s.max(0.0)).at(t_s.max(0.0));
        if a_rad_s2 == 0.0 {
            RampPhase::Steady
        } else if v_rad_s * a_rad_s2 >= 0.0 {
            RampPhase::Accelerating
        } else {
            RampPhase::Decelerating
        }
    }

    /// Length in seconds; `None` for a velocity that is held for ever.
    pub fn duration_s(&self) -> Option<f64> {
        self.end.map(|(end_s, _)| end_s)
    }

    /// Where the ramp comes to rest; `None` for a velocity that is held for ever.
    pub fn target_rad(&self) -> Option<f64> {
        self.end.map(|(_, target_rad)| target_rad)
    }

    fn stretch(&self, t_s: f64) -> &Stretch {
        let [first, second, third] = &self.stretches;
        if t_s >= third.t_s && self.end.is_some() {
            third
        } else if t_s >= second.t_s {
            second
        } else {
            first
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PHASES: [RampPhase; 4] =
        [RampPhase::Accelerating, RampPhase::Steady, RampPhase::Decelerating, RampPhase::Ended];

    /// Textbook trapezoid, rest to rest: 1 rad at 0.25 rad/s with 0.5 rad/s² takes 0.5 + 3.5 + 0.5 s.
    #[test]
    fn rest_to_rest_is_the_textbook_trapezoid() {
        let ramp = Ramp::to_position(0.0, 0.0, 1.0, 0.25, 0.5);
        assert!((ramp.duration_s().unwrap() - 4.5).abs() < 1e-12);
        for (t, q, v, phase) in [
            (0.0, 0.0, 0.0, PHASES[0]),
            (0.25, 0.015625, 0.125, PHASES[0]),
            (0.5, 0.0625, 0.25, PHASES[1]),
            (2.25, 0.5, 0.25, PHASES[1]),
            (4.25, 0.984375, 0.125, PHASES[2]),
            (4.5, 1.0, 0.0, PHASES[3]),
            (9.0, 1.0, 0.0, PHASES[3]),
        ] {
            let at = ramp.at(t);
            assert!((at.q_rad - q).abs() < 1e-12 && (at.v_rad_s - v).abs() < 1e-12, "t = {t}: {at:?}");
            assert_eq!(ramp.phase(t), phase, "t = {t}");
        }
    }

    #[test]
    fn short_way_is_a_triangle_that_never_cruises() {
        // 0.02 rad with 0.5 rad/s²: peak sqrt(0.01) = 0.1 rad/s after 0.2 s.
        let ramp = Ramp::to_position(1.0, 0.0, 0.98, 0.25, 0.5);
        assert!((ramp.duration_s().unwrap() - 0.4).abs() < 1e-12);
        assert!((ramp.at(0.2).v_rad_s + 0.1).abs() < 1e-12);
        assert_eq!(ramp.phase(0.21), RampPhase::Decelerating);
    }

    #[test]
    fn target_behind_is_reached_by_braking_and_coming_back() {
        // 1 rad/s away from the target with 1 rad/s²: stops after 1 s, 0.5 rad beyond.
        let ramp = Ramp::to_position(0.0, 1.0, -0.5, 10.0, 1.0);
        assert_eq!(ramp.phase(0.5), RampPhase::Decelerating);
        let turn = ramp.at(1.0);
        assert!((turn.q_rad - 0.5).abs() < 1e-12 && turn.v_rad_s.abs() < 1e-12);
        assert_eq!(ramp.phase(1.2), RampPhase::Accelerating);
        // 1 rad back from rest: two times 1 s.
        assert!((ramp.duration_s().unwrap() - 3.0).abs() < 1e-12);
    }

    #[test]
    fn speed_above_a_lowered_maximum_is_braked_first() {
        let ramp = Ramp::to_position(0.0, 2.0, 10.0, 1.0, 1.0);
        assert_eq!(ramp.phase(0.5), RampPhase::Decelerating);
        assert!((ramp.at(1.0).v_rad_s - 1.0).abs() < 1e-12);
        assert_eq!(ramp.phase(1.5), RampPhase::Steady);
    }

    #[test]
    fn velocity_ramp_holds_its_target_exactly_and_ends_only_at_zero() {
        let ramp = Ramp::to_velocity(1.0, -0.5, 0.25, 0.5);
        assert_eq!((ramp.duration_s(), ramp.phase(0.5)), (None, RampPhase::Decelerating));
        assert_eq!(ramp.phase(1.25), RampPhase::Accelerating);
        assert_eq!((ramp.phase(1.5), ramp.at(100.0).v_rad_s), (RampPhase::Steady, 0.25));
        let stop = Ramp::to_velocity(0.0, 1.0, 0.0, 2.0);
        assert_eq!((stop.duration_s(), stop.phase(0.5)), (Some(0.5), RampPhase::Ended));
        assert!((stop.at(3.0).q_rad - 0.25).abs() < 1e-12);
    }

    /// Independent computation: time-optimal double integrator by integrating its switching law in small steps.
    fn by_switching_law(q: f64, v: f64, target: f64, v_max: f64, a: f64, until: f64) -> (f64, f64) {
        let (mut e, mut v, dt) = (q - target, v, 1e-5);
        for _ in 0..(until / dt).round() as usize {
            let surface = e + v * v.abs() / (2.0 * a);
            let mut u = if surface > 0.0 { -a } else { a };
            let next = v + u * dt;
            if next.abs() > v_max && next.abs() >= v.abs() {
                u = 0.0;
            }
            e += v * dt + 0.5 * u * dt * dt;
            v += u * dt;
        }
        (e + target, v)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]
        #[test]
        fn profile_agrees_with_the_switching_law_of_optimal_control(
            v in -1.0..1.0_f64, target in -0.6..0.6_f64, v_max in 0.3..1.5_f64, a in 0.5..4.0_f64, share in 0.05..1.0_f64,
        ) {
            let v = v.clamp(-v_max, v_max);
            let ramp = Ramp::to_position(0.0, v, target, v_max, a);
            let t = share * ramp.duration_s().unwrap();
            let (q, speed) = by_switching_law(0.0, v, target, v_max, a, t);
            let at = ramp.at(t);
            prop_assert!((at.q_rad - q).abs() < 2e-4, "{} against {q}", at.q_rad);
            prop_assert!((at.v_rad_s - speed).abs() < 5e-4, "{} against {speed}", at.v_rad_s);
        }
    }

    proptest! {
        #[test]
        fn retargeting_in_flight_never_exceeds_the_maxima_and_ends_exactly(
            legs in proptest::collection::vec(
                (-3.0..3.0_f64, 0.01..3.0_f64, 0.05..12.0_f64, 0.0..1.5_f64), 1..12),
        ) {
            let (mut q, mut v) = (0.0, 0.0);
            let mut last = Ramp::to_position(0.0, 0.0, 0.0, 1.0, 1.0);
            let mut target = 0.0;
            for (next, v_max, a, stay) in legs {
                let ramp = Ramp::to_position(q, v, next, v_max, a);
                let start = ramp.at(0.0);
                prop_assert!((start.q_rad - q).abs() < 1e-12 && (start.v_rad_s - v).abs() < 1e-12);
                let allowed = v_max.max(v.abs());
                let mut before = start;
                for k in 1..=50 {
                    let t = stay * f64::from(k) / 50.0;
                    let at = ramp.at(t);
                    prop_assert!(at.v_rad_s.abs() <= allowed * (1.0 + 1e-9), "speed {} above {allowed}", at.v_rad_s);
                    prop_assert!(at.a_rad_s2.abs() <= a * (1.0 + 1e-9));
                    let dt = stay / 50.0;
                    prop_assert!((at.v_rad_s - before.v_rad_s).abs() <= a * dt * (1.0 + 1e-6) + 1e-9);
                    prop_assert!((at.q_rad - before.q_rad).abs() <= allowed * dt * (1.0 + 1e-6) + 1e-9);
                    before = at;
                }
                let now = ramp.at(stay);
                (q, v, last, target) = (now.q_rad, now.v_rad_s, ramp, next);
            }
            let end = last.duration_s().unwrap();
            let just_before = last.at(end * (1.0 - 1e-12));
            prop_assert!((just_before.q_rad - target).abs() < 1e-6 && just_before.v_rad_s.abs() < 1e-6);
            prop_assert_eq!(last.at(end), Setpoint::standing(target));
            prop_assert_eq!(last.phase(end), RampPhase::Ended);
        }
    }
}
