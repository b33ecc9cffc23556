//! Whether a ball that enters the cup stays in it.
//!
//! ```text
//! between contacts    p'' = -g e_z
//! contact             J_n = (1 + e) (-u.n), the slip is stopped by at most mu J_n; spin from rest
//! stays               the energy against the cup does not lift the ball to the mouth any more: u²/2 < g_least (-z)
//! lost                beyond the rim
//! ```
//!
//! The cup moves as its hand does, the stop after the catch included: a hand that slows down presses the ball to the bottom. u is the
//! velocity of the ball against the cup, z its height above the mouth, g_least the least acceleration that presses it to the bottom from
//! then on. A ball steps from one surface to the next: as far as it can fly before it may touch one.
//!
//! [`StayTable`] has the chance for a cup that does not turn, by speed, angle and pressing acceleration: for the thousands of
//! candidates of a search. The few that are checked are judged with the motion of their hand.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::arm::CatchArm;
use super::cup::Cup;
use super::edge::{AROUND, BETWEEN_RAD, around};
use super::forecast::across;
use super::motion::CatchMotion;

/// The ball is followed for this long after the catch, s, and for so many steps at most.
const FOLLOWED_S: f64 = 1.0;
const STEPS_MAX: usize = 2000;
/// Shortest and longest step, s: 2 mm of a ball with 4 m/s; 0.1 mm by gravity.
const STEP_S: (f64, f64) = (5e-4, 5e-3);
/// Share of the energy that the mouth asks for below which a ball stays: the turning of the hand adds a little.
const SURE: f64 = 0.9;
/// Time between two knots of the cup's path, s.
const KNOT_S: f64 = 0.01;

/// The cup at one time.
#[derive(Debug, Clone, Copy)]
pub(super) struct CupNow {
    /// Middle of the mouth, m.
    pub(super) mouth_m: Vector3<f64>,
    /// Unit vector out of the cup.
    pub(super) axis: Vector3<f64>,
    /// Velocity of the middle of the mouth, m/s.
    pub(super) v_m_s: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub(super) w_rad_s: Vector3<f64>,
}

/// The cup from the catch on, until its hand stands.
pub(super) struct CupPath {
    knots: Vec<CupNow>,
    /// Least acceleration that presses a ball to the bottom from each knot on, m/s².
    pressing_m_s2: Vec<f64>,
    gravity_m_s2: f64,
}

impl CupPath {
    fn new(knots: Vec<CupNow>, gravity_m_s2: f64) -> Self {
        let mut least = f64::INFINITY;
        let mut pressing_m_s2: Vec<f64> = (0..knots.len())
            .rev()
            .map(|k| {
                let next = knots.get(k + 1).unwrap_or(&knots[k]);
                let a = (next.v_m_s - knots[k].v_m_s) / KNOT_S;
                least = least.min(knots[k].axis.dot(&(a + Vector3::z() * gravity_m_s2)));
                least
            })
            .collect();
        pressing_m_s2.reverse();
        Self { knots, pressing_m_s2, gravity_m_s2 }
    }

    /// The hand of a motion from `catch_s` on.
    pub(super) fn of(arm: &CatchArm, motion: &CatchMotion, catch_s: f64) -> Self {
        let after_s = (motion.end_s() - catch_s).clamp(0.0, FOLLOWED_S);
        let steps = (after_s / KNOT_S).ceil() as usize;
        let at = |k: usize| {
            let (q, qd) = motion.joints_at(catch_s + KNOT_S * k as f64);
            arm.cup_at(&q, &qd)
        };
        Self::new((0..=steps).map(at).collect(), arm.model().world().gravity_m_s2)
    }

