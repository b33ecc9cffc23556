//! Flight of a disc.
//!
//! State: centre, velocity, normal and angular momentum. A symmetric top needs no more: its angular velocity is
//! `(H - (H·n) n)/I_diameter + (H·n) n/I_axis`, so `dn/dt = (H × n)/I_diameter` and `dH/dt = M` (no approximation of fast
//! spin; the nutation is in it). Forces by [`super::aero`], at the velocity relative to the air.

use nalgebra::Vector3;
use robot_model::cubic::Cubic;

use super::aero::{AIR_KG_M3, Body, coefficients};
use super::throw::{GRAVITY_M_S2, Throw};

/// A disc at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscState {
    /// Centre, m.
    pub p_m: Vector3<f64>,
    /// Velocity, m/s.
    pub v_m_s: Vector3<f64>,
    /// Unit normal, on the upper side.
    pub normal: Vector3<f64>,
    /// Angular momentum about the centre, kg·m²/s; zero where only the path is known.
    pub momentum: Vector3<f64>,
}

impl DiscState {
    /// A disc that leaves with spin about its normal.
    #[must_use]
    pub fn released(throw: &Throw, normal: Vector3<f64>, spin_rad_s: f64, body: &Body) -> Self {
        let normal = normal.normalize();
        Self {
            p_m: throw.start_m,
            v_m_s: throw.velocity_m_s,
            normal,
            momentum: normal * (spin_rad_s * body.about_axis_kg_m2),
        }
    }
}

/// What the disc flies in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Gravity along -z, m/s².
    pub gravity_m_s2: f64,
    pub wind_m_s: Vector3<f64>,
    /// Density, kg/m³; 0 is vacuum.
    pub density_kg_m3: f64,
}

impl Air {
    #[must_use]
    pub fn still() -> Self {
        Self { gravity_m_s2: GRAVITY_M_S2, wind_m_s: Vector3::zeros(), density_kg_m3: AIR_KG_M3 }
    }

    /// No air: a parabola, and a torque-free top.
    #[must_use]
    pub fn vacuum() -> Self {
        Self { density_kg_m3: 0.0, ..Self::still() }
    }
}

/// Rates of a state.
#[derive(Clone, Copy)]
struct Rates {
    p: Vector3<f64>,
    v: Vector3<f64>,
    n: Vector3<f64>,
    h: Vector3<f64>,
}

/// Force in N (without weight) and moment in N·m of the air on the disc.
#[must_use]
pub fn air_loads(body: &Body, air: &Air, state: &DiscState) -> (Vector3<f64>, Vector3<f64>) {
    let relative = state.v_m_s - air.wind_m_s;
    let speed = relative.norm();
    let pressure = 0.5 * air.density_kg_m3 * speed * speed * body.area_m2();
    if pressure <= 0.0 {
        return (Vector3::zeros(), Vector3::zeros());
    }
    let n = state.normal;
    let along = relative / speed;
    let sin_alpha = (-along.dot(&n)).clamp(-1.0, 1.0);
    let c = coefficients(sin_alpha.asin());
    let up = n - along * along.dot(&n);
    let forward = along - n * along.dot(&n);
    let unit = |v: Vector3<f64>| v.try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
    let force = (unit(up) * c.lift - along * c.drag) * pressure;
    let spin = state.momentum.dot(&n) / body.about_axis_kg_m2;
    let turning = (state.momentum - n * state.momentum.dot(&n)) / body.about_diameter_kg_m2;
    // Nose up turns the forward direction towards the normal.
    let moment =
        unit(forward).cross(&n) * c.pitch + turning * body.damping_s + n * (spin * body.spin_damping_s);
    (force, moment * (pressure * 2.0 * body.radius_m))
}

fn rates(body: &Body, air: &Air, s: &DiscState) -> Rates {
    let (force, moment) = air_loads(body, air, s);
    Rates {
        p: s.v_m_s,
        v: force / body.mass_kg - Vector3::z() * air.gravity_m_s2,
        n: s.momentum.cross(&s.normal) / body.about_diameter_kg_m2,
        h: moment,
    }
}

