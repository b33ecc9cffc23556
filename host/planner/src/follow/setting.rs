//! What both forms of the planner are asked.

use nalgebra::Vector3;

use super::clear::Margins;
use super::limits::{Arm, Limits};

/// Period of the RSI link of a KR C2 (paper 000), in s.
pub const PERIOD_S: f64 = 0.012;

/// A throw to plan.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'m> {
    /// The arm.
    pub arm: &'m Arm,
    /// Where the centre of the ball shall be at the end of its flight, in m, world frame.
    pub target: Vector3<f64>,
    /// What the controller accepts.
    pub limits: Limits,
    /// First-order lag of the controller in s: `q + lag q̇` is commanded and limited; 0 commands `q`.
    pub lag_s: f64,
    /// Time between two set points in s.
    pub period_s: f64,
    /// Distances to keep.
    pub margins: Margins,
}

impl<'m> Setting<'m> {
    /// With the period of the paper, no lag, and the margins of [`Margins::default`].
    #[must_use]
    pub fn new(arm: &'m Arm, target: Vector3<f64>, limits: Limits) -> Self {
        Self { arm, target, limits, lag_s: 0.0, period_s: PERIOD_S, margins: Margins::default() }
    }

    /// The same for another target.
    #[must_use]
    pub fn at(&self, target: Vector3<f64>) -> Self {
        Self { target, ..*self }
    }

    /// Gravity in m/s².
    #[must_use]
    pub fn gravity_m_s2(&self) -> f64 {
        self.arm.world().gravity_m_s2
    }
}