    fn at(&self, t_s: f64) -> (CupNow, f64) {
        let last = self.knots.len() - 1;
        let k = ((t_s / KNOT_S) as usize).min(last);
        let pressing = self.pressing_m_s2[k];
        let a = &self.knots[k];
        let Some(b) = self.knots.get(k + 1) else { return (*a, pressing) };
        let tau_s = t_s - KNOT_S * k as f64;
        let s = tau_s / KNOT_S;
        let now = CupNow {
            mouth_m: a.mouth_m + a.v_m_s * tau_s + (b.v_m_s - a.v_m_s) * (0.5 * tau_s * s),
            axis: (a.axis + (b.axis - a.axis) * s).normalize(),
            v_m_s: a.v_m_s + (b.v_m_s - a.v_m_s) * s,
            w_rad_s: a.w_rad_s + (b.w_rad_s - a.w_rad_s) * s,
        };
        (now, pressing)
    }
}

/// A ball in the cup: centre (m), velocity (m/s), spin (rad/s).
struct Inside {
    p_m: Vector3<f64>,
    v_m_s: Vector3<f64>,
    spin_rad_s: Vector3<f64>,
}

impl Inside {
    /// Takes a contact with a surface of this velocity; `normal` leads from it to the ball.
    fn bounce(&mut self, cup: &Cup, normal: &Vector3<f64>, surface_m_s: &Vector3<f64>) {
        let (ball, contact) = (&cup.ball, &cup.contact);
        let lever = normal * -ball.radius_m;
        let against = self.v_m_s + self.spin_rad_s.cross(&lever) - surface_m_s;
        let approach = -against.dot(normal);
        if approach <= 0.0 {
            return;
        }
        let e = if approach > contact.rest_m_s { contact.restitution } else { 0.0 };
        let pressed = (1.0 + e) * approach;
        // What stops the slip of a ball that may turn.
        let sticking = (against + normal * approach) * (-ball.inertia / (1.0 + ball.inertia));
        let rubbed = sticking * (contact.friction * pressed / sticking.norm().max(1e-12)).min(1.0);
        self.v_m_s += normal * pressed + rubbed;
        self.spin_rad_s += lever.cross(&rubbed) / (ball.inertia * ball.radius_m * ball.radius_m);
        let rolled = contact.rolling * pressed;
        let mut along = self.v_m_s - surface_m_s;
        along -= normal * along.dot(normal);
        self.v_m_s -= along * (rolled / along.norm().max(1e-12)).min(1.0);
        let rim = self.spin_rad_s.norm() * ball.radius_m;
        self.spin_rad_s *= 1.0 - (rolled / rim.max(1e-12)).min(1.0);
    }
}

/// Whether a ball whose centre is at `p_m` with `v_m_s` at the start of the path stays in the cup.
fn stays(cup: &Cup, path: &CupPath, p_m: Vector3<f64>, v_m_s: Vector3<f64>) -> bool {
    let g = Vector3::z() * path.gravity_m_s2;
    let (radius, half) = (cup.ball.radius_m, 0.5 * cup.wall_m);
    let mut ball = Inside { p_m, v_m_s, spin_rad_s: Vector3::zeros() };
    let mut t_s = 0.0;
    let mut within = false;
    for _ in 0..STEPS_MAX {
        let (now, pressing_m_s2) = path.at(t_s);
        let from_mouth = ball.p_m - now.mouth_m;
        let z = from_mouth.dot(&now.axis);
        let off = from_mouth - now.axis * z;
        let rho = off.norm();
        if rho > cup.outer_radius_m() || (z < -half && rho > cup.inner_radius_m) {
            return false;
        }
        within = z < 0.0;
        let surface = |at: &Vector3<f64>| now.v_m_s + now.w_rad_s.cross(at);
        let against = ball.v_m_s - surface(&from_mouth);
        if within && 0.5 * against.norm_squared() < -SURE * pressing_m_s2 * z {
            return true;
        }
        if t_s > FOLLOWED_S {
            break;
        }
        let radial = if rho > 1e-9 { off / rho } else { across(&now.axis).0 };
        // Bottom; and wall, or its rounded rim.
        let bottom = (z + cup.depth_m - radius, now.axis);
        let from_rim = from_mouth - radial * (cup.inner_radius_m + half) + now.axis * half;
        let wall = if z < -half {
            (cup.inner_radius_m - radius - rho, -radial)
        } else {
            let distance = from_rim.norm().max(1e-9);
            (distance - half - radius, from_rim / distance)
        };
        let mut gap_m = f64::INFINITY;
        for (gap, normal) in [wall, bottom] {
            gap_m = gap_m.min(gap);
            if gap < 0.0 {
                ball.p_m -= normal * gap;
                ball.bounce(cup, &normal, &surface(&(from_mouth - normal * radius)));
            }
        }
        let h = (gap_m / against.norm().max(1e-9)).clamp(STEP_S.0, STEP_S.1);
        ball.p_m += ball.v_m_s * h - g * (0.5 * h * h);
        ball.v_m_s -= g * h;
        t_s += h;
    }
    within
}

