//! Request to both forms of the planner.

use nalgebra::Vector3;

use super::clear::Margins;
use super::limits::{AXES, Arm, Axes, Limits};

/// Period of the RSI link of a KR C2 (paper 000), in s.
pub const PERIOD_S: f64 = 0.012;

/// Least and largest command per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandRange {
    /// Least command in rad.
    pub min_rad: Axes,
    /// Largest command in rad.
    pub max_rad: Axes,
}

impl Default for CommandRange {
    /// Every command.
    fn default() -> Self {
        Self { min_rad: Axes::repeat(AXES, f64::NEG_INFINITY), max_rad: Axes::repeat(AXES, f64::INFINITY) }
    }
}

impl CommandRange {
    /// The ranges of the joints, less `margin_rad` at each end.
    #[must_use]
    pub fn inside(limits: &Limits, margin_rad: f64) -> Self {
        let margin = Axes::repeat(AXES, margin_rad);
        Self { min_rad: limits.q_min_rad + margin, max_rad: limits.q_max_rad - margin }
    }

    /// How far a command is outside on an axis (from 0), in rad; negative inside.
    #[must_use]
    pub fn outside_rad(&self, axis: usize, command: &Axes) -> f64 {
        (command[axis] - self.max_rad[axis]).max(self.min_rad[axis] - command[axis])
    }

    /// Whether a command is inside on every axis. NaN is not.
    #[must_use]
    pub fn holds(&self, command: &Axes) -> bool {
        (0..command.len()).all(|axis| self.outside_rad(axis, command) <= 0.0)
    }
}

/// A throw to plan.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'m> {
    pub arm: &'m Arm,
    /// Where the centre of the ball is at the end of its flight, in m, world frame.
    pub target: Vector3<f64>,
    /// What the controller accepts.
    pub limits: Limits,
    /// Allowed commands: the robot's program may accept less than the ranges of the joints. Unbounded by default.
    pub commands: CommandRange,
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
        Self {
            arm,
            target,
            limits,
            commands: CommandRange::default(),
            lag_s: 0.0,
            period_s: PERIOD_S,
            margins: Margins::default(),
        }
    }

    /// The same for another target.
    #[must_use]
    pub fn at(&self, target: Vector3<f64>) -> Self {
        Self { target, ..*self }
    }

    #[must_use]
    pub fn gravity_m_s2(&self) -> f64 {
        self.arm.world().gravity_m_s2
    }
}
