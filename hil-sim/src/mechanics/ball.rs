//! Flight of the ball.
//!
//! ```text
//! p̈ = -g e_z - κ |ṗ| ṗ + m × ṗ   g 9.81 m/s², κ = ρ c_d A / (2 m) in 1/m, m spin times lift constant in 1/s
//!
//! κ = 0 and m = 0 are the parabola, evaluated in closed form.
//! ```

use nalgebra::Vector3;

use super::plant::HandPoint;

/// Sub-step of the flight with drag, s: Runge-Kutta of fourth order, error far below a micrometre over a throw.
const DRAG_STEP_S: f64 = 1e-3;
/// A flight that has met no floor by then is over, s.
const FLIGHT_MAX_S: f64 = 60.0;

/// A ball in the air, since its release.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    release: HandPoint,
    gravity_m_s2: f64,
    drag_1_m: f64,
    magnus_rad_s: Vector3<f64>,
    // State in the air at `t_s`; unused in vacuum.
    t_s: f64,
    now: HandPoint,
}

/// A plane that a ball passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    pub point_m: Vector3<f64>,
    /// Its normal, to the side from which the ball comes; of any length but zero.
    pub normal: Vector3<f64>,
}

/// Where and when a flight met a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    pub p_m: Vector3<f64>,
    pub v_m_s: Vector3<f64>,
    /// Time since release, s.
    pub t_s: f64,
}

impl Flight {
    /// From the hand's point at the release; `drag_1_m` is κ, not negative.
    pub fn new(release: HandPoint, gravity_m_s2: f64, drag_1_m: f64) -> Self {
        let (drag_1_m, magnus_rad_s) = (drag_1_m.max(0.0), Vector3::zeros());
        Self { release, gravity_m_s2, drag_1_m, magnus_rad_s, t_s: 0.0, now: release }
    }

    /// With the spin of the ball times its lift constant, 1/s.
    #[must_use]
    pub fn with_magnus(self, magnus_rad_s: Vector3<f64>) -> Self {
        Self { magnus_rad_s, ..self }
    }

    fn is_in_vacuum(&self) -> bool {
        self.drag_1_m == 0.0 && self.magnus_rad_s == Vector3::zeros()
    }

    /// The ball `t_s` seconds after the release; in the air `t_s` may not decrease from call to call.
    pub fn at(&mut self, t_s: f64) -> HandPoint {
        if self.is_in_vacuum() {
            return self.parabola(t_s);
        }
        while self.t_s + DRAG_STEP_S <= t_s {
            self.now = self.runge_kutta(&self.now, DRAG_STEP_S);
            self.t_s += DRAG_STEP_S;
        }
        self.runge_kutta(&self.now, (t_s - self.t_s).max(0.0))
    }

    /// First passage downwards through the plane z = `z_m`; `None` if it never gets there (within a minute).
    pub fn landing(&self, z_m: f64) -> Option<Landing> {
        if self.is_in_vacuum() {
            let HandPoint { p_m, v_m_s } = self.release;
            let g = self.gravity_m_s2;
            // z + vz t - g/2 t² = plane, the later root.
            let under = v_m_s.z * v_m_s.z + 2.0 * g * (p_m.z - z_m);
            if under < 0.0 || g <= 0.0 {
                return None;
            }
            let t_s = (v_m_s.z + under.sqrt()) / g;
            let HandPoint { p_m, v_m_s } = self.parabola(t_s);
            return (t_s >= 0.0).then_some(Landing { p_m, v_m_s, t_s });
        }
        let (mut point, mut t_s) = (self.release, 0.0);
        while t_s < FLIGHT_MAX_S {
            let next = self.runge_kutta(&point, DRAG_STEP_S);
            if next.p_m.z <= z_m && next.v_m_s.z < 0.0 && point.p_m.z >= z_m {
                let (mut low, mut high) = (0.0, DRAG_STEP_S);
                for _ in 0..50 {
                    let middle = 0.5 * (low + high);
                    if self.runge_kutta(&point, middle).p_m.z > z_m { low = middle } else { high = middle }
                }
                let at = self.runge_kutta(&point, high);
                return Some(Landing { p_m: at.p_m, v_m_s: at.v_m_s, t_s: t_s + high });
            }
            point = next;
            t_s += DRAG_STEP_S;
        }
        None
    }

