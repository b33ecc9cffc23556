//! A thing that is no ball, as the plan file has it: what was asked of its arrival, and how it arrives.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::plan::attitude::{arrived_with_delay, predict_attitude, turn_by_delay};
use crate::plan::options::{Cone, Noise};
use crate::plan::problem::Problem;
use crate::throw::Throw;

/// A thing with an axis of symmetry, fixed in the hand until the release.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttitudeInfo {
    /// Axis of symmetry in the frame E of the hand, unit vector.
    pub axis_e: [f64; 3],
    /// Moment of inertia about the axis over that across it, 0 to 2.
    pub inertia_ratio: f64,
    /// Where the axis was to point at the arrival; none: anywhere.
    pub axis: Option<DirectionInfo>,
    /// Where the angular momentum was to point; none: anywhere.
    pub spin: Option<DirectionInfo>,
    /// Least angular momentum over the transverse moment of inertia that was asked for with `spin`, in rad/s.
    pub spin_min_rad_s: f64,
    /// How the thing arrives.
    pub arrival: ArrivalInfo,
}

/// A direction that was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DirectionInfo {
    /// Unit vector, world.
    pub direction_w: [f64; 3],
    /// Largest angle to it in rad.
    pub angle_max_rad: f64,
    /// Whether the opposite direction is as good.
    pub either_sign: bool,
}

/// A thing at its arrival.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ArrivalInfo {
    /// Axis of symmetry, unit vector, world.
    pub axis_w: [f64; 3],
    /// Angular momentum over the transverse moment of inertia in rad/s, world; the same from the release on.
    pub momentum_rad_s: [f64; 3],
    /// How far a late or early release turns the thing at its arrival.
    pub delay_turns: Vec<DelayTurn>,
    /// Root mean square angle between the axis and its mean with the noise of the landing, in rad; none if some disturbed throw
    /// does not come down on the plane of the target.
    pub axis_sigma_rad: Option<f64>,
    /// The same of the angular momentum; none for a thing that does not rotate.
    pub spin_sigma_rad: Option<f64>,
}

/// Turn of a thing at its arrival when the gripper opens late or early.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DelayTurn {
    /// Delay, and equally advance, of the release in s.
    pub delay_s: f64,
    /// Turn of the axis in rad, the larger of the two; none if the thing then does not come down on the plane of the target.
    pub axis_rad: Option<f64>,
    /// Turn of the angular momentum in rad; none for a thing that does not rotate too.
    pub spin_rad: Option<f64>,
}

/// Release delays for which a plan tells the turn of the thing, in s.
const DELAYS_S: [f64; 2] = [0.010, 0.025];

impl DirectionInfo {
    fn of(cone: &Cone) -> Self {
        Self {
            direction_w: cone.direction_w.normalize().into(),
            angle_max_rad: cone.angle_max_rad,
            either_sign: cone.either_sign,
        }
    }

    /// Angle between a direction (world, any length but zero) and this one, in rad.
    #[must_use]
    pub fn angle_rad(&self, direction: &Vector3<f64>) -> f64 {
        let angle = direction.angle(&Vector3::from(self.direction_w));
        if self.either_sign { angle.min(std::f64::consts::PI - angle) } else { angle }
    }

    fn sound(&self) -> bool {
        (Vector3::from(self.direction_w).norm() - 1.0).abs() < 1e-9 && self.angle_max_rad.is_finite()
    }
}

impl AttitudeInfo {
    /// Of a throw; `None` if nothing but a ball is thrown.
    pub(super) fn of<const N: usize>(
        problem: &Problem<'_, N>,
        throw: &Throw<N>,
        noise: &Noise,
    ) -> Option<Self> {
        let attitude = problem.options.attitude?;
        let arrived = arrived_with_delay(problem, throw, 0.0)?;
        let spread = predict_attitude(problem, throw, noise);
        let turn = |delay_s: f64| {
            let turns = turn_by_delay(problem, throw, delay_s);
            DelayTurn { delay_s, axis_rad: turns.map(|t| t.0), spin_rad: turns.and_then(|t| t.1) }
        };
        Some(Self {
            axis_e: attitude.axis_e.normalize().into(),
            inertia_ratio: attitude.inertia_ratio,
            axis: attitude.axis.as_ref().map(DirectionInfo::of),
            spin: attitude.spin.as_ref().map(DirectionInfo::of),
            spin_min_rad_s: attitude.spin_min_rad_s,
            arrival: ArrivalInfo {
                axis_w: arrived.axis_w.into(),
                momentum_rad_s: arrived.momentum_rad_s.into(),
                delay_turns: DELAYS_S.into_iter().map(turn).collect(),
                axis_sigma_rad: spread.map(|s| s.axis_rad),
                spin_sigma_rad: spread.and_then(|s| s.spin_rad),
            },
        })
    }

    /// What the types cannot say.
    pub(super) fn sound(&self) -> Result<(), String> {
        let unit = (Vector3::from(self.axis_e).norm() - 1.0).abs() < 1e-9;
        if !unit || !(0.0..=2.0).contains(&self.inertia_ratio) {
            return Err(
                "target.attitude: the axis is no unit vector, or the ratio of inertia is outside 0 to 2"
                    .to_owned(),
            );
        }
        if !self.axis.iter().chain(&self.spin).all(DirectionInfo::sound) {
            return Err(
                "target.attitude: a direction is no unit vector, or its angle is not finite".to_owned()
            );
        }
        Ok(())
    }
}
