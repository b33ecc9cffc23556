//! One axis between rest and the window in which the ball is followed.
//!
//! Start and stop are the same function of the time `s` away from the window: a stop runs with the time, a start is
//! a stop seen backwards (the speed changes its sign, the acceleration does not). The acceleration has three parts:
//!
//! ```text
//!  a1 \                 blend: from the acceleration of the window to that of the ramp, smooth (3σ² - 2σ³)
//!      \_________       cruise: constant, the paper's ramp
//!                \__    fade: to zero, smooth
//!  0 ---blend-----|--|--> s
//! ```
//!
//! With blend and fade of zero length it is the paper's linear speed ramp.

/// State of an axis: angle, first and second derivative by the time away from the window.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisState {
    /// Angle in rad.
    pub q: f64,
    /// Speed away from the window in rad/s.
    pub w: f64,
    /// Acceleration in rad/s².
    pub a: f64,
}

/// A ramp of one axis from the edge of the window to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    edge: AxisState,
    blend_s: f64,
    cruise_s: f64,
    fade_s: f64,
    cruise_a: f64,
}

/// Shape of ramps, common to the axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RampShape {
    /// Time of the blend in s.
    pub blend_s: f64,
    /// Time of the fade in s.
    pub fade_s: f64,
}

impl Ramp {
    /// A ramp whose cruise lasts `cruise_s`; all times together must be positive unless the axis rests at the edge.
    #[must_use]
    pub fn new(edge: AxisState, shape: RampShape, cruise_s: f64) -> Self {
        let weight = 0.5 * shape.blend_s + cruise_s + 0.5 * shape.fade_s;
        let speed = edge.w + 0.5 * edge.a * shape.blend_s;
        let cruise_a = if weight > 0.0 { -speed / weight } else { 0.0 };
        Self { edge, blend_s: shape.blend_s, cruise_s, fade_s: shape.fade_s, cruise_a }
    }

    /// Shortest cruise with which a ramp stays at or below the acceleration `a_max` (rad/s²), in s.
    #[must_use]
    pub(crate) fn shortest_cruise_s(edge: AxisState, shape: RampShape, a_max: f64) -> f64 {
        let speed = edge.w + 0.5 * edge.a * shape.blend_s;
        (speed.abs() / a_max - 0.5 * (shape.blend_s + shape.fade_s)).max(0.0)
    }

    /// Time from the edge of the window to rest, in s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.blend_s + self.cruise_s + self.fade_s
    }

    /// State at `s` seconds from the edge of the window; at rest from [`Ramp::duration_s`] on.
    #[must_use]
    pub fn at(&self, s: f64) -> AxisState {
        let blended = faded(self.edge, self.cruise_a, self.blend_s, s.min(self.blend_s));
        if s <= self.blend_s {
            return blended;
        }
        let t = (s - self.blend_s).min(self.cruise_s);
        let a = self.cruise_a;
        let cruised = AxisState { q: blended.q + (blended.w + 0.5 * a * t) * t, w: blended.w + a * t, a };
        if s <= self.blend_s + self.cruise_s {
            return cruised;
        }
        let t = s - self.blend_s - self.cruise_s;
        let end = faded(cruised, 0.0, self.fade_s, t.min(self.fade_s));
        if t >= self.fade_s { AxisState { q: end.q, w: 0.0, a: 0.0 } } else { end }
    }

    /// Angle at rest in rad.
    #[must_use]
    pub(crate) fn rest_q(&self) -> f64 {
        self.at(self.duration_s()).q
    }
}

/// State after `t` of a smooth change of the acceleration from `from.a` to `to_a` within `time`.
fn faded(from: AxisState, to_a: f64, time: f64, t: f64) -> AxisState {
    if time <= 0.0 {
        return AxisState { a: to_a, ..from };
    }
    let x = t / time;
    let change = to_a - from.a;
    let (s0, s1, s2) = (x * x * (3.0 - 2.0 * x), x * x * x * (1.0 - 0.5 * x), x.powi(4) * (0.25 - 0.1 * x));
    AxisState {
        q: from.q + (from.w + 0.5 * from.a * t) * t + change * time * time * s2,
        w: from.w + from.a * t + change * time * s1,
        a: from.a + change * s0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHARP: RampShape = RampShape { blend_s: 0.0, fade_s: 0.0 };

    #[test]
    fn without_blend_it_is_the_linear_speed_ramp_of_the_paper() {
        // Speed 2 with 4 rad/s²: half a second, half a radian.
        let edge = AxisState { q: 1.0, w: 2.0, a: 30.0 };
        let ramp = Ramp::new(edge, SHARP, Ramp::shortest_cruise_s(edge, SHARP, 4.0));
        assert!((ramp.duration_s() - 0.5).abs() < 1e-15);
        assert!((ramp.rest_q() - 1.5).abs() < 1e-15);
        assert!((ramp.at(0.25).q - (1.0 + 0.5 - 0.125)).abs() < 1e-15);
        assert_eq!(ramp.at(0.2).a, -4.0);
        assert_eq!(ramp.at(0.7), AxisState { q: ramp.rest_q(), w: 0.0, a: 0.0 });
    }

    #[test]
    fn an_axis_at_rest_stays_where_it_is() {
        let edge = AxisState { q: 0.3, w: 0.0, a: 0.0 };
        let ramp = Ramp::new(edge, SHARP, 0.0);
        assert_eq!((ramp.duration_s(), ramp.rest_q()), (0.0, 0.3));
    }

    proptest! {
        #[test]
        fn every_ramp_is_the_integral_of_its_acceleration_and_comes_to_rest(
            w in -3.0..3.0_f64, a in -20.0..20.0_f64, blend_s in 0.0..0.1_f64, fade_s in 0.0..0.1_f64, longer in 0.0..1.0_f64,
        ) {
            let edge = AxisState { q: 0.5, w, a };
            let shape = RampShape { blend_s, fade_s };
            let a_max = 2.1;
            let ramp = Ramp::new(edge, shape, Ramp::shortest_cruise_s(edge, shape, a_max) + longer);
            prop_assert!(ramp.cruise_a.abs() <= a_max * (1.0 + 1e-12));
            // Simpson's rule over steps that end at the joints of the parts.
            let ends = [0.0, blend_s, blend_s + ramp.cruise_s, ramp.duration_s()];
            for pair in ends.windows(2) {
                let h = (pair[1] - pair[0]) / 16.0;
                for k in 0..16 {
                    let s = pair[0] + h * f64::from(k);
                    let [x, m, y] = [s, s + 0.5 * h, s + h].map(|s| ramp.at(s));
                    // The acceleration jumps where a part of no length ends.
                    if h > 1e-9 && s > pair[0] {
                        prop_assert!((y.w - x.w - h / 6.0 * (x.a + 4.0 * m.a + y.a)).abs() < 1e-9);
                        prop_assert!((y.q - x.q - h / 6.0 * (x.w + 4.0 * m.w + y.w)).abs() < 1e-9);
                    }
                }
            }
            let rest = ramp.at(ramp.duration_s() - 1e-12);
            prop_assert!(rest.w.abs() < 1e-9, "still moving: {rest:?}");
        }
    }
}