    /// First passage through a plane from the side of its normal; `None` if it never gets there (within a minute).
    pub fn passage(&self, plane: &Plane) -> Option<Landing> {
        let above = |p: &Vector3<f64>| plane.normal.dot(&(p - plane.point_m));
        let (mut point, mut t_s) = (self.release, 0.0);
        while t_s < FLIGHT_MAX_S {
            let next = self.runge_kutta(&point, DRAG_STEP_S);
            if above(&next.p_m) <= 0.0 && above(&point.p_m) > 0.0 {
                let (mut low, mut high) = (0.0, DRAG_STEP_S);
                for _ in 0..50 {
                    let middle = 0.5 * (low + high);
                    if above(&self.runge_kutta(&point, middle).p_m) > 0.0 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let at = self.runge_kutta(&point, high);
                return Some(Landing { p_m: at.p_m, v_m_s: at.v_m_s, t_s: t_s + high });
            }
            point = next;
            t_s += DRAG_STEP_S;
        }
        None
    }

    fn parabola(&self, t_s: f64) -> HandPoint {
        let g = Vector3::new(0.0, 0.0, -self.gravity_m_s2);
        let HandPoint { p_m, v_m_s } = self.release;
        HandPoint { p_m: p_m + v_m_s * t_s + g * (0.5 * t_s * t_s), v_m_s: v_m_s + g * t_s }
    }

    fn runge_kutta(&self, from: &HandPoint, h: f64) -> HandPoint {
        let g = Vector3::new(0.0, 0.0, -self.gravity_m_s2);
        let acceleration = |v: &Vector3<f64>| g - v * (self.drag_1_m * v.norm()) + self.magnus_rad_s.cross(v);
        let (v1, a1) = (from.v_m_s, acceleration(&from.v_m_s));
        let v2 = from.v_m_s + a1 * (0.5 * h);
        let a2 = acceleration(&v2);
        let v3 = from.v_m_s + a2 * (0.5 * h);
        let a3 = acceleration(&v3);
        let v4 = from.v_m_s + a3 * h;
        let a4 = acceleration(&v4);
        HandPoint {
            p_m: from.p_m + (v1 + (v2 + v3) * 2.0 + v4) * (h / 6.0),
            v_m_s: from.v_m_s + (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn release(v: [f64; 3]) -> HandPoint {
        HandPoint { p_m: Vector3::new(0.675574, 0.362951, -0.114747), v_m_s: Vector3::from(v) }
    }

    /// The published throw: from its release point at 1.83 m/s to (1, 1, -1) in 0.586 s.
    #[test]
    fn published_throw_lands_on_its_target() {
        let flight = Flight::new(release([0.553627, 1.087115, 1.363659]), 9.81, 0.0);
        let landing = flight.landing(-1.0).unwrap();
        assert!((landing.p_m - Vector3::new(1.0, 1.0, -1.0)).norm() < 2e-5, "{landing:?}");
        assert!((landing.t_s - 0.586).abs() < 1e-5);
    }

    #[test]
    fn throw_upwards_comes_back_with_its_speed() {
        let flight = Flight::new(release([0.0, 0.0, 3.0]), 9.81, 0.0);
        let landing = flight.landing(-0.114747).unwrap();
        assert!((landing.t_s - 6.0 / 9.81).abs() < 1e-12 && (landing.v_m_s.z + 3.0).abs() < 1e-12);
        assert_eq!(Flight::new(release([0.0, 0.0, -1.0]), 9.81, 0.0).landing(5.0), None);
    }

    /// Straight down with drag: z = -ln(cosh(sqrt(κ g) t)) / κ.
    #[test]
    fn falling_with_drag_follows_the_closed_form() {
        let kappa = 0.5_f64;
        let mut flight = Flight::new(release([0.0; 3]), 9.81, kappa);
        for k in 1..=40 {
            let t = 0.05 * f64::from(k);
            let fallen = ((kappa * 9.81).sqrt() * t).cosh().ln() / kappa;
            let z = flight.at(t).p_m.z;
            assert!((z - (-0.114747 - fallen)).abs() < 1e-9, "t = {t}: {z}");
        }
        let landing = Flight::new(release([0.0; 3]), 9.81, kappa).landing(-1.0).unwrap();
        let expected = ((kappa * (1.0 - 0.114747)).exp().acosh()) / (kappa * 9.81).sqrt();
        assert!((landing.t_s - expected).abs() < 1e-9, "{} against {expected}", landing.t_s);
    }

    #[test]
    fn an_upright_plane_is_passed_where_the_parabola_meets_it() {
        let flight = Flight::new(release([2.0, 0.3, 1.0]), 9.81, 0.0);
        let wall = Plane { point_m: Vector3::new(1.5, 0.0, 0.0), normal: Vector3::new(-2.0, 0.0, 0.0) };
        let met = flight.passage(&wall).unwrap();
        let t_s = (1.5 - 0.675574) / 2.0;
        assert!((met.t_s - t_s).abs() < 1e-9 && (met.p_m.x - 1.5).abs() < 1e-9);
        assert!((met.p_m.z - (-0.114747 + t_s - 0.5 * 9.81 * t_s * t_s)).abs() < 1e-9);
        assert_eq!(flight.passage(&Plane { normal: -wall.normal, ..wall }), None, "from the other side");
    }

    #[test]
    fn drag_shortens_a_throw_and_a_little_drag_hardly() {
        let reach = |kappa| Flight::new(release([2.0, 0.0, 2.0]), 9.81, kappa).landing(-1.0).unwrap().p_m.x;
        assert!(reach(0.2) < reach(0.02) && reach(0.02) < reach(0.0));
        assert!((reach(1e-9) - reach(0.0)).abs() < 1e-6);
    }
}
