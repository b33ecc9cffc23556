//! Joint motion between two states in a given time, as pieces of constant jerk.
//!
//! The acceleration is linear between knots at fixed shares of the time T. It starts at the present acceleration a0, has
//! a level x in the first part and y in the second, and ends at zero:
//!
//! ```text
//!  a ^    x ________                          change of speed  T   (X1 x + Y1 y + C1 a0)
//!    |    /         \                         change of angle  v0 T + T² (X2 x + Y2 y + C2 a0)
//! a0 |---/-----------\-----------------/-->
//!    |                \______________ /  y    X1..C2: integrals of the shape, one table for all T
//! ```
//!
//! Two levels meet two conditions, so each shape gives one motion in closed form. A table of shapes (where x ends, where y
//! begins, how long the ramps are) is tried; the one that uses the limits least is taken.
//!
//! Without a jerk limit the motion with the least peak acceleration has two pieces, +a and -a, with a piece at the highest speed
//! between them where that is passed: [`least_peak`]. The controller takes new end states over by the same law.

use std::array;

/// Limits of one joint. All positive; an infinite jerk is allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Lowest and highest angle, rad.
    pub q_rad: (f64, f64),
    /// Speed, rad/s.
    pub v_rad_s: f64,
    /// Acceleration, rad/s².
    pub a_rad_s2: f64,
    /// Jerk, rad/s³.
    pub j_rad_s3: f64,
}

/// State of one joint.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Angle, rad.
    pub q: f64,
    /// Speed, rad/s.
    pub v: f64,
    /// Acceleration, rad/s².
    pub a: f64,
}

impl State {
    #[must_use]
    pub fn rest(q: f64) -> Self {
        Self { q, v: 0.0, a: 0.0 }
    }
}

const KNOTS: usize = 8;
const PIECES: usize = KNOTS - 1;

/// One shape: shares of T at the knots, and the levels of a0, x and y there.
#[derive(Debug, Clone, Copy)]
struct Shape {
    at: [f64; KNOTS],
    level: [[f64; 3]; KNOTS],
    /// Change of speed per T and level, of angle per T² and level: order a0, x, y.
    speed: [f64; 3],
    angle: [f64; 3],
    /// Inverse of the two conditions: x = inverse\[0\]·(angle, speed), y likewise.
    inverse: [[f64; 2]; 2],
    /// Shortest ramp, as a share of T.
    ramp: f64,
}

impl Shape {
    /// x from 0 to `x_ends`, y from `y_begins` to 1, ramps of `ramp`; where both meet, one ramp of twice the length.
    fn new(x_ends: f64, y_begins: f64, ramp: f64) -> Option<Self> {
        let joined = y_begins <= x_ends;
        let (x_end, y_begin) =
            if joined { (x_ends - ramp, x_ends + ramp) } else { (x_ends - ramp, y_begins + ramp) };
        let (x_zero, y_zero) = if joined { (x_ends, x_ends) } else { (x_ends, y_begins) };
        let at = [0.0, ramp, x_end, x_zero, y_zero, y_begin, 1.0 - ramp, 1.0];
        if at.windows(2).any(|w| w[1] < w[0] - 1e-12) {
            return None;
        }
        let half = if joined { [0.0, 0.5, 0.5] } else { [0.0; 3] };
        let x = [0.0, 1.0, 0.0];
        let y = [0.0, 0.0, 1.0];
        let level = [[1.0, 0.0, 0.0], x, x, half, half, y, y, [0.0; 3]];
        let mut speed = [0.0; 3];
        let mut angle = [0.0; 3];
        for k in 0..3 {
            let (mut v, mut q) = (0.0, 0.0);
            for i in 0..PIECES {
                let h = at[i + 1] - at[i];
                let (a, b) = (level[i][k], level[i + 1][k]);
                q += v * h + h * h * (2.0 * a + b) / 6.0;
                v += h * 0.5 * (a + b);
            }
            (speed[k], angle[k]) = (v, q);
        }
        let determinant = angle[1] * speed[2] - angle[2] * speed[1];
        let inverse = [
            [speed[2] / determinant, -angle[2] / determinant],
            [-speed[1] / determinant, angle[1] / determinant],
        ];
        (determinant.abs() > 1e-9).then_some(Self { at, level, speed, angle, inverse, ramp })
    }

