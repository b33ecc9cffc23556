//! A ball that flies, bounces and rolls: air, floor, cups and links.
//!
//! ```text
//! v' = -g e_z - kappa |v| v + lambda w x v          between contacts; spin w stays as it is
//! J_n = -(1 + e) (u.n)                              impulse per mass of a contact with approach speed u.n < 0
//! J_t = -u_t / (1 + 1/k),  |J_t| <= mu J_n          sliding or sticking, I = k m r^2
//! |dv_t|, r |dw| <= c J_n                           rolling resistance: rolling against the surface slows down
//! ```
//!
//! u is the velocity of the ball's surface at the contact against the surface it touches. Below
//! [`Surface::rest_m_s`] a contact does not bounce.

use nalgebra::Vector3;

/// Longest step, s: a ball at 6 m/s moves by 0.6 mm, a tenth of a cup's wall.
pub const STEP_MAX_S: f64 = 1e-4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BallOptions {
    pub radius_m: f64,
    /// Drag kappa = rho c_d A / (2 m), 1/m.
    pub drag_1_m: f64,
    /// Lift: acceleration is `lift` × spin × velocity, without unit.
    pub lift: f64,
    /// Moment of inertia over m r²: 0.4 solid, 0.667 hollow.
    pub inertia: f64,
}

impl Default for BallOptions {
    /// Radius 30 mm and 30 g: drag 0.0284 /m with c_d 0.492; solid.
    fn default() -> Self {
        Self { radius_m: 0.03, drag_1_m: 0.0284, lift: 0.0, inertia: 0.4 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Speed after over speed before a bounce, 0..=1.
    pub restitution: f64,
    /// Coulomb friction.
    pub friction: f64,
    /// Rolling resistance c: a ball that rolls on the level slows down with c g.
    pub rolling: f64,
    /// Approach speed below which nothing bounces, m/s.
    pub rest_m_s: f64,
}

/// State of a loose ball, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LooseBall {
    pub p_m: Vector3<f64>,
    pub v_m_s: Vector3<f64>,
    pub spin_rad_s: Vector3<f64>,
}

/// One contact, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Unit normal from the surface to the ball.
    pub normal: Vector3<f64>,
    /// Depth of the ball in the material, m.
    pub depth_m: f64,
    /// Velocity of the surface at the contact, m/s.
    pub surface_v_m_s: Vector3<f64>,
    pub surface: Surface,
}

impl LooseBall {
    /// Flies for `h_s`, at most [`STEP_MAX_S`] at a time for contacts to be seen: Runge-Kutta of fourth order.
    pub fn fly(&mut self, ball: &BallOptions, gravity_m_s2: f64, h_s: f64) {
        let a = |v: &Vector3<f64>| {
            Vector3::new(0.0, 0.0, -gravity_m_s2) - v * (ball.drag_1_m * v.norm())
                + self.spin_rad_s.cross(v) * ball.lift
        };
        let v1 = self.v_m_s;
        let a1 = a(&v1);
        let v2 = v1 + a1 * (0.5 * h_s);
        let a2 = a(&v2);
        let v3 = v1 + a2 * (0.5 * h_s);
        let a3 = a(&v3);
        let v4 = v1 + a3 * h_s;
        let a4 = a(&v4);
        self.p_m += (v1 + (v2 + v3) * 2.0 + v4) * (h_s / 6.0);
        self.v_m_s += (a1 + (a2 + a3) * 2.0 + a4) * (h_s / 6.0);
    }

