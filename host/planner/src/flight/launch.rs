//! The velocity that carries the ball to the target.

use nalgebra::{Matrix3, Vector3};

use super::model::FlightModel;

/// Velocity at release that reaches the target after a given time of flight, with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Launch {
    /// `v0` in m/s, world.
    pub v0: Vector3<f64>,
    /// `∂v0/∂p0` in 1/s; `∂v0/∂p_target` is its negative.
    pub by_p0: Matrix3<f64>,
    /// `∂v0/∂F` in m/s².
    pub by_flight_s: Vector3<f64>,
}

/// No launch velocity was found.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LaunchError {
    #[error("time of flight {flight_s} s: a launch needs a positive time and finite points")]
    Input { flight_s: f64 },
    #[error("no launch velocity reaches the target in {flight_s} s against this drag")]
    Drag { flight_s: f64 },
}

impl FlightModel {
    /// `v0` from `p0` to `target` (m, world) in `flight_s` seconds.
    ///
    /// In vacuum `v0 = (p_target - p0)/F + (0, 0, g) F/2` (the paper's step 2; g must point up there for the printed
    /// formula to hit). Otherwise the three components are solved for by Newton's method on the integrated flight.
    ///
    /// # Errors
    /// [`LaunchError`] for a time that is not positive, numbers that are not finite, or drag too strong to hit.
    #[inline]
    pub(crate) fn launch(
        &self,
        p0: &Vector3<f64>,
        target: &Vector3<f64>,
        flight_s: f64,
    ) -> Result<Launch, LaunchError> {
        let way = target - p0;
        if !(flight_s > 0.0 && flight_s.is_finite() && way.iter().all(|w| w.is_finite())) {
            return Err(LaunchError::Input { flight_s });
        }
        let f = flight_s;
        let half_g = Vector3::new(0.0, 0.0, 0.5 * self.gravity_m_s2());
        let vacuum = way / f + half_g * f;
        if self.is_vacuum() {
            return Ok(Launch {
                v0: vacuum,
                by_p0: Matrix3::identity() * (-1.0 / f),
                by_flight_s: half_g - way / (f * f),
            });
        }
        let mut v0 = vacuum;
        for _ in 0..NEWTON_STEPS_MAX {
            let end = self.fly(p0, &v0, f);
            let miss = end.p - target;
            let Some(inverse) = end.p_by_v0.try_inverse() else { break };
            if miss.norm() <= MISS_TOLERANCE_M {
                return Ok(Launch { v0, by_p0: -inverse, by_flight_s: -(inverse * end.v) });
            }
            v0 -= inverse * miss;
            if !v0.iter().all(|v| v.is_finite()) {
                break;
            }
        }
        Err(LaunchError::Drag { flight_s })
    }
}

const NEWTON_STEPS_MAX: usize = 20;
/// Far below what any arm can realise, far above rounding.
const MISS_TOLERANCE_M: f64 = 1e-11;