    fn accelerations(&self, a0: f64, x: f64, y: f64) -> [f64; KNOTS] {
        array::from_fn(|i| self.level[i][0] * a0 + self.level[i][1] * x + self.level[i][2] * y)
    }

    /// Largest change of the acceleration in the time of a ramp. Between two levels that meet, the ramp is twice as long.
    fn change(&self, a0: f64, x: f64, y: f64) -> f64 {
        let met = self.at[3] == self.at[4];
        (x - a0).abs().max(y.abs()).max(if met { 0.5 * (y - x).abs() } else { x.abs() })
    }

    /// Largest speed on the way.
    fn peak_speed(&self, from: &State, x: f64, y: f64, t_s: f64) -> f64 {
        let a = self.accelerations(from.a, x, y);
        let mut v = from.v;
        let mut peak = v.abs();
        for i in 0..PIECES {
            let h = (self.at[i + 1] - self.at[i]) * t_s;
            if a[i] * a[i + 1] < 0.0 {
                // The acceleration passes zero: an extreme of the speed.
                peak = peak.max((v + 0.5 * h * a[i] * a[i] / (a[i] - a[i + 1])).abs());
            }
            v += 0.5 * h * (a[i] + a[i + 1]);
            peak = peak.max(v.abs());
        }
        peak
    }
}

/// How a motion is made.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// Shape of the table, with its two levels.
    Levels { shape: usize, x: f64, y: f64 },
    /// Up to three pieces of constant acceleration: duration and acceleration.
    Steps([(f64, f64); 3]),
}

/// A motion to a state that the limits allow, and the largest share of an acceleration or jerk limit that it uses, 0..=1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    form: Form,
    /// Largest share.
    pub used: f64,
}

/// The motion from `from` to `q`, `v` in exactly `t_s` with the least peak acceleration: two pieces of constant acceleration, and one at
/// the highest speed `v_max_rad_s` between them where they would pass it. Returns the peak (rad/s²), and duration (s) and acceleration of each piece;
/// `None`: at that speed the joint comes
/// too late, or there is no time.
#[must_use]
pub fn steps(from: &State, q: f64, v: f64, t_s: f64, v_max_rad_s: f64) -> Option<(f64, [(f64, f64); 3])> {
    if t_s.is_nan() || t_s <= 0.0 {
        return None;
    }
    let (v0, way) = (from.v, q - from.q);
    let excess = way - 0.5 * (v0 + v) * t_s;
    let change = v - v0;
    let a = (2.0 * excess + (4.0 * excess * excess + t_s * t_s * change * change).sqrt().copysign(excess))
        / (t_s * t_s);
    let v_switch = 0.5 * (v0 + v + a * t_s);
    let (a, pieces) = if v_switch.abs() <= v_max_rad_s {
        let first = if a == 0.0 { 0.5 * t_s } else { (0.5 * (t_s + change / a)).clamp(0.0, t_s) };
        (a.abs(), [(first, a), (0.0, 0.0), (t_s - first, -a)])
    } else {
        let top = v_max_rad_s.copysign(v_switch);
        let (before, after, room) = (top - v0, top - v, top * t_s - way);
        let a = (before * before + after * after) / (2.0 * room.abs());
        let fits = room * top > 0.0 && a > 0.0;
        if !fits {
            return None;
        }
        let (first, last) = (before.abs() / a, after.abs() / a);
        // Rounded away where there is no time at the highest speed.
        let between = t_s - first - last;
        let between = if between > -1e-12 { between.max(0.0) } else { between };
        (a, [(first, a.copysign(before)), (between, 0.0), (last, -a.copysign(after))])
    };
    pieces.iter().all(|(h, _)| *h >= 0.0).then_some((a, pieces))
}

/// The law, with its table of shapes if jerk is limited.
#[derive(Debug, Clone)]
pub struct MotionLaw {
    shapes: Vec<Shape>,
    jerk: bool,
}