    /// Handles a contact: moves the ball out of the material, and gives it an impulse if it approaches. Returns the approach
    /// speed, m/s.
    pub fn hit(&mut self, ball: &BallOptions, hit: &Hit) -> f64 {
        self.p_m += hit.normal * hit.depth_m;
        let arm = -hit.normal * ball.radius_m;
        let u = self.v_m_s + self.spin_rad_s.cross(&arm) - hit.surface_v_m_s;
        let approach = -u.dot(&hit.normal);
        if approach <= 0.0 {
            return 0.0;
        }
        let e = if approach > hit.surface.rest_m_s { hit.surface.restitution } else { 0.0 };
        let normal_impulse = (1.0 + e) * approach;
        let sliding = u + hit.normal * approach;
        let stick = -sliding / (1.0 + 1.0 / ball.inertia);
        let most = hit.surface.friction * normal_impulse;
        let tangent = if stick.norm() > most { stick * (most / stick.norm()) } else { stick };
        self.v_m_s += hit.normal * normal_impulse + tangent;
        self.spin_rad_s += arm.cross(&tangent) / (ball.inertia * ball.radius_m * ball.radius_m);
        let slow = hit.surface.rolling * normal_impulse;
        let along = self.v_m_s - hit.surface_v_m_s;
        let along = along - hit.normal * along.dot(&hit.normal);
        self.v_m_s -= along * (slow / along.norm().max(slow).max(1e-12));
        let spin_m_s = self.spin_rad_s.norm() * ball.radius_m;
        self.spin_rad_s *= 1.0 - slow / spin_m_s.max(slow).max(1e-12);
        approach
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOOR: Surface = Surface { restitution: 0.5, friction: 0.4, rolling: 0.0, rest_m_s: 0.05 };

    fn dropped(v: [f64; 3], surface: Surface, seconds: f64) -> (LooseBall, Vec<f64>) {
        let ball = BallOptions { drag_1_m: 0.0, ..BallOptions::default() };
        let mut at = LooseBall {
            p_m: Vector3::new(0.0, 0.0, 1.0 + ball.radius_m),
            v_m_s: Vector3::from(v),
            spin_rad_s: Vector3::zeros(),
        };
        let mut bounces = Vec::new();
        for _ in 0..(seconds / STEP_MAX_S) as usize {
            at.fly(&ball, 9.81, STEP_MAX_S);
            let depth_m = ball.radius_m - at.p_m.z;
            if depth_m > 0.0 {
                let hit = Hit { normal: Vector3::z(), depth_m, surface_v_m_s: Vector3::zeros(), surface };
                let approach = at.hit(&ball, &hit);
                if approach > 0.1 {
                    bounces.push(approach);
                }
            }
        }
        (at, bounces)
    }

    #[test]
    fn a_bounce_loses_the_share_that_restitution_says_until_the_ball_rests() {
        let (at, bounces) = dropped([0.0; 3], FLOOR, 3.0);
        let first = (2.0_f64 * 9.81).sqrt();
        assert!((bounces[0] - first).abs() < 2e-3 && (bounces[1] - 0.5 * first).abs() < 5e-3, "{bounces:?}");
        assert!(at.v_m_s.norm() < 2e-3 && (at.p_m.z - 0.03).abs() < 1e-5, "{at:?}");
    }

    /// A solid ball that slides ends up rolling at 5/7 of its speed.
    #[test]
    fn a_sliding_ball_ends_up_rolling() {
        let dead = Surface { restitution: 0.0, ..FLOOR };
        let (at, _) = dropped([1.0, 0.0, 0.0], dead, 2.0);
        assert!((at.v_m_s.x - 5.0 / 7.0).abs() < 5e-3, "{at:?}");
        assert!((at.spin_rad_s.y * 0.03 - at.v_m_s.x).abs() < 5e-3);
    }

    /// On the level a rolling ball slows down with c g: from 0.5 m/s within 0.5 s for c = 0.1.
    #[test]
    fn rolling_resistance_brings_a_rolling_ball_to_rest() {
        let foam = Surface { restitution: 0.0, rolling: 0.1, ..FLOOR };
        let (at, _) = dropped([0.7, 0.0, 0.0], foam, 2.0);
        assert!(at.v_m_s.norm() < 1e-2, "{at:?}");
    }

    /// Straight down with drag: z = -ln(cosh(sqrt(kappa g) t)) / kappa.
    #[test]
    fn falling_with_drag_follows_the_closed_form() {
        let ball = BallOptions { drag_1_m: 0.5, ..BallOptions::default() };
        let mut at =
            LooseBall { p_m: Vector3::zeros(), v_m_s: Vector3::zeros(), spin_rad_s: Vector3::zeros() };
        for _ in 0..10_000 {
            at.fly(&ball, 9.81, STEP_MAX_S);
        }
        let fallen = ((0.5_f64 * 9.81).sqrt()).cosh().ln() / 0.5;
        assert!((at.p_m.z + fallen).abs() < 1e-9, "{at:?}");
    }

    #[test]
    fn spin_bends_the_flight_to_the_side_of_its_cross_product() {
        let ball = BallOptions { drag_1_m: 0.0, lift: 0.01, ..BallOptions::default() };
        let mut at =
            LooseBall { p_m: Vector3::zeros(), v_m_s: Vector3::x() * 4.0, spin_rad_s: Vector3::z() * 20.0 };
        for _ in 0..1000 {
            at.fly(&ball, 9.81, STEP_MAX_S);
        }
        // a_y = 0.01 * 20 * 4 = 0.8 m/s2 for 0.1 s.
        assert!((at.p_m.y - 0.004).abs() < 2e-5, "{at:?}");
    }
}
