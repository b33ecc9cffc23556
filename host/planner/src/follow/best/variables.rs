//! The numbers of the search.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::follow::hand::HandLaw;
use crate::follow::motion::RampPlan;
use crate::follow::parabola::Parabola;
use crate::follow::ramp::RampShape;
use crate::follow::setting::Setting;

/// Number of variables.
pub(super) const COUNT: usize = 15;

/// How the hand may turn while the ball is on the parabola.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HandFreedom {
    /// Not at all, as in the paper.
    Constant,
    /// About v0.
    Roll,
    /// With the tangent of the flight.
    Tangent,
    /// With the tangent, and about it.
    TangentAndRoll,
    /// As before, and away from the tangent by up to this angle in rad.
    Tilted(f64),
}

/// Place of each variable.
mod at {
    pub(super) const RADIUS: usize = 0;
    pub(super) const PLACE: usize = 1;
    pub(super) const HEIGHT: usize = 2;
    pub(super) const FLIGHT: usize = 3;
    pub(super) const ROLL: usize = 4;
    pub(super) const ROLL_RATE: usize = 5;
    pub(super) const ROLL_SECOND: usize = 6;
    pub(super) const FOLLOW: usize = 7;
    pub(super) const TILT: usize = 8;
    pub(super) const TILT_RATE: usize = 9;
    pub(super) const YAW: usize = 10;
    pub(super) const YAW_RATE: usize = 11;
    pub(super) const START_TOGETHER: usize = 12;
    pub(super) const STOP_TOGETHER: usize = 13;
    pub(super) const BLEND: usize = 14;
}

/// A change of each variable that changes the motion about as much as those of the others.
pub(super) const SCALES: [f64; COUNT] =
    [0.05, 0.05, 0.05, 0.05, 0.1, 0.5, 2.0, 0.2, 0.05, 0.3, 0.05, 0.3, 0.2, 0.2, 0.012];

const MIN: [f64; COUNT] =
    [0.02, -1e3, -1e3, 0.1, -1e3, -20.0, -200.0, 0.0, -1.0, -6.0, -1.0, -6.0, 0.0, 0.0, 0.0];
const MAX: [f64; COUNT] = [1e3, 1e3, 1e3, 3.0, 1e3, 20.0, 200.0, 1.5, 1.0, 6.0, 1.0, 6.0, 1.0, 1.0, 2.0];

/// One point of the search. The flight's t = 0 is the middle of the window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Variables(pub(super) [f64; COUNT]);

impl Variables {
    /// From a release at `p` (world), the time of flight from there, a roll, and the time of the blends.
    pub(super) fn release(
        p: Vector3<f64>,
        flight_s: f64,
        roll_rad: f64,
        hand: HandFreedom,
        blend_s: f64,
    ) -> Self {
        let mut x = [0.0; COUNT];
        x[at::RADIUS] = p.xy().norm();
        x[at::PLACE] = p.y.atan2(p.x);
        x[at::HEIGHT] = p.z;
        x[at::FLIGHT] = flight_s;
        x[at::ROLL] = roll_rad;
        x[at::BLEND] = blend_s;
        x[at::FOLLOW] = if matches!(hand, HandFreedom::Constant | HandFreedom::Roll) { 0.0 } else { 1.0 };
        Self(x)
    }

    /// Indices of the variables that may change.
    pub(super) fn free(hand: HandFreedom) -> Vec<usize> {
        let mut free = vec![at::RADIUS, at::PLACE, at::HEIGHT, at::FLIGHT, at::ROLL];
        if !matches!(hand, HandFreedom::Constant | HandFreedom::Tangent) {
            free.extend([at::ROLL_RATE, at::ROLL_SECOND]);
        }
        if let HandFreedom::Tilted(_) = hand {
            free.extend([at::FOLLOW, at::TILT, at::TILT_RATE, at::YAW, at::YAW_RATE]);
        }
        free.extend([at::START_TOGETHER, at::STOP_TOGETHER, at::BLEND]);
        free
    }

    /// True for a variable that changes the ramps only: the window does not depend on it.
    pub(super) const fn is_of_ramps(index: usize) -> bool {
        matches!(index, at::START_TOGETHER | at::STOP_TOGETHER | at::BLEND)
    }

    /// Moves every variable into its bounds; those that are not free keep their values.
    pub(super) fn clamp(&mut self, hand: HandFreedom, blend_max_s: f64) {
        for i in 0..COUNT {
            self.0[i] = self.0[i].clamp(MIN[i], MAX[i]);
        }
        self.0[at::BLEND] = self.0[at::BLEND].min(blend_max_s);
        let fixed = Self::release(Vector3::zeros(), 0.0, 0.0, hand, 0.0);
        let free = Self::free(hand);
        for i in (0..COUNT).filter(|i| !free.contains(i)) {
            self.0[i] = fixed.0[i];
        }
    }

    pub(super) fn flight(&self, setting: &Setting<'_>) -> Parabola {
        let x = &self.0;
        let p = Vector3::new(
            x[at::RADIUS] * x[at::PLACE].cos(),
            x[at::RADIUS] * x[at::PLACE].sin(),
            x[at::HEIGHT],
        );
        Parabola::through(p, setting.target, x[at::FLIGHT], setting.gravity_m_s2())
    }

    /// Time of flight from the middle of the window in s.
    pub(super) fn flight_s(&self) -> f64 {
        self.0[at::FLIGHT]
    }

    pub(super) fn hand(&self) -> HandLaw {
        let x = &self.0;
        HandLaw {
            follow: x[at::FOLLOW],
            roll: [x[at::ROLL], x[at::ROLL_RATE], x[at::ROLL_SECOND]],
            tilt: [x[at::TILT], x[at::TILT_RATE]],
            yaw: [x[at::YAW], x[at::YAW_RATE]],
        }
    }

    /// Ramps before and after the window.
    pub(super) fn ramps(&self, fade_s: f64) -> [RampPlan; 2] {
        let shape = RampShape { blend_s: self.0[at::BLEND], fade_s };
        [at::START_TOGETHER, at::STOP_TOGETHER].map(|i| RampPlan { shape, together: self.0[i] })
    }
}