impl MotionLaw {
    /// With ramps for a limited jerk, or without.
    #[must_use]
    pub fn new(jerk: bool) -> Self {
        let ramps: &[f64] = if jerk { &[0.04, 0.08, 0.13, 0.19, 0.25] } else { &[] };
        let mut shapes = Vec::new();
        for ramp in ramps {
            for switch in [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8] {
                shapes.extend(Shape::new(switch, switch, *ramp));
            }
            for (x_ends, y_begins) in
                [(0.35, 0.65), (0.2, 0.8), (0.2, 0.5), (0.5, 0.8), (0.1, 0.9), (0.12, 0.6), (0.4, 0.88)]
            {
                shapes.extend(Shape::new(x_ends, y_begins, *ramp));
            }
        }
        Self { shapes, jerk }
    }

    /// Whether jerk is limited.
    #[must_use]
    pub fn limits_jerk(&self) -> bool {
        self.jerk
    }

    /// The motion from `from` to angle `q` and speed `v` in exactly `t_s` that uses the limits least; `None` if every shape passes
    /// a limit of speed, acceleration or jerk. Ranges are not looked at: see [`Pieces::extremes`].
    #[must_use]
    #[inline]
    pub fn fit(&self, limits: &Limits, from: &State, q: f64, v: f64, t_s: f64) -> Option<Fit> {
        let possible = t_s > 1e-4 && v.abs() <= limits.v_rad_s;
        if !possible {
            return None;
        }
        if !self.jerk {
            let (a, pieces) = steps(from, q, v, t_s, limits.v_rad_s)?;
            let used = a / limits.a_rad_s2;
            return (used <= 1.0 + 1e-12).then_some(Fit { form: Form::Steps(pieces), used });
        }
        let want_angle = (q - from.q - from.v * t_s) / (t_s * t_s);
        let want_speed = (v - from.v) / t_s;
        let per_a = 1.0 / limits.a_rad_s2;
        let per_j = 1.0 / (limits.j_rad_s3 * t_s);
        let mut best: Option<Fit> = None;
        let mut bound = 1.0 + 1e-12;
        for (index, shape) in self.shapes.iter().enumerate() {
            let d = want_angle - shape.angle[0] * from.a;
            let e = want_speed - shape.speed[0] * from.a;
            let x = shape.inverse[0][0] * d + shape.inverse[0][1] * e;
            let y = shape.inverse[1][0] * d + shape.inverse[1][1] * e;
            let change = shape.change(from.a, x, y);
            let used = (x.abs().max(y.abs()) * per_a).max(change * per_j / shape.ramp);
            if used < bound && shape.peak_speed(from, x, y, t_s) <= limits.v_rad_s * (1.0 + 1e-9) {
                bound = used;
                best = Some(Fit { form: Form::Levels { shape: index, x, y }, used });
            }
        }
        best
    }

    /// Shortest time of a motion from rest to rest that [`Self::fit`] finds, s.
    #[must_use]
    pub fn rest_to_rest_s(&self, limits: &Limits, distance_rad: f64) -> f64 {
        let d = distance_rad.abs();
        let (v, a, j) = (limits.v_rad_s, limits.a_rad_s2, limits.j_rad_s3);
        if !self.jerk {
            return if d * a <= v * v { 2.0 * (d / a).sqrt() } else { d / v + v / a };
        }
        let times = self.shapes.iter().map(|shape| {
            // Levels for 1 rad in 1 s.
            let [x, y] = shape.inverse.map(|row| row[0]);
            let speed = shape.peak_speed(&State::default(), x, y, 1.0);
            let jerk = shape.change(0.0, x, y) / shape.ramp;
            (speed * d / v).max((x.abs().max(y.abs()) * d / a).sqrt()).max((jerk * d / j).cbrt())
        });
        times.fold(f64::INFINITY, f64::min)
    }

    /// How many times the limits of acceleration and jerk the motion of [`Self::fit`] would need at least; infinite if the speed does not suffice
    /// without a limit of jerk.
    #[must_use]
    pub fn needed(&self, limits: &Limits, from: &State, q: f64, v: f64, t_s: f64) -> f64 {
        if !self.jerk {
            return steps(from, q, v, t_s, limits.v_rad_s)
                .map_or(f64::INFINITY, |(a, _)| a / limits.a_rad_s2);
        }
        let wide = Limits { a_rad_s2: 1e3 * limits.a_rad_s2, j_rad_s3: 1e3 * limits.j_rad_s3, ..*limits };
        self.fit(&wide, from, q, v, t_s).map_or(1e3, |fit| 1e3 * fit.used)
    }

