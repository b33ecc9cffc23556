//! Where a released ball meets a plane, and how that moves with the release.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3, Vector6};

use super::aim::Aim;
use super::model::{FlightModel, FlightState};

/// `∂(coordinates of the landing)/∂(p, v at release)`, 2 × 6, columns in m per m and m per m/s.
pub type LandingJacobian = SMatrix<f64, 2, 6>;

/// The ball meets a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landing {
    /// Point in m.
    pub p: Vector3<f64>,
    /// Velocity there in m/s.
    pub v: Vector3<f64>,
    /// Time since the release in s.
    pub time_s: f64,
    /// How the point moves with the velocity at the release at a fixed time, in s.
    pub p_by_v0: Matrix3<f64>,
}

/// No ball flies longer, in s.
const FLIGHT_MAX_S: f64 = 20.0;
/// Newton steps inside one step of the integration.
const NEWTON_STEPS_MAX: usize = 12;

impl Aim {
    /// Velocity of the ball against the target at a landing of a release `since_s` after the planned one.
    #[must_use]
    #[inline]
    pub fn approach(&self, landing: &Landing, since_s: f64) -> Vector3<f64> {
        if self.is_level() {
            landing.v
        } else {
            landing.v - self.course().velocity_m_s(since_s + landing.time_s)
        }
    }
}

impl FlightModel {
    /// Landing on the horizontal plane at height `z_m` for a release at `p` (m) with `v` (m/s), on the way down.
    ///
    /// `None` if the ball never comes down through the plane (it starts below and does not rise to it), or for
    /// input that is not finite. The time is exact to rounding.
    #[must_use]
    #[inline]
    pub fn land(&self, p: &Vector3<f64>, v: &Vector3<f64>, z_m: f64) -> Option<Landing> {
        self.meet(p, v, &Aim::level(Vector3::new(0.0, 0.0, z_m)), 0.0)
    }

    /// First passage through the plane of an aim, from the side of its normal, for a release at `p` (m) with `v` (m/s)
    /// `since_s` after the planned release.
    ///
    /// `None` if there is no passage within 20 s, or for input that is not finite. The time is exact to rounding.
    #[must_use]
    pub fn meet(&self, p: &Vector3<f64>, v: &Vector3<f64>, aim: &Aim, since_s: f64) -> Option<Landing> {
        let finite = p.iter().chain(v.iter()).all(|c| c.is_finite());
        if !(finite && aim.above_m(p, since_s).is_finite()) {
            return None;
        }
        if self.is_vacuum() && aim.is_level() {
            return self.fall(p, v, aim.point_at(0.0).z);
        }
        let mut state = FlightState::begin(p, v);
        let (mut t, mut above_m) = (0.0, aim.above_m(p, since_s));
        while t < FLIGHT_MAX_S {
            let h = self.step_s(&state.v, FLIGHT_MAX_S);
            let next = self.advance(&state, h);
            let next_above_m = aim.above_m(&next.p, since_s + t + h);
            if above_m >= 0.0 && next_above_m < 0.0 {
                return self.pass(&state, aim, since_s, t, h * above_m / (above_m - next_above_m));
            }
            // Below, on the way down, and nothing pulls up again.
            let down = aim.normal().dot(&(next.v - aim.course().velocity_m_s(since_s + t + h))) < 0.0;
            if next_above_m < 0.0 && down && aim.is_level() {
                return None;
            }
            (state, above_m) = (next, next_above_m);
            t += h;
        }
        None
    }

    /// The closed form in vacuum.
    #[inline]
    fn fall(&self, p: &Vector3<f64>, v: &Vector3<f64>, z_m: f64) -> Option<Landing> {
        let g = self.gravity_m_s2();
        let under_root = v.z * v.z + 2.0 * g * (p.z - z_m);
        if under_root < 0.0 {
            return None;
        }
        let time_s = (v.z + under_root.sqrt()) / g;
        if time_s < 0.0 {
            return None;
        }
        let mut end = self.fly(p, v, time_s);
        end.p.z = z_m;
        Some(Landing { p: end.p, v: end.v, time_s, p_by_v0: end.p_by_v0 })
    }