/// Which flights about the mean are followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Flights {
    /// To choose a candidate.
    Choosing,
    /// To say how likely the chosen one is. They lie between the flights that chose it. Those would say too much: the candidate was chosen
    /// because it keeps just them.
    Judging,
}

/// Chance that a ball stays in the cup that is at `off_m` beside the middle of the mouth with `v_m_s` at the start of the path, by a
/// normal distribution of `sigma_m` across its flight. A ball that misses the cup does not stay.
pub(super) fn chance_to_stay(
    cup: &Cup,
    path: &CupPath,
    (off_m, v_m_s): (Vector3<f64>, &Vector3<f64>),
    sigma_m: f64,
    flights: Flights,
) -> f64 {
    let p_m = path.knots[0].mouth_m + off_m;
    let (a, b) = across(&v_m_s.normalize());
    let (sin, cos) = if flights == Flights::Judging { BETWEEN_RAD.sin_cos() } else { (0.0, 1.0) };
    let (a, b) = (a * cos + b * sin, b * cos - a * sin);
    let stay = around().filter(|(x, y)| stays(cup, path, p_m + (a * *x + b * *y) * sigma_m, *v_m_s));
    stay.count() as f64 / AROUND as f64
}

/// Acceleration with which the table is made, m/s²; for another one speeds are scaled.
const TABLE_M_S2: f64 = 9.81;
/// Step and number of speeds, m/s; of angles between axis and reverse of the relative velocity, rad (the rings of a search); of tilts
/// of the axis against the pressing acceleration, rad; of turns between both about the axis, rad.
const SPEEDS: (f64, usize) = (0.4, 16);
const ANGLES: (f64, usize) = (26.0 / 3.0 * PI / 180.0, 4);
const TILTS: (f64, usize) = (15.0 * PI / 180.0, 6);
const TURNS: (f64, usize) = (0.5 * PI, 3);
/// No ball stays at so many speeds one after the other: none of a higher one does.
const LOST: usize = 3;
/// Spread of the ball about the axis with which the table is made, m.
const TABLE_SIGMA_M: f64 = 0.004;

/// Chance that a ball stays in a cup that does not turn.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StayTable {
    chances: Vec<f32>,
}

impl StayTable {
    pub(super) fn new(cup: &Cup) -> Self {
        let mut chances = Vec::with_capacity(SPEEDS.1 * ANGLES.1 * TILTS.1 * TURNS.1);
        for angle in 0..ANGLES.1 {
            for tilt in 0..TILTS.1 {
                for turn in 0..TURNS.1 {
                    let (sin, cos) = (TILTS.0 * tilt as f64).sin_cos();
                    let axis = Vector3::new(sin, 0.0, cos);
                    let lower = Vector3::new(cos, 0.0, -sin);
                    let side = Vector3::y();
                    let (turn_sin, turn_cos) = (TURNS.0 * turn as f64).sin_cos();
                    let (angle_sin, angle_cos) = (ANGLES.0 * angle as f64).sin_cos();
                    let along = axis * -angle_cos + (lower * turn_cos + side * turn_sin) * angle_sin;
                    let zero = Vector3::zeros();
                    let still = CupNow { mouth_m: zero, axis, v_m_s: zero, w_rad_s: zero };
                    let path = CupPath::new(vec![still], TABLE_M_S2);
                    let mut lost = 0;
                    chances.extend((0..SPEEDS.1).map(|speed| {
                        if lost == LOST {
                            return 0.0;
                        }
                        let v_m_s = along * (SPEEDS.0 * (speed + 1) as f64);
                        let chance =
                            chance_to_stay(cup, &path, (zero, &v_m_s), TABLE_SIGMA_M, Flights::Choosing)
                                as f32;
                        lost = if chance == 0.0 { lost + 1 } else { 0 };
                        chance
                    }));
                }
            }
        }
        Self { chances }
    }

