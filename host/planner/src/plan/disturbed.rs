//! What is off in one throw: nothing, or drawn from the noise for a Monte Carlo study.

use robot_model::JointVec;

use super::options::Noise;
use super::rng::SplitMix64;
use crate::flight::FlightModel;
use crate::throw::{JointState, Throw};

/// A release with a delay and with errors of the joint state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Disturbed {
    /// Delay of the release in s; early if negative.
    pub(super) delay_s: f64,
    /// Error of the joint angles in rad.
    pub(super) q_rad: JointVec,
    /// Error of the joint speeds in rad/s.
    pub(super) qd_rad_s: JointVec,
}

impl Disturbed {
    /// Nothing is off.
    pub(super) fn nothing(n: usize) -> Self {
        Self { delay_s: 0.0, q_rad: JointVec::zeros(n), qd_rad_s: JointVec::zeros(n) }
    }

    pub(super) fn drawn(n: usize, noise: &Noise, rng: &mut SplitMix64) -> Self {
        Self {
            delay_s: drawn_delay(noise, rng),
            q_rad: JointVec::from_fn(n, |_| noise.position_rad * rng.normal()),
            qd_rad_s: JointVec::from_fn(n, |_| noise.speed_rad_s * rng.normal()),
        }
    }

    /// Joint state at the late release.
    pub(super) fn at_release(&self, throw: &Throw) -> JointState {
        let mut state = throw.at_time(throw.ha_s + self.delay_s);
        state.q += self.q_rad;
        state.qd += self.qd_rad_s;
        state
    }
}

/// The flight with a drawn drag, which is never negative; `None` if no flight has so much.
pub(super) fn drawn_flight(flight: &FlightModel, noise: &Noise, rng: &mut SplitMix64) -> Option<FlightModel> {
    flight.with_drag((flight.drag_per_m() + noise.drag_per_m * rng.normal()).abs()).ok()
}

/// A release delay in s: normal, or one of the measured nodes.
fn drawn_delay(noise: &Noise, rng: &mut SplitMix64) -> f64 {
    let Some(nodes) = &noise.release_nodes else { return noise.release_time_s * rng.normal() };
    let mut rest = rng.unit();
    let mut last_s = 0.0;
    for (delay_s, weight) in nodes.iter() {
        last_s = delay_s;
        rest -= weight;
        if rest < 0.0 {
            break;
        }
    }
    last_s
}