    /// Appends the motion of a fit.
    pub fn append(&self, fit: &Fit, t_s: f64, pieces: &mut Pieces) {
        match fit.form {
            Form::Levels { shape, x, y } => {
                let shape = &self.shapes[shape];
                let a = shape.accelerations(pieces.end().a, x, y);
                for i in 0..PIECES {
                    let h = (shape.at[i + 1] - shape.at[i]) * t_s;
                    if h > 1e-12 {
                        pieces.push(h, a[i], a[i + 1]);
                    }
                }
            }
            Form::Steps(steps) => {
                for (h, a) in steps {
                    pieces.push(h, a, a);
                }
            }
        }
    }

    /// Appends a stop as fast as the limits allow.
    pub fn append_stop(&self, limits: &Limits, pieces: &mut Pieces) {
        let State { a, .. } = pieces.end();
        if !self.jerk {
            let v = pieces.end().v;
            if v != 0.0 {
                let brake = -v.signum() * limits.a_rad_s2;
                pieces.push(v.abs() / limits.a_rad_s2, brake, brake);
            }
            pieces.rest();
            return;
        }
        if a != 0.0 {
            pieces.push(a.abs() / limits.j_rad_s3, a, 0.0);
        }
        let v = pieces.end().v;
        if v != 0.0 {
            let peak = limits.a_rad_s2.min((v.abs() * limits.j_rad_s3).sqrt());
            let ramp = peak / limits.j_rad_s3;
            let hold = (v.abs() - peak * ramp).max(0.0) / peak;
            let brake = -v.signum() * peak;
            pieces.push(ramp, 0.0, brake);
            if hold > 0.0 {
                pieces.push(hold, brake, brake);
            }
            pieces.push(ramp, brake, 0.0);
        }
        pieces.rest();
    }
}

/// Most pieces of one motion: a move, a stop.
const PIECES_MAX: usize = 16;

/// Motion of one joint: pieces of constant jerk one after the other, then standing still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pieces {
    /// Duration of each piece and the state at its begin; jerk from the next acceleration.
    pieces: [(f64, State, f64); PIECES_MAX],
    len: usize,
    end: State,
}

impl Pieces {
    /// Nothing yet, at a state.
    #[must_use]
    pub fn starting(at: State) -> Self {
        Self { pieces: [(0.0, State::default(), 0.0); PIECES_MAX], len: 0, end: at }
    }

    /// A piece of `h_s` whose acceleration goes from `a` to `b`.
    fn push(&mut self, h_s: f64, a: f64, b: f64) {
        if self.len == PIECES_MAX || h_s <= 0.0 {
            return;
        }
        let from = State { a, ..self.end };
        self.pieces[self.len] = (h_s, from, (b - a) / h_s);
        self.len += 1;
        self.end = State {
            q: from.q + h_s * from.v + h_s * h_s * (2.0 * a + b) / 6.0,
            v: from.v + 0.5 * h_s * (a + b),
            a: b,
        };
    }

    /// Appends a time at constant speed.
    pub fn coast(&mut self, h_s: f64) {
        self.push(h_s, 0.0, 0.0);
    }

    /// Rounding errors of a stop go: it ends at rest.
    fn rest(&mut self) {
        self.end.v = 0.0;
        self.end.a = 0.0;
    }