    /// Chance for a ball with `relative_m_s` against a cup that opens along `axis`, which presses it with `pressing_m_s2`: the
    /// acceleration of the hand less that of gravity.
    pub(super) fn chance(
        &self,
        relative_m_s: &Vector3<f64>,
        axis: &Vector3<f64>,
        pressing_m_s2: &Vector3<f64>,
    ) -> f64 {
        let (speed, pressing) = (relative_m_s.norm(), pressing_m_s2.norm().max(1e-3));
        let (along, down) = (-relative_m_s.dot(axis), pressing_m_s2.dot(axis));
        let (off, low) = (relative_m_s + axis * along, axis * down - pressing_m_s2);
        let cos = off.dot(&low) / (off.norm() * low.norm()).max(1e-9);
        let places = [
            place(off.norm().atan2(along), ANGLES),
            place(low.norm().atan2(down), TILTS),
            place(cos.clamp(-1.0, 1.0).acos(), TURNS),
            place(speed * (TABLE_M_S2 / pressing).sqrt() - SPEEDS.0, SPEEDS),
        ];
        let mut chance = 0.0;
        for corner in 0..16_usize {
            let (mut at, mut weight) = (0, 1.0);
            for (i, (low, share, number)) in places.iter().enumerate() {
                let upper = corner >> i & 1;
                at = at * number + (low + upper).min(number - 1);
                weight *= if upper == 1 { *share } else { 1.0 - share };
            }
            if weight > 0.0 {
                chance += weight * f64::from(self.chances[at]);
            }
        }
        chance
    }
}

/// Grid point below a value, how far it is to the next one, number of points.
fn place(value: f64, (step, number): (f64, usize)) -> (usize, f64, usize) {
    let at = (value / step).clamp(0.0, (number - 1) as f64);
    let low = at as usize;
    (low, at - low as f64, number)
}

#[cfg(test)]
mod tests {
    use super::super::cup::{Ball, Contact};
    use super::*;

    fn cup(restitution: f64) -> Cup {
        Cup {
            mouth_m: 0.05,
            inner_radius_m: 0.07,
            depth_m: 0.09,
            wall_m: 0.006,
            replaces: Vec::new(),
            ball: Ball { radius_m: 0.03, inertia: 0.4 },
            contact: Contact { restitution, friction: 0.5, rolling: 0.1, rest_m_s: 0.1 },
        }
    }

    /// Opens 40 degrees beside the vertical.
    fn axis() -> Vector3<f64> {
        let (sin, cos) = 40.0_f64.to_radians().sin_cos();
        Vector3::new(sin, 0.0, cos)
    }

    /// A cup that moves to its bottom with `v_m_s` and slows down with `a_m_s2`.
    fn slowing(v_m_s: f64, a_m_s2: f64) -> CupPath {
        let knots = (0..=20).map(|k| {
            let t_s = (KNOT_S * f64::from(k)).min(v_m_s / a_m_s2);
            let way_m = v_m_s * t_s - 0.5 * a_m_s2 * t_s * t_s;
            let v_m_s = axis() * (a_m_s2 * t_s - v_m_s);
            CupNow { mouth_m: axis() * -way_m, axis: axis(), v_m_s, w_rad_s: Vector3::zeros() }
        });
        CupPath::new(knots.collect(), 9.81)
    }

