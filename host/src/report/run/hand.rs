//! The hand's end effector as planned and as measured, seen flat, and how far the two are apart.

use nalgebra::Vector3;

use super::super::chart::{Chart, Curve, Pen};
use super::RunReport;

/// Points of a path.
const STEPS: u32 = 400;

/// Axes of the base's frame: the two along which a path extends most.
const PLANES: [([usize; 2], [&str; 2]); 3] =
    [([0, 1], ["x in m", "y in m"]), ([0, 2], ["x in m", "z in m"]), ([1, 2], ["y in m", "z in m"])];

/// Places of the hand at the same times.
pub(super) struct HandPath {
    planned: Vec<Vector3<f64>>,
    measured: Vec<Vector3<f64>>,
}

impl HandPath {
    pub(super) fn of(run: &RunReport<'_>) -> Self {
        let times = (0..=STEPS).map(|i| run.ran.end_s() * f64::from(i) / f64::from(STEPS));
        let poses = times.map(|t_s| [run.ran.motion.at(t_s).q, run.q_at(t_s)]);
        let (planned, measured) = poses
            .map(|[planned, measured]| (run.arm.ee_at(&planned).pos, run.arm.ee_at(&measured).pos))
            .unzip();
        Self { planned, measured }
    }

    /// Largest distance of the hand from where the plan has it at the same time, m.
    pub(super) fn error_m(&self) -> f64 {
        self.planned.iter().zip(&self.measured).map(|(p, m)| (p - m).norm()).fold(0.0, f64::max)
    }

    /// The path in the plane of the base's axes in which it extends most.
    pub(super) fn seen_flat(&self) -> Chart {
        let extent = |axis: usize| {
            let values = || self.planned.iter().map(|p| p[axis]);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let area = |([a, b], _): &([usize; 2], [&str; 2])| extent(*a).max(1e-3) * extent(*b).max(1e-3);
        let ([a, b], [x_label, y_label]) =
            PLANES.into_iter().max_by(|one, other| area(one).total_cmp(&area(other))).unwrap_or(PLANES[0]);
        let flat = |path: &[Vector3<f64>]| path.iter().map(|p| (p[a], p[b])).collect();
        Chart {
            title: format!("Path of the hand, at most {:.2} mm beside its plan", 1e3 * self.error_m()),
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            curves: vec![
                Curve::line("planned", 6, flat(&self.planned)).drawn(Pen::Dashed),
                Curve::line("measured", 0, flat(&self.measured)),
            ],
            equal: true,
            ..Chart::default()
        }
    }
}