    /// The passage inside one step of the integration that begins at `t` in `state`, about `dt` later.
    fn pass(&self, state: &FlightState, aim: &Aim, since_s: f64, t: f64, mut dt: f64) -> Option<Landing> {
        for _ in 0..NEWTON_STEPS_MAX {
            let (p, v) = self.coast_step(&state.p, &state.v, dt);
            let at_s = since_s + t + dt;
            let towards = aim.normal().dot(&(v - aim.course().velocity_m_s(at_s)));
            let step = aim.above_m(&p, at_s) / towards;
            if !step.is_finite() {
                return None;
            }
            dt -= step;
            if step.abs() <= 1e-15 {
                break;
            }
        }
        let end = self.advance(state, dt);
        let time_s = t + dt;
        // Onto the plane, of which rounding leaves it beside.
        let p = end.p - aim.normal() * aim.above_m(&end.p, since_s + time_s);
        Some(Landing { p, v: end.v, time_s, p_by_v0: end.p_by_v0 })
    }

    /// Landing Jacobian G for a release that lands as `landing` on a horizontal plane at rest: derivatives of x and y.
    #[must_use]
    #[inline]
    pub fn landing_jacobian(&self, landing: &Landing) -> LandingJacobian {
        Aim::level(landing.p).jacobian(landing, 0.0)
    }
}

impl Aim {
    /// Landing Jacobian G for a release, `since_s` after the planned one, that meets the plane as `landing`.
    ///
    /// With the flight `p(T; p0, v0)`, `δL = δp(T) - w n·δp(T)/(n·w)`, w the velocity against the plane: it is met
    /// earlier or later.
    #[must_use]
    #[inline]
    pub fn jacobian(&self, landing: &Landing, since_s: f64) -> LandingJacobian {
        let onto_plane = self.onto_plane(&self.approach(landing, since_s));
        let mut g = LandingJacobian::zeros();
        g.fixed_view_mut::<2, 3>(0, 0).copy_from(&onto_plane);
        g.fixed_view_mut::<2, 3>(0, 3).copy_from(&(onto_plane * landing.p_by_v0));
        g
    }
}

/// Speed of the landing point with the delay of the release, `dL/dδ = G_p v + G_v a`, in m/s (mm per ms).
///
/// `v` and `a` are velocity and acceleration of the ball in the hand at the release; for a target that moves, `v` is
/// against the target's velocity at the landing.
#[must_use]
pub(crate) fn delay_sensitivity(g: &LandingJacobian, v: &Vector3<f64>, a: &Vector3<f64>) -> Vector2<f64> {
    g * Vector6::new(v.x, v.y, v.z, a.x, a.y, a.z)
}