    /// Along the axis gravity is g = 7.5 m/s2. The ball meets the bottom with v² + 2 g L, L = 60 mm, and rises by e² times that over 2 g: to the
    /// mouth for v = 1.64 m/s and e = 0.5. What rises higher falls over the lower rim.
    #[test]
    fn a_ball_leaves_a_cup_at_rest_once_its_bounce_lifts_it_over_the_rim() {
        let mut cup = cup(0.5);
        (cup.contact.friction, cup.contact.rolling) = (0.0, 0.0);
        let thrown = |v_m_s: f64| stays(&cup, &slowing(0.0, 1.0), Vector3::zeros(), axis() * -v_m_s);
        let stay: Vec<bool> = [0.8, 1.2, 1.55, 2.4, 3.0, 4.0].map(thrown).to_vec();
        assert_eq!(stay, [true, true, true, false, false, false]);
    }

    /// A hand that slows down with 15 m/s² presses the ball to the bottom with 22 m/s² instead of 7.5.
    #[test]
    fn a_hand_that_slows_down_keeps_a_ball_that_leaves_a_hand_at_rest() {
        let chance = |path: &CupPath, hand_m_s: f64| {
            let v_m_s = axis() * -(2.5 + hand_m_s);
            chance_to_stay(&cup(0.5), path, (Vector3::zeros(), &v_m_s), 0.004, Flights::Choosing)
        };
        assert_eq!(chance(&slowing(2.0, 15.0), 2.0), 1.0);
        assert_eq!(chance(&slowing(0.0, 1.0), 0.0), 0.0);
    }

    /// The rounding of the rim has its middle 73 mm beside the axis: what comes farther out is thrown outwards.
    #[test]
    fn a_ball_stays_with_the_share_of_its_flights_that_come_inside_the_rim() {
        let beside = |off_m: f64, flights: Flights| {
            let comes = (Vector3::y() * off_m, &(axis() * -2.0));
            chance_to_stay(&cup(0.15), &slowing(0.0, 1.0), comes, 0.004, flights)
        };
        for flights in [Flights::Choosing, Flights::Judging] {
            assert_eq!([0.0, 0.03, 0.09].map(|off_m| beside(off_m, flights)), [1.0, 1.0, 0.0]);
            let half = beside(0.073, flights);
            assert!((0.25..=0.75).contains(&half), "{flights:?}: {half}");
        }
    }

    #[test]
    fn the_table_says_less_for_a_faster_ball_and_for_one_that_bounces_more() {
        let chance = |restitution: f64, speed: f64| {
            let table = StayTable::new(&cup(restitution));
            table.chance(&(axis() * -speed), &axis(), &(Vector3::z() * 9.81))
        };
        assert!(chance(0.15, 4.0) > 0.999 && chance(0.3, 1.8) > 0.999);
        assert!(chance(0.5, 4.0) < 0.001 && chance(0.7, 3.0) < 0.001);
        assert!(chance(0.3, 2.5) > chance(0.3, 5.0) + 0.5);
    }

    /// Four times the pressing acceleration is as good as half the speed.
    #[test]
    fn the_table_scales_speeds_with_the_root_of_the_pressing_acceleration() {
        let table = StayTable::new(&cup(0.4));
        let axis = Vector3::new(0.3, 0.1, 0.9).normalize();
        for speed in [1.0, 1.5, 2.0, 2.5] {
            let relative = Vector3::new(-0.1, 0.2, -1.0).normalize() * speed;
            let once = table.chance(&relative, &axis, &(Vector3::z() * 9.81));
            let fourfold = table.chance(&(relative * 2.0), &axis, &(Vector3::z() * 39.24));
            assert!((once - fourfold).abs() < 1e-9, "{speed}: {once} {fourfold}");
        }
    }
}