    /// State at the end.
    #[must_use]
    pub fn end(&self) -> State {
        self.end
    }

    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.pieces[..self.len].iter().map(|p| p.0).sum()
    }

    /// State `t_s` after the start; the first state before it, the last after the end.
    #[must_use]
    pub fn at(&self, t_s: f64) -> State {
        let mut left = t_s.max(0.0);
        for (h, from, jerk) in &self.pieces[..self.len] {
            if left <= *h {
                return State {
                    q: from.q + left * (from.v + left * (0.5 * from.a + left * jerk / 6.0)),
                    v: from.v + left * (from.a + 0.5 * left * jerk),
                    a: from.a + left * jerk,
                };
            }
            left -= h;
        }
        self.end
    }

    /// Duration, first state and jerk of each piece.
    pub fn iter(&self) -> impl Iterator<Item = (f64, State, f64)> + '_ {
        self.pieces[..self.len].iter().copied()
    }

    /// Lowest and highest angle on the way, exactly.
    #[must_use]
    pub fn extremes(&self) -> (f64, f64) {
        let mut low = self.end.q;
        let mut high = self.end.q;
        let mut see = |q: f64| {
            low = low.min(q);
            high = high.max(q);
        };
        for (h, from, jerk) in &self.pieces[..self.len] {
            see(from.q);
            // v + a t + j t²/2 = 0
            let roots = if jerk.abs() < 1e-9 {
                [-from.v / from.a, f64::NAN]
            } else {
                let under = from.a * from.a - 2.0 * jerk * from.v;
                let root = under.max(0.0).sqrt();
                if under < 0.0 { [f64::NAN; 2] } else { [(-from.a + root) / jerk, (-from.a - root) / jerk] }
            };
            for t in roots {
                if t > 0.0 && t < *h {
                    see(from.q + t * (from.v + t * (0.5 * from.a + t * jerk / 6.0)));
                }
            }
        }
        (low, high)
    }
}

/// Angle that a joint goes on to while it stops from speed `v` without acceleration, rad, signed.
#[must_use]
#[inline]
pub fn stopping_angle(limits: &Limits, jerk: bool, v: f64) -> f64 {
    let speed = v.abs();
    let time_s = if !jerk {
        speed / limits.a_rad_s2
    } else {
        let ramp = limits.a_rad_s2 / limits.j_rad_s3;
        if speed >= limits.a_rad_s2 * ramp {
            ramp + speed / limits.a_rad_s2
        } else {
            2.0 * (speed / limits.j_rad_s3).sqrt()
        }
    };
    0.5 * v * time_s
}