/// The state `dt_s` later, one step of the classical Runge-Kutta method; the normal stays a unit vector.
#[must_use]
pub fn step(body: &Body, air: &Air, s: &DiscState, dt_s: f64) -> DiscState {
    let ahead = |r: &Rates, dt: f64| DiscState {
        p_m: s.p_m + r.p * dt,
        v_m_s: s.v_m_s + r.v * dt,
        normal: s.normal + r.n * dt,
        momentum: s.momentum + r.h * dt,
    };
    let k1 = rates(body, air, s);
    let k2 = rates(body, air, &ahead(&k1, 0.5 * dt_s));
    let k3 = rates(body, air, &ahead(&k2, 0.5 * dt_s));
    let k4 = rates(body, air, &ahead(&k3, dt_s));
    let mean =
        |pick: fn(&Rates) -> Vector3<f64>| (pick(&k1) + (pick(&k2) + pick(&k3)) * 2.0 + pick(&k4)) / 6.0;
    let mut out =
        ahead(&Rates { p: mean(|r| r.p), v: mean(|r| r.v), n: mean(|r| r.n), h: mean(|r| r.h) }, dt_s);
    out.normal.normalize_mut();
    out
}

/// A flight as a table of states in equal steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    step_s: f64,
    states: Vec<DiscState>,
}

/// Step of the tables, s.
const STEP_S: f64 = 0.002;

impl Path {
    /// Flies until the centre is at the floor z = 0, or for `until_s`.
    #[must_use]
    pub fn flown(body: &Body, air: &Air, released: &DiscState, until_s: f64) -> Self {
        Self::flown_in_steps(body, air, released, until_s, STEP_S)
    }

    /// The same in steps of `step_s`; 4 ms are a hundredth of a millimetre off after half a second.
    #[must_use]
    pub(crate) fn flown_in_steps(
        body: &Body,
        air: &Air,
        released: &DiscState,
        until_s: f64,
        step_s: f64,
    ) -> Self {
        let mut states = vec![*released];
        let mut now = *released;
        for _ in 0..(until_s / step_s).ceil().clamp(1.0, 1e5) as usize {
            now = step(body, air, &now, step_s);
            states.push(now);
            if now.p_m.z < 0.0 {
                break;
            }
        }
        Self { step_s, states }
    }

    /// The parabola of the paper with a level disc, until the floor or for `until_s`.
    #[must_use]
    pub fn parabola(throw: &Throw, until_s: f64) -> Self {
        Self::flown(
            &Body::of_paper(),
            &Air::vacuum(),
            &DiscState::released(throw, Vector3::z(), 0.0, &Body::of_paper()),
            until_s,
        )
    }

    /// End of the table, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.step_s * (self.states.len() - 1) as f64
    }

    /// The state at a time; before 0 the first, after the end the last.
    #[must_use]
    pub fn at(&self, t_s: f64) -> DiscState {
        let place = (t_s / self.step_s).clamp(0.0, (self.states.len() - 1) as f64);
        let low = (place as usize).min(self.states.len().saturating_sub(2));
        let (Some(a), Some(b)) = (self.states.get(low), self.states.get(low + 1)) else {
            return self.states[0];
        };
        // A cubic for the place, straight lines for the rest.
        let u = place - low as f64;
        let path_m = Cubic::between(self.step_s, (a.p_m, a.v_m_s), (b.p_m, b.v_m_s));
        let mix = |x: &Vector3<f64>, y: &Vector3<f64>| x + (y - x) * u;
        DiscState {
            p_m: path_m.position(u * self.step_s),
            v_m_s: mix(&a.v_m_s, &b.v_m_s),
            normal: mix(&a.normal, &b.normal).normalize(),
            momentum: mix(&a.momentum, &b.momentum),
        }
    }
}