/// Semi-axes (m, largest first) and direction of the largest (rad from x) of the 1σ ellipse of a landing covariance.
#[must_use]
pub fn ellipse(covariance_m2: &Matrix2<f64>) -> (f64, f64, f64) {
    let eigen = covariance_m2.symmetric_eigen();
    let (i, j) = if eigen.eigenvalues[0] >= eigen.eigenvalues[1] { (0, 1) } else { (1, 0) };
    let axis = eigen.eigenvectors.column(i);
    (eigen.eigenvalues[i].max(0.0).sqrt(), eigen.eigenvalues[j].max(0.0).sqrt(), axis[1].atan2(axis[0]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const P: Vector3<f64> = Vector3::new(0.6, 0.3, -0.1);
    const V: Vector3<f64> = Vector3::new(0.55, 1.1, 1.4);

    fn vacuum() -> FlightModel {
        FlightModel::vacuum(9.81).expect("valid")
    }

    fn heavy_air() -> FlightModel {
        vacuum().with_drag(0.08).expect("valid").with_magnus(Vector3::new(0.2, -0.1, 0.3)).expect("valid")
    }

    /// Numerical Jacobian: an oracle that knows only `land`.
    fn differences(model: &FlightModel) -> LandingJacobian {
        let eps = 1e-6;
        LandingJacobian::from_fn(|row, col| {
            let at = |e: f64| {
                let (mut p, mut v) = (P, V);
                if col < 3 {
                    p[col] += e;
                } else {
                    v[col - 3] += e;
                }
                model.land(&p, &v, -1.0).expect("lands").p[row]
            };
            (at(eps) - at(-eps)) / (2.0 * eps)
        })
    }

    #[test]
    fn landing_jacobian_matches_differences_in_vacuum_and_in_air() {
        for model in [vacuum(), heavy_air()] {
            let landing = model.land(&P, &V, -1.0).expect("lands");
            let g = model.landing_jacobian(&landing);
            assert!((g - differences(&model)).amax() < 2e-8, "{model:?}: {g} {}", differences(&model));
        }
    }

    #[test]
    fn a_ball_that_follows_its_own_parabola_does_not_care_when_it_is_released() {
        let landing = vacuum().land(&P, &V, -1.0).expect("lands");
        let g = vacuum().landing_jacobian(&landing);
        assert!(delay_sensitivity(&g, &V, &Vector3::new(0.0, 0.0, -9.81)).norm() < 1e-12);
        assert!(delay_sensitivity(&g, &V, &Vector3::zeros()).norm() > 1.0);
    }

    #[test]
    fn launch_and_landing_are_inverse_also_in_air() {
        let target = Vector3::new(1.2, -0.7, -1.0);
        for model in [vacuum(), heavy_air()] {
            let launch = model.launch(&P, &target, 0.6).expect("launch");
            let landing = model.land(&P, &launch.v0, -1.0).expect("lands");
            assert!((landing.p - target).norm() < 1e-9, "{model:?}");
            assert!((landing.time_s - 0.6).abs() < 1e-9);
            // Derivatives of the launch against differences of the launch.
            let eps = 1e-6;
            for axis in 0..3 {
                let mut moved = P;
                moved[axis] += eps;
                let change = (model.launch(&moved, &target, 0.6).expect("launch").v0 - launch.v0) / eps;
                assert!((change - launch.by_p0.column(axis)).amax() < 1e-4);
            }
            let change = (model.launch(&P, &target, 0.6 + eps).expect("launch").v0 - launch.v0) / eps;
            assert!((change - launch.by_flight_s).amax() < 1e-4);
        }
    }

    #[test]
    fn drag_of_a_vertical_fall_matches_the_closed_form() {
        // v(t) = vt tanh(g t / vt) and depth = vt²/g ln cosh(g t / vt), vt = sqrt(g/k).
        let k = 0.3;
        let model = vacuum().with_drag(k).expect("valid");
        let vt = (9.81_f64 / k).sqrt();
        let end = model.fly(&Vector3::zeros(), &Vector3::zeros(), 0.8);
        let x = 9.81 * 0.8 / vt;
        assert!((end.v.z + vt * x.tanh()).abs() < 1e-7);
        assert!((end.p.z + vt * vt / 9.81 * x.cosh().ln()).abs() < 1e-7);
    }

    #[test]
    fn a_ball_that_stays_below_the_plane_does_not_land() {
        for model in [vacuum(), heavy_air()] {
            assert!(model.land(&P, &Vector3::new(1.0, 0.0, 1.0), 2.0).is_none());
            assert!(model.land(&P, &Vector3::new(f64::NAN, 0.0, 1.0), -1.0).is_none());
        }
    }

    #[test]
    fn published_throw_has_the_published_velocity() {
        let launch = vacuum()
            .launch(&Vector3::new(0.675574, 0.362951, -0.114747), &Vector3::new(1.0, 1.0, -1.0), 0.586)
            .expect("launch");
        assert!((launch.v0 - Vector3::new(0.553627, 1.087115, 1.363659)).amax() < 1e-5);
    }
}