/// Least peak acceleration of any motion from `from` to `q`, `v` in `t_s`, without a limit of jerk or speed, rad/s²:
/// two pieces, a = \[2D + sgn(D) sqrt(4D² + T²E²)\] / T² with D = q - q0 - (v0 + v)T/2 and E = v - v0. A bound from below for every
/// motion of [`MotionLaw::fit`], whatever its first acceleration.
#[must_use]
#[inline]
pub fn least_peak(from: &State, q: f64, v: f64, t_s: f64) -> f64 {
    let d = q - from.q - 0.5 * (from.v + v) * t_s;
    let e = v - from.v;
    (2.0 * d.abs() + (4.0 * d * d + t_s * t_s * e * e).sqrt()) / (t_s * t_s)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMITS: Limits = Limits { q_rad: (-3.0, 3.0), v_rad_s: 2.6, a_rad_s2: 10.4, j_rad_s3: 104.0 };

    fn moved(law: &MotionLaw, limits: &Limits, from: State, q: f64, v: f64, t_s: f64) -> Option<Pieces> {
        let fit = law.fit(limits, &from, q, v, t_s)?;
        let mut pieces = Pieces::starting(from);
        law.append(&fit, t_s, &mut pieces);
        Some(pieces)
    }

    /// The reference numbers of the two-piece law: d = 1, v0 = 0, vf = 1, T = 1.
    #[test]
    fn least_peak_has_the_reference_value() {
        assert!((least_peak(&State::default(), 1.0, 1.0, 1.0) - 2.414).abs() < 5e-4);
        assert!((least_peak(&State::default(), 1.0, 0.0, 1.0) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn without_a_jerk_limit_the_motion_has_the_least_peak() {
        let law = MotionLaw::new(false);
        let wide = Limits { v_rad_s: 100.0, a_rad_s2: 1.0, j_rad_s3: f64::INFINITY, ..LIMITS };
        for (q, v) in [(1.0, 0.0), (1.0, 1.0), (0.3, -0.8), (-0.5, 1.0)] {
            let from = State::default();
            let least = least_peak(&from, q, v, 1.0);
            let limits = Limits { a_rad_s2: 10.0 * least, ..wide };
            let fit = law.fit(&limits, &from, q, v, 1.0).unwrap();
            let over = fit.used * 10.0;
            assert!((over - 1.0).abs() < 1e-9, "({q}, {v}): {over} times the least peak");
        }
    }

    fn within(pieces: &Pieces, limits: &Limits, jerk: bool) -> Result<(), String> {
        let mut last = None;
        for (h, from, j) in pieces.iter() {
            let end = State { q: 0.0, v: from.v + h * (from.a + 0.5 * h * j), a: from.a + h * j };
            for s in [from, end] {
                if s.a.abs() > limits.a_rad_s2 * (1.0 + 1e-9) || s.v.abs() > limits.v_rad_s * (1.0 + 1e-9) {
                    return Err(format!("{s:?}"));
                }
            }
            if jerk && j.abs() > limits.j_rad_s3 * (1.0 + 1e-6) {
                return Err(format!("jerk {j}"));
            }
            if jerk && last.is_some_and(|a: f64| (a - from.a).abs() > 1e-9) {
                return Err("a jump of the acceleration".to_owned());
            }
            last = Some(end.a);
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn a_motion_ends_where_it_shall_and_keeps_every_limit(
            q in -1.5..1.5_f64, v in -2.0..2.0_f64, v0 in -2.0..2.0_f64, a0 in -8.0..8.0_f64, t_s in 0.1..1.0_f64,
            jerk in any::<bool>(),
        ) {
            let law = MotionLaw::new(jerk);
            let from = State { q: 0.2, v: v0, a: a0 };
            if let Some(mut pieces) = moved(&law, &LIMITS, from, q, v, t_s) {
                let end = pieces.end();
                prop_assert!((end.q - q).abs() < 1e-9 && (end.v - v).abs() < 1e-9, "{end:?}");
                prop_assert!((pieces.duration_s() - t_s).abs() < 1e-9);
                let by_stop = stopping_angle(&LIMITS, jerk, v);
                law.append_stop(&LIMITS, &mut pieces);
                prop_assert!((pieces.end().q - q - by_stop).abs() < 1e-9, "{} {by_stop}", pieces.end().q - q);
                prop_assert!(pieces.end().v == 0.0);
                prop_assert!(within(&pieces, &LIMITS, jerk).is_ok(), "{:?}", within(&pieces, &LIMITS, jerk));
                let (low, high) = pieces.extremes();
                for k in 0..=200 {
                    let q = pieces.at(pieces.duration_s() * f64::from(k) / 200.0).q;
                    prop_assert!(q >= low - 1e-9 && q <= high + 1e-9);
                }
            }
        }

        #[test]
        fn a_motion_exists_if_a_share_of_the_limits_would_do(
            q in -0.4..0.4_f64, v in -1.0..1.0_f64, v0 in -1.0..1.0_f64, t_s in 0.45..0.8_f64,
        ) {
            let from = State { q: 0.0, v: v0, a: 0.0 };
            if least_peak(&from, q, v, t_s) < 4.0 {
                prop_assert!(moved(&MotionLaw::new(true), &LIMITS, from, q, v, t_s).is_some());
                prop_assert!(moved(&MotionLaw::new(false), &LIMITS, from, q, v, t_s).is_some());
            }
        }
    }

    proptest! {
        #[test]
        fn the_shortest_time_from_rest_to_rest_is_the_shortest_that_is_found(d in 0.01..2.5_f64, jerk in any::<bool>()) {
            let law = MotionLaw::new(jerk);
            let shortest_s = law.rest_to_rest_s(&LIMITS, -d);
            for (share, fits) in [(0.99, false), (1.0 + 1e-9, true), (1.5, true)] {
                let t_s = share * shortest_s;
                let found = law.fit(&LIMITS, &State::default(), -d, 0.0, t_s);
                prop_assert_eq!(found.is_some(), fits, "{} of {} s", share, shortest_s);
                let needed = law.needed(&LIMITS, &State::default(), -d, 0.0, t_s);
                prop_assert!((needed <= 1.0 + 1e-6) == fits, "{}", needed);
            }
        }
    }

    #[test]
    fn too_little_time_is_refused() {
        let from = State::default();
        assert!(moved(&MotionLaw::new(false), &LIMITS, from, 1.0, 0.0, 0.3).is_none());
        assert!(moved(&MotionLaw::new(true), &LIMITS, from, 0.1, 0.0, 0.0).is_none());
        assert!(moved(&MotionLaw::new(true), &LIMITS, from, 0.1, f64::NAN, 0.3).is_none());
    }
}
