//! Options for a thing that is no ball, and how it is to arrive.

use nalgebra::Vector3;
use planner::plan::{Attitude, Cone};
use throw_tables::TargetRow;

use super::numbers::point;

/// What is thrown instead of a ball, and its attitude at the arrival. What is not asked for is free.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Arrival attitude")]
pub struct AttitudeOptions {
    /// A thing with an axis of symmetry is thrown (stick, disc, box): its moment of inertia about that axis over the one
    /// across it, 0 (thin stick) to 2 (thin disc). The plan then tells how it arrives.
    #[arg(long, value_name = "RATIO")]
    pub thing_inertia: Option<f64>,
    /// Axis of symmetry of the thing in the frame E of the hand.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point, default_value = "0,0,1")]
    pub thing_axis: [f64; 3],
    /// Where the axis of symmetry points at the arrival, in the frame W of the world. The sign counts.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    pub arrival_axis: Option<[f64; 3]>,
    /// Largest angle between the axis of symmetry and --arrival-axis, in degrees (0.1 to 179).
    #[arg(long, value_name = "DEG", default_value_t = 15.0)]
    pub arrival_axis_max_deg: f64,
    /// The opposite of --arrival-axis is as good: the thing has no front.
    #[arg(long)]
    pub arrival_axis_either_sign: bool,
    /// Axis about which the thing rotates at the arrival, right-handed, in the frame W of the world: the direction of its angular
    /// momentum, which the flight does not change.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    pub spin_axis: Option<[f64; 3]>,
    /// Largest angle between the axis of rotation and --spin-axis, in degrees (0.1 to 179).
    #[arg(long, value_name = "DEG", default_value_t = 20.0)]
    pub spin_axis_max_deg: f64,
    /// The opposite of --spin-axis is as good: the sense of rotation does not matter.
    #[arg(long)]
    pub spin_axis_either_sign: bool,
    /// Least angular momentum over the transverse moment of inertia with --spin-axis, in rad/s (0.1 to 100).
    #[arg(long, value_name = "RAD/S", default_value_t = 1.0)]
    pub spin_min_rad_s: f64,
}

impl AttitudeOptions {
    /// For the planner; `None` for a ball.
    pub(super) fn resolve(&self) -> Option<Attitude> {
        let cone = |direction: Option<[f64; 3]>, deg: f64, either_sign| {
            let direction_w = Vector3::from(direction?);
            Some(Cone { direction_w, angle_max_rad: deg.to_radians(), either_sign })
        };
        Some(Attitude {
            axis_e: Vector3::from(self.thing_axis),
            inertia_ratio: self.thing_inertia?,
            axis: cone(self.arrival_axis, self.arrival_axis_max_deg, self.arrival_axis_either_sign),
            spin: cone(self.spin_axis, self.spin_axis_max_deg, self.spin_axis_either_sign),
            spin_min_rad_s: self.spin_min_rad_s,
        })
    }

    /// What a row of a list says, in place of the own words.
    pub(super) fn take_row(&mut self, row: &TargetRow) {
        self.arrival_axis = row.arrival_axis.or(self.arrival_axis);
        self.arrival_axis_max_deg = row.arrival_axis_max_deg.unwrap_or(self.arrival_axis_max_deg);
        self.spin_axis = row.spin_axis.or(self.spin_axis);
        self.spin_axis_max_deg = row.spin_axis_max_deg.unwrap_or(self.spin_axis_max_deg);
    }
}
