//! The ramp generator of a drive, in closed form (pure).

use crate::groups::powercube::ramp::RampState;
use crate::joints::{at_least, at_most};

/// Ramp generator `dt_s` later: towards the target with at most `v_ramp`, changing its speed with `a`.
pub(super) fn after(
    from: RampState,
    target_rad: f32,
    v_ramp_rad_s: f32,
    a_rad_s2: f32,
    dt_s: f32,
) -> RampState {
    let RampState { q_rad, v_rad_s } = from;
    if a_rad_s2 <= 0.0 {
        // No motion was commanded yet.
        return RampState { q_rad: q_rad + v_rad_s * dt_s, v_rad_s };
    }
    let a = a_rad_s2;
    let rest_rad = target_rad - (q_rad + 0.5 * v_rad_s * v_rad_s.abs() / a);
    let s = if rest_rad > 0.0 || (rest_rad == 0.0 && v_rad_s > 0.0) { 1.0 } else { -1.0 };
    // All in the direction of travel from here on.
    let (d, u, v_max) = (s * (target_rad - q_rad), s * v_rad_s, at_least(v_ramp_rad_s, 1e-6));
    let give = |way: f32, v: f32| RampState { q_rad: q_rad + s * way, v_rad_s: s * v };
    let way_of = |a: f32, t: f32| t * (u + 0.5 * a * t);

    // Mostly it still changes its speed after the whole time.
    let (first_a, w, t1) = if u > v_max {
        (-a, v_max, (u - v_max) / a)
    } else {
        let u1 = u + a * dt_s;
        if u1 <= v_max && d - way_of(a, dt_s) >= 0.5 * u1 * u1.abs() / a {
            return give(way_of(a, dt_s), u1);
        }
        let peak = libm::sqrtf(at_least(a * d + 0.5 * u * u, 0.0));
        let w = at_most(peak, v_max);
        (a, w, at_least((w - u) / a, 0.0))
    };
    if dt_s <= t1 {
        return give(way_of(first_a, dt_s), u + first_a * dt_s);
    }
    let (way1, t) = (way_of(first_a, t1), dt_s - t1);
    let cruise = at_least(d - way1 - 0.5 * w * w / a, 0.0);
    if w * t <= cruise {
        return give(way1 + w * t, w);
    }
    let t3 = t - cruise / at_least(w, 1e-6);
    if a * t3 < w {
        return give(way1 + cruise + t3 * (w - 0.5 * a * t3), w - a * t3);
    }
    RampState { q_rad: target_rad, v_rad_s: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Generator in small steps in double precision: an oracle that switches by itself.
    fn by_steps(from: RampState, target: f64, v_ramp: f64, a: f64, seconds: f64) -> (f64, f64) {
        let (mut q, mut v, dt) = (f64::from(from.q_rad), f64::from(from.v_rad_s), 2e-6);
        for _ in 0..(seconds / dt).round() as usize {
            let d = target - q;
            let towards = d * v > 0.0;
            let wanted = if towards && v * v / (2.0 * a) >= d.abs() { 0.0 } else { d.signum() * v_ramp };
            let dv = (wanted - v).clamp(-a * dt, a * dt);
            q += dt * (v + 0.5 * dv);
            v += dv;
        }
        (q, v)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn generator_in_closed_form_agrees_with_small_steps(
            v in -2.5f32..2.5, target in -1.0f32..1.0, v_ramp in 0.05f32..2.6, a in 0.3f32..10.0, t in 0.0f32..0.4,
        ) {
            let from = RampState { q_rad: 0.1, v_rad_s: v };
            let (q, speed) = by_steps(from, target.into(), v_ramp.into(), a.into(), t.into());
            let model = after(from, target, v_ramp, a, t);
            prop_assert!((f64::from(model.q_rad) - q).abs() < 2e-4, "{model:?}, {q} {speed}");
            prop_assert!((f64::from(model.v_rad_s) - speed).abs() < 8e-3, "{model:?}, {q} {speed}");
        }

        /// Many short looks see what one long one sees.
        #[test]
        fn generator_does_not_depend_on_how_often_it_is_looked_at(
            v in -2.5f32..2.5, target in -1.0f32..1.0, a in 0.3f32..10.0, looks in 2u16..60,
        ) {
            let from = RampState { q_rad: 0.1, v_rad_s: v };
            let once = after(from, target, 1.5, a, 0.3);
            let mut often = from;
            for _ in 0..looks {
                often = after(often, target, 1.5, a, 0.3 / f32::from(looks));
            }
            prop_assert!((once.q_rad - often.q_rad).abs() < 1e-4, "{once:?} {often:?}");
        }
    }
}
